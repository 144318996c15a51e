"""Queue of members: each lane of a vector takes its next member when the last one has ended.

A lane is a number from 0 on. It runs the members whose index is the lane plus a multiple of the number of lanes. The
results of a member depend on its own numbers only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.members.along import Along
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.constants import MOST_SURVEYS, SMALL_FLOOR
from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.values import Flag, Memory, Real, Whole

LANE = "lane"
"""The argument that differs from lane to lane; all others are common."""

COUNTED = ("steps", "rejected", "evaluations")
"""Names of the counts that are returned for each member."""


@dataclass(frozen=True)
class SystemNumbers:
    """The numbers of procedures in addition to time and state: parameters, then the values of them alone.

    `size` is their total number. With `prepare` each member has its own `parameters`, from which it computes all
    numbers; otherwise all members share one array of them.
    """

    size: int
    parameters: int
    prepare: Procedure | None = None


@dataclass(frozen=True)
class Observed:
    """Numbers that are recorded of a state, `size` of them, by a procedure of time, state, numbers and results."""

    kernel: Procedure
    size: int


class Members(ABC):
    """Builds a procedure that runs members from t0 to t1. A method defines the start of a run and its steps.

    There are `count` members: `starts` has their states [q, v], and `numbers` their parameters or the common numbers;
    see `SystemNumbers`. The results have a row for each member: last states, times and outcomes, the counts, the
    observed values at the start and at the end, the states at `wanted` output times, and the reductions of expressions
    along the run. `points` are the sample points of a step, and `table` has the numbers of the dense output. A member
    whose outcome is not DONE is at the point where its run stopped.
    """

    def __init__(self, dimension: int, numbers: SystemNumbers, observed: Observed) -> None:
        self.dimension, self.known, self.observed = dimension, numbers, observed
        p = self.p = Builder("members", "Run members of an ensemble, one after the other in each lane.")
        self.lane, self.lanes = p.given(LANE, WHOLE), p.given("lanes", WHOLE)
        self.count, self.budget = p.given("count", WHOLE), p.given("budget", WHOLE)
        self.t0, self.t1 = p.given("t0", REAL), p.given("t1", REAL)
        self.rtol, self.floor, self.share = (p.given(name, REAL) for name in ("rtol", "floor", "share"))
        self.step, self.longest = p.given("step", REAL), p.given("longest", REAL)
        self.starts, self.numbers = p.array("starts", read=True), p.array("numbers", read=True)
        self.wanted, self.output_times = p.given("wanted", WHOLE), p.array("output_times", read=True)
        self.outputs, self.ends, self.times = p.array("outputs"), p.array("ends"), p.array("times")
        self.first, self.last = p.array("first"), p.array("last")
        self.outcomes = p.array("outcomes", WHOLE)
        self.counted = {name: p.array(name, WHOLE) for name in COUNTED}
        self.points, self.table = p.array("points", read=True), p.array("table", read=True)
        self.reduced = p.array("reduced")
        self.announce()
        self.held = p.reserve(numbers.size, name="prepared") if numbers.prepare else self.numbers
        self.seen, self.found = p.reserve(dimension, name="seen"), p.reserve(max(observed.size, 1), name="found")
        self.run: Any = p.reserve_record(RUN)
        self.counts: Any = p.reserve_record(COUNTS)
        self.floors = p.reserve(dimension, name="floors")
        self.member = p.variable(self.lane, "member")
        self.tried = p.variable(0, "tried")
        self.fresh = p.variable(p.true, "fresh")

    @abstractmethod
    def announce(self) -> None:
        """Add the parameters of the method, after all others."""

    @property
    @abstractmethod
    def state(self) -> list[Memory]:
        """The state of the present member, as vectors of equal length."""

    @property
    @abstractmethod
    def along(self) -> Along | None:
        """The reductions of expressions along the run, or None."""

    @abstractmethod
    def begin(self) -> None:
        """Initialize the data that the method keeps of a run."""

    @abstractmethod
    def advance(self, last: Flag) -> Whole:
        """Take a step, and return an outcome, PAUSED if the run continues; after the `last` step it does not."""

    @property
    def attempts(self) -> Whole:
        """Number of trial steps of the present member, which the budget bounds."""
        found: Whole = self.counts.steps + self.counts.rejected
        return found

    def build(self) -> Procedure:
        """Return the procedure that runs members, after adding all of its statements."""
        p = self.p
        with p.repeat(lambda: self.member.value < self.count):
            with p.when(self.fresh.value):
                self.begin_member()
            last = self.tried.value >= self.budget
            outcome = self.without_sizes(self.advance(last)).called("outcome")
            self.tried.value = self.attempts
            done = ~outcome.equals(Outcome.PAUSED) | last
            self.fresh.value = done
            with p.when(done):
                self.end_member(outcome)
        return p.finish()

    def without_sizes(self, outcome: Whole) -> Whole:
        """Return an outcome; PAUSED instead of UNSCALED for a run that can continue without a survey of sizes.

        Sizes would only raise floors, so its steps are at most shorter. A run ends if it cannot begin without them, or
        if an entry may be rounding: its steps would shrink to nothing.
        """
        p, counts = self.p, self.counts
        asked = outcome.equals(Outcome.UNSCALED) & (counts.steps > 0) & (counts.surveyed < MOST_SURVEYS)
        goes_on = p.variable(asked, "goes_on")
        with p.when(asked, likely=False):
            counts.surveyed = counts.surveyed + 1
            goes_on.value = ~self.some_rounded()
        found: Whole = p.choose(goes_on.value, Outcome.PAUSED, outcome)
        return found

    def some_rounded(self) -> Flag:
        """Return whether the floor of an entry is below `SMALL_FLOOR` times the largest of its kind."""
        p, half = self.p, self.dimension // 2
        found = p.variable(p.false, "rounded")
        for kind in range(2):
            floors, largest = self.floors.at(kind * half), p.variable(0.0, "largest")
            with p.loop(0, half) as i:
                largest.value = p.larger(largest.value, floors[i])
            with p.loop(0, half) as i:
                found.value = found.value | (floors[i] < SMALL_FLOOR * largest.value)
        rounded: Flag = found.value
        return rounded

    def explained(self, outcome: Whole) -> Whole:
        """Return an outcome. If steps shrank because trials had no value, it is the outcome of these trials."""
        p = self.p
        stuck = outcome.equals(Outcome.STEP_TOO_SMALL) & (self.counts.after_reject > 0)
        for cause in (Outcome.NON_FINITE, Outcome.SINGULAR):
            outcome = p.choose(stuck & self.run.cause.equals(float(cause)), cause, outcome)
        return outcome

    def begin_member(self) -> None:
        """Initialize the run of the next member."""
        p, run, counts, n = self.p, self.run, self.counts, self.dimension
        member = self.member.value
        if self.known.prepare is not None:
            p.call(self.known.prepare, self.numbers.at(member * self.known.parameters), self.held)
        self.tried.value = 0
        for name, kind in RUN.fields:
            setattr(run, name, 0.0 if kind is REAL else 0)
        for name, _ in COUNTS.fields:
            setattr(counts, name, 0)
        run.t = run.start = self.t0
        run.end = self.t1
        run.h = run.step = self.step
        run.rtol, run.share, run.longest, run.previous = self.rtol, self.share, self.longest, 1.0
        run.cause = float(Outcome.STEP_TOO_SMALL)
        with p.each(n, width=1) as i:
            self.floors[i] = self.floor
        length = n // len(self.state)
        for k, part in enumerate(self.state):
            start = self.starts.at(member * n + k * length)
            with p.each(length, width=1) as i:
                part[i] = start[i]
        self.observe(self.t0, self.first)
        self.begin()

    def observe(self, t: Real, results: Memory) -> None:
        """Write the observed values of the state, as a row of some results."""
        p, size = self.p, self.observed.size
        if not size:
            return
        length = self.dimension // len(self.state)
        for k, part in enumerate(self.state):
            with p.each(length, width=1) as i:
                self.seen.at(k * length)[i] = part[i]
        p.call(self.observed.kernel, t, self.seen, self.held, self.found)
        target = results.at(self.member.value * size)
        with p.each(size, width=1) as i:
            target[i] = self.found[i]

    def end_member(self, outcome: Whole) -> None:
        """Write the results of a member, and go to the next one."""
        p, member = self.p, self.member.value
        length = self.dimension // len(self.state)
        for k, part in enumerate(self.state):
            target = self.ends.at(member * self.dimension + k * length)
            with p.each(length, width=1) as i:
                target[i] = part[i]
        self.observe(self.run.t, self.last)
        self.times[member] = self.run.t
        self.outcomes[member] = self.explained(outcome)
        for name, array in self.counted.items():
            array[member] = getattr(self.counts, name)
        if self.along is not None:
            self.along.write(self.run.t, self.reduced.at(member * len(self.along.sampled.reductions)))
        self.member.value = member + self.lanes
