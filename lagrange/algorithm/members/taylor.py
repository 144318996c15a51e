"""Members that run by Taylor series of one order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.members.along import AlongRun, Sampled, SampledStep, series_path
from lagrange.algorithm.members.occurrences import ENDED_BY_EVENT, EventSearch, SearchArguments, TaylorEvents
from lagrange.algorithm.members.queue import Member, MemberJob, MemberMethod, Observed, SystemNumbers
from lagrange.algorithm.taylor.loop import begin_run, iteration
from lagrange.algorithm.taylor.memory import JET, Held, OutputCounts, TaylorLayout, TaylorState
from lagrange.algorithm.taylor.step_size import logarithm
from lagrange.algorithm.taylor.watching import Arguments
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.plain import inline
from lagrange.procedure.front.vocabulary import Out, clear, reals, unlikely


@dataclass(frozen=True)
class SeriesMemory:
    """Memory of a run by series: the array of the series, the records of the run, and the search for events."""

    work: Out
    taylor: TaylorState
    held: Held
    outputs: OutputCounts
    unused: Out
    search: Any


class TaylorMembers(MemberMethod):
    """Runs members by Taylor series, with the same steps as the driver of single runs.

    The procedure `jet` computes the Taylor coefficients of the solution up to the `order`.
    """

    law_type = JET

    def __init__(
        self,
        layout: TaylorLayout,
        order: int,
        jet: Procedure,
        numbers: SystemNumbers,
        observed: Observed,
        sampled: Sampled | None = None,
        events: TaylorEvents | None = None,
    ) -> None:
        along = None
        if sampled is not None:
            path = series_path.form(layout=layout, entries=sampled.entries)
            along = AlongRun(sampled, path, layout.dimension)
        super().__init__(layout.dimension, numbers, observed, along)
        self.layout, self.order = layout, order
        self.functions = {"law": jet} if events is None else {"law": jet, "values": events.values}
        self.search = None if events is None else EventSearch(events, layout)
        self.watched_type = None if events is None else SearchArguments

    @inline
    def memory(self, job: MemberJob) -> tuple[tuple[Out, ...], SeriesMemory]:
        """Return memory for the state, which begins the work array, and the other memory of a run."""
        work = reals(self.layout.size(self.order), room=WIDEST_VECTOR)
        records = TaylorState(), Held(), OutputCounts(), reals(1)
        search = None if self.search is None else self.search.memory()
        return (work,), SeriesMemory(work, *records, search)

    @inline
    def begin(self, job: MemberJob, member: Member) -> None:
        """Reset the state's rounding error, the counters, the series' unit of time, and the outputs."""
        method_memory = member.own
        method_memory.held.unproven = 0
        clear(method_memory.outputs)
        begin_run(member.run, member.counts, method_memory.taylor, method_memory.held, method_memory.work, self.layout)
        if self.search is not None:
            self.search.begin(method_memory.search, method_memory.taylor)

    @inline
    def attempts(self, job: MemberJob, member: Member) -> int:
        """Return the number of trial steps, including the last one, which the defect test has not confirmed yet."""
        tried: int = member.counts.steps + member.counts.rejected + member.own.held.unproven
        return tried

    @inline
    def advance(self, job: MemberJob, member: Member, index: int, last: bool) -> int:
        """Test the defect of the last step of member `index`, and take the next step. Return an outcome.

        `last` is true if the budget allows no step after this one.
        """
        run, counts, method_memory = member.run, member.counts, member.own
        states = job.outputs[index * (job.wanted * self.dimension) :]
        watched = None if self.search is None else self.search.arguments(method_memory.search, job, member.numbers)
        records = run, counts, method_memory.taylor, member.floors, method_memory.held, method_memory.outputs
        arrays = job.output_times, states, method_memory.unused, method_memory.unused
        arguments: Any = (
            member.numbers,
            member.numbers,
            *records,
            *arrays,
            watched,
            None,
            None,
            method_memory.work,
            self.order,
        )
        loop_arguments = Arguments(job.law, *arguments)
        before = counts.steps
        outcome: int = iteration(loop_arguments, last, -logarithm(job.rtol), layout=self.layout)
        if self.along is not None:
            # Sample the last step while its series is in memory; commit the one before if it is proven.
            if counts.steps > before:
                self.along.accept(member.reduced)
            if method_memory.held.unproven != 0:
                h = method_memory.held.h
                step = SampledStep(
                    method_memory.held.t,
                    run.t,
                    h,
                    h / method_memory.held.scale,
                    method_memory.work,
                    method_memory.work,
                    self.order,
                )
                self.along.follow(member.reduced, step, member.numbers, job.points)
        if self.search is None:
            return outcome
        return self.ended_by_event(self.search, job, member, index, outcome, last)

    @inline
    def ended_by_event(
        self, search: EventSearch, job: MemberJob, member: Member, index: int, outcome: int, last: bool
    ) -> int:
        """Copy events to the results. Return `outcome`, or ENDED_BY_EVENT if an event ends the run.

        The events are those on steps that the defect test has confirmed.

        `index` is the number of the member, and `last` is true if the budget allows no more steps.
        """
        method_memory = member.own
        search.take(method_memory.search, job, index)
        is_ended = search.is_ended(method_memory.search, outcome, method_memory.held.unproven, last)
        if unlikely(is_ended):
            search.occurrences.keep(
                job.watched,
                method_memory.search.seen,
                index,
                search.due(method_memory.search),
                member.run.t,
                method_memory.work,
            )
        return ENDED_BY_EVENT if is_ended else outcome
