"""Newton's method for the unknowns of a step.

The unknowns are predicted from previous steps and corrected with a matrix that is kept from step to step, until the
corrections are round-off (equal steps) or far below the tolerance (error control). The matrix is rebuilt when the
corrections shrink slowly.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import reduce

from lagrange.algorithm.newton.constants import (
    LARGE_CORRECTION,
    LARGEST_CORRECTION,
    LARGEST_DISTANCE,
    MATRIX_AGE,
    MOST_CORRECTIONS,
    MOST_CORRECTIONS_ADAPTIVE,
    UNIT_ROUND_OFF,
)
from lagrange.algorithm.newton.convergence import assess_correction
from lagrange.algorithm.newton.matrix import build_matrix
from lagrange.algorithm.newton.prediction import predict
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.memory import Layout, SolveLayout
from lagrange.algorithm.step.vectors import Given, Vectors
from lagrange.graph.node import Node
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.values import Memory, Real, Variable, Whole

UNROLLED_PRODUCT = 64
"""Most blocks for which the product of a matrix and a vector is written out."""


def solve_unknowns(layout: Layout, solve: SolveLayout, prefix: str) -> Procedure:
    """Return the solve: predict and iterate; if that fails, restart from the guess with a new matrix."""
    p = Builder(f"{prefix}solve{solve.index}", "Find the unknowns of a solve, and return an outcome.")
    given = Given(p, layout, solve)
    newton = given.newton
    again, begin = _iterate(layout, solve, prefix), _start(layout, solve, prefix)
    newton.tried_step = given.h
    if solve.adaptive:
        _weigh_by_tolerance(given, solve)
    fresh = p.variable(newton.known.equals(0), "fresh")
    with p.when(~fresh.value):
        predict(given, solve)
        fresh.value = ~p.call(again, *given.handed()).equals(Outcome.DONE)
    with p.when(fresh.value):
        newton.differentiated = 0
        newton.matrix_step = 0.0
        newton.rate = 1.0
        newton.known = 0
        given.leave_unless_done(p.call(begin, *given.handed()))
        given.leave_unless_done(p.call(again, *given.handed()))
    newton.solved = 1
    p.leave(Outcome.DONE)
    return p.finish(WHOLE)


def _start(layout: Layout, solve: SolveLayout, prefix: str) -> Procedure:
    """Return the procedure that sets the unknowns to their guesses."""
    p = Builder(f"{prefix}start{solve.index}", "Set the unknowns to their guesses, and return an outcome.", apart=True)
    given, stated = Given(p, layout, solve), solve.solve
    arguments = [argument for call in stated.preparation for argument in call.arguments]
    vectors = Vectors(given, [*arguments, *stated.guesses], [call.time for call in stated.preparation])
    singular = p.variable(p.false, "singular")
    for call in stated.preparation:
        vectors.evaluate(call, singular)
    if stated.preparation:
        given.effort.evaluations = given.effort.evaluations + len(stated.preparation)
    for i, guess in enumerate(stated.guesses):
        vectors.combine(guess, vectors.at(stated.first + i))
    p.leave_if(singular.value, Outcome.SINGULAR)
    p.leave(Outcome.DONE)
    return p.finish(WHOLE)


def _weigh_by_tolerance(given: Given, solve: SolveLayout) -> None:
    """Set the weights of corrections: their largest effect on a state in the arguments of calls, in units of tolerance.

    The size of an entry that begins at zero is that of its slope times the step. A multiplier has no tolerance: its
    weight is 0, and what it does to the velocities counts.
    """
    p, states = given.p, range(given.layout.step.states)
    reached = [[solve.solve.reach(i, state) for state in states] for i in range(solve.solve.count)]
    vectors = Vectors(given, [], [factor for found in reached for factors in found for factor in factors])
    step = vectors.layout.step
    slope = vectors.at(step.calls[0].first) if step.starts_with_slope else None
    for i, found in enumerate(reached):
        largest = [_largest(vectors, factors) for factors in found]
        weights = given.work.at(solve.weights + i * solve.width)
        with p.each(solve.width, spill=True) as k:
            weight = p.constant(0.0, REAL)
            for state, effect in enumerate(largest):
                size = abs(vectors.at(state)[k])
                if slope is not None:
                    size = p.larger(size, abs(given.h * slope[k]))
                share = effect / p.fma(given.rtol, size, given.floors.at(state * solve.length)[k])
                weight = p.larger(weight, share) if state else share
            weights[k] = weight


def _largest(vectors: Vectors, factors: list[Node]) -> Real:
    """Return the largest absolute value of some numbers of a step."""
    p = vectors.p
    return reduce(lambda largest, factor: p.larger(largest, abs(vectors.numbers[factor])), factors, p.real(0.0))


def _iterate(layout: Layout, solve: SolveLayout, prefix: str) -> Procedure:
    """Return the iteration: correct the unknowns until the estimated error is negligible."""
    about = "Correct the unknowns until what is left is small; return an outcome."
    p = Builder(f"{prefix}iterate{solve.index}", about, apart=True)
    given, stated = Given(p, layout, solve), solve.solve
    newton, effort = given.newton, given.effort
    arguments = [argument for call in stated.calls for argument in call.arguments]
    vectors = Vectors(given, [*arguments, *stated.residuals], [call.time for call in stated.calls])
    constrained = layout.step.law == "constrained"
    unit = given.rtol if solve.adaptive else p.constant(UNIT_ROUND_OFF, REAL)
    previous, moved = p.variable(0.0, "previous"), p.variable(0.0, "moved")
    since = p.variable(MATRIX_AGE, "since")
    with p.loop(0, MOST_CORRECTIONS_ADAPTIVE if solve.adaptive else MOST_CORRECTIONS) as iteration:
        singular = p.variable(p.false, "singular")
        for call in stated.calls:
            vectors.evaluate(call, singular)
        effort.evaluations = effort.evaluations + len(stated.calls)
        p.leave_if(singular.value, Outcome.SINGULAR)
        for i, residual in enumerate(stated.residuals):
            vectors.combine(residual, given.work.at(solve.residual + i * solve.width))
        with p.when(~newton.matrix_step.equals(given.h)):
            given.leave_unless_done(p.call(build_matrix(layout, solve, prefix), *given.handed()))
            since.value = 0
        norm = _correct(given, solve).called("norm")
        effort.residual = norm * unit
        with p.when(~(norm < LARGEST_CORRECTION)):
            p.note("The law is not finite there, unless a large correction has led out of its domain.")
            p.leave_if(previous.value * unit < LARGE_CORRECTION, Outcome.NON_FINITE)
            p.leave(Outcome.DIVERGED)
        if not solve.adaptive:
            moved.value = p.fma(norm, unit, moved.value)
            p.leave_if(moved.value > LARGEST_DISTANCE, Outcome.DIVERGED)
        assessment = p.call(
            assess_correction.form(adaptive=solve.adaptive, constrained=constrained),
            newton,
            iteration,
            norm,
            previous.value,
            since.value,
        )
        p.leave_if(~assessment.equals(Outcome.PAUSED), assessment)
        previous.value = norm
        since.value = since.value + 1
    p.leave(Outcome.DIVERGED)
    return p.finish(WHOLE)


def _correct(given: Given, solve: SolveLayout) -> Real:
    """Add the correction to the unknowns and return its weighted root mean square."""
    p, work = given.p, given.work
    unknowns, weights = work.at(solve.first), work.at(solve.weights)
    with product(given, solve, work.at(solve.inverse), solve.solve.count) as (i, correction):
        unknowns[i] = unknowns[i] + correction
        weighted = correction * weights[i]
        squares = p.dot(weighted, weighted)
    found: Real = p.sqrt(squares.value * (1.0 / solve.unknowns))
    return found


@contextmanager
def product(given: Given, solve: SolveLayout, matrix: Memory, vectors: int) -> Iterator[tuple[Whole, Real]]:
    """Yield a place and the entry there of the product of a matrix, by columns, with the first residuals."""
    p, residual = given.p, given.work.at(solve.residual)
    width, length = vectors * solve.width, solve.length
    block = given.layout.block
    if vectors * length * (width // block if block > 1 else 1) <= UNROLLED_PRODUCT:
        entries = [residual[i * solve.width + a] for i in range(vectors) for a in range(length)]
        columns = [matrix.at(j * width) for j in range(len(entries))]
        with p.each(width, spill=True, unrolled=True) as row:
            sums: list[Real] = []
            for j, entry in enumerate(entries):
                part = columns[j][row]
                if j < 2:
                    sums.append(part * entry)
                else:
                    sums[j % 2] = p.fma(part, entry, sums[j % 2])
            yield row, sums[0] + sums[1] if len(sums) > 1 else sums[0]
        return
    with p.each(width, spill=True) as row:
        first, second = p.variable(0.0, "first"), p.variable(0.0, "second")

        def add(total: Variable, i: Whole, a: Whole) -> None:
            column = matrix.at((i * length + a) * width)
            total.value = p.fma(column[row], residual[i * solve.width + a], total.value)

        with p.loop(0, vectors) as i:
            with p.loop(0, length - 1, 2) as a:
                add(first, i, a)
                add(second, i, p.whole(a + 1))
            if length % 2:
                add(first, i, p.whole(length - 1))
        yield row, first.value + second.value
