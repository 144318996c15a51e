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
        """Run members, with arguments by name."""
        known = {**arguments, **self._known}
        values = [known[parameter.name] for parameter in self._parameters]
        self._call(*[value.ctypes.data if isinstance(value, np.ndarray) else value for value in values])


def loop_layout(step: StepProgram, dimension: int, *, projected: bool = False) -> Layout:
    """Return the layout of the vectors of a step in memory, padded to whole blocks. `dimension` is 2n."""
    small = fit(dimension) and not LAWS[step.law].through_memory
    return Layout(step, dimension, block=STORED_TOGETHER, in_registers=small, projected=projected)


@lru_cache(maxsize=64)
def compiled_loop(step: StepProgram, dimension: int, projected: bool) -> tuple[CompiledProcedure, Layout]:
    """Return the compiled loop over the steps of a method, and its layout in memory. `dimension` is 2n."""
    layout = loop_layout(step, dimension, projected=projected)
    return CompiledProcedure(steps_of(layout), tiers=True, optimize=True), layout


@dataclass(frozen=True)
class LlvmMachine:
    """Compiles programs to machine code of this processor."""

    name: str = "llvm"

    def load(self, program: Program) -> LlvmKernel:
        """Compile a program to a kernel. Raises RunError if LLVM fails."""
        try:
            return LlvmKernel(program)
        except RuntimeError as error:
            raise RunError(f"LLVM could not compile {program.name}: {error}. Use target='numpy'.") from error

    def series(self, program: SeriesProgram) -> LlvmSeries:
        """Return a series program that is ready to run. Each order is compiled at its first use."""
        return LlvmSeries(program)

    def loop(self, step: StepProgram, states: int, *, projected: bool) -> tuple[CompiledProcedure, Layout]:
        """Compile the loop over the steps of a method, without optimization at first."""
        return compiled_loop(step, LAWS[step.law].dimension(states), projected)

    def callback(self, kernel: LlvmKernel, parameters: FloatArray, *, of_steps: bool = False) -> Callback:
        """Return the address of a kernel, of the one in registers for steps of a small state."""
        return Callback(kernel.law_address if of_steps else kernel.address, kernel.prepare(parameters))

    def called(self, procedure: Procedure) -> CompiledProcedure:
        """Compile a procedure, once per process."""
        return compiled(procedure)

    @property
    def processor(self) -> str:
        """Name of this processor in LLVM, and the number of doubles in its vectors."""
        return processor()

    def members(self, procedure: Procedure) -> MembersCode:
        """Compile a procedure that runs members, one in each lane of a vector."""
        return MembersCode(procedure)

    def dense(
        self, kind: StepPolynomial, kernel: LlvmKernel, parameters: FloatArray, jacobian: LlvmKernel | None = None
    ) -> LlvmDense:
        """Return the dense output for a kind of step polynomial, compiled at its first use."""
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
        """Return the compiled loop over steps with events, None if a constant mass matrix is singular."""
        try:
            return LlvmEventSteps(driver, events, resets, parameters, dense, screen)
        except SingularMassMatrix:
            return None
