"""Series programs on the numpy machine: the interpreted series, its steps and its dense output."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from lagrange.algorithm.dense.polynomials import series_polynomial
from lagrange.algorithm.series.cost import Cost, best_order
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.machine.backend import FloatArray, Kernel, SingularMassMatrix
from lagrange.machine.copies import Shared
from lagrange.machine.dense.interpreted_dense import NumpyDense, printed
from lagrange.machine.kernel.python_kernel import kernel_in_python
from lagrange.machine.python_source import PrintedProcedure, called
from lagrange.machine.series.interpreted_jet import Jet
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram


class NumpySeries(Shared):
    """A Taylor series program that is interpreted (implements `Series` and `SeriesCode`)."""

    is_final = True

    def __init__(self, program: SeriesProgram) -> None:
        self.program = program
        self._prepared: tuple[bytes, Jet] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return NumpySeries, (self.program,)

    def form(self, order: int) -> str:
        """Return the word "interpreted", by which the printed summary of a run says how the series is computed."""
        return "interpreted"

    def order(self, tolerance: float) -> int:
        """Return the order of the series with which a run to a relative tolerance costs least.

        It is assumed that interpretation takes as long at every order.
        """
        return best_order(Cost(fixed=2.0, each=1.0, pairs=0.0), tolerance)

    @cached_property
    def values(self) -> Kernel:
        """The kernel that evaluates the event functions and switching surfaces at a state."""
        return self.load(self.program.values)

    @cached_property
    def layout(self) -> TaylorLayout:
        """The layout of the series in memory, which serves every order."""
        return TaylorLayout.of(self.program)

    @property
    def loop(self) -> PrintedProcedure:
        """The loop over Taylor steps, printed as Python."""
        return called(taylor_steps.form(layout=self.layout))

    @property
    def function(self) -> Callable[..., bool]:
        """The Python function that computes the Taylor coefficients, for the printed loop over steps."""
        return _between_arrays(self)

    def joined(self, parameters: FloatArray, values: Kernel | None) -> tuple[FloatArray, Sequence[int]]:
        """Return one array of all numbers that a run reads, and the length of each of its parts.

        The parts are the parameters of the series, no constants, and the parameters of the event functions.
        """
        return np.concatenate([parameters, parameters]), (len(parameters), 0, len(parameters))

    def count(self, steps: int) -> bool:
        """Return False: unlike machine code, this code is not replaced by optimized code after many steps."""
        return False

    def load(self, program: Program) -> Kernel:
        """Return the kernel of a program. Programs with a large linear system are interpreted."""
        return kernel_in_python(program)

    def code(self, order: int) -> NumpySeries:
        """Return the series itself, which serves every order."""
        return self

    def dense(self, order: int, parameters: FloatArray) -> NumpyDense:
        """Return the dense output of Taylor steps of an order: the Taylor polynomial on each step."""
        n = self.program.states
        size = partial(_work_size, 2 * n + (order + 1) * (n + len(self.program.watched)))
        write = partial(_write_polynomials, self, order, parameters)
        return NumpyDense(n, order, both=False, size=size, write=write)

    def rows(
        self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray, low: FloatArray | None = None
    ) -> FloatArray:
        """Return the Taylor coefficients of the motion at the state y + `low`, with order k in row k, times scale**k.

        The columns are the state (2n), then the event functions and switching surfaces. `low` (2n,) is a correction
        below the rounding of y, None for zero. The last of the `parameters` are the sides of surfaces.
        """
        with np.errstate(all="ignore"):
            coefficients = self._jet(parameters).coefficients(t, y, order, scale, low)
            zero = np.zeros(order + 1)
            watched = [zero if i is None else coefficients[:, i] for i in self.program.watched]
            rows: FloatArray = np.column_stack([coefficients[:, : self.program.states], *watched])
            return rows

    def _jet(self, parameters: FloatArray) -> Jet:
        """Return the object that computes Taylor coefficients for these parameters, cached until they change."""
        key, known = parameters.tobytes(), self._prepared
        if known is None or known[0] != key:
            known = self._prepared = key, Jet(self.program, parameters.copy())
        return known[1]


def _work_size(size: int, _columns: int) -> int:
    """Return the number of doubles of work memory for a block of steps: `size`, however many columns it has.

    The same memory for a state, its rounding errors and one series serves all steps.
    """
    return size


def _write_polynomials(series: NumpySeries, order: int, parameters: FloatArray, *arrays: Any) -> None:
    """Write the polynomials of a block of Taylor steps of an order.

    `arrays` are the number of steps, the steps and their neighbours, work memory, and the coefficients to write.
    """
    n, jet = series.program.states, _between_arrays(series)
    write = printed(series_polynomial.form(), by_arrays=True)
    write(jet, parameters, None, order, n + len(series.program.watched), n, n, *arrays)


def _between_arrays(series: NumpySeries) -> Callable[..., bool]:
    """Return a series as a function for printed procedures, which computes Taylor coefficients into an array.

    Its arguments are t, the scale, the state, the parameters, an unused array, the rows to write, and the order. The
    array of the state has 2n entries, then their 2n rounding errors. The function returns True if a matrix is
    singular.
    """
    states, count = series.program.states, series.program.constants.parameters

    def jet(t: float, scale: float, y: Any, numbers: Any, _: Any, rows: Any, order: int) -> bool:
        state = np.frombuffer(y, count=2 * states).reshape(2, -1)
        try:
            coefficients = series.rows(order, t, state[0], scale, np.asarray(numbers[:count]), state[1])
        except SingularMassMatrix:
            return True
        rows[: coefficients.size] = coefficients.reshape(-1).data
        return False

    return jet
