"""Configurations from which two motions are possible: a run follows the smooth one, or ends there."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from sympy import Abs, Expr, Piecewise, atan2, cos, sin

import lagrange as lg
from lagrange.equations.singular import Singular
from lagrange.errors import RunError
from lagrange.trajectory import endings
from lagrange.trajectory.constraints.dependence import dependent_passage
from tests.models import shared_scene
from tests.trajectory.runs import ADAPTIVE, FIXED, OUTSIDE

a, b, s = lg.coordinates("a b s")

CRANK = lg.System(
    kinetic=(a.dot**2 + b.dot**2 + s.dot**2) / 2,
    coordinates=[a, b, s],
    constraints={"along": cos(a) + cos(b) - s, "across": sin(a) - sin(b)},
    initial={a: 0.3, b: 0.3, s: 2 * np.cos(0.3)},
)
"""A slider-crank with equal rods. As the slider passes the crank's centre, both rods may turn together or apart."""

START = CRANK.consistent({a.dot: 3.0, b.dot: 3.0}).initial


def told(solution: lg.Solution) -> None:
    """Assert that the rods stay parallel across the configuration, or that the run ends there."""
    assert np.abs(solution[a] - solution[b]).max() < 1e-4
    if solution.status is not lg.Status.SUCCESS:
        assert solution.status is lg.Status.SINGULAR and "'across'" in solution.message, solution.message
        return
    assert float(np.cos(solution[a]).min()) < -0.9
    assert solution.energy[-1] == pytest.approx(solution.energy[0], rel=1e-5)


@pytest.mark.parametrize("method", ["taylor", "dop853", "verner9", "radau5"])
@pytest.mark.parametrize("options", [{}, {"t_eval": np.linspace(0.0, 3.0, 301)}])
def test_no_method_goes_on_as_another_motion(method: str, options: dict[str, Any]) -> None:
    told(CRANK.run(3.0, START, method=method, check=False, **options))


@cache
def reduced() -> lg.Solution:
    """Return the motion of the scene's linkage as a parallelogram with one angle."""
    p = {str(symbol): value for symbol, value in shared_scene("four-bar-change-point").parameters.items()}
    angle = lg.coordinate("angle")
    inertia = (p["m1"] + p["m3"]) / 3 + p["m2"]
    weight = (p["m1"] + p["m3"]) / 2 + p["m2"]
    system = lg.System(
        kinetic=inertia * p["l1"] ** 2 * angle.dot**2 / 2,
        potential=p["g"] * weight * p["l1"] * sin(angle),
        initial={angle: np.pi / 2, angle.dot: -1.0},
    )
    return system.run(2.0, rtol=1e-14)


METHODS = [name for name in (*ADAPTIVE, *OUTSIDE) if name not in ("scipy-rk23", "scipy-rk45", "scipy-bdf")]


@pytest.mark.parametrize("rtol", [1e-8, 1e-12])
@pytest.mark.parametrize("method", METHODS)
def test_every_method_with_error_control_follows_the_reduced_motion_or_ends_at_a_crossing(
    method: str, rtol: float
) -> None:
    """The bars are in one line at t = 0.722 and 1.244. Methods that take thousands of steps are left out."""
    if method in ("bs3", "radau3") and rtol < 1e-10:
        pytest.skip("a low order takes too many steps")
    if method == "cvode" and rtol < 1e-10:
        pytest.skip("rounding moves it off the constraints, onto which it is not projected")
    run = shared_scene("four-bar-change-point").run(2.0, method=method, rtol=rtol, check=False)
    if run.status is not lg.Status.SUCCESS:
        # A step, of about 0.01, before the constraints have 1e-2 of their least singular value.
        assert run.status is lg.Status.SINGULAR and "'x'" in run.message, run.message
        assert min(abs(run.t[-1] - 0.722), abs(run.t[-1] - 1.244)) < 0.02
    angle, rate = reduced().at(run.t)
    # The angle is unstable: 1e4 is what errors of a step grow to, with SUNDIALS, which is not projected. Near a
    # crossing angles are known to the root of rounding, and a run ends where velocities, of size 7, are not known to
    # the root of rtol.
    assert np.abs(run.y[0] - angle).max() < 1e4 * rtol + 2e-8
    known = 1e-7 if run.status is lg.Status.SUCCESS else 10 * np.sqrt(rtol)
    assert np.abs(run.y[3] - rate).max() < 1e5 * rtol + known
    assert np.abs(run.y[1]).max() < 100 * rtol + 2e-8


def short_steps(towards: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and states of parallel rods, with one short step at a given angle."""
    times = np.concatenate([np.linspace(0.0, 1.0, 11), [1.0 + 1e-6], np.linspace(1.1, 2.0, 10)])
    angles = np.full(len(times), 0.3)
    angles[10:12] = towards
    still = np.zeros_like(angles)
    return times, np.column_stack([angles, angles, 2 * np.cos(angles), still, still, still])


@pytest.mark.parametrize(
    ("angle", "rtol", "result"), [(1e-6, 1e-9, True), (1e-2, 1e-9, False), (1e-3, 1e-9, False), (1e-2, 1e-4, True)]
)
def test_short_steps_towards_a_crossing_are_seen(angle: float, rtol: float, result: bool) -> None:
    model = CRANK.compile(check=False)
    times, states = short_steps(np.pi / 2 - angle)
    passed = dependent_passage(model, times, states, model.parameter_array(), rtol)
    assert (passed is not None) == result
    if passed is not None:
        assert passed[0] == 9 and [row for row, _ in passed[1].rows] == [1]
    assert dependent_passage(model, np.linspace(0.0, 2.0, len(times)), states, model.parameter_array(), rtol) is None


@pytest.mark.parametrize("options", [{}, {"t_eval": np.linspace(0.0, 3.0, 301)}])
def test_a_run_that_rounding_would_decide_ends_before(monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]) -> None:
    seen: list[float] = []

    def passed(model: Any, times: Any, *_: Any, **__: Any) -> Any:
        if seen:
            return None
        seen.append(float(times[5]))
        return 5, Singular(1e-7, rows=((1, 1.0),))

    monkeypatch.setattr(endings, "dependent_passage", passed)
    solution = CRANK.run(3.0, START, method="dop853", check=False, **options)
    assert solution.status is lg.Status.SINGULAR and solution.t[-1] <= seen[0] + 1e-12
    assert "the constraint 'across' restricts no velocity" in solution.message
    assert "an error as small as the tolerance decides how the motion goes on." in solution.message
    assert len(solution.t) == len(solution.y[0]) and solution.t[-1] > 0.0


@pytest.mark.parametrize("method", ["gauss2", "gauss3", "rattle", "lobatto4"])
def test_equal_steps_with_a_matrix_say_where_they_end(method: str) -> None:
    """The matrix of Newton's method is singular at such a configuration."""
    run = shared_scene("four-bar-change-point").run(2.0, method=method, step=0.01, check=False)
    assert run.status is lg.Status.SINGULAR, run.message
    assert min(abs(run.t[-1] - 0.722), abs(run.t[-1] - 1.244)) < 0.011
    assert "'x'" in run.message and "pass it with equal steps, such as those of rk4" in run.message
    assert np.abs(run.y[0] - reduced().at(run.t)[0]).max() < 1e-3


# --- jumps and corners ----------------------------------------------------------------------------------------
# Constraints that jump, have corners, or restrict nothing on the way: a run ends before, and says which and where.

x, y = lg.coordinates("x y")
STOPPED_METHODS = ("taylor", "dop853", "rk4", "rattle", "radau5", "lobatto4", "bdf2")
INWARDS = {x: 1.0, y: 1.0, x.dot: -1.0}


def held(constraint: Expr, initial: dict[Any, float], potential: Any = 0, **more: Any) -> lg.System:
    """Return a unit mass in the plane with constraints."""
    return lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=potential,
        coordinates=[x, y],
        constraints={"wire": constraint},
        initial=initial,
        **more,
    )


def options(method: str) -> dict[str, Any]:
    return {"method": method, **({"step": 0.01} if method in FIXED else {})}


CORNER = "the constraint 'wire' has a corner where {} = 0: velocities jump there, in a way that is not stated."
JUMP = "the constraint 'wire' jumps where {} = 0, and no motion continues beyond it."
ENDED = {
    "jump": (held(y - Piecewise((1, x > 0), (-1000, True)), INWARDS), JUMP.format("x")),
    "small jump": (held(y - Piecewise((1, lg.t < 1), (1 + 1e-5, True)), {y: 1.0}), JUMP.format("t - 1")),
    "corner": (held(y - Abs(x), {**INWARDS, y.dot: -1.0}), CORNER.format("x")),
    "corner in time": (held(y - Abs(lg.t - 1), {y: 1.0, y.dot: -1.0}), CORNER.format("t - 1")),
    "angle": (
        held(atan2(y, x) - np.pi + 0.1 - lg.t / 10, {x: -np.cos(0.1), y: np.sin(0.1), x.dot: -1 / 10 * np.sin(0.1)}),
        JUMP.format("y"),
    ),
}
"""All reach their place at t = 1."""


@pytest.mark.parametrize("method", STOPPED_METHODS)
@pytest.mark.parametrize("kind", ENDED)
def test_a_run_ends_where_a_constraint_jumps_or_has_a_corner(kind: str, method: str) -> None:
    system, words = ENDED[kind]
    start = system.consistent().initial if kind == "angle" else {}
    run = system.run(2.5, start, check=False, **options(method))
    assert run.status is lg.Status.SINGULAR and words in run.message
    # A step of series ends there, one with error control beside it, and an equal one is the last that is whole.
    assert run.t[-1] == pytest.approx(1.0, abs=0.011 if method in FIXED else 1e-9)
    assert run.t[-1] <= 1.0 + 1e-12 and run.trajectory.span[1] == run.t[-1] and run.trajectory.steps == len(run.t) - 1
    assert run.constraint_error.max() < 1e-9
    assert np.abs(run.at(run.t[-1]) - run.y[:, -1]).max() < 1e-9


@pytest.mark.parametrize("method", STOPPED_METHODS)
@pytest.mark.parametrize(
    ("wire", "wall"), [(x * Abs(x), 1.0), (Piecewise((x**2, x > 0), (0, True)), 0.0)], ids=["cubic", "flat"]
)
def test_a_constraint_that_is_smooth_where_it_switches_is_passed(wire: Expr, wall: float, method: str) -> None:
    run = held(y - wire, {**INWARDS, y.dot: -2.0}).run(2.0, check=False, **options(method))
    assert run.status is lg.Status.SUCCESS, run.message
    assert run[x][-1] < 0 and run[y][-1] == pytest.approx(-wall * run[x][-1] ** 2, abs=1e-10)
    assert run.energy[-1] == pytest.approx(2.5, rel=1e-2)


def test_what_a_run_keeps_ends_there_too() -> None:
    """Outputs and events end at the same time, also in a run backwards in time. A flow raises an error."""
    system, words = ENDED["corner"]
    for method in ("taylor", "dop853"):
        run = system.run(2.5, t_eval=np.linspace(0.0, 2.5, 26), events=[x - 0.5, x + 0.5], check=False, method=method)
        assert run.status is lg.Status.SINGULAR and run.t == pytest.approx(np.linspace(0.0, 0.9, 10), abs=1e-9)
        assert [len(times) for times in run.t_events] == [1, 0]
        back = system.run(-2.5, {x.dot: 1.0, y.dot: 1.0}, check=False, method=method)
        assert back.t[-1] == pytest.approx(-1.0, abs=1e-9) and words in back.message
    with pytest.raises(RunError, match="has a corner where x = 0"):
        lg.flow(system.compile(check=False), method="rk4", step=0.01)([1.0, 1.0, -1.0, -1.0], 0.0, 2.5)


@pytest.mark.few(2)
@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "radau5", "gauss2", "bdf2"])
def test_a_constraint_that_comes_to_restrict_nothing_ends_a_run(method: str) -> None:
    """The constraint fixes the speed to 1 - t. At rest it restricts no direction."""
    brake = held(x.dot**2 + y.dot**2 - (1 - lg.t) ** 2, {x.dot: 1.0})
    run = brake.run(2.0, check=False, **options(method))
    assert run.status is lg.Status.SINGULAR and run.t[-1] <= 1.0 + 1e-9
    assert "the constraint 'wire' restricts no velocity, as all its velocity derivatives vanish," in run.message
    assert "does not determine how the motion continues" in run.message
    turning = held(x.dot**2 + y.dot**2 - 1, {x.dot: 1.0}, forces={x: -5 * y.dot, y: 5 * x.dot})
    turned = turning.run(3.0, method="rk4", step=0.3, check=False)
    assert turned.status is lg.Status.SUCCESS, turned.message


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_a_rod_that_shrinks_to_a_point_ends_a_run_long_before_its_steps_are_used_up(method: str) -> None:
    rod = held(x**2 + y**2 - (1 - lg.t) ** 2, {x: 1.0, x.dot: -1.0}, 9.81 * y)
    run = rod.run(2.0, t_eval=[0.5], method=method, check=False)
    assert run.status is lg.Status.SINGULAR and run.trajectory.steps < 1.2e6
    assert "the constraint 'wire' restricts no velocity" in run.message and "times their values at the" in run.message
    fewer = rod.run(2.0, method=method, max_steps=1000, check=False)
    assert fewer.status is lg.Status.MAX_STEPS


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["rk4", "heun", "gauss2", "gauss3", "rattle", "lobatto4", "bdf2"])
def test_equal_steps_into_the_point_of_a_shrinking_rod_name_it(method: str) -> None:
    """The mass turns faster and faster: equal steps fail where the rod has a tenth of its length."""
    rod = held(x**2 + y**2 - (1 - lg.t) ** 2, {x: 1.0, x.dot: -1.0}, 9.81 * y)
    run = rod.run(2.0, method=method, step=0.003, check=False)
    assert run.status is lg.Status.SINGULAR and 0.9 < run.t[-1] < 1.0
    assert "its steps are too long for the motion ahead, which ends at t = " in run.message
    assert "the constraint 'wire' restricts no velocity" in run.message
    assert run.message.endswith("grow beyond all bounds. End the run before it.") and len(run.message) <= 400


def test_equal_steps_that_fail_before_a_shortest_rod_are_not_called_singular() -> None:
    rod = held(x**2 + y**2 - (1 - lg.t) ** 2 - 1e-4, {x: 1.0, x.dot: -1.0}, 9.81 * y)
    start = rod.consistent({x: 1.0, x.dot: -1.0}).initial
    run = rod.run(2.0, start, method="heun", step=0.01, check=False)
    assert run.status is lg.Status.DIVERGED and "Take a shorter step" in run.message
