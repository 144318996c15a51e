"""One trial step of a step program, and its acceptance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.compensated import compensated
from lagrange.algorithm.newton.corrections import product, solve_unknowns
from lagrange.algorithm.newton.prediction import keep
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.projection import CORRECTIONS
from lagrange.algorithm.step.memory import Effort, Layout, Newton, work_array
from lagrange.algorithm.step.run import Counts, Run
from lagrange.algorithm.step.vectors import BY_PLACE, READ, Given, Sum, Vectors, law_of
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, WHOLE, Array, Procedure
from lagrange.procedure.front.plain import Bundle, Stated, inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, form_of, generated, unrolled
from lagrange.procedure.values import Memory
from lagrange.program.actions import Damp, LawCall


def take_step(layout: Layout, prefix: str = "") -> Procedure:
    """Return the trial of a step; names of procedures begin with the prefix."""
    step = layout.step
    p = Builder(f"{prefix}take", "Try a step, and return an outcome; the slope at its start may be known.")
    given = Given(p, layout)
    slope_known = p.given("slope_known", FLAG)
    entries = entries_of(p, layout)
    calls = [argument for call in step.calls for argument in call.arguments]
    others = [*(damp.vector for damp in step.damps), *step.results, *step.errors]
    vectors = Vectors(given, [*calls, *others], [call.time for call in step.calls], state=entries)
    singular = p.variable(p.false, "singular")
    solves = iter(zip(layout.solves, given.newtons, strict=True))
    for i, action in enumerate(step.actions):
        if isinstance(action, LawCall) and i == 0 and step.starts_with_slope:
            with p.when(~slope_known):
                vectors.evaluate(action, singular)
        elif isinstance(action, LawCall):
            vectors.evaluate(action, singular, always=True)
        elif isinstance(action, Damp):
            _damp(vectors, action)
        else:
            solve, newton = next(solves)
            given.leave_unless_done(p.call(solve_unknowns(layout, solve, prefix), *given.handed(newton)))
    for i in range(step.states):
        _keep_result(vectors, i, entries)
    for i, error in enumerate(step.errors):
        vectors.combine(error, vectors.at(layout.errors + i))
    p.leave_if(singular.value, Outcome.SINGULAR)
    p.leave(Outcome.DONE)
    return p.finish(WHOLE)


def entries_of(p: Builder, layout: Layout) -> Memory | None:
    """Return the array of the entries of the state and of the new state, if they are kept."""
    return p.array("entries", size=2 * layout.dimension) if layout.keeps_entries else None


def _damp(vectors: Vectors, damp: Damp) -> None:
    """Write (I - factor J)^-1 times a vector."""
    layout, work = vectors.layout, vectors.work
    solve = layout.solves[damp.of]
    vectors.combine(damp.vector, work.at(solve.residual))
    result = vectors.at(damp.result)
    with product(vectors.given, solve, work.at(solve.damper(damp)), 1) as (i, value):
        result[i] = value


def _keep_result(vectors: Vectors, state: int, entries: Memory | None) -> None:
    """Write a new state; as a compensated sum of the old state and the step if rounding errors are kept.

    Source: D. E. Knuth, The Art of Computer Programming, vol. 2, 3rd ed., 1997, 4.2.2, theorem B.
    """
    p, layout, work = vectors.p, vectors.layout, vectors.work
    step = layout.step
    result, new = step.results[state], vectors.at(layout.new + state)
    if entries is not None:
        values = vectors.entries(result)
        vectors.keep_entries(values, new)
        for k, value in enumerate(values):
            entries[layout.dimension + state * layout.length + k] = value
        return
    if not step.compensated(state):
        vectors.combine(result, new)
        return
    added = Sum(vectors, tuple(term for term in result if term != (state, step.graph.one)))
    old = vectors.at(state)
    lost, tried = (work.at(layout.lost + (i * step.states + state) * layout.width) for i in (0, 1))
    with p.each(layout.width, spill=True) as i:
        new[i], tried[i] = compensated(old[i], added[i] + lost[i])


@dataclass(frozen=True)
class Running:
    """The arguments of a procedure that takes steps of a run."""

    law: Callable[..., Any]
    parameters: In
    jacobian: Callable[..., Any]
    """The derivative of the law."""

    constants: In
    """The parameters of the derivative."""

    run: Run
    counts: Counts
    floors: Out
    """The absolute tolerance of each entry of the state, (dimension,)."""

    effort: Effort
    newtons: tuple[Newton, ...]
    """The records of the solves of the step."""

    starters: tuple[Newton, ...]
    """The records of the solves of the starter."""

    work: Out
    """The vectors of the step and the data of its solves; see `Layout`."""

    projection: Callable[..., Any]
    """The corrections that constraints want, None without constraints."""

    projection_numbers: In
    """The parameters of the projection."""


def running(layout: Layout) -> Bundle:
    """Return the type of the arguments of a run."""
    newton = form_of(Newton)
    starters = len(layout.starting.solves) if layout.step.starter is not None else 0
    types: dict[str, Stated] = {
        "law": law_of(layout),
        "jacobian": BY_PLACE,
        "floors": Array(size=layout.dimension, room=layout.block),
        "newtons": (newton,) * len(layout.solves),
        "starters": (newton,) * starters,
        "work": work_array(layout),
        "projection": CORRECTIONS if layout.projected else None,
        "projection_numbers": READ if layout.projected else None,
    }
    return Bundle(Running, types)


def entries_array(layout: Layout) -> Array | None:
    """Return the type of the array of the entries of the state and of the new state, None if they are not kept."""
    return Array(size=2 * layout.dimension) if layout.keeps_entries else None


def rows_array(layout: Layout) -> Array:
    """Return the type of the array of rows, the states of a run."""
    return Array(room=layout.block)


@procedure(given=running, entries=entries_array)
def try_step(given: Running, t: float, h: float, entries: Out | None, *, layout: Layout) -> Outcome:
    """Try a step of a run, count what it takes, and return an outcome.

    The starter takes it if the state one step back is not known.
    """
    step, counts, effort = layout.step, given.counts, given.effort
    if layout.keeps_history:
        effort.evaluations = 0
    if step.starter is None:
        known = counts.slope_known != 0
        counts.evaluations += len(step.calls) - int(known) if step.starts_with_slope else len(step.calls)
        outcome = take(given, t, h, known, entries, layout)
    else:
        # A step from two states needs them at the distance of this one.
        equal = h == given.run.step
        given.work[layout.flags + 1] = float(equal)
        if equal and given.work[layout.flags] == 1.0:
            counts.evaluations += len(step.calls)
            outcome = take(given, t, h, slope_known=False, entries=entries, layout=layout)
        else:
            counts.evaluations += len(layout.starting.step.calls)
            outcome = take_starting_step(given, t, h, layout)
    if layout.keeps_history:
        counts.evaluations += effort.evaluations
        given.run.residual = effort.residual
    if step.starts_with_slope:
        counts.slope_known = 1
    return outcome


@inline
def take(given: Running, t: float, h: float, slope_known: bool, entries: Out | None, layout: Layout) -> Outcome:
    """Take a step from the state, and return the outcome."""
    laws = given.law, given.parameters, given.jacobian, given.constants
    numbers = t, h, given.run.rtol, given.floors
    outcome: Outcome = generated(
        take_step(layout), laws, numbers, given.effort, given.newtons, given.work, slope_known, entries
    )
    return outcome


@inline
def take_starting_step(given: Running, t: float, h: float, layout: Layout) -> Outcome:
    """Take a step of the starter, in its own memory, and return the outcome."""
    work, starting, width = given.work, layout.starting, layout.width
    memory = work[layout.end :]
    for i in unrolled(layout.step.states):
        copy_vector(work[layout.place(i) :], memory[starting.place(i) :], width)
    laws = given.law, given.parameters, given.jacobian, given.constants
    numbers = t, h, given.run.rtol, given.floors
    slope_known = False
    outcome: Outcome = generated(
        take_step(starting, "starter_"), laws, numbers, given.effort, given.starters, memory, slope_known
    )
    for i in unrolled(layout.step.states):
        copy_vector(memory[starting.place(starting.new + i) :], work[layout.place(layout.new + i) :], width)
    return outcome


@inline
def copy_vector(source: In, target: Out, width: int) -> None:
    """Copy a vector of the work array in whole blocks."""
    for i in each(width, spill=True, disjoint=True):
        target[i] = source[i]


@procedure(
    newtons=lambda layout: (form_of(Newton),) * len(layout.solves),
    work=work_array,
    entries=entries_array,
    moved=lambda layout: FLAG if layout.projected else None,
    rows=rows_array,
)
def accept_step(
    run: Run,
    counts: Counts,
    newtons: tuple[Newton, ...],
    work: Out,
    entries: Out | None,
    moved: bool | None,
    t: float,
    times: Out,
    rows: Out,
    *,
    layout: Layout,
) -> None:
    """Make the trial step the state at a time, and a row where rows are kept.

    If the projection has `moved` the state, the slope at the end of the step is not that of the state.
    """
    step, width = layout.step, layout.width
    run.t = t
    if step.starter is not None:
        work[layout.flags] = work[layout.flags + 1]
    for i in unrolled(step.states):
        state, new = work[layout.place(i) :], work[layout.place(layout.new + i) :]
        if step.starter is not None:
            copy_vector(state, work[layout.place(step.states + i) :], width)
        copy_vector(new, state, width)
        if step.compensated(i):
            lost = layout.lost + i * width
            copy_vector(work[lost + step.states * width :], work[lost:], width)
    if entries is not None:
        for k in unrolled(layout.dimension):
            entries[k] = entries[layout.dimension + k]
    if step.ends_with_slope:
        copy_vector(work[layout.place(step.calls[-1].first) :], work[layout.place(step.calls[0].first) :], width)
    is_known = int(step.ends_with_slope)
    counts.slope_known = is_known if moved is None else 0 if moved else is_known
    for solve, newton in zip(layout.solves, newtons, strict=True):
        generated(keep(layout, solve), newton, work)
    counts.steps += 1
    if counts.record != 0:
        row = counts.rows
        times[row] = t
        for i in unrolled(step.states):
            copy_vector(work[layout.place(i) :], rows[row * layout.dimension + i * layout.length :], width)
        counts.rows = row + 1
