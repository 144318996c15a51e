"""Drivers of both machines, step by step, and the decisions of Newton's method after a correction.

A wrong decision about a step often only costs time, which no result shows. So every entry of `DriverState` is
compared, for all methods with step programs. Steps are accepted, rejected, not finite, unsolvable, singular, or too
short.
"""

from collections.abc import Callable
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.algorithm.step.memory import COUNTS, NEWTON, RUN
from lagrange.algorithm.step.newton_corrections import (
    DIVERGENCE_GROWTH,
    DIVERGENCE_RATE,
    FEW_CORRECTIONS,
    FRESH_RATE,
    LARGEST_MATRIX_AGE,
    LARGEST_RATE,
    LEAST_RATE,
    MATRIX_AGE,
    NOISE_DECAY,
    RATE_INCREASE,
    ROUND_OFF_FRACTION,
    SLOW_RATE,
    STAGNATION_NORM,
    STAGNATION_RATE,
    TOLERANCE_FRACTION,
    assess_correction,
)
from lagrange.compiler import compile_model, machine, model_of
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.graph.sympy_nodes import to_sympy
from lagrange.machine.drivers import StepDriver
from lagrange.machine.llvm.engine import CompiledProcedure
from lagrange.machine.llvm_machine import loop_layout
from lagrange.machine.model import Model
from lagrange.machine.python_source import loaded
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.interpreter import run
from lagrange.program.step import StepProgram, trace
from lagrange.program.step_size_control import Control
from lagrange.statement.coordinate import coordinate, t
from lagrange.statement.scene.library import load
from lagrange.statement.statement import Statement
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.implicit import ImplicitMethod
from lagrange.trajectory.plan import StepPlan
from tests.models import TARGETS, build, c, k, m, stated, x, y
from tests.trajectory.runs import (
    CONSTRAINED,
    CONTROLLED,
    FIXED,
    IMPLICIT,
    SLOPES,
    SPLITTINGS,
    STEPPED,
    implicit,
    planned,
)

S = DriverState


def driven() -> Statement:
    return stated(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=k * sp.sqrt(1 + x**2 + y**2) + x**4 / 4,
        forces={x: sp.cos(3 * t) - c * x.dot * y},
        initial={x: 0.4, y.dot: 0.6},
    )


def separable() -> Statement:
    return stated(
        kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=k * x**2 * y**2 + x**4, initial={x: 0.9, y: -0.4, y.dot: 0.6}
    )


def pole() -> Statement:
    """Return a system with the motion x = 1 / (1 - t)."""
    return stated(kinetic=x.dot**2 / 2, potential=-(x**4) / 2, initial={x: 1.0, x.dot: 1.0})


def edge() -> Statement:
    """Return a system whose forces have no value beyond x = 0."""
    return stated(kinetic=x.dot**2 / 2, potential=-sp.sqrt(x), initial={x: 1.0, x.dot: -3.0})


def degenerate() -> Statement:
    """Return a system whose mass matrix is singular from x = 1 on."""
    return stated(
        kinetic=x.dot**2 / 2 + (y.dot + x.dot) ** 2 / 2 * sp.Max(0, 1 - x), initial={x: 0.5, x.dot: 1.0, y.dot: 0.2}
    )


SYSTEMS: dict[str, Callable[[], Statement]] = {
    made.__name__: made for made in (driven, separable, pole, edge, degenerate)
}


@cache
def models(name: str) -> list[Model]:
    """Return a model on each machine."""
    statement = SYSTEMS[name]()
    equations = euler_lagrange(statement)
    return [model_of(statement, machine(target), equations) for target in TARGETS]


def assert_lockstep(
    drivers: list[Any], start: Any, end: float, step: float, tolerances: tuple[float, float], **reals: float
) -> Outcome:
    """Take single steps on both machines until the run ends, and compare all entries of their states."""
    states = [S(0.0, end, start, *tolerances, step) for _ in drivers]
    outcome = Outcome.PAUSED
    for state in states:
        for which, value in reals.items():
            state.reals[getattr(S, which)] = value
    for _ in range(60):
        outcomes = []
        for driver, state in zip(drivers, states, strict=True):
            times, rows = np.zeros(1), np.zeros((5, len(start)))
            state.counts[S.ROWS] = 0
            outcomes.append(driver.advance(state, 1, times, rows))
            if state.counts[S.ROWS]:
                assert times[0] == state.t and (rows[0] == state.y).all()
        assert outcomes[0] == outcomes[1]
        assert_same(*states)
        outcome = outcomes[0]
        # Where forces lose their values a step behind a rejected one is longer or shorter by chance.
        if outcome is not Outcome.PAUSED or states[0].cause is Outcome.NON_FINITE:
            break
    return outcome


def assert_same(ours: DriverState, theirs: DriverState) -> None:
    """Assert that two states are equal up to rounding, which is larger for error vectors and so for the next step."""
    counts = [i for i in range(len(ours.counts)) if i != S.EVALUATIONS]
    assert (ours.counts[counts] == theirs.counts[counts]).all()
    # By chance round-off takes one correction more.
    assert ours.count(S.EVALUATIONS) == pytest.approx(theirs.count(S.EVALUATIONS), rel=0.2)
    reals = [i for i in range(len(ours.reals)) if i not in (S.RESIDUAL, S.PREVIOUS)]
    assert ours.reals[reals] == pytest.approx(theirs.reals[reals], rel=1e-2)
    assert ours.reals[S.PREVIOUS] == pytest.approx(theirs.reals[S.PREVIOUS], rel=1e-1)
    assert ours.y == pytest.approx(theirs.y, rel=1e-3, abs=1e-3)


def drivers(name: str, system: str) -> list[Any]:
    result = []
    for compiled in models(system):
        start = np.array(compiled.statement.initial)
        problem = Problem(compiled, compiled.parameter_values(), 0.0, 1.0, start)
        result.append(planned(name, problem).driver(compiled, compiled.parameter_array()))
    return result


def test_procedures_know_the_entries_of_a_run_by_name() -> None:
    state = S(0.0, 1.0, np.zeros(2), 1e-6, 1e-8, 0.1)
    for record, count in ((RUN, S.FLOORS), (COUNTS, len(state.counts))):
        assert [getattr(S, name.upper()) for name, _ in record.fields] == list(range(count))


TAKEN = [
    (name, system)
    for name in (*STEPPED, *IMPLICIT)
    for system in SYSTEMS
    # A splitting takes no forces of velocities, and no mass matrix that moves.
    if name not in SPLITTINGS or system not in ("driven", "degenerate")
]


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "system"), TAKEN)
def test_both_machines_decide_alike(name: str, system: str) -> None:
    if (name, system) in (("trapezoidal", "pole"), ("trapezoidal", "edge"), ("radau5", "edge")):
        pytest.skip("round-off decides which step is the last that has a solution")
    start = np.array(models(system)[0].statement.initial)
    for end in (2.0, -2.0):
        step = np.copysign(0.07 if system == "driven" else 0.021, end) if name in FIXED else 0.0
        outcome = assert_lockstep(drivers(name, system), start, end, step, (1e-5, 1e-7))
        if system in ("driven", "separable") and name in FIXED:
            assert outcome in (Outcome.DONE, Outcome.PAUSED)


@pytest.mark.few(1)
@pytest.mark.parametrize(("which", "value"), [("LONGEST", 0.013), ("H", 0.5), ("H", 1e-7), ("PREVIOUS", 1e-3)])
@pytest.mark.parametrize("name", ["dopri5", "dop853", "verner9", "radau5", "radau3"])
def test_both_machines_keep_to_the_same_bounds(name: str, which: str, value: float) -> None:
    start = np.array(models("driven")[0].statement.initial)
    for tolerances in ((1e-3, 1e-9), (1e-9, 1e-4)):
        assert_lockstep(drivers(name, "driven"), start, 1.0, 0.0, tolerances, **{which: value})


def made(large: int) -> StepProgram:
    """Return a step whose state, first or second error vector is infinite."""

    def step(f: Any, t: Any, y: Any, h: Any) -> Any:
        first = f(t, y)
        parts = [y + first * h, first * (h * 1e-3), first * (h * 1e-3)]
        parts[large] = parts[large] + first * 1e308
        return tuple(parts)

    return trace(f"large{large}", step, control=Control(3, damped=True))


@pytest.mark.parametrize("large", [0, 1, 2])
def test_no_part_of_a_step_may_be_beyond_all_numbers(large: int) -> None:
    step, compiled = made(large), models("driven")
    both: list[Any] = [
        StepDriver(machine(target), step, item.kernel("rhs"), item.parameter_array())
        for target, item in zip(TARGETS, compiled, strict=True)
    ]
    start = 100 * np.array(compiled[0].statement.initial)
    states = [S(0.0, 1.0, start, 1e-6, 1e-6, 0.01) for _ in both]
    for driver, state in zip(both, states, strict=True):
        assert driver.advance(state, 1, np.zeros(1), np.zeros((5, 4))) is Outcome.PAUSED
        assert state.cause is Outcome.NON_FINITE
        assert (state.count(S.STEPS), state.count(S.REJECTED)) == (0, 1)
    assert_same(*states)


# --- procedure steps ------------------------------------------------------------------------------------------
# Steps of both machines: the memory beside a vector, and decisions that rounding does not take.


class Compiled:
    """A run by compiled code, one step per call."""

    def __init__(self, name: str, compiled: Model, step: float, share: float = 0.0) -> None:
        self.start = np.array(compiled.statement.initial)
        problem = Problem(compiled, compiled.parameter_values(), 0.0, 1.0, self.start)
        plan = planned(name, problem)
        assert isinstance(plan, StepPlan)
        self.step, self.projected = plan.step, plan.projected
        self.driver: Any = plan.driver(compiled, compiled.parameter_array())
        self.state = DriverState(0.0, 1.0, self.start, 1e-6, 1e-8, step if name in FIXED else 0.0, share)

    def take(self) -> Outcome:
        times, rows = np.empty(1), np.empty((5, len(self.start)))
        self.state.counts[S.ROWS] = 0
        return Outcome(self.driver.advance(self.state, 1, times, rows))


@cache
def four_bar() -> Model:
    return compile_model(load("four-bar"), euler_lagrange(load("four-bar")))


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "name", [name for name in (*SLOPES, *CONTROLLED, *STEPPED) if name not in CONSTRAINED + SPLITTINGS]
)
def test_the_projection_leaves_nothing_behind_the_entries_of_a_vector(name: str) -> None:
    """Six entries are in blocks of four. Norms are taken of whole blocks, so the padding must stay 0."""
    beside = Compiled(name, four_bar(), 0.01)
    layout = loop_layout(beside.step, 6, projected=True)
    for _ in range(5):
        beside.take()
        for vector in range(layout.errors + len(layout.step.errors)):
            place = layout.place(vector)
            assert not beside.driver._work[place + layout.length : place + layout.width].any()


# --- decisions of Newton's method after a correction: converged, continue, update the matrix, or give up -------


FRESH, FAR = 1, 100
"""Corrections since the matrix was made: a new one has been tried, and one that is old."""

VERDICTS = {Outcome.DONE: True, Outcome.PAUSED: False}


@cache
def judgements(adaptive: bool) -> tuple[Callable[..., Any], ...]:
    """Return the procedure by each printer."""
    procedure = assess_correction.form(adaptive=adaptive)
    return lambda *args: run(procedure, *args)[0], loaded(procedure), CompiledProcedure(procedure, optimize=True)


class Solve:
    """A nonlinear solve of a step, with a matrix for steps of 0.5."""

    def __init__(self, *, adaptive: bool = False, rate: float = 0.1, noise: float = 1.0, age: int = 0) -> None:
        self.adaptive = adaptive
        self.known: Any = NEWTON.structure(matrix_step=0.5, differentiated=1, rate=rate, noise=noise, age=age)

    def outcome(self, iteration: int, norm: float, previous: float, since: int) -> Outcome:
        """Return the decision about a correction, after a check that all printers agree on it and on the record."""
        before, result = bytes(self.known), []
        for judgement in judgements(self.adaptive):
            made = NEWTON.structure.from_buffer_copy(before)
            result.append((int(judgement(made, iteration, norm, previous, since)), bytes(made)))
        assert result[0] == result[1] == result[2]
        self.known = NEWTON.structure.from_buffer_copy(result[0][1])
        return Outcome(result[0][0])

    def enough(self, iteration: int, norm: float, previous: float, since: int) -> bool:
        """True if the method has converged, after a check that it has not given up."""
        return VERDICTS[self.outcome(iteration, norm, previous, since)]


def renewed(result: Solve) -> bool:
    """Return whether the next correction, or the next step, updates the matrix and the derivative."""
    assert (result.known.matrix_step == 0.0) == (not result.known.differentiated)
    return bool(result.known.matrix_step == 0.0)


@pytest.mark.parametrize(("adaptive", "bound"), [(False, ROUND_OFF_FRACTION), (True, TOLERANCE_FRACTION)])
@pytest.mark.parametrize(("part", "enough"), [(0.9, True), (1.1, False)])
def test_what_is_left_is_the_rest_of_a_geometric_series(
    adaptive: bool, bound: float, part: float, enough: bool
) -> None:
    """The ratio of a first correction is that of the previous step; later ratios are measured."""
    rate = 0.2
    norm = part * bound * (1 - rate) / rate
    assert Solve(adaptive=adaptive, rate=rate).enough(0, norm, 0.0, FAR) is enough
    result = Solve(adaptive=adaptive, rate=0.9, noise=1.0)
    assert result.enough(1, norm, norm / rate, FAR) is (enough or (not adaptive and norm / rate <= 1))
    if enough:
        assert result.known.rate == pytest.approx(rate)


def test_two_corrections_in_a_row_are_round_off() -> None:
    for norm, previous, enough in ((0.9, 0.95, True), (0.9, 1.1, False), (1.1, 0.95, False)):
        assert Solve().enough(1, norm, previous, 0) is enough
        assert Solve(noise=2.0).enough(1, 2 * norm, 2 * previous, 0) is enough
        assert Solve(adaptive=True).enough(1, norm / 2, norm, 0) is False
    assert Solve(rate=0.9).enough(0, 0.9, 0.0, 0) is False, "there is no correction before the first"


def test_a_rate_that_is_not_measured_ages() -> None:
    for before, after in ((0.1, 0.1 * RATE_INCREASE), (0.85, LARGEST_RATE)):
        result = Solve(rate=before)
        assert result.enough(0, 1e-6, 0.0, FAR)
        assert result.known.rate == pytest.approx(after)
    result = Solve()
    assert result.enough(1, 1e-9, 1.0, FAR)
    assert result.known.rate == LEAST_RATE


def test_noise_is_forgotten_down_to_one() -> None:
    for before, after in ((5.0, 5.0 * NOISE_DECAY), (1.05, 1.0), (1.0, 1.0)):
        result = Solve(noise=before)
        assert result.enough(0, 1e-6, 0.0, FAR)
        assert result.known.noise == pytest.approx(after)


@pytest.mark.parametrize(
    ("iteration", "age", "new"),
    [
        (0, 0, False),
        (FEW_CORRECTIONS - 1, MATRIX_AGE, False),
        (FEW_CORRECTIONS, MATRIX_AGE - 2, False),
        (FEW_CORRECTIONS, MATRIX_AGE - 1, True),
        (0, LARGEST_MATRIX_AGE - 2, False),
        (0, LARGEST_MATRIX_AGE - 1, True),
    ],
)
def test_a_step_of_many_corrections_or_an_old_matrix_wants_a_new_one(iteration: int, age: int, new: bool) -> None:
    result = Solve(age=age)
    assert result.enough(iteration, 1e-6, 1e-3, FAR)
    assert result.known.age == age + 1 and renewed(result) is new


@pytest.mark.parametrize(
    ("iteration", "rate", "new"), [(0, 0.1, False), (1, 2 * FRESH_RATE, True), (1, FRESH_RATE / 2, False)]
)
def test_where_steps_follow_the_error_a_slow_step_wants_a_new_matrix(iteration: int, rate: float, new: bool) -> None:
    result = Solve(adaptive=True)
    assert result.enough(iteration, 1e-6, 1e-6 / rate, FAR)
    assert renewed(result) is new


@pytest.mark.parametrize("rate", [SLOW_RATE / 2, 2 * SLOW_RATE, 1.5])
def test_corrections_that_shrink_slowly_want_a_new_matrix_where_it_is_old(rate: float) -> None:
    for since, old in ((0, False), (FRESH, False), (MATRIX_AGE - 1, False), (MATRIX_AGE, True), (FAR, True)):
        result = Solve()
        assert not result.enough(1, 2 * STAGNATION_NORM, 2 * STAGNATION_NORM / rate, since)
        assert renewed(result) is (old and rate > SLOW_RATE)
        assert not Solve(rate=rate).enough(0, 2 * STAGNATION_NORM, 0.0, since), "nothing is measured by the first"


def test_with_a_new_matrix_small_corrections_that_stall_are_round_off() -> None:
    for rate, norm, since, enough in (
        (1.1 * STAGNATION_RATE, STAGNATION_NORM / 2, FRESH, True),
        (1.1 * STAGNATION_RATE, STAGNATION_NORM / 2, MATRIX_AGE - 1, True),
        (1.1 * STAGNATION_RATE, STAGNATION_NORM / 2, 0, False),
        (1.1 * STAGNATION_RATE, STAGNATION_NORM / 2, MATRIX_AGE, False),
        (1.1 * STAGNATION_RATE, STAGNATION_NORM * 2, FRESH, False),
        (0.9 * STAGNATION_RATE, STAGNATION_NORM / 2, FRESH, False),
        (3 * DIVERGENCE_GROWTH, STAGNATION_NORM / 2, FRESH, True),
    ):
        result = Solve()
        assert result.enough(1, norm, norm / rate, since) is enough
        assert result.known.noise == (2 * norm if enough else 1.0)
        assert not Solve(adaptive=True).enough(1, norm, norm / min(rate, 0.8), since)


def test_with_a_new_matrix_large_corrections_that_grow_have_no_end() -> None:
    for rate, norm, since, hopeless in (
        (1.1 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, FRESH, True),
        (1.1 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, MATRIX_AGE - 1, True),
        (1.1 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, 0, False),
        (1.1 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, MATRIX_AGE, False),
        (0.9 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, FRESH, False),
    ):
        if hopeless:
            assert Solve().outcome(1, norm, norm / rate, since) is Outcome.DIVERGED
        else:
            assert not Solve().enough(1, norm, norm / rate, since)


def test_where_steps_follow_the_error_slow_corrections_want_a_shorter_one() -> None:
    for rate in (1.1 * DIVERGENCE_RATE, 5.0, np.nan):
        assert Solve(adaptive=True).outcome(1, 100.0, 100.0 / rate, FRESH) is Outcome.DIVERGED
    assert not Solve(adaptive=True).enough(1, 100.0, 100.0 / (0.9 * DIVERGENCE_RATE), FRESH)
    assert not Solve(adaptive=True, rate=5.0).enough(0, 100.0, 0.0, FRESH)


# --- matrix ---------------------------------------------------------------------------------------------------
# With the right matrix one correction solves a linear law. A wrong one costs corrections: evaluations are counted.


STEP = 0.5
"""Long beside the times of the motion: a matrix without one of its terms needs many corrections."""


@cache
def linear(target: str, n: int, *, constrained: bool) -> Model:
    """Return coupled oscillators with friction, a gyroscopic term, and forces that depend on time."""
    q = [coordinate(f"q{i}") for i in range(n)]
    kinetic = sum((2 + i) * a.dot**2 for i, a in enumerate(q)) / 2 + sum(a.dot * b.dot for a, b in pairwise(q)) / 3
    potential = sum(sp.Rational(5 + i, 4) * a**2 for i, a in enumerate(q)) + sum(a * b for a, b in pairwise(q)) / 4
    return build(
        target,
        lagrangian=kinetic - potential + q[0] * q[-1].dot,
        coordinates=q,
        forces={a: -sp.Rational(3 + i, 10) * a.dot + sp.cos(t) for i, a in enumerate(q)},
        constraints={"slide": q[0] + 2 * q[1] - q[2] / 3} if constrained else {},
        initial=dict.fromkeys(q, 0.0),
    )


# --- methods of one's own, for what no registered one has -----------------------------------------------------


def two_solves(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
    """A step with two solves. The second has two unknowns, each in all residuals and arguments."""
    a = solve(lambda a: f(t + h / 4, y + a * (h / 4)) * 2 - a * 3, lambda: f(t, y))

    def residuals(b: Any, c: Any) -> tuple[Any, Any]:
        first, second = f(t + h / 2, y + b * (h / 3) + c * (h / 5) + a * h), f(t + h, y - b * (h / 7) + c * (h / 2))
        third = f(t, y + b * h)
        return b * 2 - c - first + third * h, c * Fraction(5, 3) + second * 2 - third * 4 + a + b * (h / 3)

    b, c = solve(residuals, (a, a))
    return y + a * (h / 4) + b * (h / 4) + c * (h / 2)


def damped(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
    """A step with two solves, error control, and vectors damped by each solve."""
    z = solve(lambda z: f(t + h, y + z) * h - z * 2, y * 0)
    far = solve.damp(h * 2, z)
    w = solve(lambda w: (f(t + h / 2, y + w / 3) + f(t + h, y - w * 2)) * h - w * 5, lambda: f(t, y) * h)
    return y + w, (solve.damp(h / 3, w - z) + solve.damp(-h, far)) * h


def momenta(g: Any, t: Any, q: Any, v: Any, h: Any, solve: Any) -> Any:
    """A step with unknowns in both arguments; both residuals contain momenta and forces with different factors."""
    before, force = g(t, q, v)

    def residuals(a: Any, b: Any) -> tuple[Any, Any]:
        p0, f0 = g(t, q + a * (h / 3) - b * (h / 5), a * 2 - b)
        p1, f1 = g(t + h / 2, q + a * h, b + a / 7)
        p2, f2 = g(t + h, q + b * h, a / 2 + b)
        return p0 + before * 2 - p1 * 3 + f0 * h - f2 * (2 * h), p2 * 2 - force * h + f1 * (h / 2) - p0 + a

    a, b = solve(residuals, (v, v))
    return q + a * h, b


def two_steps(f: Any, t: Any, y: Any, before: Any, h: Any, solve: Any) -> Any:
    k = solve(lambda k: f(t + h, y * 2 - before + k * h) - k * 2 + f(t, before), lambda: f(t, y))
    return y + k * h


def start(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
    k, _ = solve(
        lambda k, m: (f(t + h, y + k * (h / 2) + m * (h / 2)) - k, f(t, y + m * h) * 2 - m * 3 + k), (y * 0, y * 0)
    )
    return y + k * h


OWN = {
    "two-solves": ImplicitMethod("two-solves", Claims(1, explicit=False), two_solves),
    "damped": ImplicitMethod("damped", Claims(1, adaptive=True, explicit=False), damped, control=Control(2)),
    "momenta": ImplicitMethod("momenta", Claims(1, explicit=False), momenta, law="momentum"),
    "two-steps": ImplicitMethod("two-steps", Claims(1, explicit=False), two_steps, starter=start),
}
EVERY = (*IMPLICIT, *OWN)


def method_of(name: str) -> ImplicitMethod:
    return OWN[name] if name in OWN else implicit(name)


class Steps:
    """Steps of a method for a linear law, from a random state that satisfies the constraint."""

    def __init__(self, method: ImplicitMethod, model: Model) -> None:
        n, self.size = model.dimension, 2 * model.dimension
        start = np.random.default_rng(1).uniform(-1.0, 1.0, self.size)
        if model.equations.constraints:
            start[[2, n + 2]] = 3 * (start[[0, n]] + 2 * start[[1, n + 1]])
        problem = Problem(model, model.parameter_values(), 0.0, 9.0, start)
        plan = method.plan(problem)
        self.step = plan.step
        self.driver: Any = plan.driver(model, model.parameter_array())
        self.state = DriverState(0.0, 9.0, start, 1e-9, 1e-9, STEP)

    def take(self) -> int:
        """Take a step, and return the number of evaluations of the law."""
        before = self.state.count(DriverState.EVALUATIONS)
        self.state.counts[DriverState.ROWS] = 0
        outcome = self.driver.advance(self.state, 1, np.empty(1), np.empty((5, self.size)))
        # Its equations are solved: an adaptive method may find that its error is above the tolerance.
        solved = self.state.count(DriverState.ROWS) == 1 or self.state.cause is Outcome.STEP_TOO_SMALL
        assert outcome is Outcome.PAUSED and solved
        return self.state.count(DriverState.EVALUATIONS) - before


CASES = [(name, constrained) for name in EVERY for constrained in (False, True)[: 1 + (name in CONSTRAINED)]]


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("n", [3, 5])
@pytest.mark.parametrize(("name", "constrained"), CASES)
def test_a_linear_law_is_solved_by_one_correction(name: str, constrained: bool, n: int, target: str) -> None:
    """A second correction confirms the first one. The slope of a guess is one more evaluation."""
    steps = Steps(method_of(name), linear(target, n, constrained=constrained))
    first, program = steps.step.starter or steps.step, steps.step
    assert steps.take() <= 2 * sum(len(solve.calls) for solve in first.solves) + len(first.calls) + 1
    for _ in range(3):
        assert steps.take() <= 2 * sum(len(solve.calls) for solve in program.solves) + len(program.calls) + 1


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["radau3", "radau5", "damped"])
def test_dampers_are_inverses_of_the_identity_less_a_multiple_of_the_derivative(name: str, target: str) -> None:
    model = linear(target, 3, constrained=False)
    steps = Steps(method_of(name), model)
    steps.take()
    layout, work = steps.driver._layout, steps.driver._work
    dampers = [
        work[solve.damper(damp) :][: solve.length * solve.width].reshape(solve.length, solve.width)[:, : solve.length].T
        for solve in layout.solves
        for damp in solve.damped
    ]
    length = work[layout.solves[0].flags + NEWTON.places["matrix_step"]]
    jacobian = model.jacobian(0.0, np.zeros(6))
    assert len(dampers) == len(steps.step.damps) > 0
    for damper, damp in zip(dampers, steps.step.damps, strict=True):
        factor = float(to_sympy(damp.factor, {steps.step.h: sp.Float(length)}))
        assert damper @ (np.eye(6) - factor * jacobian) == pytest.approx(np.eye(6), abs=1e-10)
