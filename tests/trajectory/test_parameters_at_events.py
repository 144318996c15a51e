"""Events that set parameters, and events located by the compiled loop over steps."""

import importlib
import json
import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import Abs, cos, exp, sin

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory import run as runs
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import Trajectory
from tests.models import build, model
from tests.systems import rod_pendulum
from tests.trajectory.runs import FALL, FIXED, IMPLICIT, SPLITTINGS, STEPPED, G, ball, floor, run

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
    pendulum = rod_pendulum(parameters={m: 1, g: 1, l: 1}, initial={x: 0, y: -1})
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
    [(1 / x, lg.Status.NON_FINITE, "gives a state that is nan or infinite"), (-k, lg.Status.DIVERGED, "k")],
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


# --- the compiled loop over steps gives the same events, ends, resets and messages as the search on arrays -----


METHODS = (*STEPPED, *IMPLICIT)


@cache
def systems() -> dict[str, tuple[Model, dict[str, float]]]:
    """Return models with an initial state and the duration of a run for each."""
    plane = {"kinetic": (x.dot**2 + y.dot**2) / 2, "initial": {x: 0.1, y: 0.2, x.dot: 0.3, y.dot: 0.2}}
    return {
        "Henon-Heiles": (model("Henon-Heiles"), {"x": 0.1, "y": 0.2, "x_dot": 0.3, "y_dot": 0.2}),
        "driven": (build(potential=-cos(x) + (y - sin(t)) ** 2, **plane), {}),
        "coupled": (build(potential=x**2 + y**2 / 2 + sin(x * y) / 4, forces={x: -x.dot / 20}, **plane), {}),
    }


def expressions(rng: np.random.Generator) -> Any:
    """Return a random function of state and time, smooth or rarely with a kink."""
    a, b, c = (float(number) for number in rng.normal(size=3).round(3))
    return [
        y,
        a * x + b * y - c / 8,
        a * x.dot + b * y.dot * cos(y),
        x**2 + y**2 - c**2 / 9,
        sin(3 * x + t) - c / 4,
        x * y.dot - y * x.dot + c / 20,
        exp(a * x) - exp(b * y.dot) + c / 10,
        Abs(x) - abs(c) / 9,
        sp.cos(7 * t + a) - c / 3,
    ][rng.integers(9)]


def events_of(rng: np.random.Generator) -> list[Any]:
    result = [event(expressions(rng), direction=int(rng.integers(-1, 2))) for _ in range(rng.integers(1, 5))]
    kind = rng.random()
    if kind < 0.3:
        result.append(event(expressions(rng), terminal=int(rng.integers(2, 20))))
    elif kind < 0.8:
        result.append(event(y + 0.3, direction=-1, reset={y.dot: -0.9 * y.dot}))
        result.append(event(x - 0.2, direction=1, reset={x.dot: -x.dot}, terminal=int(rng.integers(0, 9))))
    return result


def settings(name: str, rng: np.random.Generator) -> dict[str, Any]:
    if name in FIXED:
        return {"step": float(rng.choice((0.01, 0.05)))}
    tolerance = 10.0 ** -int(rng.integers(4, 10))
    return {"rtol": tolerance, "atol": tolerance}


def taken(place: int, *, everything: bool) -> list[tuple[str, tuple[Model, dict[str, float]]]]:
    """Return the systems to test a method on: all, or in a default run two that differ from method to method."""
    result = list(systems().items())
    return result if everything else [result[k % len(result)] for k in (place, place + 1)]


def both(monkeypatch: pytest.MonkeyPatch, go: Callable[[], Trajectory]) -> tuple[Trajectory, Trajectory]:
    """Return a run with events found on arrays, and one with the compiled loop on all regular steps."""
    result = []
    monkeypatch.setattr("lagrange.trajectory.events.compiled_loop.ENOUGH", 0)
    for least in (math.inf, 0):
        monkeypatch.setattr("lagrange.trajectory.events.compiled_loop.WORTH_COMPILING", least)
        result.append(go())
    return result[0], result[1]


def alike(one: Trajectory, other: Trajectory, off: float = 1e-9) -> None:
    """Assert that two runs are equal up to round-off, which grows from impact to impact."""
    assert other.status is one.status
    assert [len(times) for times in other.t_events] == [len(times) for times in one.t_events]
    assert other.message.split(" ")[:4] == one.message.split(" ")[:4]
    for times, truth, states, right in zip(other.t_events, one.t_events, other.y_events, one.y_events, strict=True):
        assert times == pytest.approx(truth, abs=off, rel=1e-12)
        assert states == pytest.approx(right, abs=off, rel=1e-9)


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", METHODS)
def test_events_of_random_systems(name: str, seed: int, monkeypatch: pytest.MonkeyPatch, everything: bool) -> None:
    rng = np.random.default_rng([METHODS.index(name), seed])
    for title, (of, initial) in taken(METHODS.index(name) + seed, everything=everything):
        options, events = settings(name, rng), events_of(rng)
        end = float(rng.choice((-1, 1)) * (3.0 if name in IMPLICIT else 12.0))
        if name in SPLITTINGS and title == "coupled":
            continue
        if "rtol" in options and any(getattr(first, "reset", None) for first in events):
            # The short steps behind a reset have errors of round-off, and so the next lengths are: others within rtol.
            options = {"rtol": 1e-9, "atol": 1e-9}
        given: dict[str, Any] = {"initial": initial or None, "events": events, **options}
        first, second = both(monkeypatch, partial(run, of, end, name, **given))
        alike(first, second, 1e-7)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["dop853", "verlet", "radau5", "gauss2"])
def test_bounces_are_done_in_machine_code(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Machine code handles all of 300 bounces but the first few, and the output between them is right."""
    looks = counted(monkeypatch, "lagrange.trajectory.events.step_watch.StepWatch.review")
    resets = counted(monkeypatch, "lagrange.trajectory.events.step_watch.StepWatch.process")
    options: dict[str, Any] = {"step": 0.05} if name in FIXED else {"rtol": 1e-9, "atol": 1e-9}
    result = run(ball(), 600 * FALL, name, events=[floor(1), y.dot], **options)
    assert [len(times) for times in result.t_events] == [300, 299]
    assert len(looks) < 20 and len(resets) < 10
    assert result.t_events[0] == pytest.approx((2 * np.arange(300) + 1) * FALL, abs=1e-8)
    # Each bounce is two rows at one time, and what is between two of them is a parabola.
    assert (np.diff(result.t) == 0).sum() == 300 and (np.diff(result.t) >= 0).all()
    times = np.linspace(0.0, 600 * FALL, 2000)
    since = (times + FALL) % (2 * FALL)
    assert result.dense(times)[0] == pytest.approx(G / 2 * since * (2 * FALL - since), abs=1e-6)
    outputs = run(ball(), 600 * FALL, name, events=[floor(1)], t_eval=times, **options)
    assert outputs.y[0] == pytest.approx(result.dense(times)[0], abs=1e-9)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["dop853", "rk4", "radau5", "gauss2", "implicit-midpoint", "bdf2", "verner9"])
def test_the_digits_of_events_do_not_depend_on_how_many_steps_a_call_takes(
    name: str, monkeypatch: pytest.MonkeyPatch, everything: bool
) -> None:
    """The number of steps of a driver call depends on measured times. The events must not depend on it."""
    of, initial = systems()["Henon-Heiles"]
    options: dict[str, Any] = {"step": 0.05} if name in FIXED else {"rtol": 1e-6, "atol": 1e-9}
    wall = event(y + 0.15, direction=-1, reset={y.dot: -y.dot})
    events = [x, x.dot * y - 0.01, sin(3 * t), Abs(x) - 0.05, y + 0.1495]
    for least in (0, 512, math.inf):
        monkeypatch.setattr("lagrange.trajectory.events.compiled_loop.WORTH_COMPILING", least)
        for several in (events, [*events, wall]):
            result = []
            for most in (16384, 64, 7, 2) if everything else (16384, 7):
                monkeypatch.setattr("lagrange.trajectory.run_loop.MOST_STEPS_PER_CALL", most)
                result.append(run(of, 8.0, name, initial=initial, events=several, **options))
            for other in result[1:]:
                assert other.t.tolist() == result[0].t.tolist() and other.y.tolist() == result[0].y.tolist()
                for times, states, right, there in zip(
                    other.t_events, other.y_events, result[0].t_events, result[0].y_events, strict=True
                ):
                    assert times.tolist() == right.tolist() and states.tolist() == there.tolist()


def counted(monkeypatch: pytest.MonkeyPatch, name: str) -> list[None]:
    """Return a list to which each call of a method appends an entry."""
    calls: list[None] = []
    owner, attribute = name.rsplit(".", 1)
    module, kind = owner.rsplit(".", 1)
    cls = getattr(importlib.import_module(module), kind)
    plain = getattr(cls, attribute)

    def noted(*arguments: Any) -> Any:
        calls.append(None)
        return plain(*arguments)

    monkeypatch.setattr(cls, attribute, noted)
    return calls


@pytest.mark.few(1)
@pytest.mark.parametrize("tolerance", [0.02, 3e-3, 8e-4, 1e-4, 1e-6])
def test_a_fast_entry_that_the_tolerance_leaves_out_is_not_screened_away(
    tolerance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps of dop853 contain most of a period of y, which the cubic through the ends of a step does not show."""
    initial = {x: 1.0, y: 1e-3, x.dot: 0.0, y.dot: 0.02}
    potential = x**2 / 2 + 450 * y**2 + x * y / 3
    of = build(kinetic=(x.dot**2 + y.dot**2) / 2, potential=potential, initial=initial)
    events = [x * y.dot - y * x.dot - 0.01545, y.dot * cos(y) - 2.126 * x.dot, x**2 - y.dot, cos(7 * t + 0.375) - 0.12]
    first, second = both(
        monkeypatch, lambda: run(of, 25.0, "dop853", events=events, rtol=tolerance, atol=10 * tolerance)
    )
    alike(first, second, 1e-7)
    assert sum(len(times) for times in first.t_events) > 100
