"""The zeros of watched functions on a Taylor step, in order of time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.events.polynomial import PADDED
from lagrange.procedure.events.roots import roots
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.event_series import keeps_sign
from lagrange.procedure.taylor.event_terms import only_passage, only_zero, read_column
from lagrange.procedure.taylor.memory import SIZES, RecordedLayout, SeriesMemory, work_array
from lagrange.procedure.taylor.watching import (
    COLUMN,
    DIRECTION,
    MOST_ZEROS,
    RESET_SIZE,
    TERM_SUMS,
    Watched,
)
from lagrange.procedure.values import Memory, Real, Whole

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
            answer.value = p.call(only_zero(), s, self.memory.order, sign, self.noise[i], terms, sums)
        with ways.otherwise():
            self.read(i)
            with p.when(smooth):
                c, count = self.columns.at(i * COLUMN), self.counts[i]
                clear = p.call(keeps_sign(), c, count, s, self.noise[i], p.real(sign))
                answer.value = p.choose(clear, 0, answer.value)
        with p.when(answer.value.equals(2), likely=False) as ways:
            self.read(i)
            self.isolate(i, s, begins, near)
        with ways.otherwise(), p.when(~answer.value.equals(0)):
            to = self.found.value
            given = terms, self.slopes.at(i * PADDED), sums, self.memory.order, answer.value
            self.times[to] = s * p.call(only_passage(), *given)
            self.directions[to] = self.signs[i] = answer.value
            self.add(i, to, 1)

    def read(self, i: Whole) -> None:
        """Copy the series of a watched function on first use; leave if it is not finite."""
        p = self.p
        given = self.rows.at(i), self.layout.width, self.memory.order
        with p.when(~p.call(read_column(), *given, self.columns.at(i * COLUMN), self.counts.at(i)), likely=False):
            p.leave(-1)

    def isolate(self, i: Whole, s: Real, begins: Any, near: Any) -> None:
        """Find all zeros by root isolation.

        A function that starts at zero is divided by time: the root there is known, and the next may be close.
        """
        p, to, first = self.p, self.found.value, self.p.whole(begins)
        c, count, allowed = self.columns.at(i * COLUMN), self.counts[i], p.choose(begins, 0.0, self.noise[i])
        last = self.last & s.equals(self.step)
        given = c.at(first), count - first, s, allowed, self.before[i], near, last
        more, self.signs[i], after = p.call(roots(), *given, self.times.at(to), self.directions.at(to), MOST_ZEROS)
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
