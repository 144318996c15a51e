"""Newton's method step by step: what machine code does is what the interpreter does, to the last bit.

The interpreter runs the procedures of an implicit step as they stand, with the compiled law, beside a compiled run.
After each step the unknowns, the matrices, the number of corrections and all that a solve knows are the same. The
numpy machine has no fused multiply-add: there the same decisions are taken where rounding does not decide.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lagrange.machine.backend import FloatArray
from lagrange.machine.kernel import llvm_calling
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.steps.llvm_layout import laid_out
from lagrange.procedure.interpreter import Span, run
from lagrange.procedure.step.memory import EFFORT, NEWTON, Layout, SolveLayout
from lagrange.procedure.step.run import COUNTS, RUN
from lagrange.procedure.step.trial import accept_step, take_step
from lagrange.program.actions import LAWS
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.plan import StepPlan
from tests.models import TARGETS, model, springs
from tests.trajectory.runs import CONTROLLED, FIXED, IMPLICIT, planned

S = DriverState
Function = Callable[..., Any]
FIELDS = [name for name, _ in NEWTON.fields]


class Compiled:
    """A compiled run, one step at a time."""

    def __init__(self, name: str, compiled: Model, step: float) -> None:
        self.start = np.array(compiled.statement.initial)
        problem = Problem(compiled, compiled.parameter_values(), 0.0, 1.0, self.start)
        plan = planned(name, problem)
        assert isinstance(plan, StepPlan)
        self.step = plan.step
        self.driver: Any = plan.driver(compiled, compiled.parameter_array())
        self.state = DriverState(0.0, 1.0, self.start, 1e-6, 1e-8, step if name in FIXED else 0.0)

    def take(self) -> Outcome:
        times, rows = np.empty(1), np.empty((5, len(self.start)))
        self.state.counts[S.ROWS] = 0
        return Outcome(self.driver.advance(self.state, 1, times, rows))

    def known(self, solve: SolveLayout, offset: int) -> dict[str, float]:
        """Return what a solve of the steps knows, whose memory begins at an offset."""
        start = offset + solve.flags
        record: Any = NEWTON.structure.from_buffer_copy(self.driver._work[start : start + len(FIELDS)].tobytes())
        return fields(record)


def fields(record: Any) -> dict[str, float]:
    return {name: getattr(record, name) for name in FIELDS}


class Interpreted:
    """The same procedures, interpreted on memory of their own; a compiled run has theirs at an offset."""

    def __init__(self, beside: Compiled, compiled: Model, layout: Layout, offset: int) -> None:
        self.beside, self.layout, self.offset = beside, layout, offset
        self.take, self.accept = take_step(self.layout), accept_step(self.layout)
        law, parameters = LAWS[beside.step.law], compiled.parameter_array()
        kernels = [compiled.kernel(name) for name in (law.quantity, law.derivative)]
        self.law, self.jacobian = (self.between_arrays(kernel, parameters) for kernel in kernels)
        if self.layout.in_registers:
            self.law = self.of_numbers(kernels[0], parameters)
        self.work: FloatArray = np.zeros(self.layout.size + 8)
        self.work[self.places] = beside.start
        self.newtons: list[Any] = [NEWTON.structure() for _ in self.layout.solves]
        self.effort: Any = EFFORT.structure()

    @property
    def places(self) -> NDArray[np.intp]:
        """Where the state stands, whose vectors are padded."""
        layout = self.layout
        found = [layout.place(i) + np.arange(layout.length) for i in range(layout.step.states)]
        return np.concatenate(found)

    def between_arrays(self, kernel: Function, parameters: FloatArray) -> Function:
        size = self.layout.dimension

        def evaluate(t: float, y: Span, _: Span, out: Span) -> bool:
            found = kernel(t, np.array([y[i] for i in range(size)]), parameters).ravel()
            for i, value in enumerate(found):
                out[i] = value
            return False

        return evaluate

    def of_numbers(self, kernel: Function, parameters: FloatArray) -> Function:
        first = self.layout.dimension // 2 if LAWS[self.layout.step.law].states == 1 else 0

        def evaluate(t: float, *given: Any) -> tuple[Any, ...]:
            return (*map(float, kernel(t, np.array(given[:-1]), parameters)[first:]), False)

        return evaluate

    def try_step(self, t: float, h: float, *, slope_known: bool) -> int:
        self.effort.evaluations = 0
        laws: tuple[Any, ...] = (self.law, [], self.jacobian, [])
        floors = [1e-8] * self.layout.dimension + [1.0] * 8
        given = (t, h, 1e-6, floors, self.effort, *self.newtons, self.work, slope_known)
        return int(run(self.take, *laws, *given)[0])

    def calls(self, *, known: bool) -> int:
        """Return how often a step evaluates the law outside of its solves."""
        step = self.layout.step
        return len(step.calls) - (known and step.starts_with_slope)

    def make_state(self) -> None:
        where = RUN.structure(), COUNTS.structure()
        run(self.accept, *where, *self.newtons, self.work, 0.0, [], [])

    def assert_same(self) -> None:
        """Compare what a step leaves: unknowns, residuals, weights, history and matrices, and what each solve knows."""
        for solve, record in zip(self.layout.solves, self.newtons, strict=True):
            assert self.beside.known(solve, self.offset) == fields(record)
            theirs = self.beside.driver._work[self.offset :]
            for same in (slice(solve.first, solve.first + solve.all), slice(solve.residual, solve.matrix)):
                assert (self.work[same] == theirs[same]).all()


def steps(name: str, n: int) -> tuple[Compiled, list[Interpreted]]:
    """Return a compiled run, and what takes its steps: that which takes the first one may take no other."""
    compiled = springs("llvm", n)
    beside = Compiled(name, compiled, 0.07)
    layout = laid_out(beside.step, 2 * n)
    first = [] if beside.step.starter is None else [Interpreted(beside, compiled, layout.starting, layout.end)]
    return beside, [*first, Interpreted(beside, compiled, layout, 0)]


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("name", IMPLICIT)
def test_machine_code_takes_the_steps_of_the_interpreter(name: str, n: int) -> None:
    """One coordinate in registers, two in registers and whole blocks, five between arrays with a block begun."""
    assert llvm_calling.fit(2 * n) is (n < 5)
    beside, taking = steps(name, n)
    for _ in range(9 if n < 5 else 5):
        ours, state = taking[0], beside.state
        t, known, before = state.t, bool(state.count(S.SLOPE_KNOWN)), state.y.copy()
        taken, evaluations = state.count(S.STEPS), state.count(S.EVALUATIONS)
        first = name in CONTROLLED and state.reals[S.H] == 0.0
        assert beside.take() is Outcome.PAUSED
        h = beside.known(ours.layout.solves[0], ours.offset)["tried_step"]
        assert ours.try_step(t, h, slope_known=known) == Outcome.DONE
        evaluations += ours.effort.evaluations + ours.calls(known=known) + (3 if first else 0)
        assert state.count(S.EVALUATIONS) == evaluations
        assert state.reals[S.RESIDUAL] == ours.effort.residual
        if len(taking) > 1:
            taking = taking[1:]
            following = taking[0]
            following.work[following.places + following.layout.place(following.layout.step.states)] = before
            following.work[following.places] = ours.work[ours.places + ours.layout.place(ours.layout.new)]
        elif state.count(S.STEPS) > taken:
            ours.make_state()
        assert (taking[0].work[taking[0].places] == state.y).all()
        ours.assert_same()
    assert (beside.start != beside.state.y).any()


@pytest.mark.parametrize("system", ["pendulum", "double pendulum", "cart and pole", "elastic pendulum"])
@pytest.mark.parametrize("name", CONTROLLED)
def test_the_numpy_machine_decides_alike_where_rounding_does_not(name: str, system: str) -> None:
    """Corrections, matrices and steps: corrections end far above round-off where steps follow the error."""
    ours, theirs = (Compiled(name, model(system, target), 0.0) for target in TARGETS)
    for _ in range(40):
        assert ours.take() is theirs.take()
        assert (ours.state.counts == theirs.state.counts).all()
        pairs = zip(ours.driver.kept(), theirs.driver.kept(), strict=True)
        for one, other in pairs:
            assert (one.step == 0.0) == (other.step == 0.0)
            assert one.step == pytest.approx(other.step, rel=1e-5)
            assert one.inverse == pytest.approx(other.inverse, rel=1e-4, abs=1e-6)
