"""What a model keeps of runs with events and output times: a second run begins as if there had been none."""

from __future__ import annotations

import pickle
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.machine.event_memory import EventMemory
from lagrange.machine.events.llvm_event_steps import STANDING
from lagrange.machine.model import Model
from lagrange.machine.series.driver import WATCHED as WATCHED_ARRAYS
from lagrange.machine.state import NO_OUTPUTS
from lagrange.machine.step_events import StepEventMemory
from lagrange.statement.event import event
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import TARGETS, build, k, m, x
from tests.trajectory.runs import FIXED, run, same

WATCHED: dict[str, Any] = {"none": [], "one": [x], "five": [x, x.dot, x - 0.5, x + 0.5, x.dot - x]}
WATCHED["jumps"] = [event(x + 0.2, direction=-1, reset={x.dot: -0.9 * x.dot}), x.dot, event(x, terminal=99)]
FORCES = {"smooth": -(x**3), "switching": -sp.sign(x) - x}


def watched(name: str, target: str = "llvm") -> Model:
    """An oscillator, whose force may switch where x = 0."""
    return build(
        target, kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, forces={x: FORCES[name]}, parameters={m: 1, k: 1}
    )


def same_events(a: Trajectory, b: Trajectory) -> bool:
    """Whether two runs and their events are the same, to the last bit.

    How many steps are tried in vain behind a change of the motion depends on how many one call of the driver takes.
    """
    a, b = (replace(one, evaluations=0, rejected=0) for one in (a, b))
    times, states = (all(map(np.array_equal, getattr(a, n), getattr(b, n))) for n in ("t_events", "y_events"))
    return same(a, b) and len(a.t_events) == len(b.t_events) and times and states


def poison(compiled: Model) -> None:
    """Fill what idle drivers share with what watches their runs, but for what the drivers only read."""
    idle = [one for kept in compiled.prepared.values() for one in kept.idle.values()]
    assert idle
    for one in idle:
        taylor, memory = one.state.taylor, getattr(one.memory, "memory", one.memory)
        for name in ("low", "scale", "next_limit", "limit"):
            setattr(taylor, name, 2.0**-600)
        taylor.inspect = taylor.rescalings = taylor.failures = 1
        if isinstance(memory, EventMemory):
            _fill(memory, (*(name for _, name in WATCHED_ARRAYS), "combinations"), memory.record)
        elif isinstance(memory, StepEventMemory):
            _fill(memory, (*STANDING, "until_end"), memory.run)
            _fill(memory, (), memory.review)


READ_ALONE = ("settings", "direction", "tilts")
"""What no run writes to, but for the last settings of a run by a step program."""


def _fill(memory: Any, arrays: tuple[str, ...], record: Any) -> None:
    """Fill arrays, and the fields of a record."""
    for name in arrays:
        if name not in READ_ALONE:
            getattr(memory, name).fill(3)
    for name, _ in record._fields_:
        setattr(record, name, 2)


SPANS = (0.0, 9.0), (0.0, 4.0), (3.0, 0.0), (0.0, 9.0), (0.0, 260.0), (0.0, 9.0)


@pytest.mark.few(1)
@pytest.mark.parametrize("outputs", [False, True])
@pytest.mark.parametrize("force", FORCES)
@pytest.mark.parametrize("events", WATCHED)
@pytest.mark.parametrize("name", ["taylor", "dop853", "rk4", "radau5", "bdf2"])
def test_a_watched_run_is_that_of_a_model_that_has_kept_nothing(
    name: str, events: str, force: str, *, outputs: bool
) -> None:
    """Whatever is in the memory of its driver: other starts, spans, directions and parameters."""
    compiled, alone = watched(force), watched(force)
    for i, (begin, end) in enumerate(SPANS):
        options: dict[str, Any] = {"events": WATCHED[events], "parameters": {k: 1.0 + i // 3}}
        options |= {"step": 0.05} if name in FIXED else {"rtol": 1e-7}
        options |= {"t_eval": np.linspace(begin, end, 17)} if outputs else {}
        start = {x: 0.7 - 0.2 * i, x.dot: 0.3}
        if i and any(one.idle for one in compiled.prepared.values()):
            poison(compiled)
        alone.prepared.clear()
        assert same_events(
            run(compiled, end, name, begin, start, **options), run(alone, end, name, begin, start, **options)
        )


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("options", [{"events": [x]}, {"t_eval": [0.5, 1.0]}, {"events": [x], "t_eval": [0.5, 1.0]}])
@pytest.mark.parametrize("name", ["taylor", "dop853", "rk4", "radau5"])
def test_a_second_watched_run_makes_no_driver(
    name: str, options: dict[str, Any], target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = watched("smooth", target)
    first = run(compiled, 3.0, name, initial={x: 1.0}, **options)
    plan = list(compiled.prepared.values())[-1].plan
    monkeypatch.setattr(type(plan), "driver", None)
    for made in ("series_watch.EventMemory", "event_loop.WatchedEvents.of"):
        monkeypatch.setattr(f"lagrange.trajectory.events.{made}", None)
    assert same_events(run(compiled, 3.0, name, initial={x: 1.0}, **options), first)


@pytest.mark.parametrize("name", ["taylor", "dop853"])
def test_what_a_watched_run_found_stays_as_it_is(name: str) -> None:
    compiled = watched("switching")
    first = run(compiled, 20.0, name, initial={x: 1.0}, events=WATCHED["five"], t_eval=np.linspace(0.0, 20.0, 33))
    copied = [array.copy() for array in (first.t, first.y, *first.t_events, *first.y_events)]
    run(compiled, 20.0, name, initial={x: 2.0}, events=WATCHED["five"], t_eval=np.linspace(0.0, 20.0, 33))
    poison(compiled)
    assert all(map(np.array_equal, copied, (first.t, first.y, *first.t_events, *first.y_events)))


@pytest.mark.parametrize("events", WATCHED)
@pytest.mark.parametrize("name", ["taylor", "dop853", "rk4", "verlet", "radau5", "bdf2"])
def test_threads_share_a_model(name: str, events: str) -> None:
    """The bits of runs one after the other, whatever runs beside them: other states, parameters and directions."""
    shared, alone = watched("switching"), watched("switching")
    calls = [({x: 1.0 + i / 7, x.dot: 0.3}, 20.0 * (-1) ** i, {k: 1.0 + i % 3}) for i in range(8)]
    given: dict[str, Any] = {"events": WATCHED[events]}
    expected = [run(alone, end, name, initial=start, parameters=values, **given) for start, end, values in calls]
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # threads change within a run
    try:
        with ThreadPoolExecutor(8) as pool:
            found = list(
                pool.map(lambda one: run(shared, one[1], name, initial=one[0], parameters=one[2], **given), calls)
            )
    finally:
        sys.setswitchinterval(before)
    assert all(map(same_events, found, expected))


@pytest.mark.parametrize("events", ["none", "five"])
def test_a_run_inside_a_run_has_a_driver_of_its_own(events: str) -> None:
    compiled = watched("smooth")
    given: dict[str, Any] = {"initial": {x: 1.0}, "events": WATCHED[events]}
    expected, inner = run(compiled, 9.0, "taylor", **given), []
    outer = run(
        compiled, 9.0, "taylor", progress=lambda t: inner.append(run(compiled, 9.0, "taylor", **given)), **given
    )
    assert same_events(outer, expected) and inner and all(same_events(one, expected) for one in inner)


def test_a_model_with_idle_drivers_of_events_pickles() -> None:
    compiled = watched("smooth")
    first = run(compiled, 9.0, "taylor", initial={x: 1.0}, events=[x])
    again = pickle.loads(pickle.dumps(compiled))
    assert same_events(run(again, 9.0, "taylor", initial={x: 1.0}, events=[x]), first)


@pytest.mark.parametrize("name", ["taylor", "dop853"])
def test_large_memory_of_events_is_not_kept(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = watched("smooth")
    for most, kept in ((0, 0), (2**20, 1)):
        monkeypatch.setattr("lagrange.trajectory.plan.MOST_BYTES", most)
        run(compiled, 9.0, name, initial={x: 1.0}, events=[x])
        assert len(list(compiled.prepared.values())[-1].idle) == kept
    (idle,) = list(compiled.prepared.values())[-1].idle.values()
    assert idle.memory is not None and 1e4 < idle.memory.nbytes < 2**20
    run(compiled, 9.0, name, initial={x: 1.0}, t_eval=[1.0])
    assert all(one.state.outputs is NO_OUTPUTS for each in compiled.prepared.values() for one in each.idle.values())


@pytest.mark.parametrize("name", ["taylor", "dop853"])
def test_a_driver_is_not_kept_where_an_event_ended_the_run(name: str) -> None:
    """Something may be pending there."""
    compiled = watched("smooth")
    assert run(compiled, 9.0, name, initial={x: 1.0}, events=[event(x, terminal=True)]).status is Status.EVENT
    assert not list(compiled.prepared.values())[-1].idle
