"""Ensemble members that run by Taylor series of one order: their coefficients, their steps, and their events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.constants import WIDEST_VECTOR, Outcome
from lagrange.algorithm.members.queue import (
    ENDED_BY_EVENT,
    FirstOccurrences,
    Member,
    MemberJob,
    MemberMethod,
    Observed,
    OccurrenceArrays,
    SystemNumbers,
)
from lagrange.algorithm.members.reductions import RunReductions, Sampled, SampledStep, series_path
from lagrange.algorithm.series.jets import ByOrderJet, run_layout
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import Chunk, Packing, depth_first
from lagrange.algorithm.series.rules import OrderSums, StoredOperands, SumsAtUse, read_later
from lagrange.algorithm.taylor.loop import begin_run, iteration
from lagrange.algorithm.taylor.memory import JET, Held, OutputCounts, Sizes, TaylorLayout, TaylorState
from lagrange.algorithm.taylor.step_size import logarithm
from lagrange.algorithm.taylor.watched_functions import (
    MOST_ZEROS,
    PARTS,
    SIDES,
    Arguments,
    Watch,
    Watched,
    scratch_sizes,
)
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.decorators import inline
from lagrange.procedure.front.vocabulary import In, Out, WholesIn, WholesOut, clear, each, reals, unlikely, wholes

MEMBER_TILE = 8
"""Number of sums that one loop computes: enough to hide the latency of multiply-adds, and few enough for 16 registers.
The outer solar system takes 1.06 times as long with 12 sums, and 1.2 times with 16 (four members, AMD Zen 3).
"""


class MemberJet(ByOrderJet):
    """Builder of the procedure that computes the series of ensemble members up to the order `highest`.

    A value is a vector with one entry for each member, so that the coefficients of a large system do not fit into the
    processor's first cache. Each sum over lower orders is computed where a rule first reads it, together with sums of
    the same factors. The operands that later orders read are in local memory, and the caller's
    rows have the state and the event functions only. A call may leave out some members: it must not change their
    rows, but writes their local memory without a mask.
    """

    def __init__(self, packing: Packing, numbers: SeriesNumbers, highest: int) -> None:
        super().__init__(packing, numbers, run_layout(packing), tile=MEMBER_TILE)
        self.highest = highest

    def storage(self) -> StoredOperands:
        """Return new local memory for the operands that later orders read, up to the order `highest`."""
        places = {operand: index for index, operand in enumerate(dict.fromkeys(read_later(self.packing)))}
        memory = self.p.reserve((self.highest + 1) * len(places), name="stored")
        return StoredOperands(memory, len(places), places)

    def order_sums(self) -> OrderSums:
        """Return the builder of the code for the sums over lower orders, each added where a rule first reads it."""
        packing = self.packing
        pairs = [pair for part in packing.parts for chunk in depth_first(packing, part) for pair in chunk.sums]
        return SumsAtUse(self.p, pairs, self.stored, self.tile)

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Compute the Taylor coefficients of `chunks` at the present order, each by the rule of its chunk."""
        super().fill(depth_first(self.packing, chunks))


MEMBER_EVENT_ROOM = 2 * MOST_ZEROS
"""Number of events that the memory of one member can hold. Events are copied to the results after each step."""


@dataclass(frozen=True)
class TaylorEvents:
    """The watched functions of members: `count` of them, and the first `events` are the user's events.

    `values` evaluates all of them from a time, a state, and the parameters with all values that depend on them
    alone. `changing` is true if one of them may end the run. `hides_growth` is true if a series has exp,
    sinh, cosh or tanh, whose terms may grow late, so that every step is inspected. `steep` is true if a
    function has powers above the order of the series. Then the series are compared with the functions at the
    end of every step.
    """

    values: Procedure
    count: int
    events: int
    changing: bool
    hides_growth: bool
    steep: bool


@dataclass(frozen=True)
class SearchArguments(OccurrenceArrays):
    """Arguments of the search for events on Taylor steps, and the arrays for the results.

    `sizes` describes the memory layout of the series. `settings` says for each watched function which zeros
    count and what they do. `tilts` are factors near 1 that multiply the entries of a state to estimate rounding
    errors.
    """

    sizes: Sizes
    settings: WholesIn
    tilts: In


@dataclass(frozen=True)
class SearchMemory:
    """Memory of the search for events on the steps of a member.

    `watched` are the watched functions with the state of the search and the new events, as arguments of the loop over
    steps. `seen` is the number of occurrences of each event so far.
    """

    watched: Watched
    seen: WholesOut
    taken: WholesOut
    """Number of events already copied to the results, in an array of one entry."""


class EventSearch:
    """The search for the events of members on Taylor steps.

    `events` are the watched functions, and `layout` is the layout of the series in memory.
    """

    def __init__(self, events: TaylorEvents, layout: TaylorLayout) -> None:
        self.events, self.dimension = events, layout.dimension
        self.occurrences = FirstOccurrences(events.events, layout.dimension)

    @inline
    def memory(self, job: Any, numbers: In) -> SearchMemory:
        """Return memory for the search for events on the steps of one member, whose parameters are `numbers`."""
        count, n, watched = self.events.count, self.dimension, job.watched
        real_count, whole_count = scratch_sizes(count, n)
        sides, places, unused = wholes(2 * len(SIDES) * count), wholes(MEMBER_EVENT_ROOM), wholes(1)
        times, states = reals(MEMBER_EVENT_ROOM), reals(MEMBER_EVENT_ROOM * n, room=WIDEST_VECTOR)
        scratch = unused, unused, unused, reals(real_count, room=WIDEST_VECTOR), wholes(whole_count)
        arrays = watched.tilts, sides, watched.settings, times, states, places, *scratch
        arguments: Any = watched.sizes, job.values, job.values, numbers, numbers, *arrays, None, None
        return SearchMemory(Watched(Watch(), *arguments), self.occurrences.memory(), wholes(1))

    @inline
    def begin(self, memory: SearchMemory, taylor: TaylorState) -> None:
        """Reset the search at the start of a member's run: no events, and unknown signs of the functions."""
        watch, events = memory.watched.watch, self.events
        clear(watch)
        watch.enabled, watch.fresh, taylor.inspect = 1, 1, 1
        watch.changing, watch.room = int(events.changing), MEMBER_EVENT_ROOM
        watch.hides_growth, watch.steep = int(events.hides_growth), int(events.steep)
        watch.changed = -math.inf
        for i in each(2 * len(SIDES) * events.count, width=1):
            memory.watched.sides[i] = 0
        self.occurrences.begin(memory.seen)
        memory.taken[0] = 0

    @inline
    def take(self, memory: SearchMemory, job: Any, index: int) -> None:
        """Copy new events from `memory` to the results of member `index`, which are arrays of `job.watched`.

        These events are on steps that the defect test has confirmed.
        """
        watched, watch, slot = memory.watched, memory.watched.watch, memory.taken[0]
        if unlikely(watch.done > slot):
            while slot < watch.done:
                t, state = watched.event_times[slot], watched.event_states[slot * self.dimension :]
                self.occurrences.keep(job.watched, memory.seen, index, watched.event_places[slot], t, state)
                slot += 1
            memory.taken[0] = slot
            if watch.ahead == watch.done:
                watch.done, watch.ahead, memory.taken[0] = 0, 0, 0

    @inline
    def due(self, memory: SearchMemory) -> int:
        """Return the index of the watched function that is first in the list of due functions.

        Due functions are zero at the end of the step.
        """
        return memory.watched.whole_scratch[self.events.count * PARTS["due"][1]]

    @inline
    def is_ended(self, memory: SearchMemory, outcome: int, unproven: int, last: bool) -> bool:
        """Return True if an event, and nothing else, ends the run at the present state.

        `outcome` is the code with which the loop over steps stopped. `unproven` is 1 if the defect test has not
        confirmed the last step yet. `last` is true if the budget allows no more steps.
        """
        is_due = memory.watched.watch.due == 1 and self.due(memory) < self.events.events and unproven == 0
        is_stopped = outcome == Outcome.DONE or outcome == Outcome.WATCHED
        return is_due and (is_stopped or (outcome == Outcome.PAUSED and last))


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
        reductions = None
        if sampled is not None:
            path = series_path.form(layout=layout, entries=sampled.entries)
            reductions = RunReductions(sampled, path, layout.dimension)
        super().__init__(layout.dimension, numbers, observed, reductions)
        self.layout, self.order = layout, order
        self.functions = {"law": jet} if events is None else {"law": jet, "values": events.values}
        self.search = None if events is None else EventSearch(events, layout)
        self.watched_type = None if events is None else SearchArguments

    @inline
    def memory(self, job: MemberJob, numbers: In) -> tuple[tuple[Out, ...], SeriesMemory]:
        """Return memory for the state, and an object with the other memory of a run.

        The state is one vector at the beginning of the work array.
        """
        work = reals(self.layout.size(self.order), room=WIDEST_VECTOR)
        records = TaylorState(), Held(), OutputCounts(), reals(1)
        search = None if self.search is None else self.search.memory(job, numbers)
        return (work,), SeriesMemory(work, *records, search)

    @inline
    def begin(self, job: MemberJob, member: Member) -> None:
        """Reset the state's rounding error, the counters, the series' unit of time, and the outputs."""
        method_memory = member.method_memory
        method_memory.held.unproven = 0
        clear(method_memory.outputs)
        begin_run(member.run, member.counts, method_memory.taylor, method_memory.held, method_memory.work, self.layout)
        if self.search is not None:
            self.search.begin(method_memory.search, method_memory.taylor)

    @inline
    def attempts(self, job: MemberJob, member: Member) -> int:
        """Return the number of trial steps, including the last one, which the defect test has not confirmed yet."""
        tried: int = member.counts.steps + member.counts.rejected + member.method_memory.held.unproven
        return tried

    @inline
    def advance(self, job: MemberJob, member: Member, index: int, last: bool) -> int:
        """Test the defect of the last step of member `index`, and take the next step. Return an outcome.

        The outcome is PAUSED if the run continues, else the reason of its end. `last` is true if the budget allows no
        step after this one.
        """
        run, counts, method_memory = member.run, member.counts, member.method_memory
        states = job.outputs[index * (job.output_count * self.dimension) :]
        watched = None if self.search is None else method_memory.search.watched
        records = run, counts, method_memory.taylor, member.floors, method_memory.held, method_memory.outputs
        arrays = job.output_times, states, method_memory.unused, method_memory.unused
        series = method_memory.work, self.order
        arguments: Any = member.numbers, member.numbers, *records, *arrays, watched, None, None, *series
        loop_arguments = Arguments(job.law, *arguments)
        before = counts.steps
        outcome: int = iteration(loop_arguments, last, -logarithm(job.rtol), layout=self.layout)
        if self.reductions is not None:
            # Accept the previous step if the defect test has confirmed it. Sample the last step while its series is in
            # memory.
            if counts.steps > before:
                self.reductions.accept(member.reduced)
            if method_memory.held.unproven != 0:
                held, work = method_memory.held, method_memory.work
                step = SampledStep(held.t, run.t, held.h, held.h / held.scale, work, work, self.order)
                self.reductions.follow(member.reduced, step, member.numbers, job.points)
        if self.search is None:
            return outcome
        return self.ended_by_event(self.search, job, member, index, outcome, last)

    @inline
    def ended_by_event(
        self, search: EventSearch, job: MemberJob, member: Member, index: int, outcome: int, last: bool
    ) -> int:
        """Copy new events to the results. Return ENDED_BY_EVENT if an event ends the run, else `outcome`.

        The events are those on steps that the defect test has confirmed. `index` is the number of the member,
        and `last` is true if the budget allows no more steps.
        """
        method_memory, memory = member.method_memory, member.method_memory.search
        search.take(memory, job, index)
        is_ended = search.is_ended(memory, outcome, method_memory.held.unproven, last)
        if unlikely(is_ended):
            due = search.due(memory)
            search.occurrences.keep(job.watched, memory.seen, index, due, member.run.t, method_memory.work)
        return ENDED_BY_EVENT if is_ended else outcome
