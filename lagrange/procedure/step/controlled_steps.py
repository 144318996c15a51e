"""The loop over steps with error control.

Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., 1993, II.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import WHOLE, Procedure
from lagrange.procedure.outcome import Outcome
from lagrange.procedure.step.constants import (
    AFTER_BROKEN,
    AFTER_DIVERGED,
    EARLIEST,
    FAR_FROM_ZERO,
    LARGEST_CORRECTION,
    LARGEST_RETRY,
    LEAST_NORM,
    LEAST_PREVIOUS,
    NEAR_END,
    PI_SHARE,
    ROUNDED_START,
    SHORTENINGS,
    SPACING,
)
from lagrange.procedure.step.equal_steps import discard_history, equal_steps, is_finite, keep_entries, leave_at_budget
from lagrange.procedure.step.error_norm import error_norm, raise_floors, reject
from lagrange.procedure.step.first_step import first_step
from lagrange.procedure.step.memory import Layout
from lagrange.procedure.step.projection import project_new_state
from lagrange.procedure.step.trial import Running, accept_step, try_step
from lagrange.procedure.values import Flag, Memory, Real
from lagrange.program.actions import LAWS
from lagrange.program.step import Control


def controlled_steps(layout: Layout, control: Control) -> Procedure:
    """Return the loop; it returns at the end, after `budget` trials, or when no step succeeds."""
    return _ControlledLoop(layout, control).build()


def steps_of(layout: Layout) -> Procedure:
    """Return the loop over the steps of a step program."""
    control = layout.step.control
    return equal_steps(layout) if control is None else controlled_steps(layout, control)


class _ControlledLoop:
    """Builds the procedure."""

    def __init__(self, layout: Layout, control: Control) -> None:
        self.p = p = Builder("controlled_steps", "Take steps that follow the error, and return an outcome.")
        self.layout, self.control = layout, control
        self.rejection, self.measure = reject(layout), error_norm(layout, control)
        self.given = Running(p, layout)
        self.run, self.counts = self.given.run, self.given.counts
        self.budget = p.given("budget", WHOLE)
        self.times, self.rows = p.array("times"), p.array("rows", room=layout.block)

    def build(self) -> Procedure:
        p, run = self.p, self.run
        discard_history(self.given)
        entries = keep_entries(self.given)
        end = run.end
        direction = self.begin(end)
        with p.loop(0, self.budget):
            t = run.t
            h = direction * p.smaller(abs(run.h), run.longest)
            p.leave_if(t.equals(end), Outcome.DONE)
            final = abs(h) * NEAR_END >= abs(end - t)
            small = ~(abs(h) >= p.larger(abs(t), EARLIEST) * SPACING)
            rejected = ~self.counts.after_reject.equals(0)
            p.leave_if(small & (~final | rejected), Outcome.STEP_TOO_SMALL)
            after = p.choose(final, end, t + h)
            p.note(
                "Far from time zero a step is a difference of times; elsewhere it is h, so that a matrix serves again."
            )
            length = p.choose(final | (abs(h) < abs(t) * FAR_FROM_ZERO), after - t, h)
            self.trial(t, length, after, rejected, entries)
        leave_at_budget(self.given, end)
        return p.finish(WHOLE)

    def begin(self, end: Real) -> Real:
        """Choose the length of the first step if none is given; return the direction of time."""
        p, run = self.p, self.run
        distance = end - run.t
        direction = p.real(p.choose(distance < 0.0, -1.0, 1.0))
        with p.when(run.h.equals(0.0)):
            size = p.call(first_step(self.layout, self.control), *self.given.handed, abs(distance), direction)
            if LAWS[self.layout.step.law].results == 1:
                self.counts.evaluations = self.counts.evaluations + 3
            p.leave_if(size < 0.0, Outcome.UNSCALED)
            run.h = size * direction
        return direction

    def trial(self, t: Real, length: Real, after: Real, rejected: Flag, entries: Sequence[Memory]) -> None:
        """Take a trial step; reject it if it fails or is not finite, else test its error."""
        p = self.p
        outcome = p.call(try_step(self.layout), *self.given.handed, t, length, *entries)
        done = outcome.equals(Outcome.DONE)
        with p.when(is_finite(self.given, errors=True) & done) as ways:
            self.control_error(length, after, rejected, entries)
        with ways.otherwise():
            cause = p.choose(done, float(Outcome.NON_FINITE), p.real(outcome))
            part = p.choose(outcome.equals(Outcome.DIVERGED), AFTER_DIVERGED, AFTER_BROKEN)
            self.reject(cause, length * part, moved=False)

    def control_error(self, length: Real, after: Real, rejected: Flag, entries: Sequence[Memory]) -> None:
        """Accept or reject a finite trial step by its error norm, and choose the length of the next one."""
        p, run, control, given = self.p, self.run, self.control, self.given
        norm = p.call(self.measure, run, given.floors, given.work).called("norm")
        exponent = -(1 / control.exponent - PI_SHARE * control.memory)
        factor: Any = p.larger(norm, LEAST_NORM) ** exponent * control.safety
        with p.when(norm <= 1.0) as ways:
            longer = factor * run.previous**control.memory if control.memory else factor
            longer = p.larger(p.smaller(longer, p.choose(rejected, 1.0, control.most)), control.least)
            if control.hold > 1:
                longer = p.choose((longer >= 1.0) & (longer < control.hold), 1.0, longer)
            self.project(norm, length, length * longer, after, entries)
        with ways.otherwise():
            shorter = p.smaller(p.larger(factor, control.least), LARGEST_RETRY)
            self.reject(float(Outcome.STEP_TOO_SMALL), length * shorter, moved=True)

    def project(self, norm: Real, length: Real, longer: Real, after: Real, entries: Sequence[Memory]) -> None:
        """Accept the trial step, on the constraints of the system if it has any; reject it if it cannot get there."""
        p = self.p
        if not self.layout.projected:
            self.accept(norm, longer, after, entries)
            return
        outcome, moved = project_new_state(self.given, after, entries)
        done, correction = outcome.equals(Outcome.DONE), p.variable(0.0, "correction")
        with p.when(moved):
            correction.value = p.call(self.measure, self.run, self.given.floors, self.given.work)
        begun_off = p.larger(ROUNDED_START / self.run.rtol, LARGEST_CORRECTION)
        most = p.choose(self.counts.after_reject >= SHORTENINGS, begun_off, LARGEST_CORRECTION)
        with p.when(done & (correction.value <= most), likely=True) as ways:
            self.accept(norm, longer, after, [*entries, moved])
        with ways.otherwise():
            cause = p.choose(done, float(Outcome.STEP_TOO_SMALL), p.real(outcome))
            self.reject(cause, length * AFTER_DIVERGED, moved=False)

    def accept(self, norm: Real, longer: Real, after: Real, more: Sequence[Any]) -> None:
        """Accept the trial step, and take a longer or shorter one next."""
        p, run, given = self.p, self.run, self.given
        run.previous = p.larger(norm, LEAST_PREVIOUS)
        run.h = longer
        self.counts.after_reject = 0
        raise_floors(given)
        accepted = (run, self.counts, *given.newtons, given.work, *more)
        p.call(accept_step(self.layout), *accepted, after, self.times, self.rows)

    def reject(self, cause: Any, h: Real, *, moved: bool) -> None:
        """Try again with a step of h; return to the caller if the sizes of the entries are needed."""
        p, given = self.p, self.given
        flag = p.true if moved else p.false
        asked = p.call(self.rejection, self.run, self.counts, given.floors, given.work, cause, h, flag)
        p.leave_if(asked, Outcome.UNSCALED)
