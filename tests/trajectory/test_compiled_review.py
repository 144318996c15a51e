"""The compiled loop over steps gives the same events, ends, resets and messages as the search on arrays."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import Abs, cos, exp, sin

from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.trajectory import Trajectory
from tests.models import build, model, x, y
from tests.trajectory.runs import FIXED, IMPLICIT, SPLITTINGS, STEPPED, run
from tests.trajectory.watched import FALL, G, ball, floor

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


@pytest.mark.few(2)
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
                result.append(run(of, 20.0, name, initial=initial, events=several, **options))
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


@pytest.mark.few(2)
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
