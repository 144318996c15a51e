"""Evaluation of a program instruction by instruction, in any number type: the readable reference of all kernels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.linear.symmetric import PIVOT, PREFERENCE
from lagrange.graph.evaluate import DOUBLE_FUNCTIONS
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.program.program import Program

OPERATIONS: dict[str, Callable[..., Any]] = {
    "neg": np.negative,
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "fma": lambda a, b, c: a * b + c,
    "sqrt": np.sqrt,
    "power": np.power,
    **DOUBLE_FUNCTIONS,
    "select": np.where,
}
"""The function of each operation, on numbers or on arrays with one number per column."""


@dataclass(frozen=True)
class Arithmetic:
    """A number type: its function for each operation of a program, and its conversion from a double.

    `systems` maps "factor" and "solve" to the functions for linear systems, if the number type supports them. They
    take the size of the matrix and the operands.
    """

    operations: Mapping[str, Callable[..., Any]]
    number: Callable[[float], Any]
    dtype: Any
    systems: Mapping[str, Callable[..., Any]] = field(default_factory=dict)

    def evaluate(
        self, program: Program, t: Any, y: Sequence[Any] | NDArray[Any], parameters: Sequence[Any] | NDArray[Any]
    ) -> list[Any]:
        """Return the outputs of a program, as a list, at time `t`, for the inputs `y` and the parameters."""
        values: list[Any] = []
        for op, args, index, value, order, _ in program.instructions:
            if op == "state":
                values.append(y[index])
            elif op == "parameter":
                values.append(parameters[index])
            elif op == "time":
                values.append(t)
            elif op == "constant":
                values.append(self.number(value))
            elif op == "component":
                values.append(values[args[0]][index])
            elif op in self.systems:
                values.append(self.systems[op](order, *[values[arg] for arg in args]))
            else:
                values.append(self.operations[op](*[values[arg] for arg in args]))
        return [values[output] for output in program.outputs]


FLOATS = Arithmetic(OPERATIONS, np.float64, float)


@dataclass(frozen=True)
class InterpretedKernel:
    """A kernel that evaluates a program instruction by instruction."""

    program: Program

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the program's result at time t, for a state y (2n,) or many states (2n, batch)."""
        return self._rows(t, y, y.shape[1:], parameters)

    def quick(self, parameters: FloatArray) -> None:
        """Return None: this kernel has no quick calls (calls for one state that check their own arguments)."""

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the program's result for many states, one in each column."""
        return self._rows(t, [row for block in inputs for row in block], inputs[0].shape[1:], parameters)

    def _rows(
        self, t: float | FloatArray, y: Sequence[Any] | FloatArray, columns: tuple[int, ...], parameters: FloatArray
    ) -> FloatArray:
        with np.errstate(all="ignore"):
            values = WITH_SYSTEMS.evaluate(self.program, np.asarray(t, dtype=float), y, parameters)
        out = np.empty((len(values), *columns))
        for row, value in enumerate(values):
            out[row] = value
        return out.reshape((*self.program.shape, *columns))


def _matrix(n: int, *lower: Any) -> FloatArray:
    """Return the full symmetric matrix, (n, n) or (n, n, batch), from the entries `lower` of its lower triangle.

    The entries are ordered by rows. Each is a number or an array (batch,).
    """
    rows = np.array(np.broadcast_arrays(*lower), dtype=float)
    i, j = np.tril_indices(n)
    full = np.empty((n, n, *rows.shape[1:]))
    full[i, j] = rows
    full[j, i] = rows
    return full


def _solve(n: int, matrix: FloatArray, *right: Any) -> FloatArray:
    """Return the solution of matrix * x = right, (n,) or (n, batch), by Gaussian elimination of the scaled matrix.

    `matrix` is (n, n) or (n, n, batch). `right` are the n entries of the right-hand side, each a number or (batch,).
    Rows are exchanged to obtain large pivots.
    """
    columns = np.broadcast_shapes(matrix.shape[2:], *(np.shape(entry) for entry in right))
    whole = matrix[..., None] if columns and matrix.ndim == 2 else matrix
    a = np.broadcast_to(whole, (n, n, *columns)).reshape(n, n, -1).copy()
    b = np.array(np.broadcast_arrays(*right, np.empty(columns))[:n], dtype=float).reshape(n, -1)
    finite = np.asarray(np.isfinite(a).all(axis=(0, 1)))
    scale = _scale(a)
    a *= scale[:, None] * scale
    b *= scale
    lanes = np.arange(a.shape[2])
    preference = np.where(np.einsum("iik->ik", a) == 0.0, PREFERENCE, 1.0)
    for j in range(n):
        pick = j + np.argmax(np.abs(a[j:, j]) * preference[j:], axis=0)
        for array in (a, b, preference):
            row, pivot_rows = array[j].copy(), array[pick, ..., lanes]
            array[j] = np.moveaxis(pivot_rows, 0, -1)
            array[pick, ..., lanes] = np.moveaxis(row, -1, 0)
        # A pivot that is zero within rounding errors; matrices that are not finite are skipped.
        singular = finite & (np.abs(a[j, j]) <= PIVOT)
        if singular.any():
            raise SingularMassMatrix(int(np.argmax(singular)) if columns else None)
        factor = a[j + 1 :, j] / a[j, j]
        a[j + 1 :] -= factor[:, None] * a[j]
        b[j + 1 :] -= factor * b[j]
    x = np.empty_like(b)
    for j in reversed(range(n)):
        x[j] = (b[j] - (a[j, j + 1 :] * x[j + 1 :]).sum(axis=0)) / a[j, j]
    return np.where(finite, scale * x, np.nan).reshape((n, *columns))


def _scale(a: FloatArray) -> FloatArray:
    """Return the factors (n, k) by which rows and columns of k symmetric matrices are scaled before elimination.

    `a` (n, n, k) has the matrices. The factors are the same as in `lagrange.algorithm.linear.symmetric`. For a matrix
    that is not definite, the factors are powers of two, so that scaling does not round.
    """
    diagonal, size = np.abs(np.einsum("iik->ik", a)), np.abs(a)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(diagonal), 0.0)
    for _ in range(2):
        largest = (size * scale).max(axis=1)
        scale = np.where((scale == 0.0) & (largest > 0.0), 1.0 / largest, scale)
    scale = np.where(scale == 0.0, 1.0, scale)
    largest = scale * (size * scale).max(axis=1)
    definite = (np.einsum("iik->ik", a) > 0.0).all(axis=0)
    powers = np.exp2(np.round(np.log2(scale / np.sqrt(np.where(largest > 0.0, largest, 1.0)))))
    return np.where(definite, scale, powers)


WITH_SYSTEMS = replace(FLOATS, systems={"factor": _matrix, "solve": _solve})
"""Arithmetic of doubles with the linear systems of the mass matrix."""
