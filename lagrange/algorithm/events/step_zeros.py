"""Zeros of events on one step, in order, up to the first that changes the motion: it is to happen alone.

An event that starts at zero where the motion starts is divided by time, less its value there: its zero there is known,
and the next may be close. What it is at the start stays subtracted on the whole step.
"""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.events.chebyshev import COARSE, DEGREE
from lagrange.algorithm.events.constants import (
    CLEAR_FACTOR,
    DEEPEST,
    JUMP,
    MOST_HALVINGS,
    MOST_ROOTS,
    NARROWEST,
    TOGETHER,
)
from lagrange.algorithm.events.resolution import chebyshev, local_polynomial
from lagrange.algorithm.events.roots import roots
from lagrange.algorithm.events.step_samples import Samples
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Record
from lagrange.procedure.values import Flag, Memory, Real, Whole

ENDED, IRREGULAR, CHANGED, CROWDED = range(4)
"""Reasons for the end of a review: after the last step; before an irregular step; before a step on which the motion
changes; before a step whose zeros may not fit into the arrays."""

REVIEW = Record.of(
    "Review",
    begin=WHOLE,
    end=WHOLE,
    starts=WHOLE,
    last=WHOLE,
    rounded=REAL,
    room=WHOLE,
    found=WHOLE,
    step=WHOLE,
    event=WHOLE,
    way=WHOLE,
    place=REAL,
)
"""Inputs and outputs of a review.

    begin, end   the steps that it goes through
    starts       1 where the motion starts at the first of them
    last         the step after which none follows, -1 if there is none
    rounded      how much rounding has moved an event by then, in units of its noise
    room         how many zeros there is room for
    found        how many zeros that count are written, with those from before
    step         the step in front of which the review ended
    event        what changes the motion on it
    way          the direction of its zero, and `place` where in the step that is
"""

UNKNOWN, ANYHOW = 0, 5
"""In place of a direction: it is for others to say what happens where an event starts at zero, and nothing does."""

MOST_ZEROS = 128
"""Most zeros on one step that a review handles."""


class ReviewArguments:
    """The arguments of a review beside its samples: the record, the side of each event, and the arrays for zeros.

    `sign` and `near` are the sides of the events, settled or not. `direction` says which zeros count, 0 for all, and
    `remaining` how many of them until the motion changes, 0 or below for never. Where the motion starts, some events
    have `stayed` at zero to a size, to which they `came` in a direction, less 2; see also `UNKNOWN` and `ANYHOW`.
    """

    def __init__(self, p: Builder) -> None:
        self.screens = p.given("screens", FLAG)
        self.record: Any = p.record("review", REVIEW)
        self.sign, self.near = p.array("sign", WHOLE), p.array("near", WHOLE)
        self.direction, self.remaining = p.array("direction", WHOLE, read=True), p.array("remaining", WHOLE)
        self.stayed, self.came = p.array("stayed"), p.array("came", WHOLE)
        self.which, self.when, self.there = p.array("which", WHOLE), p.array("when"), p.array("there")
        self.noted, self.levels = p.array("noted", WHOLE), p.array("levels")

    @property
    def handed(self) -> tuple[Any, ...]:
        """The arguments for another procedure."""
        sides = self.sign, self.near, self.direction, self.remaining, self.stayed, self.came
        return (self.screens, self.record, *sides, self.which, self.when, self.there, self.noted, self.levels)


class StepZeros:
    """Goes through the zeros on a step, with memory for them.

    `noted` has, for each event, the sides and counts after the step, and whether the event starts at zero.
    """

    def __init__(self, p: Builder, samples: Samples, given: ReviewArguments) -> None:
        self.p, self.samples, self.given, self.record = p, samples, given, given.record
        self.sides = given.sign, given.near, given.remaining
        self.after = [given.noted.at(samples.events * k) for k in range(3)]
        self.starting = given.noted.at(samples.events * 3)
        self.stack = [p.reserve(DEEPEST + 2, name=name) for name in ("starts", "widths", "tails")]
        self.coefficients, self.powers = (p.reserve(DEGREE + 2, name=name) for name in ("coefficients", "powers"))
        self.roots, self.ways = p.reserve(MOST_ROOTS, name="roots"), p.reserve(MOST_ROOTS, WHOLE, name="ways")
        self.times = p.reserve(MOST_ZEROS, name="zero_times")
        self.events, self.directions = (p.reserve(MOST_ZEROS, WHOLE, name=name) for name in ("events_of", "ways_of"))
        self.count, self.limit = p.variable(0, "count"), p.variable(1.0, "limit")
        self.cutting, self.again = p.variable(p.false, "cutting"), p.variable(p.true, "again")
        self.besides = p.variable(-1, "besides")

    def leave(self, why: int, step: Whole, *, condition: Flag | None = None) -> None:
        """End the review in front of a step, on a condition."""
        if condition is None:
            self.record.step = step
            self.p.leave(why)
        else:
            with self.p.when(condition, likely=False):
                self.leave(why, step)

    def begin_at_zero(self, step: Whole) -> None:
        """Note which events start at zero in the first step of a block; one with a reset has to come from there.

        An event whose side is known passes zero there, or does not, as at any joint of two steps.
        """
        p, record = self.p, self.record
        starts = (~record.starts.equals(0) & step.equals(record.begin)).called("begins")
        with p.loop(0, self.samples.events) as e:
            self.starting[e], self.given.levels[e] = 0, 0.0
            with p.when(starts, likely=False):
                values = self.samples.lines["coarse"].at(e * self.samples.widths.wide)
                start = values[0]
                size = p.larger(
                    self.samples.edge(start, values[(COARSE + 1) * self.samples.columns]), 4.0 * self.given.stayed[e]
                )
                noise = self.samples.lines["noise"][e * self.samples.columns]
                size = p.choose(self.given.came[e].equals(UNKNOWN), p.larger(size, noise), size)
                with p.when(~(abs(start) > size) & self.given.sign[e].equals(0)):
                    self.leave(IRREGULAR, step, condition=self.given.came[e].equals(UNKNOWN))
                    self.starting[e], self.given.levels[e] = 1, start

    def may_vanish(self, b: Whole, e: Whole) -> Flag:
        """Return true if an event may vanish on a step, or if its side is not settled."""
        doubtful = ~self.samples.lines["doubtful"][e * self.samples.columns + b].equals(0.0)
        return Flag.of(doubtful | self.given.sign[e].equals(0) | ~self.given.near[e].equals(0))

    def visit(self, step: Whole, b: Whole) -> None:
        """Isolate the zeros on a step, in its column. A step that ends the review leaves all records unchanged."""
        p, record = self.p, self.record
        self.leave(CROWDED, step, condition=record.found + MOST_ZEROS >= record.room)
        self.count.value, self.limit.value = 0, 1.0
        self.cutting.value, self.again.value, self.besides.value = p.false, p.true, -1
        kept, change = p.variable(0, "kept"), p.variable(-1, "change")
        with p.repeat(lambda: self.again.value):
            self.again.value = p.false
            self.isolate_all(step, b)
            with p.when(~self.cutting.value):
                self.sort()
                kept.value, change.value = self.count.value, self.first_change()
                with p.when(change.value >= 0, likely=False):
                    self.limit.value, self.besides.value = self.times[change.value], self.events[change.value]
                    self.cutting.value, self.again.value = p.true, p.true
        with p.when(change.value >= 0, likely=False):
            self.change(step, b, change.value, kept.value)
        self.stay_clear(step, b)
        self.write(b, kept.value, p.constant(math.inf, REAL))
        with p.loop(0, self.samples.events) as e:
            self.starting[e], self.given.levels[e] = 0, 0.0
            for now, after in zip(self.sides, self.after, strict=True):
                now[e] = after[e]

    def isolate_all(self, step: Whole, b: Whole) -> None:
        """Isolate the zeros on a step, or those up to a change, of all events but the one that changes the motion."""
        p = self.p
        with p.loop(0, self.samples.events) as e:
            for now, after in zip(self.sides, self.after, strict=True):
                after[e] = now[e]
            with p.when(self.may_vanish(b, e) & ~e.equals(self.besides.value)):
                self.isolate(step, b, e)

    def isolate(self, step: Whole, b: Whole, e: Whole) -> None:
        """Isolate the zeros of one event on a step, which is halved until it is a polynomial on each part."""
        p, (starts, widths, tails) = self.p, self.stack
        last, place = step.equals(self.record.last), e * self.samples.columns + b
        noise = p.variable(self.samples.lines["noise"][place], "noise")
        with p.when(last, likely=False):
            noise.value = p.larger(noise.value, self.samples.lines["edge_end"][place] * self.record.rounded)
        starts[0], widths[0], tails[0] = 0.0, 1.0, math.inf
        top, halvings = p.variable(0, "top"), p.variable(0, "halvings")
        with p.repeat(lambda: top.value >= 0):
            now = top.value
            start, width = starts[now].called("start"), widths[now].called("width")
            size = self.sampled(b, e, start, width)
            begins = (~self.starting[e].equals(0) & start.equals(0.0)).called("at_zero")
            least = p.choose(begins, noise.value, 0.0)
            given = self.coefficients, size, noise.value, tails[now], least, self.powers
            count, blur, tail = p.call(local_polynomial.form(), *given)
            with p.when(count.equals(0), likely=False) as ways:
                hopeless = (width <= NARROWEST) | (halvings.value >= MOST_HALVINGS) | ~(size < math.inf)
                self.leave(IRREGULAR, step, condition=hopeless | self.samples.bad.value)
                half = width * 0.5
                starts[now + 1], widths[now + 1], tails[now + 1] = start, half, tail
                starts[now], widths[now], tails[now] = start + half, half, tail
                top.value, halvings.value = now + 1, halvings.value + 1
            with ways.otherwise():
                self.keep_roots(step, e, begins, size, (start, width, count, blur))
                top.value = now - 1

    def sampled(self, b: Whole, e: Whole, start: Real, width: Real) -> Real:
        """Write the Chebyshev coefficients of an event, less its level, on a part of a step; return its size."""
        p = self.p
        size = p.variable(self.samples.lines["size"][e * self.samples.columns + b], "size")
        with p.when(width.equals(1.0), likely=True) as ways:
            known = self.samples.lines["chebyshev"].at(e * self.samples.widths.full + b)
            with p.loop(0, DEGREE + 1) as k:
                self.coefficients[k] = known[k * self.samples.columns]
        with ways.otherwise():
            self.samples.sample_part(b, start, width)
            size.value = p.call(
                chebyshev.form(), self.samples.lines["part"].at(e * self.samples.widths.part), self.coefficients
            )
        self.coefficients[0] = self.coefficients[0] - self.given.levels[e]
        return p.real(size.value)

    def keep_roots(self, step: Whole, e: Whole, begins: Flag, size: Real, part: tuple[Real, Real, Whole, Real]) -> None:
        """Isolate the roots on a part of a step up to the limit, and keep them. A jump over zero is irregular."""
        p, (sign, near, _) = self.p, self.after
        start, width, count, blur = part
        first = p.whole(begins).called("first")
        noise = p.variable(blur, "blur")
        with p.when(begins, likely=False):
            noise.value = self.leave_zero(step, e, count, blur)
        length = p.smaller((self.limit.value - start) / width, 1.0).called("length")
        final = step.equals(self.record.last) & (start + width).equals(1.0)
        final = final | (self.limit.value <= start + width) & self.cutting.value
        with p.when(length > 0.0):
            given = self.powers.at(first), count - first, length, noise.value, sign[e], ~near[e].equals(0), final
            met, sign_after, near_after = p.call(roots.form(), *given, self.roots, self.ways, MOST_ROOTS)
            self.leave(IRREGULAR, step, condition=(met < 0) | (self.count.value + met > MOST_ZEROS))
            far = (met > 0) & self.roots[0].equals(0.0) & (abs(self.powers[0]) > JUMP * size)
            self.leave(IRREGULAR, step, condition=far & ~begins)
            sign[e], near[e] = sign_after, p.whole(near_after)
            with p.loop(0, met) as r:
                slot = self.count.value + r
                self.times[slot], self.events[slot] = start + width * self.roots[r], e
                self.directions[slot] = self.ways[r]
            self.count.value = self.count.value + met

    def leave_zero(self, step: Whole, e: Whole, count: Whole, blur: Real) -> Real:
        """Find the side to which an event leaves zero, which its slope tells; return by how much that may be wrong.

        The slope of Chebyshev's polynomial of rank k at the end of [0, 1] is 2 k**2. An event that goes on to where it
        came from, or whose slope is zero within its error, is irregular.
        """
        p = self.p
        rank = p.real(p.larger(count - 1, 1))
        noise: Real = (2.0 * rank * rank * blur).called("divided")
        slope = p.real(p.choose(count > 1, self.powers[1], 0.0))
        side = p.choose(slope > 0.0, p.whole(1), p.whole(-1))
        self.leave(IRREGULAR, step, condition=~(abs(slope) > noise) | side.equals(self.given.came[e] - 2))
        self.after[0][e], self.after[1][e] = side, 0
        return noise

    def sort(self) -> None:
        """Sort the zeros by time; equal ones stay in their order."""
        p = self.p
        with p.loop(1, self.count.value) as i:
            j = p.variable(i)
            with p.repeat(lambda: (j.value > 0) & (self.times[j.value] < self.times[p.larger(j.value - 1, 0)])):
                a, b = j.value - 1, j.value
                for array in (self.times, self.events, self.directions):
                    one, other = array[a], array[b]
                    array[a], array[b] = other, one
                j.value = a

    def first_change(self) -> Whole:
        """Return the number of the first zero that changes the motion, -1 if none does; count those that count."""
        p, remaining = self.p, self.after[2]
        found = p.variable(-1, "change")
        with p.loop(0, self.count.value) as j, p.when((found.value < 0) & self.counts(j)):
            e = self.events[j]
            found.value = p.choose(remaining[e].equals(1), j, found.value)
            remaining[e] = remaining[e] - 1
        return p.whole(found.value)

    def counts(self, j: Whole) -> Flag:
        """Return true if a zero has the direction that counts."""
        wanted = self.given.direction[self.events[j]]
        return Flag.of(wanted.equals(0) | wanted.equals(self.directions[j]))

    def change(self, step: Whole, b: Whole, change: Whole, kept: Whole) -> None:
        """End the review at a zero that changes the motion, behind those before it.

        Other events that are zero there within their noise occur there too: the next motion would not find them.
        """
        p, record = self.p, self.record
        s, event, way = self.times[change], self.events[change], self.directions[change]
        t = self.samples.own.t[b]
        early: Real = (s - TOGETHER * p.larger(abs(t / (self.samples.t_end[b] - t)), s)).called("early")
        late = 2.0 * s - early
        with p.loop(0, kept) as j:
            near = (self.times[j] >= early) & (self.times[j] <= late) & ~j.equals(change)
            self.leave(IRREGULAR, step, condition=near)
        with p.loop(kept, self.count.value) as j:
            self.leave(IRREGULAR, step, condition=self.times[j] >= early)
        record.event, record.way, record.place = event, way, s
        before = record.found
        self.write(b, kept, early)
        self.write_one(b, record.found, event, s)
        with p.loop(before, record.found) as j, p.when(self.given.remaining[self.given.which[j]] > 0):
            e = self.given.which[j]
            self.given.remaining[e] = self.given.remaining[e] - 1
        with p.loop(0, self.samples.events) as e:
            for now, there in zip(self.sides[:2], self.after[:2], strict=True):
                now[e] = there[e]
        self.leave(CHANGED, step)

    def stay_clear(self, step: Whole, b: Whole) -> None:
        """Leave where an event that started at zero does not clear the value that it had there by the end."""
        with self.p.loop(0, self.samples.events) as e, self.p.when(~self.starting[e].equals(0), likely=False):
            end = self.samples.lines["coarse"][e * self.samples.widths.wide + COARSE * self.samples.columns + b]
            clear = abs(end) > CLEAR_FACTOR * abs(self.given.levels[e])
            same = end * self.p.real(self.after[0][e]) > 0.0
            self.leave(IRREGULAR, step, condition=~(clear & same))

    def write(self, b: Whole, count: Whole, before: Real) -> None:
        """Write those of `count` zeros that count and lie before a time."""
        p, record = self.p, self.record
        with p.loop(0, count) as j, p.when(self.counts(j) & (self.times[j] < before)):
            self.write_one(b, record.found, self.events[j], self.times[j])
            record.found = record.found + 1

    def write_one(self, b: Whole, slot: Whole, e: Whole, s: Real) -> None:
        """Write a zero: the event, its time and the state there."""
        p, samples = self.p, self.samples
        self.given.which[slot] = e
        t = samples.own.t[b]
        self.given.when[slot] = t + s * (samples.t_end[b] - t)
        state: Memory = self.given.there.at(slot * samples.dimension)
        with p.loop(0, samples.dimension) as j:
            c = samples.c.at(j * self.samples.columns + b)
            total = p.variable(c[samples.degree * samples.total])
            with p.loop(0, samples.degree) as k:
                total.value = p.fma(total.value, s, c[(samples.degree - 1 - k) * samples.total])
            state[j] = total.value
