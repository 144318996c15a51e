"""Apply the event at which a Taylor step has ended: reset the state, or continue on the other side of a surface."""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.events.constants import CLOSEST, MOST_COEFFICIENTS
from lagrange.algorithm.step.constants import EARLIEST
from lagrange.algorithm.step.run import COUNTS
from lagrange.algorithm.taylor.constants import EVENT_SLACK
from lagrange.algorithm.taylor.event_series import comparable_unit, start_of_series, write_noise
from lagrange.algorithm.taylor.memory import JET, TAYLOR, SeriesMemory, work_array
from lagrange.algorithm.taylor.watching import (
    COUNT,
    DIRECTION,
    NEAR,
    RESET_AT,
    RESET_SIZE,
    ROOT,
    SETTINGS,
    SIGN,
    STARTING,
    Watched,
    column,
    write_event,
)
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.front.building import Tracer
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Whole

AT_REST = 4.0
"""Largest distance of an event function from zero after a reset, relative to that before it, that counts as zero."""


@shared
def sides_at_start() -> Procedure:
    """Return the procedure that finds the sides at the start of a motion, and the functions that start at zero.

    The event at index `place` counts as zero up to `margin`. The procedure returns False if it cannot decide: a series
    is not finite, that event does not leave zero at once, or another function starts at zero. At the start of a run
    `place` is -1, and an event that does not reset the state may start at zero.
    """
    p = Builder("sides_at_start", "Find the sides with which a motion begins.", apart=True)
    t, scale, rtol, margin = (p.given(name, REAL) for name in ("t", "scale", "rtol", "margin"))
    place = p.given("place", WHOLE)
    numbers, state, series = (p.array(name, read=True) for name in ("numbers", "state", "series"))
    watched, order = Watched(p), p.given("order", WHOLE)
    layout, kept, count = watched.layout, watched.kept, order + 1
    layout.read()
    signs, starting = kept.wholes("begun"), kept.wholes("begun", 1)
    c, size = p.reserve(MOST_COEFFICIENTS + 1, name="c"), layout.watched
    values, noise, first = kept.reals("values"), kept.reals("noise"), series.at(layout.watched_at)
    with p.loop(0, size) as i:
        values[i] = first[i]
    write_noise(watched, numbers, t, state)
    unit = Tracer(p, ()).call(comparable_unit, t, scale)
    tolerance = p.larger(rtol, 2.0**-52) * EVENT_SLACK
    with p.loop(0, size) as i:
        total = p.variable(0.0)
        column(p, layout, series, i, count, c)
        with p.loop(0, count) as k:
            total.value = total.value + c[k] * 0.0
        p.leave_if(~total.value.equals(0.0), p.false)
        mine = i.equals(place).called("mine")
        allowed = p.choose(mine, p.larger(noise[i], margin), noise[i])
        sign, order = p.call(start_of_series.form(), c, count, unit, tolerance, noise[i], allowed)
        turned = (watched.setting(RESET_SIZE, i) > 0) & sign.equals(watched.setting(DIRECTION, i))
        quiet = watched.is_event(i) & watched.setting(ROOT, i).equals(0) & ~turned
        p.leave_if(~order.equals(0) & ~((mine & order.equals(1)) | ((place < 0) & quiet)), p.false)
        signs[i], starting[i] = sign, order
    p.leave(p.true)
    return p.finish(FLAG)


@shared
def begin_sides() -> Procedure:
    """Return the procedure that finds the first sides of a run, and returns whether that succeeded."""
    p = Builder("begin_sides", "Find the sides at the beginning, and return whether that was done.", apart=True)
    t, scale, rtol = (p.given(name, REAL) for name in ("t", "scale", "rtol"))
    watched = Watched(p)
    memory = SeriesMemory(p, watched.layout, work_array(p))
    watched.layout.read()
    series = memory.work.at(watched.layout.rows)
    given = watched.own_numbers, memory.work, series
    found = p.call(sides_at_start(), t, scale, rtol, 0.0, -1, *given, *watched.handed, memory.order)
    with p.when(found):
        put_sides(watched)
        watched.record.fresh = 0
    p.leave(found)
    return p.finish(FLAG)


def put_sides(watched: Watched) -> None:
    """Write the sides at the beginning of a motion, from the results of `sides_at_start`."""
    signs, starting = (watched.kept.wholes("begun", number) for number in (0, 1))
    sides = [watched.side(block) for block in (SIGN, NEAR, STARTING)]
    with watched.p.loop(0, watched.count) as i:
        for side, value in zip(sides, (signs[i], 0, starting[i]), strict=True):
            side[i] = value


@shared
def reset_state() -> Procedure:
    """Return the procedure that applies the reset due at the state, if the motion then leaves zero at once.

    It returns whether that was done. If not, nothing has changed.
    """
    return _Reset().build()


class DueChange:
    """Base of builders whose procedures change the motion at the end of a step: arguments, and the early return.

    With `writes_row` the procedure also gets the arrays of recorded times and states.
    """

    def __init__(self, name: str, about: str, *, writes_row: bool) -> None:
        self.p = p = Builder(name, about, apart=True)
        self.jet = p.function("jet", JET)
        self.prepared, self.constants = p.array("prepared", read=True), p.array("constants", read=True)
        self.t, self.rtol = p.given("t", REAL), p.given("rtol", REAL)
        self.counts: Any = p.record("counts", COUNTS)
        self.taylor: Any = p.record("taylor", TAYLOR)
        if writes_row:
            self.times, self.rows = p.array("times"), p.array("rows")
        self.watched = Watched(p)
        self.layout = self.watched.layout
        self.memory = SeriesMemory(p, self.layout, work_array(p))
        self.work = self.memory.work
        self.layout.read()

    def due(self) -> Whole:
        """Return the index of the function that is due. Leave if the motion just changed: changes may accumulate."""
        p, record = self.p, self.watched.record
        since = abs(self.t - record.changed)
        self.leave_if(~(since > CLOSEST * p.larger(abs(self.t), EARLIEST)))
        place: Whole = (record.due - 1).called("place")
        return place

    def leave_if(self, condition: Flag) -> None:
        """Return False on a condition, so that the caller handles the change."""
        self.p.leave_if(condition, self.p.false)


class _Reset(DueChange):
    """Builds the procedure."""

    def __init__(self) -> None:
        super().__init__("reset_state", "Reset the state at an event, if possible.", writes_row=True)

    def build(self) -> Procedure:
        p, layout, record = self.p, self.layout, self.watched.record
        place = self.due()
        number = (self.watched.side(COUNT)[place] + 1).called("number")
        self.leave_if(~record.checked.equals(0))
        self.leave_if(self.watched.setting(RESET_SIZE, place).equals(0) | self.watched.is_last(place, number))
        self.leave_if(record.done >= record.room)
        there = self.work.at(p.whole(layout.ahead(self.memory.order)))
        self.write_new_state(place, there)
        series = there.at(layout.rows)
        numbers = self.prepared, self.constants
        self.leave_if(self.jet(self.t, self.taylor.scale, there, *numbers, series, self.memory.order))
        self.find_sides(place, there, series)
        self.commit(place, number, there)
        p.leave(p.true)
        return p.finish(FLAG)

    def write_new_state(self, place: Whole, there: Memory) -> None:
        """Write the state after the reset, with a compensation of zero."""
        p, layout, watched = self.p, self.layout, self.watched
        with p.loop(0, layout.padded) as i:
            there[i], there[i + layout.lost] = self.work[i], 0.0
        given = watched.kept.new_entries
        self.leave_if(watched.resets(self.t, self.work, watched.reset_numbers, given))
        first, size = watched.setting(RESET_AT, place), watched.setting(RESET_SIZE, place)
        entries = watched.settings.at(layout.watched * SETTINGS)
        with p.loop(first, first + size) as j:
            there[entries[j]] = given[j]
            self.leave_if(~(abs(given[j]) < math.inf))

    def find_sides(self, place: Whole, there: Memory, series: Memory) -> None:
        """Find the sides after the reset. Only the event itself may start at zero there."""
        p, layout, watched = self.p, self.layout, self.watched
        before = abs(self.work[place + (layout.rows + layout.watched_at)]) * AT_REST
        numbers = self.t, self.taylor.scale, self.rtol, before, place
        given = watched.own_numbers, there, series, *watched.handed, self.memory.order
        self.leave_if(~p.call(sides_at_start(), *numbers, *given))
        signs, sides = watched.kept.wholes("begun"), watched.side(SIGN)
        with p.loop(0, watched.record.surfaces) as i:
            self.leave_if(~signs[i].equals(sides[i]))
        with p.loop(watched.record.surfaces, layout.watched) as i:
            self.keep_side(i, place, series)

    def keep_side(self, i: Whole, place: Whole, series: Memory) -> None:
        """Keep the side of an event that the reset leaves unchanged; see `lagrange.trajectory.events.motion_start`.

        An event that came near zero may have touched it, which the caller handles.
        """
        p, watched, at = self.p, self.watched, self.layout.watched_at
        sign, near = watched.side(SIGN)[i], watched.side(NEAR)[i]
        signs, noise = watched.kept.wholes("begun"), watched.kept.reals("noise")
        stays = abs(series[i + at] - self.work[i + (self.layout.rows + at)]) <= noise[i]
        stays = stays & ~sign.equals(0) & ~i.equals(place) & watched.setting(ROOT, i).equals(0)
        self.leave_if(stays & ~near.equals(0))
        signs[i] = p.choose(stays, sign, signs[i])

    def commit(self, place: Whole, number: Whole, there: Memory) -> None:
        """Write the event and the new state, and begin a motion there."""
        p, layout, watched, record = self.p, self.layout, self.watched, self.watched.record
        state = write_event(watched, record.done, self.t, place)
        with p.loop(0, layout.dimension) as i:
            state[i] = self.work[i]
        record.done = record.done + 1
        record.ahead, record.due = record.done, 0
        record.changed, record.changed_at = self.t, place
        record.jumps = record.jumps + 1
        watched.side(COUNT)[place] = number
        put_sides(watched)
        with p.loop(0, layout.padded * 2) as i:
            self.work[i] = there[i]
        self.taylor.low, self.taylor.next_limit, self.taylor.inspect = 0.0, math.inf, 1
        with p.when(~self.counts.record.equals(0)):
            row = self.counts.rows
            self.times[row] = self.t
            target = self.rows.at(row * layout.dimension)
            with p.loop(0, layout.dimension) as i:
                target[i] = there[i]
            self.counts.rows = row + 1


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
