"""The numpy machine: it runs programs without a compiler, with Python and NumPy only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.algorithm.step.loops import steps_of
from lagrange.algorithm.step.memory import Layout
from lagrange.machine.backend import Callback, FloatArray, Kernel
from lagrange.machine.dense.interpreted_dense import NumpyDense, step_dense
from lagrange.machine.kernel.python_kernel import kernel_in_python
from lagrange.machine.printed_run import PrintedProcedure, between_arrays, called
from lagrange.machine.series.interpreted_series import NumpySeries
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import LAWS, StepProgram


@lru_cache(maxsize=64)
def printed_loop(step: StepProgram, dimension: int, projected: bool) -> tuple[PrintedProcedure, Layout]:
    """Return the loop over the steps of a method, printed as Python, and its layout, without padding.

    `dimension` is 2n.
    """
    layout = Layout(step, dimension, block=1, projected=projected)
    return PrintedProcedure(steps_of(layout)), layout


@dataclass(frozen=True)
class NumpyMachine:
    """Runs programs without a compiler, as Python source that is printed for each program."""

    name: str = "numpy"

    def load(self, program: Program) -> Kernel:
        """Return the program as printed Python. Programs with a large linear system are interpreted."""
        return kernel_in_python(program)

    def series(self, program: SeriesProgram) -> NumpySeries:
        """Return a series program that is ready to run. Its instructions are interpreted."""
        return NumpySeries(program)

    def loop(self, step: StepProgram, states: int, *, projected: bool) -> tuple[PrintedProcedure, Layout]:
        """Print the loop over the steps of a method, once per process."""
        return printed_loop(step, LAWS[step.law].dimension(states), projected)

    def callback(self, kernel: Kernel, parameters: FloatArray, *, of_steps: bool = False) -> Callback:
        """Return a kernel as a Python function, which reads its parameters from an array."""
        return Callback(between_arrays(kernel), parameters)

    def called(self, procedure: Procedure) -> PrintedProcedure:
        """Print a procedure as Python, once per process."""
        return called(procedure)

    @property
    def processor(self) -> str:
        """The empty string, because no code is compiled."""
        return ""

    def members(self, procedure: Procedure) -> None:
        """Return None: Python runs members one by one."""

    def dense(
        self, kind: StepPolynomial, kernel: Kernel, parameters: FloatArray, jacobian: Kernel | None = None
    ) -> NumpyDense:
        """Return the dense output for a kind of step polynomial, printed as Python on arrays."""
        return step_dense(kind, kernel, parameters, jacobian)

    def event_steps(self, *_: Any, **__: Any) -> None:
        """Return None: the caller searches many steps at once for events with NumPy, faster than a Python loop."""
