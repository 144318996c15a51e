"""A pendulum with open inputs, the pivot X and the torque u, and the same with values."""

from __future__ import annotations

from typing import Any

from sympy import cos, sin

import lagrange as lg

X, u = lg.given("X"), lg.given("u")
theta = lg.coordinate("theta")
m, g, length = lg.parameters("m g l")

VALUES = {X: sin(3 * lg.t) / 5 + lg.t**2, u: -2 + cos(lg.t)}
BOB: Any = (X + length * sin(theta), -length * cos(theta))


def driven() -> lg.System:
    """Return the pendulum with its inputs left open."""
    return lg.System(
        lg.kinetic_energy(m, BOB),
        lg.gravity(m, BOB, g),
        forces={theta: u - theta.dot / 10},
        parameters={m: 1.5, g: 9.81, length: 2},
        initial={theta: 1},
        positions={"bob": BOB},
        name="driven",
    )


def at(t: float) -> dict[str, float]:
    """Return the values of the inputs and their rates at a time."""
    pivot: Any = VALUES[X]
    names = ("X", "X_dot", "X_ddot")
    result = {name: float(pivot.diff(lg.t, order).subs(lg.t, t)) for order, name in enumerate(names)}
    return {**result, "u": float(VALUES[u].subs(lg.t, t))}
