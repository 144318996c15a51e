"""Events of members side by side: their first occurrences, and the runs that they end, are those of runs alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.members import job, work
from lagrange.members.singly import RunEngine
from tests.covering import spread


@cache
def ball() -> lg.System:
    """A ball thrown upwards, y'' = -10."""
    y = lg.coordinate("y")
    return lg.System(kinetic=y.dot**2 / 2, potential=10 * y, initial={y: 1.0, y.dot: 3.0})


@cache
def oscillator() -> lg.System:
    """x = a cos 2t."""
    x = lg.coordinate("x")
    return lg.System(kinetic=x.dot**2 / 2, potential=2 * x**2, initial={x: 1.0})


@contextmanager
def without_lanes(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run members one after the other."""
    with monkeypatch.context() as changed:
        changed.setattr(job, "lane_engine", lambda *_, **__: None)
        yield


@contextmanager
def runs_alone(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Count the members that a lane has left to runs of their own."""
    numbers: list[int] = []
    known = RunEngine.again

    def again(engine: RunEngine, starts: Any, ends: Any, which: Any) -> Any:
        numbers.append(len(which))
        return known(engine, starts, ends, which)

    with monkeypatch.context() as changed:
        changed.setattr(RunEngine, "again", again)
        yield numbers


def agree(one: lg.Ensemble, other: lg.Ensemble, tolerance: float = 1e-12) -> None:
    """Compare all columns: what is missing in one is missing in the other."""
    assert one.status.tolist() == other.status.tolist()
    for column in one.columns:
        if column.name != "evaluations":
            found, expected = (runs.results.column(column.name) for runs in (one, other))
            assert np.allclose(found, expected, rtol=tolerance, atol=tolerance, equal_nan=True), column.name


def test_times_of_a_thrown_ball_have_closed_forms(monkeypatch: pytest.MonkeyPatch) -> None:
    """The motion is a polynomial: times and states are right to round-off. One ball is still in the air."""
    (y,) = ball().coordinates
    speeds = np.append(np.linspace(0.5, 9.0, 20), 40.0)
    events = [lg.event(y, terminal=True), lg.event(y.dot, direction=-1)]
    with runs_alone(monkeypatch) as alone:
        runs = lg.ensemble(ball(), 4.0, {"y_dot": speeds}, events=events, keep=("end", ("events", 2)))
    assert "side by side" in runs.form and sum(alone) == 0
    landed = (speeds + np.sqrt(speeds**2 + 20.0)) / 10.0
    assert [one.value for one in runs.status] == [*["event"] * 20, "success"]
    assert np.allclose(runs.t_events[0][:20, 0], landed[:20], rtol=4e-16, atol=0)
    assert np.isnan(runs.t_events[0][20]).all() and np.isnan(runs.t_events[0][:, 1]).all()
    assert np.array_equal(runs.t[:20], runs.t_events[0][:20, 0]) and runs.t[20] == 4.0
    assert np.array_equal(runs.y[:, :20].T, runs.y_events[0][:20, 0])
    assert np.allclose(runs.t_events[1][:, 0], speeds / 10.0, rtol=4e-16, atol=0)
    assert np.allclose(runs.y_events[1][:, 0, 0], 1.0 + speeds**2 / 20.0, rtol=4e-15, atol=0)


def test_more_occurrences_than_there_is_room_for_on_the_way() -> None:
    """x = a cos 2t is zero at (k + 1/2) pi / 2; the error of the phase grows with the time."""
    (x,) = oscillator().coordinates
    keep = ("end", ("events", 300))
    runs = lg.ensemble(oscillator(), 400.0, {"x": np.linspace(0.5, 1.5, 9)}, events=[x], keep=keep, rtol=1e-12)
    expected = (np.arange(300) + 0.5) * np.pi / 2
    inside = expected < 400.0
    assert inside.sum() > 128
    assert np.allclose(runs.t_events[0][:, inside], expected[inside], rtol=0, atol=1e-9)
    assert np.isnan(runs.t_events[0][:, ~inside]).all()
    assert np.allclose(runs.y_events[0][:, inside, 0], 0.0, atol=1e-14)


HENON: dict[str, Any] = {
    "crossings": lambda x, y: [x, y - 0.05],
    "directions": lambda x, y: [lg.event(x, direction=1), lg.event(y, direction=-1)],
    "the third ends the run": lambda x, y: [lg.event(x, terminal=3), y],
    "a product that touches zero": lambda x, y: [x * y],
    "one that is never zero": lambda x, y: [x**2 + y**2 - 4],
    "velocities": lambda x, y: [x.dot, lg.event(x.dot * y.dot, terminal=4)],
    "two at once that end the run": lambda x, y: [lg.event(x - 0.01, terminal=True), lg.event(2 * x - 0.02)],
    "a transcendental one": lambda x, y: [sympy.cos(7 * x) - sympy.exp(y) / 2],
}


BEYOND = ("a transcendental one",)
"""Events whose series end a step before that of the motion, where rounding decides how far: other steps, and a motion
that is as right as the tolerance of 1e-10 makes it."""


@pytest.mark.parametrize("case", spread(list(HENON), 3))
@pytest.mark.parametrize("end", [20.0, -7.0])
def test_events_of_a_member_are_those_of_its_run(case: str, end: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also what a lane leaves to the run. Lyapunov growth over t = 20 multiplies round-off by less than 100."""
    henon = lg.scene("henon-heiles")
    x, y = henon.coordinates
    given: dict[str, Any] = {"events": HENON[case](x, y), "rtol": 1e-10}
    counts = () if case in BEYOND else ("counts",)
    given["keep"] = ("end", *counts, ("events", 4), ("max", x), ("mean", y))
    given["t_eval"] = np.linspace(0.0, end, 5)
    starts = {"x": np.linspace(0.05, 0.2, 13)}
    together = lg.ensemble(henon, end, starts, **given)
    with without_lanes(monkeypatch):
        alone = lg.ensemble(henon, end, starts, workers=1, **given)
    assert "side by side" in together.form and "one after" in alone.form
    agree(together, alone, 1e-8 if case in BEYOND else 1e-12)


def test_events_at_both_ends_of_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zeros from which a motion begins are no events; some that lie at its very end are, as in a run."""
    (y,) = ball().coordinates
    for event in (lg.event(y, terminal=True), y, lg.event(y.dot + 5.0)):
        for start in ({"y": np.array([0.0, 0.5, 1.0]), "y_dot": 5.0}, {"y": 0.0, "y_dot": np.array([-5.0, 5.0, 5.5])}):
            given: dict[str, Any] = {"events": [event], "keep": ("end", ("events", 2))}
            together = lg.ensemble(ball(), 1.0, start, **given)
            with without_lanes(monkeypatch):
                agree(together, lg.ensemble(ball(), 1.0, start, workers=1, **given))


def test_what_a_member_keeps_depends_on_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks, threads, order, and neighbours that escape or are left to runs of their own: the same bytes."""
    henon = lg.scene("henon-heiles")
    x, y = henon.coordinates
    given: dict[str, Any] = {"keep": ("end", ("events", 3), ("min", x)), "rtol": 1e-8}
    given["events"] = [lg.event(x, terminal=2), y]
    grid = lg.grid({"x": (-1.0, 1.0, 7), "y": [-0.2, 0.1, 0.9]})
    whole = lg.ensemble(henon, 6.0, grid, workers=1, **given)
    assert len(set(whole.status)) > 2
    for size, workers in ((1, 1), (5, 2), (8, 1)):
        with monkeypatch.context() as changed:
            changed.setattr(work, "FIRST_CHUNK", size)
            changed.setattr(work, "LARGEST_CHUNK", size)
            runs = lg.ensemble(henon, 6.0, grid, workers=workers, **given)
        for name in (column.name for column in whole.columns):
            assert runs.results.column(name).tobytes() == whole.results.column(name).tobytes(), name
    order = np.random.default_rng(3).permutation(len(whole))
    mixed = lg.ensemble(henon, 6.0, {"x": whole.given("x")[order], "y": whole.given("y")[order]}, **given)
    for name in (column.name for column in whole.columns):
        assert mixed.results.column(name).tobytes() == whole.results.column(name)[order].tobytes(), name


def test_a_root_in_the_forces_is_watched_in_lanes_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """sqrt(1 + x) has no value from x = -1 on: a run ends there, and says so, whoever runs beside it."""
    x = lg.coordinate("x")
    cliff = lg.System(kinetic=x.dot**2 / 2, potential=-4 * (1 + x) ** sympy.Rational(3, 2) / 3, initial={x: 0.0})
    starts = {"x_dot": np.linspace(-2.5, 1.0, 11)}
    together = lg.ensemble(cliff, 2.0, starts, keep=("end", "counts"))
    with without_lanes(monkeypatch):
        alone = lg.ensemble(cliff, 2.0, starts, keep=("end", "counts"), workers=1)
    assert "side by side" in together.form and len(set(alone.status)) > 1
    agree(together, alone)


def test_a_limit_of_steps_holds_with_events(monkeypatch: pytest.MonkeyPatch) -> None:
    (x,) = oscillator().coordinates
    given: dict[str, Any] = {"events": [x], "keep": ("end", "counts", ("events", 9)), "max_steps": 6}
    together = lg.ensemble(oscillator(), 50.0, {"x": [0.5, 1.0]}, **given)
    with without_lanes(monkeypatch):
        alone = lg.ensemble(oscillator(), 50.0, {"x": [0.5, 1.0]}, workers=1, **given)
    assert set(alone.status) == {lg.Status.MAX_STEPS}
    agree(together, alone)


def test_resets_and_other_methods_are_runs_one_after_the_other() -> None:
    (y,) = ball().coordinates
    bounce = lg.event(y, direction=-1, reset={y.dot: -0.5 * y.dot})
    runs = lg.ensemble(ball(), 1.0, {"y_dot": [1.0, 2.0]}, events=[bounce])
    assert "one after" in runs.form
    runs = lg.ensemble(ball(), 1.0, {"y_dot": [1.0, 2.0]}, events=[y], method="dop853", keep=("events",))
    assert "one after" in runs.form and np.allclose(runs.t_events[0][:, 0], [0.558257569, 0.689897949], atol=1e-8)
