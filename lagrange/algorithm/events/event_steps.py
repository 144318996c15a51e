"""The loop over the steps of a step program with events: take some, review them, go back to the first change.

A reset after which the motion leaves zero is applied here. Irregular events are left to the caller, with the steps that
wait for it.
"""

from __future__ import annotations

import math

from lagrange.algorithm.events.constants import AHEAD, CLOSE, LONGEST_LOOK, NOISE_HALVES
from lagrange.algorithm.events.event_reset import reset
from lagrange.algorithm.events.event_run import COUNTED, LOOK, MOST_STEPS, NUMBERS, READ_EVENTS, EventRun, count, number
from lagrange.algorithm.events.step_review import review
from lagrange.algorithm.events.step_zeros import CHANGED, CROWDED, ENDED
from lagrange.algorithm.outcome import Outcome
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real, Whole


@shared
def event_steps() -> Procedure:
    """Return the loop; it gives an `Outcome`, `LOOK` or `READ_EVENTS`.

    `Outcome.WATCHED` says that the state stands at a change of the motion that is due. The loop goes on where it ended:
    steps that the caller has reviewed in the meantime are not reviewed again.
    """
    return _EventSteps().build()


class _EventSteps:
    """Builds the procedure."""

    def __init__(self) -> None:
        self.p = p = Builder("event_steps", "Take steps up to what the events on them ask for, and return an outcome.")
        self.given = EventRun(p)
        self.run, self.review = self.given.run, self.given.review.record
        self.reals, self.counts = self.given.reals, self.given.counts

    def build(self) -> Procedure:
        p, run = self.p, self.run
        with p.repeat(lambda: p.constant(0, WHOLE).equals(0)):
            with p.when(run.begin > run.count):
                self.take()
            with p.when(run.begin <= run.count):
                why, step = self.look()
                p.leave_if(why.equals(CROWDED) & (self.review.found > 0), READ_EVENTS)
                p.leave_if(~why.equals(ENDED) & ~why.equals(CHANGED), LOOK)
                with p.when(why.equals(CHANGED)) as ways:
                    self.cut(step)
                    p.leave_if(~p.call(reset(), *self.given.handed), Outcome.WATCHED)
                with ways.otherwise():
                    self.accept()
        p.leave(Outcome.PAUSED)
        return p.finish(WHOLE)

    def take(self) -> None:
        """Take the next steps."""
        p, run, given = self.p, self.run, self.given
        t = self.reals[number("t")]
        p.leave_if(t.equals(self.reals[number("end")]), Outcome.DONE)
        first: Flag = (~run.both.equals(0) & run.before.equals(0)).called("first")
        waits = first & (run.left < 2) & (run.left < run.budget)
        p.leave_if((run.left <= 0) | waits, Outcome.PAUSED)
        p.leave_if(run.breaks >= run.break_room, READ_EVENTS)
        given.copy(self.reals, given.kept_reals, given.dimension + NUMBERS)
        given.copy(self.counts, given.kept_counts, COUNTED)
        given.times[1] = t
        given.copy(given.y, given.row(1), given.dimension)
        with p.loop(0, given.dimension) as i:
            given.driver_work[given.entries[i]] = given.y[i]
        run.rows, run.proven = self.counts[count("rows")], self.review.found
        self.counts[count("rows")] = 0
        tries: Whole = p.smaller(p.smaller(run.ahead, run.left), MOST_STEPS)
        tries = p.choose(first, p.larger(tries, p.smaller(2, run.left)), tries)
        outcome = p.variable(self.drive(tries), "outcome")

        def waiting() -> Flag:
            few: Flag = first & (run.left < run.budget - 1) & (self.counts[count("rows")] < 2)
            goes_on: Flag = few & outcome.value.equals(Outcome.PAUSED)
            return goes_on

        with p.repeat(waiting):
            outcome.value = self.drive(p.constant(1, WHOLE))
        with p.loop(0, given.dimension) as i:
            given.y[i] = given.driver_work[given.entries[i]]
        run.count, run.begin, run.outcome = self.counts[count("rows")], 1, outcome.value
        self.counts[count("rows")] = run.rows
        with p.when(run.count.equals(0)):
            run.ahead = p.smaller(run.ahead * 2, run.longest)
            p.leave_if(~outcome.value.equals(Outcome.PAUSED), outcome.value)

    def drive(self, tries: Whole) -> Whole:
        """Try a number of steps, and return their `Outcome`."""
        given = self.given
        self.run.left = self.run.left - tries
        rows: tuple[Memory, Memory] = given.times.at(2), given.row(2)
        found: Whole = given.drive(given.laws, self.reals, self.counts, given.driver_work, tries, *rows)
        return found

    def look(self) -> tuple[Whole, Whole]:
        """Review the steps that wait; return why that ended, and in front of which of them."""
        p, run, given, review_of = self.p, self.run, self.given, self.review
        shift: Whole = (1 - run.before).called("shift")
        steps: Whole = (run.count + 1 - shift).called("steps")
        review_of.begin, review_of.end = run.begin - shift, steps
        review_of.starts = p.choose(run.begin.equals(1), run.starts, p.whole(0))
        ends = given.times[run.count + 1].equals(run.final)
        review_of.last = p.choose(ends, steps - 1, p.whole(-1))
        taken = given.kept_counts[count("steps")] + run.count - 1
        review_of.rounded = p.real(taken) * (1.0 / NOISE_HALVES)
        path = given.times.at(shift), given.row(shift), steps
        why = p.call(review(), *given.samples.handed(*path), *given.review.handed).called("why")
        run.begin = review_of.step + shift
        run.starts = p.choose(run.begin > 1, p.whole(0), run.starts)
        return why, run.begin.called("step")

    def accept(self) -> None:
        """Write the steps as rows, and go on."""
        p, run, given = self.p, self.run, self.given
        self.write_rows(run.count)
        run.since, run.ahead = run.since + run.count, p.smaller(run.ahead * 2, run.longest)
        given.times[0] = given.times[run.count]
        given.copy(given.row(run.count), given.row(0), given.dimension)
        run.before, run.begin, run.count = 1, 1, 0
        p.leave_if(~run.outcome.equals(Outcome.PAUSED), run.outcome)

    def write_rows(self, kept: Whole) -> None:
        """Write the first `kept` waiting steps as rows of the run."""
        run, given = self.run, self.given
        given.copy(given.times.at(2), given.row_times.at(run.rows), kept)
        given.copy(given.row(2), given.row_states.at(run.rows * given.dimension), kept * given.dimension)
        self.counts[count("rows")] = run.rows + kept

    def cut(self, step: Whole) -> None:
        """Let the state stand at the change on a step, and the next step begin a motion of its own."""
        p, run, given, s = self.p, self.run, self.given, self.review.place
        kept: Whole = (step - p.whole(s.equals(0.0))).called("kept")
        self.place(step, s)
        slot = self.review.found
        t: Real = given.review.when[slot].called("time")
        state = given.review.there.at(slot * given.dimension)
        length: Real = (given.times[step + 1] - given.times[step]).called("length")
        given.times[kept + 1] = t
        given.copy(state, given.row(kept + 1), given.dimension)
        given.copy(state, given.y, given.dimension)
        self.write_rows(kept)
        self.lower_floors(kept)
        steps: Whole = (given.kept_counts[count("steps")] + kept).called("accepted")
        self.counts[count("steps")] = steps
        for name in ("slope_known", "after_reject", "kept"):
            self.counts[count(name)] = 0
        self.reals[number("t")], self.reals[number("previous")] = t, 1.0
        with p.when(~run.fixed.equals(0)) as ways:
            self.reals[number("start")] = t - p.real(steps) * self.reals[number("step")]
        with ways.otherwise():
            interval = p.larger(AHEAD * abs(t - run.changed), CLOSE * abs(t))
            size = p.smaller(abs(length), interval)
            self.reals[number("h")] = p.operation("copysign", size, length)
        since: Whole = run.since + kept
        run.ahead = p.larger(1, p.smaller(since, LONGEST_LOOK))
        run.since, run.count, run.begin, run.before = 0, 0, 1, 0
        given.break_rows[run.breaks] = steps + run.jumps
        run.due, run.way = self.review.event + 1, self.review.way

    def place(self, step: Whole, s: Real) -> None:
        """Let a change at an end of a step be at the accepted state; write the end of a step that is cut within."""
        p, run, given, slot = self.p, self.run, self.given, self.review.found
        within = (s > 0.0) & (s < 1.0)
        given.break_times[run.breaks] = p.choose(within, given.times[step + 1], math.nan)
        given.copy(given.row(step + 1), given.break_states.at(run.breaks * given.dimension), given.dimension)
        with p.when(~within, likely=False):
            at = p.choose(s > 0.0, step + 1, step)
            given.review.when[slot] = given.times[at]
            given.copy(given.row(at), given.review.there.at(slot * given.dimension), given.dimension)

    def lower_floors(self, kept: Whole) -> None:
        """Let the floors be those from before the steps, raised by the rows that are left of these."""
        p, given, first = self.p, self.given, NUMBERS
        share = self.reals[number("share")]
        with p.loop(0, given.dimension) as j:
            size = p.variable(0.0, "size")
            with p.loop(0, kept) as i:
                size.value = p.larger(size.value, abs(given.row(i + 2)[j]))
            self.reals[j + first] = p.larger(given.kept_reals[j + first], share * size.value)
