"""Initial guesses of Newton's method, from the unknowns of previous steps.

For equal steps backward differences of the unknowns are stored. The sum of the first k differences extrapolates the
polynomial through k values. The k-th difference at the next step is the error of that guess, and selects the best k.
"""

from __future__ import annotations

from lagrange.algorithm.step.memory import HISTORY, ORDERS, Layout, Newton, SolveLayout, work_array
from lagrange.algorithm.step.run import Running
from lagrange.algorithm.step.vectors import copy_vector, vectors_of
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import Out, Writable, each, fma, unrolled


@inline
def predict(arguments: Running, t: float, h: float, layout: Layout, solve: SolveLayout) -> None:
    """Write the initial guess of the unknowns: by the formula of the method if it has one, else by extrapolation."""
    work, newton, predicted = arguments.work, arguments.newtons[solve.index], solve.solve.predicted
    unknowns, residual = work[solve.first :], work[solve.residual :]
    if not solve.adaptive:
        extrapolate(newton.order, differences_of(work, solve), unknowns, solve.all)
    else:
        vectors = vectors_of(arguments, t, h, layout, (), predicted, ratio=h / newton.old_step)
        # The predicted unknowns are combinations of those of the previous step, which have the same numbers.
        copy_vector(work[solve.history :], unknowns, solve.all)
        for i, combination in enumerate(predicted):
            vectors.combine(combination, residual[i * solve.width :])
        if predicted:
            copy_vector(residual, unknowns, solve.all)


@inline
def differences_of(work: Out, solve: SolveLayout) -> tuple[Writable[float], ...]:
    """Return the arrays of backward differences of the unknowns; the first one has the unknowns themselves."""
    return tuple([work[solve.history + k * solve.all :] for k in unrolled(HISTORY)])


@inline
def extrapolate(order: int, differences: tuple[Writable[float], ...], unknowns: Out, count: int) -> None:
    """Write the sum of the first `order` backward differences to the unknowns, added from the highest rank on."""
    for k in reversed(ORDERS):
        if order == k:
            for i in each(count, spill=True, disjoint=True):
                total = differences[k - 1][i]
                for difference in reversed(differences[: k - 1]):
                    total = total + difference[i]
                unknowns[i] = total


@procedure(work=work_array)
def keep_unknowns(newton: Newton, work: Out, *, layout: Layout, solve: SolveLayout) -> None:
    """Store the unknowns of an accepted step for the extrapolation."""
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
    """Write the backward differences for a new `value` of unknown i. Return the errors of all its guesses.

    There is a guess for each of the `ORDERS`, by extrapolation.
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
    """Set the order of the next guess to that with the least error; `errors` are those of all `ORDERS`.

    An order that has just become available is taken in any case.
    """
    known, following = newton.known, newton.known + 1
    best, least = ORDERS[0], errors[0]
    for k, error in zip(ORDERS[1:], errors[1:], strict=True):
        is_better = following >= k and (known < k or error < least)
        best, least = k if is_better else best, error if is_better else least
    newton.known = min(following, HISTORY)
    newton.order = best
