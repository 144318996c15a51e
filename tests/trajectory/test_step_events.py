"""Events of all methods: located on the dense output of steps, and by the compiled loop over Taylor steps."""

import math
import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import brentq
from sympy import Abs, Max, Piecewise, Rational, atan2, cos, exp, lambdify, log, sign, sin, sqrt, tan

from lagrange.machine.drivers import EventMemory
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.events.end_messages import EventResult
from lagrange.trajectory.events.event_log import Occurrences
from lagrange.trajectory.events.series_watch import SeriesWatch
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import LLVM_FIRST, TARGETS, build, x, y
from tests.trajectory.runs import (
    ADAPTIVE,
    FALL,
    FIXED,
    NAMES,
    OUTSIDE,
    STEPPED,
    WITHOUT_VALUE,
    G,
    ball,
    bounces,
    checked_run,
    floor,
    free,
    harmonic,
    run,
)

TIGHT: dict[str, dict[str, Any]] = {
    **{name: {"rtol": 1e-12, "atol": 1e-14} for name in ADAPTIVE},
    **{name: {"step": 1e-3} for name in FIXED},
    **{name: {"rtol": 1e-9, "atol": 1e-11} for name in OUTSIDE},
}
SHARP = [name for name in ("rk4", "dopri5", "tsit5", "verner9", "dop853", "gauss2", "gauss3") if name in NAMES]
"""Methods whose errors at the settings above stay below 1e-9 over some tens of time units."""


def go(model: Model, end: float, events: Any, name: str, start: float = 0.0, **options: Any) -> Trajectory:
    """Return a run with tight tolerances and events, after checks that every result must pass."""
    return checked_run(model, end, events, start, name, **{**TIGHT[name], **options})


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["taylor", *SHARP, "verlet"])
def test_grazing_turns_of_a_pendulum(name: str) -> None:
    """The pendulum passes 1 - eps twice at each return. SciPy's DOP853 finds 1 to 11 of these 15 crossings."""
    model = build(kinetic=x.dot**2 / 2, potential=-cos(x), initial={x: 1.0})
    for depth in range(1, 9 if name == "taylor" else 7):
        eps = 10.0**-depth
        times = go(model, 50.0, [x - (1 - eps)], name).t_events[0]
        assert len(times) == 15, (name, eps)
        apart = math.sqrt(8 * eps / math.sin(1))
        # Verlet's amplitude is off by some h**2 = 1e-6 times a tenth, and eps with it.
        off = {"verlet": 0.2e-6, "taylor": 1e-11}.get(name, 1e-10)
        assert np.diff(times)[1::2] == pytest.approx(apart, rel=0.5 * eps + off / eps)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["taylor", *STEPPED, *OUTSIDE])
def test_directions_starts_and_ends(name: str, target: str) -> None:
    """A zero at the start is no event, a zero at the end is one. The motion x = t is exact for all methods."""
    options = {} if find(name).claims.adaptive else {"step": 0.07}
    events = [
        x,
        event(x, terminal=True),
        x - 1,
        event(x - 1, direction=1),
        event(x - 1, direction=-1),
        (x - 0.5) ** 2,
        event((x - 0.5) ** 2, direction=1),
        x - 2,
        t - 1.4,
        x.dot - 2,
    ]
    result = go(free(target), 2.0, events, name, **options)
    ones = pytest.approx([1.0], rel=1e-13)
    # A double root is as uncertain as the square root of round-off.
    touch, last = pytest.approx([0.5], abs=1e-6), pytest.approx([2.0], rel=1e-13)
    at = pytest.approx([1.4])
    assert [list(times) for times in result.t_events] == [[], [], ones, ones, [], touch, [], last, at, []]
    assert result.y_events[2][0] == pytest.approx([1.0, 1.0], rel=1e-13) and result.status is Status.SUCCESS


@pytest.mark.parametrize("name", ["taylor", *STEPPED, *OUTSIDE])
@pytest.mark.parametrize(("terminal", "direction", "turns"), [(True, 0, 1), (1, -1, 1), (2, 1, 4), (3, 0, 3)])
def test_a_terminal_event_ends_the_run(terminal: int, direction: int, turns: int, name: str) -> None:
    """Steps beyond the terminal event are not stored."""
    result = go(harmonic(), 4000.0, [event(x, direction=direction, terminal=terminal), x.dot], name, max_steps=500_000)
    assert result.status is Status.EVENT and len(result.t_events[0]) == terminal and len(result.t_events[1]) == turns
    off = 1e-6 if name in OUTSIDE else {1: 2e-2, 2: 1e-5}.get(find(name).claims.order, 1e-9)
    assert result.t[-1] == result.t_events[0][-1] == result.span[1] == pytest.approx(turns * math.pi, abs=off)
    assert result.y[:, -1].tolist() == result.y_events[0][-1].tolist() and result.steps == len(result.t) - 1
    assert result.message.startswith(f"{name} stopped at an event at t = ")
    # The large weights of verner9, of both signs, make up to 7e-13 of the rounding of its slopes, at 80 tolerances.
    off = 1e-12 if name == "verner9" else 5e-14
    assert result.dense(result.t[-1:])[:, 0] == pytest.approx(result.y[:, -1], abs=off)


@cache
def pendulum() -> Model:
    return build(kinetic=x.dot**2 / 2, potential=-cos(x), initial={x: 1.0})


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [*NAMES, *OUTSIDE])
def test_what_stays_zero_is_no_event(name: str) -> None:
    """The event is a conserved quantity minus its value, around which the dense output oscillates by its error."""
    model = pendulum()
    energy = x.dot**2 / 2 - cos(x) + cos(sp.Integer(1))
    options: dict[str, Any] = {} if find(name).claims.adaptive else {"step": 0.01}
    result = run(model, 4.0, name, events=[energy, event(energy, direction=1, terminal=True)], **options)
    assert result.status is Status.SUCCESS and [len(times) for times in result.t_events] == [0, 0]


@pytest.mark.parametrize("level", [0.0, 3.0, 6.4e6])
@pytest.mark.parametrize("restitution", [0.5, 0.9])
@pytest.mark.parametrize("name", ["taylor", "rk4", "dopri5", "dop853"])
def test_a_ball_comes_to_rest_in_words(name: str, restitution: float, level: float) -> None:
    """The ball never falls through the floor.

    Flights below the spacing of doubles have a velocity, but no height. Each may sink by some spacings, except with
    taylor.
    """
    options = {"taylor": {}, "rk4": {"step": 0.05}}.get(name, {"rtol": 1e-9, "atol": 1e-12})
    result = go(ball(height=level + 1), 100.0, [floor(restitution, level)], name, **options)
    end = FALL * (1 + restitution) / (1 - restitution)
    assert result.status is Status.STEP_TOO_SMALL and "comes to rest" in result.message
    spacing = 2.0**-52 * level
    off = 1e-13 * end + 3e-15 * level if name == "taylor" else 1e-11 + 10 * math.sqrt(spacing / G)
    assert result.t[-1] == pytest.approx(end, abs=off)
    assert result.y[0].min() >= level - (4e-15 + 20 * spacing if name == "taylor" else 4e-13 + 3000 * spacing)
    times = result.t_events[0]
    assert len(times) > 30 and times == pytest.approx(bounces(restitution, len(times)), abs=off)


def test_a_start_below_zero_by_rounding_is_the_level_to_come_back_to() -> None:
    """At a height of 1e12 a ball may be 1e-4 below the floor after a bounce, and must not meet the floor as it rises.

    Flights lower than that depend on rounding, and end the run.
    """
    result = go(ball(height=1e12 + 1), 60.0, [floor(0.5, 1e12)], "rk4", step=1e-3)
    assert 12 < len(result.t_events[0]) < 40 and np.diff(result.t_events[0]).min() > 0.03
    assert result.status is Status.STEP_TOO_SMALL and "too quickly for the steps of the method" in result.message


@pytest.mark.few
@pytest.mark.parametrize("name", ["taylor", "rk4", "dop853", *OUTSIDE])
def test_a_start_on_the_floor(name: str) -> None:
    """A ball that starts on the floor bounces at once if it falls, but not if it rises.

    A ball at rest gets a message.
    """
    falling = go(ball(height=0.0, speed=-2.0), 0.3, [floor(0.5)], name)
    assert list(falling.t_events[0]) == [0.0, pytest.approx(2 / G, rel=1e-10)]
    assert falling.y[:, 0].tolist() == [0.0, -2.0] and falling.y[:, 1].tolist() == [0.0, 1.0]
    rising = go(ball(height=0.0, speed=2.0), 0.3, [floor(0.5)], name)
    assert len(rising.t_events[0]) == 0 and rising.y[0, -1] == pytest.approx(0.6 - G * 0.09 / 2)
    for rest in (go(ball(), 2.0, [floor(0)], name), go(ball(height=0.0), 2.0, [floor(0.9)], name)):
        assert rest.status is Status.STEP_TOO_SMALL and len(rest.t_events[0]) == 1
        assert "is zero, its rate is zero, and the motion would cross zero" in rest.message
        assert "State the reset as a contact, as in contacts={'floor': lagrange.contact(gap=...)}" in rest.message


@pytest.mark.parametrize(("expression", "place", "words"), WITHOUT_VALUE)
@pytest.mark.parametrize("name", ["taylor", "rk4", "dop853", *OUTSIDE])
def test_an_event_without_a_value_ends_the_run_in_words(name: str, expression: Any, place: float, words: str) -> None:
    result = go(free(), 3.0, [expression, x - 0.25], name, **({"step": 0.11} if name == "rk4" else {}))
    assert result.status is Status.NON_FINITE and words in result.message and result.steps < 200
    assert "pole there or leaves its domain" in result.message or name == "taylor" or place == 0
    assert result.t[-1] == pytest.approx(place, abs=1e-7)
    assert len(result.t_events[1]) == (place > 0.25)


@pytest.mark.few
@pytest.mark.parametrize("name", ["taylor", "dop853", *OUTSIDE])
def test_resets_that_lead_nowhere(name: str) -> None:
    bad = go(free(), 3.0, [event(x - 1, reset={x.dot: log(-t * x)})], name)
    assert bad.t[-1] == pytest.approx(1.0)
    assert bad.status is Status.NON_FINITE and "The reset where x - 1 is zero gives a state that is nan" in bad.message
    polar = build(
        kinetic=(x.dot**2 + x**2 * y.dot**2) / 2, coordinates=[x, y], initial={x: 1.0, x.dot: -0.5, y.dot: 1.0}
    )
    singular = go(polar, 3.0, [event(x - 0.9, direction=-1, reset={x: 0})], name)
    assert singular.status is Status.SINGULAR and "the mass matrix is singular at t = " in singular.message
    edge = build(kinetic=x.dot**2 / 2, forces={x: sp.sqrt(1.5 - x)}, initial={x.dot: 1.0})
    outside = go(edge, 3.0, [event(x - 1, reset={x: 2})], name)
    assert outside.status is Status.NON_FINITE and "x" in outside.message
    assert outside.t[-1] == outside.t_events[0][0] and outside.y[0, -1] == 2


@pytest.mark.parametrize("name", ["taylor", "rk4", "dop853", *OUTSIDE])
@pytest.mark.parametrize(
    ("options", "status"), [({"max_steps": 100}, Status.MAX_STEPS), ({"max_wall": 0.03}, Status.MAX_WALL)]
)
def test_what_a_limit_cuts_off_has_not_happened(name: str, options: dict[str, Any], status: Status) -> None:
    result = go(free(), 1e6, [event(x - 1, reset={x: 0}), sin(20 * t)], name, **options)
    assert result.status is status and result.t[-1] < 1e5
    assert len(result.t_events[0]) == pytest.approx(result.t[-1], abs=1.1)
    assert len(result.t_events[1]) == pytest.approx(result.t[-1] * 20 / math.pi, abs=1.1)


# --- series ----------------------------------------------------------------------------------------------------
# Events on series: each zero of an expression along a run is found once, and resets act by their laws.

ON_A_SINE: list[Any] = [
    1.04 - 0.04 / (1 - 0.99 * x),
    log(x + 1.01) - 0.3,
    x**30 - sp.Rational(1, 1000),
    (2 * x) ** 30 - 1,
    tan(1.4 * x) - 3,
    sp.atan(50 * x) - 1,
    1 / (1 + 100 * x**2) - 0.5,
    exp(20 * x) - 5,
    sqrt(x + 1.1) - 1,
    x * x.dot - 0.4 * cos(3 * t),
    Abs(x) - 0.5,
    Max(x, x.dot) - 0.9,
    Piecewise((x - 0.25, x < 0.5), (0.75 - x, True)),
]


@pytest.mark.few(2)
@pytest.mark.parametrize("expression", ON_A_SINE, ids=str)
def test_the_zeros_are_those_of_a_dense_search(expression: Any) -> None:
    """The reference brackets the zeros of the closed form along x = sin t: near poles, high powers, kinks and a jump.

    Expressions have errors of up to 64 tolerances of 1e-10, so times have errors of 1e-8 divided by the slope.
    """

    def closed(when: float) -> float:
        return float(g(when, math.sin(when), math.cos(when)))

    g = sp.lambdify((t, x, x.dot), expression)
    grid = np.linspace(1e-3, 20.0, 40_001)
    values = g(grid, np.sin(grid), np.cos(grid))
    places = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) < 0)
    expected = [brentq(closed, grid[i], grid[i + 1], xtol=1e-15) for i in places]
    result = checked_run(harmonic(), 20.0, [expression])
    assert result.status is Status.SUCCESS
    assert result.t_events[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("factor", [1e-320, 1e-30, 1.0, 1e30, 1e300])
def test_the_size_of_an_event_is_no_matter(factor: float) -> None:
    result = checked_run(free(), 3.0, [sp.Float(factor) * (x - 1)])
    assert result.t_events[0] == pytest.approx([1.0], rel=1e-15)


# --- resets ---------------------------------------------------------------------------------------------------
# Resets at events: impacts by their laws, over thousands of them, and every end where no law says how to go on.


def test_what_begins_in_the_other_direction_is_not_thrown_back() -> None:
    """A ball that starts below the floor falls freely, and a particle that starts at the wall leaves it."""
    below = checked_run(ball(height=-1.0, speed=10.0), 1.0, [floor(0.5)])
    assert len(below.t_events[0]) == 0 and below.y[0, -1] == pytest.approx(9 - G / 2)
    passing = checked_run(free(x=1.0, x_dot=1.0), 1.0, [event(x - 1, direction=1, reset={x.dot: x.dot / 2})])
    assert len(passing.t_events[0]) == 0 and passing.y[0, -1] == 2.0


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_two_resets_of_one_entry_at_one_time_are_not_settled_by_their_order(method: str) -> None:
    model = build(
        kinetic=(x.dot**2 + y.dot**2) / 2, coordinates=[x, y], initial={x: 0.5, y: 0.5, x.dot: 1.0, y.dot: 1.0}
    )
    first, second = event(x - 1, reset={x.dot: -x.dot}), event(y - 1, reset={x.dot: 2.0})
    result = run(model, 1.0, method, events=[first, second])
    assert result.status is Status.NON_FINITE and result.t[-1] == pytest.approx(0.5, rel=1e-12)
    assert "two events at this time that reset one entry to different values" in result.message
    alike = run(model, 0.8, method, events=[first, event(y - 1, reset={x.dot: -y.dot})])
    assert alike.status is Status.SUCCESS and alike.y[2, -1] == pytest.approx(-1.0, rel=1e-12)


def test_resets_of_all_kinds() -> None:
    """Resets of coordinates, with explicit time, at the end of the run, and together with a terminal event."""
    saw = checked_run(free(), 5.0, [event(x - 1, reset={x: 0})])
    assert saw.t_events[0] == pytest.approx([1, 2, 3, 4, 5], rel=1e-15) and saw.y[:, -1].tolist() == [0.0, 1.0]
    clock = checked_run(free(), 4.0, [event(t - 2, reset={x: t * x.dot, x.dot: x - 1})])
    assert clock.t_events[0].tolist() == [2.0] and clock.y[:, -1].tolist() == [4.0, 1.0]
    last = checked_run(free(), 5.0, [event(x - 1, reset={x.dot: -2 * x.dot}, terminal=True)])
    assert last.status is Status.EVENT and last.y[:, -1].tolist() == [1.0, -2.0]
    assert last.y_events[0].tolist() == [[1.0, 1.0]]


# --- events handled by the compiled loop over Taylor steps equal those that Python handles ---------------------


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


@pytest.mark.few(1)
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


@pytest.mark.few(1)
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
    for speed in np.linspace(0.7, 0.95, 4):
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
