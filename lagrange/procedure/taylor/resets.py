"""What happens at an event to which a Taylor step has led: the state is reset, and the motion starts anew."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.events.constants import MOST_COEFFICIENTS
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.step.constants import EARLIEST
from lagrange.procedure.step.run import COUNTS
from lagrange.procedure.taylor.constants import CLOSEST, EVENT_SLACK
from lagrange.procedure.taylor.event_series import comparable_unit, event_noise, start_of_series
from lagrange.procedure.taylor.memory import JET, TAYLOR, SeriesMemory, TaylorLayout, work_array
from lagrange.procedure.taylor.watching import (
    COUNT,
    FUNCTION,
    NEAR,
    RESET_AT,
    RESET_SIZE,
    SETTINGS,
    SIGN,
    STARTING,
    Watched,
    column,
    write_event,
)
from lagrange.procedure.values import Flag, Memory, Whole

AT_REST = 4.0
"""An event function may be this many times as far from zero behind a reset as before, and counts as zero."""


@cache
def sides_at_start(layout: TaylorLayout) -> Procedure:
    """Return what finds the sides with which a motion begins, and what starts at zero there.

    It returns False where that is not decided here: a series is not finite, or something starts at zero and does not
    leave at once; but for the event at `place`, which is as good as zero where it is not above `margin`, nothing may.
    """
    p = Builder("sides_at_start", "Find the sides with which a motion begins.", apart=True)
    t, scale, rtol, margin = (p.given(name, REAL) for name in ("t", "scale", "rtol", "margin"))
    place = p.given("place", WHOLE)
    function, numbers = p.function("values", FUNCTION), p.array("numbers", read=True)
    tilts, state, series = (p.array(name, read=True) for name in ("tilts", "state", "series"))
    signs, starting = p.array("signs", WHOLE), p.array("starting", WHOLE)
    count = p.given("order", WHOLE) + 1
    c, size = p.reserve(MOST_COEFFICIENTS + 1, name="c"), layout.watched
    values, noise = (p.reserve(size + layout.block, room=layout.block, name=name) for name in ("value", "noise"))
    with p.loop(0, size) as i:
        values[i] = series[i + layout.watched_at]
    p.call(event_noise(layout), function, numbers, tilts, t, state, values, noise)
    unit = comparable_unit(p, t, scale)
    tolerance = p.larger(rtol, 2.0**-52) * EVENT_SLACK
    with p.loop(0, size) as i:
        total = p.variable(0.0)
        column(p, layout, series, i, count, c)
        with p.loop(0, count) as k:
            total.value = total.value + c[k] * 0.0
        p.leave_if(~total.value.equals(0.0), p.false)
        mine = i.equals(place)
        allowed = p.choose(mine, p.larger(noise[i], margin), noise[i])
        sign, order = p.call(start_of_series(), c, count, unit, tolerance, noise[i], allowed)
        p.leave_if(~order.equals(0) & (~mine | ~order.equals(1)), p.false)
        signs[i], starting[i] = sign, order
    p.leave(p.true)
    return p.finish(FLAG)


@cache
def begin_sides(layout: TaylorLayout) -> Procedure:
    """Return what begins to watch at the state, if that can be done here; it returns whether it was done."""
    p = Builder("begin_sides", "Find the sides at the beginning, and return whether that was done.", apart=True)
    t, scale, rtol = (p.given(name, REAL) for name in ("t", "scale", "rtol"))
    watched, memory = Watched(p, layout), SeriesMemory(p, layout, work_array(p, layout))
    signs, starting = (p.reserve(layout.watched, WHOLE, name=name) for name in ("signs", "starting"))
    state, series = memory.work, memory.work.at(layout.rows)
    function = watched.values, watched.own_numbers, watched.tilts
    found = p.call(
        sides_at_start(layout), t, scale, rtol, 0.0, -1, *function, state, series, signs, starting, *memory.handed[1:]
    )
    with p.when(found):
        put_sides(watched, signs, starting)
        watched.record.fresh = 0
    p.leave(found)
    return p.finish(FLAG)


def put_sides(watched: Watched, signs: Memory, starting: Memory) -> None:
    """Write the sides at the beginning of a motion."""
    sides = [watched.side(block) for block in (SIGN, NEAR, STARTING)]
    with watched.p.loop(0, watched.count) as i:
        for side, value in zip(sides, (signs[i], 0, starting[i]), strict=True):
            side[i] = value


@cache
def reset_state(layout: TaylorLayout) -> Procedure:
    """Return what does what is due at the state, if that is a reset behind which the motion leaves zero at once.

    It returns whether that was done; otherwise nothing has changed.
    """
    return _Reset(layout).build()


class DueChange:
    """What builders of procedures share that change the motion where a step has led: their arguments, and the refusal.

    One that writes a row of the run takes where to.
    """

    def __init__(self, layout: TaylorLayout, name: str, about: str, *, writes_row: bool) -> None:
        self.p = p = Builder(name, about, apart=True)
        self.layout = layout
        self.jet = p.function("jet", JET)
        self.prepared, self.constants = p.array("prepared", read=True), p.array("constants", read=True)
        self.t, self.rtol = p.given("t", REAL), p.given("rtol", REAL)
        self.counts: Any = p.record("counts", COUNTS)
        self.taylor: Any = p.record("taylor", TAYLOR)
        if writes_row:
            self.times, self.rows = p.array("times"), p.array("rows", room=layout.block)
        self.watched = Watched(p, layout)
        self.memory = SeriesMemory(p, layout, work_array(p, layout))
        self.work = self.memory.work

    def due(self) -> Whole:
        """Return the place of what is due; leave it where the motion has just changed: changes may accumulate."""
        p, record = self.p, self.watched.record
        since = abs(self.t - record.changed)
        self.leave_if(~(since > CLOSEST * p.larger(abs(self.t), EARLIEST)))
        place: Whole = (record.due - 1).called("place")
        return place

    def leave_if(self, condition: Flag) -> None:
        """Leave what is due to who watches on a condition."""
        self.p.leave_if(condition, self.p.false)


class _Reset(DueChange):
    """Builds the procedure."""

    def __init__(self, layout: TaylorLayout) -> None:
        super().__init__(layout, "reset_state", "Reset the state at an event, if possible.", writes_row=True)

    def build(self) -> Procedure:
        p, layout, record = self.p, self.layout, self.watched.record
        place = self.due()
        number = (self.watched.side(COUNT)[place] + 1).called("number")
        self.leave_if(self.watched.setting(RESET_SIZE, place).equals(0) | self.watched.is_last(place, number))
        self.leave_if(record.done >= record.room)
        there = self.work.at(p.whole(layout.ahead(self.memory.order)))
        self.write_new_state(place, there)
        series = there.at(layout.rows)
        numbers = self.prepared, self.constants
        self.leave_if(self.jet(self.t, self.taylor.scale, there, *numbers, series, self.memory.order))
        signs, starting = self.sides_behind(place, there, series)
        self.commit(place, number, there, signs, starting)
        p.leave(p.true)
        return p.finish(FLAG)

    def write_new_state(self, place: Whole, there: Memory) -> None:
        """Write the state behind the reset; of it nothing is lost to rounding."""
        p, layout, watched = self.p, self.layout, self.watched
        with p.loop(0, layout.padded) as i:
            there[i], there[i + layout.lost] = self.work[i], 0.0
        given = watched.scratch
        self.leave_if(watched.resets(self.t, self.work, watched.reset_numbers, given))
        first, size = watched.setting(RESET_AT, place), watched.setting(RESET_SIZE, place)
        entries = watched.settings.at(SETTINGS * layout.watched)
        with p.loop(first, first + size) as j:
            there[entries[j]] = given[j]
            self.leave_if(~(abs(given[j]) < math.inf))

    def sides_behind(self, place: Whole, there: Memory, series: Memory) -> tuple[Memory, Memory]:
        """Return the sides behind the reset, and what starts at zero there: nothing else than the event may."""
        p, layout, watched = self.p, self.layout, self.watched
        signs, starting = (p.reserve(layout.watched, WHOLE, name=name) for name in ("signs", "starting"))
        before = abs(self.work[place + (layout.rows + layout.watched_at)]) * AT_REST
        numbers = self.t, self.taylor.scale, self.rtol, before, place
        function = watched.values, watched.own_numbers, watched.tilts
        memory = there, series, signs, starting, *self.memory.handed[1:]
        self.leave_if(~p.call(sides_at_start(layout), *numbers, *function, *memory))
        with p.loop(0, watched.record.surfaces) as i:
            self.leave_if(~signs[i].equals(watched.side(SIGN)[i]))
        return signs, starting

    def commit(self, place: Whole, number: Whole, there: Memory, signs: Memory, starting: Memory) -> None:
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
        put_sides(watched, signs, starting)
        with p.loop(0, 2 * layout.padded) as i:
            self.work[i] = there[i]
        self.taylor.low, self.taylor.next_limit, self.taylor.inspect = 0.0, math.inf, 1
        with p.when(~self.counts.record.equals(0)):
            row = self.counts.rows
            self.times[row] = self.t
            target = self.rows.at(row * layout.dimension)
            with p.loop(0, layout.dimension) as i:
                target[i] = there[i]
            self.counts.rows = row + 1
