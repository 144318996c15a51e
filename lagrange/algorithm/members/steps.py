"""Members that run by the steps of an explicit step program, with error control or with equal steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.members.along import AlongRun, Sampled, SampledStep
from lagrange.algorithm.members.occurrences import ENDED_BY_EVENT
from lagrange.algorithm.members.paths import (
    MemberDenseOutput,
    MemberStepPath,
    PathMemory,
    polynomial_path,
    states_on_step,
)
from lagrange.algorithm.members.queue import (
    Member,
    MemberJob,
    MemberMethod,
    Observed,
    SystemNumbers,
    copy_state,
    move_to,
)
from lagrange.algorithm.members.step_occurrences import ReviewArguments, StepEvents, StepEventSearch
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.loops import steps_of
from lagrange.algorithm.step.memory import Effort, Layout
from lagrange.algorithm.step.run import Running
from lagrange.algorithm.taylor.memory import OutputCounts
from lagrange.algorithm.taylor.sums import outstanding
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.plain import inline
from lagrange.procedure.front.vocabulary import Out, each, generated, reals, unlikely
from lagrange.procedure.rewrite import bound
from lagrange.program.step import StepProgram


@dataclass(frozen=True)
class StepMemory:
    """Memory of a run by steps: the vectors of a step, and memory to evaluate expressions and events on it."""

    work: Out
    effort: Effort
    unused: Out
    path: Any
    """The dense output, see `PathMemory`, or None."""

    outputs: Any
    """The number of output times with states, see `OutputCounts`, or None without dense output."""

    search: Any
    """The search for events, or None."""


class StepMembers(MemberMethod):
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
        along = None
        if sampled is not None:
            some = polynomial_path.form(entries=sampled.entries, dimension=dimension)
            along = AlongRun(sampled, bound(some, {}, prefix="expressions_"), dimension)
        super().__init__(dimension, numbers, observed, along)
        self.program, self.functions = step, {"law": law}
        self.layout = Layout(step, dimension, block=1)
        self.steps = steps_of(self.layout)
        self.takes_all = dense is None and step.control is None
        """True if all steps are taken in one call."""
        self.path = None if dense is None else MemberStepPath.of(dense.kind, dense.column, dimension, "path_")
        path_form = polynomial_path.form(entries=tuple(range(dimension)), dimension=dimension)
        self.outputs = bound(states_on_step.form(), {"path": path_form}, prefix="path_")
        self.search = None if dense is None or events is None else StepEventSearch(events, dense, dimension)
        self.watched_type = None if self.search is None else ReviewArguments

    @inline
    def memory(self, job: MemberJob) -> tuple[tuple[Out, ...], StepMemory]:
        """Return memory for the state, one vector or coordinates and velocities, and the other memory of a run."""
        work = reals(self.layout.size)
        parts = tuple([work[self.layout.place(k) :] for k in range(self.program.states)])
        path = None if self.path is None else self.path.memory()
        outputs = None if self.path is None else OutputCounts()
        search = None if self.search is None else self.search.memory()
        return parts, StepMemory(work, Effort(), reals(1), path, outputs, search)

    @inline
    def begin(self, job: MemberJob, member: Member) -> None:
        """Reset the search for events and the outputs at the start of a member's run.

        Entries that the law reads and no step writes are cleared: velocities, if the step moves only
        coordinates.
        """
        method_memory = member.own
        if self.program.law == "accelerations":
            velocities = method_memory.work[self.layout.argument + self.layout.length :]
            for i in each(self.layout.length, width=1):
                velocities[i] = 0.0
        if self.path is not None:
            method_memory.outputs.done = 0
        if self.search is not None:
            self.search.begin(method_memory.search, job.watched)

    @inline
    def attempts(self, job: MemberJob, member: Member) -> int:
        """Return the number of trial steps; the whole budget if all steps are taken at once."""
        return job.budget if self.takes_all else member.counts.steps + member.counts.rejected

    @inline
    def advance(self, job: MemberJob, member: Member, index: int, last: bool) -> int:
        """Take a trial step, or all equal steps at once, which finishes the member. Return an outcome.

        `index` is the number of the member.

        `last` is true if the budget allows no more steps.
        """
        run, counts, method_memory = member.run, member.counts, member.own
        trials = 0 if last else job.budget if self.takes_all else 1
        before = counts.steps
        if self.path is not None:
            method_memory.path.step.t[0] = run.t
            copy_state(member, method_memory.path.step.y, self.dimension)
        numbers = member.numbers
        arguments = Running(
            job.law,
            numbers,
            job.law,
            numbers,
            run,
            counts,
            member.floors,
            method_memory.effort,
            (),
            (),
            method_memory.work,
            None,
            None,
        )
        outcome: int = generated(self.steps, arguments, trials, method_memory.unused, method_memory.unused)
        if self.path is not None and counts.steps > before:
            ended = self.follow(self.path, job, member, index)
            outcome = outcome if ended == Outcome.PAUSED else ended
        return outcome

    @inline
    def follow(self, path: MemberStepPath, job: MemberJob, member: Member, index: int) -> int:
        """Search an accepted step for events, and write output states and reductions of expressions on it.

        `path` is the dense output. Return PAUSED or, if an event ends the run, its outcome.
        """
        run, method_memory = member.run, member.own
        memory: PathMemory = method_memory.path
        step, end = memory.step, run.t
        t = step.t[0]
        direction = -1.0 if job.t1 < job.t0 else 1.0
        is_due = outstanding(job.output_times, method_memory.outputs.done, end, direction)
        step.h[0], step.side[0] = end - t, 0.0
        copy_state(member, step.new, self.dimension)
        outcome, part, last = int(Outcome.PAUSED), 1.0, end
        if self.search is not None:
            outcome, last, part = self.search.look(method_memory.search, job, member, index, step, end)
            if unlikely(outcome == ENDED_BY_EVENT):
                run.t = last
                member.counts.steps -= int(part <= 0.0)
                move_to(member, method_memory.search.there, self.dimension)
        if self.along is not None:
            path.find(memory, job.table, member.numbers)
            if self.search is not None:
                copy_state(member, step.new, self.dimension)
            sampled = SampledStep(t, last, last - t, part, memory.c, step.new, path.kind.degree)
            self.along.follow(member.reduced, sampled, member.numbers, job.points)
            self.along.accept(member.reduced)
        if unlikely(is_due):
            if self.along is None:
                path.find(memory, job.table, member.numbers)
            states, degree = job.outputs[index * (job.wanted * self.dimension) :], path.kind.degree
            arrays = job.output_times, memory.c, states, self.dimension, degree, method_memory.outputs.done
            method_memory.outputs.done = generated(self.outputs, t, end, direction, *arrays)
        return outcome
