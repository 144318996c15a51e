"""Systems for the tests of dynamics, each compiled once."""

from functools import cache
from typing import Any

from sympy import cos, sin

import lagrange as lg

x, y, theta = lg.coordinates("x y theta")
F, w, r, g, m, c = lg.parameters("F w r g m c")
mu = lg.parameters("mu", positive=False)


@cache
def pendulum() -> lg.System:
    """Return the pendulum theta'' = -sin(theta)."""
    return lg.System(kinetic=theta.dot**2 / 2, potential=-cos(theta), name="pendulum")


@cache
def damped_pendulum() -> lg.System:
    return lg.System(kinetic=theta.dot**2 / 2, potential=-cos(theta), forces={theta: -0.3 * theta.dot}, name="damped")


@cache
def escape() -> lg.System:
    """Return a particle in the potential x^2/2 - x^3/3, whose saddle at 1 has a homoclinic orbit."""
    return lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2 - x**3 / 3, name="escape")


@cache
def van_der_pol() -> lg.System:
    return lg.System(
        kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: (1 - x**2) * x.dot}, coordinates=[x], name="van der Pol"
    )


@cache
def duffing() -> lg.System:
    """Return the oscillator x'' + 0.3 x' - x + x^3 = F cos(w t)."""
    return lg.System(
        kinetic=x.dot**2 / 2,
        potential=x**4 / 4 - x**2 / 2,
        forces={x: -0.3 * x.dot + F * cos(w * lg.t)},
        parameters={F: 0.2, w: 1.2},
        initial={x: 1.0},
        name="Duffing",
    )


@cache
def driven_linear() -> lg.System:
    """Return the oscillator x'' + 0.5 x' + 4 x = cos(3 t)."""
    return lg.System(
        kinetic=x.dot**2 / 2, potential=2 * x**2, forces={x: -x.dot / 2 + cos(3 * lg.t)}, coordinates=[x], name="driven"
    )


@cache
def star() -> lg.System:
    """Return a star in the galaxy of Henon and Heiles."""
    return lg.System(
        kinetic=lg.kinetic_energy(1, (x, y)), potential=(x**2 + y**2) / 2 + x**2 * y - y**3 / 3, name="Henon-Heiles"
    )


@cache
def hoop() -> lg.System:
    """Return a bead on a hoop that rotates at the rate w."""
    return lg.System(
        kinetic=m * r**2 * (theta.dot**2 + w**2 * sin(theta) ** 2) / 2,
        potential=-m * g * r * cos(theta),
        parameters={m: 1, r: 0.5, g: 9.81, w: 1},
        name="bead on a hoop",
    )


def interrupting(after: int) -> Any:
    """Return a function that forwards calls to another, and raises KeyboardInterrupt after a number of them."""

    def around(function: Any) -> Any:
        calls = iter(range(after))

        def called(*arguments: Any, **named: Any) -> Any:
            if next(calls, None) is None:
                raise KeyboardInterrupt
            return function(*arguments, **named)

        return called

    return around
