"""Runs of systems with constraints: every method follows the motion, or refuses the system with a message."""

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import Abs, cos, sin, sqrt

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.trajectory.constraints.consistent import violation
from lagrange.trajectory.ending_messages import UNPROJECTED
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.runge_kutta import RungeKutta
from tests.mechanisms.formulation import SEEDS, compiled
from tests.models import LLVM_FIRST, TARGETS, g, l, m, phi, shared_scene, theta, x, y, z
from tests.refusals import refusal
from tests.systems import rod_pendulum
from tests.trajectory.runs import ADAPTIVE, FIXED, NAMES, OUTSIDE, SPLITTINGS, UNCONSTRAINED

PROJECTED = tuple(name for name in NAMES if name not in (*UNCONSTRAINED, *SPLITTINGS))
"""The methods that run every system with constraints."""

ROUNDED = 1e-14
"""Relative violations of projected states. The largest of all tests below is 2e-15: the rounding of the coordinates."""


@cache
def reference(t: float) -> FloatArray:
    """Return x and y of the scene's pendulum, integrated in its angle."""
    theta, _ = shared_scene("pendulum").run(t, method="taylor", rtol=1e-14).y[:, -1]
    return np.array([np.sin(theta), -np.cos(theta)])


def error(name: str, t: float = 1.0, **options: Any) -> tuple[float, float]:
    """Return the error of a method on the pendulum in Cartesian coordinates, and the error of the constraint."""
    solution = shared_scene("cartesian-pendulum").run(t, method=name, **options).require()
    return float(np.abs(solution.y[:2, -1] - reference(t)).max()), float(solution.constraint_error.max())


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [name for name in PROJECTED if name in FIXED])
def test_a_method_with_fixed_steps_keeps_its_order_on_the_constraints(name: str) -> None:
    """Half the step size reduces the error by 2**-order, or the error is at round-off."""
    (coarse, first), (fine, second) = (error(name, step=step) for step in (0.01, 0.005))
    assert fine < coarse * 0.5 ** (find(name).claims.order - 0.5) or fine < 1e-12
    assert max(first, second) < ROUNDED


@pytest.mark.few
@pytest.mark.parametrize("name", [name for name in PROJECTED if name in ADAPTIVE])
def test_a_method_with_step_control_follows_the_angle_to_its_tolerance(name: str) -> None:
    """The error of a run is at most 20 tolerances (radau3); 100 are allowed."""
    for rtol in (1e-6, 1e-9):
        far, off = error(name, rtol=rtol)
        assert far < 100 * rtol
        assert off < ROUNDED


@pytest.mark.parametrize("name", OUTSIDE)
def test_solvers_of_other_packages_drift_by_some_tolerances_and_say_so(name: str) -> None:
    """They integrate the equations with the constraints differentiated twice, without projection."""
    far, off = error(name, rtol=1e-8)
    assert far < 1e-6
    assert ROUNDED < off < 1e-6


@pytest.mark.parametrize("name", [*UNCONSTRAINED, *SPLITTINGS])
def test_a_method_that_leaves_out_forces_of_constraints_is_refused(name: str) -> None:
    words = r"the forces of its constraints depend on velocities" if name in SPLITTINGS else "constraints .*: use "
    r"rattle"
    assert re.search(f"{name} .*{words}", refusal(error, name, step=0.01))


@pytest.mark.few(2)
@pytest.mark.parametrize("name", SPLITTINGS)
def test_a_splitting_runs_where_constraints_are_linear(name: str) -> None:
    """Two masses on a line with a rod and a spring: each part of a splitting step satisfies x - y + l = 0."""
    x, y = lg.coordinates("x y")
    system = lg.System(
        kinetic=x.dot**2 + y.dot**2 / 2, potential=x**4 + y**2, constraints={"rod": x - y + 1}, initial={x: 0.5, y: 1.5}
    )
    want = system.run(2.0, rtol=1e-13).y[:, -1]
    coarse, fine = (system.run(2.0, method=name, step=step) for step in (0.02, 0.01))
    far, near = (np.abs(item.y[:, -1] - want).max() for item in (coarse, fine))
    assert near < far * 0.5 ** (find(name).claims.order - 0.5) or near < 1e-12
    assert coarse.constraint_error.max() < ROUNDED


@pytest.mark.few(1)
@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("seed", SEEDS)
def test_random_mechanisms_stay_on_their_constraints(seed: int, target: str) -> None:
    """Positions and velocities satisfy rods, moving pivots and knife edges, with each kind of loop."""
    model = compiled(seed, target)
    for name in ("taylor", "dop853", "rk4", "radau5", "bdf2", "gauss2"):
        options: Any = {"step": 0.01} if name in FIXED else {"rtol": 1e-6}
        solution = lg.integrate(model, (0.0, 0.5), method=name, **options).require()
        assert solution.steps > 2
        assert solution.constraint_error.max() < ROUNDED


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["rk4", "bs3", "dopri5", "tsit5", "verner9", "dop853"])
@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_each_step_is_that_of_the_method_from_the_projected_state_and_then_projected(name: str, target: str) -> None:
    """A method that reuses its last slope must use the slope at the projected state."""
    model = shared_scene("cartesian-double-pendulum").compile(target)
    method = find(name)
    assert isinstance(method, RungeKutta)
    options: Any = {"step": 0.05} if name in FIXED else {"rtol": 1e-4}
    solution = lg.integrate(model, (0.0, 2.0), method=name, **options).require()
    parameters = model.parameter_array()
    rhs, corrections = model.kernel("rhs"), model.law("projection")

    def f(t: float, y: FloatArray) -> FloatArray:
        return rhs(t, y, parameters)

    moved = 0.0
    states = solution.y.T
    for t, h, before, after in zip(solution.t[:-1], np.diff(solution.t), states[:-1], states[1:], strict=True):
        result = method.program.function(f, t, before, h)
        state = np.array(result if method.program.control is None else result[0])
        for _ in range(3):
            move = corrections(t + h, state, parameters)[:-2]
            state, moved = state + move, max(moved, float(np.abs(move).max()))
        # Rounding of a step, and of its projection: a stale slope is off by 1e-7 and more.
        assert np.abs(state - after).max() < 1e-12
    assert moved > 1e-7


@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_a_state_too_far_away_to_be_projected_ends_the_run_in_words(target: str) -> None:
    system = shared_scene("cartesian-double-pendulum")
    solution = system.run(50.0, method="rk4", step=2.5, target=target)
    assert solution.status is lg.Status.DIVERGED
    assert UNPROJECTED in solution.message
    assert "shorter step" in solution.message
    assert np.isfinite(solution.y).all()


@pytest.mark.parametrize(
    ("name", "words"),
    [("galerkin4", "finds velocities from momenta, .* of first order"), ("verlet", "equations are of first order")],
)
def test_equations_of_first_order_are_refused_as_such(name: str, words: str) -> None:
    """Internally such equations are constraints on velocities, but the user has not stated constraints."""
    x, y = lg.coordinates("x y")
    charge = lg.System(lagrangian=x * y.dot - y * x.dot - x**2 - y**2, initial={x: 1.0})
    assert re.search(words, refusal(charge.run, 1.0, method=name, step=0.1))
    solution = charge.run(5.0, rtol=1e-12)
    assert solution.card()["constraints"] is None
    assert np.hypot(*solution.y[:2]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.few(1)
@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("method", ["taylor", "dop853", "tsit5", "bs3", "verner9", "radau3", "radau5", "radau5-index2"])
def test_a_change_that_a_step_passes_over_is_no_error_to_be_projected_away(method: str, target: str) -> None:
    """The speed must be 1.5 + tanh(100 (t - 1)) / 2, which changes only during a hundredth of a second.

    With a step over this time, projection would correct the speed only afterwards: x(3) = 4 instead of 5.
    """
    x, y = lg.coordinates("x y")
    belt = lg.System(
        (x.dot**2 + y.dot**2) / 2,
        constraints={"belt": x.dot - sp.Rational(3, 2) - sp.tanh(100 * (lg.t - 1)) / 2},
        initial={x.dot: 1.0},
    )
    run = belt.run(3.0, method=method, target=target, check=False)
    assert run.status is lg.Status.SUCCESS
    # 1000 tolerances of rtol = 1e-9.
    assert run[x][-1] == pytest.approx(5.0, abs=1e-6)


# --- resets ---------------------------------------------------------------------------------------------------
# Resets under constraints: the state behind one is held to them, as an initial state is.

METHODS: list[tuple[str, dict[str, Any]]] = [
    ("taylor", {}), ("dop853", {}), ("rk4", {"step": 0.01}), ("rattle", {"step": 0.01}), ("radau5-index2", {}),
    ("scipy-lsoda", {}),
]  # fmt: skip


def run(end: float, *events: lg.Event, **options: Any) -> lg.Solution:
    return rod_pendulum().run(end, events=events, **options)


OFF = [
    (
        lg.event(x, direction=-1, reset={y: -0.9}),
        "The reset where x is zero violates the constraints: 'rod' (-l**2 + x**2 + y**2) is -0.19",
    ),
    (
        lg.event(x + 0.3, direction=-1, reset={x.dot: -x.dot}),
        "'rod' (the rate of change of -l**2 + x**2 + y**2) is -1.98",
    ),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("method", "options"), METHODS)
def test_a_reset_off_the_constraint_ends_the_run(method: str, options: dict[str, Any]) -> None:
    for event, words in OFF:
        result = run(3.0, event, method=method, **options)
        assert result.status is lg.Status.DIVERGED
        assert result.t[-1] == result.t_events[0][0] > 0.5
        assert np.abs(result.constraint_error).max() < 1e-6
        assert words in result.message and "Reset velocities only" in result.message


@pytest.mark.few(2)
@pytest.mark.parametrize(("method", "options"), METHODS)
def test_a_reset_that_satisfies_the_constraint_goes_on(method: str, options: dict[str, Any]) -> None:
    """A reset at x = -0.3 reverses the velocity and keeps the energy, up to the error of the dense output."""
    back = lg.event(x + 0.3, direction=-1, reset={x.dot: -x.dot, y.dot: -y.dot})
    result = run(3.0, back, method=method, **options).require()
    assert len(result.t_events[0]) > 1
    assert result.y[0].min() > -0.301


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_reset_off_by_rounding_is_projected(method: str) -> None:
    result = run(3.0, lg.event(x, direction=-1, reset={x.dot: -x.dot, y: y * (1 + 1e-8)}), method=method).require()
    assert result.constraint_error.max() < (1e-13 if method == "taylor" else 1e-7)


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_velocities_without_inertia_follow_behind_a_reset(method: str) -> None:
    """L = (x y.dot - y x.dot)/2 - (x^2 + y^2)/2 rotates with rate 1; the reset halves the radius."""
    turning = lg.System(lagrangian=(x * y.dot - y * x.dot) / 2 - (x**2 + y**2) / 2, initial={x: 1, y: 0})
    result = turning.run(4.0, events=[lg.event(y, direction=-1, reset={x: x / 2})], method=method).require()
    assert result.t_events[0] == pytest.approx([np.pi], abs=1e-7)
    assert result.y[:2, -1] == pytest.approx([np.cos(4.0) / 2, np.sin(4.0) / 2], abs=1e-7)


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_run_may_end_behind_a_reset_where_all_terms_are_round_off(method: str) -> None:
    """At x = 0 both terms of x x.dot + y y.dot are round-off, before and after the reset."""
    result = run(3.0, lg.event(x, direction=-1, terminal=True, reset={x.dot: -x.dot}), method=method)
    assert result.status is lg.Status.EVENT


# --- redundant constraints ------------------------------------------------------------------------------------
# Redundant constraints with redundant='allow': right accelerations, forces of least norm, and refusals.


ROD = x**2 + y**2 - l**2
LENGTH = {m: 1.3, g: 9.81, l: 1.0}


def pendulum(constraints: Any, **options: Any) -> lg.System:
    return rod_pendulum(constraints=constraints, parameters=LENGTH, **options)


ALONE = pendulum({"rod": ROD})
TWICE = pendulum({"rod": ROD, "twice": 2 * ROD, "rate": x * x.dot + y * y.dot}, redundant="allow")


@pytest.mark.few(1)
@pytest.mark.parametrize("target", LLVM_FIRST)
@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_the_motion_is_that_of_independent_constraints(method: str, target: str) -> None:
    result, expected = (system.run(3.0, method=method, target=target) for system in (TWICE, ALONE))
    assert result.status is lg.Status.SUCCESS
    assert result.y[:, -1] == pytest.approx(expected.y[:, -1], abs=1e-8)


@pytest.mark.parametrize("target", TARGETS)
def test_the_multipliers_have_the_least_norm(target: str) -> None:
    """The constraints are 2, 4 and 1 times the same row, and so are their shares of the force."""
    model, q, v = TWICE.compile(target), [0.6, -0.8], [0.3, 0.225]
    tension = ALONE.compile(target).multipliers(q, v)[0]
    assert model.multipliers(q, v) == pytest.approx(2 * tension * np.array([2.0, 4.0, 1.0]) / 21, rel=1e-12)
    forces = model.kernel("constraint_forces")(0.0, np.array([*q, *v]), model.parameter_array())
    assert forces.shape == (3, 2) and forces.sum(axis=0) == pytest.approx(2 * tension * np.array(q), rel=1e-12)
    solution = TWICE.run(0.1)
    assert solution.multipliers["twice"] == pytest.approx(2 * solution.multipliers["rod"], rel=1e-12)


@pytest.mark.slow
def test_constraints_that_follow_only_where_all_hold() -> None:
    """A table on three parallel cranks, of which two suffice. The six constraints are dependent only where all hold."""
    a1, a2, a3 = cranks = lg.coordinates("a1 a2 a3")
    held: dict[str, Any] = {}
    for i, (a, d, e) in enumerate(zip(cranks, (-1.0, 0.5, 0.0), (0.0, 0.0, 1.0), strict=True)):
        held[f"x{i}"] = x + d * cos(phi) - e * sin(phi) - d - cos(a)
        held[f"y{i}"] = y + d * sin(phi) + e * cos(phi) - e - sin(a)
    table: dict[str, Any] = {
        "kinetic": (x.dot**2 + y.dot**2 + phi.dot**2 + a1.dot**2 + a2.dot**2 + a3.dot**2) / 2,
        "potential": 9.81 * y,
        "coordinates": [x, y, phi, *cranks],
        "constraints": held,
        "initial": {x: float(cos(0.7)), y: float(sin(0.7)), **dict.fromkeys(cranks, 0.7)},
    }
    with pytest.raises(StatementError, match=r"are dependent here: .* or state the system with redundant='allow'"):
        lg.System(**table).run(0.5, check=False)
    free = lg.System(**table, redundant="allow")
    start = free.consistent({a1.dot: 3.0, a2.dot: 3.0, a3.dot: 3.0}).initial
    turn = lg.coordinate("turn")
    swing = lg.System(kinetic=2 * turn.dot**2, potential=9.81 * sin(turn))
    result, expected = free.run(0.5, start), swing.run(0.5, {turn: 0.7, turn.dot: start[a1.dot]})
    assert result.y[:6, -1] == pytest.approx(
        [np.cos(expected.y[0, -1]), np.sin(expected.y[0, -1]), 0.0, *[expected.y[0, -1]] * 3], abs=1e-8
    )


def test_more_constraints_than_coordinates_may_follow_from_one_another() -> None:
    assert "3 constraints" in refusal(pendulum, [ROD, 2 * ROD, 3 * ROD])
    assert pendulum([ROD, 2 * ROD, 3 * ROD], redundant="allow").run(0.1).status is lg.Status.SUCCESS


def test_all_of_them_must_hold_at_the_start() -> None:
    assert re.search(r"'twice' .* is -0\.22", refusal(TWICE.run, 1.0, {x: 0.5}))
    with pytest.raises(StatementError, match="no state was found that satisfies the constraints 'a' and 'b' together"):
        pendulum({"a": x - 1, "b": x - 2}, redundant="allow")


# --- initial states on the constraints: the nearest one, the note about a moved state, and refusals ------------


def particle(constraint: Any = None, **options: Any) -> lg.System:
    """Return a pendulum in Cartesian coordinates, or the same particle on another constraint."""
    rod = {} if constraint is None else {"constraints": {"rod": constraint}}
    return rod_pendulum(parameters=LENGTH, **rod, **options)


def test_the_nearest_point_of_a_circle_is_in_line_with_its_centre() -> None:
    result = particle().consistent({x: 0.9, y: -1.2, x.dot: 1.0})
    assert list(result.initial) == [x, y, x.dot, y.dot]
    # On the circle along the radius; of the velocity (1, 0) the part along the tangent (0.8, 0.6) is left.
    assert result.initial[x] == pytest.approx(0.6, abs=1e-9) and result.initial[y] == pytest.approx(-0.8, abs=1e-9)
    assert result.initial[x.dot] == pytest.approx(0.64, abs=1e-9)
    assert result.initial[y.dot] == pytest.approx(0.48, abs=1e-9)
    assert result.entry == y.dot and result.moved == pytest.approx(0.48, abs=1e-9)
    assert result.changes[x] == pytest.approx(-0.3, abs=1e-9)
    assert "moved by at most 0.48, in y.dot>" in repr(result)


def test_what_is_held_stays() -> None:
    result = particle().consistent({x: 0.7, y: -0.9, x.dot: 1.0}, hold=[x, "x_dot"]).initial
    assert result[x] == 0.7 and result[x.dot] == 1.0
    assert result[y] == pytest.approx(-sqrt(1 - 0.49), abs=1e-12)
    assert result[x] * result[x.dot] + result[y] * result[y.dot] == pytest.approx(0.0, abs=1e-12)


def test_a_state_on_the_constraints_stays_as_it_is() -> None:
    result = particle().consistent()
    assert result.moved == 0.0 and result.entry is None and result.initial == {x: 0.6, y: -0.8, x.dot: 0.0, y.dot: 0.0}
    assert repr(result).endswith("nothing moved>")


def test_a_velocity_constraint_moves_velocities_alone() -> None:
    knife = lg.System(
        kinetic=(x.dot**2 + y.dot**2 + theta.dot**2) / 2,
        coordinates=[x, y, theta],
        constraints={"blade": sin(theta) * x.dot - cos(theta) * y.dot},
    )
    result = knife.consistent({theta: 0.3, x.dot: 1.0}).initial
    assert (result[x], result[y], result[theta], result[theta.dot]) == (0.0, 0.0, 0.3, 0.0)
    assert np.tan(0.3) * result[x.dot] == pytest.approx(result[y.dot], abs=1e-12)


def test_a_singular_mass_matrix_that_is_definite_on_the_surface() -> None:
    system = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2, potential=x, coordinates=[x, y, z], constraints={"height": z - x * y}
    )
    result = system.consistent({x: 2.0, y: 3.0, z: 5.0, x.dot: 1.0}).initial
    # z has no inertia: its change costs nothing, and it alone moves.
    assert (result[x], result[y]) == pytest.approx((2.0, 3.0), abs=1e-9) and result[z] == pytest.approx(6.0, abs=1e-9)
    assert result[z.dot] == pytest.approx(3.0, abs=1e-9)


@pytest.mark.parametrize("target", ["numpy", "llvm"])
def test_a_run_moves_what_rounding_left_and_says_it(target: str) -> None:
    given = {x: 0.70710678, y: -0.70710678}
    solution = particle().run(0.1, given, target=target, check=False)
    assert solution.y[0, 0] ** 2 + solution.y[1, 0] ** 2 == pytest.approx(1.0, abs=1e-15)
    assert "The initial state was moved onto the constraints, by at most 1.2e-09, in x." in solution.message
    exact = particle().run(0.1, target=target, check=False)
    assert "moved" not in exact.message and exact.y[:, 0].tolist() == [0.6, -0.8, 0.0, 0.0]


def test_round_off_is_not_moved() -> None:
    angle = 2.0
    state = {x: np.cos(angle), y: np.sin(angle), x.dot: -3 * np.sin(angle), y.dot: 3 * np.cos(angle)}
    solution = particle().run(0.1, state, check=False)
    assert solution.y[:, 0].tolist() == list(state.values()) and "moved" not in solution.message
    lying = particle(y).run(0.1, {x: 1.0, y: 1e-17}, check=False)
    assert lying.y[1, 0] == 1e-17 and "moved" not in lying.message


def test_the_flow_moves_and_refuses_as_a_run_does() -> None:
    flow = lg.flow(particle().compile(check=False))
    near, exact = np.array([0.6, -0.8 + 1e-9, 0.0, 0.0]), np.array([0.6, -0.8, 0.0, 0.0])
    assert flow(near, 0.0, 0.1) == pytest.approx(flow(exact, 0.0, 0.1), abs=1e-8)
    at_once = flow(near, 0.0, 0.0)
    assert at_once[0] ** 2 + at_once[1] ** 2 == pytest.approx(1.0, abs=1e-15)
    assert "'rod'" in refusal(flow, np.array([0.6, -0.7, 0.0, 0.0]), 0.0, 0.1)


def started(constraint: Any, initial: Any) -> str:
    """Return the message that refuses a run of a particle on a constraint."""
    return refusal(particle(constraint).run, 1.0, initial, check=False)


KNIFE = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, constraints={"blade": x.dot - 2 * y.dot})
THREE = lg.System(kinetic=(x.dot**2 + y.dot**2 + z.dot**2) / 2, constraints={"a": x - 1, "b": y - z, "c": z})
HEAVY = lg.System(kinetic=x.dot**2 / x + y.dot**2, coordinates=[x, y], constraints={"line": x - y})
REFUSED: list[tuple[Callable[[], str], tuple[str, ...]]] = [
    (
        lambda: started(None, {x: 0.7, y: -0.7}),
        (
            "the initial state does not satisfy the constraint at t = 0: 'rod' (-l**2 + x**2 + y**2) is -0.02",
            "with terms of size 1.98",
            "or take the nearest ones, system.consistent({'x': 0.7, 'y': -0.7}).initial.",
        ),
    ),
    (
        lambda: started(None, {x.dot: 1.0}),
        (
            "the initial velocities do not satisfy the constraint at t = 0: 'rod' (the rate of change of -l**2",
            "is 1.2, with terms of size 1.2.",
        ),
    ),
    (
        lambda: refusal(KNIFE.run, 1.0, {x.dot: 1.0}, check=False),
        ("'blade' (x_dot - 2*y_dot) is 1, with terms of size 1",),
    ),
    (
        lambda: refusal(THREE.run, 1.0, {y: 0.5}, check=False),
        ("the constraints at t = 0: 'a' (x - 1) is -1, with terms of size 1 and 'b' (y - z) is 0.5",),
    ),
    (
        lambda: refusal(particle().consistent, {x: 1.2}, hold=[x]),
        ("no state near the one given satisfies the constraint 'rod'", "Hold fewer values (held: x), or give others."),
    ),
    (
        lambda: refusal(particle(x**2 + y**2 + l**2).consistent, {x: 1.2}),
        ("Give values that are nearer to them, and look for constraints that contradict one another.",),
    ),
    (
        lambda: refusal(particle().consistent, {x: 0.0, y: 0.0}),
        ("'rod' (-l**2 + x**2 + y**2) stays at -1", "All its derivatives vanish there: give a state away from it."),
    ),
    (
        lambda: started(sqrt(x**2 + y**2) - l, {x: 0.0, y: 0.0}),
        (
            "the constraint 'rod', -l + sqrt(x**2 + y**2) = 0, is not differentiable at the initial state (x = 0",
            "such as x**2 + y**2 - l**2 for sqrt(x**2 + y**2) - l",
        ),
    ),
    (
        lambda: started(y - Abs(x), {x: 0.0, y: 0.0}),
        ("the constraint 'rod', y - Abs(x) = 0, is not differentiable at the initial state",),
    ),
    (
        lambda: started(sp.log(x) - y, {x: -1.0, y: 0.0}),
        ("the constraint 'rod', -y + log(x) = 0, has no finite value at the initial state (x = -1, y = 0",),
    ),
    (
        lambda: refusal(HEAVY.consistent, {y: 1.0}),
        ("the mass matrix is not finite at the initial state (x = 0, y = 1",),
    ),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=lambda case: case[0][:30] if isinstance(case, tuple) else "")
def test_a_start_is_refused_by_name(call: Callable[[], str], words: tuple[str, ...]) -> None:
    text = call()
    assert all(part in text for part in words), text
    assert "'c'" not in text


@pytest.mark.parametrize("hold", [3, x, [z], ["nothing"], [[x]]])
def test_what_is_held_must_be_entries_of_the_state(hold: Any) -> None:
    text = refusal(particle().consistent, {}, hold=hold)
    assert "hold is " in text or "which is not a coordinate or velocity of this system: they are x, x_dot" in text


def test_a_run_that_ends_off_its_constraints_is_unreliable() -> None:
    """Friction hides the loss of energy. Solvers of other packages do not project onto constraints."""
    damped = particle(forces={x: -x.dot / 10})
    solution = damped.run(100.0, method="scipy-rk45", rtol=1e-2, atol=1e-2)
    assert solution.status is lg.Status.UNRELIABLE, solution.message
    assert "The state at the end violates the constraint 'rod' by" in solution.message


@pytest.mark.parametrize("method", ["dop853", "dopri5", "taylor"])
def test_a_run_that_ends_where_a_pendulum_turns_around_is_reliable(method: str) -> None:
    """All velocities are errors there, in any direction: the run was called unreliable."""
    released = lg.System((x.dot**2 + y.dot**2) / 2, 9.81 * y, constraints={"rod": x**2 + y**2 - 1})
    start = {x: 0.6, y: -0.8}
    solution = released.run(20.0, start, method=method, rtol=1e-8, events=[lg.event(x.dot, terminal=1)])
    assert solution.status is lg.Status.EVENT, solution.message


def test_a_state_on_a_corner_is_no_end_of_a_run() -> None:
    """Methods of other packages may end on a corner of a constraint."""
    model = particle(y - Abs(x)).compile(check=False)
    told = violation(model, 0.0, np.array([0.0, 0.0, 1.0, 1.0]), model.parameter_array(), 1.0, np.zeros(2))
    assert told.startswith("The run ends on a corner of the constraint 'rod', where velocities jump")


@pytest.mark.parametrize(("speed", "unreliable"), [(1e-17, False), (1e-10, True)])
def test_round_off_of_a_structure_that_cannot_move_is_not_unreliable(speed: float, unreliable: bool) -> None:
    """There are as many bars as coordinates, so only rounding errors of a velocity are allowed."""
    truss = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=y,
        constraints={"left": x - y - 1, "right": x - 2 * y - 1},
        initial={x: 1.0},
    ).compile()
    told = violation(truss, 1.0, np.array([1.0, 0.0, speed, -speed]), truss.parameter_array(), 1.0, np.zeros(2))
    assert bool(told) is unreliable


def test_the_advice_on_an_initial_state_may_be_pasted() -> None:
    """The call in the message can be executed: it has the parameters, the time, and all entries."""
    x0 = {"x": 0.6, "y": -0.8, "x_dot": 0.8, "y_dot": 0.6}
    system = particle()
    text = refusal(system.run, 1.0, x0, parameters={"l": 2}, t_start=1.5, check=False)
    call = text.rpartition("or take the nearest ones, ")[2].removesuffix(".initial.")
    assert call == f"system.consistent({x0}, parameters={{'l': 2.0}}, t=1.5)"
    result = eval(call, {"system": system})
    assert system.run(1.0, result.initial, parameters={"l": 2}, t_start=1.5, check=False).status is lg.Status.SUCCESS


def test_where_no_nearest_state_is_found_none_is_advised() -> None:
    text = refusal(particle(initial={}).run, 1.0, check=False)
    assert "consistent" not in text
    assert "no nearest state is found from this one, so give initial values, of coordinates first." in text


def test_states_and_constraints_near_the_ends_of_doubles_are_refused_in_words() -> None:
    """Matrices with such entries are scaled without underflow, and no step overflows."""
    assert "no state" in refusal(particle().consistent, {x: 1e-300, y: 0.0})
    tiny = particle((x**2 + y**2 - l**2) * 1e-170)
    run = tiny.run(0.1, check=False)
    assert run.status is lg.Status.SINGULAR or np.abs(run[x] ** 2 + run[y] ** 2 - 1).max() < 1e-9
