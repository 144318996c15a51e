"""What a solve keeps of previous steps, and the initial guess that it computes from them.

For equal steps these are backward differences of the unknowns. The polynomial through k values is extrapolated by the
sum of the differences; the k-th difference at the next step is the error of that guess, which selects the best k.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

from lagrange.algorithm.newton.constants import HISTORY, ORDERS
from lagrange.algorithm.step.memory import NEWTON, Layout, SolveLayout
from lagrange.algorithm.step.vectors import Given, Vectors
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import Procedure
from lagrange.procedure.values import Memory, Real


def predict(given: Given, solve: SolveLayout) -> None:
    """Write the initial guess of the unknowns: as the method states, or by extrapolation."""
    p, work = given.p, given.work
    unknowns = work.at(solve.first)
    if not solve.adaptive:
        _extrapolate(given, solve, unknowns)
        return
    vectors = Vectors(given, solve.solve.predicted, ratio=given.h / given.newton.old_step)
    p.copy(work.at(solve.history), unknowns, solve.all)
    if solve.solve.predicted:
        residual = work.at(solve.residual)
        for i, combination in enumerate(solve.solve.predicted):
            vectors.combine(combination, residual.at(i * solve.width))
        p.copy(residual, unknowns, solve.all)
    p.note("The unknowns of the step before stood where those of this one are put.")


def _extrapolate(given: Given, solve: SolveLayout, unknowns: Memory) -> None:
    """Write the sum of the selected number of differences, the smallest first."""
    p, order = given.p, given.newton.order
    differences = [given.work.at(solve.history + i * solve.all) for i in range(HISTORY)]
    for k in reversed(ORDERS):
        with p.when(order.equals(k)), p.each(solve.all, spill=True) as i:
            values: list[Any] = [one[i] for one in reversed(differences[:k])]
            unknowns[i] = reduce(lambda total, larger: larger + total, values)


def keep(layout: Layout, solve: SolveLayout) -> Procedure:
    """Return the update of the stored unknowns when a step is accepted."""
    p = Builder(f"keep{solve.index}", "Keep the unknowns of an accepted step, to extrapolate from.")
    newton: Any = p.record("newton", NEWTON)
    work = p.array("work", size=layout.size, room=layout.block)
    with p.when(newton.solved.equals(1)):
        newton.solved = 0
        if solve.adaptive:
            unknowns, history = work.at(solve.first), work.at(solve.history)
            p.copy(unknowns, history, solve.all)
            newton.known = 1
        else:
            _choose_order(p, newton, _difference(p, solve, work))
        newton.old_step = newton.tried_step
    return p.finish()


def _difference(p: Builder, solve: SolveLayout, work: Memory) -> dict[int, Real]:
    """Write the differences with the new unknowns; return the weighted squares of those that are errors of a guess."""
    unknowns, weights = work.at(solve.first), work.at(solve.weights)
    differences = [work.at(solve.history + i * solve.all) for i in range(HISTORY)]
    squares = {}
    with p.each(solve.all, spill=True) as i:
        weight, value = weights[i], unknowns[i]
        for k, difference in enumerate(differences, 1):
            old = difference[i]
            difference[i] = value
            value = value - old
            if k in ORDERS:
                weighted = value * weight
                squares[k] = p.dot(weighted, weighted)
    return {k: found.value for k, found in squares.items()}


def _choose_order(p: Builder, newton: Any, errors: dict[int, Real]) -> None:
    """Set the order of the next guess: that of the least error, or one more if it has just become available."""
    known = newton.known
    following = known + 1
    best, least = p.whole(ORDERS[0]), errors[ORDERS[0]]
    for k in ORDERS[1:]:
        taken = (following >= k) & ((known < k) | (errors[k] < least))
        best = p.choose(taken, k, best)
        least = p.choose(taken, errors[k], least)
    newton.known = p.smaller(following, HISTORY)
    newton.order = best
