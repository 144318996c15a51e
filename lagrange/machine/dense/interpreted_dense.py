"""Dense output of the numpy machine: the same procedures as in machine code, printed as Python on NumPy's arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.dense.block import StepPolynomial, block_size
from lagrange.machine.backend import BlockPolynomial, FloatArray, Kernel, Places, SingularMassMatrix
from lagrange.machine.python_source import arrays_loaded, called

STEPS_PER_BLOCK, TIMES_PER_BLOCK = 1024, 16384
"""Largest number of steps in a block, and of times evaluated at once: bounds on memory."""


SHORT_BLOCK = 16
"""Largest number of entries of a block for which the procedure is printed for numbers, not for arrays. An operation on
a short array takes as long as twenty operations on numbers."""

NONE = np.empty(0).data
"""Placeholder for an array that is not used."""


@dataclass(frozen=True, eq=False)
class NumpyDense:
    """The dense output of the numpy machine (implements `DensePath`) for states with `dimension` entries.

    `degree` is that of the polynomials. `both` is True if a polynomial also depends on a neighbouring step.
    `size(columns)` returns the number of doubles of work memory for a block of `columns` steps. `write(columns, own,
    beside, work, out)` writes the polynomials of a block to `out`, in the layout of `POLYNOMIAL`: `own` has the steps
    of the block, `beside` a neighbouring step of each, and `work` is work memory.
    """

    dimension: int
    degree: int
    both: bool
    size: Callable[[int], int]
    write: Callable[..., None]

    def polynomial(self) -> BlockPolynomial:
        """Return the callback that writes the polynomials of a block of steps."""

        def write(_: Any, columns: int, *arrays: Any) -> None:
            block, beside, work, out = (
                array if isinstance(array, np.ndarray) else np.frombuffer(array) for array in arrays
            )
            self.write(columns, block, beside, work, out)

        return BlockPolynomial(write, np.empty(0).data, WIDEST_VECTOR, self.size(WIDEST_VECTOR), self.both, ())

    def coefficients(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the coefficients (degree + 1, 2n, k) of the polynomials on the k steps with the indices `steps`."""
        coefficients = np.empty((self.degree + 1, self.dimension, len(steps)))
        for low in range(0, len(steps), STEPS_PER_BLOCK):
            part = slice(low, low + STEPS_PER_BLOCK)
            coefficients[:, :, part] = self._block(times, states, steps[part])
        return coefficients

    def at(self, times: FloatArray, states: FloatArray, requested_times: FloatArray, out: FloatArray) -> None:
        """Write the states of a run at `requested_times` (K,) to `out` (2n, K)."""
        sign = 1.0 if times[-1] >= times[0] else -1.0
        step_of = np.searchsorted(sign * times, sign * requested_times, side="right") - 1
        step_of = np.clip(step_of, 0, len(times) - 2)
        for low in range(0, len(requested_times), TIMES_PER_BLOCK):
            part = slice(low, low + TIMES_PER_BLOCK)
            steps, part_times = step_of[part], requested_times[part]
            used, which = np.unique(steps, return_inverse=True)
            with np.errstate(all="ignore"):
                theta = (part_times - times[steps]) / (times[steps + 1] - times[steps])
                c = self.coefficients(times, states, used)
                out[:, part] = polyval(theta, c[:, :, which], tensor=False)
            for rows in (steps, steps + 1):
                exact = times[rows] == part_times
                out[:, part][:, exact] = states[rows[exact]].T

    def _block(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the coefficients (degree + 1, 2n, K) of the polynomials on one block of K steps.

        `steps` are the indices of the steps. The run has accepted times `times` (S+1,) and states `states` (S+1, 2n).
        """
        n, count = self.dimension, len(steps)
        out = np.empty((self.degree + 1) * n * count)
        block, beside = _gathered(times, states, steps), np.empty(0)
        if self.both:
            neighbours = np.where(steps > 0, steps - 1, min(1, len(times) - 2))
            alone = len(times) < 3
            beside = _gathered(times, states, neighbours, np.where(steps > 0, -1.0, 0.0 if alone else 1.0))
        with np.errstate(all="ignore"):
            self.write(count, block, beside, np.empty(self.size(count)), out)
        return out.reshape(-1, n, count)


def write_steps(
    kind: StepPolynomial,
    kernel: Kernel,
    parameters: FloatArray,
    jacobian: Kernel | None,
    columns: int,
    *arrays: FloatArray,
) -> None:
    """Write the polynomials of a block of `columns` steps by the printed procedure for their `kind`.

    `kind` says how the polynomial follows from the ends of a step. `kernel` is the right-hand side and `jacobian` its
    derivative or None. The four `arrays` are the steps of the block, a neighbouring step of each, work memory, and
    the coefficients, which are written.
    """
    law, n = _by_columns(kernel, parameters), kernel.program.states
    derivative = None if jacobian is None else _by_columns(jacobian, parameters)
    few = columns * n <= SHORT_BLOCK
    table, *rest = [array.data if few else array for array in (kind.table, *arrays)]
    write = called(kind.procedure).function if few else arrays_loaded(kind.procedure)
    write(law, NONE, derivative, NONE, _invert, table, kind.stages, kind.degree, n, columns, *rest)


def _by_columns(kernel: Kernel, parameters: FloatArray) -> Callable[..., int]:
    """Return a function for printed procedures that evaluates a kernel at many states.

    Its arguments are the number of states, their times, coordinates and velocities (one column for each state), an
    unused one, and the array that receives the results. Results at a singular mass matrix are NaN. The function
    returns -1.
    """
    half = kernel.program.states // 2

    def evaluate(count: int, t: Any, q: Any, v: Any, _: Any, out: Any) -> int:
        parts = [np.asarray(part)[: half * count].reshape(half, count) for part in (q, v)]
        results = _known(kernel, np.asarray(t)[:count], np.concatenate(parts), parameters)
        np.asarray(out)[: results.size] = results.reshape(-1)
        return -1

    return evaluate


def _invert(order: int, columns: int, a: Any, _: Any) -> None:
    """Invert a matrix of size `order` for each of `columns` columns. An inverse is NaN if its matrix is singular.

    `a` is a flat array of shape (order, 2 order, columns). Its left half has the matrices. The inverses are written
    to its right half.
    """
    both = np.asarray(a)[: 2 * order * order * columns].reshape(order, 2 * order, columns)
    matrices = np.moveaxis(both[:, :order], -1, 0).copy()
    try:
        inverses = np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        inverses = np.array([_inverse(matrix) for matrix in matrices])
    both[:, order:] = np.moveaxis(inverses, 0, -1)


def _inverse(matrix: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)


def _known(kernel: Kernel, t: FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return the results of a kernel for many states y (2n, batch) at times t; NaN at a singular mass matrix."""
    try:
        return kernel(float(t[0]), y[:, 0], parameters)[..., None] if len(t) == 1 else kernel(t, y, parameters)
    except SingularMassMatrix as error:
        results = np.full((*kernel.program.shape, y.shape[1]), np.nan)
        if error.column is not None and y.shape[1] > 1:
            others = np.arange(y.shape[1]) != error.column
            results[..., others] = _known(kernel, t[others], y[:, others], parameters)
        return results


def _gathered(times: FloatArray, states: FloatArray, steps: Places, side: FloatArray | float = 0.0) -> FloatArray:
    """Return the steps with indices `steps` of a run as a flat block with one column for each step.

    The rows are the start times, the lengths, `side`, and the states at the start and at the end. `side` says where
    the step is relative to the step that needs it as a neighbour: -1.0 before, 1.0 after, 0.0 if it is this step
    itself. `times` (S+1,) and `states` (S+1, 2n) are those of the run.
    """
    count = len(steps)
    block = np.empty(block_size(states.shape[1], count))
    rows = block.reshape(-1, count)
    rows[0], rows[1], rows[2] = times[steps], times[steps + 1] - times[steps], side
    size = states.shape[1]
    rows[3 : 3 + size], rows[3 + size :] = states[steps].T, states[steps + 1].T
    return block
