"""Dense output of whole runs: paths over their steps, computed on demand, sampled from another solver, or stored."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from lagrange.algorithm.dense.block import StepPolynomial, chebyshev_points
from lagrange.algorithm.dense.polynomials import hermite_polynomial, runge_kutta_polynomial
from lagrange.errors import RunError
from lagrange.machine.backend import DensePath, FloatArray, Places, Series
from lagrange.machine.model import Model
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.tableaux.butcher import ButcherTableau


@dataclass(frozen=True, eq=False)
class StepPath:
    """The path over accepted steps: times (S+1,), states (S+1, 2n), and the dense output of their method.

    On each step the path is a polynomial of degree at most 16, on which events are located. `dense` evaluates the path,
    and `kind` is its formula. `tableau` is set for a path by the stages of an explicit Runge-Kutta method.
    """

    dense: DensePath
    times: FloatArray
    states: FloatArray
    kind: StepPolynomial
    tableau: ButcherTableau | None = None

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at times (K,) in any order."""
        if len(self.times) < 2 or not len(times):
            return np.repeat(self.states[:1].T, len(times), axis=1)
        return sorted_along(self.times, times, self._sorted)

    def _sorted(self, requested_times: FloatArray) -> FloatArray:
        out = np.empty((self.states.shape[1], len(requested_times)))
        self.write(requested_times, out)
        return out

    def write(self, requested_times: FloatArray, out: FloatArray) -> None:
        """Write the states at times (K,), sorted along the run, to `out` (2n, K), which must be contiguous."""
        self.dense.at(self.times, self.states, requested_times, out)

    def inside(self, steps: Places, theta: FloatArray) -> FloatArray:
        """Return the states (2n, k, K) at the fractions theta (K,) of each of the k steps with the indices `steps`."""
        return np.asarray(polyval(theta, self.dense.coefficients(self.times, self.states, steps)))


@dataclass(frozen=True, eq=False)
class MotionsPath:
    """Dense output of a run with resets: one path for each smooth piece, from times (K,) to states (2n, K).

    `times` (S+1,) and `states` (S+1, 2n) are the accepted states of the run. `breaks` are three arrays with an entry
    for each piece but the last: the index of its last accepted state, then the time and the state at the end of its
    last step before that step was shortened. This time and state are NaN if the step was not shortened. `path` is a
    path through some states of the run, whose formula all pieces use.
    """

    times: FloatArray
    states: FloatArray
    breaks: tuple[NDArray[np.int64], FloatArray, FloatArray]
    path: StepPath

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at times (K,) in any order; at the time of a reset, the state after the reset."""
        states = np.empty((self.states.shape[1], len(times)))
        rows = self.breaks[0][self.breaks[0] < len(self.times) - 1]
        forward = 1.0 if self.times[-1] >= self.times[0] else -1.0
        motions = np.searchsorted(forward * self.times[rows], forward * times, side="right")
        return _by_piece(motions, times, self._motion, states)

    def _motion(self, number: int) -> StepPath:
        """Return the path over smooth piece number `number`. A reset ends a piece."""
        rows, ends, whole = self.breaks
        begin = int(rows[number - 1]) + 1 if number else 0
        last = int(rows[number]) if number < len(rows) else len(self.times) - 1
        t, y = self.times[begin : last + 1], self.states[begin : last + 1]
        if number < len(rows) and not np.isnan(ends[number]):
            t, y = np.append(t[:-1], ends[number]), np.concatenate([y[:-1], whole[number][None]])
        return replace(self.path, times=t, states=y)


def _by_piece(
    numbers: NDArray[np.intp],
    times: FloatArray,
    path_of: Callable[[int], Callable[[FloatArray], FloatArray]],
    states: FloatArray,
) -> FloatArray:
    """Write the states at times (K,) to `states` (2n, K), and return them.

    `numbers` (K,) are the indices of the pieces of the run to which the times belong. `path_of` maps such an index to
    the path of the piece, a function from times (k,) to states (2n, k).
    """
    order = np.argsort(numbers, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1):
        if len(group):
            states[:, group] = path_of(int(numbers[group[0]]))(times[group])
    return states


def sorted_along(run_times: FloatArray, times: FloatArray, at: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return the states (2n, K) at times (K,) in any order, from a function `at` that needs sorted times.

    `at` maps times that are sorted like `run_times`, rising or falling, to states (2n, K).
    """
    rising = times if len(run_times) < 2 or run_times[-1] >= run_times[0] else -times
    if (rising[1:] >= rising[:-1]).all():
        return at(times)
    order = np.argsort(rising)
    sorted_states = at(times[order])
    states = np.empty_like(sorted_states)
    for row, sorted_row in zip(states, sorted_states, strict=True):
        row[order] = sorted_row
    return states


def step_path(
    model: Model,
    parameters: FloatArray,
    kind: StepPolynomial,
    times: FloatArray,
    states: FloatArray,
    tableau: ButcherTableau | None = None,
) -> StepPath:
    """Return the path by the formula `kind` through accepted times (S+1,) and states (S+1, 2n) of a model.

    `parameters` are the model's parameters. `tableau` is the tableau of an explicit Runge-Kutta method, else None.
    """
    derivative = model.kernel("jacobian") if kind.derivative else None
    dense = model.machine.dense(kind, model.kernel("rhs"), parameters, derivative)
    return StepPath(dense, times, states, kind, tableau)


@lru_cache(maxsize=64)
def stages_polynomial(tableau: ButcherTableau) -> StepPolynomial:
    """Return the formula of the dense output of an explicit Runge-Kutta method, which is made from its stages."""
    if tableau.dense is None:
        raise AssertionError("a method is registered without its dense output")
    rows = np.zeros((len(tableau.rows), len(tableau.rows)))
    for i, row in enumerate(tableau.rows):
        rows[i, : len(row)] = [float(a) for a in row]
    powers = max(map(len, tableau.dense.weights))
    weights = np.array([[*map(float, line), *[0.0] * (powers - len(line))] for line in tableau.dense.weights])
    return runge_kutta_polynomial(rows, np.array([float(c) for c in tableau.abscissae]), weights)


def hermite_path(order: int) -> Callable[[Problem, FloatArray, FloatArray], StepPath]:
    """Return a function that makes Hermite paths of degree `order` - 1, at least 3, for a method of this order.

    The function takes a problem, accepted times (S+1,) and states (S+1, 2n).
    """

    def path(problem: Problem, times: FloatArray, states: FloatArray) -> StepPath:
        kind = hermite_polynomial(max(3, order - 1))
        return step_path(problem.model, problem.parameter_array, kind, times, states)

    return path


@dataclass(frozen=True, eq=False)
class SeriesPath:
    """The path over accepted steps by Taylor series: times (S+1,), states (S+1, 2n), and the series of a given order.

    `epochs` are pairs of a step index and an array: the parameters, and the signs of switching surfaces, from this step
    on. `continuations` maps the indices of steps without a series to their dense output.
    """

    series: Series
    order: int
    epochs: tuple[tuple[int, FloatArray], ...]
    times: FloatArray
    states: FloatArray
    continuations: Mapping[int, Callable[[FloatArray], FloatArray]] = field(default_factory=dict)

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at times (K,) in any order."""
        if len(self.times) < 2 or not len(times):
            return np.repeat(self.states[:1].T, len(times), axis=1)
        return sorted_along(self.times, times, self._sorted)

    def _sorted(self, requested_times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at `requested_times` (K,), which are sorted in the direction of the run."""
        states = np.empty((self.states.shape[1], len(requested_times)))
        if len(self.epochs) == 1 and not self.continuations:
            self.series.dense(self.order, self.epochs[0][1]).at(self.times, self.states, requested_times, states)
            return states
        sign = 1.0 if self.times[-1] >= self.times[0] else -1.0
        steps = np.searchsorted(sign * self.times, sign * requested_times, side="right") - 1
        steps = np.clip(steps, 0, len(self.times) - 2)
        begins = np.searchsorted(steps, [begin for begin, _ in self.epochs]).tolist()
        for (_, values), first, last in zip(self.epochs, begins, [*begins[1:], len(steps)], strict=True):
            if first < last:
                part = slice(first, last)
                self.series.dense(self.order, values).at(
                    self.times, self.states, requested_times[part], states[:, part]
                )
        for step, path in self.continuations.items():
            first, last = np.searchsorted(steps, [step, step + 1])
            if first < last:
                states[:, first:last] = path(requested_times[first:last])
        return states


@dataclass(frozen=True, eq=False)
class OutputPath:
    """Output times (K,), rising or falling, the states (2n, K) at these times, and the path between them.

    `path` maps times (k,) to states (2n, k). It is None for a run that stored its outputs alone; `refusal` then states
    the cause and the remedy.
    """

    times: FloatArray
    states: FloatArray
    path: Callable[[FloatArray], FloatArray] | None
    refusal: str = ""

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, k) at times (k,). Without a path, raises RunError between output times."""
        return sorted_along(self.times, times, self._sorted)

    def _sorted(self, requested_times: FloatArray) -> FloatArray:
        forward = len(self.times) < 2 or bool(self.times[-1] >= self.times[0])
        output_times, sought = (self.times, requested_times) if forward else (-self.times, -requested_times)
        index = np.searchsorted(output_times, sought, side="right") - 1
        is_inside = index >= 0
        is_inside[is_inside] = output_times[index[is_inside]] == sought[is_inside]
        if is_inside.all():
            return self.states[:, index]
        between = requested_times[~is_inside]
        if self.path is None:
            raise RunError(f"there is no state at t = {between[0]:.16g}: {self.refusal}")
        states = self.path(between)
        if not is_inside.any():
            return states
        result = np.empty((len(states), len(requested_times)))
        result[:, ~is_inside], result[:, is_inside] = states, self.states[:, index[is_inside]]
        return result


@dataclass(frozen=True, eq=False)
class PiecewisePath:
    """Dense output of a run with one interpolant per step: from times (K,) to states (2n, K).

    `edges` (steps + 1,) are the times of the accepted states, rising or falling. `start` (2n,) is the first state.
    `interpolants` has a function for each step, from times (k,) to states (2n, k). At an edge, the interpolant of the
    step that begins there is used.
    """

    edges: FloatArray
    start: FloatArray
    interpolants: Sequence[Callable[[FloatArray], FloatArray]]

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at times (K,) in any order."""
        states = np.repeat(self.start[:, None], len(times), axis=1)
        if len(self.interpolants):
            forward = np.sign(self.edges[-1] - self.edges[0])
            steps = np.searchsorted(forward * self.edges, forward * times, side="right") - 1
            steps = np.clip(steps, 0, len(self.interpolants) - 1)
            _by_piece(steps, times, self.interpolants.__getitem__, states)
        return states


FEWEST_SPACINGS = 256
"""Length of a step, in spacings of the solver's times, below which its path is a straight line. A polynomial of degree
up to 12 through states at rounded times would oscillate."""


@dataclass(frozen=True, eq=False)
class StepInterpolant:
    """The polynomial over one step from the time `begin`, by its `values` (k, 2n) at Chebyshev points.

    `length` is the length of the step. The polynomial passes through both accepted states. The solver's own interpolant
    may miss them by the tolerance.
    """

    begin: float
    length: float
    values: FloatArray

    @classmethod
    def read(
        cls,
        times: tuple[float, float],
        ends: tuple[FloatArray, FloatArray],
        solver_times: tuple[float, float],
        interpolant: Callable[[FloatArray], FloatArray],
        degree: int,
    ) -> StepInterpolant:
        """Return the polynomial of a given `degree` over one step, sampled from a solver's interpolant.

        The step goes from the first to the second of `times`, and `ends` are the states (2n,) there, which the
        polynomial has exactly. `interpolant` maps times of the solver (k,) to states (2n, k). `solver_times` are the
        solver's times at both ends, which may count from another origin.
        """
        first, last = solver_times
        x = chebyshev_points(degree)[:, None]
        if len(x) == 2 or abs(last - first) < FEWEST_SPACINGS * float(np.spacing(max(abs(first), abs(last)))):
            values = (1 - x) * ends[0] + x * ends[1]
        else:
            inner = interpolant(first + x[1:-1, 0] * (last - first)).T
            values = np.concatenate([ends[0][None], inner, ends[1][None]])
            if not np.isfinite(inner).all():
                values = (1 - x) * ends[0] + x * ends[1]
        return cls(times[0], times[1] - times[0], values)

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, k) at times (k,) on the step."""
        shares = _shares(len(self.values), (times - self.begin) / self.length)
        return np.asarray((shares @ self.values).T)


class StepInterpolants(Sequence[StepInterpolant]):
    """The polynomials over the steps of a run, from the step with index `first` on. Each is made at its first access.

    `entries` has for each step its polynomial, or a function that samples the solver's path. Sampling takes as long as
    a step of a fast solver, and few runs need states between their steps.
    """

    def __init__(self, entries: list[Any], first: int = 0) -> None:
        self._entries, self._first = entries, first

    def __reduce__(self) -> tuple[Any, ...]:
        return StepInterpolants, (list(self),)

    def __len__(self) -> int:
        return len(self._entries) - self._first

    def __getitem__(self, which: Any) -> Any:
        index = range(self._first, len(self._entries))[which]
        entry = self._entries[index]
        if isinstance(entry, partial):
            with np.errstate(all="ignore"):
                entry = self._entries[index] = entry()
        return entry


@dataclass(frozen=True, eq=False)
class SampledPath:
    """The path over accepted steps: times (S+1,), states (S+1, 2n), and polynomials of one degree, one per step."""

    times: FloatArray
    states: FloatArray
    interpolants: Sequence[StepInterpolant]

    def inside(self, steps: Places, theta: FloatArray) -> FloatArray:
        """Return the states (2n, k, K) at the fractions theta (K,) of each of the k steps with the indices `steps`."""
        values = np.stack([self.interpolants[step].values for step in steps.tolist()])
        return np.asarray(np.moveaxis(_shares(values.shape[1], theta) @ values, -1, 0))


def _shares(count: int, theta: FloatArray) -> FloatArray:
    """Return the weights (K, count) of values at `count` Chebyshev points in their interpolation at theta (K,).

    The points and theta are fractions of a step. Source: J.-P. Berrut, L. N. Trefethen, Barycentric Lagrange
    interpolation, SIAM Review 46 (2004) 501, (4.2) and (5.4).
    """
    away = theta[:, None] - chebyshev_points(count - 1)
    hits = away == 0
    weights = np.where(np.arange(count) % 2, -1.0, 1.0)
    weights[[0, -1]] /= 2
    shares = np.where(hits.any(axis=1)[:, None], hits, weights / np.where(hits, 1.0, away))
    return np.asarray(shares / shares.sum(axis=1)[:, None])
