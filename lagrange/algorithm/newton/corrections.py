"""Newton's method for the unknowns of a step.

The unknowns are predicted from previous steps and corrected with a matrix that is kept from step to step, until the
corrections are round-off (equal steps) or far below the tolerance (error control). The matrix is rebuilt when the
corrections shrink slowly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.newton.convergence import MATRIX_AGE, assess_correction, request_matrix
from lagrange.algorithm.newton.matrix import UNIT_ROUND_OFF, build_matrix
from lagrange.algorithm.newton.prediction import predict
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.memory import Layout, SolveLayout
from lagrange.algorithm.step.run import Running, running
from lagrange.algorithm.step.vectors import StepVectors, plus, vectors_of
from lagrange.graph.node import Node
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, larger, unrolled

MOST_CORRECTIONS = 50
"""Largest number of corrections of an equal step; then Newton's method has not converged."""

MOST_CORRECTIONS_ADAPTIVE = 10
"""Largest number of corrections of a step with error control, which can be shortened instead."""

LARGEST_CORRECTION = 1e150
"""A weighted correction above this counts as not finite."""

LARGE_CORRECTION = 0.25
"""If the law is not finite after a correction of more than this fraction of the unknowns, the step has diverged. After
a smaller correction the motion itself has left the domain of the law.
"""

LARGEST_DISTANCE = 8.0
"""Largest sum of the corrections of an equal step, as a multiple of the first size estimate. The estimate is the size
of the terms of the residuals, multiplied by the inverse. Newton's first correction is at most that large, and
corrections that converge decrease. A larger sum leads to another root, or to none.
"""

UNROLLED_PRODUCT = 64
"""Largest number of blocks for which the product of a matrix and a vector is written out."""


@procedure(arguments=running)
def solve_unknowns(arguments: Running, t: float, h: float, *, layout: Layout, solve: SolveLayout) -> Outcome:
    """Solve the equations of a step of length h from time t for its unknowns, and return an outcome.

    The unknowns are predicted and corrected by Newton's method, in the work array of `arguments`. If that fails,
    corrections begin again from the guess of the method, with a new matrix. `solve` has the equations and the
    places of their data.
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


@procedure(apart=True, arguments=running)
def guess(arguments: Running, t: float, h: float, *, layout: Layout, solve: SolveLayout) -> Outcome:
    """Set the unknowns to the guesses of the method. Return DONE, or SINGULAR for a singular matrix."""
    stated = solve.solve
    vectors = vectors_of(arguments, t, h, layout, stated.preparation, stated.guesses)
    is_singular = vectors.evaluate_all(stated.preparation)
    for i, combination in enumerate(stated.guesses):
        vectors.combine(combination, vectors.at(stated.first + i))
    return Outcome.SINGULAR if is_singular else Outcome.DONE


@inline
def weigh_by_tolerance(arguments: Running, t: float, h: float, layout: Layout, solve: SolveLayout) -> None:
    """Set the weight of each unknown: its largest effect on a state at which the law is called, in tolerances.

    The size of an entry of the state is at least its slope times the step, for entries that begin at zero. A
    multiplier has no tolerance: its weight is 0, and its effect on the velocities counts.
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
    """Return the largest absolute value of the coefficients `factors` in the present step."""
    largest = 0.0
    for factor in factors:
        largest = larger(largest, abs(vectors.numbers[factor]))
    return largest


@procedure(apart=True, arguments=running)
def iterate(arguments: Running, t: float, h: float, *, layout: Layout, solve: SolveLayout) -> Outcome:
    """Correct the unknowns until the estimated error is negligible; return an outcome."""
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
            # The law has no finite value there, unless a large correction has led out of its domain.
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

    The correction is the product of the stored inverse matrix and the residuals.
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
    """Return the product of a matrix, stored by columns, with the first `count` residuals of a solve.

    A short product is written out, with the residuals in registers.
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
        """True if the product is written out."""
        return bool(self.terms)

    @inline
    def entry(self, row: int) -> float:
        """Return entry `row` of the product."""
        return self.short_sum(row) if self.terms else self.long_sum(row)

    @inline
    def short_sum(self, row: int) -> float:
        """Return entry `row` of a product that is written out."""
        even: Any = None
        odd: Any = None
        for column, entry in self.terms[::2]:
            even = plus(even, column[row], entry)
        for column, entry in self.terms[1::2]:
            odd = plus(odd, column[row], entry)
        return plus(even, None, odd) if self.terms[1:] else even

    @inline
    def long_sum(self, row: int) -> float:
        """Return entry `row` of a product that is not written out."""
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
