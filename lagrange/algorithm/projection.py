"""The projection of the state onto its constraints at the end of an accepted step.

The corrections are those of `lagrange.program.constraints`, a Newton step whose remainder is the square of the
violation. They are normal to the constraints in the metric of the mass matrix, so that the energy of the motion changes
in second order only.
"""

from __future__ import annotations

from lagrange.algorithm.blocks import whole_blocks
from lagrange.algorithm.compensated import compensated
from lagrange.algorithm.outcome import Outcome
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Callee, Procedure
from lagrange.procedure.shared import shared

CORRECTIONS = Callee((REAL, Array(read=True), Array(read=True), Array()), (FLAG,))
"""The program of the corrections: from a time, a state [q, v] and prepared parameters to [dq, dv], the relative
violation, and the violation that would remain. The flag is true for a singular matrix."""

ROUND_OFF = 2.0**-51
"""Largest relative violation at which a state is kept: evaluating the constraints has the same rounding error."""

RESOLVED = 2.0**-26
"""Largest relative violation at which a step is accepted if the corrections cannot reduce it.

Near a configuration with dependent constraints, the gradients do not determine where the constraints hold. Corrections
would move the state by more than its distance from there. A double root is determined to half of the digits.
"""

MOST_AT_START = 2.0**-20
"""Largest relative violation of the initial state of an exported integrator, which moves it onto the constraints.

A state that is further off would become another motion.
"""

MOST_CORRECTIONS = 8
"""Largest number of corrections. Newton's method needs 2 or 3 for the largest violations that a step leaves; more means
that it does not converge."""

MOST_WRITTEN_BEYOND = 8
"""Doubles that a program may write after its results, since machines write in blocks."""


@shared
def project(dimension: int, block: int) -> Procedure:
    """Return the procedure that projects a state and its compensation `lost`, and changes both.

    Its results are an outcome, and whether the state has moved. The correction is added to the compensated state, so
    that its rounding error is compensated as well.
    """
    p = Builder("project", "Move a state onto its constraints; return an outcome, and if it moved.", apart=True)
    corrections, numbers = p.function("corrections", CORRECTIONS), p.array("numbers", read=True)
    t = p.given("t", REAL)
    # Arrays without a size: entries after those of the state must stay unchanged.
    state, lost = (p.array(name, room=block) for name in ("state", "lost"))
    size = whole_blocks(dimension + 2, block) + MOST_WRITTEN_BEYOND
    found = p.reserve(size, room=block, name="found")
    moved = p.variable(p.false, "moved")
    with p.loop(0, MOST_CORRECTIONS):
        p.note(
            "Where the matrix is singular the state stays: what comes next finds it singular there too, and says so."
        )
        p.leave_if(corrections(t, state, numbers, found), p.whole(Outcome.DONE), moved.value, likely=False)
        violation, left = found[dimension], found[dimension + 1]
        p.leave_if(violation <= ROUND_OFF, p.whole(Outcome.DONE), moved.value)
        better = left <= 0.5 * violation
        unresolved = p.choose(violation <= RESOLVED, p.whole(Outcome.DONE), p.whole(Outcome.UNPROJECTED))
        p.leave_if(~better, unresolved, moved.value, likely=False)
        moved.value = p.true
        with p.each(dimension) as i:
            state[i], lost[i] = compensated(state[i], found[i] + lost[i])
        p.leave_if(left <= ROUND_OFF, p.whole(Outcome.DONE), moved.value, likely=True)
    p.leave(p.whole(Outcome.UNPROJECTED), moved.value)
    return p.finish(WHOLE, FLAG)


@shared
def starts_on_constraints(dimension: int) -> Procedure:
    """Return the procedure that tests whether a state satisfies its constraints up to `MOST_AT_START`."""
    about = "Say whether a state is near enough to its constraints to start there."
    p = Builder("starts_on_constraints", about, apart=True)
    corrections, numbers = p.function("corrections", CORRECTIONS), p.array("numbers", read=True)
    t, state = p.given("t", REAL), p.array("state", read=True)
    found = p.reserve(dimension + 2 + MOST_WRITTEN_BEYOND, name="found")
    p.note("A matrix that is singular here is so in the first step, which says it.")
    p.leave_if(corrections(t, state, numbers, found), p.true)
    p.leave(found[dimension] <= MOST_AT_START)
    return p.finish(FLAG)
