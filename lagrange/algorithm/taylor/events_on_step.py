"""Zeros of watched functions on the next Taylor step, in order of time; the first that changes the motion ends it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from lagrange.algorithm.events.constants import JUMP, TOGETHER
from lagrange.algorithm.events.polynomial import PADDED
from lagrange.algorithm.events.roots import roots
from lagrange.algorithm.taylor.constants import EVENT_SLACK, LEAST_PART
from lagrange.algorithm.taylor.defect_test import verified_step
from lagrange.algorithm.taylor.event_series import (
    LATE,
    event_terms,
    is_balanced,
    keeps_sign,
    largest_term,
    only_passage,
    only_zero,
    reach,
    read_column,
    safe_step,
    write_noise,
)
from lagrange.algorithm.taylor.memory import SIZES, TAYLOR, RecordedLayout, SeriesMemory, work_array
from lagrange.algorithm.taylor.sums import state_on_step
from lagrange.algorithm.taylor.watching import (
    COLUMN,
    COUNT,
    DIRECTION,
    MOST_ZEROS,
    NEAR,
    REALS,
    RESET_SIZE,
    ROOT,
    SIDES,
    SIGN,
    STARTING,
    TERM_SUMS,
    Watched,
    write_event,
)
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real, Whole

MARGIN = 1 / 64
"""Least part of a step by which the search continues after the first zero that changes the motion."""


class Zeros:
    """The zeros on a step: their times in units of the scale, indices and directions, and the sides at its end.

    Two such lists, with the numbers 0 and 1, may exist at a time.
    """

    def __init__(self, watched: Watched, number: int) -> None:
        kept = watched.kept
        self.times = kept.reals("times", number * MOST_ZEROS)
        self.places, self.directions = (kept.wholes("zeros", (2 * number + i) * MOST_ZEROS) for i in range(2))
        self.signs, self.nears = (kept.wholes("ends", 2 * number + i) for i in range(2))

    @property
    def handed(self) -> tuple[Memory, ...]:
        """The arguments of the procedure that finds zeros."""
        return self.times, self.places, self.directions, self.signs, self.nears


@shared
def zeros_on_step() -> Procedure:
    """Return the procedure that finds the zeros of watched functions on a step, in order.

    It returns their number, or -1 on failure. With `until`, only zeros up to the first one that surely changes the
    motion matter, and simultaneous ones. The search then ends at twice the time of that zero, at least `MARGIN` of the
    step after it, where simultaneous zeros are clearly passed. The terms are those on a step of length `whole`.
    """
    return _Search().build()


class _Search:
    """Builds the procedure."""

    def __init__(self) -> None:
        self.p = p = Builder("zeros_on_step", "Find the zeros of what is watched on a step, in order.", apart=True)
        self.step, self.whole, self.last = p.given("s", REAL), p.given("whole", REAL), p.given("last", FLAG)
        self.until, self.surfaces = p.given("until", FLAG), p.given("surfaces", WHOLE)
        self.settings = p.array("settings", WHOLE, read=True)
        self.columns, self.counts = p.array("columns"), p.array("counts", WHOLE)
        self.terms, self.slopes, self.sums = (p.array(name, read=True) for name in ("terms", "slopes", "sums"))
        self.noise, self.doubtful = p.array("noise", read=True), p.array("doubtful", read=True)
        names = "before", "came_near", "starting"
        self.before, self.came_near, self.starting = (p.array(name, WHOLE, read=True) for name in names)
        self.times = p.array("times")
        self.places, self.directions = p.array("places", WHOLE), p.array("directions", WHOLE)
        self.signs, self.nears = p.array("signs", WHOLE), p.array("nears", WHOLE)
        sizes: Any = p.record("sizes", SIZES)
        self.layout: Any = RecordedLayout(sizes)
        self.memory = SeriesMemory(p, self.layout, work_array(p))
        self.layout.read()

    def build(self) -> Procedure:
        p = self.p
        self.rows = self.memory.row(0).at(self.layout.watched_at)
        self.found, self.far = p.variable(0, "found"), p.variable(self.step, "far")
        with p.loop(0, self.layout.watched) as i:
            self.signs[i], self.nears[i] = self.before[i], self.came_near[i]
            with p.when(~self.doubtful[i].equals(0.0)):
                self.search(i)
        with _sorted(p, self.found.value, self.times) as (a, b):
            for one in (self.times, self.places, self.directions):
                first = one[a]
                one[a] = one[b]
                one[b] = first
        p.leave(self.found.value)
        return p.finish(WHOLE)

    def search(self, i: Whole) -> None:
        """Find the zeros of a watched function, from the sums of its terms if these decide."""
        p, s = self.p, self.far.value
        sign, near, begins = self.before[i], ~self.came_near[i].equals(0), ~self.starting[i].equals(0)
        answer = p.variable(2, "answer")
        smooth = ~begins & ~near
        sums, terms = self.sums.at(i * len(TERM_SUMS)), self.terms.at(i * PADDED)
        with p.when(smooth & s.equals(self.whole), likely=True) as ways:
            answer.value = p.call(only_zero.form(), s, self.memory.order, sign, self.noise[i], terms, sums)
        with ways.otherwise():
            self.read(i)
            with p.when(smooth):
                c, count = self.columns.at(i * COLUMN), self.counts[i]
                clear = p.call(keeps_sign.form(), c, count, s, self.noise[i], p.real(sign))
                answer.value = p.choose(clear, 0, answer.value)
        with p.when(answer.value.equals(2), likely=False) as ways:
            self.read(i)
            self.isolate(i, s, begins, near)
        with ways.otherwise(), p.when(~answer.value.equals(0)):
            to = self.found.value
            given = terms, self.slopes.at(i * PADDED), sums, self.memory.order, answer.value
            self.times[to] = s * p.call(only_passage.form(), *given)
            self.directions[to] = self.signs[i] = answer.value
            self.add(i, to, 1)

    def read(self, i: Whole) -> None:
        """Copy the series of a watched function on first use; leave if it is not finite."""
        p = self.p
        given = self.rows.at(i), self.layout.width, self.memory.order
        with p.when(~p.call(read_column.form(), *given, self.columns.at(i * COLUMN), self.counts.at(i)), likely=False):
            p.leave(-1)

    def isolate(self, i: Whole, s: Real, begins: Any, near: Any) -> None:
        """Find all zeros by root isolation.

        A function that starts at zero is divided by time: the root there is known, and the next may be close.
        """
        p, to, first = self.p, self.found.value, self.p.whole(begins)
        c, count, allowed = self.columns.at(i * COLUMN), self.counts[i], p.choose(begins, 0.0, self.noise[i])
        last = self.last & s.equals(self.step)
        given = c.at(first), count - first, s, allowed, self.before[i], near, last
        more, self.signs[i], after = p.call(roots.form(), *given, self.times.at(to), self.directions.at(to), MOST_ZEROS)
        self.nears[i] = p.whole(after)
        with p.when(more < 0, likely=False):
            p.leave(-1)
        self.add(i, to, more)

    def add(self, i: Whole, to: Whole, more: Any) -> None:
        """Add zeros that were written. If one changes the motion, the search ends soon after it."""
        p, watched = self.p, self.layout.watched
        with p.loop(to, to + more) as j:
            self.places[j] = i
        with p.when(self.until):
            resets, wanted = (self.settings[i + watched * block] for block in (RESET_SIZE, DIRECTION))
            with p.loop(to, to + more) as j:
                direction, at = self.directions[j], self.times[j]
                reset = (resets > 0) & (wanted.equals(0) | wanted.equals(direction))
                changes = p.choose(i < self.surfaces, ~direction.equals(0), reset)
                end = at + p.larger(at, MARGIN * self.step)
                self.far.value = p.choose(changes & (end < self.far.value), end, self.far.value)
        self.found.value = to + more


@contextmanager
def _sorted(p: Builder, count: Whole, keys: Memory) -> Iterator[tuple[Whole, Whole]]:
    """Sort by exchanging neighbours, in the body, until their keys rise; equal keys keep their order."""
    with p.loop(1, count) as i:
        j = p.variable(i)
        with p.repeat(lambda: (j.value > 0) & (keys[j.value] < keys[p.larger(j.value - 1, 0)])):
            yield j.value - 1, j.value
            j.value = j.value - 1


MOST_BALANCING = 200
"""Largest number of halvings of a step until the low powers of watched functions keep their digits."""

GO_ON, LEAVE, WAIT = range(3)
"""Decisions: take the step, leave the step to the caller, or return because the memory for events is full."""


@shared
def inspect_step() -> Procedure:
    """Return the procedure that inspects a step of length s in units of the scale: a decision, and its new length.

    Functions that are not `doubtful` keep their signs on the step. `final` is true if it ends at the end of the run,
    which is `left` away. If the step is taken, its events are written, and the sides are those at its end. Otherwise
    nothing has changed.
    """
    return _Inspection().build()


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
        self.hides_growth: Flag = (~watched.record.hides_growth.equals(0)).called("hides_growth")
        self.steep: Flag = (~watched.record.steep.equals(0)).called("steep")
        self.columns, self.noise, self.counts = kept.reals("columns"), kept.reals("noise"), kept.wholes("counts")
        self.size, self.values = self.layout.watched, kept.reals("values")
        first = self.rows.at(self.layout.watched_at)
        with p.loop(0, self.size) as i:
            self.values[i], self.counts[i] = first[i], 0
        write_noise(watched, watched.own_numbers, self.t, self.memory.work)
        ends = self.terminates()
        s = self.verified(self.trusted(ends))
        whole = s.equals(self.s)
        shortest = TOGETHER * abs(self.t) + LEAST_PART * abs(self.left)
        with p.when(~whole & (abs(s * self.scale) < shortest)):
            p.leave(LEAVE, s)
        self.signs, self.nears = self.sides_now(s)
        found, shorter = Zeros(watched, 0), Zeros(watched, 1)
        count = self.find(found, s, whole & self.final, until_change=True)
        change = self.first_change(found, count, p.constant(math.inf, REAL))
        with p.when(change >= 0) as ways:
            self.shorten(found, count, change, shorter)
        with ways.otherwise():
            self.accept(found, count, p.constant(math.inf, REAL), ends)
            p.leave(GO_ON, s)
        return p.finish(WHOLE, REAL)

    def column(self, i: Whole) -> Memory:
        """Return the series of a watched function, copied on first use; leave if it is not finite."""
        p, c = self.p, self.columns.at(i * COLUMN)
        given = self.rows.at(i + self.layout.watched_at), self.layout.width, self.memory.order
        with p.when(~p.call(read_column.form(), *given, c, self.counts.at(i)), likely=False):
            p.leave(LEAVE, self.s)
        return c

    @contextmanager
    def doubted(self) -> Iterator[Whole]:
        """Loop over the doubtful functions."""
        p = self.p
        with p.loop(0, self.size) as i, p.when(~self.doubtful[i].equals(0.0)):
            yield i

    def terminates(self) -> Flag:
        """Return whether the series of the state terminate, so that they do not limit the step."""
        p, width, place = self.p, self.layout.width, self.p.variable(0)
        last = self.rows.at(self.memory.order * width)
        before = self.rows.at((self.memory.order - 1) * width)
        with p.repeat(lambda: (place.value < self.layout.dimension) & _both_zero(last, before, place.value)):
            place.value = place.value + 1
        found: Flag = place.value.equals(self.layout.dimension)
        return found

    def trusted(self, ends: Flag) -> Real:
        """Return the part of the step on which the series of all watched functions can be trusted."""
        p, s = self.p, self.p.variable(self.s, "trusted")
        tolerance = p.larger(self.rtol, 2.0**-52) * EVENT_SLACK
        kept = self.watched.kept
        with self.doubted() as i:
            rows, noise = self.rows.at(i + self.layout.watched_at), self.noise[i]
            c, slopes, sums = (kept.reals(name).at(i * REALS[name]) for name in ("terms", "slopes", "sums"))
            p.call(event_terms.form(), rows, self.layout.width, self.memory.order, self.s, c, slopes, sums)
            late, early = sums[LATE], p.magnitude(c[0], c[1])
            with p.when(~(late <= p.fma(tolerance, early, noise)), likely=False):
                s.value = p.smaller(s.value, p.call(reach.form(), self.column(i), self.count, self.s, tolerance, noise))
            with p.when(self.hides_growth, likely=False):
                s.value = p.smaller(s.value, p.call(safe_step.form(), self.column(i), self.count))
        with p.when(ends, likely=False):
            # A series that is balanced on a step is balanced on a shorter one.
            halvings, balanced = p.variable(0), p.variable(p.false)
            with self.doubted() as i:
                c = self.column(i)
                balanced.value = p.false
                with p.repeat(lambda: ~balanced.value & (halvings.value < MOST_BALANCING)):
                    balanced.value = p.call(is_balanced.form(), c, self.counts[i], s.value)
                    halvings.value = halvings.value + p.whole(~balanced.value)
                    s.value = p.choose(balanced.value, s.value, s.value * 0.5)
        found: Real = s.value
        return found

    def verified(self, s: Real) -> Real:
        """Return a step at whose end the series of high powers agree with the watched functions."""
        p, watched, found = self.p, self.watched, self.p.variable(s, "verified")
        with p.when(self.steep, likely=False):
            function = watched.values, watched.own_numbers, watched.tilts
            kept = (watched.kept.reals(name) for name in ("noise", "there", "blur"))
            scratch = *kept, watched.kept.new_entries, watched.kept.moved
            given = self.t, self.scale, self.rtol, s, *scratch, watched.sizes, *self.memory.handed
            found.value = p.call(verified_step(), *function, *given)
        result: Real = found.value
        return result

    def sides_now(self, s: Real) -> tuple[Memory, Memory]:
        """Return the sides before the step; functions that jumped over zero since the last step have changed theirs."""
        p, kept = self.p, self.watched.kept
        signs, nears = kept.wholes("sides"), kept.wholes("sides", 1)
        sides = self.watched.side(SIGN), self.watched.side(NEAR)
        with p.loop(0, self.size) as i:
            sign = sides[0][i]
            signs[i], nears[i] = sign, sides[1][i]
            over = ~self.doubtful[i].equals(0.0) & (p.real(sign) * self.values[i] < 0.0)
            with p.when(over, likely=False):
                c = self.column(i)
                jumped = abs(c[0]) > JUMP * p.call(largest_term.form(), c, self.counts[i], s)
                signs[i] = p.choose(jumped, -sign, sign)
                nears[i] = p.choose(jumped, 0, nears[i])
        return signs, nears

    def find(self, zeros: Zeros, s: Real, last: Flag, *, until_change: bool) -> Whole:
        """Find the zeros on a step of length s; leave if that cannot be done here."""
        p, watched = self.p, self.watched
        until = ~watched.record.changing.equals(0) if until_change else p.false
        numbers = s, self.s, last, until, watched.record.surfaces, watched.settings
        terms = (watched.kept.reals(name) for name in ("terms", "slopes", "sums"))
        series = self.columns, self.counts, *terms, self.noise, self.doubtful
        sides = self.signs, self.nears, self.watched.side(STARTING)
        given = *numbers, *series, *sides, *zeros.handed, watched.sizes, *self.memory.handed
        count: Whole = p.call(zeros_on_step(), *given)
        with p.when(count < 0):
            p.leave(LEAVE, s)
        return count

    def first_change(self, zeros: Zeros, count: Whole, before: Real) -> Whole:
        """Return the number of the first zero before a time that changes the motion, or -1 without one."""
        p, watched = self.p, self.watched
        seen, before_step = watched.kept.wholes("seen"), watched.side(COUNT)
        found, j = p.variable(-1), p.variable(0)
        with p.when(~watched.record.changing.equals(0)):
            with p.loop(0, self.size) as i:
                seen[i] = before_step[i]
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

    def shorten(self, zeros: Zeros, count: Whole, change: Whole, shorter: Zeros) -> None:
        """End the step at the first change. Leave if that is at the start, or several things happen there.

        On the shorter step more zeros are resolved. Its zeros are the ones that count, and a change may come earlier.
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
                # The zeros of the longer step are dropped, and simultaneous ones must be counted again.
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
        """Return the distance within which zeros count as simultaneous."""
        found: Real = TOGETHER * self.p.larger(abs(self.t / self.scale), at)
        return found

    def together(self, zeros: Zeros, count: Whole, at: Real) -> Whole:
        """Return the number of zeros that are simultaneous at a time."""
        p, number = self.p, self.p.variable(0)
        close = self.close(at)
        with p.loop(0, count) as j:
            number.value = number.value + p.whole(abs(zeros.times[j] - at) <= close)
        found: Whole = number.value
        return found

    def leave_unless_alone(self, zeros: Zeros, count: Whole, at: Real, place: Whole) -> None:
        """Leave if another function has a zero at the end of the shorter step."""
        p, late = self.p, at - self.close(at)
        with p.loop(0, count) as j, p.when((zeros.times[j] >= late) & ~zeros.places[j].equals(place)):
            p.leave(LEAVE, self.s)

    def accept(self, zeros: Zeros, count: Whole, before: Real, again: Flag) -> None:
        """Write the events before a time on the step, and the sides at its end; save the sides before it.

        `again` forces an inspection of the next step.
        """
        p, record = self.p, self.watched.record
        with p.when(record.done + count > record.room):
            p.leave(p.choose(record.done.equals(0), p.constant(LEAVE, WHOLE), p.constant(WAIT, WHOLE)), self.s)
        self.keep_sides(zeros, again)
        self.write_events(zeros, count, before)

    def keep_sides(self, zeros: Zeros, again: Flag) -> None:
        """Save the sides before the step, write those at its end, and decide whether to inspect the next step."""
        p, watched, size = self.p, self.watched, self.size
        kept = watched.sides.at(size * SIDES)
        sign, near, starting, counted = (watched.side(block) for block in (SIGN, NEAR, STARTING, COUNT))
        inspect = p.variable(again | self.hides_growth | self.steep, "inspect")
        with p.loop(0, size) as i:
            before = {SIGN: self.signs[i], NEAR: self.nears[i], STARTING: starting[i], COUNT: counted[i]}
            for block, value in before.items():
                kept[i + size * block] = value
            sign[i], near[i], starting[i] = zeros.signs[i], zeros.nears[i], 0
            inspect.value = inspect.value | zeros.signs[i].equals(0) | ~zeros.nears[i].equals(0)
        self.taylor.inspect = p.whole(inspect.value)

    def write_events(self, zeros: Zeros, count: Whole, before: Real) -> None:
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
