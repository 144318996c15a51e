"""Behind the last step of a run: Ctrl-C there, events of a run that failed at once, and what the message adds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import Abs, Rational, sign

import lagrange as lg
from lagrange.trajectory.measures.stiffness import with_stiff_end
from lagrange.trajectory.outputs import AcceptedStates
from tests.trajectory.runs import OUTSIDE
from tests.trajectory.test_contacts import METHODS, STEPS

x = lg.coordinate("x")
OSCILLATOR = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1})


def pressed_once(function: Any) -> Any:
    """Return the function, at whose first call somebody presses Ctrl-C."""
    calls: list[int] = []

    def called(*given: Any, **named: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return function(*given, **named)

    return called


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("where", ["states", "cause"])
def test_ctrl_c_behind_the_last_step_keeps_the_run(method: str, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {"method": method, "step": STEPS.get(method), "events": [x]}
    plain = OSCILLATOR.run(10, **given)
    if where == "states":
        monkeypatch.setattr(AcceptedStates, "joined", pressed_once(AcceptedStates.joined))
    else:
        monkeypatch.setattr("lagrange.trajectory.run.with_stiff_end", pressed_once(with_stiff_end))
    found = OSCILLATOR.run(10, **given)
    assert found.status is lg.Status.INTERRUPTED
    assert found.message.startswith(f"{method} was interrupted at t = 10 on the way from 0 to 10; what was computed")
    assert np.array_equal(found.y, plain.y) and np.array_equal(found.t_events[0], plain.t_events[0])
    assert OSCILLATOR.run(10, **given).status is lg.Status.SUCCESS


def test_a_run_that_fails_at_its_start_has_no_times_for_each_event() -> None:
    sliding = lg.System(kinetic=x.dot**2 / 2, forces={x: -x.dot / Abs(x.dot)})
    for method in ("taylor", "dop853"):
        failed = sliding.run(1, method=method, events=[x, x.dot])
        late = OSCILLATOR.run(1e7, method=method, events=[x, x.dot], max_wall=1e-9)
        assert failed.status is lg.Status.NON_FINITE and late.status is lg.Status.MAX_WALL
        for found in (failed, late):
            assert [len(times) for times in found.t_events] == [0, 0]
            assert [states.shape for states in found.y_events] == [(0, 2), (0, 2)]


@pytest.mark.parametrize("method", METHODS)
def test_an_event_behind_the_last_output_is_said(method: str) -> None:
    stop = lg.event(x, terminal=True)
    found = OSCILLATOR.run(9, method=method, step=STEPS.get(method), t_eval=[0, 1, 2], events=[stop])
    assert found.status is lg.Status.EVENT and found.t.tolist() == [0.0, 1.0]
    assert found.message.endswith("The last output before it is at t = 1; y_events has the state at the event.")
    none = OSCILLATOR.run(9, method=method, step=STEPS.get(method), t_eval=[3], events=[stop])
    assert none.message.endswith("No output lies before it; y_events has the state at the event.")


def test_events_that_fill_the_memory_are_named() -> None:
    found = OSCILLATOR.run(1e5, max_memory=1e5, t_eval=np.linspace(0, 1e5, 50), events=[x])
    assert found.status is lg.Status.MAX_MEMORY and "it keeps every step" not in found.message
    assert "The times and states of its events have used up max_memory = 100000 bytes." in found.message


@pytest.mark.parametrize(("method", "limit"), [("dop853", 3000), ("radau5", 100)])
def test_tiny_steps_where_a_body_sticks_are_explained(method: str, limit: int) -> None:
    sticking = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: -sign(x.dot) / 10}, initial={x: 1})
    found = sticking.run(50, method=method, max_steps=limit)
    assert found.status is lg.Status.MAX_STEPS
    assert "as with sign(v), a body may stick, in tiny steps: smooth the jump by tanh(v/0.001)" in found.message
    assert ("such as radau5" in found.message) == (method != "radau5")
    smooth = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: -x.dot * Rational(1, 10)}, initial={x: 1})
    assert "sign(v)" not in smooth.run(50, method=method, max_steps=9).message


ADAPTIVE = ("bs3", "dopri5", "tsit5", "verner9", "dop853", "radau3", "radau5")


@pytest.mark.few
@pytest.mark.parametrize("method", [*ADAPTIVE, *(name for name in ("scipy-radau", "scipy-rk23") if name in OUTSIDE)])
def test_a_body_that_sticks_is_named_long_before_the_step_limit(method: str) -> None:
    """At v = 0 friction of either sign leads back: dop853 took ten million steps, and spoke of the step limit."""
    sticking = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: -sign(x.dot) * 3 / 10}, initial={x: 1})
    found = sticking.run(20, method=method)
    assert found.status is lg.Status.STEP_TOO_SMALL and found.steps < 50_000
    assert "switch where x_dot is zero, and at t = 6.28" in found.message and "both sides lead back" in found.message


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("method", ["radau3", "radau5"])
def test_an_implicit_step_without_a_solution_names_the_surface_that_holds_a_body(method: str, unit: float) -> None:
    """A block slides to a halt: the equations of a step over it have no solution, and Newton's method diverges."""
    block = lg.System(
        kinetic=x.dot**2 / 2, potential=0, coordinates=[x], forces={x: -sign(x.dot) * 7 / 10}, initial={x.dot: unit}
    )
    found = block.run(5 * unit, method=method)
    assert found.status is lg.Status.STEP_TOO_SMALL
    assert "switch where x_dot is zero" in found.message and "both sides lead back" in found.message


@pytest.mark.parametrize("method", [name for name in ("scipy-lsoda", "scipy-dop853") if name in OUTSIDE])
def test_an_entry_without_a_tolerance_is_named(method: str) -> None:
    failed = OSCILLATOR.run(5, method=method, rtol=1e-9, atol=0.0)
    assert not failed.status.complete
    assert "x_dot is 0, and atol = 0 leaves it no tolerance: leave atol out" in failed.message
