"""The numpy machine: programs, Taylor series and dense output without a compiler, with Python and NumPy only.

The interpreted series is the readable reference. With floats it is the series of this machine. With numbers of mpmath
it gives reference solutions of any precision. Dense output uses the same procedures as machine code, printed as Python.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.algorithm.dense.block import StepPolynomial, block_size
from lagrange.algorithm.dense.polynomials import series_polynomial
from lagrange.algorithm.series.order_by_cost import cheapest_order
from lagrange.algorithm.series.packing import pack
from lagrange.algorithm.step.error_control import steps_of
from lagrange.algorithm.step.memory import Layout
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.equations.solve_plan import SolvePlan
from lagrange.machine.backend import BlockPolynomial, Callback, FloatArray, Kernel, Places, Shared, SingularMassMatrix
from lagrange.machine.kernel.interpreted import FLOATS, Arithmetic, inverse, lower_places, symmetric
from lagrange.machine.kernel.python_kernel import kernel_in_python
from lagrange.machine.python_source import PrintedProcedure, arrays_loaded, between_arrays, called
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import LAWS, StepProgram

STEPS_PER_BLOCK, TIMES_PER_BLOCK = 1024, 16384
"""Bounds of the memory of dense output: largest numbers of steps, and of output times, that are computed at once."""

SHORT_BLOCK = 16
"""Largest size of a block of steps (number of steps times length of a state) whose polynomials are computed number by
number. Larger blocks are computed by operations on arrays. One such operation takes as long as twenty on numbers.
"""

NONE = np.empty(0).data
"""Argument passed for an array that the called procedure does not use."""


@dataclass(frozen=True, eq=False)
class NumpyDense:
    """The dense output of the numpy machine (implements `DensePath`) for states with `dimension` entries.

    `degree` is the degree of the polynomials. `both` is True if a polynomial also depends on a neighbouring step.
    `size(columns)` returns the number of doubles of work memory for a block of `columns` steps. `write(columns,
    step_data, neighbours, work, out)` writes the polynomials of a block to `out`, in the layout of `POLYNOMIAL`.
    `step_data` has the steps of the block, `neighbours` a neighbour of each, and `work` is work memory.
    """

    dimension: int
    degree: int
    both: bool
    size: Callable[[int], int]
    write: Callable[..., None]

    def polynomial(self) -> BlockPolynomial:
        """Return the callback that writes the polynomials of a block of steps, for printed procedures."""

        def write(_: Any, columns: int, *arrays: Any) -> None:
            block, neighbours, work, out = (
                array if isinstance(array, np.ndarray) else np.frombuffer(array) for array in arrays
            )
            self.write(columns, block, neighbours, work, out)

        return BlockPolynomial(write, np.empty(0).data, WIDEST_VECTOR, self.size(WIDEST_VECTOR), self.both, ())

    def coefficients(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the polynomial coefficients (degree + 1, 2n, k) of k steps of a run, those with indices `steps`."""
        coefficients = np.empty((self.degree + 1, self.dimension, len(steps)))
        for low in range(0, len(steps), STEPS_PER_BLOCK):
            part = slice(low, low + STEPS_PER_BLOCK)
            coefficients[:, :, part] = self._block(times, states, steps[part])
        return coefficients

    def at(self, times: FloatArray, states: FloatArray, requested_times: FloatArray, out: FloatArray) -> None:
        """Write the states at `requested_times` (K,) of a run with accepted `times` and `states` to `out` (2n, K)."""
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
        """Return the coefficients (degree + 1, 2n, k) of the polynomials on a block of k steps, all computed at once.

        `steps` are the indices of the steps. The run has the accepted `times` (S+1,) and `states` (S+1, 2n).
        """
        n, count = self.dimension, len(steps)
        out = np.empty((self.degree + 1) * n * count)
        block, neighbours = _gathered(times, states, steps), np.empty(0)
        if self.both:
            next_to = np.where(steps > 0, steps - 1, min(1, len(times) - 2))
            alone = len(times) < 3
            neighbours = _gathered(times, states, next_to, np.where(steps > 0, -1.0, 0.0 if alone else 1.0))
        with np.errstate(all="ignore"):
            self.write(count, block, neighbours, np.empty(self.size(count)), out)
        return out.reshape(-1, n, count)


def write_steps(
    kind: StepPolynomial,
    kernel: Kernel,
    parameters: FloatArray,
    jacobian: Kernel | None,
    columns: int,
    *arrays: FloatArray,
) -> None:
    """Write the dense output polynomials of a block of `columns` steps, computed in Python.

    `kind` states how the polynomial follows from the two ends of a step. `kernel` is the right-hand side and `jacobian`
    its derivative or None. The four `arrays` are the steps of the block, a neighbouring step of each, work memory, and
    the array to which the coefficients are written.
    """
    law, n = _by_columns(kernel, parameters), kernel.program.states
    derivative = None if jacobian is None else _by_columns(jacobian, parameters)
    few = columns * n <= SHORT_BLOCK
    table, *rest = [array.data if few else array for array in (kind.table, *arrays)]
    write = called(kind.procedure).function if few else arrays_loaded(kind.procedure)
    write(law, NONE, derivative, NONE, _invert, table, kind.stages, kind.degree, n, columns, *rest)


def _by_columns(kernel: Kernel, parameters: FloatArray) -> Callable[..., int]:
    """Return a function of the type `COLUMNS`, by which printed procedures evaluate a kernel at many states.

    Its arguments are the number of states, their times, coordinates and velocities (one column for each state), an
    unused argument, and the array that receives the results. Results at a singular mass matrix are NaN. The
    function always returns -1: no column needs treatment by the caller.
    """
    half = kernel.program.states // 2

    def evaluate(count: int, t: Any, q: Any, v: Any, _: Any, out: Any) -> int:
        parts = [np.asarray(part)[: half * count].reshape(half, count) for part in (q, v)]
        results = _known(kernel, np.asarray(t)[:count], np.concatenate(parts), parameters)
        np.asarray(out)[: results.size] = results.reshape(-1)
        return -1

    return evaluate


def _invert(order: int, columns: int, a: Any, _: Any) -> None:
    """Invert `columns` matrices of size `order`. The inverse of a singular matrix is NaN.

    `a` is a flat array of shape (order, 2 order, columns). Its part [:, :order] has the matrices. The inverses are
    written to the part [:, order:].
    """
    both = np.asarray(a)[: 2 * order * order * columns].reshape(order, 2 * order, columns)
    matrices = np.moveaxis(both[:, :order], -1, 0).copy()
    try:
        inverses = np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        inverses = np.full_like(matrices, np.nan)
        for matrix, inverted in zip(matrices, inverses, strict=True):
            with suppress(np.linalg.LinAlgError):
                inverted[:] = np.linalg.inv(matrix)
    both[:, order:] = np.moveaxis(inverses, 0, -1)


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
    """Return the data of the steps with indices `steps`, as a flat array with one column for each step.

    The rows are the start times, the lengths, `side`, and the states at the start and at the end. If the steps are
    neighbours of others, `side` is -1.0 for a neighbour before, 1.0 for one after, and 0.0 for none. Otherwise it is
    0.0. `times` (S+1,) and `states` (S+1, 2n) are those of the run.
    """
    count = len(steps)
    block = np.empty(block_size(states.shape[1], count))
    rows = block.reshape(-1, count)
    rows[0], rows[1], rows[2] = times[steps], times[steps + 1] - times[steps], side
    size = states.shape[1]
    rows[3 : 3 + size], rows[3 + size :] = states[steps].T, states[steps + 1].T
    return block


Numbers = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Jet:
    """Computes the Taylor coefficients of a motion by interpreting its series program, for one set of parameters.

    `parameters` end with one number for each switching surface, the sign of its function. `arithmetic` is the type of
    numbers: doubles, or numbers of mpmath.
    """

    program: SeriesProgram
    parameters: Sequence[Any] | Numbers
    arithmetic: Arithmetic = field(default=FLOATS)

    def coefficients(self, t: Any, y: Sequence[Any] | Numbers, order: int, scale: Any = 1, low: Any = None) -> Numbers:
        """Return the Taylor coefficients of all values of the program, (order + 1, values), at time t.

        Row k has the derivatives divided by k! and multiplied by scale**k. The state is y + `low`, where `low` (2n,) is
        a correction below the rounding of y, or None for zero. Values 0 to 2n - 1 are the coordinates and the
        velocities. Raises SingularMassMatrix.
        """
        program = self.program
        n = program.dimension
        x = np.full((order + 1, len(program.rules)), self.arithmetic.number(0.0), dtype=self.arithmetic.dtype)
        table = self._table[: len(program.numbers)]
        lost = [self.arithmetic.number(0.0)] * program.states if low is None else low
        first = self._with_systems.evaluate(program.start, t, [*y, *lost], [*self.parameters, *table])
        x[0, list(program.started)] = first[: len(program.started)]
        x[0, : program.states] = list(y)
        entries = iter(first[len(program.started) :])
        matrices = [
            self._eliminated(stage.plan, entries) if known is None else known
            for stage, known in zip(program.stages, self._constant, strict=True)
        ]
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
        """The arithmetic of the jet, with functions that factor matrices and solve linear systems.

        The linear systems are those for the accelerations and multipliers at the start of a step.
        """

        def factor(n: int, *triangle: Any) -> Eliminated:
            return Eliminated(symmetric(n, lower_places(n), triangle, self.arithmetic.dtype))

        return replace(
            self.arithmetic, systems={"factor": factor, "solve": lambda _, known, *right: known.solve(right)}
        )

    @cached_property
    def _table(self) -> list[Any]:
        zeros = [self.arithmetic.number(0.0)] * self.program.states
        return self.arithmetic.evaluate(self.program.constants, zeros[0], zeros, self.parameters)

    @cached_property
    def _constant(self) -> list[Eliminated | None]:
        """The matrix of each linear system of the series after elimination; None for a matrix that is not constant."""
        entries = iter(self._table[len(self.program.numbers) :])
        return [None if stage.plan.moving else self._eliminated(stage.plan, entries) for stage in self.program.stages]

    def _eliminated(self, plan: SolvePlan, entries: Iterator[Any]) -> Eliminated:
        """Return the matrix (n, n) of a linear system after elimination.

        `plan` lists the entries of its lower triangle that may differ from zero, and `entries` yields their values.
        Raises SingularMassMatrix.
        """
        mass = symmetric(plan.size, plan.triangle, entries, self.arithmetic.dtype)
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
        """Bring a copy of `matrix` (n, n) to upper triangular form. Raises SingularMassMatrix if a pivot is zero."""
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
    """The data from which one Taylor coefficient is computed: that of order `k` of the value with index `i`.

    A rule of the series program computes each value from others. `x` (orders, values) has all coefficients computed so
    far. `args` are the indices of the values that the rule reads, and `constants` the constants of the rule.
    Coefficients of order k are multiplied by `scale`**k.
    """

    x: Numbers
    k: int
    i: int
    args: tuple[int, ...]
    constants: Sequence[Any]
    scale: Any

    @property
    def u(self) -> Numbers:
        """The Taylor coefficients of orders 0 to k of the computed value itself. Its coefficient k is not known yet."""
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
    """Return a Taylor coefficient of a root or power whose argument a is zero. `at` says which coefficient.

    The result of order k is 0 if the coefficient of a of order k is zero, else NaN: the root has no Taylor series.
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
"""Functions that compute one Taylor coefficient of a value, by the name of the rule that defines the value."""


class NumpySeries(Shared):
    """The Taylor series of a motion, computed by an interpreter (implements `Series` and `SeriesCode`)."""

    is_final = True

    def __init__(self, program: SeriesProgram) -> None:
        self.program = program
        self._prepared: tuple[bytes, Jet] | None = None
        self._order = cache(partial(cheapest_order, pack(program, WIDEST_VECTOR)))

    def __reduce__(self) -> tuple[Any, ...]:
        return NumpySeries, (self.program,)

    def form(self, order: int) -> str:
        """Return "interpreted", the word for this series in the printed summary of a run."""
        return "interpreted"

    def order(self, tolerance: float) -> int:
        """Return the order of the series for a relative tolerance, the same order as on the LLVM machine."""
        return self._order(tolerance)

    @cached_property
    def values(self) -> Kernel:
        """The kernel that evaluates the event functions and switching surfaces at a state."""
        return kernel_in_python(self.program.values)

    @cached_property
    def layout(self) -> TaylorLayout:
        """The layout in memory of the coefficients of the series, the same for every order."""
        return TaylorLayout.of(self.program)

    @property
    def loop(self) -> PrintedProcedure:
        """The procedure that takes Taylor steps in a loop, printed as Python."""
        return called(taylor_steps.form(layout=self.layout))

    @property
    def function(self) -> Callable[..., bool]:
        """The Python function by which the loop over steps computes the Taylor coefficients at a state."""
        return _between_arrays(self)

    def joined(self, parameters: FloatArray, values: Kernel | None) -> tuple[FloatArray, Sequence[int]]:
        """Return the parameters twice in one array, for the series and for the event functions, and three lengths.

        The lengths are those of the first part, of other constants (0, since there are none), and of the last part.
        """
        return np.concatenate([parameters, parameters]), (len(parameters), 0, len(parameters))

    def count(self, steps: int) -> bool:
        """Return False: this code is never replaced by optimized code, as machine code is after many steps."""
        return False

    def load(self, program: Program) -> Kernel:
        """Return the kernel of a program. Programs with a large linear system are interpreted."""
        return kernel_in_python(program)

    def code(self, order: int) -> NumpySeries:
        """Return this object, which computes coefficients of every order."""
        return self

    def dense(self, order: int, parameters: FloatArray) -> NumpyDense:
        """Return the dense output of Taylor steps of an `order`: the Taylor polynomial of this order on each step."""
        n = self.program.states
        size = partial(_work_size, 2 * n + (order + 1) * (n + len(self.program.watched)))
        write = partial(_write_polynomials, self, order, parameters)
        return NumpyDense(n, order, both=False, size=size, write=write)

    def rows(
        self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray, low: FloatArray | None = None
    ) -> FloatArray:
        """Return the Taylor coefficients at the state y + `low`. Row k has those of order k, times `scale`**k.

        `low` (2n,) is a correction below the rounding of y, or None for zero.
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
    """Return `size`, the work memory in doubles for one step: the steps of a block are computed one after the other."""
    return size


def _write_polynomials(series: NumpySeries, order: int, parameters: FloatArray, *arrays: Any) -> None:
    """Write the Taylor polynomials of an `order` on a block of steps.

    The `arrays` are the number of steps, the data of the steps, data of their neighbours (unused), work memory, and the
    array to which the coefficients are written.
    """
    n, jet = series.program.states, _between_arrays(series)
    write = arrays_loaded(series_polynomial.form())
    write(jet, parameters, None, order, n + len(series.program.watched), n, n, *arrays)


def _between_arrays(series: NumpySeries) -> Callable[..., bool]:
    """Return a function by which printed procedures compute the Taylor coefficients of `series` into an array.

    Its arguments are t, the scale, the state, the parameters, an unused array, the array to which coefficients are
    written (row k for order k), and the order. The array of the state has 2n entries, then their 2n rounding errors.
    The function returns True if a matrix is singular, else False.
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


@dataclass(frozen=True)
class NumpyMachine:
    """The back end without a compiler: it prints programs as Python and runs them with NumPy (implements `Machine`)."""

    name: str = "numpy"

    def load(self, program: Program) -> Kernel:
        """Return the kernel of a program, printed as Python. A program with a large linear system is interpreted."""
        return kernel_in_python(program)

    def series(self, program: SeriesProgram) -> NumpySeries:
        """Return the Taylor series that `program` states. It is computed by an interpreter."""
        return NumpySeries(program)

    def loop(self, step: StepProgram, law: Program, *, projected: bool) -> tuple[PrintedProcedure, Layout]:
        """Return the loop over steps of a method, printed as Python, and the layout of its work array.

        Steps evaluate the program `law`. With `projected` each new state is projected onto the constraints.
        """
        layout = Layout(step, LAWS[step.law].dimension(law.states), block=1, projected=projected)
        return called(steps_of(layout)), layout

    def callback(self, kernel: Kernel, parameters: FloatArray, *, of_steps: bool = False) -> Callback:
        """Return a Python function by which procedures evaluate a kernel, and its parameters. `of_steps` is ignored."""
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
        """Return the dense output of steps by the step polynomial `kind`, computed by Python code on arrays.

        `kernel` is the right-hand side, and `jacobian` its derivative, or None.
        """
        n, write = kernel.program.states, partial(write_steps, kind, kernel, parameters, jacobian)
        return NumpyDense(n, kind.degree, kind.derivative, partial(kind.size, n), write)

    def event_steps(self, *_: Any, **__: Any) -> None:
        """Return None: no function finds events. The caller searches many steps at once with NumPy, which is faster."""
