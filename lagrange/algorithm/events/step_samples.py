"""Samples of events along a block of steps, and which of them they leave in doubt."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

from lagrange.algorithm.dense.block import COLUMNS, LANES, POLYNOMIAL, steps_in
from lagrange.algorithm.dense.evaluate import gather
from lagrange.algorithm.events.chebyshev import COARSE, DEGREE, nodes
from lagrange.algorithm.events.constants import DENSE_ROUND_OFF, NOISE
from lagrange.algorithm.events.resolution import keeps_sign, transform
from lagrange.algorithm.step.constants import RELATIVE_PERTURBATION
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import WHOLE
from lagrange.procedure.front.building import Tracer
from lagrange.procedure.values import Flag, Memory, Real, Whole

Written = Callable[..., Any]
"""A function of the builder's values: a parameter of the procedure, or a procedure that is called."""

SLOPE_AT = 0.5 - 12**-0.5
"""Point of the largest slope of s**2 (1 - s)**2."""

MISSED = 1 / 16 / (2 * SLOPE_AT * (1 - SLOPE_AT) * (1 - 2 * SLOPE_AT))
"""The largest value of s**2 (1 - s)**2 in units of its largest slope."""

SAFELY = 4.0
"""Safety factor of the estimated error of a cubic; like all noise it is multiplied by four as well."""

UNRESOLVED = 0.02
"""A cubic that misses more than this part of how far an entry of the state moves says nothing of a step."""


class Widths(NamedTuple):
    """At how many columns a block of steps is sampled.

    `wide` are those at first, at the nodes and moved by rounding at both ends, `full` those of the full degree, and
    `part` those of a part of one step.
    """

    wide: int
    full: int
    part: int

    @classmethod
    def of(cls, columns: int) -> Widths:
        """Return the widths for blocks of `columns` steps."""
        return cls((COARSE + 3) * columns, (DEGREE + 1) * columns, (DEGREE // columns + 1) * columns)


def work_size(dimension: int, events: int, columns: int = LANES) -> int:
    """Return the number of doubles of work memory of the review, for blocks of `columns` steps."""
    widths = Widths.of(columns)
    lines = widths.wide + 2 * widths.full + widths.part + 6 * columns
    return 2 * columns + (widths.full + widths.part) * (dimension + 1) + lines * events + LANES


class Samples:
    """The arguments of a procedure that samples events, with its memory, and what it does with a block of steps.

    Vectors are by columns, as in `dense.block`; so are the lines of events. `places` are the steps of the block, and
    `lines` have the bounds of each event on them. `written` is true for a procedure that takes steps: they are outputs.
    """

    columns = LANES
    """The steps of a block."""

    def __init__(self, p: Builder, *, written: bool = False) -> None:
        self.p = p
        self.polynomial: Written = p.function("polynomial", POLYNOMIAL)
        self.given: Memory = p.array("given", read=True)
        self.degree, self.both = p.given("degree", WHOLE), p.given("both", WHOLE)
        self.screen: Written = p.function("screen", POLYNOMIAL)
        self.screen_given: Memory = p.array("screen_given", read=True)
        self.law: Written = p.function("law", COLUMNS)
        self.law_parameters: Memory = p.array("law_parameters", read=True)
        self.own_memory, self.beside = p.array("own", room=LANES), p.array("beside", room=LANES)
        self.path_work, self.c = p.array("path_work", room=LANES), p.array("c", room=LANES)
        self.kernel: Written = p.function("kernel", COLUMNS)
        self.parameters: Memory = p.array("parameters", read=True)
        self.dimension, self.events = p.given("dimension", WHOLE), p.given("events", WHOLE)
        self.factors, self.work = p.array("factors", read=True), p.array("work", room=LANES)
        self.times, self.states = (p.array(name, read=not written) for name in ("times", "states"))
        self.steps: Whole = p.given("steps", WHOLE)

    def handed(self, times: Memory, states: Memory, steps: Whole) -> tuple[Any, ...]:
        """Return the arguments for another procedure, with steps of its own."""
        screen = self.screen, self.screen_given, self.law, self.law_parameters
        memory = self.own_memory, self.beside, self.path_work, self.c
        path = self.polynomial, self.given, self.degree, self.both, *screen, *memory
        events = self.kernel, self.parameters, self.dimension, self.events, self.factors, self.work
        return (*path, *events, times, states, steps)

    def lay_out(self) -> None:
        """Give everything its place in memory."""
        p = self.p
        self.widths = Widths.of(self.columns)
        self.bad = p.variable(p.false, "bad")
        self.total = (self.dimension * self.columns).called("total")
        self.own = Tracer(p, ()).call(steps_in, self.own_memory, self.dimension, p.whole(self.columns))
        self.t_end, self.far, self.time = (self.work.at(self.columns * k) for k in range(3))
        wide, full, part = self.widths
        self.state = self.time.at(full)
        self.part_time = self.state.at(self.dimension * full)
        self.part_state = self.part_time.at(part)
        lines = self.part_state.at(self.dimension * part)
        names = dict.fromkeys(("missed", "noise", "edge_end", "moved", "doubtful", "size"), self.columns)
        names |= {"coarse": wide, "fine": full, "chebyshev": full, "part": part}
        self.lines: dict[str, Memory] = {}
        for name, columns in names.items():
            self.lines[name], lines = lines, lines.at(self.events * columns)
        self.places = p.reserve(self.columns, WHOLE, name="places")
        self.nodes = p.reserve(self.widths.part, room=LANES, name="nodes")
        for k, node in enumerate(nodes().tolist()):
            self.nodes[k] = node
        with p.loop(DEGREE + 1, self.widths.part) as spare:
            self.nodes[spare] = 1.0

    def follow(self) -> None:
        """Write the path of the steps of a block, and say which events may vanish on it."""
        self.gather(self.both)
        self.polynomial(self.given, self.columns, self.own_memory, self.beside, self.path_work, self.c)
        self.bad.value = self.p.false
        self.look(self.degree, screening=False)

    def sift(self) -> None:
        """Say of a block of steps which events may vanish, by the cubics through their ends and by their defects.

        A cubic misses K s**2 (1 - s)**2 of the path, its slope most at `SLOPE_AT`: what that misses there tells K.
        """
        p = self.p
        self.gather(0)
        self.screen(self.screen_given, self.columns, self.own_memory, self.beside, self.path_work, self.c)
        with self.p.each(self.columns, width=self.columns) as b:
            self.time[b] = p.fma(self.own.h[b], SLOPE_AT, self.own.t[b])
        with p.loop(0, self.dimension) as j:
            to, c = (
                self.part_state.at(j * self.columns),
                [self.c.at(self.total * k).at(j * self.columns) for k in range(4)],
            )
            with p.each(self.columns, width=self.columns) as b:
                to[b] = p.fma(p.fma(p.fma(c[3][b], SLOPE_AT, c[2][b]), SLOPE_AT, c[1][b]), SLOPE_AT, c[0][b])
        y, slopes = self.part_state, self.state
        half = self.dimension // 2 * self.columns
        singular = self.law(self.columns, self.time, y, y.at(half), self.law_parameters, slopes)
        self.bad.value = singular >= 0
        with p.each(self.columns, width=self.columns) as b:
            self.far[b] = 0.0
        with p.loop(0, self.dimension) as j:
            to, c = (
                self.part_state.at(j * self.columns),
                [self.c.at(self.total * k).at(j * self.columns) for k in range(4)],
            )
            own, slope, factor = self.own.y.at(j * self.columns), slopes.at(j * self.columns), self.moved(j) - 1.0
            with p.each(self.columns, width=self.columns) as b:
                expected = p.fma(p.fma(3.0 * SLOPE_AT, c[3][b], 2.0 * c[2][b]), SLOPE_AT, c[1][b])
                missed = MISSED * abs(self.own.h[b] * slope[b] - expected)
                to[b] = p.fma(missed, factor, own[b])
                last = p.fma(p.fma(3.0, c[3][b], 2.0 * c[2][b]), 1.0, c[1][b])
                moves = p.larger(abs(c[3][b] + c[2][b] + c[1][b]), 0.25 * p.magnitude(c[1][b], last))
                far = ~(missed <= UNRESOLVED * moves + DENSE_ROUND_OFF * abs(own[b]))
                self.far[b] = p.choose(far, 1.0, self.far[b])
        self.evaluate(self.columns, self.own.t, self.part_state, self.lines["missed"])
        self.look(p.constant(3, WHOLE), screening=True)

    def gather(self, both: Any) -> None:
        """Gather the steps of a block."""
        p = self.p
        given = self.dimension, p.whole(self.columns), self.places, self.steps, self.times, self.states
        p.call(gather.form(), *given, both, self.own_memory, self.beside)
        with p.loop(0, self.columns) as b:
            self.t_end[b] = self.times[self.places[b] + 1]

    def look(self, degree: Whole, *, screening: bool) -> None:
        """Sample the events on a block of steps, and say which may vanish; what a screen misses is noise."""
        p, lines = self.p, self.lines
        self.sample_coarsely(degree)
        with p.loop(0, self.events) as e:
            values, moved = lines["coarse"].at(e * self.widths.wide), lines["moved"].at(e * self.columns)
            noise, edge_end, doubtful = (lines[name].at(e * self.columns) for name in ("noise", "edge_end", "doubtful"))
            with p.each(self.columns, width=self.columns) as b:
                found = [values.at(k * self.columns)[b] for k in range(COARSE + 3)]
                edge, end = (self.edge(found[k], found[COARSE + 1 + (k > 0)]) for k in (0, COARSE))
                edge_end[b] = end
                owed = self.owed(found[: COARSE + 1], moved[b])
                noise[b] = p.choose(edge > end, edge, end) + owed
                coefficients = Tracer(p, ()).call(transform, tuple(found[: COARSE + 1]))
                wrong = noise[b]
                if screening:
                    missed = lines["missed"].at(e * self.columns)[b]
                    wrong = wrong + abs(missed - found[0]) * (SAFELY / RELATIVE_PERTURBATION)
                    wrong = p.choose(self.far[b] > 0.0, math.inf, wrong)
                sure = Tracer(p, ()).call(keeps_sign, coefficients, wrong)
                doubtful[b] = p.choose(sure, 0.0, 1.0)

    def is_doubtful(self, b: Whole) -> Flag:
        """Return true if an event may vanish on a step."""
        p, found = self.p, self.p.variable(self.bad.value)
        with p.loop(0, self.events) as e:
            found.value = found.value | ~self.lines["doubtful"][e * self.columns + b].equals(0.0)
        return Flag.of(found.value)

    def sample_coarsely(self, degree: Whole) -> None:
        """Evaluate the events at few nodes, at ends that are moved by rounding, and where the range of a step says."""
        p, thetas = self.p, nodes(COARSE).tolist()
        with p.each(self.columns, width=self.columns) as b:
            t, end = self.own.t[b], self.t_end[b]
            for k, time in enumerate((*self.instants(t, end, thetas), t * self.moved(-1), end * self.moved(-1))):
                self.time.at(k * self.columns)[b] = time
        with p.loop(0, self.dimension) as j:
            to, factor = self.state.at(j * self.widths.wide), self.moved(j)
            own, new, part = (
                self.own.y.at(j * self.columns),
                self.own.new.at(j * self.columns),
                self.part_state.at(j * self.columns),
            )
            with p.each(self.columns, width=self.columns) as b:
                y, end = own[b], new[b]
                inside = self.path(self.c.at(j * self.columns), degree, b, thetas[1:-1])
                for k, value in enumerate((y, *inside, end, y * factor, end * factor)):
                    to.at(k * self.columns)[b] = value
                low, high = self.range((y, *inside, end))
                part[b] = p.fma(high - low, factor - 1.0, y)
        self.evaluate(self.widths.wide, self.time, self.state, self.lines["coarse"])
        self.evaluate(self.columns, self.own.t, self.part_state, self.lines["moved"])

    def moved(self, place: Any) -> Real:
        """Return the factor by which an entry of the state is moved, or with -1 the time."""
        found: Real = self.factors[self.dimension if place == -1 else place]
        return found

    def instants(self, t: Real, end: Real, thetas: Sequence[float]) -> list[Real]:
        """Return the times at places in a step, whose ends are as they are."""
        return [t, *(self.p.fma(end - t, theta, t) for theta in thetas[1:-1]), end]

    def path(self, c: Memory, degree: Whole, b: Whole, thetas: Sequence[float]) -> list[Real]:
        """Return an entry of the state in a column at places in the step."""
        p = self.p
        top = c.at(degree * self.total)[b]
        sums = [p.variable(top) for _ in thetas]
        with p.loop(0, degree) as k:
            coefficient = c.at((degree - 1 - k) * self.total)[b]
            for one, theta in zip(sums, thetas, strict=True):
                one.value = p.fma(one.value, theta, coefficient)
        return [one.value for one in sums]

    def range(self, values: Sequence[Real]) -> tuple[Real, Real]:
        """Return the least and the largest of some numbers, without NaN."""
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

        The error scales with the change of the state, not of the event function: x**2 + v**2 may be constant while x
        and v change.
        """
        p = self.p
        low, high = self.range(values)
        spread, gain = high - low, abs(moved - values[0]) * (1.0 / RELATIVE_PERTURBATION)
        most = p.choose(spread.equals(spread) & ~(gain > spread), spread, gain)
        return p.real(p.choose(most < math.inf, DENSE_ROUND_OFF * most, 0.0))

    def sample_fully(self) -> None:
        """Write the Chebyshev coefficients of the events on a block at the full degree."""
        p, thetas = self.p, nodes().tolist()
        with p.each(self.columns, width=self.columns) as b:
            for k, time in enumerate(self.instants(self.own.t[b], self.t_end[b], thetas)):
                self.time.at(k * self.columns)[b] = time
        with p.loop(0, self.dimension) as j:
            to, own, new = (
                self.state.at(j * self.widths.full),
                self.own.y.at(j * self.columns),
                self.own.new.at(j * self.columns),
            )
            with p.each(self.columns, width=self.columns) as b:
                inside = self.path(self.c.at(j * self.columns), self.degree, b, thetas[1:-1])
                for k, value in enumerate((own[b], *inside, new[b])):
                    to.at(k * self.columns)[b] = value
        self.evaluate(self.widths.full, self.time, self.state, self.lines["fine"])
        with p.loop(0, self.events) as e:
            values, to, size = (
                self.lines[name].at(e * n)
                for name, n in (("fine", self.widths.full), ("chebyshev", self.widths.full), ("size", self.columns))
            )
            with p.each(self.columns, width=self.columns) as b:
                found = [values.at(k * self.columns)[b] for k in range(DEGREE + 1)]
                for k, value in enumerate(Tracer(p, ()).call(transform, tuple(found))):
                    to.at(k * self.columns)[b] = value
                size[b] = reduce(p.magnitude, found)

    def sample_part(self, b: Whole, start: Real, width: Real) -> None:
        """Evaluate the events at the nodes of a part of a step."""
        p, t = self.p, self.own.t[b]
        h = self.t_end[b] - t
        with p.each(self.widths.part, width=self.columns) as k:
            self.part_time[k] = p.fma(h, p.fma(width, self.nodes[k], start), t)
        with p.loop(0, self.dimension) as j:
            c, to = self.c.at(j * self.columns + b), self.part_state.at(j * self.widths.part)
            with p.each(self.widths.part, width=self.columns) as k:
                theta, total = p.fma(width, self.nodes[k], start), p.variable(c[self.degree * self.total])
                with p.loop(0, self.degree) as power:
                    total.value = p.fma(total.value, theta, c[(self.degree - 1 - power) * self.total])
                to[k] = total.value
        self.evaluate(self.widths.part, self.part_time, self.part_state, self.lines["part"])
