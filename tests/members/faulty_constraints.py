"""Faults of constraints of single members of an ensemble whose other members are healthy."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from sympy import sqrt

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import Status
from tests.faults.constraints import LOST, ROD, x, y
from tests.members.faulty import Faulty, Values, c

REFUSED, UNMET = (Status.NON_FINITE,), (Status.SINGULAR, Status.DIVERGED, *LOST)
"""How a member ends whose start is refused, or whose constraints cannot be met further on."""


@cache
def held(*constraints: Any, **initial: float) -> Model:
    """Return the model of a unit mass in a plane under unit gravity, with constraints that contain a parameter c."""
    return lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=y,
        coordinates=[x, y],
        constraints=dict(zip("ab", constraints, strict=False)),
        initial={entry: initial[name] for name, entry in (("x", x), ("y", y)) if name in initial},
        parameters={c: initial.get("c", 1.0)} if any(item.has(c) for item in constraints) else {},
        name="held mass",
    ).compile()


@cache
def weighed_bob() -> Model:
    """Return the model of a bob on a rod whose mass is a parameter."""
    return lg.System(
        kinetic=c * (x.dot**2 + y.dot**2) / 2,
        potential=c * y,
        coordinates=[x, y],
        constraints={"rod": ROD},
        initial={x: 1.0},
        parameters={c: 1.0},
        name="weighed bob",
    ).compile()


def root(values: Values) -> Values:
    """Return square roots, 0 for negative values."""
    return np.sqrt(np.maximum(values, 0.0))


def rod() -> Model:
    """Return the model of a bob on a rod of unit length."""
    return held(ROD, x=0.6, y=-0.8)


FAULTY_CONSTRAINTS = (
    Faulty("off a constraint", rod, "x", 1.3, (0.1, 0.9), REFUSED, follows=lambda v: {"y": -root(1 - v * v)}),
    Faulty("speed off a constraint", rod, "x_dot", 0.7, (0.0, 0.0), REFUSED, held={"x": 0.6, "y": -0.8}),
    Faulty(
        "no state",
        lambda: held(x**2 + y**2 - c, x=1.0),
        "c",
        -1.0,
        (0.5, 2.0),
        REFUSED,
        follows=lambda v: {"x": root(v)},
    ),
    Faulty(
        "squared by a number",
        lambda: held((x - y) * (x - y + c), x=0.3, y=0.3),
        "c",
        0.0,
        (0.5, 2.0),
        REFUSED,
        held={"x": 0.3 + 4e-8, "y": 0.3, "x_dot": 0.5, "y_dot": 0.5},
    ),
    Faulty("dependent", lambda: held(x - y - 1, x - c * y - 1, x=1.0, c=2.0), "c", 1.0, (2.0, 3.0), REFUSED),
    Faulty("massless bob", weighed_bob, "c", 0.0, (0.5, 2.0), (Status.SINGULAR,)),
    Faulty(
        "drive out of its domain",
        lambda: held(x - sqrt(c - lg.t), c=9.0, x=3.0),
        "c",
        1.0,
        (4.0, 9.0),
        UNMET,
        end=2.0,
        follows=lambda v: {"x": np.sqrt(v), "x_dot": -1 / (2 * np.sqrt(v))},
    ),
)
"""Ways in which constraints of `tests.faults` are not met at the start of a member, or lost on its way."""
