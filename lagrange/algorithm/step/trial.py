"""One trial step of a step program, the projection of its new state, and the record of an accepted step."""

from __future__ import annotations

from dataclasses import replace

from lagrange.algorithm.constants import Outcome
from lagrange.algorithm.projection import compensated, project
from lagrange.algorithm.step.memory import Layout, Running, running
from lagrange.algorithm.step.newton_corrections import keep_unknowns, product_of, solve_unknowns
from lagrange.algorithm.step.vectors import NO_REGISTERS, StepVectors, copy_vector, vectors_of
from lagrange.procedure.form import FLAG, Array
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import Out, each, reals, unrolled
from lagrange.program.step import Damp, Solve


def entries_array(layout: Layout) -> Array | None:
    """Return the type of an array of the old and the new state; None if they are not kept in registers."""
    return Array(size=2 * layout.dimension) if layout.keeps_entries else None


def rows_array(layout: Layout) -> Array:
    """Return the type of an array of rows, each of which is an accepted state of a run."""
    return Array(room=layout.block)


@procedure(arguments=running, entries=entries_array)
def take_step(
    arguments: Running, t: float, h: float, slope_known: bool, entries: Out | None, *, layout: Layout
) -> Outcome:
    """Compute a trial step of length h from time t, and return DONE, SINGULAR or a failure of Newton's method.

    The new state and the errors are in the work array. `slope_known` is true if the derivative at the start of the
    step is stored already. `entries` has the entries of the old state, then those of the new state, if they are
    kept in registers; else it is None.
    """
    step = layout.step
    combinations = [*[action.vector for action in step.damps], *step.results, *step.errors]
    vectors = vectors_of(arguments, t, h, layout, step.calls, combinations, state=entries)
    is_singular, registers = False, NO_REGISTERS
    for action in step.actions:
        if isinstance(action, Damp):
            damp(vectors, action)
        elif isinstance(action, Solve):
            outcome = solve_unknowns(arguments, t, h, layout=layout, solve=layout.solves[step.solves.index(action)])
            if outcome != Outcome.DONE:
                return outcome
        elif step.starts_with_slope and action is step.calls[0]:
            if not slope_known:
                is_singular, _ = vectors.evaluate(action)
        else:
            failed, results = vectors.evaluate(action, registers)
            is_singular = is_singular or failed
            registers = dict([*registers.items(), *results.items()])
    for state, result in enumerate(step.results):
        new = vectors.at(layout.new + state)
        if entries is not None:
            values = vectors.entries(result, registers)
            vectors.store(values, new)
            for k, value in enumerate(values):
                entries[layout.dimension + state * layout.length + k] = value
        elif step.is_compensated(state):
            add_compensated(vectors, state)
        else:
            vectors.combine(result, new)
    for k, error in enumerate(step.errors):
        vectors.combine(error, vectors.at(layout.errors + k))
    return Outcome.SINGULAR if is_singular else Outcome.DONE


@inline
def damp(vectors: StepVectors, action: Damp) -> None:
    """Write the vector (I - factor J)^-1 x of a damping action, where J is the right-hand side's derivative.

    `vectors` are the vectors of the step. x is a combination of these vectors, and the result is one of them.
    """
    layout, work = vectors.layout, vectors.running.work
    solve, result = layout.solves[action.of], vectors.at(action.result)
    vectors.combine(action.vector, work[solve.residual :])
    product = product_of(work[solve.damper(action) :], work[solve.residual :], solve, 1)
    for i in each(layout.width, spill=True, unrolled=product.is_short, disjoint=True):
        result[i] = product.entry(i)


@inline
def add_compensated(vectors: StepVectors, state: int) -> None:
    """Write vector `state` of the new state: the compensated sum of the old vector and its increment."""
    layout, work, step = vectors.layout, vectors.running.work, vectors.layout.step
    old_term = state, step.graph.one
    added = vectors.terms(tuple([term for term in step.results[state] if term != old_term]))
    old, new = vectors.at(state), vectors.at(layout.new + state)
    lost = work[layout.lost + state * layout.width :]
    lost_by_trial = work[layout.lost + (step.states + state) * layout.width :]
    for i in each(layout.width, spill=True, disjoint=True):
        new[i], lost_by_trial[i] = compensated(old[i], added.entry(i) + lost[i])


@procedure(arguments=running, entries=entries_array)
def try_step(arguments: Running, t: float, h: float, entries: Out | None, *, layout: Layout) -> Outcome:
    """Compute a trial step of a run, and count its evaluations of the law. Return the outcome of `take_step`.

    In a two-step method the starting step is taken if the state one step before is not known. `entries` has the
    entries of the old and new state if they are kept in registers, else it is None.
    """
    step, counts, effort = layout.step, arguments.counts, arguments.effort
    if layout.keeps_history:
        effort.evaluations = 0
    if step.starter is None:
        known = counts.slope_known != 0
        counts.evaluations += len(step.calls) - int(known) if step.starts_with_slope else len(step.calls)
        outcome = take_step(arguments, t, h, known, entries, layout=layout)
    else:
        # The two-step method needs a previous step of the same length.
        equal = h == arguments.run.step
        arguments.work[layout.flags + 1] = float(equal)
        if equal and arguments.work[layout.flags] == 1.0:
            counts.evaluations += len(step.calls)
            outcome = take_step(arguments, t, h, slope_known=False, entries=entries, layout=layout)
        else:
            counts.evaluations += len(layout.starting.step.calls)
            outcome = take_starting_step(arguments, t, h, layout)
    if layout.keeps_history:
        counts.evaluations += effort.evaluations
        arguments.run.residual = effort.residual
    if step.starts_with_slope:
        counts.slope_known = 1
    return outcome


@inline
def take_starting_step(arguments: Running, t: float, h: float, layout: Layout) -> Outcome:
    """Take a step of the method that starts a two-step method. Return the outcome of `take_step`.

    The starting method has its own memory, after that of the main step. The new state is copied to the main step's
    vectors.
    """
    work, starting, width = arguments.work, layout.starting, layout.width
    memory = work[layout.end :]
    for i in unrolled(layout.step.states):
        copy_vector(work[layout.place(i) :], memory[starting.place(i) :], width)
    starter = replace(arguments, newtons=arguments.starters, starters=(), work=memory)
    outcome = take_step(starter, t, h, slope_known=False, entries=None, layout=starting)
    for i in unrolled(layout.step.states):
        copy_vector(memory[starting.place(starting.new + i) :], work[layout.place(layout.new + i) :], width)
    return outcome


@inline
def project_new_state(arguments: Running, t: float, entries: Out | None, layout: Layout) -> tuple[Outcome, bool]:
    """Project the new state of a trial step onto the constraints. Return an outcome, and True if it has moved.

    The outcome is UNPROJECTED if the constraints are still violated, else DONE. If the state has moved, its
    displacement is written to the error vectors of the step. `entries` has the entries of the old and new state
    if they are kept in registers, else it is None.
    """
    n, length, work = layout.dimension, layout.length, arguments.work
    state, lost = work[layout.argument :], reals(n, room=layout.block)
    for part, vector, low in state_parts(layout):
        copy_vector(work[vector:], state[part:], length)
        if low is None:
            for i in each(length):
                lost[part:][i] = 0.0
        else:
            copy_vector(work[low:], lost[part:], length)
    outcome, moved = project(
        arguments.projection, arguments.projection_numbers, t, state, lost, dimension=n, block=layout.block
    )
    if moved:
        for k in unrolled(len(layout.step.errors)):
            part, vector, low = state_parts(layout)[k % layout.step.states]
            after, before, error = state[part:], work[vector:], work[layout.place(layout.errors + k) :]
            for i in each(length, disjoint=True):
                error[i] = after[i] - before[i]
        for part, vector, low in state_parts(layout):
            work[vector : vector + length] = state[part : part + length]
            if low is not None:
                work[low : low + length] = lost[part : part + length]
        if entries is not None:
            for k in unrolled(n):
                entries[n + k] = state[k]
    return outcome, moved


def state_parts(layout: Layout) -> list[tuple[int, int, int | None]]:
    """Return for each vector of the new state: its index in [q, v], its offset, and its rounding error's offset.

    The last offset is None if the rounding error is not stored. Offsets are positions in the work array.
    """
    step = layout.step
    tried = [layout.lost + (step.states + i) * layout.width for i in range(step.states)]
    return [
        (i * layout.length, layout.place(layout.new + i), tried[i] if step.is_compensated(i) else None)
        for i in range(step.states)
    ]


@procedure(
    arguments=running, entries=entries_array, moved=lambda layout: FLAG if layout.projected else None, rows=rows_array
)
def accept_step(
    arguments: Running, entries: Out | None, moved: bool | None, t: float, times: Out, rows: Out, *, layout: Layout
) -> None:
    """Make the new state of the trial step, at time t, the state of the run. Add a row if rows are recorded.

    The row is a time in `times` and a state in `rows`. `entries` are the old and new state in registers, or None.
    `moved` is true if the projection has moved the new state: then the derivative at the end of the step is not
    valid. This flag is None without constraints.
    """
    step, width, work, counts = layout.step, layout.width, arguments.work, arguments.counts
    arguments.run.t = t
    if step.starter is not None:
        work[layout.flags] = work[layout.flags + 1]
    for i in unrolled(step.states):
        state, new = work[layout.place(i) :], work[layout.place(layout.new + i) :]
        if step.starter is not None:
            copy_vector(state, work[layout.place(step.states + i) :], width)
        copy_vector(new, state, width)
        if step.is_compensated(i):
            lost = layout.lost + i * width
            copy_vector(work[lost + step.states * width :], work[lost:], width)
    if entries is not None:
        for k in unrolled(layout.dimension):
            entries[k] = entries[layout.dimension + k]
    if step.ends_with_slope:
        copy_vector(work[layout.place(step.calls[-1].first) :], work[layout.place(step.calls[0].first) :], width)
    is_known = int(step.ends_with_slope)
    counts.slope_known = is_known if moved is None else 0 if moved else is_known
    for solve in layout.solves:
        keep_unknowns(arguments.newtons[solve.index], work, layout=layout, solve=solve)
    counts.steps += 1
    if counts.record != 0:
        row = counts.rows
        times[row] = t
        for i in unrolled(step.states):
            copy_vector(work[layout.place(i) :], rows[row * layout.dimension + i * layout.length :], width)
        counts.rows = row + 1
