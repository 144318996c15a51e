"""States at output times: sums of the step's series, written while the series is in memory."""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.memory import HELD, OUTPUTS, SeriesMemory, TaylorLayout, work_array
from lagrange.procedure.taylor.sums import increment
from lagrange.procedure.values import Flag, Memory, Real, Whole


def outstanding(wanted: Memory, place: Whole, end: Real, scale: Real) -> Flag:
    """Return whether an output time at an index exists and lies before the end of a step."""
    found: Flag = (wanted[place] - end) * scale < 0.0
    return found


@shared
def write_outputs(layout: TaylorLayout) -> Procedure:
    """Return the procedure that writes the states at the output times before the end of the last step, `end`.

    A time at the end itself belongs to the next step, which begins with the state at that time.
    """
    p = Builder("write_outputs", "Write the states at the output times on the last step.", apart=True)
    end: Real = p.given("end", REAL)
    held: Any = p.record("held", HELD)
    outputs: Any = p.record("outputs", OUTPUTS)
    wanted, states = p.array("wanted", read=True), p.array("states", room=layout.block)
    run = SeriesMemory(p, layout, work_array(p))
    t, low, scale = held.t, held.low, held.scale
    inverse = 1.0 / scale
    before, lost = (run.work.at(layout.held + place) for place in (0, layout.padded))
    k = p.variable(outputs.done, "k")
    with p.repeat(lambda: outstanding(wanted, k.value, end, scale)):
        since: Real = wanted[k.value] - t
        s: Real = p.choose(since.equals(0.0), 0.0, since - low) * inverse
        sums = increment(run, s)
        target = states.at(k.value * layout.dimension)
        with p.each(layout.dimension, width=layout.block, unrolled=layout.chains) as i:
            target[i] = before[i] + (sums(i) + lost[i])
        k.value = k.value + 1
    outputs.ahead = k.value
    return p.finish()
