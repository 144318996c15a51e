"""Linear equations about motions on constraints: closed forms, and differences of the flow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import Matrix, Rational, cos, sin

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.mechanics.plain_form import numeric
from tests.refusals import refusal

x, y, z, heading, lean, spin = lg.coordinates("x y z heading lean spin")
m, g, r, k, w = lg.parameters("m g r k w")


def disc(*order: Any) -> lg.System:
    """Return a thin disc that rolls: (x, y) is the point of contact."""
    centre = Matrix([x + r * sin(lean) * sin(heading), y - r * sin(lean) * cos(heading), r * cos(lean)])
    about_axle = spin.dot + heading.dot * sin(lean)
    turning = m * r**2 * (lean.dot**2 + (heading.dot * cos(lean)) ** 2 + 2 * about_axle**2) / 8
    velocity = centre.diff(lg.t)
    return lg.System(
        m * velocity.dot(velocity) / 2 + turning,
        m * g * centre[2],
        coordinates=order or [x, y, heading, lean, spin],
        constraints={"along": x.dot - r * spin.dot * cos(heading), "across": y.dot - r * spin.dot * sin(heading)},
        parameters={m: 1.3, g: 9.81, r: 0.4, w: 5},
        name="disc",
    )


@pytest.mark.slow
def test_a_disc_that_rolls_straight_is_stable_above_its_critical_spin() -> None:
    # With the moments m r^2/4 and m r^2/2, leaning and turning follow 5/4 r lean'' + 3/2 r w heading' = g lean and
    # heading'' = 2 w lean', which is stable where w^2 > g/(3 r).
    straight = {x.dot: r * w, spin.dot: w}
    modes = disc().modes(straight)
    assert modes.linearization.note == "About a steady motion on the constraints."
    assert modes.symbolic
    assert sympy.expand(modes.frequencies[2] ** 2 - (12 * w**2 / 5 - 4 * g / (5 * r))) == 0
    critical = np.sqrt(9.81 / (3 * 0.4))
    path = disc().eigenvalues(w, [0.0, 0.99 * critical, 1.01 * critical, 20.0], straight)
    assert path.stable.tolist() == [False, False, True, True]
    assert path.eigenvalues.shape == (4, 8)  # five positions, and three independent velocities


def test_independent_coordinates_may_be_any() -> None:
    result = disc(spin, lean, heading, x, y).linearize({x.dot: r * w, spin.dot: w})
    assert result.velocity_coordinates == (lean, heading, x)
    assert result.coordinates == (spin, lean, heading, x, y)
    assert result.equilibrium
    assert result.C[0, 1] * result.C[1, 0] == -3 * m**2 * r**4 * w**2 / 4


def random_system(seed: int) -> tuple[lg.System, Any, Any]:
    """Return a system whose z and heading' follow from the others, with z = f(x, y, t) and heading' = h."""
    random = np.random.default_rng(seed)

    def draw() -> Any:
        return Rational(int(random.integers(3, 12)), 7)

    above = draw() * x**2 + draw() * sin(x - draw() * y)
    turning = draw() * x.dot * cos(draw() * heading) + (draw() + z) * y.dot + draw() * sin(x) * z.dot
    kinetic = sum(draw() * q.dot**2 for q in (x, y, z, heading)) + (x.dot * draw() * cos(heading) + y.dot) ** 2
    kinetic += draw() * sin(x) ** 2 * heading.dot**2 + draw() * x.dot * y
    potential = g * z + draw() * x * heading + draw() * cos(x * y)
    system = lg.System(
        kinetic,
        potential,
        coordinates=[z, heading, x, y],
        constraints={"on": z - above, "turn": heading.dot - turning},
        forces={x: -draw() * x.dot * y, heading: draw() * z.dot * heading.dot},
        parameters={g: 2},
        name=f"random {seed}",
    )
    return system, above, turning


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(4))
def test_the_matrix_is_the_slope_of_the_motion_on_the_constraints(seed: int) -> None:
    system, above, turning = random_system(seed)
    model, steps = system.compile("numpy"), 1e-4

    def whole(values: Any) -> Any:
        """Return the whole state of the disc from x, y, the heading, x' and y'."""
        table = dict(zip((x.dot, y.dot, x, y, heading), (*values[3:], *values[:3][[1, 2, 0]]), strict=True))
        table[z.dot] = above.diff(lg.t).subs(table)
        table[z] = above.subs(table)
        table[heading.dot] = turning.subs(table)
        return np.array([float(table[s]) for s in (*system.coordinates, *(q.dot for q in system.coordinates))])

    values = np.array([0.25, 0.5, -0.375, 0.625, -0.75])  # exact in binary: heading, x, y, x', y'
    rows = [1, 2, 3, 6, 7]
    columns = []
    for change in steps * np.eye(5):
        near = [model.rhs(0.0, whole(values + share * change))[rows] for share in (-2, -1, 1, 2)]
        columns.append((near[0] - 8 * near[1] + 8 * near[2] - near[3]) / (12 * steps))
    exact = dict(zip((heading, x, y, x.dot, y.dot), map(Rational, values), strict=True))
    exact[z.dot] = above.diff(lg.t).subs(exact)
    exact |= {z: above.subs({x: exact[x], y: exact[y]})}
    exact[heading.dot] = turning.subs(exact)
    lin = system.linearize(exact)
    assert lin.coordinates == (heading, x, y)
    assert lin.velocity_coordinates == (x, y)
    difference = np.array(columns).T - numeric(lin.A, {g: 2})
    # Fourth-order differences with steps of 1e-4 leave rounding, 1e-16/1e-4 times a few.
    assert np.abs(difference).max() <= 1e-9 * np.abs(columns).max()


@pytest.mark.parametrize(
    ("at", "words"),
    [
        ({x.dot: r * w}, "the velocities are not on the constraint 'along', which is r*w there and not zero: give"),
        ({x.dot: 1.0, spin.dot: 1.0}, "the velocities are not on the constraint 'along', which is 0.6"),
    ],
)
def test_velocities_off_the_constraints_are_refused(at: Any, words: str) -> None:
    assert refusal(disc().linearize, at).startswith(words)


def test_an_equilibrium_in_decimals_is_not_followed_along_constraints() -> None:
    with pytest.raises(StatementError, match="disc has constraints, and an equilibrium in decimals cannot be"):
        disc().eigenvalues(w, [1.0], {x.dot: 0.4, spin.dot: 1.0})
