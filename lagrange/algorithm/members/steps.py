"""Members that run by the steps of an explicit step program, with error control or with equal steps."""

from __future__ import annotations

from typing import Any

from lagrange.algorithm.members.along import Along, Sampled, SampledStep
from lagrange.algorithm.members.occurrences import ENDED_BY_EVENT
from lagrange.algorithm.members.paths import MemberDenseOutput, StepCoefficients, polynomial_path, states_on_step
from lagrange.algorithm.members.queue import Members, Observed, SystemNumbers
from lagrange.algorithm.members.step_occurrences import StepOccurrences
from lagrange.algorithm.members.step_review import StepEvents
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.controlled_steps import steps_of
from lagrange.algorithm.step.memory import EFFORT, Layout
from lagrange.algorithm.taylor.sums import outstanding
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.building import Tracer
from lagrange.procedure.rewrite import bound
from lagrange.procedure.values import Flag, Memory, Real, Whole
from lagrange.program.step import StepProgram


class StepMembers(Members):
    """Runs members by the same steps as the driver of single runs, with the law of the step program as a procedure.

    With `dense` it writes the states at output times and reduces `sampled` expressions, by the dense output of single
    runs. The search for `events` uses it too.
    """

    def __init__(
        self,
        step: StepProgram,
        dimension: int,
        law: Procedure,
        numbers: SystemNumbers,
        observed: Observed,
        dense: MemberDenseOutput | None = None,
        sampled: Sampled | None = None,
        events: StepEvents | None = None,
    ) -> None:
        self.events = events
        self.occurrences: StepOccurrences | None = None
        super().__init__(dimension, numbers, observed)
        p = self.p
        self.program, self.law = step, law
        self.layout = Layout(step, dimension, block=1)
        self.work = p.reserve(self.layout.size, name="work")
        self.effort: Any = p.reserve_record(EFFORT)
        self.none = p.reserve(1, name="none")
        self.whole = dense is None and step.control is None
        """True if all steps are taken in one call."""
        self.follower = None if dense is None else _Follower(self, dense, sampled)

    def announce(self) -> None:
        """Add the parameters of the events, if there are any."""
        if self.events is not None:
            self.occurrences = StepOccurrences(self.p, self.events, self.dimension)

    @property
    def state(self) -> list[Memory]:
        """The state as one vector, or as coordinates and velocities."""
        return [self.work.at(self.layout.place(k)) for k in range(self.program.states)]

    def begin(self) -> None:
        """Clear the entries that the law reads and no step writes: velocities, if the step moves only coordinates."""
        if self.program.law == "accelerations":
            velocities = self.work.at(self.layout.argument + self.layout.length)
            with self.p.each(self.layout.length, width=1) as i:
                velocities[i] = 0.0
        if self.follower is not None:
            self.follower.begin()

    def advance(self, last: Flag) -> Whole:
        """Take a trial step, or all equal steps at once, which finishes the member."""
        p = self.p
        trials = p.choose(last, 0, self.budget if self.whole else p.whole(1))
        given = {"parameters": self.held, "constants": self.held, "run": self.run, "counts": self.counts}
        given |= {"floors": self.floors, "effort": self.effort, "work": self.work}
        given |= {"budget": trials, "times": self.none, "rows": self.none}
        steps = bound(steps_of(self.layout), {"law": self.law, "jacobian": self.law}, prefix="run_")
        before = None if self.follower is None else self.follower.before()
        found = p.variable(p.call(steps, *(given[one.name] for one in steps.parameters)), "found")
        if self.follower is not None:
            with p.when(self.counts.steps > before):
                ended = self.follower.follow()
                if ended is not None:
                    found.value = p.choose(ended.equals(Outcome.PAUSED), found.value, ended)
        outcome: Whole = found.value
        return outcome

    @property
    def attempts(self) -> Whole:
        """Number of trial steps; the whole budget if all steps are taken at once."""
        return self.budget if self.whole else super().attempts

    @property
    def along(self) -> Along | None:
        """Reductions of expressions along the run, or None if none were requested."""
        return None if self.follower is None else self.follower.along


class _Follower:
    """Follows the accepted steps of members by dense output: writes outputs and samples expressions."""

    def __init__(self, members: StepMembers, dense: MemberDenseOutput, sampled: Sampled | None) -> None:
        p = self.p = members.p
        self.members, self.dimension = members, members.dimension
        self.step = StepCoefficients(p, dense, self.dimension)
        self.written = p.variable(0, "written")
        self.sign = p.real(p.choose(members.t1 < members.t0, -1.0, 1.0))
        path = polynomial_path.form(entries=tuple(range(self.dimension)), dimension=self.dimension)
        self.outputs = bound(states_on_step.form(), {"path": path}, prefix="path_")
        self.along: Along | None = None
        if sampled is not None:
            some = polynomial_path.form(entries=sampled.entries, dimension=self.dimension)
            path = bound(some, {}, prefix="expressions_")
            self.along = Along(p, sampled, path, members.points, members.held, self.dimension)
        if members.occurrences is not None:
            members.occurrences.reserve(dense)

    def begin(self) -> None:
        """Begin at the start of a member."""
        self.written.value = 0
        if self.members.occurrences is not None:
            self.members.occurrences.begin()
        if self.along is not None:
            self.copy(self.step.step.new)
            self.along.begin(self.members.run.t, self.step.step.new)

    def copy(self, to: Memory) -> None:
        """Copy the state, whose vectors need not be adjacent, to an array."""
        parts = self.members.state
        length = self.dimension // len(parts)
        for k, part in enumerate(parts):
            with self.p.each(length, width=1) as i:
                to.at(k * length)[i] = part[i]

    def before(self) -> Whole:
        """Record the beginning of the next step, and return the number of accepted steps."""
        self.step.step.t[0] = self.members.run.t
        self.copy(self.step.step.y)
        found: Whole = self.members.counts.steps
        return found

    def follow(self) -> Whole | None:
        """Follow an accepted step: events on it, states at output times, and expressions along it.

        Return PAUSED or the outcome of the run, or None without events.
        """
        p, members, step = self.p, self.members, self.step.step
        t, end = step.t[0], members.run.t
        due = Tracer(p, ()).call(outstanding, members.output_times, self.written.value, end, self.sign)
        step.h[0], step.side[0] = end - t, 0.0
        self.copy(step.new)
        ended = None if members.occurrences is None else self.watch(members.occurrences, end)
        if self.along is not None:
            self.look_along(self.along, t, end)
        with p.when(due, likely=False):
            if self.along is None:
                self.step.find(members.table, members.held)
            self.write(t, end)
        return ended

    def watch(self, occurrences: StepOccurrences, end: Real) -> Whole:
        """Find the events on a step, and move the run to an event that ends it."""
        p, members = self.p, self.members
        steps, last, numbers = members.counts.steps, end.equals(members.t1), (members.held, members.table)
        found = occurrences.look(members.member.value, steps, self.step.step, end, last, numbers)
        with p.when(found.equals(ENDED_BY_EVENT), likely=False):
            members.run.t = occurrences.time.value
            members.counts.steps = members.counts.steps - p.whole(occurrences.part.value <= 0.0)
            self.put(occurrences.there)
        return found

    def put(self, state: Memory) -> None:
        """Set the member's state from an array; its vectors need not be adjacent in memory."""
        parts = self.members.state
        length = self.dimension // len(parts)
        for k, part in enumerate(parts):
            with self.p.each(length, width=1) as i:
                part[i] = state.at(k * length)[i]

    def look_along(self, along: Along, t: Real, end: Real) -> None:
        """Sample expressions along a step, or along its part up to the event that ends the run."""
        p, members, occurrences = self.p, self.members, self.members.occurrences
        self.step.find(members.table, members.held)
        part = p.real(1.0)
        if occurrences is not None:
            end, part = occurrences.time.value, occurrences.part.value
            self.copy(self.step.step.new)
        degree = p.whole(self.step.kind.degree)
        along.follow(SampledStep(t, end, end - t, part, self.step.c, self.step.step.new, degree))
        along.accept()

    def write(self, t: Real, end: Real) -> None:
        """Write the states at the output times on a step."""
        p, members, sign = self.p, self.members, self.sign
        states = members.outputs.at(members.member.value * (members.wanted * self.dimension))
        numbers = p.whole(self.dimension), p.whole(self.step.kind.degree), self.written.value
        arrays = members.output_times, self.step.c, states
        self.written.value = p.call(self.outputs, t, end, sign, *arrays, *numbers)
