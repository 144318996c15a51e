"""The LLVM machine: programs become machine code."""

from __future__ import annotations

from dataclasses import dataclass

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.errors import RunError
from lagrange.machine.backend import DensePath, FloatArray, SingularMassMatrix
from lagrange.machine.dense.llvm_dense import LlvmStepDense
from lagrange.machine.events.llvm_event_steps import LlvmEventSteps
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.llvm.called import CompiledProcedure, compiled
from lagrange.machine.llvm.engine import processor
from lagrange.machine.members.compiled import MembersCode
from lagrange.machine.series.llvm_driver import LlvmSeries
from lagrange.machine.steps.llvm_driver import LlvmDriver
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import StepProgram


@dataclass(frozen=True)
class LlvmMachine:
    """Compiles programs to machine code of this processor."""

    name: str = "llvm"

    def load(self, program: Program) -> LlvmKernel:
        """Compile a program. Raises RunError if LLVM refuses it."""
        try:
            return LlvmKernel(program)
        except RuntimeError as error:
            raise RunError(f"LLVM could not compile {program.name}: {error}. Use target='numpy'.") from error

    def series(self, program: SeriesProgram) -> LlvmSeries:
        """Return a series program; each order is compiled at its first use."""
        return LlvmSeries(program)

    def driver(
        self,
        step: StepProgram,
        kernel: LlvmKernel,
        parameters: FloatArray,
        jacobian: LlvmKernel | None = None,
        projection: LlvmKernel | None = None,
    ) -> LlvmDriver:
        """Compile the loop over steps, or take it from the cache for other models of the same dimension."""
        return LlvmDriver(step, kernel, parameters, jacobian, projection)

    def called(self, procedure: Procedure) -> CompiledProcedure:
        """Compile a procedure, once per process."""
        return compiled(procedure)

    @property
    def processor(self) -> str:
        """Name of this processor in LLVM, and the number of doubles in its vectors."""
        return processor()

    def members(self, procedure: Procedure) -> MembersCode:
        """Compile a procedure over members for all lanes of a vector."""
        return MembersCode(procedure)

    def dense(
        self, kind: StepPolynomial, kernel: LlvmKernel, parameters: FloatArray, jacobian: LlvmKernel | None = None
    ) -> LlvmStepDense:
        """Return the dense output of a kind of path, compiled at its first use."""
        return LlvmStepDense(kind, kernel, parameters, jacobian)

    def event_steps(
        self,
        driver: LlvmDriver,
        events: Program,
        resets: Program | None,
        parameters: FloatArray,
        dense: DensePath,
        screen: DensePath | None,
    ) -> LlvmEventSteps | None:
        """Return the compiled loop, or None if a constant mass matrix is singular: then no dense output exists."""
        try:
            return LlvmEventSteps(driver, events, resets, parameters, dense, screen)
        except SingularMassMatrix:
            return None
