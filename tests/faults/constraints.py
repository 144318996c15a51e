"""Faults of constraints: empty, dependent, contradictory, not met or not smooth."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

from sympy import Abs, cos, sin, sqrt

import lagrange as lg
from lagrange.machine.model import Model
from tests.faults.fault import Fault

x, y, z = lg.coordinates("x y z")
m, l = lg.parameters("m l")

NOT_MADE_FOR = "|leave out the forces of the constraints|moves coordinates and velocities in turn"
"""What methods say that do not know of constraints, when they are asked before the start is looked at."""


def held(constraints: Any, initial: Any = None, potential: Any = None, **more: Any) -> Callable[[], Model]:
    """Return what makes the model of a unit mass in a plane under unit gravity, held by constraints."""

    @cache
    def made() -> Model:
        stated: dict[str, Any] = {"kinetic": (x.dot**2 + y.dot**2) / 2, "coordinates": [x, y], "name": "held mass"}
        stated |= {"potential": y if potential is None else potential, **more}
        return lg.System(constraints=constraints, initial=initial or {}, **stated).compile()

    return made


ROD = x**2 + y**2 - 1
AT_ONE = {x: math.sin(1.0), y: -math.cos(1.0)}


def refused(name: str, about: str, words: str, model: Callable[[], Model], **more: Any) -> Fault:
    """A statement, or a start, that deserves a refusal in words."""
    return Fault(name, about, model, refusal=words, **more)


STATED = (
    refused(
        "too many constraints",
        "three constraints for two coordinates",
        r"there are 3 constraints .* for 2 coordinates",
        held([x - y, x + y, ROD]),
    ),
    refused("empty constraint", "0 = 0 as a constraint", "0 = 0, which always holds", held({"a": x - x})),
    refused("false constraint", "1 = 0 as a constraint", "1 = 0, which never holds", held({"a": x - x + 1})),
    refused(
        "constraint without coordinates",
        "a constraint on a parameter alone",
        "'a' contains no coordinate and no velocity",
        held({"a": m - 2}, parameters={m: 1.0}),
    ),
    refused("identity", "cos^2 + sin^2 = 1", "'a' is always true", held({"a": cos(x) ** 2 + sin(x) ** 2 - 1})),
    refused("impossibility", "cos^2 + sin^2 = -1", "'a' is never true", held({"a": cos(x) ** 2 + sin(x) ** 2 + 1})),
    refused("inequality", "x > 0 as a constraint", "an inequality", held({"a": x > 0})),
    refused(
        "constraint on accelerations",
        "x'' = 1 as a constraint",
        "the derivative of order 2 of x",
        held({"a": x.dot.diff(lg.t) - 1}),
    ),
    refused(
        "dependent constraints",
        "the same line twice, in other words",
        "'a' and 'c' are dependent here",
        held({"a": x - y, "c": 2 * x - 2 * y}),
    ),
    refused(
        "contradiction",
        "two circles with one centre",
        "contradict one another",
        held({"a": ROD, "b": x**2 + y**2 - 4}, {x: 1.0}),
    ),
    refused(
        "contradiction that is allowed to be redundant",
        "two circles with one centre, with redundant='allow'",
        "no state was found that satisfies the constraints 'a' and 'b'",
        held({"a": ROD, "b": x**2 + y**2 - 4}, {x: 1.0}, redundant="allow"),
    ),
    refused(
        "motion without inertia",
        "a coordinate without kinetic energy, and a constraint on the others",
        r"z.*no inertia",
        held({"a": x - y}, kinetic=(x.dot**2 + y.dot**2) / 2, coordinates=[x, y, z]),
    ),
    refused(
        "velocity and place contradict",
        "a constraint on the speed along a line that another holds in place",
        "'a' and 'b' are dependent|contradict one another",
        held({"a": x - 1, "b": x.dot - 1}, {x: 1.0, x.dot: 1.0}),
    ),
)

BEGUN = (
    refused("start off a constraint", "x^2 + y^2 = 1.21 on a rod of length 1", "rod", held({"rod": ROD}, {x: 1.1})),
    refused(
        "speed off a constraint",
        "a bob that moves along its rod",
        "initial velocities do not satisfy the constraint.*rod",
        held({"rod": ROD}, {x: 1.0, x.dot: 0.5}),
    ),
    refused(
        "start without a state",
        "a rod that is to have the length i, and a bob at 0.5",
        "rod",
        held({"rod": x**2 + y**2 + 1}, {x: 0.5}),
    ),
    refused(
        "no derivative at the start",
        "the length of a rod of no length",
        "not differentiable at the initial state",
        held({"rod": sqrt(x**2 + y**2)}),
    ),
    refused(
        "kink at the start",
        "a wire with a corner, from the corner",
        "not differentiable at the initial state",
        held({"wire": y - Abs(x)}, {x.dot: 1.0, y.dot: 1.0}),
    ),
    refused(
        "squared constraint",
        "(x - y)^2 = 0, whose derivative vanishes where it holds",
        "'a' restricts no velocity, for all its derivatives" + NOT_MADE_FOR,
        held({"a": (x - y) ** 2}),
    ),
    refused(
        "dependent where they hold",
        "x = y and x^2 = y^2, from x = y = 1",
        "'a' and 'c' are dependent" + NOT_MADE_FOR,
        held({"a": x - y, "c": x**2 - y**2}, {x: 1.0, y: 1.0}),
    ),
    refused(
        "nan on a constraint",
        "x = nan on a rod",
        "initial value of x is nan",
        held({"rod": ROD}, AT_ONE),
        options={"initial": {x: math.nan}},
    ),
)

CONSTRAINTS: tuple[Fault, ...] = (*STATED, *BEGUN)
