"""Zeros of what is watched on a Taylor step that is about to be taken, and where the first of them ends the step."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.events.constants import JUMP, TOGETHER
from lagrange.procedure.events.roots import roots
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.taylor.constants import EVENT_SLACK, LEAST_PART
from lagrange.procedure.taylor.event_series import is_balanced, keeps_sign, largest_term, reach, safe_step, write_noise
from lagrange.procedure.taylor.memory import TAYLOR, SeriesMemory, work_array
from lagrange.procedure.taylor.sums import state_on_step
from lagrange.procedure.taylor.watching import (
    COLUMN,
    COUNT,
    DIRECTION,
    MOST_ZEROS,
    NEAR,
    RESET_SIZE,
    ROOT,
    SIDES,
    SIGN,
    STARTING,
    Watched,
    write_event,
)
from lagrange.procedure.values import Flag, Memory, Real, Whole

LEAST_COUNT = 3
"""A series is taken to have at least so many coefficients."""

MARGIN = 1 / 64
"""By this part of a step zeros are looked for behind the first that changes the motion, at least."""

MOST_BALANCING = 200
"""So many times a step is halved until the low powers of what is watched on it keep their digits."""

GO_ON, LEAVE, WAIT = range(3)
"""What is to follow: the step, a return to who watches, or a return because there is no room for more events."""


@cache
def inspect_step() -> Procedure:
    """Return what decides on a step of length s in units of the scale: what is to follow, and how long it may be.

    What is not `doubtful` keeps its sign on all of it. `final` says that it ends at the end of the run, which is `left`
    away. Where the step is to follow, its events are written, and the sides are those at its end. Otherwise nothing has
    changed.
    """
    return _Inspection().build()


class _Zeros:
    """The zeros on a step: their times in units of the scale, places and directions, and the sides at its end.

    There may be two such lists at a time, with the numbers 0 and 1.
    """

    def __init__(self, watched: Watched, number: int) -> None:
        kept = watched.kept
        self.times = kept.reals("times", number * MOST_ZEROS)
        self.places, self.directions = (kept.wholes("zeros", (2 * number + i) * MOST_ZEROS) for i in range(2))
        self.signs, self.nears = (kept.wholes("ends", 2 * number + i) for i in range(2))

    @property
    def handed(self) -> tuple[Memory, ...]:
        return self.times, self.places, self.directions, self.signs, self.nears


@cache
def zeros_on_step() -> Procedure:
    """Return what finds the zeros of all that is watched on a step, in order; it returns how many, or -1.

    With `until`, zeros matter up to the first that surely changes the motion, and others at once with it: the search
    goes on to twice its time, and at least by `MARGIN` of the step, where those others are clearly passed.
    """
    p = Builder("zeros_on_step", "Find the zeros of what is watched on a step, in order.", apart=True)
    step, last = p.given("s", REAL), p.given("last", FLAG)
    until = p.given("until", FLAG)
    watched, surfaces = p.given("watched", WHOLE), p.given("surfaces", WHOLE)
    settings = p.array("settings", WHOLE, read=True)
    columns, noise = p.array("columns", read=True), p.array("noise", read=True)
    counts, doubtful = p.array("counts", WHOLE, read=True), p.array("doubtful", read=True)
    before, came_near, starting = (p.array(name, WHOLE, read=True) for name in ("before", "came_near", "starting"))
    times, places, directions = p.array("times"), p.array("places", WHOLE), p.array("directions", WHOLE)
    signs, nears = p.array("signs", WHOLE), p.array("nears", WHOLE)
    found, far = p.variable(0, "found"), p.variable(step, "far")
    resets, wanted = (settings.at(watched * block) for block in (RESET_SIZE, DIRECTION))
    with p.loop(0, watched) as i:
        s = far.value
        c, count = columns.at(i * COLUMN), counts[i]
        sign, near, begins = before[i], ~came_near[i].equals(0), ~starting[i].equals(0)
        signs[i], nears[i] = sign, came_near[i]
        clear = p.variable(doubtful[i].equals(0.0), "clear")
        with p.when(~clear.value & ~begins & ~near):
            clear.value = p.call(keeps_sign(), c, count, s, noise[i], p.real(sign))
        with p.when(~clear.value):
            # What starts at zero is divided by time: its root there is known, and the next may be close.
            first = p.whole(begins)
            allowed = p.choose(begins, 0.0, noise[i])
            to = found.value
            given = c.at(first), count - first, s, allowed, sign, near, last & s.equals(step)
            more, signs[i], after = p.call(roots(), *given, times.at(to), directions.at(to), MOST_ZEROS)
            nears[i] = p.whole(after)
            with p.when(more < 0, likely=False):
                p.leave(-1)
            with p.loop(to, to + more) as j:
                places[j] = i
                direction, at = directions[j], times[j]
                reset = (resets[i] > 0) & (wanted[i].equals(0) | wanted[i].equals(direction))
                changes = p.choose(i < surfaces, ~direction.equals(0), reset)
                end = at + p.larger(at, MARGIN * step)
                far.value = p.choose(until & changes & (end < far.value), end, far.value)
            found.value = to + more
    with _sorted(p, found.value, times) as (a, b):
        t, place, direction = times[a], places[a], directions[a]
        times[a], places[a], directions[a] = times[b], places[b], directions[b]
        times[b], places[b], directions[b] = t, place, direction
    p.leave(found.value)
    return p.finish(WHOLE)


@contextmanager
def _sorted(p: Builder, count: Whole, keys: Memory) -> Iterator[tuple[Whole, Whole]]:
    """Exchange neighbours, in the body, until their keys rise; equal ones stay in their order."""
    with p.loop(1, count) as i:
        j = p.variable(i)
        with p.repeat(lambda: (j.value > 0) & (keys[j.value] < keys[p.larger(j.value - 1, 0)])):
            yield j.value - 1, j.value
            j.value = j.value - 1


def _both_zero(one: Memory, other: Memory, place: Whole) -> Flag:
    found: Flag = one[place].equals(0.0) & other[place].equals(0.0)
    return found


class _Inspection:
    """Builds the procedure."""

    def __init__(self) -> None:
        self.p = p = Builder("inspect_step", "Decide on a step on which something watched may vanish.", apart=True)
        self.t, self.low, self.scale, self.rtol = (p.given(name, REAL) for name in ("t", "low", "scale", "rtol"))
        self.s, self.left, self.final = p.given("s", REAL), p.given("left", REAL), p.given("final", FLAG)
        self.doubtful = p.array("doubtful", read=True)
        self.taylor: Any = p.record("taylor", TAYLOR)
        self.watched = Watched(p)
        self.layout = self.watched.layout
        self.memory = SeriesMemory(p, self.layout, work_array(p))
        self.layout.read()
        self.rows, self.count = self.memory.work.at(self.layout.rows), self.memory.order + 1

    def build(self) -> Procedure:
        p, watched, kept = self.p, self.watched, self.watched.kept
        self.wary: Flag = (~watched.record.wary.equals(0)).called("wary")
        self.columns, self.noise, self.counts = kept.reals("columns"), kept.reals("noise"), kept.wholes("counts")
        self.late, self.early, self.size = kept.reals("late"), kept.reals("early"), self.layout.watched
        values, first = kept.reals("values"), self.rows.at(self.layout.watched_at)
        with p.loop(0, self.size) as i:
            values[i] = first[i]
        self.read_columns()
        write_noise(watched, watched.own_numbers, self.t, self.memory.work)
        ends = self.terminates()
        s = self.trusted(ends)
        whole = s.equals(self.s)
        shortest = TOGETHER * abs(self.t) + LEAST_PART * abs(self.left)
        with p.when(~whole & (abs(s * self.scale) < shortest)):
            p.leave(LEAVE, s)
        self.signs, self.nears = self.sides_now(s)
        found, shorter = _Zeros(watched, 0), _Zeros(watched, 1)
        count = self.find(found, s, whole & self.final, until_change=True)
        change = self.first_change(found, count, p.constant(math.inf, REAL))
        with p.when(change >= 0) as ways:
            self.shorten(found, count, change, shorter)
        with ways.otherwise():
            self.accept(found, count, p.constant(math.inf, REAL), ends)
            p.leave(GO_ON, s)
        return p.finish(WHOLE, REAL)

    def read_columns(self) -> None:
        """Copy the series of what is watched, in one pass; leave where one is not finite.

        What is known of each: how many coefficients it has before it is zero, and its largest terms on the step, among
        the last two and among the lower half.
        """
        p, s, width = self.p, self.s, self.layout.width
        watched_rows = self.rows.at(self.layout.watched_at)
        with self.doubted() as i:
            c, first = self.columns.at(i * COLUMN), watched_rows.at(i)
            total, power = p.variable(0.0), p.variable(1.0)
            early, late, last = p.variable(0.0), p.variable(0.0), p.variable(0.0)
            middle = (self.count - 1) // 2 + 1
            for begin, end in ((0, middle), (middle, self.count)):
                with p.loop(begin, end) as k:
                    value = first[k * width]
                    c[k] = value
                    size = abs(value) * power.value
                    total.value = total.value + value * 0.0
                    if end is middle:
                        early.value = p.magnitude(early.value, size)
                    else:
                        late.value, last.value = last.value, size
                    power.value = power.value * s
            used = p.variable(self.count, "used")
            with p.repeat(lambda: (used.value > LEAST_COUNT) & c[used.value - 1].equals(0.0)):
                used.value = used.value - 1
            with p.when(~total.value.equals(0.0), likely=False):
                p.leave(LEAVE, s)
            self.counts[i] = used.value
            self.late[i], self.early[i] = p.magnitude(late.value, last.value), early.value

    @contextmanager
    def doubted(self) -> Iterator[Whole]:
        """Go through what is doubtful."""
        p = self.p
        with p.loop(0, self.size) as i, p.when(~self.doubtful[i].equals(0.0)):
            yield i

    def terminates(self) -> Flag:
        """Whether the series of the state terminate, and say nothing about the length of a step."""
        p, width, place = self.p, self.layout.width, self.p.variable(0)
        last = self.rows.at(self.memory.order * width)
        before = self.rows.at((self.memory.order - 1) * width)
        with p.repeat(lambda: (place.value < self.layout.dimension) & _both_zero(last, before, place.value)):
            place.value = place.value + 1
        found: Flag = place.value.equals(self.layout.dimension)
        return found

    def trusted(self, ends: Flag) -> Real:
        """Return how much of the step the series of all that is watched reach."""
        p, s = self.p, self.p.variable(self.s, "trusted")
        tolerance = p.larger(self.rtol, 2.0**-52) * EVENT_SLACK
        with self.doubted() as i:
            c, noise = self.columns.at(i * COLUMN), self.noise[i]
            with p.when(~(self.late[i] <= p.fma(tolerance, self.early[i], noise)), likely=False):
                s.value = p.smaller(s.value, p.call(reach(), c, self.count, self.s, tolerance, noise))
            with p.when(self.wary, likely=False):
                s.value = p.smaller(s.value, p.call(safe_step(), c, self.count))
        with p.when(ends, likely=False):
            # What is balanced on a step is so on a shorter one.
            halvings, balanced = p.variable(0), p.variable(p.false)
            with self.doubted() as i:
                c = self.columns.at(i * COLUMN)
                balanced.value = p.false
                with p.repeat(lambda: ~balanced.value & (halvings.value < MOST_BALANCING)):
                    balanced.value = p.call(is_balanced(), c, self.counts[i], s.value)
                    halvings.value = halvings.value + p.whole(~balanced.value)
                    s.value = p.choose(balanced.value, s.value, s.value * 0.5)
        found: Real = s.value
        return found

    def sides_now(self, s: Real) -> tuple[Memory, Memory]:
        """Return the sides before the step: what has jumped over zero since the step before is on the other."""
        p, kept = self.p, self.watched.kept
        signs, nears = kept.wholes("sides"), kept.wholes("sides", 1)
        sides = self.watched.side(SIGN), self.watched.side(NEAR)
        with p.loop(0, self.size) as i:
            signs[i], nears[i] = sides[0][i], sides[1][i]
        with self.doubted() as i:
            c, sign = self.columns.at(i * COLUMN), signs[i]
            with p.when(p.real(sign) * c[0] < 0.0, likely=False):
                jumped = abs(c[0]) > JUMP * p.call(largest_term(), c, self.counts[i], s)
                signs[i] = p.choose(jumped, -sign, sign)
                nears[i] = p.choose(jumped, 0, nears[i])
        return signs, nears

    def find(self, zeros: _Zeros, s: Real, last: Flag, *, until_change: bool) -> Whole:
        """Find the zeros on a step of length s; leave where they are not to be found here."""
        p, watched = self.p, self.watched
        until = p.true if until_change else p.false
        numbers = s, last, until, self.size, watched.record.surfaces, watched.settings
        series = self.columns, self.noise, self.counts, self.doubtful
        sides = self.signs, self.nears, self.watched.side(STARTING)
        count: Whole = p.call(zeros_on_step(), *numbers, *series, *sides, *zeros.handed)
        with p.when(count < 0):
            p.leave(LEAVE, s)
        return count

    def first_change(self, zeros: _Zeros, count: Whole, before: Real) -> Whole:
        """Return the number of the first zero before a time that changes the motion, -1 if none does."""
        p, watched = self.p, self.watched
        seen, before_step = watched.kept.wholes("seen"), watched.side(COUNT)
        with p.loop(0, self.size) as i:
            seen[i] = before_step[i]
        found, j = p.variable(-1), p.variable(0)
        with p.repeat(lambda: (j.value < count) & (found.value < 0)):
            place, direction = zeros.places[j.value], zeros.directions[j.value]
            is_event = watched.is_event(place)
            counts = is_event & watched.counts(place, direction)
            number = seen[place] + 1
            seen[place] = p.choose(counts, number, seen[place])
            stops = (watched.setting(RESET_SIZE, place) > 0) | watched.is_last(place, number)
            changes = p.choose(is_event, counts & stops, ~direction.equals(0))
            found.value = p.choose(changes & (zeros.times[j.value] < before), j.value, -1)
            j.value = j.value + 1
        result: Whole = found.value
        return result

    def shorten(self, zeros: _Zeros, count: Whole, change: Whole, shorter: _Zeros) -> None:
        """End the step at the first change; leave where it is at the start, or more than one thing happens there.

        The shorter step tells more zeros apart: what it has is what is kept, and a change may come out earlier.
        """
        p = self.p
        at = p.variable(zeros.times[change], "at")
        together = p.variable(self.together(zeros, count, at.value), "together")
        found, place = p.variable(0, "count"), p.variable(zeros.places[change], "place")
        direction = p.variable(zeros.directions[change], "direction")
        again = p.variable(p.true, "again")
        with p.repeat(lambda: again.value):
            with p.when((at.value <= 0.0) | ~together.value.equals(1)):
                p.leave(LEAVE, self.s)
            found.value = self.find(shorter, at.value, p.false, until_change=False)
            earlier = self.first_change(shorter, found.value, at.value - self.close(at.value))
            again.value = earlier >= 0
            with p.when(again.value):
                # The zeros of the longer step count no more, and which happen at once is to be seen anew.
                at.value = shorter.times[earlier]
                place.value, direction.value = shorter.places[earlier], shorter.directions[earlier]
                together.value = self.together(shorter, found.value, at.value)
        self.leave_unless_alone(shorter, found.value, at.value, place.value)
        with p.when(~self.watched.setting(ROOT, place.value).equals(0)):
            p.leave(LEAVE, self.s)
        self.accept(shorter, found.value, at.value - self.close(at.value), p.true)
        self.watched.record.due, self.watched.record.direction = place.value + 1, direction.value
        p.leave(GO_ON, at.value)

    def close(self, at: Real) -> Real:
        """Return how far from a zero others happen at once with it."""
        found: Real = TOGETHER * self.p.larger(abs(self.t / self.scale), at)
        return found

    def together(self, zeros: _Zeros, count: Whole, at: Real) -> Whole:
        """Return how many zeros happen at once at a time."""
        p, number = self.p, self.p.variable(0)
        close = self.close(at)
        with p.loop(0, count) as j:
            number.value = number.value + p.whole(abs(zeros.times[j] - at) <= close)
        found: Whole = number.value
        return found

    def leave_unless_alone(self, zeros: _Zeros, count: Whole, at: Real, place: Whole) -> None:
        """Leave where something else has its zero at the end of the shorter step."""
        p, late = self.p, at - self.close(at)
        with p.loop(0, count) as j, p.when((zeros.times[j] >= late) & ~zeros.places[j].equals(place)):
            p.leave(LEAVE, self.s)

    def accept(self, zeros: _Zeros, count: Whole, before: Real, again: Flag) -> None:
        """Write the events before a time on the step, and the sides at its end; keep what held before it.

        `again` says that the next step is to be inspected whatever its bounds say.
        """
        p, watched, record = self.p, self.watched, self.watched.record
        with p.when(record.done + count > record.room):
            p.leave(p.choose(record.done.equals(0), p.constant(LEAVE, WHOLE), p.constant(WAIT, WHOLE)), self.s)
        still = p.variable(count.equals(0) & ~again, "still")
        signs, nears, starting = (watched.side(block) for block in (SIGN, NEAR, STARTING))
        with p.loop(0, self.size) as i:
            begins = ~starting[i].equals(0)
            same = signs[i].equals(zeros.signs[i]) & nears[i].equals(zeros.nears[i])
            still.value = still.value & same & ~begins
        with p.when(~still.value):
            self.keep_sides(zeros)
            self.write_events(zeros, count, before)
        inspect = p.variable(again | self.wary, "inspect")
        with p.loop(0, self.size) as i:
            inspect.value = inspect.value | zeros.signs[i].equals(0) | ~zeros.nears[i].equals(0)
        self.taylor.inspect = p.whole(inspect.value)

    def keep_sides(self, zeros: _Zeros) -> None:
        """Keep the sides before the step, and write those at its end."""
        p, watched, size = self.p, self.watched, self.size
        kept = watched.sides.at(size * SIDES)
        with p.loop(0, size * SIDES) as i:
            kept[i] = watched.sides[i]
        sides = [watched.side(block) for block in (SIGN, NEAR, STARTING)]
        with p.loop(0, size) as i:
            kept[i], kept[i + size] = self.signs[i], self.nears[i]
            for side, value in zip(sides, (zeros.signs[i], zeros.nears[i], 0), strict=True):
                side[i] = value

    def write_events(self, zeros: _Zeros, count: Whole, before: Real) -> None:
        """Write the events before a time on the step."""
        p, watched, record = self.p, self.watched, self.watched.record
        slot = p.variable(record.done, "slot")
        with p.loop(0, count) as j:
            place, time = zeros.places[j], zeros.times[j]
            counts = watched.is_event(place) & watched.counts(place, zeros.directions[j])
            with p.when(counts & (time < before)):
                watched.side(COUNT)[place] = watched.side(COUNT)[place] + 1
                state = write_event(watched, slot.value, (self.t + self.low) + time * self.scale, place)
                p.call(state_on_step(), time, state, watched.sizes, *self.memory.handed)
                slot.value = slot.value + 1
        record.ahead, record.due, record.unproven = slot.value, 0, 1
