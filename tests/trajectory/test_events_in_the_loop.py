"""Events handled by the compiled loop over Taylor steps equal those that Python handles."""

from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from sympy import Abs, Max, Piecewise, Rational, atan2, cos, lambdify, sign, sin, sqrt

from lagrange.machine.drivers import EventMemory
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.events.end_messages import EventResult
from lagrange.trajectory.events.event_log import Occurrences
from lagrange.trajectory.events.series_watch import SeriesWatch
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import LLVM_FIRST, TARGETS, build, x, y
from tests.trajectory.runs import run

ON_MACHINES = [
    *((seed, "llvm") for seed in range(40)),
    *(pytest.param(seed, "numpy", marks=pytest.mark.slow) for seed in range(12)),
]
"""Seeds and targets: an interpreted run takes many times as long, and finds what the first seeds find on llvm."""


def random_model(chance: np.random.Generator, target: str) -> Model:
    """Return two masses in a potential well with random terms of low order."""
    a, b, c, d = (Rational(int(k), 10) for k in chance.integers(-5, 6, 4))
    well = (x**2 + y**2) / 2 + x**4 / 4 + y**4 / 4
    return build(
        target,
        kinetic=(x.dot**2 + (2 + cos(x)) * y.dot**2) / 2,
        potential=well + a * x * y + b * x**2 * y + c * x * y**2 + d * x,
        initial=dict(zip((x, y, x.dot, y.dot), chance.uniform(-0.6, 0.6, 4).tolist(), strict=True)),
    )


def random_events(chance: np.random.Generator) -> list[Any]:
    """Return one to four random events, some with resets, some of which end the run."""
    level = Rational(int(chance.integers(-3, 4)), 10)
    functions = [y - level, x - y, x.dot, x**2 + y**2 - Rational(1, 10), sin(3 * t), x * y.dot - y * x.dot, x + level]
    result = []
    for k in chance.permutation(len(functions))[: chance.integers(1, 5)]:
        options: dict[str, Any] = {"direction": int(chance.integers(-1, 2))}
        if chance.random() < 0.3:
            options["reset"] = {x.dot: -x.dot * Rational(9, 10), y.dot: y.dot + level / 4}
        if chance.random() < 0.2:
            options["terminal"] = int(chance.integers(2, 9))
        result.append(event(functions[k], **options))
    return result


def changed_in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let Python handle all resets, all crossings of switching surfaces, and the signs at the start."""
    write = SeriesWatch.write

    def begun(self: SeriesWatch, state: DriverState) -> EventResult:
        self.state = state
        return self._begin(state)

    def left(self: SeriesWatch) -> None:
        write(self)
        self.memory.record.checked, self.memory.record.combination = 1, -1

    monkeypatch.setattr(SeriesWatch, "write", left)
    monkeypatch.setattr(SeriesWatch, "begin", begun)


def assert_zeros(result: Trajectory, events: list[Any]) -> None:
    """Assert that events without resets are the zeros of the dense output in the counted directions."""
    if any(item.reset for item in events):
        return
    times = np.linspace(*result.span, 4001)
    symbols = (t, x, y, x.dot, y.dot)
    for item, at, there in zip(events, result.t_events, result.y_events, strict=True):
        g = lambdify(symbols, item.expression, "numpy")
        # A zero is where rounding and the tolerance of 1e-9 of the run put it; slopes are at most some 10.
        assert g(at, *there.T) == pytest.approx(np.zeros(len(at)), abs=1e-7)
        signs = np.sign(g(times, *result.dense(times)))
        turns = np.flatnonzero(signs[:-1] * signs[1:] < 0)
        expected = [i for i in turns if item.direction in (0, signs[i + 1])]
        # Two zeros between neighbouring times are not seen in their values.
        assert len(at) >= len(expected)
        assert all(((times[i] - at) * (times[i + 1] - at) <= 1e-9).any() for i in expected)


def assert_same(ours: Trajectory, theirs: Trajectory) -> None:
    assert ours.status is theirs.status and ours.message == theirs.message
    assert [len(times) for times in ours.t_events] == [len(times) for times in theirs.t_events]
    # Both take the same steps, and round the coefficients otherwise: a grazing root is known to the root of round-off.
    for first, second in zip((*ours.t_events, *ours.y_events), (*theirs.t_events, *theirs.y_events), strict=True):
        assert first == pytest.approx(second, rel=1e-8, abs=1e-8)
    begin, end = theirs.span
    times = np.linspace(begin, end, 50)
    assert ours.span == pytest.approx(theirs.span, rel=1e-10)
    assert ours.dense(times) == pytest.approx(theirs.dense(times), rel=1e-9, abs=1e-9)
    assert ours.y[:, -1] == pytest.approx(theirs.y[:, -1], rel=1e-9, abs=1e-9)


@pytest.mark.few(2)
@pytest.mark.parametrize(("seed", "target"), ON_MACHINES)
def test_random_events(seed: int, target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    chance = np.random.default_rng(seed)
    compiled, events = random_model(chance, target), random_events(chance)
    end = float(chance.choice([12.0, -12.0]))
    times = np.sort(chance.uniform(0, abs(end), 20)) * np.sign(end)
    ours = run(compiled, end, "taylor", events=events)
    shown = run(compiled, end, "taylor", events=events, t_eval=times)
    assert_zeros(ours, events)
    changed_in_python(monkeypatch)
    assert_same(ours, run(compiled, end, "taylor", events=events))
    assert_same(shown, run(compiled, end, "taylor", events=events, t_eval=times))


def random_switches(chance: np.random.Generator, target: str) -> Model:
    """Return two masses with one-sided springs, contacts, and dry friction."""
    level, stiff = Rational(int(chance.integers(-3, 4)), 10), Rational(int(chance.integers(1, 9)), 2)
    spring = Piecewise((stiff * (x - level) ** 2, x > level), (0, True))
    contact = Abs(y - x / 2) if chance.random() < 0.5 else Max(y, level) ** 2
    friction = {x: -sign(x.dot) / 20} if chance.random() < 0.5 else {}
    return build(
        target,
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=(x**2 + y**2) / 2 + spring + contact,
        forces=friction,
        initial=dict(zip((x, y, x.dot, y.dot), chance.uniform(-0.9, 0.9, 4).tolist(), strict=True)),
    )


@pytest.mark.few(2)
@pytest.mark.parametrize(("seed", "target"), ON_MACHINES)
def test_random_switches(seed: int, target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    chance = np.random.default_rng(100 + seed)
    compiled, events = random_switches(chance, target), random_events(chance)
    times = np.sort(chance.uniform(0, 8.0, 20))
    ours = run(compiled, 8.0, "taylor", events=events)
    shown = run(compiled, 8.0, "taylor", t_eval=times)
    changed_in_python(monkeypatch)
    assert_same(ours, run(compiled, 8.0, "taylor", events=events))
    plain = run(compiled, 8.0, "taylor")
    assert_same(shown, run(compiled, 8.0, "taylor", t_eval=times))
    assert shown.y == pytest.approx(plain.dense(shown.t), rel=1e-10, abs=1e-10)


def counted(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a list to which the time of each call of Python is appended."""
    calls: list[float] = []
    read = SeriesWatch.read

    def noted(self: SeriesWatch, state: DriverState) -> None:
        calls.append(state.t)
        read(self, state)

    monkeypatch.setattr(SeriesWatch, "read", noted)
    return calls


def test_the_loop_comes_back_for_nothing_that_is_regular(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a section and a reflecting wall, Python is called only at the start and the end."""
    calls = counted(monkeypatch)
    wall = event(x - Rational(1, 2), direction=1, reset={x.dot: -x.dot})
    well = build(kinetic=(x.dot**2 + y.dot**2) / 2, potential=x**2 / 2 + y**2, initial={x: 0.4, x.dot: 1.0, y: 0.3})
    result = run(well, 300.0, "taylor", events=[wall, event(y)])
    assert result.status is Status.SUCCESS and sum(map(len, result.t_events)) > 150
    assert len(calls) < 40


def test_an_event_on_a_surface_counts_in_its_direction() -> None:
    """A step that ends on a surface may end just before or after an event at the same place."""
    kepler = build("llvm", kinetic=(x.dot**2 + y.dot**2) / 2, potential=-1 / sqrt(x**2 + y**2))
    angle = atan2(y.dot, x)
    rises, falls = event(angle, direction=1), event(angle, direction=-1)
    kinked = Piecewise((x, y.dot > 0), (2 * x, True)) - 5
    for speed in np.linspace(0.7, 0.95, 8):
        start = {x: 1.0, y: 0.0, x.dot: 0.0, y.dot: float(speed)}
        alone = run(kepler, 20.0, "taylor", initial=start, events=[rises, falls], rtol=1e-9)
        there = run(kepler, 20.0, "taylor", initial=start, events=[rises, falls, kinked], rtol=1e-9)
        expected = list(map(len, alone.t_events))
        assert min(expected) >= 3 and list(map(len, there.t_events))[:2] == expected


@pytest.mark.parametrize("where", [(Occurrences, "extend"), (EventMemory, "forget")])
@pytest.mark.parametrize("late", [False, True])
def test_an_interruption_while_events_are_taken_over_neither_loses_nor_repeats_any(
    where: tuple[Any, str], late: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    oscillator = build("llvm", kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1.0})
    real, calls = getattr(*where), []

    def interrupted(self: Any, *arguments: Any) -> None:
        calls.append(arguments)
        if not late and len(calls) == 4:
            raise KeyboardInterrupt
        real(self, *arguments)
        if late and len(calls) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(*where, interrupted)
    result = run(oscillator, 1e6, "taylor", events=[x, x.dot])
    end = float(result.t[-1])
    assert result.status is Status.INTERRUPTED and len(calls) >= 4
    for times, phase in zip(result.t_events, (math.pi / 2, math.pi), strict=True):
        expected = np.arange(phase, end, math.pi)
        assert times == pytest.approx(expected, rel=1e-9)


STARTS = {
    "leaves at once": ({x: 0.0, x.dot: 0.3, y: 0.4, y.dot: 0.1}, [x, event(x, direction=-1), event(x, terminal=2)]),
    "leaves with an acceleration": ({x: 0.5, x.dot: 0.0, y: 0.4, y.dot: 0.0}, [x.dot, y.dot, event(x.dot - y.dot)]),
    "turns back there": ({x: 0.0, x.dot: 0.0, y: 0.4, y.dot: 0.1}, [x, x.dot, x * y]),
    "stays there": ({x: 0.0, x.dot: 0.0, y: 0.0, y.dot: 0.4}, [x, y, x.dot]),
    "is not reset there": (
        {x: 0.0, x.dot: 0.3, y: 0.4, y.dot: 0.1},
        [event(x, direction=-1, reset={x.dot: -x.dot}), x * (y + 1)],
    ),
}


@pytest.mark.parametrize("case", STARTS)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("end", [7.0, -7.0])
def test_events_that_are_zero_at_the_start(case: str, target: str, end: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop determines the signs at the start itself, unless a reset is due there."""
    calls = counted(monkeypatch)
    initial, events = STARTS[case]
    if end < 0 and case == "is not reset there":
        initial = {**initial, x.dot: -0.3}
    well = (x**2 + 2 * y**2) / 2 + x**4 / 4
    compiled = build(target, kinetic=(x.dot**2 + y.dot**2) / 2, potential=well, initial=initial)
    ours = run(compiled, end, "taylor", events=events)
    assert 0.0 not in calls
    assert ours.status is (Status.EVENT if case == "leaves at once" else Status.SUCCESS)
    changed_in_python(monkeypatch)
    assert_same(ours, run(compiled, end, "taylor", events=events))


@pytest.mark.parametrize("change", [{}, {"reset": {x.dot: -x.dot}}, {"terminal": 1}])
@pytest.mark.parametrize("target", LLVM_FIRST)
def test_events_on_a_step_that_its_defect_refuses_have_not_happened(
    change: dict[str, Any], target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From x = 0 the series is a straight line that crosses x = 5, but a wall reflects the motion at x = 1.1."""
    wall = build(target, kinetic=x.dot**2 / 2, potential=x**40, initial={x: 0.0, x.dot: 1.0})
    events = [event(x - 5, **change), x - Rational(1, 2), x + 5]
    ours = run(wall, 6.0, "taylor", events=events, rtol=1e-6)
    assert [len(times) for times in ours.t_events] == [0, 4, 0] and ours.rejected > 0
    changed_in_python(monkeypatch)
    assert_same(ours, run(wall, 6.0, "taylor", events=events, rtol=1e-6))


SMALL_STACK = """
import threading
import lagrange as lg
from sympy import Rational

x = lg.coordinates("x y")[0]
model = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, coordinates=[x]).compile()
events = [lg.event(x - Rational(i, 100), reset={x.dot: x.dot} if i == 0 else None) for i in range(100)]

def count():
    solution = lg.integrate(model, (0.0, 10.0), {x: 1.0}, events=events)
    print(solution.status.name, sum(map(len, solution.t_events)))

count()
threading.stack_size(2**18)
thread = threading.Thread(target=count)
thread.start()
thread.join()
"""


@pytest.mark.slow
def test_many_events_fit_a_small_stack() -> None:
    """The 4 kB of memory for each event are not on the stack, which may be small in a thread."""
    done = subprocess.run([sys.executable, "-c", SMALL_STACK], capture_output=True, text=True, check=False)
    # x = cos(t) has each of the values from 0 to below 1 three times from t = 0 to 10.
    assert (done.returncode, done.stdout) == (0, "SUCCESS 300\nSUCCESS 300\n"), done.stderr


@pytest.mark.parametrize("place", [0, 1])
def test_the_message_names_the_function_whose_series_ends(place: int) -> None:
    free = build(kinetic=x.dot**2 / 2, coordinates=[x], initial={x.dot: 1.0})
    others = [event(x - 5), event(x - 6)]
    result = run(free, 3.0, "taylor", events=[*others[:place], event(1 / (x - 1)), *others[place:]])
    assert result.status is Status.NON_FINITE and result.t[-1] == pytest.approx(1.0, rel=1e-12)
    assert "The event function 1/(x - 1)" in result.message
