"""Array parameters that need an offset, for languages without subarrays by reference."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.procedure.form import Block, Part, Procedure, calls, inner

Shifted = Mapping[Procedure, frozenset[int]]
"""Indices of the array parameters of each procedure for which the caller passes an offset, too."""


def shifted_parameters(procedures: Sequence[Procedure], always: Shifted) -> Shifted:
    """Return the array parameters to which some call passes a subarray, and those of `always`.

    `procedures` are ordered, callees before their callers.
    """
    found = {one: always.get(one, frozenset[int]()) for one in procedures}
    for caller in reversed(procedures):
        own = [one.ref for place, one in enumerate(caller.parameters) if place in found[caller]]
        moved = frozenset((*own, *(part.ref for part in _parts(caller.body))))
        for call in calls(caller.body):
            if isinstance(call.callee, Procedure):
                found[call.callee] |= {place for place, arg in enumerate(call.args) if arg in moved}
    return found


def _parts(block: Block) -> Iterator[Part]:
    for statement in block:
        if isinstance(statement, Part):
            yield statement
        for one in inner(statement):
            yield from _parts(one)
