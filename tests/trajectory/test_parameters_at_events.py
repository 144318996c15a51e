"""Events that set parameters, against solutions in closed form."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.trajectory import run as runs
from lagrange.trajectory.integrator import Problem

x, y = lg.coordinates("x y")
m, k, c, g, l = lg.parameters("m k c g l")

spring = lg.System(m * x.dot**2 / 2, k * x**2 / 2, parameters={m: 1, k: 1}, initial={x: 1})
doubling = lg.event(x, direction=1, reset={k: 2 * k})

PASSAGES = 1.5 * math.pi + np.cumsum([0.0, 2 * math.pi / math.sqrt(2), 2 * math.pi / 2, 2 * math.pi / math.sqrt(8)])
"""Times of x = 0 with v > 0, at which k doubles: a period 2 pi/omega lies between two of them."""


def exact(t: Any) -> Any:
    """Return x of the spring, sin(omega (t - passage))/omega, since the speed at x = 0 stays 1."""
    which = np.searchsorted(PASSAGES, t)
    omega = math.sqrt(2) ** which
    return np.sin(omega * (t - np.append(-math.pi / 2, PASSAGES)[which])) / omega


@pytest.mark.few
@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "radau5", "scipy-rk45"])
def test_a_stiffness_doubles_at_each_passage(method: str) -> None:
    run = spring.run(15.0, events=[doubling], method=method)
    assert run.status is lg.Status.SUCCESS
    # rk4 takes 1000 steps of h = 0.015: (omega h)**4/120 of 15 omega is 3e-7 for the largest omega.
    close = 1e-6 if method == "rk4" else 3e-8
    assert run.t_events[0] == pytest.approx(PASSAGES, abs=close)
    assert [t for t, _ in run.parameter_changes] == run.t_events[0].tolist()
    assert [new for _, new in run.parameter_changes] == [{"k": 2.0}, {"k": 4.0}, {"k": 8.0}, {"k": 16.0}]
    t = np.linspace(0, 15, 97)
    assert run.at(t)[0] == pytest.approx(exact(t), abs=4 * close)
    assert run.energy == pytest.approx(np.full(len(run.t), 0.5), abs=4 * close)


@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_a_zero_that_rounding_leaves_ahead_of_a_segment_is_the_one_that_began_it(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_once, starts = runs._run, list[float]()

    def with_rounding(integrator: Any, problem: Problem) -> lg.Trajectory:
        starts.append(problem.t0)
        before = len(starts) == 2
        return run_once(integrator, replace(problem, y0=problem.y0 - [2e-15, 0]) if before else problem)

    monkeypatch.setattr(runs, "_run", with_rounding)
    run = spring.run(6.0, events=[doubling], method=method)
    assert starts[1] == starts[2] == run.t_events[0][0]
    assert [new for _, new in run.parameter_changes] == [{"k": 2.0}]
    assert run[x][-1] == pytest.approx(exact(6.0), abs=1e-6)


def test_rows_times_and_files_have_the_values_that_hold(tmp_path: Path) -> None:
    run = spring.run(6.0, events=[lg.event(x - 0.5, direction=1, reset={"k": 2 * k, x.dot: 0})])
    (tau,) = run.t_events[0]
    assert tau == pytest.approx(math.pi * 5 / 3)
    before, behind = np.flatnonzero(run.t == tau)
    assert run.evaluate(k)[[before, behind]].tolist() == [1.0, 2.0]
    assert run.energy[[before, behind]] == pytest.approx([0.5, 0.25])
    assert run.at(tau).tolist() == run.y[:, behind].tolist()
    # The energy that the event adds, -1/4, is not drift.
    assert run.drift.absolute < 1e-9
    assert run.sampled([0.0, tau, 6.0]).energy == pytest.approx([0.5, 0.25, 0.25])
    run.to_npz(tmp_path / "run.npz")
    for other in (lg.load(tmp_path / "run.npz"), pickle.loads(pickle.dumps(run))):
        assert other.energy.tolist() == run.energy.tolist()
        assert other.parameter_changes == run.parameter_changes
        assert other.drift.absolute == run.drift.absolute
    assert run.to_csv(tmp_path / "run.csv").read_text().splitlines()[0] == "t,x,x_dot,k"
    assert json.loads(json.dumps(run.card()))["changes"] == [{"t": tau, "parameters": {"k": 2.0}}]
    assert f"k = 2 from t = {tau:.6g}" in repr(run)


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_output_times_at_an_event_and_behind_it_have_the_state_behind(method: str) -> None:
    stop = lg.event(lg.t - 1, reset={x.dot: 0, k: 4})
    run = spring.run(2.0, events=[stop], t_eval=[0.5, 1.0, 2.0], method=method)
    end = math.cos(1)
    assert run[x] == pytest.approx([math.cos(0.5), end, end * math.cos(2)], abs=1e-8)
    assert run[x.dot] == pytest.approx([-math.sin(0.5), 0, -2 * end * math.sin(2)], abs=1e-8)
    assert run.evaluate(k).tolist() == [1.0, 4.0, 4.0]
    last = spring.run(1.0, events=[stop], method=method)
    assert (last.status, last[x.dot][-1], last.evaluate(k)[-1]) == (lg.Status.SUCCESS, 0.0, 4.0)


def test_events_at_one_time_all_act_on_the_state_and_the_parameters_before() -> None:
    events = [lg.event(lg.t - 1, reset=reset) for reset in ({x.dot: k}, {k: 3 * k}, {m: m + k})]
    run = spring.run(2.0, {x: 0, x.dot: 0}, events=events)
    assert run.at(1.0).tolist() == [0.0, 1.0]
    assert [new for _, new in run.parameter_changes] == [{"m": 2.0, "k": 3.0}]
    assert run.at(2.0)[0] == pytest.approx(math.sin(math.sqrt(1.5)) / math.sqrt(1.5))


def test_a_rod_whose_length_changes_ends_the_run_and_a_force_changes_the_multiplier() -> None:
    pendulum = lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        m * g * y,
        constraints={"rod": x**2 + y**2 - l**2},
        parameters={m: 1, g: 1, l: 1},
        initial={x: 0, y: -1},
    )
    run = pendulum.run(2.0, events=[lg.event(lg.t - 1, reset={g: 3})])
    assert run.status is lg.Status.SUCCESS
    # At rest the rod carries 2 lambda y = m g.
    assert run.multipliers["rod"][[0, -1]] == pytest.approx([-0.5, -1.5])
    longer = pendulum.run(2.0, events=[lg.event(lg.t - 1, reset={l: 2})])
    assert longer.status is lg.Status.DIVERGED
    assert longer.t[-1] == 1.0
    assert "rod" in longer.message
    fitting = pendulum.run(2.0, events=[lg.event(lg.t - 1, reset={l: 2, y: -2})])
    assert fitting.status is lg.Status.SUCCESS
    assert fitting[y][-1] == pytest.approx(-2)


@pytest.mark.parametrize(
    ("value", "status", "said"),
    [
        (1 / x, lg.Status.NON_FINITE, "gives a state that is nan or infinite"),
        (-k, lg.Status.DIVERGED, "k"),
    ],
)
def test_a_value_that_is_none_ends_the_run(value: Any, status: lg.Status, said: str) -> None:
    run = spring.run(9.0, {x: 0, x.dot: 0}, events=[lg.event(lg.t - 1, reset={k: value})])
    assert (run.status, run.t[-1]) == (status, 1.0)
    assert said in run.message


def test_parameters_that_change_without_end_at_one_time_end_the_run() -> None:
    ball = lg.System(m * y.dot**2 / 2, m * g * y, parameters={m: 1, g: 2, k: 0}, initial={y: 1})
    run = ball.run(9.0, events=[lg.event(y, direction=-1, reset={y.dot: -y.dot / 2, g: g})])
    assert run.status is lg.Status.STEP_TOO_SMALL
    # Falls of 1, then flights of 1, 1/2, 1/4, ...
    assert run.t[-1] == pytest.approx(3, abs=1e-6)


def test_members_of_an_ensemble_change_parameters_one_by_one() -> None:
    keep = ("end", "drift", ("mean", k), ("max", k * x))
    runs = lg.ensemble(spring, 6.0, {x: [1.0, 2.0]}, events=[doubling], keep=keep, workers=1)
    assert runs.y[:, 0].tolist() == spring.run(6.0, events=[doubling]).y[:, -1].tolist()
    tau = PASSAGES[0]
    assert runs["mean", k] == pytest.approx([(tau + 2 * (6 - tau)) / 6] * 2)
    # Behind the passage k x = 2 sin(omega (t - tau))/omega with omega = sqrt(2) has a maximum of sqrt(2) of the speed.
    assert runs["max", k * x] == pytest.approx([math.sqrt(2), 2 * math.sqrt(2)])
    assert np.abs(runs["drift"]).max() < 1e-9


@pytest.mark.parametrize(
    ("does", "said"),
    [
        (lambda: spring.export("c", "unused", events=[doubling]), "an export has constant parameters"),
        (lambda: spring.compile().as_scipy(events=[doubling]), "as_scipy has constant parameters"),
        (lambda: lg.poincare(spring, doubling), "a section has constant parameters"),
        (lambda: spring.run(1.0, events=[lg.event(x, reset={k: 1, "k": 2})]), "names the parameter k twice"),
        (lambda: spring.run(1.0, events=[lg.event(x, reset={"kk": 1})]), "its parameters are"),
    ],
)
def test_what_has_constant_parameters_refuses_by_name(does: Any, said: str) -> None:
    with pytest.raises(lg.StatementError, match=said):
        does()
