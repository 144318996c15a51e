"""Random mechanisms in a plane: rods with coupled masses, a pivot that may move, and a knife edge."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import sympy as sp

import lagrange as lg
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model

SEEDS = range(6)


@cache
def mechanism(seed: int) -> lg.System:
    """Return a mechanism. Every second one has a moving pivot, and every third a skate on a spring."""
    rng = np.random.default_rng(seed)
    points = [lg.coordinates(f"x{i} y{i}") for i in range(1 + seed % 3)]
    pivot: Any = (sp.sin(2 * lg.t) / 10, 0) if seed % 2 else (0, 0)
    kinetic, potential = sp.Integer(0), sp.Integer(0)
    rods: dict[str, Any] = {}
    initial: dict[Any, float] = {}
    # States are drawn at random too: their order must not be that in which other tests declared these names.
    order: list[Any] = [q for point in points for q in point]
    before: Any = pivot
    velocity: Any = (sp.Integer(0), sp.Integer(0))
    place = np.zeros(2)
    for i, point in enumerate(points):
        mass, length, angle = map(float, (*rng.uniform(0.5, 2.0, 2), rng.uniform(-2.5, 2.5)))
        own = tuple(q.dot for q in point)
        # A point mass and a uniform rod to the point before, which couples the velocities of both.
        kinetic += sum(mass * v**2 / 2 + mass * (v**2 + v * w + w**2) / 12 for v, w in zip(own, velocity, strict=True))
        potential += 9.81 * mass * point[1] + point[0] ** 2 / 2
        rods[f"rod{i}"] = sum((p - b) ** 2 for p, b in zip(point, before, strict=True)) - length**2
        place = place + length * np.array([np.sin(angle), -np.cos(angle)])
        initial |= dict(zip(point, place.tolist(), strict=True))
        initial |= {q.dot: float(rng.normal()) for q in point}
        before, velocity = point, own
    if seed % 3 == 2:
        u, w, heading = lg.coordinates("u w heading")
        order += [u, w, heading]
        kinetic += (u.dot**2 + w.dot**2 + heading.dot**2 / 3) / 2
        potential += (u - before[0]) ** 2 + (w - before[1]) ** 2
        rods["edge"] = u.dot * sp.sin(heading) - w.dot * sp.cos(heading)
        initial |= {heading: float(rng.uniform(0, 6)), heading.dot: 1.0, u.dot: 0.4}
    given: dict[str, Any] = {
        "kinetic": kinetic,
        "potential": potential,
        "coordinates": order,
        "constraints": rods,
        "name": f"mechanism {seed}",
    }
    return lg.System(**given, initial=lg.System(**given, initial=initial).consistent(initial).initial)


@cache
def compiled(seed: int, target: str = "llvm") -> Model:
    """Return the model of a mechanism."""
    return mechanism(seed).compile(target)


def initial_state(seed: int) -> FloatArray:
    """Return the initial state of a mechanism, which satisfies its constraints."""
    return np.array(compiled(seed).statement.initial, dtype=float)
