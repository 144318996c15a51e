"""Limits of time and memory: how a run ends at a limit, and which states it keeps."""

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sympy import Abs, sign

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.statement import display
from lagrange.trajectory import slow_runs
from lagrange.trajectory.measures.stiffness import with_stiff_end
from lagrange.trajectory.methods.registry import find, names
from lagrange.trajectory.outputs import AcceptedStates
from lagrange.trajectory.plan import Planned
from tests.systems import unit_pendulum
from tests.trajectory.runs import OUTSIDE
from tests.trajectory.test_constraint_forces import CONTACT_METHODS, STEPS


@pytest.fixture(scope="module")
def model() -> Model:
    return unit_pendulum().compile()


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [name for name in names() if isinstance(find(name), Planned)])
def test_memory_has_a_bound(name: str, model: Model) -> None:
    step: dict[str, Any] = {} if find(name).claims.adaptive else {"step": 0.01}
    result = lg.integrate(model, (0.0, 1e5), method=name, max_memory=20_000, **step)
    assert result.status is lg.Status.MAX_MEMORY
    assert f"{name} used up max_memory = 20000 bytes at t = " in result.message
    assert "Raise max_memory, end the run earlier" in result.message
    assert 10 < len(result.t) == result.steps + 1 and result.t[-1] < 1e5
    assert result.t.nbytes + result.y.nbytes <= 20_000 + 24  # the first state is there in any case
    result.at(result.t[-1] / 2)
    with pytest.raises(lg.RunError, match="max_memory"):
        result.require()


@pytest.mark.parametrize("method", ["taylor", "dop853", "scipy-dop853"])
def test_compiling_counts(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """`max_wall` includes the time of compilation, not only that of steps."""
    monkeypatch.setattr(slow_runs, "COMPILE_SECONDS", 0.0)
    system = unit_pendulum()
    system.compile()
    result = system.run(1.0, method=method, max_wall=1e-9)
    assert result.status is lg.Status.MAX_WALL
    assert f"{method} stopped at t = 0 on the way from 0 to 1. Compiling took " in result.message
    assert "more than max_wall = 1e-09 s. What is compiled stays with the model" in result.message
    assert result.steps == 0 and result.t.tolist() == [0.0]
    monkeypatch.undo()
    assert system.run(1.0, method=method, max_wall=60.0).status is lg.Status.SUCCESS


def test_a_short_limit_leaves_time_to_compile() -> None:
    result = unit_pendulum().run(1e7, method="verner9", max_wall=0.2)
    assert result.status is lg.Status.MAX_WALL and result.steps > 0
    assert "used up max_wall = 0.2 s at t = " in result.message


class Terminal:
    """A text stream that claims to be a terminal."""

    def __init__(self) -> None:
        self.text = ""

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> None:
        self.text += text

    def flush(self) -> None:
        """Do nothing: there is no buffer."""


SLOW: dict[str, tuple[str, Callable[[], Any]]] = {
    "reading bob": ("lagrange.system.equations_of", lambda: lg.System(lg.coordinate("u").dot ** 2, name="bob")),
    "compiling pendulum": ("lagrange.compiler.quick_check", lambda: lg.scene("pendulum").compile()),
    "deriving linear equations of pendulum": (
        "lagrange.mechanics.linearization.check",
        lambda: lg.scene("pendulum").linearize(),
    ),
}
"""What takes long, a function on its way, and the call."""


@pytest.mark.parametrize("what", SLOW)
def test_a_terminal_is_told_what_takes_so_long(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(display, "SILENT_SECONDS", 0.01)

    def slow(*_: object, **__: object) -> str:
        until = time.monotonic() + 600.0
        while not terminal.text and time.monotonic() < until:
            time.sleep(0.01)
        return "done"

    place, work = SLOW[what]
    monkeypatch.setattr(place, slow)
    work()
    assert terminal.text.startswith(f"\r{what}: 0 s")
    assert terminal.text.endswith(" \r"), "the line is taken away"


def test_a_pipe_is_told_nothing(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(display, "SILENT_SECONDS", 0.0)
    unit_pendulum().run(0.1, progress=True)
    assert capfd.readouterr() == ("", "")


# --- behind the end -------------------------------------------------------------------------------------------
# Behind the last step of a run: Ctrl-C there, events of a run that failed at once, and what the message adds.

x = lg.coordinate("x")
OSCILLATOR = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1})


def pressed_once(function: Any) -> Any:
    """Return the function with a KeyboardInterrupt at its first call."""
    calls: list[int] = []

    def called(*arguments: Any, **named: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return function(*arguments, **named)

    return called


@pytest.mark.parametrize("method", CONTACT_METHODS)
@pytest.mark.parametrize("where", ["states", "cause"])
def test_ctrl_c_behind_the_last_step_keeps_the_run(method: str, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {"method": method, "step": STEPS.get(method), "events": [x]}
    plain = OSCILLATOR.run(10, **given)
    if where == "states":
        monkeypatch.setattr(AcceptedStates, "joined", pressed_once(AcceptedStates.joined))
    else:
        monkeypatch.setattr("lagrange.trajectory.run.with_stiff_end", pressed_once(with_stiff_end))
    result = OSCILLATOR.run(10, **given)
    assert result.status is lg.Status.INTERRUPTED
    assert result.message.startswith(f"{method} was interrupted at t = 10 on the way from 0 to 10; what was computed")
    assert np.array_equal(result.y, plain.y) and np.array_equal(result.t_events[0], plain.t_events[0])
    assert OSCILLATOR.run(10, **given).status is lg.Status.SUCCESS


def test_a_run_that_fails_at_its_start_has_no_times_for_each_event() -> None:
    sliding = lg.System(kinetic=x.dot**2 / 2, forces={x: -x.dot / Abs(x.dot)})
    for method in ("taylor", "dop853"):
        failed = sliding.run(1, method=method, events=[x, x.dot])
        late = OSCILLATOR.run(1e7, method=method, events=[x, x.dot], max_wall=1e-9)
        assert failed.status is lg.Status.NON_FINITE and late.status is lg.Status.MAX_WALL
        for result in (failed, late):
            assert [len(times) for times in result.t_events] == [0, 0]
            assert [states.shape for states in result.y_events] == [(0, 2), (0, 2)]


@pytest.mark.parametrize("method", CONTACT_METHODS)
def test_an_event_behind_the_last_output_is_said(method: str) -> None:
    stop = lg.event(x, terminal=True)
    result = OSCILLATOR.run(9, method=method, step=STEPS.get(method), t_eval=[0, 1, 2], events=[stop])
    assert result.status is lg.Status.EVENT and result.t.tolist() == [0.0, 1.0]
    assert result.message.endswith("The last output before the event is at t = 1; y_events has the state at the event.")
    none = OSCILLATOR.run(9, method=method, step=STEPS.get(method), t_eval=[3], events=[stop])
    assert none.message.endswith("No output is before the event; y_events has the state at the event.")


def test_events_that_fill_the_memory_are_named() -> None:
    result = OSCILLATOR.run(1e5, max_memory=1e5, t_eval=np.linspace(0, 1e5, 50), events=[x])
    assert result.status is lg.Status.MAX_MEMORY and "it keeps every step" not in result.message
    assert "The times and states of its events have used up max_memory = 100000 bytes." in result.message


ADAPTIVE = ("bs3", "dopri5", "tsit5", "verner9", "dop853", "radau3", "radau5")


@pytest.mark.few
@pytest.mark.parametrize("method", [*ADAPTIVE, *(name for name in ("scipy-radau", "scipy-rk23") if name in OUTSIDE)])
def test_a_body_that_sticks_is_named_long_before_the_step_limit(method: str) -> None:
    """At v = 0 friction of both signs leads back. dop853 took ten million steps and reported the step limit."""
    sticking = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, forces={x: -sign(x.dot) * 3 / 10}, initial={x: 1})
    result = sticking.run(20, method=method)
    assert result.status is lg.Status.STEP_TOO_SMALL and result.steps < 50_000
    assert "jump where x_dot is zero, and from t = 6.28" in result.message and "from both sides" in result.message


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("method", ["radau3", "radau5"])
def test_an_implicit_step_without_a_solution_names_the_surface_that_holds_a_body(method: str, unit: float) -> None:
    """A block stops by friction.

    The equations of a step over this time have no solution, and Newton's method diverges.
    """
    block = lg.System(
        kinetic=x.dot**2 / 2, potential=0, coordinates=[x], forces={x: -sign(x.dot) * 7 / 10}, initial={x.dot: unit}
    )
    result = block.run(5 * unit, method=method)
    assert result.status is lg.Status.STEP_TOO_SMALL
    assert "jump where x_dot is zero" in result.message and "from both sides" in result.message


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_motion_faster_than_the_spacing_of_times_ends_at_once(method: str) -> None:
    """At t = 1e9 doubles are 1.2e-7 apart, and a period is 6e-9."""
    fast = lg.System(kinetic=x.dot**2 / 2, potential=10**18 * x**2 / 2, initial={x: 1}).compile()
    result = lg.integrate(fast, (1e9, 1e9 + 1), method=method, max_steps=100)
    assert result.status is lg.Status.STEP_TOO_SMALL


@pytest.mark.parametrize("method", [name for name in ("scipy-lsoda", "scipy-dop853") if name in OUTSIDE])
def test_an_entry_without_a_tolerance_is_named(method: str) -> None:
    failed = OSCILLATOR.run(5, method=method, rtol=1e-9, atol=0.0)
    assert not failed.status.complete
    assert "x_dot is 0, and with atol = 0 its tolerance is zero: leave atol out" in failed.message
