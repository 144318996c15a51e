"""Events of members in lanes, and reductions of runs, equal those of single runs."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.algorithm.members.reductions import largest_between, lobatto
from lagrange.machine.llvm import engine
from lagrange.machine.python_source import called
from lagrange.members import jobs, lanes
from lagrange.members.singly import RunEngine
from lagrange.trajectory.events import compiled_loop
from tests.members import test_ensembles as partitions
from tests.models import shared_scene
from tests.systems import chain

FIXED_STEPS: dict[str, dict[str, Any]] = {"rk4": {"step": 0.02}, "forest-ruth4": {"step": 0.02}}
METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"rtol": 1e-10},
    "dop853": {"rtol": 1e-10},
    "tsit5": {"rtol": 1e-8},
    **FIXED_STEPS,
}
"""Series; steps with their errors under control, which cubics screen, and equal ones; paths by stages and by slopes."""


@cache
def ball() -> lg.System:
    """Return a ball that is thrown upwards, with y'' = -10."""
    y = lg.coordinate("y")
    return lg.System(kinetic=y.dot**2 / 2, potential=10 * y, initial={y: 1.0, y.dot: 3.0})


def one_after_the_other(monkeypatch: pytest.MonkeyPatch, *args: Any, **options: Any) -> lg.Ensemble:
    """Return the ensemble without lanes: its members run one after the other."""
    with monkeypatch.context() as changed:
        changed.setattr(jobs, "lane_engine", lambda *_, **__: None)
        return lg.ensemble(*args, workers=1, **options)


@contextmanager
def runs_alone(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Count the members that lanes leave to single runs."""
    numbers: list[int] = []
    known = RunEngine.again

    def again(engine: RunEngine, starts: Any, ends: Any, which: Any) -> Any:
        numbers.append(len(which))
        return known(engine, starts, ends, which)

    with monkeypatch.context() as changed:
        changed.setattr(RunEngine, "again", again)
        yield numbers


def agree(one: lg.Ensemble, other: lg.Ensemble, tolerance: float = 1e-12, method: str = "taylor") -> None:
    """Assert that all columns of two results agree, including missing entries.

    A single run may take steps beyond the event that ends it, and counts them.
    """
    assert one.status.tolist() == other.status.tolist()
    vain = ("evaluations",) if method == "taylor" else ("evaluations", "rejected")
    for column in one.columns:
        if column.name not in vain:
            result, expected = (runs.results.column(column.name) for runs in (one, other))
            assert np.allclose(result, expected, rtol=tolerance, atol=tolerance, equal_nan=True), column.name


@pytest.mark.slow
def test_times_of_a_thrown_ball_have_closed_forms(monkeypatch: pytest.MonkeyPatch) -> None:
    """The motion is a polynomial, so times and states are right to round-off. One ball has not landed yet."""
    (y,) = ball().coordinates
    speeds = np.append(np.linspace(0.5, 9.0, 20), 40.0)
    events = [lg.event(y, terminal=True), lg.event(y.dot, direction=-1)]
    with runs_alone(monkeypatch) as alone:
        runs = lg.ensemble(ball(), 4.0, {"y_dot": speeds}, events=events, keep=("end", ("events", 2)))
    assert "side by side" in runs.form and sum(alone) == 0
    landed = (speeds + np.sqrt(speeds**2 + 20.0)) / 10.0
    assert [item.value for item in runs.status] == [*["event"] * 20, "success"]
    assert np.allclose(runs.t_events[0][:20, 0], landed[:20], rtol=4e-16, atol=0)
    assert np.isnan(runs.t_events[0][20]).all() and np.isnan(runs.t_events[0][:, 1]).all()
    assert np.array_equal(runs.t[:20], runs.t_events[0][:20, 0]) and runs.t[20] == 4.0
    assert np.array_equal(runs.y[:, :20].T, runs.y_events[0][:20, 0])
    assert np.allclose(runs.t_events[1][:, 0], speeds / 10.0, rtol=4e-16, atol=0)
    assert np.allclose(runs.y_events[1][:, 0, 0], 1.0 + speeds**2 / 20.0, rtol=4e-15, atol=0)


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


@pytest.mark.slow
@pytest.mark.parametrize("case", list(HENON))
@pytest.mark.parametrize("end", [20.0, -7.0])
@pytest.mark.parametrize("method", METHODS)
def test_events_of_a_member_are_those_of_its_run(
    case: str, end: float, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Events equal those of single runs, also for members that lanes leave to them.

    Round-off grows by less than 100.
    """
    henon = lg.scene("henon-heiles")
    x, y = henon.coordinates
    given: dict[str, Any] = {"events": HENON[case](x, y), "method": method, **METHODS[method]}
    beyond = method == "taylor" and case in BEYOND
    counts = () if beyond else ("counts",)
    given["keep"] = ("end", *counts, ("events", 4), ("max", x), ("mean", y))
    given["t_eval"] = np.linspace(0.0, end, 5)
    starts = {"x": np.linspace(0.05, 0.2, 13)}
    together = lg.ensemble(henon, end, starts, **given)
    alone = one_after_the_other(monkeypatch, henon, end, starts, **given)
    assert "side by side" in together.form and "one after" in alone.form
    agree(together, alone, 1e-8 if beyond else 1e-12, method)


def random_ensemble(rng: np.random.Generator) -> tuple[lg.System, dict[str, Any], dict[str, Any]]:
    """Return two coupled oscillators with random coefficients, starts of 19 members, and events of all kinds."""
    x, y = lg.coordinates("x y")
    k = lg.parameters("k")
    b, c, d, e = rng.uniform(0.3, 1.5, 4).round(3).tolist()
    potential = k * x**2 + b * y**2 + c * x**2 * y / 4 + d * x**4 / 8 + e * y**4 / 8
    system = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2, potential=potential, parameters={k: 0.8}, initial={y.dot: 0.2}
    )
    shifts = rng.normal(0.0, 0.2, 4).round(3).tolist()
    expressions = [
        x - shifts[0],
        y.dot + k * x - shifts[1],
        x * y.dot - y * x.dot - shifts[2],
        x**2 + y**2 - shifts[3] ** 2,
    ]
    ways, ends = rng.integers(-1, 2, 4).tolist(), rng.choice([0, 0, 3, 9], 4).tolist()
    events = [
        lg.event(item, direction=way, terminal=end) for item, way, end in zip(expressions, ways, ends, strict=True)
    ]
    starts = {name: rng.uniform(-0.8, 0.8, 19) for name in ("x", "y")}
    if rng.random() < 0.5:
        starts["k"] = rng.uniform(0.3, 1.5, 19)
    return system, starts, {"events": events, "keep": (("events", 5),)}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("method", FIXED_STEPS)
def test_events_on_fixed_steps_are_those_of_the_compiled_loop_to_the_last_bit(
    method: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With fixed steps the bits are the same. A short run would search events on arrays, which add in another order."""
    system, starts, given = random_ensemble(np.random.default_rng(seed))
    given |= {"method": method, **FIXED_STEPS[method]}
    monkeypatch.setattr(compiled_loop, "WORTH_COMPILING", 0)
    with runs_alone(monkeypatch) as left:
        together = lg.ensemble(system, 15.0, starts, **given)
    alone = one_after_the_other(monkeypatch, system, 15.0, starts, **given)
    assert sum(left) <= 2 and np.isfinite(together.t_events[0]).any()
    for column in together.columns:
        result, expected = (runs.results.column(column.name) for runs in (together, alone))
        assert np.array_equal(result, expected, equal_nan=column.kind == "f8"), column.name


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_events_at_both_ends_of_a_run(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a run, zeros at the start are no events, and zeros at the end are."""
    (y,) = ball().coordinates
    for event in (lg.event(y, terminal=True), y, lg.event(y.dot + 5.0)):
        for start in ({"y": np.array([0.0, 0.5, 1.0]), "y_dot": 5.0}, {"y": 0.0, "y_dot": np.array([-5.0, 5.0, 5.5])}):
            given: dict[str, Any] = {"events": [event], "keep": ("end", ("events", 2)), "method": method}
            given |= METHODS[method]
            together = lg.ensemble(ball(), 1.0, start, **given)
            assert "side by side" in together.form
            agree(together, one_after_the_other(monkeypatch, ball(), 1.0, start, **given))


def test_resets_and_implicit_methods_are_runs_one_after_the_other() -> None:
    (y,) = ball().coordinates
    bounce = lg.event(y, direction=-1, reset={y.dot: -0.5 * y.dot})
    for method in ("taylor", "dop853"):
        runs = lg.ensemble(ball(), 1.0, {"y_dot": [1.0, 2.0]}, events=[bounce], method=method)
        assert "one after" in runs.form
    runs = lg.ensemble(ball(), 1.0, {"y_dot": [1.0, 2.0]}, events=[y], method="gauss2", step=0.05, keep=("events",))
    assert "one after" in runs.form and np.allclose(runs.t_events[0][:, 0], [0.558257569, 0.689897949], atol=1e-8)


K = lg.parameters("k")

CHANGES: dict[str, dict[str, Any]] = {
    "parameter": {"reset": {K: 4 * K}},
    "velocity": {"reset": {"x_dot": -lg.coordinate("x").dot}},
    "end": {"terminal": True},
}


@pytest.mark.few(1)
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("method", ["taylor", "radau5"])
@pytest.mark.parametrize("listed", [list, iter])
def test_last_states_alone_are_those_after_events(change: str, method: str, listed: Any) -> None:
    """Without events, members whose last states alone are kept run by a flow."""
    x = lg.coordinate("x")
    spring = lg.System(kinetic=x.dot**2 / 2, potential=K * x**2 / 2, parameters={K: 1.0})
    event = lg.event(x, direction=-1, **CHANGES[change])
    runs = lg.ensemble(spring, 4.0, {x: [1.0, 2.0]}, events=listed([event]), method=method)
    alone = spring.run(4.0, {x: 2.0}, events=[event], method=method)
    assert runs.y[:, 1] == pytest.approx(alone.y[:, -1], abs=1e-6)
    assert alone.y[:, -1] != pytest.approx(spring.run(4.0, {x: 2.0}, method=method).y[:, -1], abs=0.1)


# --- series in loops over orders ------------------------------------------------------------------------------
# Members whose series are computed in a loop over orders: they end, and find events, as a run of their own does.
#
# A wrong series would not conserve the energy, and a run alone would take its place: these are counted.


@pytest.fixture
def by_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute even the smallest series in a loop over orders."""
    monkeypatch.setattr(lanes, "MOST_WRITTEN_OUT", 0)


@pytest.mark.usefixtures("by_order")
@pytest.mark.parametrize(("links", "rtol"), [(2, 1e-9), pytest.param(13, 1e-12, marks=pytest.mark.slow)])
def test_a_member_ends_where_a_run_of_its_own_ends(links: int, rtol: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even and odd orders; an inverse that is written out, and one in loops. Round-off grows by less than 100."""
    system = chain(links)
    names = system.compile().layout.names()
    rng = np.random.default_rng(4)
    starts = dict(zip(names, rng.uniform(-1.5, 1.5, (len(names), 11)), strict=True))
    given: dict[str, Any] = {"method": "taylor", "rtol": rtol, "keep": ("end", "counts")}
    with runs_alone(monkeypatch) as left:
        together = lg.ensemble(system, 0.5, starts, **given)
    alone = one_after_the_other(monkeypatch, system, 0.5, starts, **given)
    assert "side by side" in together.form and "one after" in alone.form and sum(left) == 0
    agree(together, alone, 1e-11)


# --- results along the runs of members: states at output times, extremes and means, in lanes and in single runs ---


REDUCED_METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"rtol": 1e-9},
    "dop853": {"rtol": 1e-9},
    "tsit5": {"rtol": 1e-7},
    "rk4": {"step": 0.01},
    "forest-ruth4": {"step": 0.02},
}
"""Series, dense output by stages, by Hermite polynomials, and coordinates and velocities apart."""

STARTS = 0.4 + np.linspace(-0.2, 0.25, 21)


@cache
def oscillator() -> lg.System:
    """Return an oscillator with mass 1 and angular frequency 2: x = a cos 2t."""
    x, k = lg.coordinate("x"), lg.parameters("k")
    return lg.System(kinetic=x.dot**2 / 2, potential=k * x**2 / 2, parameters={k: 4.0})


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.few(1)
@pytest.mark.parametrize("method", list(REDUCED_METHODS))
def test_states_at_output_times_are_those_of_a_run(method: str, backward: bool) -> None:
    """Output times are at both ends, repeated, several in a step, and none in some steps.

    Machine code for one state adds some terms in another order, so results differ by rounding.
    """
    times = np.array([0.0, 0.3, 0.3, 1.2, 1.2001, 1.2002, 2.9, 3.0])
    span, times = (-3.0, -times) if backward else (3.0, times)
    given: dict[str, Any] = {"t_eval": times, "method": method, **REDUCED_METHODS[method]}
    runs = lg.ensemble(shared_scene("pendulum"), span, {"theta": STARTS}, **given)
    assert "side by side" in runs.form
    for i in (0, 8, 20):
        alone = shared_scene("pendulum").run(span, {"theta": STARTS[i]}, **given)
        assert np.allclose(runs.y[:, :, i], alone.y, rtol=1e-13, atol=1e-14)
    ends = lg.ensemble(shared_scene("pendulum"), span, {"theta": STARTS}, method=method, **REDUCED_METHODS[method])
    assert np.array_equal(runs.y[:, -1], ends.y)


@pytest.mark.parametrize(
    "method",
    [pytest.param(name, marks=[pytest.mark.slow] * (name not in ("taylor", "dop853"))) for name in REDUCED_METHODS],
)
def test_extremes_and_means_of_an_oscillator_have_closed_forms(method: str) -> None:
    """The motion is x = a cos 2t until t = 5.

    Methods with error control have a relative error of at most 1e-9. rk4 and forest-ruth4 have errors of
    (2h)**4 t / 60 and ten times this. Sampling, quadrature and search add only round-off.
    """
    (x,) = oscillator().coordinates
    keep = ("end", ("max", x), ("min", x), ("max", x.dot), ("mean", x**2), ("min", sympy.Abs(x)))
    a = np.linspace(1.0, 2.0, 11)
    runs = lg.ensemble(oscillator(), 5.0, {"x": a}, keep=keep, method=method, **REDUCED_METHODS[method])
    assert "side by side" in runs.form
    bound = {"rk4": 1e-7, "forest-ruth4": 1e-5, "tsit5": 1e-6}.get(method, 1e-8)
    assert np.allclose(runs["max(x)"], a, rtol=bound)
    assert np.allclose(runs["min(x)"], -a, rtol=bound)
    assert np.allclose(runs["max(x_dot)"], 2 * a, rtol=bound)
    assert np.allclose(runs["mean(x**2)"], a**2 * (0.5 + np.sin(20.0) / 40.0), rtol=bound)
    # The kink of |x| is found to 2**-27 of a step, which is at most 0.5 long and at speeds below 4.
    assert (runs["min(Abs(x))"] < 2e-8).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["taylor", "rk4"])
def test_the_drift_is_that_to_the_time_of_the_end(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The potential of a driven oscillator depends on time, and its runs end early by a limit of steps."""
    x = lg.coordinate("x")
    driven = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2 - x * sympy.sin(3 * lg.t), initial={x: 1.0})
    given: dict[str, Any] = {"keep": ("drift",), "max_steps": 5, "method": method, **REDUCED_METHODS[method]}
    together = lg.ensemble(driven, 20.0, {"x": STARTS}, **given)
    alone = one_after_the_other(monkeypatch, driven, 20.0, {"x": STARTS}, **given)
    assert "side by side" in together.form and "one after" in alone.form
    assert set(together.status) == {lg.Status.MAX_STEPS} and np.abs(together["drift"]).min() > 1e-6
    assert np.allclose(together["drift"], alone["drift"], rtol=1e-9)


@pytest.mark.slow
def test_a_rejected_taylor_step_leaves_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    """A free motion meets a bump that its series do not show, so that steps beyond the bump are rejected.

    States on rejected steps, beyond the bump, must not count as extremes.
    """
    x = lg.coordinate("x")
    bump = lg.System(kinetic=x.dot**2 / 2, potential=sympy.exp(-1000 * (x - 1) ** 2) / 5, initial={x: 0.0})
    speeds = np.linspace(0.5, 1.5, 24)
    given: dict[str, Any] = {"keep": ("counts", ("max", x), ("mean", x), ("min", x.dot)), "rtol": 1e-9}
    together = lg.ensemble(bump, 3.0, {"x_dot": speeds}, **given)
    alone = one_after_the_other(monkeypatch, bump, 3.0, {"x_dot": speeds}, **given)
    rejected = together.results.column("rejected")
    assert rejected.max() > 1
    slow = speeds**2 / 2 < 0.2
    turning = 1 - np.sqrt(np.log(0.2 / (speeds[slow] ** 2 / 2)) / 1000)
    assert np.allclose(together["max(x)"][slow], turning, rtol=1e-9)
    for name in ("max(x)", "mean(x)", "min(x_dot)"):
        assert np.allclose(together.results.column(name), alone.results.column(name), rtol=1e-9, atol=1e-9)


def test_the_rule_is_exact_to_degree_15() -> None:
    points, weights = lobatto()
    assert np.array_equal(points + points[::-1], np.ones(9)) and np.array_equal(weights, weights[::-1])
    errors = [abs(weights @ points**k - 1 / (k + 1)) for k in range(17)]
    assert max(errors[:16]) < 4e-16 and errors[16] > 1e-10


@pytest.mark.parametrize(
    ("shape", "peak", "middle", "allowed"),
    [
        (lambda u: 1 - (u - 0.31) ** 2, 0.31, 0.35, 1e-15),
        (lambda u: math.sin(math.pi * u), 0.5, 0.52, 1e-15),
        (lambda u: 1 - abs(u - 0.777), 0.777, 0.7, 2e-8),
        (lambda u: 1 - (u - 0.4) ** 4, 0.4, 0.5, 1e-15),
        (lambda u: 1 - u, 0.2, 0.3, 2e-8),
    ],
)
def test_the_search_finds_the_largest_value_of_any_shape(
    shape: Callable[[float], float], peak: float, middle: float, allowed: float
) -> None:
    """The shapes are a parabola, a sine, a kink, a flat top and an end. The error is at most two resolutions."""
    search, none, places = called(largest_between.form()), np.empty(0), (0.2, middle, 0.8)
    step = (lambda u, *_: shape(u)), 0.0, 0.0, 0.0, 0, none, none, 0
    best = search(*step, 1.0, *places, *map(shape, places), -math.inf)
    assert best == pytest.approx(shape(peak), rel=0, abs=allowed)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["taylor", pytest.param("dop853", marks=pytest.mark.slow)])
@pytest.mark.parametrize("watched", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_optimized_code_gives_the_bits_of_the_quick_code(
    method: str, watched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first chunk of the second run uses quickly compiled code, all later ones optimized code."""
    right = partitions.whole(method, watched=watched)
    compiled: list[Any] = []
    count = engine.CompiledCall.count
    monkeypatch.setattr(engine, "STEPS_BEFORE_LATE_OPTIMIZING", 1)
    monkeypatch.setattr(lanes, "_COMPILED", {})
    monkeypatch.setattr(engine.CompiledCall, "count", lambda call, steps: compiled.append(count(call, steps)))
    rows = partitions.run(method=method, workers=1, watched=watched)
    assert compiled[:3] == [True, False, False]
    assert all(rows[name].tobytes() == right[name].tobytes() for name in right)
