"""Deriving and compiling before a run end at `max_wall`, wherever they are."""

from __future__ import annotations

import math
import time
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.statement import preparation

q, u = lg.coordinates("q u")
FACTORS = sympy.prod([sympy.cos(q / k) for k in range(1, 7)])


@dataclass
class Clock:
    """A clock that works for some readings and is late by 30 years from then on."""

    left: float
    readings: int = 0

    def perf_counter(self) -> float:
        self.readings += 1
        self.left -= 1
        return time.perf_counter() + (1e9 if self.left < 0 else 0.0)


def wide(*, constrained: bool) -> lg.System:
    """Return a system with a long right-hand side, and a longer series."""
    rail = [u - q**2 / 8] if constrained else []
    return lg.System(q.dot**2 / 2 + u.dot**2 / 2, FACTORS + u, constraints=rail, initial={q.dot: 0.5})


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Let small systems look at the clock often."""
    for place in ("graph.node", "program.recurrence", "program.lower"):
        monkeypatch.setattr(f"lagrange.{place}.CHECKED_EVERY", 8)
    return monkeypatch


@pytest.mark.parametrize(
    ("method", "constrained"), [("taylor", False), ("taylor", True), ("radau5", False), ("scipy-lsoda", True)]
)
def test_preparation_ends_at_the_limit_wherever_it_is(
    method: str, constrained: bool, often: pytest.MonkeyPatch
) -> None:
    """The time was first looked at when everything was compiled: 599 factors took 72 s with max_wall=5."""
    wide(constrained=constrained).run(1.0, method=method)  # the same text is compiled once, and then comes from a cache
    clock = Clock(math.inf)
    with often.context() as patch:
        patch.setattr(preparation, "time", clock)
        whole = wide(constrained=constrained).run(1.0, method=method, max_wall=60.0)
    assert whole.status is lg.Status.SUCCESS
    assert clock.readings > 20
    for place in np.linspace(0, clock.readings - 1, 4).astype(int).tolist():
        system = wide(constrained=constrained)
        with often.context() as patch:
            patch.setattr(preparation, "time", Clock(place))
            try:
                run = system.run(1.0, method=method, max_wall=60.0)
            except lg.RunError as refusal:  # its equations are not known: no run is there to have a status
                message = str(refusal)
            else:
                message = run.message
                assert run.status is lg.Status.MAX_WALL and run.steps == 0
                assert run.t.tolist() == [0.0] and run.at(0.0).tolist() == run.y[:, 0].tolist()
        assert "Compiling was ended after 1e+09 s, more than max_wall = 60 s" in message and len(message) <= 400
        # What a preparation leaves behind serves the next one.
        again = system.run(1.0, method=method, max_wall=60.0)
        assert again.final == whole.final and again.steps == whole.steps


def test_a_run_that_ends_before_its_first_step_has_its_outputs_and_events(often: pytest.MonkeyPatch) -> None:
    system = wide(constrained=False)
    system.compile()
    often.setattr(preparation, "time", Clock(2))
    run = system.run(1.0, t_eval=[0.5, 1.0], events=[q - 0.2], max_wall=60.0)
    assert run.status is lg.Status.MAX_WALL and run.y.shape == (4, 0)
    assert [len(times) for times in run.t_events] == [0]


def test_steps_are_not_limited_by_the_time_of_preparation(often: pytest.MonkeyPatch) -> None:
    """What a run compiles on its way, such as code with optimization, is not preparation."""
    with preparation.preparation(0.0, 1e-9):
        with pytest.raises(preparation.PreparationTooLongError):
            preparation.check_time()
        preparation.preparation_ends()
        preparation.check_time()
    seen: list[float] = []
    system = wide(constrained=False)

    def in_a_step(t: float) -> None:
        often.setattr(preparation, "time", Clock(0))
        preparation.check_time()
        seen.append(t)

    with often.context() as patch:
        patch.setattr("lagrange.trajectory.run.progress_bar", lambda *_, **__: nullcontext(in_a_step))
        run = system.run(1.0, max_wall=60.0, progress=True)
    assert run.status is lg.Status.SUCCESS and seen
