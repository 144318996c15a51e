"""Events along many steps, block by block: most keep their sign on a step, and zeros of the others are isolated.

What is irregular ends the review in front of its step: an event that has no value or is not resolved, a zero that
changes the motion, more zeros than there is room for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, reduce
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.dense.block import COLUMNS, LANES, POLYNOMIAL, OwnStep
from lagrange.procedure.dense.evaluate import gather
from lagrange.procedure.events.chebyshev import COARSE, DEGREE, nodes
from lagrange.procedure.events.constants import (
    DEEPEST,
    DENSE_ROUND_OFF,
    MOST_HALVINGS,
    MOST_ROOTS,
    NARROWEST,
    NOISE,
)
from lagrange.procedure.events.resolution import chebyshev, keeps_sign, local_polynomial, transform
from lagrange.procedure.events.roots import roots
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.step.constants import RELATIVE_PERTURBATION
from lagrange.procedure.values import Flag, Memory, Real, Whole

WIDE = (COARSE + 3) * LANES
"""Columns at which a block is sampled at first: at the nodes, and moved by rounding at both ends."""

FULL = (DEGREE + 1) * LANES
"""Columns at which a block is sampled at the full degree."""

PART = (DEGREE // LANES + 1) * LANES
"""Columns at which a part of one step is sampled."""


def work_size(dimension: int, events: int) -> int:
    """Return how many doubles the review works in."""
    lines = WIDE + 2 * FULL + PART + 5 * LANES
    return LANES + (FULL + PART) * (dimension + 1) + lines * events + LANES


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
    """Builds the procedure. Vectors are by columns, as in `dense.block`; so are the lines of events."""

    def __init__(self) -> None:
        self.p = p = Builder("review", "Find the zeros of events on steps, up to what is irregular.")
        self.polynomial, self.given = p.function("polynomial", POLYNOMIAL), p.array("given", read=True)
        self.degree, self.both = p.given("degree", WHOLE), p.given("both", WHOLE)
        self.own_memory, self.beside = p.array("own", room=LANES), p.array("beside", room=LANES)
        self.path_work, self.c = p.array("path_work", room=LANES), p.array("c", room=LANES)
        self.kernel, self.parameters = p.function("kernel", COLUMNS), p.array("parameters", read=True)
        self.dimension, self.events = p.given("dimension", WHOLE), p.given("events", WHOLE)
        self.factors = p.array("factors", read=True)
        self.times, self.states = p.array("times", read=True), p.array("states", read=True)
        self.steps, self.begin, self.end = (p.given(name, WHOLE) for name in ("steps", "begin", "end"))
        self.sign, self.near = p.array("sign", WHOLE), p.array("near", WHOLE)
        self.direction, self.remaining = p.array("direction", WHOLE, read=True), p.array("remaining", WHOLE)
        self.which, self.where = p.array("which", WHOLE), p.array("where", WHOLE)
        self.when, self.there = p.array("when"), p.array("there")
        self.stayed, self.starts = p.array("stayed", read=True), p.given("starts", FLAG)
        self.last, self.rounded = p.given("last", WHOLE), p.given("rounded", REAL)
        self.room, self.noted = p.given("room", WHOLE), p.array("noted", WHOLE)
        self.work = p.array("work", room=LANES)

    def build(self) -> Procedure:
        p = self.p
        self.lay_out()
        self.found, self.bad = p.variable(0, "found"), p.variable(p.false, "bad")
        with p.loop(self.begin, self.end, LANES) as first:
            with p.loop(0, LANES) as b:
                self.places[b] = p.smaller(first + b, self.end - 1)
            given = self.dimension, p.constant(LANES, WHOLE), self.places, self.steps, self.times, self.states
            p.call(gather(), *given, self.both, self.own_memory, self.beside)
            with p.loop(0, LANES) as b:
                self.t_end[b] = self.times[self.places[b] + 1]
            self.polynomial(self.given, LANES, self.own_memory, self.beside, self.path_work, self.c)
            self.look(first)
            self.settle(first)
        p.leave(self.end, self.found.value)
        return p.finish(WHOLE, WHOLE)

    def lay_out(self) -> None:
        """Give everything its place in memory."""
        p = self.p
        self.total = (self.dimension * LANES).called("total")
        self.own = OwnStep(self.own_memory, self.dimension, p.constant(LANES, WHOLE))
        self.t_end, self.time = self.work, self.work.at(LANES)
        self.state = self.time.at(FULL)
        self.part_time = self.state.at(self.dimension * FULL)
        self.part_state = self.part_time.at(PART)
        lines = self.part_state.at(self.dimension * PART)
        names = {"noise": LANES, "edge_end": LANES, "moved": LANES, "doubtful": LANES, "size": LANES}
        names |= {"coarse": WIDE, "fine": FULL, "chebyshev": FULL, "part": PART}
        self.lines: dict[str, Memory] = {}
        for name, columns in names.items():
            self.lines[name], lines = lines, lines.at(self.events * columns)
        self.places = p.reserve(LANES, WHOLE, name="places")
        self.nodes = p.reserve(PART, room=LANES, name="nodes")
        for k, node in enumerate(nodes().tolist()):
            self.nodes[k] = node
        with p.loop(DEGREE + 1, PART) as spare:
            self.nodes[spare] = 1.0
        self.after = [self.noted.at(self.events * k) for k in range(3)]
        self.stack = [p.reserve(DEEPEST + 2, name=name) for name in ("starts", "widths", "tails")]
        self.coefficients, self.powers = (p.reserve(DEGREE + 1, name=name) for name in ("coefficients", "powers"))
        self.roots, self.ways = p.reserve(MOST_ROOTS, name="roots"), p.reserve(MOST_ROOTS, WHOLE, name="ways")

    # --- what all steps of a block take

    def look(self, first: Whole) -> None:
        """Sample the events on a block of steps, and say which may vanish."""
        p, lines = self.p, self.lines
        self.sample_coarsely()
        with p.loop(0, self.events) as e:
            values, moved = lines["coarse"].at(e * WIDE), lines["moved"].at(e * LANES)
            noise, edge_end, doubtful = (lines[name].at(e * LANES) for name in ("noise", "edge_end", "doubtful"))
            with p.each(LANES, width=LANES) as b:
                found = [values.at(k * LANES)[b] for k in range(COARSE + 3)]
                edge, end = (self.edge(found[k], found[COARSE + 1 + (k > 0)]) for k in (0, COARSE))
                edge_end[b] = end
                owed = self.owed(found[: COARSE + 1], moved[b])
                noise[b] = p.choose(edge > end, edge, end) + owed
                sure = keeps_sign(p, transform(p, found[: COARSE + 1]), noise[b])
                doubtful[b] = p.choose(sure, 0.0, 1.0)
        p.leave_if(self.bad.value, first, self.found.value, likely=False)
        self.begin_at_zero(first)

    def sample_coarsely(self) -> None:
        """Evaluate the events at few nodes, at ends that are moved by rounding, and where the range of a step says."""
        p, thetas = self.p, nodes(COARSE).tolist()
        with p.each(LANES, width=LANES) as b:
            t, end = self.own.t[b], self.t_end[b]
            for k, time in enumerate((*self.instants(t, end, thetas), t * self.moved(-1), end * self.moved(-1))):
                self.time.at(k * LANES)[b] = time
        with p.loop(0, self.dimension) as j:
            to, factor = self.state.at(j * WIDE), self.moved(j)
            own, new, part = self.own.y.at(j * LANES), self.own.new.at(j * LANES), self.part_state.at(j * LANES)
            with p.each(LANES, width=LANES) as b:
                y, end = own[b], new[b]
                inside = self.path(self.c.at(j * LANES), b, thetas[1:-1])
                for k, value in enumerate((y, *inside, end, y * factor, end * factor)):
                    to.at(k * LANES)[b] = value
                low, high = self.range((y, *inside, end))
                part[b] = p.fma(high - low, factor - 1.0, y)
        self.evaluate(WIDE, self.time, self.state, self.lines["coarse"])
        self.evaluate(LANES, self.own.t, self.part_state, self.lines["moved"])

    def moved(self, place: Any) -> Real:
        """Return the factor by which an entry of the state is moved, or with -1 the time."""
        found: Real = self.factors[self.dimension if place == -1 else place]
        return found

    def instants(self, t: Real, end: Real, thetas: Sequence[float]) -> list[Real]:
        """Return the times at places in a step, whose ends are as they are."""
        return [t, *(self.p.fma(end - t, theta, t) for theta in thetas[1:-1]), end]

    def path(self, c: Memory, b: Whole, thetas: Sequence[float]) -> list[Real]:
        """Return an entry of the state in a column at places in the step."""
        p = self.p
        top = c.at(self.degree * self.total)[b]
        sums = [p.variable(top) for _ in thetas]
        with p.loop(0, self.degree) as k:
            coefficient = c.at((self.degree - 1 - k) * self.total)[b]
            for one, theta in zip(sums, thetas, strict=True):
                one.value = p.fma(one.value, theta, coefficient)
        return [one.value for one in sums]

    def range(self, values: Sequence[Real]) -> tuple[Real, Real]:
        """Return the least and the largest of some numbers; what is NaN is left out."""
        low = high = values[0]
        for value in values[1:]:
            low, high = self.p.choose(value < low, value, low), self.p.choose(value > high, value, high)
        return low, high

    def evaluate(self, columns: int, t: Memory, y: Memory, out: Memory) -> None:
        """Evaluate the events on columns."""
        half = self.dimension // 2 * columns
        singular = self.kernel(columns, t, y, y.at(half), self.parameters, out)
        self.bad.value = self.bad.value | (singular >= 0)

    def edge(self, value: Real, moved: Real) -> Real:
        """Return by how much an event may be wrong for the rounding of an accepted state."""
        found = abs(moved - value) * (NOISE / RELATIVE_PERTURBATION)
        return self.p.real(self.p.choose(found < math.inf, found, 0.0))

    def owed(self, values: Sequence[Real], moved: Real) -> Real:
        """Return by how much an event may be wrong on a step for the round-off of its dense output.

        It owes that to the motion of the state: x**2 + v**2 may stay as it is while x and v do not.
        """
        p = self.p
        low, high = self.range(values)
        spread, gain = high - low, abs(moved - values[0]) * (1.0 / RELATIVE_PERTURBATION)
        most = p.choose(spread.equals(spread) & ~(gain > spread), spread, gain)
        return p.real(p.choose(most < math.inf, DENSE_ROUND_OFF * most, 0.0))

    def begin_at_zero(self, first: Whole) -> None:
        """Leave it to others where the motion starts at a zero of an event."""
        p = self.p
        with p.when(self.starts & first.equals(self.begin), likely=False), p.loop(0, self.events) as e:
            values = self.lines["coarse"].at(e * WIDE)
            start = values[0]
            size = p.larger(self.edge(start, values[(COARSE + 1) * LANES]), 4.0 * self.stayed[e])
            p.leave_if(~(abs(start) > size), first, self.found.value)

    # --- what some steps take

    def settle(self, first: Whole) -> None:
        """Go through the steps of a block in order, and isolate the zeros of the events that may vanish."""
        p = self.p
        resolved = p.variable(p.false, "resolved")
        with p.loop(0, p.smaller(self.end - first, LANES)) as b:
            watched = p.variable(p.false, "watched")
            with p.loop(0, self.events) as e:
                watched.value = watched.value | self.may_vanish(b, e)
            with p.when(watched.value):
                with p.when(~resolved.value):
                    self.sample_fully()
                    resolved.value = p.true
                self.visit((first + b).called("step"), b)

    def may_vanish(self, b: Whole, e: Whole) -> Flag:
        """Whether an event may vanish on a step, or its side is not settled."""
        doubtful = ~self.lines["doubtful"][e * LANES + b].equals(0.0)
        return Flag.of(doubtful | self.sign[e].equals(0) | ~self.near[e].equals(0))

    def sample_fully(self) -> None:
        """Write the Chebyshev coefficients of the events on a block at the full degree."""
        p, thetas = self.p, nodes().tolist()
        with p.each(LANES, width=LANES) as b:
            for k, time in enumerate(self.instants(self.own.t[b], self.t_end[b], thetas)):
                self.time.at(k * LANES)[b] = time
        with p.loop(0, self.dimension) as j:
            to, own, new = self.state.at(j * FULL), self.own.y.at(j * LANES), self.own.new.at(j * LANES)
            with p.each(LANES, width=LANES) as b:
                inside = self.path(self.c.at(j * LANES), b, thetas[1:-1])
                for k, value in enumerate((own[b], *inside, new[b])):
                    to.at(k * LANES)[b] = value
        self.evaluate(FULL, self.time, self.state, self.lines["fine"])
        with p.loop(0, self.events) as e:
            values, to, size = (
                self.lines[name].at(e * n) for name, n in (("fine", FULL), ("chebyshev", FULL), ("size", LANES))
            )
            with p.each(LANES, width=LANES) as b:
                found = [values.at(k * LANES)[b] for k in range(DEGREE + 1)]
                for k, value in enumerate(transform(p, found)):
                    to.at(k * LANES)[b] = value
                size[b] = reduce(p.magnitude, found)

    def visit(self, step: Whole, b: Whole) -> None:
        """Isolate the zeros on a step. What is irregular leaves everything as it was in front of it."""
        p, before = self.p, self.found.value
        known = self.sign, self.near, self.remaining
        with p.loop(0, self.events) as e:
            for now, after in zip(known, self.after, strict=True):
                after[e] = now[e]
            with p.when(self.may_vanish(b, e)):
                self.isolate(step, b, e, before)
        with p.loop(0, self.events) as e:
            for now, after in zip(known, self.after, strict=True):
                now[e] = after[e]

    def isolate(self, step: Whole, b: Whole, e: Whole, before: Whole) -> None:
        """Isolate the zeros of one event on a step, which is halved until it is a polynomial on each part."""
        p, (starts, widths, tails) = self.p, self.stack
        last, place = step.equals(self.last), e * LANES + b
        noise = p.variable(self.lines["noise"][place], "noise")
        with p.when(last, likely=False):
            noise.value = p.larger(noise.value, self.lines["edge_end"][place] * self.rounded)
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
                p.leave_if(hopeless | self.bad.value, step, before)
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
        size = p.variable(self.lines["size"][e * LANES + b], "size")
        with p.when(width.equals(1.0), likely=True) as ways:
            known = self.lines["chebyshev"].at(e * FULL + b)
            with p.loop(0, DEGREE + 1) as k:
                self.coefficients[k] = known[k * LANES]
        with ways.otherwise():
            self.sample_part(b, start, width)
            size.value = p.call(chebyshev(), self.lines["part"].at(e * PART), self.coefficients)
        return p.real(size.value)

    def sample_part(self, b: Whole, start: Real, width: Real) -> None:
        """Evaluate the events at the nodes of a part of a step."""
        p, t = self.p, self.own.t[b]
        h = self.t_end[b] - t
        with p.each(PART, width=LANES) as k:
            self.part_time[k] = p.fma(h, p.fma(width, self.nodes[k], start), t)
        with p.loop(0, self.dimension) as j:
            c, to = self.c.at(j * LANES + b), self.part_state.at(j * PART)
            with p.each(PART, width=LANES) as k:
                theta, total = p.fma(width, self.nodes[k], start), p.variable(c[self.degree * self.total])
                with p.loop(0, self.degree) as power:
                    total.value = p.fma(total.value, theta, c[(self.degree - 1 - power) * self.total])
                to[k] = total.value
        self.evaluate(PART, self.part_time, self.part_state, self.lines["part"])

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
        t = self.own.t[b]
        self.when[found] = t + s * (self.t_end[b] - t)
        with p.loop(0, self.dimension) as j:
            c = self.c.at(j * LANES + b)
            total = p.variable(c[self.degree * self.total])
            with p.loop(0, self.degree) as k:
                total.value = p.fma(total.value, s, c[(self.degree - 1 - k) * self.total])
            self.there[found * self.dimension + j] = total.value
        self.found.value = found + 1
