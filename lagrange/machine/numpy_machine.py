"""The numpy machine, which needs only Python and NumPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.machine.backend import DensePath, FloatArray, Kernel
from lagrange.machine.dense.interpreted_dense import NumpyStepDense
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.kernel.python_kernel import PythonKernel
from lagrange.machine.kernel.straight_lines import fits
from lagrange.machine.printed_run import called
from lagrange.machine.series.interpreted_driver import NumpySeries
from lagrange.machine.steps.interpreted_driver import NumpyDriver
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import StepProgram


@dataclass(frozen=True)
class NumpyMachine:
    """Runs programs without a compiler, as Python source that is printed for each program."""

    name: str = "numpy"

    def load(self, program: Program) -> Kernel:
        """Return the program as printed Python. Programs with a large linear system are interpreted."""
        return PythonKernel(program) if fits(program) else InterpretedKernel(program)

    def series(self, program: SeriesProgram) -> NumpySeries:
        """Return a series program, which is interpreted."""
        return NumpySeries(program)

    def driver(
        self,
        step: StepProgram,
        kernel: Kernel,
        parameters: FloatArray,
        jacobian: Kernel | None = None,
        projection: Kernel | None = None,
    ) -> NumpyDriver:
        """Return a driver that takes each step in Python."""
        return NumpyDriver(step, kernel, parameters, jacobian, projection)

    def called(self, procedure: Procedure) -> Callable[..., Any]:
        """Return a procedure printed as Python, cached for the process."""
        return called(procedure)

    @property
    def processor(self) -> str:
        """The empty string: nothing is compiled."""
        return ""

    def members(self, procedure: Procedure) -> None:
        """Return None: Python runs members one by one."""

    def dense(
        self, kind: StepPolynomial, kernel: Kernel, parameters: FloatArray, jacobian: Kernel | None = None
    ) -> NumpyStepDense:
        """Return the dense output for a kind of path, printed as Python on arrays."""
        return NumpyStepDense(kind, kernel, parameters, jacobian)

    def event_steps(
        self,
        driver: NumpyDriver,
        events: Program,
        resets: Program | None,
        parameters: FloatArray,
        dense: DensePath,
        screen: DensePath | None,
    ) -> None:
        """Return None: the caller searches events on many steps at once with NumPy, faster than a Python loop."""
