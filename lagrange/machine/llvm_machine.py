"""The LLVM machine: programs are compiled to machine code."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.algorithm.members.queue import LANE
from lagrange.algorithm.step.loops import steps_of
from lagrange.algorithm.step.memory import Layout
from lagrange.errors import RunError
from lagrange.machine.backend import Callback, DensePath, FloatArray, SingularMassMatrix
from lagrange.machine.dense.llvm_dense import LlvmDense, step_dense
from lagrange.machine.events.llvm_event_steps import LlvmEventSteps
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.kernel.llvm_module import STORED_TOGETHER, fit
from lagrange.machine.llvm.called import CompiledProcedure, compiled
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module
from lagrange.machine.llvm.processor import lanes, processor
from lagrange.machine.series.llvm_series import LlvmSeries
from lagrange.machine.steps.driver import StepDriver
from lagrange.procedure.form import REAL, WHOLE, Kind, Procedure
from lagrange.procedure.lanes import ACTIVE, MemberProcedures
from lagrange.procedure.rewrite import Pruner
from lagrange.procedure.spread import COMMON, OWN
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import LAWS, StepProgram

SCALARS: Mapping[Kind, Any] = {REAL: ctypes.c_double, WHOLE: ctypes.c_int64}


class MembersCode:
    """A procedure that runs members of an ensemble, compiled with one member in each lane of a vector."""

    def __init__(self, procedure: Procedure) -> None:
        self.lanes = lanes()
        pruned = Pruner().pruned(procedure)
        signature = tuple(OWN if parameter.name == LANE else COMMON for parameter in pruned.parameters)
        entry = MemberProcedures(self.lanes).entry(pruned, signature)
        self._parameters = entry.parameters
        self._code = Module(module([entry]), optimize=True, often=True)
        types = [SCALARS[each.type] if isinstance(each.type, Kind) else ctypes.c_void_p for each in self._parameters]
        self._call = ctypes.CFUNCTYPE(None, *types)(self._code.address(entry.name))
        numbers = np.arange(self.lanes, dtype=np.int64)
        self._known: Mapping[str, Any] = {LANE: numbers, ACTIVE: np.ones_like(numbers), "lanes": self.lanes}

    def __call__(self, arguments: Mapping[str, Any]) -> None:
        """Run members of an ensemble. `arguments` maps each parameter of the procedure to a number or array."""
        known = {**arguments, **self._known}
        values = [known[parameter.name] for parameter in self._parameters]
        self._call(*[value.ctypes.data if isinstance(value, np.ndarray) else value for value in values])


def loop_layout(step: StepProgram, dimension: int, *, projected: bool = False) -> Layout:
    """Return the layout in memory of the vectors of a step program, each padded to whole blocks of numbers.

    `dimension` is the length 2n of a state. `projected` is true if steps are projected onto constraints.
    """
    small = fit(dimension) and not LAWS[step.law].through_memory
    return Layout(step, dimension, block=STORED_TOGETHER, in_registers=small, projected=projected)


@lru_cache(maxsize=64)
def compiled_loop(step: StepProgram, dimension: int, projected: bool) -> tuple[CompiledProcedure, Layout]:
    """Return the compiled loop over the steps of a method, and the layout of its vectors in memory.

    `dimension` is the length 2n of a state. `projected` is true if steps are projected onto constraints.
    """
    layout = loop_layout(step, dimension, projected=projected)
    return CompiledProcedure(steps_of(layout), tiers=True, optimize=True), layout


@dataclass(frozen=True)
class LlvmMachine:
    """The back end that compiles programs to machine code of this processor with LLVM."""

    name: str = "llvm"

    def load(self, program: Program) -> LlvmKernel:
        """Compile a program to a kernel. Raises RunError if LLVM fails."""
        try:
            return LlvmKernel(program)
        except RuntimeError as error:
            raise RunError(f"LLVM could not compile {program.name}: {error}. Use target='numpy'.") from error

    def series(self, program: SeriesProgram) -> LlvmSeries:
        """Return a program of Taylor series as callable machine code. Each order is compiled at its first use."""
        return LlvmSeries(program)

    def loop(self, step: StepProgram, states: int, *, projected: bool) -> tuple[CompiledProcedure, Layout]:
        """Return the compiled loop over the steps of a method, and the layout of its vectors in memory.

        `states` is the length 2n of a state. `projected` is true if steps are projected onto constraints. The code is
        not optimized until it has taken many steps.
        """
        return compiled_loop(step, LAWS[step.law].dimension(states), projected)

    def callback(self, kernel: LlvmKernel, parameters: FloatArray, *, of_steps: bool = False) -> Callback:
        """Return the address of a kernel with the numbers that it reads, for calls from compiled code.

        The numbers are the parameters and all values that depend on them alone. With `of_steps` it is the kernel that
        steps call: for a small state it takes the state in registers.
        """
        return Callback(kernel.law_address if of_steps else kernel.address, kernel.prepare(parameters))

    def called(self, procedure: Procedure) -> CompiledProcedure:
        """Return a procedure compiled to machine code, callable from Python; it is compiled once per process."""
        return compiled(procedure)

    @property
    def processor(self) -> str:
        """Name of this processor in LLVM, and the number of doubles in its vectors."""
        return processor()

    def members(self, procedure: Procedure) -> MembersCode:
        """Return machine code of a procedure that runs members of an ensemble, one in each lane of a vector."""
        return MembersCode(procedure)

    def dense(
        self, kind: StepPolynomial, kernel: LlvmKernel, parameters: FloatArray, jacobian: LlvmKernel | None = None
    ) -> LlvmDense:
        """Return the dense output of steps: the polynomial on each step, compiled at its first use.

        `kind` says how a method's polynomial follows from the ends of a step. `kernel` is the right-hand side and
        `jacobian` its derivative, None if the polynomial does not need it.
        """
        return step_dense(kind, kernel, parameters, jacobian)

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

        `events` computes the event functions, and `resets` the new values of the state after events. Zeros are
        located on the polynomials of `dense`. The cheaper polynomials of `screen` show which steps have no zero.
        """
        try:
            return LlvmEventSteps(driver, events, resets, parameters, dense, screen)
        except SingularMassMatrix:
            return None
