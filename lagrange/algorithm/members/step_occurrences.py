"""Events of members on the steps of an explicit step program: each accepted step is reviewed before the next.

An irregular case, such as an event that is not resolved, ends the member here, and the member is run again alone.
"""

from __future__ import annotations

from typing import Any

from lagrange.algorithm.dense.block import OwnStep
from lagrange.algorithm.events.constants import NOISE_HALVES
from lagrange.algorithm.events.step_zeros import ANYHOW, CHANGED, ENDED, MOST_ZEROS, REVIEW
from lagrange.algorithm.members.occurrences import ENDED_BY_EVENT, FirstOccurrences
from lagrange.algorithm.members.paths import MemberDenseOutput
from lagrange.algorithm.members.step_review import MemberFunctions, StepEvents, review_step
from lagrange.algorithm.outcome import Outcome
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE
from lagrange.procedure.values import Flag, Memory, Real, Whole

ZERO_ROOM = MOST_ZEROS + 1
"""Number of zeros that can be stored until they are copied, which is done after each step."""

Numbers = tuple[Memory, Memory]
"""The numbers of the law, and those of the dense output."""


class StepOccurrences(FirstOccurrences):
    """The search for events of a member on steps, in memory of a procedure; adds its parameters.

    After a review the run is at `time`, in the state `there`, at the fraction `part` of the step. This is the end of
    the step, unless an event ends the run earlier.
    """

    def __init__(self, p: Builder, events: StepEvents, dimension: int) -> None:
        super().__init__(p, events.count, dimension)
        self.events = events
        self.factors, self.direction = p.array("factors", read=True), p.array("direction", WHOLE, read=True)
        self.terminal = p.array("terminal", WHOLE, read=True)

    def reserve(self, dense: MemberDenseOutput) -> None:
        """Reserve memory, after all parameters have been added."""
        p, count, n = self.p, self.events.count, self.dimension
        self.reserve_counts()
        self.record: Any = p.reserve_record(REVIEW)
        names = ("sign", "near", "remaining", "came")
        self.wholes = {name: p.reserve(count, WHOLE, name=name) for name in names}
        self.wholes |= {"which": p.reserve(ZERO_ROOM + 1, WHOLE, name="which")}
        self.wholes |= {"noted": p.reserve(4 * count, WHOLE, name="noted")}
        self.reals = {name: p.reserve(count, name=name) for name in ("stayed", "levels")}
        self.reals |= {
            "when": p.reserve(ZERO_ROOM + 1, name="when"),
            "there": p.reserve((ZERO_ROOM + 1) * n, name="zeros"),
        }
        self.there = p.reserve(n, name="there")
        self.time, self.part = p.variable(0.0, "time"), p.variable(1.0, "part")
        self.review = review_step.form(functions=MemberFunctions(dense, self.events, n))

    def begin(self) -> None:
        """Reset the search at the start of a member: no events, and unknown sides."""
        self.forget()
        for name, kind in REVIEW.fields:
            setattr(self.record, name, 0.0 if kind is REAL else 0)
        self.record.end, self.record.room = 1, ZERO_ROOM
        for e in range(self.events.count):
            self.wholes["sign"][e] = self.wholes["near"][e] = 0
            self.wholes["remaining"][e], self.wholes["came"][e] = self.terminal[e], ANYHOW
            self.reals["stayed"][e] = 0.0

    def look(self, member: Whole, steps: Whole, step: OwnStep, end: Real, last: Flag, numbers: Numbers) -> Whole:
        """Review a step up to a time, which is the `last` or not; return PAUSED or the outcome of the run.

        `steps` is the number of steps including this one. `numbers` are those of the law and of the dense output.
        """
        p, record = self.p, self.record
        record.found, record.starts = 0, p.whole(steps.equals(1))
        record.last = p.choose(last, p.whole(0), -1)
        record.rounded = p.real(steps - 1) * (1.0 / NOISE_HALVES)
        given: dict[str, Any] = {"review": record, "direction": self.direction, **self.wholes, **self.reals}
        given |= {"numbers": numbers[0], "table": numbers[1], "factors": self.factors}
        given |= {"own": step.memory, "end": end}
        why = p.call(self.review, *(given[one.name] for one in self.review.parameters)).called("why")
        changed: Flag = why.equals(CHANGED)
        regular = why.equals(ENDED) | changed
        self.time.value, self.part.value = end, 1.0
        with p.when((record.found > 0) & regular, likely=False), p.loop(0, record.found) as slot:
            self.keep(member, self.wholes["which"][slot], self.reals["when"][slot], self.zero(slot))
        with p.when(changed, likely=False):
            self.end(step, end)
            self.keep(member, record.event, self.time.value, self.there)
        found: Whole = p.choose(changed, ENDED_BY_EVENT, p.choose(regular, p.whole(Outcome.PAUSED), Outcome.WATCHED))
        return found

    def zero(self, slot: Whole) -> Memory:
        """Return the state at the zero in a slot of the result arrays."""
        return self.reals["there"].at(slot * self.dimension)

    def end(self, step: OwnStep, end: Real) -> None:
        """Move the run to the event that ends it; at the end of a step that is the accepted state."""
        p, record = self.p, self.record
        s, slot = record.place, record.found
        begins, finishes = (s <= 0.0).called("begins"), (s >= 1.0).called("finishes")
        self.part.value = s
        self.time.value = p.choose(begins, step.t[0], p.choose(finishes, end, self.reals["when"][slot]))
        zero = self.zero(slot)
        with p.each(self.dimension, width=1) as i:
            self.there[i] = p.choose(begins, step.y[i], p.choose(finishes, step.new[i], zero[i]))
