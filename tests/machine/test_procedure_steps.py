"""Steps one by one: what machine code does is what the interpreter does, to the last bit.

The interpreter runs the loop over steps as it stands, with the compiled law, beside a compiled run. After each trial
the state, the next step, all counts, the unknowns, the matrices and all that a solve knows are the same. The
numpy machine has no fused multiply-add: there the same decisions are taken where rounding does not decide.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lagrange.algorithm.step.controlled_steps import steps_of
from lagrange.algorithm.step.memory import EFFORT, NEWTON, Layout, SolveLayout
from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.compiler import compile_model
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine.backend import FloatArray
from lagrange.machine.kernel.llvm_module import fit
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.steps.llvm_driver import laid_out
from lagrange.procedure.interpreter import Span, run
from lagrange.program.actions import LAWS
from lagrange.statement.scene.library import load
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.plan import StepPlan
from tests.models import TARGETS, model, rods, springs
from tests.trajectory.runs import (
    CONSTRAINED,
    CONTROLLED,
    FIXED,
    IMPLICIT,
    SLOPES,
    SPLITTINGS,
    STEPPED,
    UNCONSTRAINED,
    planned,
)

S = DriverState
Function = Callable[..., Any]
FIELDS = [name for name, _ in NEWTON.fields]


class Compiled:
    """A compiled run, one step at a time."""

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

    def known(self, solve: SolveLayout, offset: int) -> dict[str, float]:
        """Return what a solve of the steps knows, whose memory begins at an offset."""
        start = offset + solve.flags
        record: Any = NEWTON.structure.from_buffer_copy(self.driver._work[start : start + len(FIELDS)].tobytes())
        return fields(record)


def fields(record: Any) -> dict[str, float]:
    return {name: getattr(record, name) for name in FIELDS}


class Interpreted:
    """The same loop over steps, interpreted on memory of its own, with the compiled law."""

    def __init__(self, beside: Compiled, compiled: Model) -> None:
        self.beside = beside
        projected = beside.projected and len(compiled.equations.constraints) > 0
        self.layout: Layout = laid_out(beside.step, compiled.dimension * 2, projected=projected)
        self.loop, self.effort = steps_of(self.layout), EFFORT.structure()
        law, parameters = LAWS[beside.step.law], compiled.parameter_array()
        kernel = compiled.law(law.quantity)
        by_number = self.layout.in_registers
        evaluate = self.of_numbers(kernel, parameters) if by_number else self.between_arrays(kernel, parameters)
        derivative = self.between_arrays(compiled.law(law.derivative), parameters) if self.layout.solves else None
        self.laws: tuple[Any, ...] = evaluate, [], derivative, []
        self.projection: tuple[Any, ...] = ()
        if projected:
            self.projection = self.between_arrays(compiled.law("projection"), parameters), []
        self.run = RUN.structure.from_buffer_copy(beside.state.reals.tobytes())
        self.counts = COUNTS.structure.from_buffer_copy(beside.state.counts.tobytes())
        self.floors = beside.state.reals[S.FLOORS :].copy()
        self.work: FloatArray = np.zeros(self.layout.size + 8)
        self.work[self.places] = beside.start
        self.solves = [(solve, 0) for solve in self.layout.solves]
        if beside.step.starter is not None:
            self.solves += [(solve, self.layout.end) for solve in self.layout.starting.solves]
        self.newtons: list[Any] = [NEWTON.structure() for _ in self.solves]

    @property
    def places(self) -> NDArray[np.intp]:
        """Where the state stands, whose vectors are padded."""
        layout = self.layout
        return np.concatenate([layout.place(i) + np.arange(layout.length) for i in range(layout.step.states)])

    def between_arrays(self, kernel: Any, parameters: FloatArray) -> Function:
        size = kernel.program.states

        def evaluate(t: float, y: Span, _: Span, out: Span) -> bool:
            found = kernel(t, np.array([y[i] for i in range(size)]), parameters).ravel()
            for i, value in enumerate(found):
                out[i] = value
            return False

        return evaluate

    def of_numbers(self, kernel: Function, parameters: FloatArray) -> Function:
        law = LAWS[self.layout.step.law]
        first = self.layout.dimension // 2 if law.quantity == "rhs" else 0

        def evaluate(t: float, *given: Any) -> tuple[Any, ...]:
            return (*map(float, kernel(t, np.array(given[:-1]), parameters)[first:]), False)

        return evaluate

    def take(self) -> Outcome:
        times, rows = [0.0], [0.0] * (self.layout.dimension + 8)
        self.counts.rows = 0
        records = self.run, self.counts, self.floors, self.effort, *self.newtons
        return Outcome(run(self.loop, *self.laws, *records, self.work, *self.projection, 1, times, rows)[0])

    def assert_same(self) -> None:
        """Compare what a trial leaves: where the run stands, what it counts, and what each solve keeps."""
        state, theirs = self.beside.state, self.beside.driver._work
        assert bytes(self.run) == state.reals[: S.FLOORS].tobytes()
        assert bytes(self.counts) == state.counts.tobytes()
        assert (self.work[self.places] == state.y).all()
        assert (self.floors == state.reals[S.FLOORS :]).all()
        for (solve, offset), record in zip(self.solves, self.newtons, strict=True):
            assert self.beside.known(solve, offset) == fields(record)
            for kept in (slice(solve.first, solve.first + solve.all), slice(solve.residual, solve.matrix)):
                assert (self.work[offset:][kept] == theirs[offset:][kept]).all()


@cache
def row_of(n: int) -> Model:
    return springs("llvm", n)


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("name", [*IMPLICIT, *STEPPED])
def test_machine_code_takes_the_steps_of_the_interpreter(name: str, n: int) -> None:
    """One coordinate in registers, two in registers and whole blocks, five between arrays with a block begun."""
    assert fit(2 * n) is (n < 5)
    compiled = row_of(n)
    for share in (0.0, 1e-3) if name not in FIXED else (0.0,):
        beside = Compiled(name, compiled, 0.07, share)
        ours = Interpreted(beside, compiled)
        for _ in range(9 if n < 5 else 3):
            outcome = beside.take()
            assert outcome is ours.take()
            ours.assert_same()
            if outcome is Outcome.UNSCALED:  # a law of momenta gives no slopes, from which sizes would follow
                beside.state.counts[S.SURVEYED] += 1
                ours.counts.surveyed += 1
        assert (beside.start != beside.state.y).any()


@pytest.mark.parametrize("links", [2, 3])
@pytest.mark.parametrize("name", [name for name in (*IMPLICIT, *STEPPED) if name not in (*UNCONSTRAINED, *SPLITTINGS)])
def test_machine_code_projects_the_steps_of_the_interpreter(name: str, links: int) -> None:
    """Two points of four coordinates in registers, three of six between arrays; rounding decides what is lost."""
    compiled = rods(links)
    assert fit(4 * links) is (links < 3)
    beside = Compiled(name, compiled, 0.01)
    ours = Interpreted(beside, compiled)
    for _ in range(2 if links > 2 else 6):
        assert beside.take() is ours.take()
        ours.assert_same()
    values = compiled.kernel("constraints")(beside.state.t, beside.state.y, compiled.parameter_array())
    assert np.abs(values).max() < 1e-14


@cache
def four_bar() -> Model:
    return compile_model(load("four-bar"), euler_lagrange(load("four-bar")))


@pytest.mark.few
@pytest.mark.parametrize(
    "name", [name for name in (*SLOPES, *CONTROLLED, *STEPPED) if name not in CONSTRAINED + SPLITTINGS]
)
def test_the_projection_leaves_nothing_behind_the_entries_of_a_vector(name: str) -> None:
    """Six entries in blocks of four: norms are taken of whole blocks, so what stands behind the entries must be 0."""
    beside = Compiled(name, four_bar(), 0.01)
    layout = laid_out(beside.step, 6, projected=True)
    for _ in range(5):
        beside.take()
        for vector in range(layout.errors + len(layout.step.errors)):
            place = layout.place(vector)
            assert not beside.driver._work[place + layout.length : place + layout.width].any()


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
