"""Newton's method for implicit steps: initial guesses of the unknowns, corrections, and tests of convergence.

For fixed steps backward differences of the unknowns are stored. The sum of the first k differences extrapolates the
polynomial through k values. The k-th difference at the next step is the error of that guess, and selects the best k.

The unknowns are corrected with a matrix that is kept from step to step, until the corrections are round-off (equal
steps) or far below the tolerance (error control). After a correction the error is estimated as the remainder of a
geometric series, with the contraction rate of the last two corrections, or the rate of the previous step. The matrix is
rebuilt when the corrections decrease slowly. If the corrections do not converge, error control shortens the step
(`error_control.py`), and a run with fixed steps ends. Source: E. Hairer, G. Wanner, Solving Ordinary Differential
Equations II, 2nd ed., 1996, IV.8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.constants import Outcome
from lagrange.algorithm.step.memory import HISTORY, ORDERS, Layout, Newton, Running, SolveLayout, running, work_array
from lagrange.algorithm.step.newton_matrix import UNIT_ROUND_OFF, build_matrix
from lagrange.algorithm.step.vectors import StepVectors, copy_vector, plus, vectors_of
from lagrange.graph.node import Node
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, Writable, each, fma, larger, smaller, unrolled

MATRIX_AGE = 3
"""Least age at which the matrix of Newton's method may be rebuilt: this number of corrections in one step, or this
number of steps.
"""

ROUND_OFF_FRACTION = 2.0**-6
"""Largest error of an unknown after a fixed step, as a fraction of its rounding error. The error has the same sign at
every step and adds up: with a fraction of 1, the method galerkin6 drifts 15 times as much. This fraction costs up to a
quarter more evaluations, and a second correction of very short steps. Two corrections in a row at rounding level end
the iteration.
"""

TOLERANCE_FRACTION = 0.02
"""Error of Newton's method in steps with error control, as a fraction of the tolerance."""

SLOW_RATE = 0.25
"""Contraction rate of Newton's method above which the matrix is rebuilt."""

DIVERGENCE_RATE = 0.9
"""Contraction rate above which a step with error control is shortened."""

RATE_INCREASE, LARGEST_RATE = 1.2, 0.9
"""Factor per step, and upper bound, of the stored contraction rate of Newton's method after steps that do not measure
it. A step does not measure the rate if it converges at once.
"""

LEAST_RATE = 1e-4
"""Lower bound of the stored contraction rate: one good correction does not predict the next one."""

FRESH_RATE = 1e-3
"""Contraction rate above which the next step begins with a new matrix, with error control. Source: E. Hairer, G.
Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.8.
"""

FEW_CORRECTIONS = 2
"""Largest number of corrections of a fixed step after which the next step keeps the matrix of Newton's method. A matrix
younger than `MATRIX_AGE` steps is kept after more corrections, too.
"""

LARGEST_MATRIX_AGE = 64
"""Number of fixed steps after which the matrix is rebuilt, even if Newton's method converges. Otherwise a matrix that
has become singular would not be noticed.
"""

STAGNATION_NORM, STAGNATION_RATE = 2.0**10, 0.5
"""Bounds by which corrections of Newton's method count as round-off: `STAGNATION_NORM` for their norm, in units of the
estimated round-off, and `STAGNATION_RATE` for their contraction rate. With a new matrix, corrections are round-off if
their norm is below the first and their rate is at least the second.
"""

DIVERGENCE_GROWTH = 2.0
"""Growth from one correction to the next at which Newton's iteration with a new matrix ends as diverged. It applies to
corrections above the level of rounding. A further iteration might converge to another root.
"""

NOISE_DECAY = 0.9
"""Factor per step by which the stored size of corrections at rounding level decreases."""


@procedure
def assess_correction(
    newton: Newton,
    iteration: int,
    norm: float,
    previous: float,
    since: int,
    *,
    adaptive: bool,
    constrained: bool = False,
) -> Outcome:
    """Decide by the norms of corrections if Newton's method has converged. Return DONE, PAUSED or DIVERGED.

    PAUSED means that another correction is needed. `iteration` counts corrections from 0, and `since` the
    corrections with the current matrix. `norm` is the size of this correction, and `previous` the size of the last
    one. The first correction measures no contraction rate: the rate of the previous step is used. For a
    `constrained` step with error control (`adaptive`) `DIVERGENCE_RATE` is used instead: the rate then depends on
    how the constraints' gradients turn, and does not decrease with the step.
    """
    first = iteration == 0
    measured = norm / previous
    expected = DIVERGENCE_RATE if adaptive and constrained else newton.rate
    rate = expected if first else measured
    if is_small(newton, norm, math.inf if first else previous, rate, adaptive):
        aged = smaller(newton.rate * RATE_INCREASE, LARGEST_RATE)
        newton.rate = aged if first else larger(measured, LEAST_RATE)
        schedule_matrix(newton, iteration, measured, adaptive)
        return Outcome.DONE
    if not first and not rate <= SLOW_RATE:
        if adaptive:
            if not rate <= DIVERGENCE_RATE:
                return Outcome.DIVERGED
        else:
            old = since >= MATRIX_AGE
            fresh = since >= 1 and not old
            # With a new matrix, small corrections that do not decrease are rounding.
            if fresh and rate >= STAGNATION_RATE and norm < STAGNATION_NORM:
                newton.noise = 2.0 * norm
                return Outcome.DONE
            if fresh and rate >= DIVERGENCE_GROWTH and norm >= STAGNATION_NORM:
                return Outcome.DIVERGED
            if old:
                request_matrix(newton)
    return Outcome.PAUSED


@inline
def is_small(newton: Newton, norm: float, previous: float, rate: float, adaptive: bool) -> bool:
    """Return True if the error of Newton's iterate is small enough, or two corrections are at rounding level.

    The error is estimated from the sizes `norm` and `previous` of the last two corrections, and their
    contraction `rate`. With error control, `adaptive`, only the estimate counts.
    """
    bound = TOLERANCE_FRACTION if adaptive else newton.noise * ROUND_OFF_FRACTION
    small = norm * rate <= (1.0 - rate) * bound
    return small if adaptive else small or larger(norm, previous) <= newton.noise


@inline
def schedule_matrix(newton: Newton, iteration: int, rate: float, adaptive: bool) -> None:
    """Request a new matrix for the next step if the present one is outdated. Reduce the noise estimate slowly.

    Called after convergence. With error control (`adaptive`) a matrix is outdated if the contraction `rate` of
    the corrections is large. For fixed steps it is outdated by its age, sooner if the step took many
    corrections: `iteration` is their number minus 1.
    """
    newton.age += 1
    if adaptive:
        outdated = iteration > 0 and rate > FRESH_RATE
    else:
        aged = iteration >= FEW_CORRECTIONS and newton.age >= MATRIX_AGE
        outdated = aged or newton.age >= LARGEST_MATRIX_AGE
        newton.noise = larger(newton.noise * NOISE_DECAY, 1.0)
    if outdated:
        request_matrix(newton)


@inline
def request_matrix(newton: Newton) -> None:
    """Request that the matrix and the derivative of the law are computed again when they are needed next."""
    newton.matrix_step = 0.0
    newton.differentiated = 0


@inline
def predict(arguments: Running, t: float, h: float, layout: Layout, solve: SolveLayout) -> None:
    """Write the initial guess of the unknowns to the work array, from the unknowns of previous steps.

    With error control the guess is the formula of the method, or the previous unknowns if the method has no
    formula. For fixed steps backward differences are extrapolated. `solve` is the layout of the equations.
    """
    work, newton, predicted = arguments.work, arguments.newtons[solve.index], solve.solve.predicted
    unknowns, residual = work[solve.first :], work[solve.residual :]
    if not solve.adaptive:
        extrapolate(newton.order, differences_of(work, solve), unknowns, solve.all)
    else:
        vectors = vectors_of(arguments, t, h, layout, (), predicted, ratio=h / newton.old_step)
        # The predicted unknowns are combinations of the previous step's unknowns, which have the same numbers.
        copy_vector(work[solve.history :], unknowns, solve.all)
        for i, combination in enumerate(predicted):
            vectors.combine(combination, residual[i * solve.width :])
        if predicted:
            copy_vector(residual, unknowns, solve.all)


@inline
def differences_of(work: Out, solve: SolveLayout) -> tuple[Writable[float], ...]:
    """Return the arrays of backward differences of the unknowns, parts of `work`, by order.

    The first array has the unknowns of the previous step themselves, as differences of order 0.
    """
    return tuple([work[solve.history + k * solve.all :] for k in unrolled(HISTORY)])


@inline
def extrapolate(order: int, differences: tuple[Writable[float], ...], unknowns: Out, count: int) -> None:
    """Write the sum of the first `order` of the backward `differences` of each unknown to `unknowns`.

    There are `count` unknowns. The highest differences are added first.
    """
    for k in reversed(ORDERS):
        if order == k:
            for i in each(count, spill=True, disjoint=True):
                total = differences[k - 1][i]
                for difference in reversed(differences[: k - 1]):
                    total = total + difference[i]
                unknowns[i] = total


@procedure(work=work_array)
def keep_unknowns(newton: Newton, work: Out, *, layout: Layout, solve: SolveLayout) -> None:
    """Store the unknowns of an accepted step, from which the next step extrapolates its guess."""
    if newton.solved == 1:
        newton.solved = 0
        unknowns, weights = work[solve.first :], work[solve.weights :]
        if layout.step.control is not None:
            copy_vector(unknowns, work[solve.history :], solve.all)
            newton.known = 1
        else:
            differences = differences_of(work, solve)
            of_1, of_3, of_6, of_12 = 0.0, 0.0, 0.0, 0.0
            for i in each(solve.all, spill=True, disjoint=True):
                weight = weights[i]
                errors = update_differences(differences, unknowns[i], i)
                error_1, error_3, error_6, error_12 = [error * weight for error in errors]
                of_1 = fma(error_1, error_1, of_1)
                of_3 = fma(error_3, error_3, of_3)
                of_6 = fma(error_6, error_6, of_6)
                of_12 = fma(error_12, error_12, of_12)
            choose_order(newton, (of_1, of_3, of_6, of_12))
        newton.old_step = newton.tried_step


@inline
def update_differences(differences: tuple[Writable[float], ...], value: float, i: int) -> list[float]:
    """Update the backward differences of unknown i with its new `value`. Return errors of guesses.

    There is a guess for each of the `ORDERS`, by extrapolation from the previous steps. The error of a guess is its
    distance from `value`.
    """
    errors: list[float] = []
    for k, difference in enumerate(differences, 1):
        old = difference[i]
        difference[i] = value
        value = value - old
        errors = [*errors, value] if k in ORDERS else errors
    return errors


@inline
def choose_order(newton: Newton, errors: tuple[float, ...]) -> None:
    """Set the order of extrapolation for the next guess to the order with the least error.

    `errors` are the squared errors of the guesses of all `ORDERS` for this step. An order that has just become
    available is taken in any case.
    """
    known, following = newton.known, newton.known + 1
    best, least = ORDERS[0], errors[0]
    for k, error in zip(ORDERS[1:], errors[1:], strict=True):
        is_better = following >= k and (known < k or error < least)
        best, least = k if is_better else best, error if is_better else least
    newton.known = min(following, HISTORY)
    newton.order = best


MOST_CORRECTIONS = 50
"""Largest number of corrections of a fixed step; then Newton's method has not converged."""

MOST_CORRECTIONS_ADAPTIVE = 10
"""Largest number of corrections of a step with error control, which can be shortened instead."""

LARGEST_CORRECTION = 1e150
"""Largest norm of a correction, multiplied by the weights of the unknowns, that counts as finite."""

LARGE_CORRECTION = 0.25
"""Threshold of a correction, as a fraction of the unknowns, for the case that the law is not finite after it. After a
larger correction Newton's method has diverged. After a smaller one the motion itself has left the domain of the law.
"""

LARGEST_DISTANCE = 8.0
"""Largest sum of the corrections of a fixed step, as a multiple of the first size estimate. The estimate is the size
of the terms of the residuals, multiplied by the inverse matrix. Newton's first correction is at most that large, and
corrections that converge decrease. A larger sum leads to another root, or to none.
"""

UNROLLED_PRODUCT = 64
"""Largest number of blocks for which the product of a matrix and a vector is written out."""


@procedure(arguments=running)
def solve_unknowns(arguments: Running, t: float, h: float, *, layout: Layout, solve: SolveLayout) -> Outcome:
    """Solve the equations of a step of length h from time t for its unknowns. Return DONE or a failure.

    The unknowns are predicted and corrected by Newton's method, in the work array of `arguments`. If that
    fails, corrections begin again from the guess that the method states, with a new matrix. Failures are
    SINGULAR, NON_FINITE and DIVERGED. `solve` has the equations and the places of their data.
    """
    newton = arguments.newtons[solve.index]
    newton.tried_step = h
    if solve.adaptive:
        weigh_by_tolerance(arguments, t, h, layout, solve)
    is_fresh = newton.known == 0
    if not is_fresh:
        predict(arguments, t, h, layout, solve)
        is_fresh = iterate(arguments, t, h, layout=layout, solve=solve) != Outcome.DONE
    if is_fresh:
        request_matrix(newton)
        newton.rate = 1.0
        newton.known = 0
        outcome = guess(arguments, t, h, layout=layout, solve=solve)
        if outcome == Outcome.DONE:
            outcome = iterate(arguments, t, h, layout=layout, solve=solve)
        if outcome != Outcome.DONE:
            return outcome
    newton.solved = 1
    return Outcome.DONE


@procedure(noinline=True, arguments=running)
def guess(arguments: Running, t: float, h: float, *, layout: Layout, solve: SolveLayout) -> Outcome:
    """Set the unknowns to the guesses that the method states. Return DONE, or SINGULAR if a matrix is singular."""
    stated = solve.solve
    vectors = vectors_of(arguments, t, h, layout, stated.preparation, stated.guesses)
    is_singular = vectors.evaluate_all(stated.preparation)
    for i, combination in enumerate(stated.guesses):
        vectors.combine(combination, vectors.at(stated.first + i))
    return Outcome.SINGULAR if is_singular else Outcome.DONE


@inline
def weigh_by_tolerance(arguments: Running, t: float, h: float, layout: Layout, solve: SolveLayout) -> None:
    """Write the weight of each unknown: its largest effect on an entry of a state, divided by the entry's tolerance.

    The norm of a correction multiplies its entries by the weights. The states are those at which the step evaluates
    the law, such as the right-hand side. The tolerance of an entry is relative to its size. This size counts as at
    least the slope times the step length, for entries that begin at zero. A multiplier has no tolerance: its own
    weight is 0, and its effect on the velocities counts.
    """
    step, stated, rtol = layout.step, solve.solve, arguments.run.rtol
    reached = [[stated.reach(i, state) for state in unrolled(step.states)] for i in unrolled(stated.count)]
    nodes = [node for effects in reached for factors in effects for node in factors]
    vectors = vectors_of(arguments, t, h, layout, nodes=nodes)
    slope = vectors.at(step.calls[0].first) if step.starts_with_slope else None
    for i, effects in enumerate(reached):
        effects_on_states = [largest_size(vectors, factors) for factors in effects]
        weights = arguments.work[solve.weights + i * solve.width :]
        for k in each(solve.width, spill=True, disjoint=True):
            weight = 0.0
            for state, effect in enumerate(effects_on_states):
                size = abs(vectors.at(state)[k])
                if slope is not None:
                    size = larger(size, abs(h * slope[k]))
                share = effect / fma(rtol, size, arguments.floors[state * solve.length :][k])
                weight = larger(weight, share) if state else share
            weights[k] = weight


@inline
def largest_size(vectors: StepVectors, factors: list[Node]) -> float:
    """Return the largest magnitude of the coefficients with the nodes `factors` in the present step."""
    largest = 0.0
    for factor in factors:
        largest = larger(largest, abs(vectors.numbers[factor]))
    return largest


@procedure(noinline=True, arguments=running)
def iterate(arguments: Running, t: float, h: float, *, layout: Layout, solve: SolveLayout) -> Outcome:
    """Correct the unknowns until the estimated error is negligible. Return DONE or a failure.

    Failures are SINGULAR for a singular matrix, NON_FINITE if the law has no finite value, and DIVERGED.
    """
    stated, work, newton = solve.solve, arguments.work, arguments.newtons[solve.index]
    vectors = vectors_of(arguments, t, h, layout, stated.calls, stated.residuals)
    unit = arguments.run.rtol if solve.adaptive else UNIT_ROUND_OFF
    previous, moved, since = 0.0, 0.0, MATRIX_AGE
    for iteration in range(MOST_CORRECTIONS_ADAPTIVE if solve.adaptive else MOST_CORRECTIONS):
        if vectors.evaluate_all(stated.calls):
            return Outcome.SINGULAR
        for i, residual in enumerate(stated.residuals):
            vectors.combine(residual, work[solve.residual + i * solve.width :])
        if newton.matrix_step != h:
            outcome = build_matrix(arguments, t, h, layout=layout, solve=solve)
            if outcome != Outcome.DONE:
                return outcome
            since = 0
        norm = correct(work, solve)
        arguments.effort.residual = norm * unit
        if not norm < LARGEST_CORRECTION:
            # The law has no finite value at the unknowns, unless a large correction has led out of its domain.
            return Outcome.NON_FINITE if previous * unit < LARGE_CORRECTION else Outcome.DIVERGED
        if not solve.adaptive:
            moved = fma(norm, unit, moved)
            if moved > LARGEST_DISTANCE:
                return Outcome.DIVERGED
        constrained = layout.step.law == "constrained"
        assessment = assess_correction(
            newton, iteration, norm, previous, since, adaptive=solve.adaptive, constrained=constrained
        )
        if assessment != Outcome.PAUSED:
            return assessment
        previous = norm
        since += 1
    return Outcome.DIVERGED


@inline
def correct(work: Out, solve: SolveLayout) -> float:
    """Add Newton's correction to the unknowns in the work array. Return its weighted root mean square.

    The correction is the product of the stored inverse matrix and the residuals, which are in `work`.
    """
    unknowns, weights, squares = work[solve.first :], work[solve.weights :], 0.0
    product = product_of(work[solve.inverse :], work[solve.residual :], solve, solve.solve.count)
    for i in each(solve.all, spill=True, unrolled=product.is_short, disjoint=True):
        correction = product.entry(i)
        unknowns[i] = unknowns[i] + correction
        weighted = correction * weights[i]
        squares = fma(weighted, weighted, squares)
    return math.sqrt(squares * (1.0 / solve.unknowns))


@inline
def product_of(matrix: In, residual: In, solve: SolveLayout, count: int) -> MatrixProduct:
    """Return the product of a `matrix` and residuals. Entries of a `MatrixProduct` are computed on request.

    The matrix is stored by columns. `residual` has the vectors of residuals, of which the first `count` are
    used. A short product is written out, with the residuals in registers.
    """
    length, width, block = solve.length, solve.width, solve.block
    is_short = count * length * (count * width // block if block > 1 else 1) <= UNROLLED_PRODUCT
    indices = [(i, a) for i in unrolled(count) for a in unrolled(length)] if is_short else []
    terms = [(matrix[(i * length + a) * count * width :], residual[i * width + a]) for i, a in indices]
    return MatrixProduct(matrix, residual, solve, count, terms)


@dataclass(frozen=True)
class MatrixProduct:
    """A product of a matrix and a vector. Each entry is the sum over even columns plus the sum over odd columns."""

    matrix: In
    residual: In
    solve: SolveLayout
    count: int
    terms: Sequence[tuple[In, float]]
    """The columns of a short product, each with the entry that it is multiplied by; empty for a long product."""

    @property
    def is_short(self) -> bool:
        """True if the product of matrix and vector is written out, without a loop."""
        return bool(self.terms)

    @inline
    def entry(self, row: int) -> float:
        """Return entry `row` of the product of matrix and vector."""
        return self.short_sum(row) if self.terms else self.long_sum(row)

    @inline
    def short_sum(self, row: int) -> float:
        """Return entry `row` of a product of matrix and vector that is written out."""
        even: Any = None
        odd: Any = None
        for column, entry in self.terms[::2]:
            even = plus(even, column[row], entry)
        for column, entry in self.terms[1::2]:
            odd = plus(odd, column[row], entry)
        return plus(even, None, odd) if self.terms[1:] else even

    @inline
    def long_sum(self, row: int) -> float:
        """Return entry `row` of a product of matrix and vector, computed in loops."""
        length, width, residual = self.solve.length, self.solve.width, self.residual
        stride = self.count * width
        first, second = 0.0, 0.0
        for i in range(self.count):
            column, part = self.matrix[i * length * stride :], residual[i * width :]
            for a in range(0, length - 1, 2):
                first = fma(column[a * stride :][row], part[a], first)
                second = fma(column[(a + 1) * stride :][row], part[a + 1], second)
            if length % 2:
                first = fma(column[(length - 1) * stride :][row], part[length - 1], first)
        return first + second
