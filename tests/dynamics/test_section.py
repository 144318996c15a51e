"""Poincare sections: on the section, at the energy, against single runs and exact solutions; ends and refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import cos, pi

import lagrange as lg
from lagrange.dynamics import section
from lagrange.dynamics.runs import Runs
from lagrange.dynamics.section import margin
from lagrange.errors import StatementError
from tests.dynamics.planar import driven_linear, duffing, interrupting, pendulum, star, theta, w, x, y

ENERGY = 1 / 8


def galaxy(**more: Any) -> Any:
    starts = [{y: 0.3}, {y.dot: 0.29}, {y: -0.1}]
    return lg.poincare(star(), lg.event(x, direction=1), starts, energy=ENERGY, solve_for=x.dot, **more)


def test_points_are_on_the_section_and_keep_the_energy() -> None:
    """The event is located to rounding, and the energy is kept as rtol = 1e-12 keeps it over 300 crossings."""
    result = galaxy(crossings=300)
    assert [len(states) for states in result.states] == [300, 300, 300]
    assert set(result.statuses) == {lg.Status.EVENT}
    assert result.status is lg.Status.SUCCESS
    place, other, rate, other_rate = result.points.T
    assert np.abs(place).max() < 1e-13
    assert rate.min() > 0
    energies = (rate**2 + other_rate**2 + other**2) / 2 - other**3 / 3
    assert np.abs(energies - ENERGY).max() < 1e-10
    assert result.drift == pytest.approx(np.abs(energies - ENERGY).max() / ENERGY, rel=0.1, abs=1e-14)
    assert result.axes == ("y", "y_dot")


def test_an_orbit_is_that_of_a_single_run() -> None:
    result = galaxy(crossings=40)
    alone = lg.integrate(
        star().compile(),
        (0.0, 300.0),
        {y: 0.3, x.dot: np.sqrt(2 * ENERGY - 0.09 + 2 * 0.027 / 3)},
        rtol=1e-12,
        events=[lg.event(x, direction=1, terminal=40)],
    )
    # The orbit is regular: differences of rounding grow in proportion to time.
    assert result.times[0] == pytest.approx(alone.t_events[0], abs=1e-8)
    assert result.states[0] == pytest.approx(alone.y_events[0], abs=1e-8)


def test_the_border_is_around_all_points() -> None:
    result = galaxy(crossings=100)
    model = star().compile()
    (border,) = result.border
    states = np.array([[0.0, q, 0.0, v] for q, v in border]).T
    assert np.abs(margin(model, model.parameter_array(), states, 2, ENERGY)).max() < 1e-14
    assert (margin(model, model.parameter_array(), result.points.T, 2, ENERGY) > 0).all()


def test_the_velocity_of_an_energy_goes_with_the_direction_of_the_event() -> None:
    for direction in (1, -1):
        event = lg.event(x, direction=direction)
        result = lg.poincare(star(), event, [{y: 0.1}], energy=ENERGY, solve_for="x_dot", crossings=1)
        assert result.starts[0, 2] == pytest.approx(direction * np.sqrt(2 * ENERGY - 0.01 + 2e-3 / 3), rel=1e-14)


def test_an_energy_that_is_not_quadratic_in_the_velocity_is_met() -> None:
    """The energy is that of a relativistic particle, 1/sqrt(1 - v^2)."""
    free = lg.System(lagrangian=-((1 - x.dot**2) ** 0.5) - x**2 / 2, coordinates=[x])
    result = lg.poincare(free, x, [{x: 0.2, x.dot: 0.1}], energy=1.5, solve_for=x.dot, crossings=1)
    assert 1 / np.sqrt(1 - result.starts[0, 1] ** 2) + 0.02 == pytest.approx(1.5, rel=1e-10)


def test_a_driven_oscillator_is_met_after_each_period() -> None:
    """The motion of x'' + x'/2 + 4 x = cos(3 t) tends to x = A cos(3 t) + B sin(3 t)."""
    result = lg.poincare(driven_linear(), 2 * pi / 3, [{x: 1.0}, {x.dot: 2.0}], crossings=5, skip=30)
    assert result.period == pytest.approx(2 * np.pi / 3)
    assert result.times[0] == pytest.approx(2 * np.pi / 3 * np.arange(31, 36))
    a, b = np.linalg.solve([[4 - 9, 1.5], [-1.5, 4 - 9]], [1.0, 0.0])
    for states in result.states:
        # After 31 periods e^(-t/4) has left 1e-7 of the start.
        assert states == pytest.approx(np.broadcast_to([a, 3 * b], (5, 2)), abs=1e-6)


def test_a_period_may_be_an_expression_in_parameters() -> None:
    result = lg.poincare(duffing(), 2 * pi / w, crossings=2, parameters={w: 2.0})
    assert result.times[0] == pytest.approx([np.pi, 2 * np.pi])


def test_an_orbit_goes_on_in_several_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = galaxy(crossings=40)
    monkeypatch.setattr(section, "CROSSINGS_PER_RUN", 7)
    parts = galaxy(crossings=40)
    assert [len(times) for times in parts.times] == [40, 40, 40]
    assert parts.times[0] == pytest.approx(whole.times[0], abs=1e-8)
    assert parts.states[1] == pytest.approx(whole.states[1], abs=1e-7)


def test_a_section_that_is_never_met_is_said_so() -> None:
    result = lg.poincare(pendulum(), theta - 3, [{theta: 1.0}, {theta: 0.5}])
    assert [len(times) for times in result.times] == [0, 0]
    assert result.statuses == (lg.Status.SUCCESS, lg.Status.SUCCESS)
    assert "no orbit passes theta - 3 = 0. Start 0: passed the section 0 times, and not again between" in result.message
    assert "longest=..." in result.message
    assert "theta - 3 = 0" in repr(result).splitlines()[1]
    with pytest.raises(StatementError, match="there is nothing to draw: no orbit passes"):
        result.plot()
    assert "there is nothing to draw" in result._repr_html_()


def test_a_run_that_fails_keeps_its_crossings() -> None:
    """The solution of x'' = 6 x^2 becomes infinite at a finite time."""
    falling = lg.System(kinetic=x.dot**2 / 2, potential=-2 * x**3)
    result = lg.poincare(falling, x, [{x: -1.0, x.dot: 3.0}], crossings=5)
    assert len(result.times[0]) == 1
    assert result.status not in (lg.Status.SUCCESS, lg.Status.INTERRUPTED)
    assert result.message.startswith("1 crossing of 1 orbit. Start 0: ")


def test_ctrl_c_keeps_the_orbits_that_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Runs, "__call__", interrupting(2)(Runs.__call__))
    result = galaxy(crossings=10)
    assert result.status is lg.Status.INTERRUPTED
    assert len(result.points) == 20
    assert result.message == "interrupted: 20 crossings of 3 among 3 orbits were computed and are kept."


@pytest.mark.parametrize(
    ("system", "event", "more", "says"),
    [
        (star, x, {"energy": 1.0}, "give energy and solve_for together"),
        (star, x, {"energy": 1.0, "solve_for": x}, "solve_for is the coordinate x: give a velocity"),
        (star, x, {"energy": 1.0, "solve_for": "xdot"}, "solve_for names 'xdot'.*Did you mean 'x_dot'"),
        (
            star,
            x,
            {"energy": -1.0, "solve_for": x.dot},
            "start 0 with x = 0, y = 0, y_dot = 0 has the energy 0 if x_dot is zero",
        ),
        (star, x, {"crossings": 0}, "crossings = 0: give a whole number from 1 to 100000000"),
        (star, x, {"skip": -1}, "skip = -1"),
        (star, x, {"starts": [{"z": 1}]}, "start 0: initial names 'z'"),
        (star, "x", {}, "the event is 'x', a text"),
        (star, theta, {}, "contains theta"),
        (duffing, 0.0, {}, "the period of the section = 0: give a positive time"),
        (duffing, -w, {}, "the period of the section = -1.2"),
        (duffing, cos(lg.parameters("q")), {}, "the period of the section is cos\\(q\\), an expression with symbols"),
    ],
)
def test_what_cannot_be_meant_is_refused(system: Any, event: Any, more: dict[str, Any], says: str) -> None:
    with pytest.raises(StatementError, match=says):
        lg.poincare(system(), event, **more)
