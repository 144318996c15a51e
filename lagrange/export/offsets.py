"""Which arrays a procedure is given from a place on: for languages in which a part of an array is no array."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.procedure.form import Block, Part, Procedure, calls, inner

Shifted = Mapping[Procedure, frozenset[int]]
"""Of each procedure, which of its parameters are arrays that begin at a place that the caller gives."""


def shifted_parameters(procedures: Sequence[Procedure], always: Shifted) -> Shifted:
    """Return the parameters that are given parts of arrays somewhere, and those of `always`.

    Procedures come before their callers.
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
