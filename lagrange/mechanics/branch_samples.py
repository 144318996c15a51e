"""States at which the switches of equations go other ways: equations are compared in each of their branches."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import sympy

from lagrange.evidence.operations import OutsideDomain
from lagrange.evidence.sample import Point, Sampler
from lagrange.evidence.switches import all_ways
from lagrange.mechanics.equation_row import EquationRow
from lagrange.mechanics.motion_samples import MotionSample, MotionStates
from lagrange.statement.statement import Statement

DRAWS = 1000
"""Points drawn in search of other branches; most of them cost one evaluation of the conditions."""

MOST = 16
"""States that may be added for them."""

NEAREST = 8.0
"""Digits to which an entry may agree with a number of the equations: a branch between 3 and 3.0001 is met."""

Way = tuple[Any, int]
"""A switch and one of its outcomes."""


def branch_samples(
    statement: Statement, rows: Sequence[EquationRow], known: Sequence[MotionSample]
) -> tuple[list[MotionSample], list[Way]]:
    """Return states at which switches of the statement or the equations go together in a way that no state has yet.

    Also the outcomes of switches that no state has. Entries of states are drawn of any size, and near the numbers that
    stand in the equations, energies and forces.
    """
    states = MotionStates(statement)
    switches = [*states.reference.switches, *(switch for row in rows for switch in row.switches)]
    if not switches:
        return [], []

    def ways(point: Point) -> tuple[int | None, ...]:
        return (*states.reference.inspect(point), *(way for row in rows for way in row.ways(point)))

    found: list[MotionSample] = []
    seen: set[tuple[int | None, ...]] = set()
    for sample in known:
        with suppress(OutsideDomain):
            seen.add(ways(sample.point))
    for point in _points(statement, _numbers(statement, rows)):
        if len(found) == MOST:
            break
        with suppress(OutsideDomain):
            point = states.satisfied(point)
            if (taken := ways(point)) not in seen:
                found.append(states.motion(point))
                seen.add(taken)
    had = {pair for taken in seen for pair in zip(switches, taken, strict=True)}
    every = dict.fromkeys((switch, way) for switch in switches for way in all_ways(switch))
    return found, [pair for pair in every if pair not in had]


def _numbers(statement: Statement, rows: Sequence[EquationRow]) -> list[float]:
    """Return the sizes of the numbers that stand in the equations, the energies and the forces, 1 among them."""
    expressions = [statement.lagrangian, *statement.forces, *(row.zero for row in rows)]
    numbers = {abs(float(x)) for one in expressions for x in one.atoms(sympy.Number) if x.is_finite}
    return sorted(x for x in numbers | {1.0} if x and math.isfinite(x))


def _points(statement: Statement, numbers: Sequence[float]) -> Iterator[Point]:
    """Yield points with entries of any size, half of them near one of the numbers."""
    sampler, draw = Sampler(statement, 1), random.Random(1)

    def near() -> float:
        return (
            draw.choice((-1, 1)) * draw.choice(numbers) * (1 + draw.choice((-1, 1)) * 10 ** -draw.uniform(0, NEAREST))
        )

    for _ in range(DRAWS):
        point = sampler.far()
        q, v = (tuple(near() if draw.random() < 0.5 else x for x in entries) for entries in (point.q, point.v))
        values = {p: math.copysign(near(), x) if draw.random() < 0.2 else x for p, x in point.parameters.items()}
        yield replace(point, q=q, v=v, parameters=values)
