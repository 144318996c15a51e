"""One trial step of a step program, and its acceptance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.compensated import compensated
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.newton.corrections import product, solve_unknowns
from lagrange.procedure.newton.prediction import keep
from lagrange.procedure.outcome import Outcome
from lagrange.procedure.projection import CORRECTIONS
from lagrange.procedure.step.memory import EFFORT, Layout
from lagrange.procedure.step.run import COUNTS, RUN
from lagrange.procedure.step.vectors import Given, Laws, Sum, Vectors, floors_of, newton_records
from lagrange.procedure.values import Flag, Memory, Real, Whole
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


class Running:
    """The arguments of a procedure that takes steps of a run: laws, state of the run, and records of its solves."""

    def __init__(self, p: Builder, layout: Layout) -> None:
        self.p, self.layout, self.laws = p, layout, Laws(p, layout)
        self.run: Any = p.record("run", RUN)
        self.counts: Any = p.record("counts", COUNTS)
        self.floors = floors_of(p, layout, read=False)
        self.effort: Any = p.record("effort", EFFORT)
        self.newtons = newton_records(p, layout)
        self.starters = newton_records(p, layout.starting, "starter_") if layout.step.starter is not None else []
        self.work = p.array("work", size=layout.size, room=layout.block)
        self.projection: tuple[Any, ...] = ()
        """The corrections that constraints want and their parameters, if there are constraints."""
        if layout.projected:
            self.projection = p.function("projection", CORRECTIONS), p.array("projection_numbers", read=True)

    @property
    def handed(self) -> tuple[Any, ...]:
        """The arguments for another procedure of the same run."""
        return (
            *self.laws.handed,
            self.run,
            self.counts,
            self.floors,
            self.effort,
            *self.newtons,
            *self.starters,
            self.work,
            *self.projection,
        )

    def take(self, t: Real, h: Real, slope_known: Flag, more: Sequence[Memory]) -> Whole:
        """Take a step from the state, and return the outcome."""
        numbers = t, h, self.run.rtol, self.floors
        given = (*self.laws.handed, *numbers, self.effort, *self.newtons, self.work)
        return self.p.whole(self.p.call(take_step(self.layout), *given, slope_known, *more))

    def start(self, t: Real, h: Real) -> Whole:
        """Take a step of the starter, in its own memory, and return the outcome."""
        p, layout, starting = self.p, self.layout, self.layout.starting
        memory = self.work.at(layout.end)

        for i in range(layout.step.states):
            p.copy(self.work.at(layout.place(i)), memory.at(starting.place(i)), layout.width)
        numbers = t, h, self.run.rtol, self.floors
        given = (*self.laws.handed, *numbers, self.effort, *self.starters, memory)
        outcome = p.call(take_step(starting, "starter_"), *given, p.false)
        for i in range(layout.step.states):
            p.copy(
                memory.at(starting.place(starting.new + i)), self.work.at(layout.place(layout.new + i)), layout.width
            )
        return p.whole(outcome)


def try_step(layout: Layout) -> Procedure:
    """Return the trial of a step of a run; the starter takes it if the state one step back is not known."""
    step = layout.step
    p = Builder("try_step", "Try a step of a run, count what it takes, and return an outcome.")
    given = Running(p, layout)
    t, h = p.given("t", REAL), p.given("h", REAL)
    entries = entries_of(p, layout)
    counts = given.counts
    effort = given.effort if layout.keeps_history else None
    if effort is not None:
        effort.evaluations = 0
    if step.starter is None:
        known = ~counts.slope_known.equals(0)
        calls = len(step.calls) - p.whole(known) if step.starts_with_slope else len(step.calls)
        counts.evaluations = counts.evaluations + calls
        outcome = given.take(t, h, known, [] if entries is None else [entries])
    else:
        outcome = _try_either(given, t, h)
    if effort is not None:
        counts.evaluations = counts.evaluations + effort.evaluations
        given.run.residual = effort.residual
    if step.starts_with_slope:
        counts.slope_known = 1
    p.leave(outcome)
    return p.finish(WHOLE)


def _try_either(given: Running, t: Real, h: Real) -> Whole:
    """Try a step from two states, or one of the starter; return the outcome."""
    p, layout, counts = given.p, given.layout, given.counts
    equal = h.equals(given.run.step)
    given.work[layout.flags + 1] = p.real(equal)
    outcome = p.variable(Outcome.DONE, "outcome")
    with p.when(equal & given.work[layout.flags].equals(1.0)) as ways:
        counts.evaluations = counts.evaluations + len(layout.step.calls)
        outcome.value = given.take(t, h, p.false, [])
    with ways.otherwise():
        counts.evaluations = counts.evaluations + len(layout.starting.step.calls)
        outcome.value = given.start(t, h)
    return p.whole(outcome.value)


def accept_step(layout: Layout) -> Procedure:
    """Return the procedure that makes the trial step the state.

    If the projection has moved the state, the slope at the end of the step is not that of the state.
    """
    step = layout.step
    p = Builder("accept_step", "Make the trial step the state at a time, and a row where rows are kept.")
    run: Any = p.record("run", RUN)
    counts: Any = p.record("counts", COUNTS)
    newtons = newton_records(p, layout)
    work = p.array("work", size=layout.size, room=layout.block)
    entries = entries_of(p, layout)
    moved: Flag | None = p.given("moved", FLAG) if layout.projected else None
    t, times, rows = p.given("t", REAL), p.array("times"), p.array("rows", room=layout.block)

    run.t = t
    if step.starter is not None:
        work[layout.flags] = work[layout.flags + 1]
    for i in range(step.states):
        state, new = work.at(layout.place(i)), work.at(layout.place(layout.new + i))
        if step.starter is not None:
            p.copy(state, work.at(layout.place(step.states + i)), layout.width)
        p.copy(new, state, layout.width)
        if step.compensated(i):
            lost = layout.lost + i * layout.width
            p.copy(work.at(lost + step.states * layout.width), work.at(lost), layout.width)
    if entries is not None:
        for k in range(layout.dimension):
            entries[k] = entries[layout.dimension + k]
    if step.ends_with_slope:
        first, last = (work.at(layout.place(step.calls[k].first)) for k in (0, -1))
        p.copy(last, first, layout.width)
    same = int(step.ends_with_slope)
    counts.slope_known = same if moved is None else p.choose(moved, 0, p.whole(same))
    for solve, newton in zip(layout.solves, newtons, strict=True):
        p.call(keep(layout, solve), newton, work)
    counts.steps = counts.steps + 1
    with p.when(~counts.record.equals(0)):
        row = counts.rows
        times[row] = t
        for i in range(step.states):
            p.copy(work.at(layout.place(i)), rows.at(row * layout.dimension + i * layout.length), layout.width)
        counts.rows = row + 1
    return p.finish()
