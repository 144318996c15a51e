"""Zeros of an event function that is a polynomial on each step: each root once, in order, with its direction.

The contract is that of a relay. A sign counts once it is beyond the noise, a crossing is reported by the step in
which the opposite sign first counts, and a touch by the step in which g, having come within its noise of zero,
counts again with the sign it had. So crossings alternate over a whole run, a root at a joint is reported once
whatever the round-off on its two sides (by the later step, at time 0), and g that stays clear of zero by more than
its noise has no root. Roots so close that g stays within its noise between them are one: two of them a touch,
three a crossing. Measured on h = 1: two roots by themselves merge when closer than 1e-7 to 2e-7, three at spacings
below 2e-5 to 5e-5; of roots strewn over the whole step, double coefficients keep up to 8 apart, 12 in six cases of ten,
and never 16. A simple root is refined to the round-off of g divided by its slope. The two steps that meet at a joint
must agree on g there within their noise.

Descartes' rule counts the roots by the signs of the Bernstein coefficients; a part of the step where they may stand
for more than one is halved.
Source: J. M. Lane, R. F. Riesenfeld, Bounds on a polynomial, BIT 21 (1981), 112-117.
"""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.events.constants import DEEPEST, MOST_COEFFICIENTS, NARROWEST, SURELY, TOO_MANY, UNFIT
from lagrange.algorithm.events.halving import bernstein, halve, sign_of, signs
from lagrange.algorithm.events.polynomial import PADDED, passage, slope_at_end, turn, value
from lagrange.algorithm.events.scaling import scaled
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Real, Whole


@shared
def roots() -> Procedure:
    """Return the procedure that finds the roots of sum c[k] tau**k for tau from 0 to h, as the integration meets them.

    `sign` and `near` are the side of zero before the step, and are returned for its end. `sign` is the last sign beyond
    doubt, 1 or -1. It is 0 if there was none: g starts here, and a root at the start is not an event. `near` is true if
    g has come to zero within its noise since then. `noise`, in the units of g, is the error of g besides the round-off
    of its coefficients. `last` is true if no step follows: the slope then decides a root at the very end.

    `times` and `rising` take up to `room` roots: tau, and 1 where g rises with the integration, -1 where it falls, 0
    where it turns back. The first result is their number: -1 if a coefficient is not finite, -2 if there are more than
    `room`. In both cases the other results are undefined.
    """
    return _Roots().build()


class _Roots:
    """Builds the procedure."""

    def __init__(self) -> None:
        self.p = p = Builder("roots", "Find where a polynomial on a step passes through zero or touches it.")
        self.coefficients, self.count = p.array("coefficients", read=True), p.given("count", WHOLE)
        self.h, self.noise = p.given("h", REAL), p.given("noise", REAL)
        self.before, self.came_near = p.given("sign", WHOLE), p.given("near", FLAG)
        self.last = p.given("last", FLAG)
        self.times, self.rising = p.array("times"), p.array("rising", WHOLE)
        self.room = p.given("room", WHOLE)

    def build(self) -> Procedure:
        p = self.p
        self.c = p.reserve(PADDED, name="c")
        given = self.coefficients, self.count, self.h, self.noise
        self.doubt, others, rates, end = p.call(scaled(), *given, self.c)
        self.doubt.called("doubt"), others.called("others"), rates.called("rates"), end.called("end")
        with p.when(~(self.doubt < math.inf), likely=False):
            p.leave(UNFIT, self.before, self.came_near)
        self.start()
        self.parts = p.reserve((DEEPEST + 1) * MOST_COEFFICIENTS, name="parts")
        self.part, self.sign_there = p.variable(0, "part"), p.variable(sign_of(p, end, self.doubt), "sign_there")
        self.reached = p.variable(self.first, "reached")
        self.decided, self.size = p.variable(p.true, "decided"), p.variable(0.0, "size")
        # All but the first coefficient cannot outweigh it: no root. The slope keeps its sign: one at most.
        clear = abs(self.c[0]) > SURELY * (others + self.doubt)
        monotonic = 2.0 * abs(self.c[1]) > SURELY * rates
        with p.when(~(clear | monotonic)):
            p.call(bernstein(), self.c, self.count, self.parts)
            self.judge(self.first)
        self.isolate()
        self.finish()
        return p.finish(WHOLE, WHOLE, FLAG)

    def start(self) -> None:
        """Begin at the start of the step, on the side that the step before left."""
        p = self.p
        slope = p.real(self.before) * self.c[1]
        leaving = (slope >= 0.0).called("leaving")
        self.first = sign_of(p, self.c[0], self.doubt).called("first")
        zero = self.first.equals(0)
        # Without `near`, a root that g leaves at a joint was counted by the step before; one that it comes to is new.
        # With it, a start that counts and leaves is a touch at the joint, and one still on its way there is not yet.
        fresh = p.choose(zero, self.came_near | ~leaving, self.came_near & leaving).called("fresh")
        self.found, self.sign = p.variable(0, "found"), p.variable(self.before, "side")
        self.low, self.near = p.variable(0.0, "low"), p.variable(fresh, "close")
        self.near_at, self.depth = p.variable(0.0, "close_at"), p.variable(p.real(self.before) * self.c[0], "depth")
        self.counted = p.variable(zero & ~fresh, "counted")
        with p.when(~zero):
            self.count_sign(p.constant(0.0, REAL), self.first)

    def isolate(self) -> None:
        """Go through the parts of the step in order, and halve those that are not decided."""
        p, count = self.p, self.count
        starts, depths = p.reserve(DEEPEST + 1, name="starts"), p.reserve(DEEPEST + 1, name="widths")
        starts[0], depths[0] = 0.0, 1.0
        with p.repeat(lambda: self.part.value >= 0):
            part = self.part.value
            begin, width = starts[part].called("begin"), depths[part].called("width")
            half = (width * 0.5).called("half")
            # At the edge of its noise a function would be halved everywhere, for its round-off: hence the factor 2.
            narrow = (width <= NARROWEST) | (self.size.value <= 2.0 * self.doubt)
            with p.when(self.decided.value | narrow, likely=True) as ways:
                with p.when(~self.decided.value, likely=False):
                    self.come_near(begin + half)
                self.reached.value = self.sign_there.value
                self.reach((begin + width).called("place"), self.reached.value)
                self.part.value = part - 1
            with ways.otherwise():
                right = self.parts.at(part * MOST_COEFFICIENTS)
                p.call(halve(), right, count, self.parts.at((part + 1) * MOST_COEFFICIENTS))
                starts[part], starts[part + 1] = begin + half, begin
                depths[part], depths[part + 1] = half, half
                self.part.value = part + 1
            with p.when(self.part.value >= 0, likely=False):
                self.judge(self.reached.value)

    def judge(self, first: Whole) -> None:
        """Set, for the present interval, whether it is decided, its last sign, and the size of its coefficients."""
        b = self.parts.at(self.part.value * MOST_COEFFICIENTS)
        decided, there, size = self.p.call(signs(), b, self.count, first, self.doubt)
        self.decided.value, self.sign_there.value, self.size.value = decided, there, size

    def reach(self, place: Real, sign: Whole) -> None:
        """Meet the sign at the end of a part."""
        with self.p.when(sign.equals(0), likely=False) as ways:
            self.come_near(place)
        with ways.otherwise():
            self.count_sign(place, sign)

    def come_near(self, place: Real) -> None:
        """Note a place within the noise; the one where g is least on its side, or farthest beyond, is kept."""
        p = self.p
        with p.when(~self.counted.value):
            depth = p.real(self.sign.value) * p.call(value(), self.c, self.count, place)
            with p.when(~self.near.value | (depth < self.depth.value)):
                self.depth.value, self.near_at.value = depth, place
            self.near.value = p.true

    def count_sign(self, place: Real, sign: Whole) -> None:
        """Count a sign beyond the noise: after the other one it is a crossing, after the same a touch or nothing."""
        p, before = self.p, self.sign.value
        with p.when(sign.equals(-before)):
            self.report(p.call(passage(), self.c, self.count, self.low.value, place, sign), sign)
        with p.when(sign.equals(before) & self.near.value, likely=False):
            self.report(self.turn(place), 0)
        self.sign.value, self.low.value = sign, place
        self.near.value, self.counted.value = p.false, p.false

    def turn(self, high: Real) -> Real:
        """Return where g turns back between the place where it last counted and another."""
        where = self.low.value, self.near_at.value, high
        found: Real = self.p.call(turn(), self.c, self.count, *where, self.depth.value, self.sign.value, self.doubt)
        return found

    def report(self, place: Real, rising: Any) -> None:
        """Write a root."""
        p, found = self.p, self.found.value
        with p.when(found >= self.room, likely=False):
            p.leave(TOO_MANY, self.before, self.came_near)
        self.times[found], self.rising[found] = self.h * place, rising
        self.found.value = found + 1

    def finish(self) -> None:
        """Decide what the end of a run leaves open: a crossing if g is still on its way to zero."""
        p, sign = self.p, self.sign
        near = (self.near.value & ~sign.value.equals(0)).called("near_at_end")
        with p.when(near & self.last, likely=False):
            onward = p.real(sign.value) * p.call(slope_at_end(), self.c, self.count) < 0.0
            with p.when(onward) as ways:
                self.report(p.constant(1.0, REAL), -sign.value)
            with ways.otherwise():
                self.report(self.turn(p.constant(1.0, REAL)), 0)
        p.leave(self.found.value, sign.value, near)
