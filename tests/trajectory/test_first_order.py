"""Lagrangians that are linear in velocities: their equations of motion are of first order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from sympy import cos, sin

import lagrange as lg
from lagrange.errors import StatementError
from tests.models import LLVM_FIRST, B, k, m, x, y, z
from tests.refusals import refusal

METHODS = ("taylor", "dop853", "radau5")


def charge(**options: Any) -> lg.System:
    """Return a massless charge in a magnetic field and a quadratic potential, which circles at the rate k/B."""
    return lg.System(
        lagrangian=B * (x * y.dot - y * x.dot) / 2 - k * (x**2 + y**2) / 2,
        coordinates=[x, y],
        parameters={B: 2.0, k: 3.0},
        **{"initial": {x: 1.0}, **options},
    )


@pytest.mark.parametrize("target", LLVM_FIRST)
@pytest.mark.parametrize("method", METHODS)
def test_a_charge_without_mass_goes_round_its_bowl(method: str, target: str) -> None:
    solution = charge().run(5.0, method=method, target=target, rtol=1e-10)
    angle = 1.5 * solution.t
    assert solution.status is lg.Status.SUCCESS and "moved" not in solution.message
    assert solution[x] == pytest.approx(np.cos(angle), abs=1e-8)
    assert solution[y] == pytest.approx(np.sin(angle), abs=1e-8)
    assert solution[y.dot] == pytest.approx(1.5 * np.cos(angle), abs=1e-7)


def test_a_jacobian_knows_that_a_velocity_of_first_order_follows_from_the_state() -> None:
    """The damping of y depends on x, so that the rate of its equation contains y.dot. Beside the relation as on it."""
    system = lg.System(
        lagrangian=m * x.dot**2 / 2 - k * (x**2 + x * y + y**4) / 2,
        coordinates=[x, y],
        forces={y: x.dot * sin(y)},
        dissipation=y.dot**2 * (2 + cos(x)) / 2,
        parameters={m: 1.3, k: 0.7},
    )
    model, state, h = system.compile("numpy", check=False), np.array([0.5, 0.7, 0.35, -1.1]), 1e-6
    expected = np.transpose([(model.rhs(0, state + h * e) - model.rhs(0, state - h * e)) / (2 * h) for e in np.eye(4)])
    # Central differences have an error of h**2 and of the rounding 1e-16/h.
    assert model.jacobian(0, state) == pytest.approx(expected, abs=1e-9)


def test_velocities_are_found_from_positions_or_must_agree() -> None:
    system = charge()
    assert system.run(1.0, {y.dot: 1.5}).y[3, 0] == 1.5
    assert system.run(1.0, {y.dot: 1.5 + 1e-8}).y[3, 0] == pytest.approx(1.5, abs=1e-12)
    text = refusal(system.run, 1.0, {y.dot: 2.0})
    assert "the initial velocities do not satisfy the constraint at t = 0: 'equation of x' (B*y_dot - k*x) is 1" in text
    assert "leave out the velocities of coordinates without inertia, which follow, or" in text
    result = system.consistent({x: 2.0})
    assert result.initial[x] == 2.0 and result.initial[y.dot] == pytest.approx(3.0) and result.entry == y.dot
    flow = lg.flow(system.compile())
    assert flow([1.0, 0.0, 0.0, 0.0], 0.0, 1.0)[:2] == pytest.approx([np.cos(1.5), np.sin(1.5)], abs=1e-8)


def test_equations_that_leave_velocities_open_are_refused() -> None:
    odd = x * y.dot + y * z.dot + z * x.dot
    for potential in (x**2 + y**2 + z**2, x):
        text = refusal(lg.System, lagrangian=odd - potential, coordinates=[x, y, z])
    assert text.startswith("x, y and z have no inertia, and their equations of first order leave velocities open at")
    assert "Add the kinetic energy that is missing" in text


def test_a_state_at_which_velocities_are_open_is_refused() -> None:
    fold = lg.System(lagrangian=x**2 * y.dot - y**2 - x**2, coordinates=[x, y])
    text = refusal(fold.run, 1.0, {y: 1.0})
    assert text.startswith(
        "the velocities of x and y, without inertia, are not determined at the initial state (x = 0, y = 1, x.dot = 0"
    )
    solution = fold.run(9.0, {x: 1.0, y: 1.0})
    assert solution.status is lg.Status.SINGULAR and solution.t[-1] == pytest.approx(np.sqrt(2.0) - 1.0)
    assert "x has no inertia, and its equation of first order leaves velocities open there, at x = " in solution.message


def test_a_coordinate_in_a_potential_alone_is_still_refused() -> None:
    text = refusal(lg.System, lagrangian=m * x.dot**2 / 2 - k * (x - y) ** 2, coordinates=[x, y])
    assert "does not contain y.dot, so y has no inertia" in text
    text = refusal(lg.System, lagrangian=m * x.dot**2 / 2 - x.dot * sin(y) + cos(x), coordinates=[x, y])
    assert "no term of second order in y.dot" in text


# --- states with a rate and no inertia: the rate is the force, and Rayleigh's function has half of its square ---


def test_a_force_and_a_constraint_state_the_same_lorenz_system() -> None:
    rates = {x: 10 * (y - x), y: x * (28 - z) - y, z: x * y - 8 * z / 3}
    drag = (x.dot**2 + y.dot**2 + z.dot**2) / 2
    start = {x: 1.0, y: 1.0, z: 1.0}
    by_force = lg.System(kinetic=0, coordinates=[x, y, z], forces=rates, dissipation=drag, initial=start)
    held = [q.dot - rate for q, rate in rates.items()]
    by_constraint = lg.System(kinetic=0, coordinates=[x, y, z], constraints=held, initial=start)

    def by_hand(_: float, s: Any) -> list[float]:
        return [10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 * s[2] / 3]

    expected = solve_ivp(by_hand, (0, 2), [1.0, 1.0, 1.0], method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    # Errors of 1e-13 grow by less than 1e4 in this time.
    assert by_force.run(2.0, rtol=1e-12).y[:3, -1] == pytest.approx(expected, abs=1e-8)
    start_on = by_constraint.consistent().initial
    assert by_constraint.run(2.0, start_on, rtol=1e-12).y[:3, -1] == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("given", [{"forces": {y: 1 - y}}, {"kinetic": m, "dissipation": k * y.dot**2 / 2}])
def test_the_refusal_says_how_to_state_them(given: dict[Any, Any]) -> None:
    with pytest.raises(StatementError, match=r"force on it and y\.dot\*\*2/2 as dissipation") as raised:
        lg.System(**{"kinetic": 0, "coordinates": [y], **given})
    assert len(str(raised.value)) <= 400
