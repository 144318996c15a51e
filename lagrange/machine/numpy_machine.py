"""The numpy machine: it runs programs without a compiler, with Python and NumPy only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.algorithm.step.error_control import steps_of
from lagrange.algorithm.step.memory import Layout
from lagrange.machine.backend import Callback, FloatArray, Kernel
from lagrange.machine.dense.interpreted_dense import NumpyDense, write_steps
from lagrange.machine.kernel.python_kernel import kernel_in_python
from lagrange.machine.python_source import PrintedProcedure, between_arrays, called
from lagrange.machine.series.interpreted_series import NumpySeries
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import LAWS, StepProgram


@dataclass(frozen=True)
class NumpyMachine:
    """The back end that needs no compiler: it prints each program as Python source and runs it with NumPy."""

    name: str = "numpy"

    def load(self, program: Program) -> Kernel:
        """Return the kernel of a program, printed as Python. A program with a large linear system is interpreted."""
        return kernel_in_python(program)

    def series(self, program: SeriesProgram) -> NumpySeries:
        """Return a program of Taylor series as a callable object that interprets its instructions."""
        return NumpySeries(program)

    def loop(self, step: StepProgram, law: Program, *, projected: bool) -> tuple[PrintedProcedure, Layout]:
        """Return the loop over the steps of a method as printed Python, and the layout of its vectors in memory."""
        layout = Layout(step, LAWS[step.law].dimension(law.states), block=1, projected=projected)
        return called(steps_of(layout)), layout

    def callback(self, kernel: Kernel, parameters: FloatArray, *, of_steps: bool = False) -> Callback:
        """Return a kernel as a Python function for printed procedures, with the parameters that it reads."""
        return Callback(between_arrays(kernel), parameters)

    def called(self, procedure: Procedure) -> PrintedProcedure:
        """Return a procedure as a callable Python function; it is printed once per process."""
        return called(procedure)

    @property
    def processor(self) -> str:
        """The name of the processor that code is compiled for: empty, because this machine compiles no code."""
        return ""

    def members(self, procedure: Procedure) -> None:
        """Return None: this machine has no vector code for ensembles, so their members run one by one."""

    def dense(
        self, kind: StepPolynomial, kernel: Kernel, parameters: FloatArray, jacobian: Kernel | None = None
    ) -> NumpyDense:
        """Return the dense output of steps: the polynomial on each step, printed as Python on arrays."""
        n, write = kernel.program.states, partial(write_steps, kind, kernel, parameters, jacobian)
        return NumpyDense(n, kind.degree, kind.derivative, partial(kind.size, n), write)

    def event_steps(self, *_: Any, **__: Any) -> None:
        """Return None: this machine has no loop that also finds events.

        The caller searches many steps at once for events with NumPy, which is faster than a loop in Python.
        """
