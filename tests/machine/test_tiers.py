"""Tiered compilation: quick code first, code that is compiled well after many steps, and the same bits from both."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine.llvm import engine, tiers
from lagrange.machine.llvm.engine import Module
from lagrange.machine.series.llvm_driver import LlvmSeries
from lagrange.machine.series.llvm_steps import _events, compiled_steps
from lagrange.machine.steps import llvm_driver
from lagrange.program.taylor import series_program
from tests.models import SYSTEMS
from tests.systems import unit_pendulum

INSPECTS, STEPS = r"define .*@inspect_step\(", r"define .*@taylor_steps\("
TOLERANCES = [10.0**-k for k in range(3, 17)]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that gets the text of each module that is compiled."""
    found = []
    compiling = Module.__init__

    def noted(self: Module, text: str, **how: bool) -> None:
        found.append(text)
        compiling(self, text, **how)

    monkeypatch.setattr(Module, "__init__", noted)
    return found


def ran(model: Any, method: str, **options: Any) -> tuple[bytes, bytes]:
    found = lg.integrate(model, (0.0, 9.0), method=method, **options)
    assert found.status is lg.Status.SUCCESS
    return found.t.tobytes(), found.y.tobytes()


RUNS = {"taylor": {"rtol": 1e-9}, "dop853": {"rtol": 1e-7}, "rk4": {"step": 0.01}, "radau5": {"rtol": 1e-6}}


@pytest.mark.parametrize("method", RUNS)
def test_code_that_is_compiled_well_gives_the_same_bits(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first run is of quick code, the second one passes the number of steps, and the third is of the other code."""
    compiled_steps.cache_clear()
    llvm_driver._compiled.cache_clear()
    model = unit_pendulum().compile(check=False)
    first = ran(model, method, **RUNS[method])
    monkeypatch.setattr(tiers, "STEPS", 1)
    compiled_steps.cache_clear()
    llvm_driver._compiled.cache_clear()
    fresh = unit_pendulum().compile(check=False)
    assert [ran(fresh, method, **RUNS[method]) for _ in range(2)] == [first] * 2


def test_a_series_is_compiled_well_behind_many_steps(made: list[str]) -> None:
    program = series_program(euler_lagrange(SYSTEMS["Kepler orbit"]()))[0]
    jet = LlvmSeries(program).compiled(9)
    quick = jet.address
    assert jet.tiers is not None
    jet.tiers.count(tiers.STEPS - 1)
    assert (len(made), jet.address, jet.tiers.is_final) == (1, quick, False)
    jet.tiers.count(1)
    assert made == [jet.ir] * 2
    assert jet.address != quick
    jet.tiers.count(tiers.STEPS)
    assert jet.tiers.is_final
    assert len(made) == 2


def test_drivers_go_on_with_the_code_that_another_run_has_had_compiled(
    made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiers, "STEPS", 400)
    compiled_steps.cache_clear()
    flow = lg.flow(unit_pendulum().compile(check=False), method="taylor", rtol=1e-9, atol=1e-9)
    y = np.array([1.0, 0.0])
    ends = [flow(y, 0.0, 200.0).tobytes() for _ in range(3)]
    assert ends[1:] == ends[:-1]
    assert sum("@taylor_steps(" in text for text in made) == 2


@pytest.mark.parametrize("watching", [False, True])
def test_another_tolerance_compiles_its_series_once_and_no_loop_over_steps(watching: bool, made: list[str]) -> None:
    """The loop serves all orders, with events too."""
    theta = lg.coordinate("theta")
    model = unit_pendulum().compile(check=False)
    events = [lg.Event(theta)] if watching else None
    lg.integrate(model, (0.0, 3.0), rtol=1e-9, events=events)
    made.clear()
    for rtol in TOLERANCES:
        lg.integrate(model, (0.0, 3.0), rtol=rtol, events=events)
    series = [text for text in made if "@taylor_jet(" in text]
    assert 8 < len(series) == len(dict.fromkeys(series))
    assert not any("@taylor_steps(" in text for text in made)


def test_a_run_with_the_same_events_and_resets_compiles_nothing(made: list[str]) -> None:
    """What is watched, the resets and the series with the events are each compiled once for a model and its events."""
    theta = lg.coordinate("theta")
    model = unit_pendulum().compile(check=False)
    for again in (False, True):
        made.clear()
        stops = [lg.Event(theta - 0.5), lg.Event(theta + 0.5, direction=-1, reset={theta.dot: -theta.dot})]
        lg.integrate(model, (0.0, 3.0), rtol=1e-9, events=stops)
        assert (made == []) is again


def oscillators(dimension: int) -> lg.System:
    """Return as many as there are coordinates."""
    q = [lg.coordinate(f"q{i}") for i in range(dimension)]
    kinetic, potential = sum(one.dot**2 for one in q) / 2, sum(one**2 for one in q) / 2
    return lg.System(kinetic=kinetic, potential=potential, coordinates=q, name=f"{dimension} oscillators")


@pytest.mark.slow
def test_what_is_done_at_events_is_compiled_once_for_all_layouts(
    made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Quickly by the first loop of a process, and well by the first that is compiled well."""
    monkeypatch.setattr(tiers, "STEPS", 40)
    compiled_steps.cache_clear()
    _events.cache_clear()
    # Engines that are in use call the functions that were just given up.
    engine._ENGINES.clear()
    found = []
    for dimension in (1, 2, 3):
        system = oscillators(dimension)
        q = system.coordinates[0]
        model = system.compile(check=False)
        ends = [lg.integrate(model, (0.0, 60.0), {q: 1.0}, rtol=1e-9, events=[lg.Event(q)]) for _ in range(3)]
        times = [end.t_events[0].tobytes() for end in ends]
        assert len(ends[0].t_events[0]) == 19 and times[1:] == times[:-1]
        found.append([sum(re.search(kind, text) is not None for text in made) for kind in (INSPECTS, STEPS)])
    assert found == [[2, 2], [2, 4], [2, 6]]
