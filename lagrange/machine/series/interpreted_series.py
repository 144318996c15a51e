"""Series programs on the numpy machine: Taylor coefficients by interpretation, the steps and their dense output.

The interpreted series is the readable reference. With floats it is the series of the numpy machine. With mpmath's
numbers it gives reference solutions of any precision.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.dense.polynomials import series_polynomial
from lagrange.algorithm.series.cost import Cost, best_order
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.equations.solve_plan import SolvePlan
from lagrange.machine.backend import FloatArray, Kernel, SingularMassMatrix
from lagrange.machine.copies import Shared
from lagrange.machine.dense.interpreted_dense import NumpyDense
from lagrange.machine.kernel.interpreted import FLOATS, Arithmetic
from lagrange.machine.kernel.python_kernel import kernel_in_python
from lagrange.machine.python_source import PrintedProcedure, arrays_loaded, called
from lagrange.machine.series.constants import inverse
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram

Numbers = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Jet:
    """The function that computes the Taylor coefficients of a motion, for one set of parameters.

    The parameters end with one number for each switching surface, the sign of its function.
    """

    program: SeriesProgram
    parameters: Sequence[Any] | Numbers
    arithmetic: Arithmetic = field(default=FLOATS)

    def coefficients(self, t: Any, y: Sequence[Any] | Numbers, order: int, scale: Any = 1, low: Any = None) -> Numbers:
        """Return the Taylor coefficients of all values of the program, (order + 1, values), at time t.

        Row k has the derivatives divided by k! and multiplied by scale**k. The state is y + `low`, where `low` (2n,)
        is a correction below the rounding of y, or None for zero.

        Values 0 to 2n - 1 are the coordinates and the velocities. Raises SingularMassMatrix.
        """
        program = self.program
        n = program.dimension
        x = np.full((order + 1, len(program.rules)), self.arithmetic.number(0.0), dtype=self.arithmetic.dtype)
        table = self._table[: len(program.numbers)]
        lost = [self.arithmetic.number(0.0)] * program.states if low is None else low
        first = self._with_systems.evaluate(program.start, t, [*y, *lost], [*self.parameters, *table])
        x[0, list(program.started)] = first[: len(program.started)]
        x[0, : program.states] = list(y)
        matrices = self._matrices(first[len(program.started) :])
        for k in range(1, order + 1):
            x[k, :n] = x[k - 1, list(program.rates)] * scale / k
            self._fill(x, k, program.before, scale)
            for stage, matrix, trial, following in zip(
                program.stages, matrices, program.trials, program.found, strict=True
            ):
                self._fill(x, k, trial, scale)
                rate = [x[k - 1, f] * scale / k if f is not None else 0 * y[0] for f in stage.right]
                right = [r if p is None else r - x[k, p] for r, p in zip(rate, stage.left, strict=True)]
                x[k, list(stage.unknowns)] = matrix.solve(right)
                self._fill(x, k, following, scale)
        return x

    @cached_property
    def _with_systems(self) -> Arithmetic:
        """The arithmetic of the numbers, with functions that factor matrices and solve linear systems.

        These systems give accelerations and multipliers at order 0.
        """

        def factor(n: int, *triangle: Any) -> Eliminated:
            matrix = np.full((n, n), self.arithmetic.number(0.0), dtype=self.arithmetic.dtype)
            rows, columns = np.tril_indices(n)
            matrix[rows, columns] = matrix[columns, rows] = triangle
            return Eliminated(matrix)

        return replace(
            self.arithmetic, systems={"factor": factor, "solve": lambda _, known, *right: known.solve(right)}
        )

    @cached_property
    def _table(self) -> list[Any]:
        zeros = [self.arithmetic.number(0.0)] * self.program.states
        return self.arithmetic.evaluate(self.program.constants, zeros[0], zeros, self.parameters)

    @cached_property
    def _constant(self) -> list[Eliminated | None]:
        """The matrix of each linear system of the series after elimination, or None if the matrix is not constant."""
        entries = iter(self._table[len(self.program.numbers) :])
        return [None if stage.plan.moving else self._eliminated(stage.plan, entries) for stage in self.program.stages]

    def _matrices(self, triangles: Sequence[Any]) -> list[Eliminated]:
        """Return the matrix of each linear system of the series after elimination.

        `triangles` has the entries of those matrices that are not constant: the lower triangle of each, one after the
        other.
        """
        entries, stages = iter(triangles), self.program.stages
        return [
            self._eliminated(stage.plan, entries) if known is None else known
            for stage, known in zip(stages, self._constant, strict=True)
        ]

    def _eliminated(self, plan: SolvePlan, entries: Iterator[Any]) -> Eliminated:
        """Return the matrix (n, n) of a linear system after elimination.

        `plan` says which entries of the lower triangle may differ from zero, and `entries` yields their values.
        Raises SingularMassMatrix.
        """
        mass = np.full((plan.size, plan.size), self.arithmetic.number(0.0), dtype=self.arithmetic.dtype)
        for i, j in plan.triangle:
            mass[i, j] = mass[j, i] = next(entries)
        if mass.dtype == float:
            inverse(mass)  # raises SingularMassMatrix for a matrix that is singular in doubles
        return Eliminated(mass)

    def _fill(self, x: Numbers, k: int, members: Sequence[int], scale: Any) -> None:
        """Compute the coefficients of order `k` of some values of the program, and write them to row k of `x`.

        `members` are the indices of these values. Coefficients are multiplied by `scale`**k.
        """
        for i in members:
            rule = self.program.rules[i]
            if rule.op not in ("coordinate", "unknown"):
                constants = [self._table[c] for c in rule.coefficients]
                x[k, i] = COEFFICIENT[rule.op](_Place(x, k, i, rule.args, constants, scale))


class Eliminated:
    """A matrix after elimination with row exchanges, with which linear systems are solved in any arithmetic.

    A matrix is singular here only if a pivot is zero. Matrices of doubles that are singular up to rounding are
    refused by an earlier test. A matrix with an entry that is not finite does not count as singular.
    """

    def __init__(self, matrix: Numbers) -> None:
        """Eliminate the matrix (n, n). Raises SingularMassMatrix."""
        self._upper = a = matrix.copy()
        self._rows: list[tuple[int, Numbers]] = []
        finite = a.dtype != float or bool(np.isfinite(a).all())
        for j in range(len(a)):
            pivot = j + int(np.argmax(np.abs(a[j:, j])))
            a[[j, pivot]] = a[[pivot, j]]
            if finite and not a[j, j]:
                raise SingularMassMatrix
            factors = a[j + 1 :, j] / a[j, j]
            a[j + 1 :] -= np.outer(factors, a[j])
            self._rows.append((pivot, factors))

    def solve(self, right: Sequence[Any]) -> Numbers:
        """Return the solution x (n,) of matrix * x = right, for a right-hand side (n,)."""
        n = len(right)
        a = np.concatenate([self._upper, np.array(right, dtype=self._upper.dtype)[:, None]], axis=1)
        x = a[:, n]
        for j, (pivot, factors) in enumerate(self._rows):
            x[[j, pivot]] = x[[pivot, j]]
            x[j + 1 :] -= factors * x[j]
        for j in reversed(range(n)):
            x[j] = (x[j] - a[j, j + 1 : n].dot(x[j + 1 :])) / a[j, j]
        return x


@dataclass(frozen=True, eq=False)
class _Place:
    """A Taylor coefficient to compute: that of value `i` at order `k`, by a rule of the series program.

    `x` (orders, values) has all coefficients computed so far. `args` are the indices of the values that the rule
    reads, and `constants` the constants of the rule. Coefficients of order k are multiplied by `scale`**k.
    """

    x: Numbers
    k: int
    i: int
    args: tuple[int, ...]
    constants: Sequence[Any]
    scale: Any

    @property
    def u(self) -> Numbers:
        """The Taylor coefficients of orders 0 to k of the value i that is computed. The last is not known yet."""
        return self.x[: self.k + 1, self.i]

    def arg(self, which: int) -> Numbers:
        """Return the Taylor coefficients of orders 0 to k of the rule's argument with index `which`."""
        return self.x[: self.k + 1, self.args[which]]


def _sum(a: Numbers, b: Numbers, first: int, last: int) -> Any:
    """Return the sum of a[j]*b[k-j] over first <= j <= last, where a and b have the entries 0 to k."""
    k = len(a) - 1
    return a[first : last + 1].dot(b[k - last : k - first + 1][::-1])


def _div(at: _Place) -> Any:
    a, b = at.arg(0), at.arg(1)
    return (a[-1] - _sum(b, at.u, 1, at.k)) / b[0]


def _sqrt(at: _Place) -> Any:
    if at.u[0] == 0:
        return _flat(at)
    return (at.arg(0)[-1] - _sum(at.u, at.u, 1, at.k - 1)) / (2 * at.u[0])


def _flat(at: _Place) -> Any:
    """Return a Taylor coefficient of a square root at a zero of its argument. `at` is the coefficient to compute.

    It is 0 if the argument stays zero, and NaN if the argument changes.
    """
    return at.u[0] if at.arg(0)[-1] == 0 else at.u[0] + math.nan


def _power(at: _Place) -> Any:
    a, k = at.arg(0), at.k
    if a[0] == 0 and at.constants[0] > 0:
        return _flat(at)
    j = np.arange(1, k + 1)
    return ((at.constants[0] * j - (k - j)) * a[1:]).dot(at.u[:k][::-1]) / (k * a[0])


def _against(at: _Place) -> Any:
    w = at.arg(1)
    return (at.arg(0)[-1] - _sum(np.arange(at.k + 1) * at.u, w, 1, at.k - 1) / at.k) / w[0]


COEFFICIENT: dict[str, Callable[[_Place], Any]] = {
    "time": lambda at: at.u[0] * 0 + (at.scale if at.k == 1 else 0),
    "constant": lambda at: at.u[0] * 0,
    "linear": lambda at: sum(scale * at.x[at.k, arg] for scale, arg in zip(at.constants, at.args, strict=True)),
    "mul": lambda at: _sum(at.arg(0), at.arg(-1), 0, at.k),
    "square": lambda at: _sum(at.arg(0), at.arg(0), 0, at.k),
    "div": _div,
    "inverse": lambda at: -_sum(at.arg(0), at.u, 1, at.k) / at.arg(0)[0],
    "sqrt": _sqrt,
    "power": _power,
    "integral": lambda at: at.constants[0] * at.arg(0)[-2] * at.scale / at.k,
    "along": lambda at: at.constants[0] * _sum(np.arange(at.k + 1) * at.arg(0), at.arg(1), 1, at.k) / at.k,
    "against": _against,
    "choose": lambda at: at.arg(0 if at.constants[0] else 1)[-1],
}
"""The coefficient of order k of a value by its rule."""


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
        """Return the parameters twice, for the series and for the event functions, and the lengths of three parts."""
        return np.concatenate([parameters, parameters]), (len(parameters), 0, len(parameters))

    def count(self, steps: int) -> bool:
        """Return False: this code is never replaced by optimized code, as machine code is after many steps."""
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
        below the rounding of y, None for zero. `parameters` end with the signs of the switching surfaces' functions.
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
    """Return the number of doubles of work memory for a block of steps: always `size`.

    It does not depend on the number of columns, because the steps are computed one after the other, in the same
    memory.
    """
    return size


def _write_polynomials(series: NumpySeries, order: int, parameters: FloatArray, *arrays: Any) -> None:
    """Write the polynomials of a block of Taylor steps of an order.

    The `arrays` are the number of steps, the steps, their neighbours (unused), work memory, and the coefficients,
    which are written.
    """
    n, jet = series.program.states, _between_arrays(series)
    write = arrays_loaded(series_polynomial.form())
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
