"""The LLVM machine: programs are compiled to machine code, and one compiled loop takes steps and finds events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np

from lagrange.algorithm.constants import RELATIVE_PERTURBATION, WIDEST_VECTOR, perturbation_factors
from lagrange.algorithm.dense.block import StepPolynomial, block_size
from lagrange.algorithm.events.loop import event_steps
from lagrange.algorithm.events.samples import work_size
from lagrange.algorithm.members.queue import LANE
from lagrange.algorithm.step.error_control import steps_of
from lagrange.algorithm.step.memory import Layout
from lagrange.errors import RunError
from lagrange.machine.backend import Callback, DensePath, FloatArray, SingularMassMatrix
from lagrange.machine.drivers import StepDriver
from lagrange.machine.kernel.llvm_kernel import STORED_TOGETHER, LlvmKernel, cached_kernel, fit
from lagrange.machine.llvm.address import workspace
from lagrange.machine.llvm.engine import CompiledProcedure, compiled
from lagrange.machine.llvm.processor import lanes, processor
from lagrange.machine.llvm_series import LlvmDense, LlvmSeries, of_steps
from lagrange.machine.state import DriverState, StepEventMemory, StepFunction
from lagrange.procedure.form import Procedure
from lagrange.procedure.lane_values import UNIFORM, VARYING
from lagrange.procedure.lanes import ACTIVE, MemberProcedures
from lagrange.procedure.rewrite import Pruner
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import LAWS, StepProgram

EVENT_ARRAYS = (
    *("times", "states", "sign", "near", "direction", "remaining", "zero_sizes", "arrivals", "which", "when", "there"),
    *("settings", "break_rows", "break_times", "break_states", "kept_reals", "kept_counts"),
)
"""Names of the arrays of a `StepEventMemory` that are arguments of the loop `event_steps`."""


class LlvmEventSteps:
    """Function that takes steps by `driver` and finds events on them, in one compiled loop, for one set of parameters.

    It has the type `EventSteps`. `Machine.event_steps` describes the arguments with which it is created.
    """

    def __init__(
        self,
        driver: StepDriver,
        events: Program,
        resets: Program | None,
        parameters: FloatArray,
        dense: DensePath,
        screen: DensePath | None,
    ) -> None:
        self._driver, self._written = driver, dense.polynomial()
        # Implicit methods take long steps, on which a cubic through both ends cannot exclude an event.
        screens = screen is not None and not self._written.both
        self._screen = screen.polynomial() if screen is not None and screens else self._written
        self._kernel = kernel = cached_kernel(events)
        self._resets = kernel if resets is None else cached_kernel(resets)
        n, count = events.states, events.shape[0]
        written, prepared = self._written, kernel.prepare(parameters)
        self.both = written.both
        results = 0 if resets is None else resets.shape[0]
        arguments: dict[str, Any] = {
            "polynomial": written.function,
            "given": written.context,
            "degree": dense.degree,
            "both": int(written.both),
            **{name: np.zeros(block_size(n, WIDEST_VECTOR) + WIDEST_VECTOR) for name in ("step_data", "neighbours")},
            "screen": self._screen.function,
            "screen_given": self._screen.context,
            # The context of a block polynomial begins with the right-hand side for columns, and its parameters.
            "law": int(self._screen.context[0]),
            "law_parameters": int(self._screen.context[1]),
            "screens": screens,
            "path_work": workspace(max(written.work, self._screen.work)),
            "c": workspace((dense.degree + 1) * n * WIDEST_VECTOR + WIDEST_VECTOR),
            "kernel": kernel.columns_address,
            "parameters": prepared,
            "values": kernel.address,
            "value_numbers": prepared,
            "resets": self._resets.address,
            "reset_numbers": self._resets.prepare(parameters),
            "dimension": n,
            "events": count,
            "factors": 1 + RELATIVE_PERTURBATION * perturbation_factors(n + 1),
            "step_sides": np.zeros(4 * count, dtype=np.int64),
            "levels": np.zeros(count),
            "work": workspace(work_size(n, count)),
            "scratch": np.zeros(n + 2 * count + results + WIDEST_VECTOR),
        }
        self._call = _event_loop().bound()
        self._call.give(**arguments)
        self._memory: StepEventMemory | None = None
        self._function: StepFunction | None = None
        self._state: DriverState | None = None

    def __call__(self, state: DriverState, memory: StepEventMemory, times: FloatArray, rows: FloatArray) -> int:
        """Take steps of the run `state` and find the events on them. Return the reason to stop as a number.

        The times and states of accepted steps are written to `times` (c,) and `rows` (c, 2n); c is their capacity. The
        result is an `Outcome` of the driver, `NEEDS_REVIEW` if zeros on a step cannot be resolved, so that the caller
        must search it, or `READ_EVENTS` if the arrays of `memory` are full.
        """
        if memory is not self._memory:
            self._memory = memory
            self._call.give(**{name: getattr(memory, name) for name in EVENT_ARRAYS})
            self._call.give(review=memory.review, event_run=memory.run)
        function = self._driver.function(state)
        if function is not self._function or state is not self._state:
            self._function, self._state = function, state
            self._call.give(drive=function.address, words=function.words, entries=function.entries)
            self._call.give(driver_work=function.work, reals=state.reals, counts=state.counts, y=state.y)
        self._call.give(row_times=times, row_states=rows)
        before = state.integers[DriverState.STEPS]
        code = self._call()
        steps = max(0, state.integers[DriverState.STEPS] - before)
        self._driver.count(steps)
        self._call.count(steps)
        return int(code)


@cache
def _event_loop() -> CompiledProcedure:
    return CompiledProcedure(event_steps.form(), tiers=True, late=True)


class MembersCode:
    """A procedure that runs members of an ensemble, compiled with one member in each lane of a vector."""

    def __init__(self, procedure: Procedure) -> None:
        self.lanes = lanes()
        pruned = Pruner().pruned(procedure)
        signature = tuple(VARYING if parameter.name == LANE else UNIFORM for parameter in pruned.parameters)
        entry = MemberProcedures(self.lanes).entry(pruned, signature)
        self._code = CompiledProcedure(entry, tiers=True, late=True, optimize=True, inlined=False)
        numbers = np.arange(self.lanes, dtype=np.int64)
        self._known: Mapping[str, Any] = {LANE: numbers, ACTIVE: np.ones_like(numbers), "lanes": self.lanes}

    def __call__(self, arguments: Mapping[str, Any]) -> None:
        """Run members of an ensemble. Results are written to the arrays in `arguments`, the arguments by name."""
        call = self._code.bound()
        call.give(**arguments, **self._known)
        call()
        call.count(int(arguments["steps"].sum()))


def loop_layout(step: StepProgram, dimension: int, *, projected: bool = False, by_value: bool = True) -> Layout:
    """Return the layout of the work array of a step program, whose vectors are padded to whole blocks of numbers.

    `dimension` is the length 2n of a state. `projected` is True if new states are projected onto the constraints.
    `by_value` is True if the right-hand side that steps evaluate may take a small state in registers.
    """
    # A right-hand side that takes three vectors has too many numbers for registers.
    small = by_value and fit(dimension) and LAWS[step.law].inputs <= 2
    return Layout(step, dimension, block=STORED_TOGETHER, in_registers=small, projected=projected)


@lru_cache(maxsize=64)
def compiled_loop(
    step: StepProgram, dimension: int, projected: bool, by_value: bool
) -> tuple[CompiledProcedure, Layout]:
    """Return the compiled loop that takes steps of a method, and the layout of its work array.

    `projected` is True if new states are projected onto constraints, `by_value` if registers may pass a small state.
    """
    layout = loop_layout(step, dimension, projected=projected, by_value=by_value)
    return CompiledProcedure(steps_of(layout), tiers=True, optimize=True), layout


@dataclass(frozen=True)
class LlvmMachine:
    """The back end that compiles programs to machine code of this processor with LLVM (implements `Machine`)."""

    name: str = "llvm"

    def load(self, program: Program) -> LlvmKernel:
        """Compile a program to a kernel. Raises RunError if LLVM fails."""
        try:
            return LlvmKernel(program)
        except RuntimeError as error:
            raise RunError(f"LLVM could not compile {program.name}: {error}. Use target='numpy'.") from error

    def series(self, program: SeriesProgram) -> LlvmSeries:
        """Return the Taylor series that `program` states, in machine code. Each order is compiled at its first use."""
        return LlvmSeries(program)

    def loop(self, step: StepProgram, law: Program, *, projected: bool) -> tuple[CompiledProcedure, Layout]:
        """Return the compiled loop over steps of a method, and the layout of its work array.

        Steps evaluate the program `law`. With `projected` each new state is projected onto the constraints.
        """
        dimension = LAWS[step.law].dimension(law.states)
        return compiled_loop(step, dimension, projected, by_value=bool(law.returned))

    def callback(self, kernel: LlvmKernel, parameters: FloatArray, *, of_steps: bool = False) -> Callback:
        """Return the address of a kernel, for calls from compiled code, and the array of parameters that it reads.

        With `of_steps` it is the address for a loop over steps. This function may take a small state in registers.
        """
        return Callback(kernel.law_address if of_steps else kernel.address, kernel.prepare(parameters))

    def called(self, procedure: Procedure) -> CompiledProcedure:
        """Return a procedure compiled to machine code, callable from Python; it is compiled once per process."""
        return compiled(procedure)

    @property
    def processor(self) -> str:
        """The name of this processor in LLVM, and the number of doubles in its vectors, as one text."""
        return processor()

    def members(self, procedure: Procedure) -> MembersCode:
        """Return machine code of a procedure that runs members of an ensemble, one in each lane of a vector."""
        return MembersCode(procedure)

    def dense(
        self, kind: StepPolynomial, kernel: LlvmKernel, parameters: FloatArray, jacobian: LlvmKernel | None = None
    ) -> LlvmDense:
        """Return the dense output of steps by the step polynomial `kind`, compiled at its first use.

        `kernel` is the right-hand side, and `jacobian` its derivative, or None.
        """
        polynomial = partial(of_steps, kind, kernel, parameters, jacobian)
        return LlvmDense(kernel.program.states, kind.degree, polynomial)

    def event_steps(
        self,
        driver: StepDriver,
        events: Program,
        resets: Program | None,
        parameters: FloatArray,
        dense: DensePath,
        screen: DensePath | None,
    ) -> LlvmEventSteps | None:
        """Return the compiled loop that takes steps and finds events, or None if a constant mass matrix is singular.

        `Machine.event_steps` describes the arguments.
        """
        try:
            return LlvmEventSteps(driver, events, resets, parameters, dense, screen)
        except SingularMassMatrix:
            return None
