"""Compare the sign of a watched function at the end of a step with the sign that its series predicts.

A function that saturates, such as erf(x), looks constant where it is flat: its series does not show a slope further
ahead. The next series begins with the exact value, which reveals the error.
"""

from __future__ import annotations

from lagrange.procedure.builder import Builder
from lagrange.procedure.events.constants import JUMP
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.constants import EVENT_SLACK
from lagrange.procedure.taylor.event_series import write_noise
from lagrange.procedure.taylor.memory import SeriesMemory, TaylorLayout, work_array
from lagrange.procedure.taylor.watching import NEAR, SIDES, SIGN, SMOOTH, STARTING, Watched
from lagrange.procedure.values import Flag, Real, Whole


@shared
def contradicts(layout: TaylorLayout) -> Procedure:
    """Return the procedure that tests whether the present series and that of the last step disagree on a side.

    Functions that may jump are excluded: their sign may change without a zero.
    """
    return _Contradiction(layout).build()


class _Contradiction:
    """Builds the procedure."""

    def __init__(self, layout: TaylorLayout) -> None:
        self.p = p = Builder("contradicts", "Whether the signs of what is watched are not those that series gave.")
        self.layout = layout
        self.t, self.rtol, self.length = (p.given(name, REAL) for name in ("t", "rtol", "length"))
        self.watched = Watched(p, layout)
        self.memory = SeriesMemory(p, layout, work_array(p))

    def build(self) -> Procedure:
        p, watched = self.p, self.watched
        doubt = p.variable(p.false, "doubt")
        with p.loop(0, self.layout.watched) as i:
            doubt.value = doubt.value | self.is_other(i)
        p.leave_if(~doubt.value, p.false, likely=True)
        values = watched.kept.reals("values")
        with p.loop(0, self.layout.watched) as i:
            values[i] = self.row(0, i)
        write_noise(watched, watched.own_numbers, self.t, self.memory.work)
        noise, found = watched.kept.reals("noise"), p.variable(p.false, "found")
        # The error of the state is its rounding times the ratio of tolerance to round-off.
        slack = EVENT_SLACK * p.fma(self.rtol, 2.0**50, 1.0)
        with p.loop(0, self.layout.watched) as i:
            found.value = found.value | (self.is_other(i) & (abs(values[i]) > slack * noise[i]))
        p.leave(found.value)
        return p.finish(FLAG)

    def row(self, order: int, i: Whole) -> Real:
        """Return a coefficient of a watched function."""
        found: Real = self.memory.row(order).at(self.layout.watched_at)[i]
        return found

    def is_other(self, i: Whole) -> Flag:
        """Return whether a function that cannot jump is on the other side, further than its slope explains."""
        p, watched, value = self.p, self.watched, self.row(0, i)
        before = watched.sides.at(self.layout.watched * (SIDES + STARTING))
        settled = watched.side(NEAR)[i].equals(0) & ~watched.setting(SMOOTH, i).equals(0) & before[i].equals(0)
        other = p.real(watched.side(SIGN)[i]) * value < 0.0
        far = abs(value) > JUMP * abs(self.row(1, i)) * self.length
        found: Flag = settled & other & far
        return found
