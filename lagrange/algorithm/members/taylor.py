"""Members that run by Taylor series of one order."""

from __future__ import annotations

from typing import Any

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.members.along import Along, Sampled, SampledStep
from lagrange.algorithm.members.occurrences import ENDED_BY_EVENT, Events, MemberOccurrences
from lagrange.algorithm.members.paths import series_path
from lagrange.algorithm.members.queue import Members, Observed, SystemNumbers
from lagrange.algorithm.taylor.loop import begin_run, iteration
from lagrange.algorithm.taylor.memory import HELD, OUTPUTS, TAYLOR, TaylorLayout
from lagrange.algorithm.taylor.step_size import logarithm
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.building import Tracer
from lagrange.procedure.rewrite import bound
from lagrange.procedure.values import Flag, Memory, Whole


class TaylorMembers(Members):
    """Runs members by the same steps as the driver of single runs, with the series as the procedure `jet`."""

    def __init__(
        self,
        layout: TaylorLayout,
        order: int,
        jet: Procedure,
        numbers: SystemNumbers,
        observed: Observed,
        sampled: Sampled | None = None,
        events: Events | None = None,
    ) -> None:
        self.events = events
        self.occurrences: MemberOccurrences | None = None
        super().__init__(layout.dimension, numbers, observed)
        p = self.p
        self.layout, self.order, self.jet = layout, order, jet
        self.work = p.reserve(layout.size(order), room=WIDEST_VECTOR, name="work")
        self.taylor: Any = p.reserve_record(TAYLOR)
        self.before: Any = p.reserve_record(HELD)
        self.written: Any = p.reserve_record(OUTPUTS)
        self.none = p.reserve(1, name="none")
        self._along: Along | None = None
        if sampled is not None:
            path = series_path.form(layout=layout, entries=sampled.entries)
            self._along = Along(p, sampled, path, self.points, self.held, layout.dimension)
        if self.occurrences is not None:
            self.occurrences.reserve(layout)
        self.digits = (-p.call(logarithm.form(), self.rtol)).called("digits")

    def announce(self) -> None:
        """Add the parameters of the events, if there are any."""
        if self.events is not None:
            self.occurrences = MemberOccurrences(self.p, self.events, self.dimension)

    @property
    def state(self) -> list[Memory]:
        """The state at the beginning of the work array."""
        return [self.work]

    @property
    def attempts(self) -> Whole:
        """Number of trial steps, including the last one, which is not proven yet."""
        found: Whole = super().attempts + self.before.unproven
        return found

    @property
    def along(self) -> Along | None:
        """The reductions of expressions along the run, or None."""
        return self._along

    def begin(self) -> None:
        """Reset the compensation, the counters, the scale of time and the outputs."""
        self.before.unproven = 0
        self.written.done = self.written.ahead = 0
        records = self.run, self.counts, self.taylor, self.before
        Tracer(self.p, ()).call(begin_run, *records, self.work, self.layout)
        if self.along is not None:
            self.along.begin(self.run.t, self.work)
        if self.occurrences is not None:
            self.occurrences.begin(self.taylor)

    def advance(self, last: Flag) -> Whole:
        """Prove the last step, and take the next one."""
        p = self.p
        given = {"prepared": self.held, "constants": self.held, "run": self.run, "counts": self.counts}
        given |= {"taylor": self.taylor, "floors": self.floors, "held": self.before, "outputs": self.written}
        given |= {"output_times": self.output_times, "times": self.none, "rows": self.none}
        given |= {"output_states": self.outputs.at(self.member.value * (self.wanted * self.dimension))}
        given |= {"last": last, "digits": self.digits, "work": self.work, "order": p.whole(self.order)}
        functions = {"jet": self.jet}
        if self.occurrences is not None:
            given |= self.occurrences.handed(self.held)
            functions["values"] = self.occurrences.events.values
        step = bound(iteration.form(layout=self.layout), functions, prefix="run_")
        steps = self.counts.steps
        found: Whole = p.call(step, *(given[one.name] for one in step.parameters))
        if self.along is not None:
            self.follow(self.along, steps)
        return found if self.occurrences is None else self.watch(self.occurrences, found, last)

    def watch(self, occurrences: MemberOccurrences, outcome: Whole, last: Flag) -> Whole:
        """Copy the events of proven steps, and return the outcome: ENDED_BY_EVENT if an event ends the run."""
        p, member = self.p, self.member.value
        occurrences.take(member)
        ended = occurrences.ended(outcome, self.before.unproven, last)
        with p.when(ended, likely=False):
            occurrences.keep(member, occurrences.due, self.run.t, self.work)
        found: Whole = p.choose(ended, ENDED_BY_EVENT, outcome)
        return found

    def follow(self, along: Along, steps: Whole) -> None:
        """Sample expressions on the last step while its series is in memory; commit the one before if it is proven."""
        p, held = self.p, self.before
        with p.when(self.counts.steps > steps):
            along.accept()
        with p.when(~held.unproven.equals(0)):
            order, h = p.whole(self.order), held.h
            along.follow(SampledStep(held.t, self.run.t, h, h / held.scale, self.work, self.work, order))
