"""Integrate a system in multiple precision, as a reference for runs in doubles.

The stated equations of motion are formed by differences, not derived in symbols. The method is Gauss's collocation.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from sympy import Symbol

from lagrange.errors import RunError
from lagrange.evidence import differences
from lagrange.evidence.differences import ConstraintSurface, DifferenceSteps, Numbers, Sources, StatedConstraints
from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.statement import Statement

GUARD = 14
"""Number of additional digits, beyond the digits that the differences lose."""


class PreciseEquations:
    """Residuals of the equations of motion in multiple precision, from the stated L, Q and D.

    `digits` is the number of digits that the residuals keep.
    """

    def __init__(self, statement: Statement, parameters: Mapping[Any, float], digits: int) -> None:
        # dp/dt is a difference of differences: it loses twice the digits of the step, and its error is the square of
        # the step.
        self.exponent = digits // 2 + 3
        precision = digits + 2 * self.exponent + GUARD
        lagrangian = Precise([statement.lagrangian], statement, precision)
        loads = Precise([*statement.forces, statement.dissipation], statement, precision)
        constraints = Precise([each.expression for each in statement.constraints], statement, precision)
        self.surface = ConstraintSurface(statement, precision)
        self.context = lagrangian.context
        self.number = self.context.mpf
        values = self.values = {p: self.number(parameters[p]) for p in statement.parameters}

        def energy(q: Sequence[Any], v: Sequence[Any], t: Any) -> Any:
            return lagrangian(q, v, t, values)[0]

        self.source = Sources(
            lagrangian=energy,
            for_momenta=lambda i: energy,
            for_forces=lambda i: energy,
            for_mass=lambda i: energy,
            applied=lambda q, v, t: loads(q, v, t, values)[:-1],
            dissipation=(lambda i: lambda q, v, t: loads(q, v, t, values)[-1]) if statement.dissipation != 0 else None,
            nudge=differences.exactly,
            read=lambda i: range(len(statement.state_names)),
            touched=lambda j: range(len(statement.coordinates)),
        )
        holonomic = tuple(constraint.holonomic for constraint in statement.constraints)
        self.constraints = StatedConstraints.alike(lambda q, v, t: constraints(q, v, t, values), holonomic)

    def on_constraints(self, t: Any, state: Numbers) -> Numbers:
        """Return a state at time t moved onto the constraints, from which given states may differ by rounding.

        Raises RunError if no state on the constraints is found.
        """
        if not self.constraints.holonomic:
            return state
        n = len(state) // 2
        try:
            q, v = self.surface.nearest(state[:n], state[n:], t, self.values)
        except OutsideDomain as reason:
            raise RunError(f"no precise run starts here: {reason}.") from reason
        return [*q, *v]

    def steps(self, q: FloatArray, v: FloatArray, length: float) -> DifferenceSteps:
        """Return the difference steps for an interval of the given `length`, in which q and v (s, n) are states."""
        unit = self.number(10) ** -self.exponent
        sizes = [np.abs(x).max(axis=0) for x in (q, v)]
        by_q, by_v = ([unit * (float(x) or 1.0) for x in size] for size in sizes)
        return DifferenceSteps(by_q, by_v, unit * abs(length))

    def residual(
        self, q: Numbers, v: Numbers, a: Numbers, multipliers: Numbers, t: Any, steps: DifferenceSteps
    ) -> Numbers:
        """Return [dp/dt - f - G^T lambda, dpsi/dt], n + m numbers that are zero for the motion.

        `a` are the accelerations, and `multipliers` are lambda. `steps` are the difference steps.
        """
        free = self.source.residual(q, v, t, steps, a)
        if not self.constraints.holonomic:
            return free
        exerted = zip(*differences.reactions(self.constraints.gradient(q, v, t, steps), multipliers), strict=True)
        balance = [x - sum(forces) for x, forces in zip(free, exerted, strict=True)]
        return [*balance, *self.constraints.acceleration_level(q, v, t, steps, a)]


Improvement = Callable[[FloatArray], FloatArray]

LEAST_POINTS = 8
"""Smallest number of points per interval. With more digits it is the number of digits, about the optimum."""

SHORTEST_INTERVAL = 1e-9
"""Shortest interval, relative to the length of the run."""

LARGEST_GROWTH = 2.0
"""Largest ratio of the lengths of an interval and the previous one."""

AGREED = 1e-9
"""Largest relative change after convergence in doubles, and first estimate of the contraction rate."""

SWEEPS = 10
"""Largest number of iterations for an interval. Two or three suffice, unless the interval is too long."""

WORTHWHILE = 0.1
"""Largest contraction rate of the corrections. A larger rate means that the interval is too long."""

SLACK = 100.0
"""Factor by which the last coefficients of the series of the accelerations may exceed their expected size."""

SAFETY = 0.1
"""Ratio of the largest accepted estimate of the truncation error of the series to the tolerance."""


def precise_run(
    model: Model,
    parameters: Mapping[Symbol, float],
    t0: float,
    y0: Sequence[Any],
    times: Sequence[float],
    *,
    digits: int = 30,
    max_wall: float | None = None,
) -> list[list[Any]]:
    """Return the states [q, v] at `times`, 2n mpmath numbers each, of the motion from the state `y0` at t0.

    The times are monotonic and start after t0. `parameters` has a value for every parameter; floats are converted
    exactly. About `digits` digits are right after a short run. An unstable motion loses some of them, as a second run
    with more digits shows. A run of 10 s of a double pendulum takes about 2 s. Raises RunError if the run cannot
    continue, for example at a jump of the forces, or if it takes longer than `max_wall` seconds.
    """
    run = _PreciseRun(model, parameters, digits, None if max_wall is None else time.perf_counter() + max_wall)
    number = run.equations.number
    state = run.equations.on_constraints(t0, [number(x) for x in y0])
    now, states = number(t0), []
    whole = abs(float(times[-1]) - t0) if len(times) else 0.0
    for end in times:
        state = run.advance(now, number(end), state, whole)
        now = number(end)
        states.append(state)
    return states


@dataclass(frozen=True)
class _Rule:
    """Gauss's rule with s points on [0, 1], in multiple precision and in doubles.

    - `matrix` maps values at the points to their integrals from 0 to each point.
    - In doubles, `nodes` are the points, `once` is `matrix`, and `twice` is the matrix of the double integral.
    - `spectrum` maps values at the points to coefficients of Legendre's polynomials.
    - `middle` and `tail` are the three middle and the three last rows of `spectrum` in multiple precision.
    """

    points: tuple[Any, ...]
    weights: tuple[Any, ...]
    matrix: tuple[tuple[Any, ...], ...]
    nodes: FloatArray
    once: FloatArray
    twice: FloatArray
    spectrum: FloatArray
    middle: tuple[tuple[Any, ...], ...]
    tail: tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class _Interval:
    """Solution of an interval in doubles: q, v and a at the s points of Gauss's rule, (s, n) each, and `times` (s,).

    `sizes` (n,) are the scales of the accelerations. `factor` is the length of the next interval divided by the length
    of this one. `improve` maps residuals of the equations to corrections of the accelerations.
    """

    q: FloatArray
    v: FloatArray
    a: FloatArray
    sizes: FloatArray
    factor: float
    times: FloatArray
    improve: Improvement


class _TooLong(Exception):
    """Raised if an interval is too long: the iteration fails, or the accelerations are not resolved."""


class _PreciseRun:
    """A run in multiple precision: equations of motion, quadrature rule, time limit, length of the next interval."""

    def __init__(self, model: Model, parameters: Mapping[Any, float], digits: int, deadline: float | None) -> None:
        self.parameters = dict(parameters)
        self.digits, self.deadline = digits, deadline
        self.equations = PreciseEquations(model.statement, parameters, digits)
        self.rule = _rule(max(LEAST_POINTS, digits), self.equations.context)
        self.model = model
        self.length: float | None = None

    def advance(self, t: Any, end: Any, state: Numbers, run_length: float) -> Numbers:
        """Return the state at the time `end`, by integration from `state` at the time t.

        Intervals are halved until they succeed. `run_length` is the length of the whole run.
        """
        while t != end:
            left = float(end - t)
            parts = 1 if self.length is None else math.ceil(abs(left) / self.length)
            while True:
                self._check(float(t), left / parts, run_length)
                then = end if parts == 1 else t + left / parts
                try:
                    guess = self._guess(float(t), float(then - t), state)
                    state = self._end(t, then - t, state, guess)
                    break
                except (_TooLong, RunError, OutsideDomain, np.linalg.LinAlgError):
                    parts *= 2
            t, self.length = then, abs(left / parts) * guess.factor
        return state

    def _check(self, t: float, length: float, run_length: float) -> None:
        """Raise RunError after the time limit, or if an interval at time `t` is too short to contain a smooth motion.

        `length` is the duration of the interval, and `run_length` that of the whole run.
        """
        if self.deadline is not None and time.perf_counter() > self.deadline:
            raise RunError(f"the precise run took longer than its time limit: it was at t = {t:.6g}.")
        if abs(length) < SHORTEST_INTERVAL * run_length:
            raise RunError(
                f"no precise run of {self.model.statement.name} passes t = {t:.6g}: the energies or forces, or "
                "their derivatives, jump there, or the accelerations have no value."
            )

    def _guess(self, t: float, h: float, state: Numbers) -> _Interval:
        """Return the solution of the interval from t to t + h in doubles. Raises _TooLong if it is too long."""
        times = t + h * self.rule.nodes
        start = np.array([float(x) for x in state])
        q0, v0 = self.model.layout.split(start)
        rhs = self.model.kernel("rhs")
        a = np.tile(self.model.called(rhs, t, start, self.parameters)[len(q0) :], (len(times), 1))
        with np.errstate(all="ignore"):
            for _ in range(SWEEPS):
                v = v0 + h * self.rule.once @ a
                q = q0 + h * self.rule.once @ v
                y = np.hstack([q, v]).T
                computed = self.model.called(rhs, times, y, self.parameters)[len(q0) :].T
                improve = self._improvement(times, h, y)
                change = improve(a - computed)
                a = a + change
                # `sizes` are changes of the accelerations that change the motion noticeably within the time h.
                terms = (np.abs(self.rule.spectrum @ a), np.abs(v) / abs(h), np.abs(q) / h**2)
                sizes = np.max([term.max(axis=0) for term in terms], axis=0)
                sizes = np.maximum(sizes, 1e-15 * float(sizes.max()) or 1.0)
                left = float((np.abs(change) / sizes).max())
                if not left < np.inf:
                    raise _TooLong
                if left <= AGREED:
                    return _Interval(q, v, a, sizes, self._growth(a, sizes), times, improve)
        raise _TooLong

    def _growth(self, a: FloatArray, sizes: FloatArray) -> float:
        """Return the length of the next interval divided by the length of this one.

        It is determined by the decay of the Legendre coefficients of the accelerations `a` (s, n), relative to `sizes`
        (n,). Raises _TooLong if this interval is too long.
        """
        # The order of Gauss's rule at the end of the interval is twice the order of the truncated series. So half of
        # the digits in the series are enough. The decay is measured at the middle coefficient, because later ones are
        # below the rounding of doubles.
        spectrum = np.abs(self.rule.spectrum @ a)
        middle = len(spectrum) // 2
        seen = float((spectrum[middle : middle + 3] / sizes).max())
        allowed = SAFETY * 10.0 ** (-self.digits / 2 * middle / len(spectrum))
        if seen > allowed:
            raise _TooLong
        return min(LARGEST_GROWTH, math.exp(math.log(allowed / max(seen, 1e-300)) / middle))

    def _improvement(self, times: FloatArray, h: float, y: FloatArray) -> Improvement:
        """Return a function from residuals of the equations (s, n) to Newton corrections of the accelerations (s, n).

        There is one row for each of the s points of Gauss's rule in an interval of length h. y are the states at these
        points.
        """
        n, s = self.model.dimension, len(times)
        slopes = self.model.jacobian(times, y, self.parameters)[n:]
        by_q, by_v = (np.moveaxis(part, -1, 0) for part in (slopes[:, :n], slopes[:, n:]))
        matrix = np.eye(s * n).reshape(s, n, s, n)
        matrix -= h * np.einsum("ij,ikl->ikjl", self.rule.once, by_v)
        matrix -= h**2 * np.einsum("ij,ikl->ikjl", self.rule.twice, by_q)
        if not np.isfinite(matrix).all():
            raise _TooLong
        inverse = np.linalg.inv(matrix.reshape(s * n, s * n))
        return lambda off: -(inverse @ off.ravel()).reshape(s, n)

    def _end(self, t: Any, h: Any, state: Numbers, guess: _Interval) -> Numbers:
        """Return the state at the end of the interval from t to t + h; `guess` is the solution in doubles."""
        dot = self.equations.context.fdot
        a = self._accelerations(t, h, state, guess)
        _, v = self._states(h, state, a)
        moved = []
        for start, rates in zip(self.model.layout.split(state), (v, a), strict=True):
            columns = zip(*rates, strict=True)
            moved += [x + h * dot(self.rule.weights, column) for x, column in zip(start, columns, strict=True)]
        return moved

    def _accelerations(self, t: Any, h: Any, state: Numbers, guess: _Interval) -> list[Numbers]:
        """Return accelerations at the points of Gauss's rule, s rows, correct to all digits.

        They are corrected iteratively, from the accelerations of `guess`. Raises _TooLong after too many corrections.
        """
        a = [[self.equations.number(float(x)) for x in row] for row in guess.a]
        steps = self.equations.steps(guess.q, guess.v, float(h))
        inverses, multipliers = self._solver(guess)
        n = self.model.dimension
        last, tolerance = 0.0, 10.0 ** -(self.digits + 1)
        for _ in range(SWEEPS):
            q, v = self._states(h, state, a)
            rows = [
                [float(x) for x in self.equations.residual(q[i], v[i], a[i], multipliers[i], t + c * h, steps)]
                for i, c in enumerate(self.rule.points)
            ]
            off = np.einsum("ikl,il->ik", inverses, np.array(rows))
            change = guess.improve(off[:, :n])
            a, multipliers = _moved(a, change), _moved(multipliers, off[:, n:])
            size = float((np.abs(change) / guess.sizes).max())
            left = size / last if last else AGREED
            if not left <= WORTHWHILE:
                break
            if size * left <= tolerance:
                self._check_tail(a, guess.sizes)
                return a
            last = size
        raise _TooLong

    def _solver(self, guess: _Interval) -> tuple[FloatArray, list[Numbers]]:
        """Return the inverses of M, or of [[M, G^T], [G, 0]], at the points, and approximate multipliers."""
        where = (guess.q.T, guess.v.T, guess.times, self.parameters)
        masses = np.moveaxis(self.model.evaluate("mass_matrix", *where), -1, 0)
        if not self.equations.constraints.holonomic:
            return np.linalg.inv(masses), [[] for _ in masses]
        rows = np.moveaxis(self.model.evaluate("constraint_gradient", *where), -1, 0)
        corner = np.zeros((len(rows), rows.shape[1], rows.shape[1]))
        matrices = np.block([[masses, np.swapaxes(rows, 1, 2)], [rows, corner]])
        multipliers = self.model.evaluate("multipliers", *where).T
        inverses = np.asarray(np.linalg.inv(matrices), dtype=float)
        return inverses, [[self.equations.number(float(x)) for x in row] for row in multipliers]

    def _check_tail(self, a: Sequence[Numbers], sizes: FloatArray) -> None:
        """Raise _TooLong if the last coefficients of the accelerations are large, as at a kink of the forces."""
        columns, dot = list(zip(*a, strict=True)), self.equations.context.fdot
        middle, tail = (
            np.array([max(abs(float(dot(row, column))) for row in rows) for column in columns])
            for rows in (self.rule.middle, self.rule.tail)
        )
        limit = np.maximum(SLACK * 10.0**-self.digits * sizes, SLACK * 10.0 ** (-self.digits / 4) * middle)
        if not (tail <= limit).all():
            raise _TooLong

    def _states(self, h: Any, state: Numbers, a: Sequence[Numbers]) -> tuple[list[Numbers], list[Numbers]]:
        """Return coordinates and velocities at the points of Gauss's rule, s rows of n mpmath numbers each.

        They are integrals of the accelerations `a` (s rows) over an interval of length h that begins at `state`.
        """
        first, rates = self.model.layout.split(state)
        v = self._integrated(h, rates, a)
        return self._integrated(h, first, v), v

    def _integrated(self, h: Any, start: Numbers, rates: Sequence[Numbers]) -> list[Numbers]:
        columns, dot = list(zip(*rates, strict=True)), self.equations.context.fdot
        return [
            [x + h * dot(row, column) for x, column in zip(start, columns, strict=True)] for row in self.rule.matrix
        ]


def _moved(numbers: Sequence[Numbers], by: FloatArray) -> list[Numbers]:
    """Return rows of mpmath numbers plus the array of doubles `by`, entry by entry."""
    return [[x + float(y) for x, y in zip(row, change, strict=True)] for row, change in zip(numbers, by, strict=True)]


@cache
def _rule(s: int, context: Any) -> _Rule:
    """Return Gauss's rule with s points in the precision of an mpmath context, from Legendre's polynomials."""
    guesses = np.polynomial.legendre.leggauss(s)[0]
    roots = [context.mpf(float(x)) for x in guesses]
    for _ in range(context.prec.bit_length()):  # Newton's method
        tables = ((x, _legendre(x, s)) for x in roots)
        roots = [x - p[s] * (x * x - 1) / (s * (x * p[s] - p[s - 1])) for x, p in tables]
    table = [_legendre(x, s + 1) for x in roots]
    slopes = [s * (x * p[s] - p[s - 1]) / (x * x - 1) for x, p in zip(roots, table, strict=True)]
    weights = [1 / ((1 - x * x) * slope * slope) for x, slope in zip(roots, slopes, strict=True)]
    points = [(1 + x) / 2 for x in roots]
    matrix = []
    for c, p in zip(points, table, strict=True):
        integrals = [c, *((p[k + 1] - p[k - 1]) / 2 for k in range(1, s))]
        matrix.append(tuple(w * context.fdot(integrals, r[:s]) for w, r in zip(weights, table, strict=True)))
    once = np.array(matrix, dtype=float)
    rows = [tuple((2 * k + 1) * w * p[k] for w, p in zip(weights, table, strict=True)) for k in range(s)]
    middle, tail = rows[s // 2 : s // 2 + 3], rows[-3:]
    spectrum, nodes = np.array(rows, dtype=float), np.array(points, dtype=float)
    exact = tuple(points), tuple(weights), tuple(matrix)
    return _Rule(*exact, nodes, once, once @ once, spectrum, tuple(middle), tuple(tail))


def _legendre(x: Any, degree: int) -> Numbers:
    """Return the values of Legendre's polynomials of degree 0 to `degree` at x."""
    values = [x * 0 + 1, x]
    for k in range(1, degree):
        values.append(((2 * k + 1) * x * values[k] - k * values[k - 1]) / (k + 1))
    return values
