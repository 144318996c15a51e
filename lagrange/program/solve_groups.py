"""Group solves that share a factored matrix, and order the instructions so that each group is solved at once.

Systems belong together where no right-hand side depends on the solution of another. A Jacobian has many such: one for
each entry of the state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from lagrange.program.program import Program


class SolveGroup(NamedTuple):
    """Instructions `solves` with one `factor`, in order, with all right-hand sides known before the first solution."""

    factor: int
    solves: tuple[int, ...]


def scheduled(program: Program, refs: Iterable[int], most: Callable[[int], int]) -> list[int | SolveGroup]:
    """Return instructions in an order in which systems can be solved together: at most `most(factor)` with a factor.

    At the number of a solve in a group its right-hand side is known, and its solution from the group itself on. The
    order is that of how many solves an instruction builds upon, one after the other, then that of the program; without
    groups it is the program's.
    """
    refs = list(refs)
    factors = [program.instructions[i].args[0] for i in refs if program.instructions[i].op == "solve"]
    if len(factors) == len(dict.fromkeys(factors)):
        return list(refs)
    known: dict[int, int] = {}
    """Depth of solves in the operands of each instruction."""
    depth: dict[int, int] = {}
    alike: dict[tuple[int, int], list[int]] = {}
    for i in refs:
        one = program.instructions[i]
        known[i] = max((depth.get(arg, 0) for arg in one.args), default=0)
        depth[i] = known[i] + (one.op == "solve")
        if one.op == "solve":
            alike.setdefault((one.args[0], known[i]), []).append(i)
    groups = [
        SolveGroup(factor, part) for (factor, _), solves in alike.items() for part in _parts(solves, most(factor))
    ]
    if not groups:
        return list(refs)
    grouped = dict.fromkeys(i for group in groups for i in group.solves)
    steps: list[tuple[int, int, int | SolveGroup]] = [(known[i] if i in grouped else depth[i], 2 * i, i) for i in refs]
    steps += [(known[group.solves[0]], 2 * group.solves[-1] + 1, group) for group in groups]
    return [step for _, _, step in sorted(steps, key=lambda one: one[:2])]


def _parts(solves: list[int], most: int) -> list[tuple[int, ...]]:
    """Return groups of about the same size, at most `most` each, without groups of one."""
    if min(len(solves), most) < 2:
        return []
    size = -(-len(solves) // -(-len(solves) // most))
    parts = [tuple(solves[begin : begin + size]) for begin in range(0, len(solves), size)]
    return [part for part in parts if len(part) > 1]
