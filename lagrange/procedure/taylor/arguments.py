"""The arguments that the loop over Taylor steps passes to its parts."""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import Array, Kind
from lagrange.procedure.projection import CORRECTIONS
from lagrange.procedure.step.run import COUNTS, RUN
from lagrange.procedure.taylor.memory import (
    HELD,
    JET,
    OUTPUTS,
    TAYLOR,
    SeriesMemory,
    TaylorLayout,
    floors_array,
    work_array,
)
from lagrange.procedure.taylor.watching import Watched


class Arguments:
    """The arguments of the loop, of its iterations and of a step: the common ones, and a procedure's `own`."""

    def __init__(self, p: Builder, layout: TaylorLayout, **own: Kind | Array) -> None:
        self.p, self.layout = p, layout
        self.jet = p.function("jet", JET)
        self.prepared, self.constants = p.array("prepared", read=True), p.array("constants", read=True)
        self.run: Any = p.record("run", RUN)
        self.counts: Any = p.record("counts", COUNTS)
        self.taylor: Any = p.record("taylor", TAYLOR)
        self.floors = floors_array(p, layout, read=False)
        self.held: Any = p.record("held", HELD)
        self.outputs: Any = p.record("outputs", OUTPUTS)
        self.output_times, self.output_states = (
            p.array("output_times", read=True),
            p.array("output_states", room=layout.block),
        )
        self.times, self.rows = p.array("times"), p.array("rows", room=layout.block)
        self.watched = Watched(p, layout) if layout.watched else None
        self.projection: tuple[Any, ...] = ()
        """The function of the corrections onto the constraints, and its numbers; empty without constraints."""
        if layout.projected:
            self.projection = p.function("projection", CORRECTIONS), p.array("projection_numbers", read=True)
        self.own = [p.given(name, kind) for name, kind in own.items()]
        self.series = SeriesMemory(p, layout, work_array(p))

    def handed(self, *own: Any) -> tuple[Any, ...]:
        """Return the arguments for another procedure, followed by its own."""
        records = self.run, self.counts, self.taylor, self.floors, self.held
        watched = self.watched.handed if self.watched else ()
        written = *self.output, self.times, self.rows, *watched
        fixed = self.jet, self.prepared, self.constants
        return (*fixed, *records, *written, *self.projection, *own, *self.series.handed)

    @property
    def numbers(self) -> tuple[Any, ...]:
        """The prepared numbers of the series: with switching surfaces, those for the present sides."""
        if self.watched is None or self.layout.observes:
            return self.prepared, self.constants
        place = self.watched.record.numbers
        return self.prepared.at(place), self.constants.at(place)

    @property
    def output(self) -> tuple[Any, ...]:
        """The arguments of a procedure that writes states at output times."""
        return self.outputs, self.output_times, self.output_states
