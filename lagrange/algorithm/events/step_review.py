"""Events along many steps, block by block: most keep their sign on a step, and zeros of the others are isolated.

An irregular event ends the review before its step: one without a value, one that is not resolved, one that starts at
zero and does not leave at once, or several that change the motion at one time.
"""

from __future__ import annotations

from typing import Any

from lagrange.algorithm.dense.block import LANES
from lagrange.algorithm.events.step_samples import Samples
from lagrange.algorithm.events.step_zeros import ENDED, IRREGULAR, ReviewArguments, StepZeros
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Whole

QUEUE = 256
"""Steps that are screened before those of them that are doubtful are looked at closely."""


@shared
def review() -> Procedure:
    """Return the procedure that reviews steps, times (S+1,) and states (S+1, 2n), and returns its end; see `REVIEW`.

    It writes the event, the time and the state of each zero that counts. If a zero that changes the motion ended the
    review, it is written after them and not counted.
    """
    return _Review().build()


class _Review:
    """Builds the procedure."""

    def __init__(self) -> None:
        self.p = p = Builder("review", "Find the zeros of events on steps, up to what is irregular or a change.")
        self.samples = Samples(p)
        self.given = ReviewArguments(p)
        self.record: Any = self.given.record

    def build(self) -> Procedure:
        p, samples, record = self.p, self.samples, self.record
        samples.lay_out()
        self.queue = p.reserve(QUEUE, WHOLE, name="queue")
        self.zeros = StepZeros(p, samples, self.given)
        self.end: Whole = record.end.called("end")
        self.filled = p.variable(0, "filled")
        reached = p.variable(record.begin, "reached")
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
                self.zeros.leave(IRREGULAR, samples.places[0], condition=samples.bad.value)
                self.zeros.begin_at_zero(samples.places[0])
                self.settle(p.smaller(count - first, LANES))
        record.step = self.end
        p.leave(ENDED)
        return p.finish(WHOLE)

    def queue_block(self, first: Whole) -> None:
        """Put the doubtful steps of a block into the queue, and always the first step of all."""
        p, samples = self.p, self.samples
        with p.loop(0, LANES) as b:
            samples.places[b] = p.smaller(first + b, self.end - 1)
        with p.when(self.given.screens):
            samples.sift()
        with p.loop(0, p.smaller(self.end - first, LANES)) as b:
            close = samples.is_doubtful(b) | (first + b).equals(self.record.begin)
            with p.when(~self.given.screens | close):
                self.queue[self.filled.value] = first + b
                self.filled.value = self.filled.value + 1

    def settle(self, count: Whole) -> None:
        """Go through the steps of a block in order, and isolate the zeros of the events that may vanish."""
        p = self.p
        resolved = p.variable(p.false, "resolved")
        with p.loop(0, count) as b:
            watched = p.variable(p.false, "watched")
            with p.loop(0, self.samples.events) as e:
                watched.value = watched.value | self.zeros.may_vanish(b, e)
            with p.when(watched.value):
                with p.when(~resolved.value):
                    self.samples.sample_fully()
                    resolved.value = p.true
                self.zeros.visit(self.samples.places[b].called("step"), b)
