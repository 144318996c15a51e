"""Events along many steps, block by block: most keep their sign on a step, and zeros of the others are isolated.

What is irregular ends the review in front of its step: an event that has no value or is not resolved, a zero that
changes the motion, more zeros than there is room for.
"""

from __future__ import annotations

import math
from functools import cache

from lagrange.procedure.builder import Builder
from lagrange.procedure.dense.block import LANES
from lagrange.procedure.events.chebyshev import COARSE, DEGREE
from lagrange.procedure.events.constants import DEEPEST, MOST_HALVINGS, MOST_ROOTS, NARROWEST
from lagrange.procedure.events.resolution import chebyshev, local_polynomial
from lagrange.procedure.events.roots import roots
from lagrange.procedure.events.step_samples import FULL, PART, WIDE, Samples
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.values import Flag, Real, Whole

QUEUE = 256
"""Steps that are screened before those of them that are doubtful are looked at closely."""


@cache
def review() -> Procedure:
    """Return what goes through the steps from `begin` up to `end`, times (S+1,) and states (S+1, 2n).

    It gives the step in front of which it ended, and the number of zeros that count; of each it writes the event, the
    step, the time and the state. `sign` and `near` are the sides of the events, settled or not. `direction` says which
    zeros count, 0 for all, and `remaining` how many of them until the motion changes, 0 or below for never. With
    `starts` the motion starts at `begin`, where some events `stayed` at zero to a size: one that does is irregular. No
    step follows the `last` one, -1 for none, at which steps have `rounded` the events by so many times their noise.
    """
    return _Review().build()


class _Review:
    """Builds the procedure."""

    def __init__(self) -> None:
        self.p = p = Builder("review", "Find the zeros of events on steps, up to what is irregular.")
        self.samples = Samples(p)
        self.begin, self.end, self.screens = p.given("begin", WHOLE), p.given("end", WHOLE), p.given("screens", FLAG)
        self.sign, self.near = p.array("sign", WHOLE), p.array("near", WHOLE)
        self.direction, self.remaining = p.array("direction", WHOLE, read=True), p.array("remaining", WHOLE)
        self.which, self.where = p.array("which", WHOLE), p.array("where", WHOLE)
        self.when, self.there = p.array("when"), p.array("there")
        self.stayed, self.starts = p.array("stayed", read=True), p.given("starts", FLAG)
        self.last, self.rounded = p.given("last", WHOLE), p.given("rounded", REAL)
        self.room, self.noted = p.given("room", WHOLE), p.array("noted", WHOLE)

    def build(self) -> Procedure:
        p, samples = self.p, self.samples
        samples.lay_out()
        self.queue = p.reserve(QUEUE, WHOLE, name="queue")
        self.after = [self.noted.at(samples.events * k) for k in range(3)]
        self.stack = [p.reserve(DEEPEST + 2, name=name) for name in ("starts", "widths", "tails")]
        self.coefficients, self.powers = (p.reserve(DEGREE + 1, name=name) for name in ("coefficients", "powers"))
        self.roots, self.ways = p.reserve(MOST_ROOTS, name="roots"), p.reserve(MOST_ROOTS, WHOLE, name="ways")
        self.found, self.filled = p.variable(0, "found"), p.variable(0, "filled")
        reached = p.variable(self.begin, "reached")
        with p.repeat(lambda: reached.value < self.end):
            self.filled.value = 0
            with p.repeat(lambda: (reached.value < self.end) & (self.filled.value <= QUEUE - LANES)):
                self.queue_block(reached.value)
                reached.value = reached.value + LANES
            count = self.filled.value
            with p.loop(0, count, LANES) as first:
                with p.loop(0, LANES) as b:
                    samples.places[b] = self.queue[p.smaller(first + b, count - 1)]
                samples.follow()
                p.leave_if(samples.bad.value, samples.places[0], self.found.value, likely=False)
                self.begin_at_zero()
                self.settle(p.smaller(count - first, LANES))
        p.leave(self.end, self.found.value)
        return p.finish(WHOLE, WHOLE)

    def queue_block(self, first: Whole) -> None:
        """Put those of a block of steps that want a closer look into the queue: the first step always does."""
        p, samples = self.p, self.samples
        with p.loop(0, LANES) as b:
            samples.places[b] = p.smaller(first + b, self.end - 1)
        with p.when(self.screens):
            samples.sift()
        with p.loop(0, p.smaller(self.end - first, LANES)) as b:
            close = samples.is_doubtful(b) | (first + b).equals(self.begin)
            with p.when(~self.screens | close):
                self.queue[self.filled.value] = first + b
                self.filled.value = self.filled.value + 1

    def begin_at_zero(self) -> None:
        """Leave it to others where the motion starts at a zero of an event."""
        p, first = self.p, self.samples.places[0]
        with p.when(self.starts & first.equals(self.begin), likely=False), p.loop(0, self.samples.events) as e:
            values = self.samples.lines["coarse"].at(e * WIDE)
            start = values[0]
            size = p.larger(self.samples.edge(start, values[(COARSE + 1) * LANES]), 4.0 * self.stayed[e])
            p.leave_if(~(abs(start) > size), first, self.found.value)

    def settle(self, count: Whole) -> None:
        """Go through the steps of a block in order, and isolate the zeros of the events that may vanish."""
        p = self.p
        resolved = p.variable(p.false, "resolved")
        with p.loop(0, count) as b:
            watched = p.variable(p.false, "watched")
            with p.loop(0, self.samples.events) as e:
                watched.value = watched.value | self.may_vanish(b, e)
            with p.when(watched.value):
                with p.when(~resolved.value):
                    self.samples.sample_fully()
                    resolved.value = p.true
                self.visit(self.samples.places[b].called("step"), b)

    def may_vanish(self, b: Whole, e: Whole) -> Flag:
        """Whether an event may vanish on a step, or its side is not settled."""
        doubtful = ~self.samples.lines["doubtful"][e * LANES + b].equals(0.0)
        return Flag.of(doubtful | self.sign[e].equals(0) | ~self.near[e].equals(0))

    def visit(self, step: Whole, b: Whole) -> None:
        """Isolate the zeros on a step. What is irregular leaves everything as it was in front of it."""
        p, before = self.p, self.found.value
        known = self.sign, self.near, self.remaining
        with p.loop(0, self.samples.events) as e:
            for now, after in zip(known, self.after, strict=True):
                after[e] = now[e]
            with p.when(self.may_vanish(b, e)):
                self.isolate(step, b, e, before)
        with p.loop(0, self.samples.events) as e:
            for now, after in zip(known, self.after, strict=True):
                now[e] = after[e]

    def isolate(self, step: Whole, b: Whole, e: Whole, before: Whole) -> None:
        """Isolate the zeros of one event on a step, which is halved until it is a polynomial on each part."""
        p, (starts, widths, tails) = self.p, self.stack
        last, place = step.equals(self.last), e * LANES + b
        noise = p.variable(self.samples.lines["noise"][place], "noise")
        with p.when(last, likely=False):
            noise.value = p.larger(noise.value, self.samples.lines["edge_end"][place] * self.rounded)
        starts[0], widths[0], tails[0] = 0.0, 1.0, math.inf
        top, halvings = p.variable(0, "top"), p.variable(0, "halvings")
        with p.repeat(lambda: top.value >= 0):
            now = top.value
            start, width = starts[now].called("start"), widths[now].called("width")
            size = self.sampled(b, e, start, width)
            given = self.coefficients, size, noise.value, tails[now], self.powers
            count, blur, tail = p.call(local_polynomial(), *given)
            with p.when(count.equals(0), likely=False) as ways:
                hopeless = (width <= NARROWEST) | (halvings.value >= MOST_HALVINGS) | ~(size < math.inf)
                p.leave_if(hopeless | self.samples.bad.value, step, before)
                half = width * 0.5
                starts[now + 1], widths[now + 1], tails[now + 1] = start, half, tail
                starts[now], widths[now], tails[now] = start + half, half, tail
                top.value, halvings.value = now + 1, halvings.value + 1
            with ways.otherwise():
                self.keep_roots(step, b, e, before, (start, width, count, blur))
                top.value = now - 1

    def sampled(self, b: Whole, e: Whole, start: Real, width: Real) -> Real:
        """Write the Chebyshev coefficients of an event on a part of a step, and return its size."""
        p = self.p
        size = p.variable(self.samples.lines["size"][e * LANES + b], "size")
        with p.when(width.equals(1.0), likely=True) as ways:
            known = self.samples.lines["chebyshev"].at(e * FULL + b)
            with p.loop(0, DEGREE + 1) as k:
                self.coefficients[k] = known[k * LANES]
        with ways.otherwise():
            self.samples.sample_part(b, start, width)
            size.value = p.call(chebyshev(), self.samples.lines["part"].at(e * PART), self.coefficients)
        return p.real(size.value)

    def keep_roots(self, step: Whole, b: Whole, e: Whole, before: Whole, part: tuple[Real, Real, Whole, Real]) -> None:
        """Isolate the roots on a part of a step, and keep those that count."""
        p, (sign, near, remaining) = self.p, self.after
        start, width, count, blur = part
        final = step.equals(self.last) & (start + width).equals(1.0)
        given = self.powers, count, 1.0, blur, sign[e], ~near[e].equals(0), final
        met, sign_after, near_after = p.call(roots(), *given, self.roots, self.ways, MOST_ROOTS)
        p.leave_if(met < 0, step, before, likely=False)
        sign[e], near[e] = sign_after, p.whole(near_after)
        direction = self.direction[e]
        with p.loop(0, met) as r, p.when(direction.equals(0) | direction.equals(self.ways[r])):
            left = remaining[e]
            p.leave_if(left.equals(1) | (self.found.value >= self.room), step, before, likely=False)
            remaining[e] = left - 1
            self.write(step, b, e, start + width * self.roots[r])

    def write(self, step: Whole, b: Whole, e: Whole, s: Real) -> None:
        """Write a zero that counts."""
        p, found = self.p, self.found.value
        self.which[found], self.where[found] = e, step
        t = self.samples.own.t[b]
        self.when[found] = t + s * (self.samples.t_end[b] - t)
        with p.loop(0, self.samples.dimension) as j:
            c = self.samples.c.at(j * LANES + b)
            total = p.variable(c[self.samples.degree * self.samples.total])
            with p.loop(0, self.samples.degree) as k:
                total.value = p.fma(total.value, s, c[(self.samples.degree - 1 - k) * self.samples.total])
            self.there[found * self.samples.dimension + j] = total.value
        self.found.value = found + 1
