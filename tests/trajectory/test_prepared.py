"""Drivers kept by a model: no run affects the next one, a second run prepares nothing; invalid requests."""

import math
import re
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import sympy
import sympy as sp

import lagrange as lg
from lagrange.algorithm.constants import FIRST_SHARE
from lagrange.errors import StatementError
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.model import Model
from lagrange.statement import run_settings as preparation
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.plan import DRIVERS_KEPT, PLANS_KEPT, PreparedPlan
from lagrange.trajectory.trajectory import Trajectory
from tests import systems
from tests.models import TARGETS, build, k, m, model, shared_scene, x
from tests.refusals import refusal
from tests.trajectory.runs import FIXED, NAMES, run, same

STARTS = ({"x": 0.1, "y_dot": 0.2}, {"x": -0.2, "y": 0.1, "x_dot": 0.3})


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_that_of_a_model_that_has_kept_nothing(name: str, target: str) -> None:
    """Runs with other states, spans, directions and options equal those of a new model."""
    compiled = model("Henon-Heiles", target)
    given: dict[str, Any] = {"step": 0.02} if name in FIXED else {"rtol": 1e-7, "atol": 1e-9}
    spans = (0.0, 0.3), (0.5, 0.2), (0.0, 0.3), (-1.0, -0.9)
    requests = [(STARTS[i % 2], span, given) for i, span in enumerate(spans)]
    if target == "llvm":
        requests.insert(2, (STARTS[0], (0.0, 0.1), {}))
    result = [run(compiled, end, name, begin, start, **options) for start, (begin, end), options in requests]
    for item, (start, (begin, end), options) in zip(result, requests, strict=True):
        compiled.prepared.clear()
        assert same(item, run(compiled, end, name, begin, start, **options))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["taylor", "dop853", "rk4", "verlet", "radau5", "bdf2"])
def test_a_second_run_prepares_nothing(name: str, target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = model("Henon-Heiles", target)
    options: dict[str, Any] = {"step": 0.02} if name in FIXED else {"rtol": 1e-7}
    first = run(compiled, 0.3, name, initial=STARTS[0], **options)
    monkeypatch.setattr(type(list(compiled.prepared.values())[-1].plan), "driver", None)
    monkeypatch.setattr(type(find(name)), "plan", None)
    assert same(run(compiled, 0.3, name, initial=STARTS[0], **options), first)


def oscillator() -> Model:
    return build("llvm", kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1, k: 1}, initial={x: 1.0})


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_second_run_with_the_same_events_plans_nothing(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The resets of a plan contain its parameters, so other parameters need another plan."""
    compiled = build(
        "llvm", kinetic=x.dot**2 / 2, potential=k * x**2 / 2, parameters={k: 2.0}, initial={x: 0.0, x.dot: -1.0}
    )
    wall = event(x, direction=-1, reset={x.dot: -k * x.dot / 4})
    given: list[dict[str, Any]] = [{}, {"parameters": {k: 3.0}}]
    first = [run(compiled, 9.0, method, events=[x - k / 10, wall], **options) for options in given]
    # The first reset is at the start, where the loop over steps leaves it to Python.
    assert [item.y_events[1][1][1] for item in first] == pytest.approx([-0.5, -0.75])
    monkeypatch.setattr(type(find(method)), "plan", None)
    for options, expected in zip(given, first, strict=True):
        again = run(compiled, 9.0, method, events=[x - k / 10, wall], **options)
        assert same(again, expected) and all(map(np.array_equal, again.t_events, expected.t_events))
    monkeypatch.undo()
    compiled.prepared.clear()
    for options, expected in zip(given, first, strict=True):
        assert same(run(compiled, 9.0, method, events=[x - k / 10, wall], **options), expected)


def test_few_plans_and_drivers_are_kept() -> None:
    compiled = oscillator()
    for i in range(3 * PLANS_KEPT):
        run(compiled, 0.1, "dop853", rtol=10.0 ** -(4 + i / 4))
    assert len(compiled.prepared) == PLANS_KEPT
    for i in range(3 * DRIVERS_KEPT):
        run(compiled, 0.1, "dop853", parameters={k: 1.0 + i})
    last: PreparedPlan = list(compiled.prepared.values())[-1]
    assert len(last.idle) == DRIVERS_KEPT


def test_what_depends_on_the_span_is_that_of_each_run() -> None:
    """The default step is a thousandth of the span.

    The longest step follows from the span if a force may act briefly.
    """
    compiled = oscillator()
    assert [run(compiled, end, "rk4").step for end in (1.0, 3.0, 1.0)] == [0.001, 0.003, 0.001]
    pushed = build("llvm", kinetic=x.dot**2 / 2, forces={x: sp.exp(-((t - 5) ** 2))})
    for end in (10.0, 20.0, 10.0):
        result = run(pushed, end, "dop853")
        assert result.steps >= 1000 and np.diff(result.t).max() <= 1.000001 * end / 1000
    with pytest.raises(StatementError, match="below the spacing"):
        [lg.integrate(compiled, (0.0, end), method="rk4", step=1e-3) for end in (1.0, 1e13)]


# --- preparation ----------------------------------------------------------------------------------------------
# Deriving and compiling before a run end at `max_wall`, wherever they are.

q, u = lg.coordinates("q u")
FACTORS = sympy.prod([sympy.cos(q / k) for k in range(1, 7)])


@dataclass
class Clock:
    """A clock that jumps by 30 years after some readings."""

    left: float
    readings: int = 0

    def perf_counter(self) -> float:
        self.readings += 1
        self.left -= 1
        return time.perf_counter() + (1e9 if self.left < 0 else 0.0)


def wide(*, constrained: bool) -> lg.System:
    """Return a system with a long right-hand side and an even longer series."""
    rail = [u - q**2 / 8] if constrained else []
    return lg.System(q.dot**2 / 2 + u.dot**2 / 2, FACTORS + u, constraints=rail, initial={q.dot: 0.5})


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Make small systems test the time limit often."""
    for place in ("graph.node", "program.recurrence", "program.lower"):
        monkeypatch.setattr(f"lagrange.{place}.CHECKED_EVERY", 8)
    return monkeypatch


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("method", "constrained"), [("taylor", False), ("taylor", True), ("radau5", False), ("scipy-lsoda", True)]
)
def test_preparation_ends_at_the_limit_wherever_it_is(
    method: str, constrained: bool, often: pytest.MonkeyPatch
) -> None:
    """Compilation stops at the time limit. Before, 599 factors took 72 s with max_wall=5."""
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
        assert "Compiling was stopped after 1e+09 s, more than max_wall = 60 s" in message and len(message) <= 400
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
    """Code that is compiled during a run, such as optimized code, does not count as preparation."""
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


# --- short runs -----------------------------------------------------------------------------------------------
# What a run costs beside its steps: how often its driver comes back, and that no slow way is taken without a need.


@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "radau5"])
@pytest.mark.parametrize("initial", [None, {"theta": np.pi / 2}], ids=["plain", "energy near zero"])
@pytest.mark.parametrize("scene", ["pendulum", "elastic-pendulum"])
def test_a_run_looks_at_its_ends_by_quick_calls(
    scene: str, initial: Any, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a regular run the first slope, inertia and energy are computed by quick calls only."""
    model = shared_scene(scene).compile()
    step: dict[str, Any] = {"step": 0.01} if method == "rk4" else {}
    expected = lg.integrate(model, (0.0, 0.1), initial, method=method, **step)
    for slow in (LlvmKernel, InterpretedKernel):
        monkeypatch.setattr(slow, "__call__", None)
        monkeypatch.setattr(slow, "columns", None)
    result = lg.integrate(model, (0.0, 0.1), initial, method=method, **step)
    assert result.status is lg.Status.SUCCESS and np.array_equal(result.y, expected.y)


METHODS = ("bs3", "dopri5", "tsit5", "dop853", "verner9")
SCENES = (
    *("bead-on-hoop", "chain-of-springs", "charge-in-field", "double-pendulum", "elastic-pendulum", "henon-heiles"),
    *("kepler", "mass-on-spring", "pendulum", "pleiades", "spherical-pendulum", "sun-earth-moon"),
)
"""Scenes that are at no equilibrium, and whose motion is not a polynomial in time that a method follows exactly."""

MOST_GROWTH = 10.0
"""Step control lets a step grow by this factor at most, whatever its error."""


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-11])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_the_first_step_is_less_than_two_growths_away(name: str, method: str, rtol: float) -> None:
    """The first step is chosen so well that it is not followed by two steps of largest growth."""
    model = shared_scene(name).compile()
    span = shared_scene(name).statement.run.t_end or 10.0
    for absolute in (None, rtol):
        result = lg.integrate(model, (0.0, span), method=method, rtol=rtol, atol=absolute, max_steps=6)
        steps = np.diff(result.t)
        assert len(steps) >= 3
        assert steps[2] < 0.9 * MOST_GROWTH**2 * steps[0]


@pytest.mark.parametrize("height", [0.01, 0.1])
def test_the_first_step_of_a_thrown_ball_is_a_fraction_of_the_time_to_the_top(height: float) -> None:
    """Its acceleration is constant: the change of the velocity says how long a step is, and not the height."""
    thrown = lg.System(x.dot**2 / 2, 2 * x, initial={x: height, x.dot: 3}).compile()
    thrown_run = lg.integrate(thrown, (0.0, 1.0), method="dop853", rtol=1e-8, atol=1e-300)
    assert thrown_run.t[1] == pytest.approx(1.5 * (FIRST_SHARE * 1e-8) ** (1 / 8), rel=1e-12)


# --- runs with events -----------------------------------------------------------------------------------------
# What a model keeps of runs with events and output times: a second run begins as if there had been none.

WATCHED: dict[str, Any] = {"none": [], "one": [x], "five": [x, x.dot, x - 0.5, x + 0.5, x.dot - x]}
WATCHED["jumps"] = [event(x + 0.2, direction=-1, reset={x.dot: -0.9 * x.dot}), x.dot, event(x, terminal=99)]
FORCES = {"smooth": -(x**3), "switching": -sp.sign(x) - x}


def watched(name: str, target: str = "llvm") -> Model:
    """Return an oscillator, with a force that switches at x = 0 if requested."""
    return build(
        target, kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, forces={x: FORCES[name]}, parameters={m: 1, k: 1}
    )


def same_events(a: Trajectory, b: Trajectory) -> bool:
    """Return True if two runs and their events are equal to the last bit, except for counts of rejected steps.

    These depend on the number of steps in one call of the driver.
    """
    a, b = (replace(item, evaluations=0, rejected=0) for item in (a, b))
    times, states = (all(map(np.array_equal, getattr(a, n), getattr(b, n))) for n in ("t_events", "y_events"))
    return same(a, b) and len(a.t_events) == len(b.t_events) and times and states


SPANS = (0.0, 9.0), (0.0, 4.0), (3.0, 0.0), (0.0, 9.0), (0.0, 260.0), (0.0, 9.0)


@pytest.mark.few(1)
@pytest.mark.parametrize("outputs", [False, True])
@pytest.mark.parametrize("force", FORCES)
@pytest.mark.parametrize("events", WATCHED)
@pytest.mark.parametrize("name", ["taylor", "dop853", "rk4", "radau5", "bdf2"])
def test_a_watched_run_is_that_of_a_model_that_has_kept_nothing(
    name: str, events: str, force: str, *, outputs: bool
) -> None:
    """Runs with events equal those of a new model, whatever earlier runs left in the memory of the driver."""
    compiled, alone = watched(force), watched(force)
    for i, (begin, end) in enumerate(SPANS):
        options: dict[str, Any] = {"events": WATCHED[events], "parameters": {k: 1.0 + i // 3}}
        options |= {"step": 0.05} if name in FIXED else {"rtol": 1e-7}
        options |= {"t_eval": np.linspace(begin, end, 17)} if outputs else {}
        start = {x: 0.7 - 0.2 * i, x.dot: 0.3}
        alone.prepared.clear()
        assert same_events(
            run(compiled, end, name, begin, start, **options), run(alone, end, name, begin, start, **options)
        )


@pytest.mark.few(1)
@pytest.mark.parametrize("events", WATCHED)
@pytest.mark.parametrize("name", ["taylor", "dop853", "rk4", "verlet", "radau5", "bdf2"])
def test_threads_share_a_model(name: str, events: str) -> None:
    """Runs in threads equal runs one after the other, bit by bit."""
    shared, alone = watched("switching"), watched("switching")
    calls = [({x: 1.0 + i / 7, x.dot: 0.3}, 20.0 * (-1) ** i, {k: 1.0 + i % 3}) for i in range(8)]
    given: dict[str, Any] = {"events": WATCHED[events]}
    expected = [run(alone, end, name, initial=start, parameters=values, **given) for start, end, values in calls]
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # threads change within a run
    try:
        with ThreadPoolExecutor(8) as pool:
            result = list(
                pool.map(lambda one: run(shared, one[1], name, initial=one[0], parameters=one[2], **given), calls)
            )
    finally:
        sys.setswitchinterval(before)
    assert all(map(same_events, result, expected))


# --- requests for runs: each invalid one is refused with a message, each valid one is run ----------------------


theta = lg.coordinate("theta")

g, l = lg.parameters("g l")


@pytest.fixture(scope="module")
def pendulum() -> lg.System:
    return systems.pendulum(initial={theta: 1.0})


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"method": "hopfrog"}, "there is no method 'hopfrog'; the methods are euler, "),
        ({"method": "dop583"}, "Did you mean 'dop853'?"),
        ({"method": 4}, "method is 4: give a name, such as 'taylor', or an instance"),
        ({"method": "rk4", "rtol": 1e-3}, "rk4 takes fixed steps and cannot aim at a tolerance: give step="),
        ({"step": 0.1}, "taylor chooses its steps by itself: give rtol and atol"),
        ({"method": "rk4", "step": -0.1}, "step = -0.1: give a positive size"),
        ({"method": "rk4", "step": float("nan")}, "step is nan: give a finite number"),
        ({"method": "rk4", "step": 1e-30}, "step = 1e-30 is below the spacing of floating-point times"),
        ({"rtol": -1e-3}, "rtol = -0.001: give a finite tolerance that is not negative"),
        ({"atol": float("nan")}, "atol = nan: give a finite tolerance that is not negative"),
        ({"rtol": [1e-9, 1e-9]}, "rtol is [1e-09, 1e-09]: give one number, which holds for all entries of the state"),
        ({"atol": "a", "method": "dop853"}, "atol is 'a' (str): give a number"),
        ({"rtol": True}, "rtol is True (bool): give a number"),
        ({"rtol": 1.0}, "rtol = 1 allows errors as large as the state itself: give a smaller"),
        ({"rtol": 2, "method": "scipy-rk45"}, "rtol = 2 allows errors as large as the state itself: give a smaller"),
        (
            {"rtol": 1e-12, "method": lg.methods.Taylor(rtol=1e-3)},
            "rtol is given twice, 1e-12 for the run and 0.001 for taylor itself: leave one of them out.",
        ),
        (
            {"step": 0.1, "method": lg.methods.RK4(step=0.2)},
            "step is given twice, 0.1 for the run and 0.2 for rk4 itself: leave one of them out.",
        ),
        ({"t_eval": [0.0, 2.0]}, "t_eval contains 2, outside the time span from 0 to 1"),
        ({"t_eval": [0.5, 0.2]}, "t_eval is not sorted in the direction of the run: give the times in increasing"),
        ({"t_eval": [0.5, float("nan")]}, "t_eval contains nan, outside the time span"),
        ({"t_eval": [[0.5]]}, "t_eval has shape (1, 1)"),
        ({"t_eval": 1000}, "give a list of times, such as np.linspace(0, "),
        ({"t_eval": ["a"]}, "t_eval has entries of type <U1: give real numbers"),
        ({"events": lambda t, y: y[0]}, "give a SymPy expression whose zero is the event, such as theta - 1"),
        ({"events": [g - 9]}, "event 0 is g - 9, which is constant along a run"),
        ({"max_steps": 0}, "max_steps = 0: give a whole number of at least 1"),
        ({"max_memory": 0}, "max_memory = 0: give a positive number of bytes"),
        ({"max_memory": "1"}, "'1'"),
        ({"max_wall": -1.0}, "max_wall = -1: give a positive number of seconds"),
        ({"parameters": {"mm": 2.0}}, "'mm' is not a parameter of this system; its parameters are m,"),
        ({"initial": {"thet": 1.0}}, "initial names 'thet', which is not a coordinate or velocity of this system"),
        ({"initial": [1.0]}, "initial is a list: give a dict such as {theta: 1.0}"),
        ({"target": "fortran"}, "there is no target 'fortran'; the targets are llvm and numpy"),
    ],
)
def test_a_request_that_cannot_be_meant_is_refused(pendulum: lg.System, request_: dict[str, Any], words: str) -> None:
    assert words in refusal(pendulum.run, 1.0, **request_)


@pytest.mark.parametrize("span", [5.0, (0.0,), (0.0, 1.0, 2.0), "01", (0.0, float("inf")), (0.0, "1")])
def test_a_span_is_two_times(pendulum: lg.System, span: Any) -> None:
    assert "time" in refusal(lg.integrate, pendulum.compile(), span)


def test_a_model_is_asked_for(pendulum: lg.System) -> None:
    words = "is not a compiled model: give system.compile"
    not_a_model: Any = pendulum
    assert re.search(words, refusal(lg.integrate, not_a_model, (0.0, 1.0)))
    assert re.search(words, refusal(lg.flow, not_a_model))


def test_energies_must_be_finite_at_the_start() -> None:
    x = lg.coordinate("x")
    system = lg.System(kinetic=x.dot**2 / 2, potential=1 / x, name="barrier")
    with pytest.raises(
        lg.StatementError, match=r"energy of barrier is \w+ at the initial state \(x = 0 and x\.dot = 0\)"
    ):
        system.run(1.0)


@pytest.mark.parametrize("name", ["verlet", "symplectic-euler"])
def test_a_splitting_is_refused_where_it_is_not_symplectic(name: str) -> None:
    coupled = shared_scene("double-pendulum")
    with pytest.raises(
        lg.StatementError,
        match=r"its mass matrix changes along the motion\. Use variational-midpoint or galerkin4, which are symplectic "
        r"for any mass matrix, or rk4 or dop853\.$",
    ):
        coupled.run(1.0, method=name)
    for remedy in ("variational-midpoint", "galerkin4", "rk4", "dop853"):
        assert coupled.run(0.1, method=remedy).status is lg.Status.SUCCESS


def test_a_splitting_is_refused_where_accelerations_depend_on_velocities() -> None:
    x = lg.coordinate("x")
    damped = lg.System(kinetic=x.dot**2 / 2, dissipation=x.dot**2 / 2, initial={x: 1.0})
    with pytest.raises(
        lg.StatementError,
        match=r"depend on velocities, as with friction or a magnetic field\. With friction use rk4 or dop853; without, "
        r"variational-midpoint or galerkin4, which are symplectic\.$",
    ):
        damped.run(1.0, method="verlet")


def test_no_step_means_a_thousand_and_says_so(pendulum: lg.System) -> None:
    solution = pendulum.run(2.0, method="rk4")
    assert solution.steps == 1000 and "No step was given: 1000 fixed steps of 0.002 were taken." in solution.message


def test_the_same_tolerance_given_twice_is_given_once(pendulum: lg.System) -> None:
    method = lg.methods.DOP853(rtol=1e-6, atol=1e-8)
    assert (pendulum.run(1.0, method=method, rtol=1e-6).y == pendulum.run(1.0, method=method).y).all()
