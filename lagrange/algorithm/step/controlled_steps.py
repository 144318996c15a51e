"""The loop over steps with error control.

Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., 1993, II.4.
"""

from __future__ import annotations

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.constants import (
    AFTER_BROKEN,
    AFTER_DIVERGED,
    EARLIEST,
    FAR_FROM_ZERO,
    LARGEST_CORRECTION,
    LARGEST_RETRY,
    LEAST_NORM,
    LEAST_PREVIOUS,
    PI_SHARE,
    ROUNDED_START,
    SHORTENINGS,
    SPACING,
    STRETCH_TO_END,
)
from lagrange.algorithm.step.equal_steps import discard_history, equal_steps, is_finite, kept_entries
from lagrange.algorithm.step.error_norm import error_norm, raise_floors, reject
from lagrange.algorithm.step.first_step import first_step
from lagrange.algorithm.step.memory import Layout
from lagrange.algorithm.step.run import Running, running
from lagrange.algorithm.step.trial import accept_step, project_new_state, rows_array, try_step
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import Out, larger, likely, smaller
from lagrange.program.step import LAWS, Control


def steps_of(layout: Layout) -> Procedure:
    """Return the procedure that loops over the steps of a step program."""
    control = layout.step.control
    return equal_steps.form(layout=layout) if control is None else controlled_steps.form(layout=layout, control=control)


@procedure(given=running, rows=rows_array)
def controlled_steps(
    given: Running, budget: int, times: Out, rows: Out, *, layout: Layout, control: Control
) -> Outcome:
    """Take steps with error control, and return an outcome: at the end, after `budget` trials, or on failure.

    An accepted step becomes the state, and a row. A rejected step is repeated with a shorter length.
    """
    run, counts = given.run, given.counts
    discard_history(given, layout)
    entries = kept_entries(given, layout)
    end = run.end
    distance = end - run.t
    direction = -1.0 if distance < 0.0 else 1.0
    if run.h == 0.0 and not begin(given, abs(distance), direction, layout, control):
        return Outcome.UNSCALED
    for _ in range(budget):
        t = run.t
        h = direction * smaller(abs(run.h), run.longest)
        if t == end:
            return Outcome.DONE
        is_last = abs(h) * STRETCH_TO_END >= abs(end - t)
        is_small = not abs(h) >= larger(abs(t), EARLIEST) * SPACING
        is_retry = counts.after_reject != 0
        if is_small and (not is_last or is_retry):
            return Outcome.STEP_TOO_SMALL
        after = end if is_last else t + h
        # Far from time zero a step is a difference of times. Elsewhere it is h, so that a matrix can be reused.
        length = after - t if is_last or abs(h) < abs(t) * FAR_FROM_ZERO else h
        outcome = try_step(given, t, length, entries, layout=layout)
        if is_finite(given, layout, errors=True) and outcome == Outcome.DONE:
            norm = error_norm(given, layout=layout, control=control)
            exponent = -(1 / control.exponent - PI_SHARE * control.memory)
            factor = larger(norm, LEAST_NORM) ** exponent * control.safety
            if norm <= 1.0:
                next_h = length * growth(factor, run.previous, is_retry, control)
                if layout.projected:
                    cause, moved = project_within_tolerance(given, after, entries, layout, control)
                    if likely(cause == Outcome.DONE):
                        accept(given, norm, next_h, layout)
                        accept_step(given, entries, moved, after, times, rows, layout=layout)
                    elif reject(given, float(cause), length * AFTER_DIVERGED, moved=False, layout=layout):
                        return Outcome.UNSCALED
                else:
                    accept(given, norm, next_h, layout)
                    accept_step(given, entries, None, after, times, rows, layout=layout)
            else:
                shorter = smaller(larger(factor, control.least), LARGEST_RETRY)
                if reject(given, float(Outcome.STEP_TOO_SMALL), length * shorter, moved=True, layout=layout):
                    return Outcome.UNSCALED
        else:
            cause = Outcome.NON_FINITE if outcome == Outcome.DONE else outcome
            part = AFTER_DIVERGED if outcome == Outcome.DIVERGED else AFTER_BROKEN
            if reject(given, float(cause), length * part, moved=False, layout=layout):
                return Outcome.UNSCALED
    return Outcome.DONE if run.t == end else Outcome.PAUSED


@inline
def begin(given: Running, distance: float, direction: float, layout: Layout, control: Control) -> bool:
    """Choose the length of the first step. Return False if the sizes of the entries must be estimated first.

    `distance` is the time to the end of the run without sign, and `direction` its sign.
    """
    size = first_step(given, distance, direction, layout=layout, control=control)
    if LAWS[layout.step.law].results == 1:
        given.counts.evaluations += 3
    if not size < 0.0:
        given.run.h = size * direction
    return not size < 0.0


@inline
def growth(factor: float, previous: float, is_retry: bool, control: Control) -> float:
    """Return the factor by which the step length changes after an accepted step: `factor`, within bounds.

    `factor` follows from the error norm of the step, and `previous` is the error norm of the step before. After a
    rejection (`is_retry`) the step is not made longer.
    """
    longer = factor * previous**control.memory if control.memory else factor
    longer = larger(smaller(longer, 1.0 if is_retry else control.most), control.least)
    if control.hold > 1:
        longer = 1.0 if longer >= 1.0 and longer < control.hold else longer
    return longer


@inline
def project_within_tolerance(
    given: Running, after: float, entries: Out | None, layout: Layout, control: Control
) -> tuple[Outcome, bool]:
    """Project the trial state onto the constraints. Return an outcome, and True if the state has moved.

    `after` is the time at the end of the step. The outcome is STEP_TOO_SMALL if the displacement is too large for the
    tolerance of the step.
    """
    outcome, moved = project_new_state(given, after, entries, layout)
    correction = 0.0
    if moved:
        correction = error_norm(given, layout=layout, control=control)
    begun_off = larger(ROUNDED_START / given.run.rtol, LARGEST_CORRECTION)
    most = begun_off if given.counts.after_reject >= SHORTENINGS else LARGEST_CORRECTION
    cause = Outcome.STEP_TOO_SMALL if outcome == Outcome.DONE and not correction <= most else outcome
    return cause, moved


@inline
def accept(given: Running, norm: float, h: float, layout: Layout) -> None:
    """Store the error norm of the accepted step, and the length h of the next one. Raise the floors."""
    given.run.previous = larger(norm, LEAST_PREVIOUS)
    given.run.h = h
    given.counts.after_reject = 0
    raise_floors(given.run.share, given.floors, given.work, layout)
