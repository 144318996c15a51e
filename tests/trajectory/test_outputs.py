"""States at output times of a Taylor run, which its steps write, are those of its path."""

from __future__ import annotations

import numpy as np
import pytest
from sympy import exp, sqrt

from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory
from tests.models import TARGETS, build, c, model, x, y
from tests.trajectory.runs import run
from tests.trajectory.watched import FALL, ball, floor

RNG = np.random.default_rng(11)


def assert_on_the_path(found: Trajectory, plain: Trajectory, times: FloatArray) -> None:
    """The outputs are the path of the same run without outputs, but for what rounding lost of its states."""
    assert found.status is plain.status and found.steps == plain.steps and found.rejected == plain.rejected
    assert np.array_equal(found.t, times)
    size = np.abs(plain.y).max(axis=1, keepdims=True)
    moving = np.flatnonzero(np.diff(plain.t))
    rate = np.abs(np.diff(plain.y)[:, moving] / np.diff(plain.t)[moving]).max(axis=1, keepdims=True)
    # The path begins each step from the rounded state and time, half a unit away, and rounds its own sums.
    allowed = 2.0**-52 * (8 * size + 4 * rate * np.abs(times))
    assert (np.abs(found.y - plain.dense(times)) <= allowed).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("count", [1, 3, 2000])
@pytest.mark.parametrize("end", [20.0, -20.0])
@pytest.mark.parametrize("name", ["Henon-Heiles", "double pendulum", "charge"])
def test_many_and_few_times(name: str, end: float, count: int, target: str) -> None:
    compiled = model(name, target)
    times = np.sort(RNG.uniform(min(0, end), max(0, end), count))[:: 1 if end > 0 else -1]
    found = run(compiled, end, "taylor", t_eval=times)
    assert_on_the_path(found, run(compiled, end, "taylor"), times)


@pytest.mark.parametrize("target", TARGETS)
def test_times_of_steps_and_ends(target: str) -> None:
    compiled = model("Henon-Heiles", target)
    plain = run(compiled, 9.0, "taylor")
    found = run(compiled, 9.0, "taylor", t_eval=np.repeat(plain.t, 2))
    assert np.array_equal(found.y, np.repeat(plain.y, 2, axis=1))


@pytest.mark.parametrize("target", TARGETS)
def test_a_step_that_is_taken_back_leaves_no_outputs(target: str) -> None:
    """The narrow bump in the potential is found out from behind the step, and its outputs are written anew."""
    bump = exp(-((10 * (x - 0.5)) ** 2)) / 10
    hidden = build(target, kinetic=x.dot**2 / 2, potential=x**2 / 2 + bump, initial={x: 1.0, x.dot: 2.0})
    times = np.linspace(0.0, 20.0, 800)
    found = run(hidden, 20.0, "taylor", rtol=1e-6, t_eval=times)
    assert found.rejected > 0
    assert_on_the_path(found, run(hidden, 20.0, "taylor", rtol=1e-6), times)


@pytest.mark.parametrize("target", TARGETS)
def test_across_resets_and_up_to_a_terminal_event(target: str) -> None:
    times = np.linspace(0.0, 3.0, 333)
    found = run(ball(target), 3.0, "taylor", events=[floor(0.8)], t_eval=times)
    assert_on_the_path(found, run(ball(target), 3.0, "taylor", events=[floor(0.8)]), times)
    ends = [event(y, terminal=True)]
    found = run(ball(target), 5.0, "taylor", events=ends, t_eval=times)
    reached = times[times <= FALL]
    assert found.status is Status.EVENT
    assert_on_the_path(found, run(ball(target), 5.0, "taylor", events=ends), reached)


@pytest.mark.parametrize("target", TARGETS)
def test_over_a_point_without_a_series(target: str) -> None:
    """From rest with drag |v| v a run begins with a leap, and the outputs on it are those of its path."""
    speed = sqrt(x.dot**2 + y.dot**2)
    drag = {x: -c * speed * x.dot, y: -c * speed * y.dot}
    thrown = build(target, kinetic=(x.dot**2 + y.dot**2) / 2, potential=9.81 * y, forces=drag)
    plain = run(thrown, 1.5, "taylor")
    leaps = np.flatnonzero(np.diff(plain.t) <= 1.6e-6)
    assert len(leaps), "the run leaps"
    starts, ends = plain.t[leaps], plain.t[leaps + 1]
    times = np.sort(np.concatenate([np.linspace(0.0, 1.5, 40), (starts + ends) / 2]))
    assert_on_the_path(run(thrown, 1.5, "taylor", t_eval=times), plain, times)


def test_a_time_dependent_force_is_met_at_the_right_time() -> None:
    """Against the closed form: an output reads the time at its place on the step."""
    pushed = build(kinetic=x.dot**2 / 2, forces={x: t**2}, initial={x: 1.0})
    times = np.linspace(0.0, 3.0, 50)
    found = run(pushed, 3.0, "taylor", t_eval=times)
    assert found.y[0] == pytest.approx(1 + times**4 / 12, rel=4e-16 * 8)
