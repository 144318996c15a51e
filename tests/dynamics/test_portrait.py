"""Phase portraits: separatrices, kinds of equilibria, zero lines to rounding, closed orbits, angles."""

import re
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipk
from sympy import Eq, cos, pi, sign, sin

import lagrange as lg
from lagrange.dynamics import section
from lagrange.dynamics.axes import angles
from lagrange.dynamics.orbits import CLOSED, LINEAR_ERROR
from lagrange.dynamics.runs import Runs
from lagrange.dynamics.section import EnergyLevel
from tests.dynamics.planar import (
    damped_pendulum,
    driven_linear,
    duffing,
    escape,
    interrupting,
    pendulum,
    star,
    theta,
    van_der_pol,
    w,
    x,
    y,
)
from tests.models import shared_scene
from tests.refusals import refusal


def test_the_separatrix_of_the_pendulum_is_its_closed_form() -> None:
    """The separatrix is theta' = 2 cos(theta/2), and each branch ends at the other saddle, up to `LINEAR_ERROR`."""
    result = lg.phase_portrait(pendulum())
    assert [branch.stable for branch in result.separatrices].count(True) == 2
    assert len(result.separatrices) == 4
    for branch in result.separatrices:
        angles, rates = branch.orbit.states.T
        assert np.abs(np.abs(rates) - 2 * np.abs(np.cos(angles / 2))).max() <= LINEAR_ERROR * result.plane[1].width
        assert np.ptp(angles) == pytest.approx(2 * np.pi, abs=0.02)
    assert sorted(np.sign(branch.orbit.states[:, 1].mean()) for branch in result.separatrices) == [-1, -1, 1, 1]


@pytest.mark.slow
def test_a_separatrix_that_bends_at_its_saddle_is_on_the_level_of_its_energy() -> None:
    """In x^2/2 - x^3/3 the manifolds leave the eigenvectors in the second order: 1/3 = v^2 + x^2 - 2 x^3/3."""
    result = lg.phase_portrait(escape(), {x: (-0.8, 1.5), x.dot: (-1, 1)})
    assert len(result.separatrices) == 4
    for branch in result.separatrices:
        place, rate = branch.orbit.states.T
        # Beyond the saddle the motion runs away, and carries an offset along: it grows as the speed does.
        assert np.abs(rate**2 + place**2 - 2 * place**3 / 3 - 1 / 3).max() <= 20 * LINEAR_ERROR
        assert branch.distance < 0.01


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("potential", "force", "kind", "stable"),
    [
        (2 * x**2, 0, "centre", True),
        (2 * x**2, -0.1 * x.dot, "stable spiral", True),
        (2 * x**2, -9 * x.dot, "stable node", True),
        (-(x**2), -0.1 * x.dot, "saddle", False),
        (x**4 / 4, 0, "degenerate", None),
        (x**3 / 3, -0.1 * x.dot, "degenerate", None),
        (2 * x**2, -(x.dot**3), "linear centre", None),
    ],
)
def test_each_kind_of_equilibrium(potential: Any, force: Any, kind: str, stable: bool | None) -> None:
    system = lg.System(kinetic=x.dot**2 / 2, potential=potential, forces={x: force}, coordinates=[x])
    (place,) = lg.phase_portrait(system, {x: (-1, 2), x.dot: (-1, 1)}, starts=[{x: 0.5}], t_end=0.1).equilibria
    assert (place.kind, place.stable) == (kind, stable)
    # Where the force touches zero its place is known to the root of rounding.
    assert np.abs(place.state).max() <= (1e-6 if potential.has(x**3) else 0.0)


def test_equilibria_on_the_border_are_found_and_belong_together() -> None:
    result = lg.phase_portrait(damped_pendulum())
    assert [place.kind for place in result.equilibria] == ["saddle", "stable spiral", "saddle"]
    assert [place.state[0] for place in result.equilibria] == pytest.approx([-np.pi, 0, np.pi], abs=1e-15)
    assert {branch.saddle for branch in result.separatrices} == {0}
    arriving = [branch.orbit.states[-1, 0] for branch in result.separatrices if not branch.stable]
    assert np.abs((np.array(arriving) + np.pi) % (2 * np.pi) - np.pi).max() < 0.01


def test_zero_lines_are_zeros_to_rounding() -> None:
    """The zero lines of van der Pol's equation are v = 0 and (1 - x^2) v = x, which has two poles."""
    result = lg.phase_portrait(van_der_pol(), {x: (-3, 3), x.dot: (-4, 4)}, starts=[{x: 1.0}], t_end=0.1)
    (rest,) = result.nullclines["x"]
    assert np.abs(rest[:, 1]).max() == 0.0
    lines = result.nullclines["x_dot"]
    assert len(lines) == 3
    for place, rate in (line.T for line in lines):
        terms = np.abs(rate) + np.abs(place**2 * rate) + np.abs(place)
        assert (np.abs((1 - place**2) * rate - place) <= 8 * np.finfo(float).eps * terms).all()


def test_a_closed_orbit_has_the_period_of_the_pendulum_and_comes_back() -> None:
    result = lg.phase_portrait(pendulum(), starts=[{theta: 1.0}, {theta: 3.0}])
    for orbit, amplitude in zip(result.orbits, (1.0, 3.0), strict=True):
        assert orbit.closed
        assert orbit.t[-1] == pytest.approx(4 * ellipk(np.sin(amplitude / 2) ** 2), rel=1e-6)
        assert np.abs(orbit.states[-1] - orbit.states[0]).max() <= CLOSED * result.plane[1].width
        assert np.array_equal(orbit.at(orbit.t), orbit.states)


def test_an_orbit_runs_both_ways_until_it_leaves_the_window() -> None:
    result = lg.phase_portrait(van_der_pol(), {x: (-3, 3), x.dot: (-4, 4)}, starts=[{x: 2.5, x.dot: 2.0}])
    (orbit,) = result.orbits
    assert orbit.t[0] < 0 < orbit.t[-1]
    assert not orbit.closed
    assert np.all(np.diff(orbit.t) > 0)
    assert np.abs(orbit.states[:, 1]).max() == pytest.approx(4 * 1.04, rel=1e-3)
    assert orbit.at(np.array([0.0]))[0] == pytest.approx([2.5, 2.0], abs=1e-12)


@pytest.mark.slow
def test_dry_friction_has_a_window_of_its_speeds_and_no_linear_kind() -> None:
    """Steps of an oscillator with dry friction end at its turning points, where it is at rest."""
    result = lg.phase_portrait(lg.System(x.dot**2 / 2, x**2 / 2, forces={x: -sign(x.dot) / 10}, initial={x: 1}))
    assert 1.2 < result.plane[1].high < 1.8
    assert [(place.kind, place.stable) for place in result.equilibria] == [("degenerate", None)]
    moving = [orbit for orbit in result.orbits if orbit.t[-1] > 0]
    assert len(moving) == len(result.orbits) > 3


def test_a_slice_of_two_coordinates_holds_the_others_and_says_so() -> None:
    system = shared_scene("double-pendulum")
    held = {"theta2": 0.5, "theta2_dot": 0.1}
    result = lg.phase_portrait(system, {"theta1": (-3, 3, 5), "theta1_dot": (-8, 8, 4)}, at=held)
    assert result.u.shape == (4, 5)
    states = np.array([[q, 0.5, v, 0.1] for v in result.y for q in result.x]).T
    assert result.v.ravel() == pytest.approx(system.compile().rhs(0.0, states)[2])
    assert not result.equilibria
    assert "slice" in result.message
    assert all(orbit.t[0] == 0.0 for orbit in result.orbits)


def test_a_driven_system_is_shown_at_a_time_and_says_so() -> None:
    result = lg.phase_portrait(driven_linear(), {x: (-1, 1), x.dot: (-2, 2)}, t=0.3)
    place, rate = np.meshgrid(result.x, result.y)
    assert result.v == pytest.approx(-rate / 2 + np.cos(0.9) - 4 * place)
    assert "depends on time: the field is drawn at t = 0.3" in result.message
    assert result.orbits[0].t[0] == 0.3


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_forces_whose_products_are_beyond_all_doubles_have_their_equilibria() -> None:
    x, k = lg.coordinate("x"), lg.parameters("k")
    well = lg.System(x.dot**2 / 2, k * (x**4 / 4 - x**2 / 2), parameters={k: 1e200}, name="double well")
    result = lg.phase_portrait(well, {x: (-2, 2), x.dot: (-1e100, 1e100)}, starts=[{x: 0.5}])
    assert [(item.state[0], item.kind) for item in result.equilibria] == [(-1, "centre"), (0, "saddle"), (1, "centre")]


@pytest.mark.slow
def test_orbits_of_more_oscillations_than_a_picture_shows_end_and_that_is_said() -> None:
    x = lg.coordinate("x")
    driven = lg.System(x.dot**2 / 2, x**2 / 2, forces={x: cos(2 * lg.t)}, initial={x: 1}, name="driven")
    result = lg.phase_portrait(driven, starts=[{x: 0.1}], t_end=1e9)
    assert result.orbits[0].status is lg.Status.MAX_STEPS and "max_steps = 20000" in result.message
    assert result.orbits[0].t[-1] > 2 * np.pi * 1000
    few = lg.phase_portrait(driven, starts=[{x: 0.1}], t_end=1e9, max_steps=50)
    assert len(few.orbits[0].t) == 51
    by_step = lg.phase_portrait(driven, starts=[{x: 0.1}], t_end=2.1, method="rk4", step=1e-4)
    assert by_step.orbits[0].status is lg.Status.SUCCESS


def test_ctrl_c_keeps_what_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Runs, "__call__", interrupting(8)(Runs.__call__))
    result = lg.phase_portrait(pendulum(), {theta: (-np.pi, np.pi), theta.dot: (-3, 3)})
    assert result.status is lg.Status.INTERRUPTED
    assert (len(result.separatrices), len(result.orbits)) == (4, 4)
    assert result.message.startswith("interrupted after 4 orbits, which are kept.")
    assert result.x.size


def test_a_free_particle_rests_everywhere() -> None:
    result = lg.phase_portrait(lg.System(kinetic=x.dot**2 / 2), {x: (-1, 1), x.dot: (-1, 1)})
    assert not result.equilibria
    assert "Every place is an equilibrium" in result.message


@pytest.mark.parametrize(
    ("system", "arguments", "says"),
    [
        (star, {}, "has 2 coordinates, and 4 entries of its state are free.*at=\\{'y': 0, 'y_dot': 0\\}.*lg.poincare"),
        (star, {"at": {y: 0, y.dot: 0}}, "no window is given.*window=\\{'x': \\(-3, 3\\), 'x_dot': \\(-5, 5\\)\\}"),
        (star, {"at": {y: 0}}, "3 entries of its state are free"),
        (star, {"at": {y: 0, y.dot: 0}, "window": {x: (0, 1), y: (0, 1)}}, "window names x and y, but the entries of"),
        (pendulum, {"at": {theta: 0}}, "the argument at has a value for an entry of the state"),
        (pendulum, {"window": {theta: (-3, 3)}}, "window has 1 entry, and a picture has two axes"),
        (pendulum, {"window": {theta: 3, theta.dot: (-1, 1)}}, "the range of theta is 3: give \\(low, high\\)"),
        (pendulum, {"window": {theta: (-3, 3, 1), theta.dot: (-1, 1)}}, "number of values in the range of theta = 1"),
        (pendulum, {"window": {theta: (-3, 3), "theta": (-1, 1)}}, "window names theta twice"),
        (pendulum, {"at": {theta: 0}}, "pendulum has only two, and both are axes: leave at out"),
        (pendulum, {"starts": [{"phi": 1}]}, "start 0: initial names 'phi', which is not a coordinate"),
        (pendulum, {"starts": np.zeros((2, 3))}, "starts has shape \\(2, 3\\): give \\(m, 2\\).*theta theta_dot"),
        (pendulum, {"starts": [[np.nan, 0.0]]}, "starts has entries that are not finite"),
        (pendulum, {"t_end": -1.0}, "t_end = -1: give a positive time to follow orbits"),
    ],
)
def test_what_cannot_be_meant_is_refused(system: Any, arguments: dict[str, Any], says: str) -> None:
    assert re.search(says, refusal(lg.phase_portrait, system(), **arguments))


def test_constraints_and_what_is_no_system_are_refused() -> None:
    text: Any = "pendulum"
    assert "'pendulum' is not a system: give an lg" in refusal(lg.phase_portrait, text)
    held = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=cos(x), constraints=[Eq(x, y)])
    assert "has constraints, so a phase portrait cannot be drawn: remove them" in refusal(lg.phase_portrait, held)


# --- sections -------------------------------------------------------------------------------------------------
# Poincare sections: on the section, at the energy, against single runs and exact solutions; ends and refusals.


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


def test_the_border_is_around_all_points() -> None:
    result = galaxy(crossings=100)
    model = star().compile()
    (border,) = result.border
    states = np.array([[0.0, q, 0.0, v] for q, v in border]).T
    level = EnergyLevel(model, model.parameter_array(), 2, ENERGY)
    assert np.abs(level.margin(states)).max() < 1e-14
    assert (level.margin(result.points.T) > 0).all()


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
    assert "there is nothing to draw: no orbit passes" in refusal(result.plot)
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
        (star, x, {"energy": -1.0, "solve_for": x.dot}, "start 0 with x = 0, y = 0, y_dot = 0 has the energy 0 if"),
        (star, x, {"skip": -1}, "skip = -1"),
        (star, "x", {}, "the event is 'x', a text"),
        (duffing, 0.0, {}, "the period of the section = 0: give a positive time"),
        (duffing, -w, {}, "the period of the section = -1.2"),
        (duffing, cos(lg.parameters("q")), {}, "the period of the section is cos\\(q\\), an expression with symbols"),
    ],
)
def test_sections_that_cannot_be_meant_are_refused(system: Any, event: Any, more: dict[str, Any], says: str) -> None:
    assert re.search(says, refusal(lg.poincare, system(), event, **more))


# --- detection of angles among the coordinates, for pictures that wrap and for sliders of a full turn ----------


q = lg.coordinate("q")
free = (q.dot**2 + x.dot**2) / 2

CASES: dict[str, tuple[dict[str, Any], tuple[bool, bool]]] = {
    "a pendulum": ({"potential": -cos(q) + x**2}, (True, False)),
    "one on a torsion spring": ({"potential": -cos(q) + q**2}, (False, False)),
    "half an angle": ({"potential": -cos(q / 2)}, (False, False)),
    "a free one that is seen to turn": ({"positions": {"tip": (x + cos(q), sin(q))}}, (True, False)),
    "a free one": ({"positions": {"tip": (x, q)}}, (False, False)),
    "a wheel that turns as it rolls": (
        {"constraints": [x - q], "potential": x, "positions": {"tip": (x + cos(q), sin(q))}, "initial": {}},
        (False, False),
    ),
}


@pytest.mark.parametrize("what", CASES)
def test_a_turn_of_an_angle_changes_nothing(what: str) -> None:
    stated, result = CASES[what]
    assert angles(lg.System(kinetic=free, coordinates=[q, x], **stated).statement) == result
