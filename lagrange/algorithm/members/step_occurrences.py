"""Events of members on the steps of an explicit step program: each accepted step is reviewed before the next.

An irregular case, such as an event that is not resolved, ends the member here, and the member is run again alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.dense.block import OwnStep
from lagrange.algorithm.events.constants import NOISE_HALVES
from lagrange.algorithm.events.step_zeros import ANYHOW, CHANGED, ENDED, MOST_ZEROS, Review, ReviewedEvents
from lagrange.algorithm.members.occurrences import ENDED_BY_EVENT, FirstOccurrences, OccurrenceArrays
from lagrange.algorithm.members.paths import MemberDenseOutput
from lagrange.algorithm.members.step_review import MemberFunctions, StepEvents, review_step
from lagrange.algorithm.outcome import Outcome
from lagrange.procedure.front.plain import inline
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    WholesIn,
    WholesOut,
    clear,
    each,
    reals,
    unlikely,
    unrolled,
    wholes,
)

ZERO_ROOM = MOST_ZEROS + 1
"""Number of zeros that can be stored until they are copied, which is done after each step."""


@dataclass(frozen=True)
class ReviewArguments(OccurrenceArrays):
    """Arguments of the search for events on steps: perturbation factors of a state, and settings of the events."""

    factors: In
    direction: WholesIn
    terminal: WholesIn


@dataclass(frozen=True)
class ReviewMemory:
    """Memory of the search for events on the steps of a member: the fields of `ReviewedEvents`, and two more.

    `zeros` are the states at zeros. `seen` is the number of occurrences of each event so far.
    """

    review: Review
    sign: WholesOut
    near: WholesOut
    remaining: WholesOut
    stayed: Out
    came: WholesOut
    which: WholesOut
    when: Out
    zeros: Out
    noted: WholesOut
    levels: Out
    there: Out
    """The state to which the run is moved, if an event ends it."""

    seen: WholesOut


class StepEventSearch:
    """The search for the events of members on steps."""

    def __init__(self, events: StepEvents, dense: MemberDenseOutput, dimension: int) -> None:
        self.events, self.dimension = events, dimension
        self.functions = MemberFunctions(dense, events, dimension)
        self.occurrences = FirstOccurrences(events.count, dimension)

    @inline
    def memory(self) -> ReviewMemory:
        """Return memory for the search."""
        count, n = self.events.count, self.dimension
        sides = wholes(count), wholes(count), wholes(count), reals(count), wholes(count)
        zeros = wholes(ZERO_ROOM + 1), reals(ZERO_ROOM + 1), reals((ZERO_ROOM + 1) * n)
        seen = self.occurrences.memory()
        return ReviewMemory(Review(), *sides, *zeros, wholes(4 * count), reals(count), reals(n), seen)

    @inline
    def begin(self, memory: ReviewMemory, given: ReviewArguments) -> None:
        """Reset the search at the start of a member: no events, and unknown sides."""
        self.occurrences.begin(memory.seen)
        clear(memory.review)
        memory.review.end, memory.review.room = 1, ZERO_ROOM
        for e in unrolled(self.events.count):
            memory.sign[e], memory.near[e] = 0, 0
            memory.remaining[e], memory.came[e] = given.terminal[e], ANYHOW
            memory.stayed[e] = 0.0

    @inline
    def look(
        self, memory: ReviewMemory, job: Any, member: Any, index: int, step: OwnStep, end: float
    ) -> tuple[int, float, float]:
        """Review a step up to the time `end`. Return the outcome, and up to where the step counts: time and fraction.

        The outcome is PAUSED if the run continues. If an event ends the run, the state at that event is in
        `memory.there`. `index` is the number of the member.
        """
        review, steps, given = memory.review, member.counts.steps, job.watched
        review.found, review.starts = 0, int(steps == 1)
        review.last = 0 if end == job.t1 else -1
        review.rounded = float(steps - 1) * (1.0 / NOISE_HALVES)
        sides = memory.sign, memory.near, given.direction, memory.remaining, memory.stayed, memory.came
        zeros = memory.which, memory.when, memory.zeros, memory.noted, memory.levels
        watch = ReviewedEvents(review, *sides, *zeros)
        why = review_step(watch, member.numbers, job.table, given.factors, step.memory, end, functions=self.functions)
        is_changed = why == CHANGED
        is_regular = why == ENDED or is_changed
        if unlikely(review.found > 0 and is_regular):
            for slot in range(review.found):
                zero = memory.zeros[slot * self.dimension :]
                self.occurrences.keep(given, memory.seen, index, memory.which[slot], memory.when[slot], zero)
        t, part = end, 1.0
        if unlikely(is_changed):
            t, part = self.place_of_end(memory, step, end)
            self.occurrences.keep(given, memory.seen, index, review.event, t, memory.there)
        return ENDED_BY_EVENT if is_changed else Outcome.PAUSED if is_regular else Outcome.WATCHED, t, part

    @inline
    def place_of_end(self, memory: ReviewMemory, step: OwnStep, end: float) -> tuple[float, float]:
        """Write the state at the event that ends the run; return its time and its fraction of the step.

        At an end of the step it is the state there, which is not interpolated.
        """
        part, slot = memory.review.place, memory.review.found
        is_begin, is_end, zero = part <= 0.0, part >= 1.0, memory.zeros[slot * self.dimension :]
        when, t = memory.when[slot], step.t[0]
        for i in each(self.dimension, width=1):
            before, after, between = step.y[i], step.new[i], zero[i]
            memory.there[i] = before if is_begin else after if is_end else between
        return t if is_begin else end if is_end else when, part
