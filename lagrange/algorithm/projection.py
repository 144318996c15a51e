"""Projection of the state onto its constraints at the end of a step, and compensated addition.

The corrections come from `lagrange.program.catalogue`: a Newton step whose remainder is proportional to the square of
the violation. The corrections are normal to the constraints in the metric of the mass matrix, so that the energy
changes in second order only.

Source of compensated addition: D. E. Knuth, The Art of Computer Programming, vol. 2, 3rd ed., 1997, 4.2.2, theorem B.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lagrange.algorithm.constants import Outcome, whole_blocks
from lagrange.procedure.form import FLAG, REAL, Array, Callee
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, likely, reals, unlikely


@inline
def compensated(y: Any, move: Any) -> tuple[Any, Any]:
    """Return the rounded sum of two reals, and its exact rounding error: (total, lost) with y + move = total + lost."""
    total = y + move
    back = total - y
    return total, (y - (total - back)) + (move - back)


CORRECTIONS = Callee((REAL, Array(read=True), Array(read=True), Array()), (FLAG,))
"""Type of the program of the corrections: from a time, a state [q, v] and prepared parameters to [dq, dv], the relative
violation, and the violation that would remain. With relations among velocities a third number follows: the violation of
the other constraints. The flag is true for a singular matrix.
"""

KEPT_VIOLATION = 2.0**-51
"""Largest relative violation at which a state is unchanged: evaluating the constraints has the same rounding error."""

RESOLVED = 2.0**-26
"""Largest relative violation at which a step is accepted if the corrections cannot reduce it. Near a configuration with
dependent constraints, the gradients do not determine a nearby solution. Corrections would move the state by more than
its distance from that configuration. A double root is determined to half of the digits.
"""

MOST_AT_START = 2.0**-20
"""Largest relative violation of the initial state of an exported integrator, which projects the state onto the
constraints. A larger violation is refused: the projected state would be a different initial state.
"""

PROJECTION_CORRECTIONS = 8
"""Largest number of corrections of a state. Newton's method needs 2 or 3 for the largest violations that a step leaves,
and otherwise does not converge.
"""

MOST_WRITTEN_BEYOND = 8
"""Number of doubles that a program may write after its results, since machines write in blocks."""


def state_array(block: int) -> Array:
    """Return the type of an array that has a state of any size and is accessed in blocks of `block` numbers.

    Memory after the state must stay unchanged.
    """
    return Array(room=block)


@procedure(noinline=True, corrections=lambda: CORRECTIONS, state=state_array, lost=state_array)
def project(
    corrections: Callable[..., Any], numbers: In, t: float, state: Out, lost: Out, *, dimension: int, block: int
) -> tuple[Outcome, bool]:
    """Move a state [q, v] at time t onto its constraints. Return an outcome, and True if the state has moved.

    The outcome is UNPROJECTED if the constraints are still violated, else DONE. The callback `corrections`
    computes [dq, dv], the relative violation, and the violation that would remain; `numbers` are its
    parameters, followed by the values that depend only on them. With a singular matrix the outcome is DONE,
    because the next step reports the matrix. `lost` is the rounding error of each entry of the state; it is
    updated, because corrections are added with compensation. Memory is accessed in blocks of `block` numbers.
    """
    move = reals(whole_blocks(dimension + 2, block) + MOST_WRITTEN_BEYOND, room=block)
    has_moved = False
    for _ in range(PROJECTION_CORRECTIONS):
        # With a singular matrix the state is unchanged: the next evaluation meets the same matrix, and reports it.
        if unlikely(corrections(t, state, numbers, move)):
            return Outcome.DONE, has_moved
        violation, left = move[dimension], move[dimension + 1]
        if violation <= KEPT_VIOLATION:
            return Outcome.DONE, has_moved
        if unlikely(not left <= 0.5 * violation):
            return Outcome.DONE if violation <= RESOLVED else Outcome.UNPROJECTED, has_moved
        has_moved = True
        for i in each(dimension):
            state[i], lost[i] = compensated(state[i], move[i] + lost[i])
        if likely(left <= KEPT_VIOLATION):
            return Outcome.DONE, has_moved
    return Outcome.UNPROJECTED, has_moved


@procedure(noinline=True, corrections=lambda: CORRECTIONS, state=lambda: state_array(1))
def starts_on_constraints(
    corrections: Callable[..., Any], numbers: In, t: float, state: Out, *, dimension: int, relations: bool
) -> bool:
    """Return True if a state [q, v] at time t violates its constraints by at most `MOST_AT_START`.

    With `relations` some velocities follow from the constraints, and only the violation of the other constraints
    is limited. The state is then moved onto all constraints; the result is False if that fails. The callback
    `corrections` computes the correction of a state and its violation; `numbers` are its parameters, followed by
    the values that depend only on them. With a singular matrix the result is True, because the first step
    reports the matrix.
    """
    move = reals(dimension + 3 + MOST_WRITTEN_BEYOND)
    # A matrix that is singular here is singular in the first step, which reports it.
    if corrections(t, state, numbers, move):
        return True
    if not relations:
        return move[dimension] <= MOST_AT_START
    if not move[dimension + 2] <= MOST_AT_START:
        return False
    lost = reals(dimension)
    lost[:dimension] = 0.0
    outcome, _ = project(corrections, numbers, t, state, lost, dimension=dimension, block=1)
    return outcome == Outcome.DONE
