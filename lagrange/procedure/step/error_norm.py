"""The error norm of step control, and the floors of the tolerances."""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.step.constants import DAMPING, LEAST_FLOOR, MOST_SURVEYS, REJECTIONS_BEFORE_SURVEY, ROUNDED
from lagrange.procedure.step.memory import Layout
from lagrange.procedure.step.run import COUNTS, RUN
from lagrange.procedure.step.trial import Running
from lagrange.procedure.step.vectors import floors_of
from lagrange.procedure.values import Flag, Memory, Real
from lagrange.program.step import Control


def error_norm(layout: Layout, control: Control) -> Procedure:
    """Return the error of a step relative to its tolerance; with two error vectors, the norm of DOP853."""
    p = Builder("error_norm", "Return the error of the trial step against its tolerances.")
    run: Any = p.record("run", RUN)
    floors = floors_of(p, layout)
    work = p.array("work", size=layout.size, room=layout.block, read=True)
    states, rtol = layout.step.states, run.rtol
    totals: list[Real] = []
    for state in range(states):
        old, new, floor = (
            *(work.at(layout.place(k + state)) for k in (0, layout.new)),
            floors.at(state * layout.length),
        )
        errors = [work.at(layout.place(layout.errors + i)) for i in range(state, len(layout.step.errors), states)]
        with p.each(layout.width if states == 1 else layout.length) as i:
            scale = p.fma(rtol, p.larger(abs(old[i]), abs(new[i])), floor[i])
            ratios = [error[i] / scale for error in errors]
            sums = [p.dot(ratio, ratio) for ratio in ratios]
        found = [one.value for one in sums]
        totals = [before + one for before, one in zip(totals, found, strict=True)] if state else found
    first, n = totals[0], float(layout.dimension)
    if control.damped:
        mixed = p.fma(DAMPING, totals[1], first)
        p.leave(first / p.sqrt(p.choose(mixed > 0.0, mixed * n, 1.0)))
    else:
        p.leave(p.sqrt(first / n))
    return p.finish(REAL)


def reject(layout: Layout) -> Procedure:
    """Return the procedure for a rejected step; its result says whether to ask for the sizes of the entries.

    They are asked for after several consecutive rejections, or if an entry has no size yet. If the trial `moved` the
    state, an entry that it left at zero does not count. They are also asked for at the first, second, fourth, eighth,
    ... rejection if the entry with the largest error may be the rounding of larger ones; see `ROUNDED`.
    """
    about = "Have a step tried again with another length, and say whether to ask how large the entries are."
    p = Builder("reject", about, apart=True)
    run: Any = p.record("run", RUN)
    counts: Any = p.record("counts", COUNTS)
    floors = floors_of(p, layout)
    work = p.array("work", size=layout.size, room=layout.block, read=True)
    cause, h, moved = p.given("cause", REAL), p.given("h", REAL), p.given("moved", FLAG)
    run.cause = cause
    run.h = h
    counts.after_reject = counts.after_reject + 1
    counts.rejected = counts.rejected + 1
    asked = counts.after_reject.equals(REJECTIONS_BEFORE_SURVEY)
    for state in range(layout.step.states):
        new, own = work.at(layout.place(layout.new + state)), floors.at(state * layout.length)
        with p.each(layout.width if layout.step.states == 1 else layout.length) as i:
            floor = own[i]
            size = abs(p.choose(moved, new[i], floor))
            blank = p.largest(p.choose(floor <= LEAST_FLOOR, size, 0.0))
        asked = asked | (blank.value > 0.0)
    may_ask = (run.share > 0.0) & (counts.surveyed < MOST_SURVEYS)
    p.leave_if(asked | ~may_ask, asked & may_ask)
    power_of_two = p.operation("mantissa", p.real(counts.rejected)).equals(1.0)
    p.leave_if(~(moved & power_of_two), p.false)
    p.leave(_rounding_errs_most(p, layout, run.rtol, floors, work))
    return p.finish(FLAG)


def _rounding_errs_most(p: Builder, layout: Layout, rtol: Real, floors: Memory, work: Memory) -> Flag:
    """Return whether the largest error of a trial is that of an entry that may be rounding; see `ROUNDED`."""
    states, half = layout.step.states, layout.dimension // 2
    rounded, others = p.variable(0.0, "rounded"), p.variable(0.0, "others")
    for kind in range(2):
        state, begin = (0, kind * half) if states == 1 else (kind, 0)
        old, new = (work.at(layout.place(k + state)) for k in (0, layout.new))
        errors = [work.at(layout.place(layout.errors + i)) for i in range(state, len(layout.step.errors), states)]
        largest = p.variable(0.0, "largest")
        with p.loop(begin, begin + half) as i:
            largest.value = p.larger(largest.value, abs(new[i]))
        with p.loop(begin, begin + half) as i:
            tolerance = p.fma(rtol, p.larger(abs(old[i]), abs(new[i])), floors.at(state * layout.length)[i])
            error = abs(errors[0][i])
            for other in errors[1:]:
                error = p.larger(error, abs(other[i]))
            ratio, small = error / tolerance, tolerance < ROUNDED * largest.value
            rounded.value = p.larger(rounded.value, p.choose(small, ratio, 0.0))
            others.value = p.larger(others.value, p.choose(small, 0.0, ratio))
    found: Flag = rounded.value > others.value
    return found


def raise_floors(given: Running) -> None:
    """Raise the floors to their share of the new state."""
    p, layout = given.p, given.layout
    share, one = given.run.share, layout.step.states == 1
    for state in range(layout.step.states):
        new, floors = given.work.at(layout.place(layout.new + state)), given.floors.at(state * layout.length)
        with p.each(layout.width if one else layout.length, spill=one) as i:
            floors[i] = higher(p, share * abs(new[i]), floors[i])


def higher(p: Builder, value: Real, floor: Real) -> Any:
    """Return the larger of a value and a floor; the floor if the value is NaN."""
    return p.choose(value > floor, value, floor)
