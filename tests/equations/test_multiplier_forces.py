"""Forces with multipliers, such as Coulomb friction, compared with closed forms and with a direct elimination."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import Rational, cos, sign, sin, sqrt

import lagrange as lg
from lagrange.errors import StatementError
from tests.refusals import refusal

x, y, z, theta = lg.coordinates("x y z theta")
m, g, mu, slope, R, L = lg.parameters("m g mu slope R L")
NORMAL, WALL = lg.multiplier("floor"), lg.multiplier("wall")


def incline(**more: Any) -> lg.System:
    stated = {"forces": {x: -mu * NORMAL * sign(x.dot)}, "constraints": {"floor": y}, "initial": {x.dot: 1.5}, **more}
    return lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        m * g * (y * cos(slope) - x * sin(slope)),
        coordinates=[x, y],
        parameters={m: 2, g: 9.81, mu: 0.2, slope: 0.6},
        name="incline",
        **stated,
    )


METHODS = ("taylor", "dopri5", "tsit5", "verner9", "dop853", "bs3", "radau5", "radau5-index2", "scipy-radau")


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
def test_a_block_slides_down_with_every_adaptive_method(method: str) -> None:
    run = incline().run(2.0, method=method)
    pull = 9.81 * (np.sin(0.6) - 0.2 * np.cos(0.6))
    assert abs(run.final["x"] - (3 + 2 * pull)) <= 1e-7  # the tolerance of a run is 1e-9, a few steps add up
    assert abs(run.final["x_dot"] - (1.5 + 2 * pull)) <= 1e-7
    np.testing.assert_allclose(run.evaluate(NORMAL), 2 * 9.81 * np.cos(0.6), rtol=1e-12)


def test_a_page_shows_the_multiplier_and_accelerations_without_it() -> None:
    page = incline().derivation()
    assert page.equations[0].rhs == -mu * NORMAL * sign(x.dot)
    assert page.equations[1].rhs == NORMAL
    assert page.multipliers == {"floor": g * m * cos(slope)}
    assert sympy.expand(page.accelerations[x] - g * (sin(slope) - mu * cos(slope) * sign(x.dot))) == 0
    assert incline().check()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_random_systems_solve_the_bordered_equations(seed: int) -> None:
    random = np.random.default_rng(seed)

    def draw() -> Any:
        return Rational(int(random.integers(-9, 10)), 11)

    def stated(**more: Any) -> lg.System:
        return lg.System(
            kinetic,
            potential,
            coordinates=[x, y, z, theta],
            constraints={"floor": z - sin(x) * y, "turn": theta.dot - x.dot * cos(y) - z * y.dot},
            name=f"random {seed}",
            **more,
        )

    speeds = [q.dot for q in (x, y, z, theta)]
    kinetic = sum(q**2 for q in speeds) + sum(draw() * a * b / 4 for a in speeds for b in speeds)
    kinetic += (x * theta.dot) ** 2 + draw() * y.dot
    potential = g * z + draw() * x * theta + y**2
    held = [NORMAL, lg.multiplier("turn")]
    pushes = [[draw() * sin(x) * y.dot / 2, draw() * z / 2 + draw() / 3] for _ in range(4)]
    others = [draw() * y.dot, draw() * x, 0, -draw() * theta.dot]
    forces = [q + sum(a * b for a, b in zip(row, held, strict=True)) for q, row in zip(others, pushes, strict=True)]
    rough = stated(forces=dict(zip((x, y, z, theta), forces, strict=True)), parameters={g: 2})
    smooth = stated(forces=dict(zip((x, y, z, theta), others, strict=True)), parameters={g: 2})
    model, plain = rough.compile("numpy"), smooth.compile("numpy")
    q, v = random.normal(size=4), random.normal(size=4)
    values = dict(zip((x, y, z, theta, *speeds), map(float, (*q, *v)), strict=True))
    b = np.array(sympy.Matrix(pushes).subs(values, simultaneous=True).tolist(), dtype=float)
    gradient = plain.evaluate("constraint_gradient", q, v)
    border = np.block([[plain.mass_matrix(q, v=v), -(gradient.T + b)], [gradient, np.zeros((2, 2))]])
    right = [*plain.evaluate("bias", q, v), *-plain.evaluate("constraint_bias", q, v)]
    expected = np.linalg.solve(border, right)
    result = [*model.accelerations(q, v), *model.multipliers(q, v)]
    # Both solve in doubles, by other eliminations of a matrix with a condition below 1e3.
    np.testing.assert_allclose(result, expected, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"forces": {x: -mu * abs(NORMAL)}}, "the force on x is not linear in lambda[floor]: give a coef"),
        (
            {"forces": {x: -mu * sqrt(NORMAL**2 + WALL**2)}, "constraints": {"floor": y, "wall": x - y}},
            "the force on x is not linear in lambda[floor] and lambda[wall]: give a coefficient in coordinates, "
            "velocities and parameters times a multiplier, such as -mu*lambda[floor]*sign(x.dot), and end",
        ),
        ({"forces": {x: lg.multiplier("flor")}}, "a force contains lambda[flor], but the constraint is floor."),
        ({"dissipation": NORMAL * x.dot**2}, "the dissipation contains lambda[floor], the multiplier of a constraint"),
        ({"forces": {y: -NORMAL}}, "the multipliers of incline are not determined: its constraints depend on"),
        ({"redundant": "allow"}, "the forces of incline contain multipliers, which redundant constraints"),
        (
            {"dimensions": {m: "mass", g: "m/s**2", x: "m", y: "m", mu: "1"}, "forces": {x: -mu * NORMAL * x.dot}},
            "the force on x",
        ),
    ],
)
def test_refusals(more: Any, words: str) -> None:
    assert refusal(incline, **more).startswith(words)


def test_forces_whose_multipliers_cancel_in_a_sum_are_seen() -> None:
    # With x = y the forces lambda/2 and -lambda/2 change the multiplier alone.
    pair = lg.System(
        x.dot**2 + y.dot**2 / 2,
        g * x,
        coordinates=[x, y],
        constraints={"bar": x - y},
        forces={x: lg.multiplier("bar") / 2, y: -lg.multiplier("bar") / 2},
        parameters={g: 3},
    )
    assert dict(pair.accelerations()) == {x: -g / 3, y: -g / 3}
    np.testing.assert_allclose(pair.compile("numpy").multipliers([0.0, 0.0], [0.0, 0.0]), [3 / 4.5])


def test_a_coordinate_without_inertia_follows_a_constraint() -> None:
    # lambda = x from the equation of y, so that 2 x'' = -y - lambda + lambda/2 = -3 x/2.
    bound = lg.System(x.dot**2, x * y, coordinates=[x, y], constraints={"floor": y - x}, forces={x: NORMAL / 2})
    model = bound.compile("numpy")
    np.testing.assert_allclose(model.accelerations([0.4, 0.4], [0.0, 0.0]), [-0.3, -0.3], rtol=1e-14)
    np.testing.assert_allclose(model.multipliers([0.4, 0.4], [0.0, 0.0]), [0.4], rtol=1e-14)


def test_a_coordinate_of_first_order_that_a_multiplier_pushes_is_refused() -> None:
    with pytest.raises(StatementError, match=r"the forces of system contain multipliers, and its mass matrix d2L"):
        lg.System(
            x.dot**2 + y.dot**2,
            coordinates=[x, y, z],
            constraints={"floor": y - x},
            forces={z: NORMAL},
            dissipation=z.dot**2,
        )


def chain_on_a_rough_rail(links: int) -> lg.System:
    """Return a cart on a rough rail with a chain of pendulums; its multiplier depends on all angles."""
    angles = lg.coordinates(" ".join(f"a_{i}" for i in range(1, links + 1)))
    place, kinetic, potential = (x, y), lg.kinetic_energy(m, (x, y)), lg.gravity(m, (x, y), g)
    for angle in angles:
        place = place[0] + sin(angle), place[1] - cos(angle)
        kinetic, potential = kinetic + lg.kinetic_energy(m, place), potential + lg.gravity(m, place, g)
    return lg.System(
        kinetic,
        potential,
        constraints={"floor": y},
        forces={x: -mu * NORMAL * sign(x.dot)},
        parameters={m: 1, g: 9.81, mu: 0.1},
        initial={x.dot: 3.0, **dict.fromkeys(angles, 0.3)},
        name="chain",
    )


def test_a_long_multiplier_is_no_obstacle_where_its_parts_are_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The multiplier of a chain of five has 21,512 operations without sharing, and was refused."""
    model = chain_on_a_rough_rail(5).compile("numpy", check=False)
    q, v = np.split(np.array(model.statement.initial), 2)
    assert model.evaluate("constraint_forces", q, v).ravel()[1] == pytest.approx(model.multipliers(q, v)[0])
    monkeypatch.setattr("lagrange.equations.regularity.MOST_WRITTEN_OPERATIONS", 100)
    with pytest.raises(StatementError, match=r"multipliers in the forces of chain have .* operations when written out"):
        chain_on_a_rough_rail(2)
