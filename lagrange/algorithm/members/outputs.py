"""States of a member at output times on a step, by the polynomial of the step."""

from __future__ import annotations

from lagrange.algorithm.members.paths import PATH
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real, Whole


def outstanding(times: Memory, place: Whole, end: Real, sign: Real) -> Flag:
    """Return whether an output time at an index is before the end of a step. The times end with NaN."""
    found: Flag = (times[place] - end) * sign < 0.0
    return found


@shared
def write_outputs() -> Procedure:
    """Return the procedure that writes the states at the output times on a step from t to `end`.

    It returns the number of output times that are done. A time at the end belongs to the next step.
    """
    p = Builder("write_outputs", "Write the states at the output times on a step, and return how many are done.")
    path = p.function("path", PATH)
    t, end, sign = (p.given(name, REAL) for name in ("t", "end", "sign"))
    times, memory, states = p.array("times", read=True), p.array("memory", read=True), p.array("states")
    dimension, degree, done = (p.given(name, WHOLE) for name in ("dimension", "degree", "done"))
    h = end - t
    place = p.variable(done, "place")
    with p.repeat(lambda: outstanding(times, place.value, end, sign)):
        theta = (times[place.value] - t) / h
        path(theta, 1.0, memory, states.at(place.value * dimension), degree)
        place.value = place.value + 1
    p.leave(place.value)
    return p.finish(WHOLE)
