"""Cross a switching surface at which a Taylor step has ended: continue with the equations of the other side."""

from __future__ import annotations

import math

from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.resets import DueChange, sides_at_start
from lagrange.procedure.taylor.watching import NEAR, SIGN, STARTING
from lagrange.procedure.values import Memory, Whole


@shared
def cross_surface() -> Procedure:
    """Return the procedure that crosses the surface due at the state, if the motion leaves to the other side at once.

    It returns whether that was done. If not, nothing has changed.
    """
    return _Crossing().build()


class _Crossing(DueChange):
    """Builds the procedure."""

    def __init__(self) -> None:
        about = "Go on with the other side of a surface, if possible."
        super().__init__("cross_surface", about, writes_row=False)

    def build(self) -> Procedure:
        p, record = self.p, self.watched.record
        place = self.due()
        self.leave_if(record.combination < 0)
        self.leave_if(record.switches >= record.room)
        other = self.other_side(place)
        numbers = self.watched.combinations[other].called("numbers")
        self.leave_if(numbers < 0)
        self.leave_unless_consistent(place, numbers)
        self.commit(place, other, numbers)
        p.leave(p.true)
        return p.finish(FLAG)

    def other_side(self, place: Whole) -> Whole:
        """Return the combination of sides with the other side of a surface, as a binary number: 1 is above."""
        p, record = self.p, self.watched.record
        power = p.variable(1)
        with p.loop(0, place):
            power.value = power.value * 2
        combination = record.combination
        above = combination // power.value - (combination // (power.value * 2)) * 2
        self.leave_if(~record.direction.equals(1 - above * 2))
        found: Whole = combination + (1 - above * 2) * power.value
        return found

    def leave_unless_consistent(self, place: Whole, numbers: Whole) -> None:
        """Leave unless the motion with the other side goes there, and touches no other surface."""
        p, layout, watched, work = self.p, self.layout, self.watched, self.work
        there = work.at(p.whole(layout.ahead(self.memory.order)))
        with p.loop(0, layout.padded * 2) as i:
            there[i] = work[i]
        series, scale = there.at(layout.rows), self.taylor.scale
        own = self.prepared.at(numbers), self.constants.at(numbers)
        self.leave_if(self.jet(self.t, scale, there, *own, series, self.memory.order))
        given = watched.value_numbers.at(numbers), there, series, *watched.handed, self.memory.order
        self.leave_if(~p.call(sides_at_start(), self.t, scale, self.rtol, math.inf, place, *given))
        signs, starting = (watched.kept.wholes("begun", number) for number in (0, 1))
        self.leave_if(~starting[place].equals(1))
        with p.loop(0, watched.record.surfaces) as i:
            expected = p.choose(i.equals(place), watched.record.direction, watched.side(SIGN)[i])
            self.leave_if(~signs[i].equals(expected))

    def commit(self, place: Whole, other: Whole, numbers: Whole) -> None:
        """Continue with the other side, and write the row after which it holds."""
        p, watched, record = self.p, self.watched, self.watched.record
        record.combination, record.numbers = other, numbers
        slot: Whole = record.switches
        watched.switch_rows[slot], watched.switch_combinations[slot] = self.counts.steps + record.jumps, other
        record.switches = slot + 1
        starting: Memory = watched.side(STARTING)
        with p.loop(0, self.layout.watched) as i:
            starting[i] = p.whole(i.equals(place))
        watched.side(SIGN)[place], watched.side(NEAR)[place] = record.direction, 0
        record.changed, record.changed_at, record.due = self.t, place, 0
        self.taylor.next_limit, self.taylor.inspect = math.inf, 1
