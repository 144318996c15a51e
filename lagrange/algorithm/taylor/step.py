"""One Taylor step from its series: its length, the choice of the scale of time, and its end."""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.projection import project
from lagrange.algorithm.step.constants import EARLIEST, NEAR_END, SPACING
from lagrange.algorithm.taylor.constants import (
    FIRST_SCALE_RATIO,
    LARGEST_SCALE_RATIO,
    LONGER_SCALE,
    MOST_RESCALINGS,
    OVERFLOWED,
    SHORTER_SCALE,
    SHORTEST_SCALE,
    STEP_GROWTH,
)
from lagrange.algorithm.taylor.defect_test import defect_along_step, reject_step, retries_exhausted, retry_shorter
from lagrange.algorithm.taylor.event_series import doubtful_events
from lagrange.algorithm.taylor.events_on_step import GO_ON, WAIT, inspect_step
from lagrange.algorithm.taylor.memory import BLOCK, TAYLOR, TaylorLayout
from lagrange.algorithm.taylor.resets import begin_sides, cross_surface, reset_state
from lagrange.algorithm.taylor.step_size import ends, logarithm, power, raise_floors
from lagrange.algorithm.taylor.sums import advance, outstanding, write_outputs
from lagrange.algorithm.taylor.watching import Arguments, Watched, restore_sides
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Real


@shared
def take_step(layout: TaylorLayout) -> Procedure:
    """Return the procedure that takes a step, or changes its scale or limit; PAUSED if the run continues."""
    return _TaylorStep(layout).build()


class _TaylorStep:
    """Builds the procedure; `exponent` is the binary logarithm of the step that the series allows, in its scale."""

    def __init__(self, layout: TaylorLayout) -> None:
        self.p = p = Builder("take_step", "Take a step, or prepare another try, and return an outcome.")
        self.given = given = Arguments(p, layout, exponent=REAL)
        self.layout, self.series = layout, given.series
        self.run, self.counts, self.taylor, self.held = given.run, given.counts, given.taylor, given.held
        self.exponent: Real = given.own[0]
        self.t: Real = self.run.t.called("t")
        self.low: Real = self.taylor.low.called("low")
        self.scale: Real = self.taylor.scale.called("scale")
        self.left = ((self.run.end - self.t) - self.low).called("left")
        self.ends = ends(self.series, self.exponent).called("ends")

    def build(self) -> Procedure:
        p = self.p
        if self.given.watched:
            self.begin(self.given.watched)
            self.reset(self.given.watched)
        longest = p.smaller(abs(self.left), self.run.longest)
        reach = p.call(logarithm(), longest / abs(self.scale)).called("reach")
        with p.when(~self.fits(reach), likely=False):
            p.leave(p.call(rescale(), self.taylor, self.exponent, reach, self.ends))
        s, whole, final = self.length()
        h = p.choose(final, self.left, s * self.scale).called("h")
        self.run.h = h
        if self.given.watched:
            s, h, final = self.inspect(self.given.watched, s, h, final)
        self.probe(s, h)
        p.call(raise_floors(self.layout), self.run.share, self.given.floors, self.series.work)
        # A series that terminates does not estimate the next one.
        whole = p.choose(whole > LARGEST_SCALE_RATIO, 0.0, whole)
        longer = p.operation("two_to", p.whole(whole)).called("longer")
        p.leave_if(~p.call(advance(self.layout), s, longer, *self.series.handed), Outcome.NON_FINITE, likely=False)
        self.move_on(h, final)
        if self.layout.projected:
            self.project()
        self.write_outputs()
        self.taylor.scale = self.scale * longer
        p.leave(Outcome.PAUSED)
        return p.finish(WHOLE)

    def fits(self, reach: Real) -> Flag:
        """Return whether the step is near the scale of time, so that all coefficients are in the range of doubles.

        A series that terminates fits if the scale is as long as any step may be. After `MOST_RESCALINGS` changes any
        scale is accepted.
        """
        p, exponent, tries = self.p, self.exponent, self.taylor.rescalings
        first = (self.counts.steps + tries).equals(0)
        near = abs(exponent) < p.choose(first, FIRST_SCALE_RATIO, LARGEST_SCALE_RATIO)
        whole = self.ends & (reach < 1.0)
        found: Flag = near | whole | ((tries >= MOST_RESCALINGS) & exponent.equals(exponent))
        return found

    def length(self) -> tuple[Real, Real, Flag]:
        """Return the step in units of the scale, its natural exponent rounded, and whether it is the last.

        Operations that do not need the coefficients come first: processors run them before the last coefficient is
        available.
        """
        p, run, taylor = self.p, self.run, self.taylor
        inverse = (1.0 / abs(self.scale)).called("inverse")
        whole_way = (abs(self.left) * inverse).called("whole_way")
        own = p.smaller(run.longest, taylor.limit).called("own")
        bound = p.smaller(p.smaller(own, taylor.next_limit) * inverse, whole_way).called("bound")
        spacing = p.larger(abs(self.t), EARLIEST) * SPACING
        natural, whole = p.call(power(), self.exponent)
        natural.called("natural"), whole.called("whole")
        bounded = natural * NEAR_END >= bound
        s = p.choose(bounded, bound, natural).called("s")
        final: Flag = (bounded & bound.equals(whole_way)).called("final")
        wanted = p.smaller(natural, own * inverse)
        p.leave_if((wanted < spacing * inverse) & ~final, Outcome.STEP_TOO_SMALL, likely=False)
        return s, whole, final

    def probe(self, s: Real, h: Real) -> None:
        """Try a shorter step if a terminating series does not satisfy the equations along a longer one.

        An event may have shortened the step enough. Otherwise the results of the inspection are undone.
        """
        p, run, series = self.p, self.run, self.series
        with p.when(
            self.ends & (abs(h) > STEP_GROWTH * abs(self.held.h)) & ~retries_exhausted(self.taylor), likely=False
        ):
            jet = self.given.jet, *self.given.numbers
            numbers = run.rtol, self.given.floors, self.t, self.scale, s
            with p.when(~p.call(defect_along_step(self.layout), *jet, *numbers, *series.handed)):
                p.call(retry_shorter(), self.counts, self.taylor, h)
                if self.given.watched:
                    restore_sides(self.given.watched)
                p.leave(Outcome.PAUSED)

    def begin(self, watched: Watched) -> None:
        """Find the sides where a motion begins, before the scale of time is fitted to its step."""
        p = self.p
        with p.when(~watched.record.fresh.equals(0), likely=False):
            numbers = self.t, self.scale, self.run.rtol
            begun = p.call(begin_sides(), *numbers, *watched.handed, *self.series.handed)
            p.leave_if(~begun, Outcome.WATCHED)

    def reset(self, watched: Watched) -> None:
        """Apply the reset or crossing that is due at the state, if that can be done here."""
        p, given, record = self.p, self.given, watched.record
        if self.layout.observes:
            p.leave_if(~record.due.equals(0), Outcome.WATCHED, likely=False)
            return
        with p.when(~record.due.equals(0) & ~record.enabled.equals(0), likely=False):
            records, kept = (self.t, self.run.rtol, self.counts, self.taylor), (*watched.handed, *self.series.handed)
            done = p.variable(p.false, "done")
            with p.when(watched.is_event(record.due - 1)) as ways:
                written = given.times, given.rows
                done.value = p.call(reset_state(), given.jet, *given.numbers, *records, *written, *kept)
            with ways.otherwise():
                jet = given.jet, given.prepared, given.constants
                done.value = p.call(cross_surface(), *jet, *records, *kept)
            p.leave_if(done.value, Outcome.PAUSED)

    def inspect(self, watched: Watched, s: Real, h: Real, final: Flag) -> tuple[Real, Real, Flag]:
        """Find zeros on the step; return its new length, in both units, and whether it is the last.

        Return to the caller if that cannot be decided here.
        """
        p, series = self.p, self.series
        doubtful = p.reserve(self.layout.watched, room=BLOCK, name="doubtful")
        every = ~self.taylor.inspect.equals(0)
        some: Flag = p.call(doubtful_events.form(layout=self.layout), s, every, doubtful, *series.handed)
        taken = p.variable(s, "taken")
        with p.when(some & self.taylor.next_limit.equals(math.inf), likely=False):
            record = watched.record
            here = ~record.enabled.equals(0) & record.due.equals(0) & (record.planned <= self.counts.steps)
            p.leave_if(~here, Outcome.WATCHED)
            numbers = self.t, self.low, self.scale, self.run.rtol, s, self.left, final
            given = *numbers, doubtful, self.taylor, *watched.handed, *series.handed
            answer, shorter = p.call(inspect_step(), *given)
            p.leave_if(answer.equals(WAIT), Outcome.PAUSED)
            p.leave_if(~answer.equals(GO_ON), Outcome.WATCHED)
            taken.value = shorter
        whole: Flag = taken.value.equals(s)
        length = p.choose(whole, h, taken.value * self.scale)
        self.run.h = length
        return taken.value, length, final & whole

    def move_on(self, h: Real, final: Flag) -> None:
        """Advance the time with compensation, and store the beginning of the step."""
        p, run, taylor, held = self.p, self.run, self.taylor, self.held
        held.t, held.low, held.scale, held.h = self.t, self.low, self.scale, h
        held.unproven = 1
        added = h + self.low
        total = self.t + added
        back = total - self.t
        lost = (self.t - (total - back)) + (added - back)
        run.t = p.choose(final, run.end, total)
        taylor.low = p.choose(final, 0.0, lost)
        taylor.next_limit = math.inf
        taylor.rescalings = 0

    def project(self) -> None:
        """Project the compensated state onto the constraints; if that fails, try a shorter step."""
        p, layout, work = self.p, self.layout, self.series.work
        state, lost = work.at(0), work.at(layout.lost)
        outcome, _ = p.call(
            project.form(dimension=layout.dimension, block=layout.block),
            *self.given.projection,
            self.run.t,
            state,
            lost,
        )
        with p.when(outcome.equals(Outcome.UNPROJECTED), likely=False):
            p.leave_if(retries_exhausted(self.taylor), outcome)
            p.call(reject_step(layout), self.run, self.counts, self.taylor, self.held, work)
            if self.given.watched:
                restore_sides(self.given.watched)
            p.leave(Outcome.PAUSED)

    def write_outputs(self) -> None:
        """Write the states at the output times on the step, if there are any."""
        p, given, outputs, end = self.p, self.given, self.given.outputs, self.run.t
        outputs.ahead = outputs.done
        with p.when(outstanding(given.output_times, outputs.done, end, self.scale), likely=False):
            p.call(write_outputs(self.layout), end, self.held, *given.output, *self.series.handed)


@shared
def rescale() -> Procedure:
    """Return the procedure that changes the scale of time to the step's own, for another series.

    The scale becomes shorter if a coefficient overflowed, and longer, up to the longest step, if the last coefficients
    are zero.
    """
    p = Builder("rescale", "Choose another scale of time, and return an outcome.", apart=True)
    taylor: Any = p.record("taylor", TAYLOR)
    exponent, reach, terminates = p.given("exponent", REAL), p.given("reach", REAL), p.given("terminates", FLAG)
    tries, scale = taylor.rescalings, taylor.scale
    p.leave_if((tries >= MOST_RESCALINGS) | (abs(scale) < SHORTEST_SCALE), Outcome.NON_FINITE)
    taylor.rescalings = tries + 1
    longer = p.choose(terminates, p.smaller(reach, LONGER_SCALE), exponent)
    change = p.choose(exponent >= OVERFLOWED, longer, SHORTER_SCALE)
    taylor.scale = scale * p.operation("two_to", p.whole(p.operation("round", change)))
    p.leave(Outcome.PAUSED)
    return p.finish(WHOLE)
