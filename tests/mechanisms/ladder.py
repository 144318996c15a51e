"""The ladder of N four-bar loops, a benchmark problem of multibody dynamics, for any N.

Source: M. Gonzalez, F. Gonzalez, A. Luaces, J. Cuadrado, A collaborative benchmarking framework for multibody system
dynamics, Engineering with Computers 26 (2010) 1, problem A02, with N = 40, rods of 1 m and 1 kg, 1 m/s at the start.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import lagrange as lg
from lagrange.statement.statement import Statement

GRAVITY = 9.81


def four_bar_ladder(loops: int) -> Statement:
    """Return the ladder of N loops, stated like the scene four-bar-ladder, which has two loops.

    Its coordinates are those of the pins B0 to BN. N + 1 rods connect them to the ground, and N couplers connect the
    pins.
    """
    m, l, g = lg.parameters("m l g")
    pins = [lg.coordinates(f"x{i} y{i}") for i in range(loops + 1)]
    feet = [(i * l, 0) for i in range(loops + 1)]

    def rod(first: Any, other: Any) -> Any:
        return (other[0] - first[0]) ** 2 + (other[1] - first[1]) ** 2 - l**2

    kinetic = sum(m * (x.dot**2 + y.dot**2) / 6 for x, y in pins)
    height = sum((y / 2 for _, y in pins), 0)
    constraints = {f"rod{i}": rod(foot, pin) for i, (foot, pin) in enumerate(zip(feet, pins, strict=True))}
    for i, (first, second) in enumerate(pairwise(pins), start=1):
        kinetic += m * sum(p.dot**2 + p.dot * q.dot + q.dot**2 for p, q in zip(first, second, strict=True)) / 6
        height += (first[1] + second[1]) / 2
        constraints[f"coupler{i}"] = rod(first, second)
    initial: dict[Any, float] = {}
    for i, (x, y) in enumerate(pins):
        initial |= {x: float(i), y: 1.0, x.dot: 1.0}
    return lg.System(
        kinetic=kinetic,
        potential=m * g * height,
        coordinates=[place for pin in pins for place in pin],
        constraints=constraints,
        parameters={m: 1.0, l: 1.0, g: GRAVITY},
        initial=initial,
        positions={f"B{i}": pin for i, pin in enumerate(pins)},
        name=f"ladder of {loops} four-bar loops",
    ).statement


def parallelogram_acceleration(loops: int, angle: float) -> float:
    """Return the angular acceleration of the rods, which are parallel, at an angle to the ground.

    T = ((N + 1)/3 + N) w^2/2 and V = g ((N + 1)/2 + N) sin(angle).
    """
    return -GRAVITY * ((loops + 1) / 2 + loops) / ((loops + 1) / 3 + loops) * math.cos(angle)
