"""Interpreter of programs, the reference of all kernels, and bounds of the rounding errors of a program's results.

The numbers may be of any type. Two types are doubles, and doubles with a bound of their rounding error, the noise. The
noise of a result is its own rounding plus its change when its arguments change by their noise. In a linear system the
noise of the right-hand side is multiplied by the inverse of the matrix. Source: N. J. Higham, Accuracy and Stability of
Numerical Algorithms, 2nd ed., 2002, 3.3 and 7.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.linear.symmetric import PIVOT, PREFERENCE, scale_rows
from lagrange.graph.evaluate import DOUBLE_FUNCTIONS
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram

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
"""NumPy function for each operation of a program. It takes numbers, or arrays with one number for each state."""


@dataclass(frozen=True)
class Arithmetic:
    """A number type in which programs are evaluated, such as doubles: a function for each operation of a program.

    `number` converts a double to the type, and `dtype` is the NumPy dtype of arrays of such numbers. `systems` maps
    "factor" and "solve" to the functions for linear systems, if the type supports them. These functions take the size
    of the matrix and the operands.
    """

    operations: Mapping[str, Callable[..., Any]]
    number: Callable[[float], Any]
    dtype: Any
    systems: Mapping[str, Callable[..., Any]] = field(default_factory=dict)

    def evaluate(
        self, program: Program, t: Any, y: Sequence[Any] | NDArray[Any], parameters: Sequence[Any] | NDArray[Any]
    ) -> list[Any]:
        """Return the list of a program's outputs at time `t`, for its inputs `y`, such as a state, and `parameters`."""
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
    """A kernel that evaluates a program by interpreting its instructions one by one (implements `Kernel`)."""

    program: Program

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the program's result at time t, for a state y (2n,) or many states (2n, batch)."""
        return self._rows(t, y, y.shape[1:], parameters)

    def quick(self, parameters: FloatArray) -> None:
        """Return None: this kernel has no fast functions for one state."""

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the results for many states, from an array (size, batch) for each of the program's `inputs`."""
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
    """Return the solution x of matrix * x = right, (n,) or (n, batch), by Gaussian elimination with row exchanges.

    `matrix` is (n, n) or (n, n, batch), and is scaled first. `right` are the n entries of the right-hand side, each a
    number or (batch,). Raises SingularMassMatrix if a pivot is zero within rounding.
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
        # Matrices with a pivot that is zero within rounding errors. Matrices that are not finite do not count.
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
"""Arithmetic of doubles that can also solve the linear systems of a program. `FLOATS` cannot."""


UNIT = 2.0**-53
"""Unit of round-off of doubles, 2**-53."""

NO_PIVOT = 1e-12
"""Smallest pivot, as a fraction of the terms whose sum it is, with which a matrix is factored without row exchanges."""

EXACT_OPERATIONS = frozenset(("neg", "abs", "min", "max", "select"))
"""Operations whose result has no rounding error of its own."""

JUMPING = frozenset(("sign", "less", "less_equal", "equal", "and", "or", "not"))
"""Operations whose result is taken to have no rounding error, because it jumps. A jump of a force is not rounding, even
if the state is on the surface of the jump.
"""


class Noisy(NamedTuple):
    """A number, or the entries of a vector or matrix, with a bound of its rounding error: the noise."""

    value: Any
    noise: Any


def _noisy(name: str) -> Callable[..., Noisy]:
    """Return a function that applies the operation `name` to numbers with error bounds.

    The exact value of an argument is in an interval: its value plus or minus its error bound. The error bound of the
    result is its rounding plus, for each argument, the change of the result at the ends of this interval.
    """
    operation, rounding = OPERATIONS[name], 0.0 if name in EXACT_OPERATIONS else UNIT

    def apply(*args: Noisy) -> Noisy:
        values = [number.value for number in args]
        value = operation(*values)
        if name in JUMPING:
            return Noisy(value, 0.0)
        noise = rounding * abs(float(value))
        for k, number in enumerate(args):
            if number.noise:
                ends = [
                    operation(*values[:k], number.value + sign * number.noise, *values[k + 1 :]) for sign in (-1, 1)
                ]
                # The change may be lost in rounding, as in 1 + x. So the error also includes the distance of each end
                # from the value.
                noise += float(np.fmax(abs(float(ends[1]) - float(value)), abs(float(ends[0]) - float(value))))
        return Noisy(value, noise)

    return apply


def _linear(name: str) -> Callable[..., Noisy]:
    """Return a function that adds, subtracts, multiplies or divides numbers with error bounds.

    `name` is the operation. The error bound of the result comes from a formula such as |b| da + |a| db. Unlike a
    difference of values, the formula is also valid for errors below the spacing of doubles.
    """
    operation = OPERATIONS[name]

    def apply(*args: Noisy) -> Noisy:
        (a, da), (b, db) = args[:2]
        value = operation(*(number.value for number in args))
        if name == "div":
            carried = (da + abs(value) * db) / abs(b) if b else np.inf
        elif name in ("mul", "fma"):
            carried = abs(b) * da + abs(a) * db + sum(number.noise for number in args[2:])
        else:
            carried = da + db
        return Noisy(value, UNIT * abs(value) + carried)

    return apply


def _noisy_factor(order: int, *entries: Noisy) -> Noisy:
    """Return the symmetric matrix with the lower triangle `entries` by rows, with an error bound for each entry."""
    return Noisy(*(symmetric(order, lower_places(order), part) for part in zip(*entries, strict=True)))


def _factorization_sizes(matrix: FloatArray) -> FloatArray:
    """Return |L| |D| |L^T| (n, n) for a symmetric matrix M = L D L^T (n, n).

    Return |M| if a pivot is too small for these factors. An entry may be zero in M but not in the factors: a
    constraint adds G M^-1 G^T to the zero block of M. Source: Higham, theorem 10.3.
    """
    sizes, remainder = abs(matrix), matrix.copy()
    for k in range(len(matrix)):
        if abs(remainder[k, k]) <= NO_PIVOT * sizes[k, k]:
            return abs(matrix)
        terms = np.outer(remainder[k + 1 :, k], remainder[k, k + 1 :] / remainder[k, k])
        remainder[k + 1 :, k + 1 :] -= terms
        sizes[k + 1 :, k + 1 :] += abs(terms)
    return sizes


def _noisy_solve(order: int, matrix: Noisy, *right: Noisy) -> list[Noisy]:
    """Return the solution x of a linear system M x = b with error bounds: |M^-1| times bounds of the residual's error.

    `order` is the size of M, `matrix` has its entries, and `right` are the entries of b. The residual b - M x has the
    errors of M and b, and those of the factorization of M.
    """
    value, noise = np.array([number.value for number in right]), np.array([number.noise for number in right])
    inverse = np.linalg.inv(matrix.value)
    solution = inverse @ value
    left = noise + (matrix.noise + order * UNIT * _factorization_sizes(matrix.value)) @ abs(solution)
    return list(map(Noisy, solution, abs(inverse) @ left))


_LINEAR = ("add", "sub", "mul", "div", "fma")
_NOISY = Arithmetic(
    {name: _linear(name) if name in _LINEAR else _noisy(name) for name in OPERATIONS},
    lambda value: Noisy(np.float64(value), 0.0),
    object,
    {"factor": _noisy_factor, "solve": _noisy_solve},
)
"""Arithmetic of `Noisy` numbers, which have a bound of their rounding error."""


def rounding_noise(program: Program, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return a bound of the rounding error of each output of a program at a state y (2n,).

    The bound is NaN if a matrix in the program is singular.
    """
    state = [Noisy(value, abs(value) * UNIT) for value in y]
    try:
        outputs = _NOISY.evaluate(program, Noisy(t, 0.0), state, [Noisy(value, 0.0) for value in parameters])
    except (np.linalg.LinAlgError, ArithmeticError, ValueError):
        return np.full(len(y), np.nan)
    return np.array([output.noise for output in outputs])


def constants(program: SeriesProgram, parameters: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """Return the constants in the recurrences of a series, and the inverse (n, n) of each of its constant matrices.

    `parameters` (k + s,) end with the signs of the s switching surfaces. The matrices are those of the linear systems
    for accelerations and multipliers. If a parameter is NaN, for example while the sign of a surface is unknown, the
    inverses are NaN. Raises SingularMassMatrix.
    """
    with np.errstate(all="ignore"):
        values = FLOATS.evaluate(program.constants, 0.0, [0.0] * program.states, list(parameters))
    table, entries = np.array(values[: len(program.numbers)], dtype=float), values[len(program.numbers) :]
    unknown, inverses = bool(np.isnan(parameters).any()), []
    for plan in (stage.plan for stage in program.stages if not stage.plan.moving):
        matrix, entries = symmetric(plan.size, plan.triangle, entries), entries[len(plan.triangle) :]
        whole = np.full_like(matrix, np.nan) if unknown else np.zeros_like(matrix)
        for block in () if unknown else plan.blocks:
            whole[np.ix_(block, block)] = inverse(matrix[np.ix_(block, block)])
        inverses.append(whole)
    return table, inverses


def lower_places(size: int) -> list[tuple[int, int]]:
    """Return the pairs (row, column) of a lower triangle by rows: (0, 0), (1, 0), (1, 1) and so on."""
    return [(i, j) for i in range(size) for j in range(i + 1)]


def symmetric(size: int, places: Iterable[tuple[int, int]], entries: Iterable[Any], dtype: Any = float) -> NDArray[Any]:
    """Return the symmetric matrix (size, size) with `entries` at the `places` (row, column) of its lower triangle.

    All other entries of the triangle are zero. If there are more `entries` than places, the rest is not read.
    """
    full = np.zeros((size, size), dtype)
    for (i, j), entry in zip(places, entries, strict=False):
        full[i, j] = full[j, i] = entry
    return full


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse (n, n) of a symmetric matrix (n, n); it is NaN if an entry of the matrix is not finite.

    Raises SingularMassMatrix if the inverse of the scaled matrix has an entry above 1/`PIVOT`.
    """
    if not np.isfinite(matrix).all():
        return np.full_like(matrix, np.nan)
    diagonal = np.abs(np.diag(matrix))
    units: Any = np.empty_like(diagonal)
    if diagonal.all():
        units = 1 / np.sqrt(diagonal)
    else:  # the diagonal is zero for constraints and coordinates without inertia: units follow from other entries
        largest: Any = np.empty_like(diagonal)
        scale_rows(len(matrix), len(matrix), matrix.ravel(), units, largest)
    try:
        inverse = np.linalg.inv(matrix * units[:, None] * units)
    except np.linalg.LinAlgError as error:
        raise SingularMassMatrix from error
    if not np.isfinite(inverse).all() or np.abs(inverse).max() > 1 / PIVOT:
        raise SingularMassMatrix
    with np.errstate(all="ignore"):  # values that overflow are infinite; the run reports them
        return np.asarray(inverse * units[:, None] * units)
