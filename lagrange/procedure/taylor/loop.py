"""The loop over Taylor steps: look from where the run stands, prove the step that led there, take the next one."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.outcome import Outcome
from lagrange.procedure.step.constants import SURVEYS
from lagrange.procedure.step.run import COUNTS, RUN
from lagrange.procedure.taylor.floors import first_floors
from lagrange.procedure.taylor.memory import HELD, JET, TAYLOR, Run, TaylorLayout, floors_array, work_array
from lagrange.procedure.taylor.powers import logarithm
from lagrange.procedure.taylor.proof import agrees, hopeless, record, take_back
from lagrange.procedure.taylor.step import take_step
from lagrange.procedure.taylor.step_size import choose_exponent, weigh
from lagrange.procedure.values import Flag, Memory, Real


class _Given:
    """The arguments of the loop and of each of its turns."""

    def __init__(self, p: Builder, layout: TaylorLayout, *own: str) -> None:
        self.p, self.layout = p, layout
        self.jet = p.function("jet", JET)
        self.prepared, self.constants = p.array("prepared", read=True), p.array("constants", read=True)
        self.run: Any = p.record("run", RUN)
        self.counts: Any = p.record("counts", COUNTS)
        self.taylor: Any = p.record("taylor", TAYLOR)
        self.floors = floors_array(p, layout, read=False)
        self.held: Any = p.record("held", HELD)
        self.times, self.rows = p.array("times"), p.array("rows", room=layout.block)
        self.own = [p.given(name, _KINDS[name]) for name in own]
        self.series = Run(p, layout, work_array(p, layout))

    def handed(self, *own: Any) -> tuple[Any, ...]:
        """Return the arguments for another procedure, with those of its own."""
        records = self.run, self.counts, self.taylor, self.floors, self.held, self.times, self.rows
        return (self.jet, self.prepared, self.constants, *records, *own, *self.series.handed)

    def leave_if(self, condition: Flag, outcome: Outcome) -> None:
        """End the procedure with an outcome where a condition holds."""
        with self.p.when(condition):
            self.p.leave(int(outcome))

    def leave_unscaled(self, asked: Flag) -> None:
        """Come back on a condition for a look at how large the entries are, where floors follow them; see `Outcome`."""
        self.leave_if(asked & (self.run.share > 0.0) & (self.counts.surveyed < SURVEYS), Outcome.UNSCALED)


_KINDS = {"budget": WHOLE, "last": FLAG, "digits": REAL}


@cache
def taylor_steps(layout: TaylorLayout) -> Procedure:
    """Return the loop; it comes back at the end, after so many steps as `budget` says, or where a step fails."""
    p = Builder("taylor_steps", "Take Taylor steps towards the end, and return an outcome.")
    given = _Given(p, layout, "budget")
    run, counts, budget = given.run, given.counts, given.own[0]
    counts.rows = 0
    given.held.waits = 0
    with p.when(counts.kept.equals(0)):
        _begin(given)
    p.note("Minus the binary logarithm of the relative tolerance.")
    digits = (-p.call(logarithm(), run.rtol)).called("digits")
    p.note("The last turn does no more than prove the last step.")
    with p.loop(0, budget + 1) as i:
        outcome = p.call(turn(layout), *given.handed(i.equals(budget), digits))
        with p.when(~outcome.equals(int(Outcome.PAUSED)), likely=False):
            p.leave(outcome)
    p.leave(int(Outcome.PAUSED))
    return p.finish(WHOLE)


def _begin(given: _Given) -> None:
    """Nothing is lost yet, no step was taken, and the scale of time has the sign of the run's direction.

    Who watches may have asked for a look at the first step.
    """
    p, run, taylor, layout = given.p, given.run, given.taylor, given.layout
    given.counts.kept = 1
    low = given.series.work.at(layout.lost)
    with given.series.entries() as i:
        low[i] = 0.0
    taylor.low, given.held.h = 0.0, 0.0
    taylor.scale = p.choose(run.end < run.t, -1.0, p.real(1.0))
    taylor.once = taylor.limit = math.inf
    taylor.tries = taylor.fails = 0


@cache
def turn(layout: TaylorLayout) -> Procedure:
    """Return one turn of the loop."""
    p = Builder("turn", "Prove the last step, take the next one, and return an outcome: paused where the run goes on.")
    given = _Given(p, layout, "last", "digits")
    run, counts, held, series = given.run, given.counts, given.held, given.series
    last, digits = given.own
    there: Flag = run.t.equals(run.end).called("there")
    idle: Flag = held.waits.equals(0).called("idle")
    given.leave_if(idle & there, Outcome.DONE)
    given.leave_if(idle & last, Outcome.PAUSED)
    rows, numbers = series.work.at(layout.rows), (given.prepared, given.constants)
    singular: Flag = given.jet(run.t, given.taylor.scale, series.work, *numbers, rows, series.order).called("singular")
    counts.evaluations = counts.evaluations + 1
    weights = p.reserve(layout.padded, room=layout.block, name="weights")
    p.call(weigh(layout), run.rtol, given.floors, weights, series.work)
    with p.when(~idle, likely=True):
        _prove(given, weights, singular)
        given.leave_if(there, Outcome.DONE)
        given.leave_if(last, Outcome.PAUSED)
    given.leave_if(singular, Outcome.SINGULAR)
    _begin_floors(given, weights)
    sizes = run.rtol, digits, given.floors, weights
    exponent: Real = p.call(choose_exponent(layout), *sizes, *series.handed).called("exponent")
    records = run, counts, given.taylor, given.floors, held
    p.leave(p.call(take_step(layout), given.jet, *numbers, *records, exponent, *series.handed))
    return p.finish(WHOLE)


def _prove(given: _Given, weights: Memory, singular: Flag) -> None:
    """Record the step that led here, or take it back; where steps fail again and again, ask how large entries are."""
    p, layout, counts, held, series = given.p, given.layout, given.counts, given.held, given.series
    length = abs(held.h) / abs(given.taylor.scale)
    first = layout.rows + layout.width
    good = p.call(agrees(layout), length, series.order, first, weights, series.work).called("good")
    with p.when(~((good & ~singular) | hopeless(given.taylor)), likely=False):
        p.call(take_back(layout), given.run, counts, given.taylor, held, series.work)
        failed = p.real(counts.rejected)
        power_of_two = p.operation("mantissa", failed).equals(1.0)
        given.leave_unscaled((failed > 1.0) & power_of_two)
        p.leave(int(Outcome.PAUSED))
    p.call(record(layout), given.run, counts, given.taylor, held, series.work, given.times, given.rows)


def _begin_floors(given: _Given, weights: Memory) -> None:
    """Begin floors that follow the scale where a run begins, or tries a scale of time, until it is surveyed."""
    p, layout, run, counts, taylor = given.p, given.layout, given.run, given.counts, given.taylor
    begins = (counts.steps.equals(0) | ~taylor.tries.equals(0)) & counts.surveyed.equals(0)
    with p.when(begins & (run.share > 0.0), likely=False):
        given.leave_unscaled(p.call(first_floors(layout), run.share, given.floors, *given.series.handed))
        p.call(weigh(layout), run.rtol, given.floors, weights, given.series.work)
