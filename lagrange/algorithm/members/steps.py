"""Ensemble members that run by an explicit method, with error control or with fixed steps, and their events.

Each accepted step is searched for events before the next. The samples and decisions are the same as on the blocks of
single runs, in `lagrange.algorithm.events.search`. If a case is left to the caller there, such as an event that is not
resolved, the member ends here, and is run again as a single run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.constants import WIDEST_VECTOR, Outcome
from lagrange.algorithm.dense.block import BlockSteps
from lagrange.algorithm.dense.polynomials import hermite_polynomial
from lagrange.algorithm.events.constants import NOISE_HALVES
from lagrange.algorithm.events.samples import Lines, Samples, work_size
from lagrange.algorithm.events.search import (
    CHANGED,
    ENDED,
    IGNORED,
    IRREGULAR,
    MOST_ZEROS,
    Review,
    ReviewedEvents,
    step_zeros,
)
from lagrange.algorithm.members.queue import (
    ENDED_BY_EVENT,
    FirstOccurrences,
    Member,
    MemberJob,
    MemberMethod,
    Observed,
    OccurrenceArrays,
    SystemNumbers,
    copy_state,
    move_to,
)
from lagrange.algorithm.members.reductions import (
    MemberDenseOutput,
    MemberStepPath,
    PathMemory,
    RunReductions,
    Sampled,
    SampledStep,
    polynomial_path,
    states_on_step,
)
from lagrange.algorithm.step.error_control import steps_of
from lagrange.algorithm.step.memory import Effort, Layout, Running
from lagrange.algorithm.taylor.memory import OutputCounts
from lagrange.algorithm.taylor.sums import outstanding
from lagrange.procedure.form import Array, Procedure
from lagrange.procedure.front.decorators import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    WholesIn,
    WholesOut,
    clear,
    each,
    generated,
    reals,
    unlikely,
    unrolled,
    wholes,
)
from lagrange.procedure.rewrite import bound
from lagrange.program.step import StepProgram


@dataclass(frozen=True)
class StepEvents:
    """The event functions of members: `count` of them, which the procedure `values` evaluates.

    With `screened`, cubics exclude events on most steps, as in single runs of methods with error control.
    """

    values: Procedure
    count: int
    screened: bool


@dataclass(frozen=True, eq=False)
class MemberFunctions:
    """The dense output, the right-hand side and the events of members, for states of a `dimension`."""

    dense: MemberDenseOutput
    events: StepEvents
    dimension: int

    @inline
    def law(self, columns: int, t: In, q: In, v: In, numbers: In, out: Out) -> int:
        """Write the right-hand side at one state to `out`. Return 0 if its mass matrix is singular, else -1.

        The arguments are those of a function of several columns, for one column. t has the time, q the whole state [q,
        v], and `numbers` are the parameters and all values that depend only on them; v is not used.
        """
        failed: int = generated(self.dense.column, columns, t, q, v, numbers, out)
        return failed

    @inline
    def kernel(self, columns: int, t: In, q: In, v: In, numbers: In, out: Out) -> int:
        """Write the event functions of each column to `out`. Return the first column without a value, or -1.

        t has the times. q has the whole states [q, v] by columns: entry j of column b at j * columns + b.
        `numbers` are the parameters and all values that depend only on them; v is not used.
        """
        return events_of_columns(columns, t, q, numbers, out, functions=self)


@procedure
def events_of_columns(columns: int, t: In, y: In, numbers: In, out: Out, *, functions: MemberFunctions) -> int:
    """Write the event functions of each column to `out`. Return the first column without a value, or -1.

    t has the times. Entry j of the state of column b is at index j * columns + b of y, and event k at k * columns + b
    of `out`.
    """
    events, n, failed = functions.events, functions.dimension, -1
    state, values = reals(n), reals(events.count)
    for b in range(columns):
        for j in unrolled(n):
            state[j] = y[columns * j + b]
        is_singular = generated(events.values, t[b], state, numbers, values)
        failed = b if is_singular and failed < 0 else failed
        for k in unrolled(events.count):
            out[columns * k + b] = values[k]
    return failed


@dataclass(frozen=True)
class StepSamples(Samples):
    """Samples of event functions on one step of a member. The memory of the block already has the step."""

    end: float
    """Time at the end of the step."""

    columns = 1

    @inline
    def gather(self, lines: Lines, step_numbers: WholesIn, with_neighbours: int) -> None:
        """Store the end time of the step in `lines`: the block has all other data. Other arguments are not used."""
        lines.t_end[0] = self.end


@procedure(watch=lambda: Bundle(ReviewedEvents, {}), step=lambda: Array(room=WIDEST_VECTOR))
def review_step(
    watch: ReviewedEvents, numbers: In, table: In, factors: In, step: Out, end: float, *, functions: MemberFunctions
) -> int:
    """Find the zeros of event functions on a step up to time `end`. Return the code of the end of the search.

    The code is ENDED after the whole step, CHANGED if an event ends the run, or IRREGULAR if the zeros cannot be
    resolved. The zeros are written to `watch`. `step` has the data of the step as in `BlockSteps`. `numbers` are the
    parameters and all values that depend only on them, and `table` has the coefficients of the dense output.
    `factors` are near 1 and perturb the entries of a state, to estimate rounding errors.
    """
    n, events, dense = functions.dimension, functions.events.count, functions.dense
    degree, path = dense.kind.degree, MemberStepPath.of(dense.kind, dense.column, n, "review_")
    # Cubics through the ends of steps exclude events on most steps.
    cubic = MemberStepPath.of(hermite_polynomial(3), dense.column, n, "screen_")
    tables: Any = (numbers, table)
    work = reals(max(path.size, cubic.size), room=WIDEST_VECTOR)
    c, memory = reals((max(degree, 3) + 1) * n, room=WIDEST_VECTOR), reals(work_size(n, events, 1), room=WIDEST_VECTOR)
    samples = StepSamples(
        polynomial=path.write,
        given=tables,
        degree=degree,
        both=0,
        screens=functions.events.screened,
        screen=cubic.write,
        screen_given=tables,
        law=functions.law,
        law_parameters=numbers,
        step_data=step,
        neighbours=step,
        path_work=work,
        c=c,
        kernel=functions.kernel,
        parameters=numbers,
        dimension=n,
        events=events,
        factors=factors,
        work=memory,
        times=None,
        states=None,
        steps=0,
        end=end,
    )
    lines, step_numbers, is_close = samples.lines(), wholes(1), watch.review.starts != 0
    zeros = step_zeros(samples, lines, watch)
    for e in range(events):
        sign, near = watch.sign[e], watch.near[e]
        is_close = is_close or sign == 0 or near != 0
    if samples.screens and not is_close:
        is_bad = samples.sift(lines, step_numbers)
        is_close = samples.some_doubtful(lines, 0) or is_bad
    if not samples.screens or is_close:
        if unlikely(samples.follow(lines, step_numbers) or zeros.begin_at_zero(0)):
            return IRREGULAR
        if zeros.some_may_vanish(0):
            return zeros.visit(0, 0, samples.sample_fully(lines))
    return ENDED


ZERO_ROOM = MOST_ZEROS + 1
"""Number of zeros that the memory of one member can hold. Zeros are copied to the results after each step."""


@dataclass(frozen=True)
class ReviewArguments(OccurrenceArrays):
    """Arguments of the search for events on steps, and the arrays for the results.

    `factors` are near 1 and perturb the entries of a state, to estimate rounding errors. `direction` is for
    each event the direction of zeros that count, 0 for all. `terminal` is the number of zeros after which the
    event ends the run.
    """

    factors: In
    direction: WholesIn
    terminal: WholesIn


@dataclass(frozen=True)
class ReviewMemory:
    """Memory of the search for events on the steps of a member, which writes zeros to `watch`.

    `seen` is the number of occurrences of each event so far.
    """

    watch: ReviewedEvents
    there: Out
    """The state to which the run is moved, if an event ends it."""

    seen: WholesOut


class StepEventSearch:
    """The search for the events of members on steps of an explicit method."""

    def __init__(self, events: StepEvents, dense: MemberDenseOutput, dimension: int) -> None:
        self.events, self.dimension = events, dimension
        self.functions = MemberFunctions(dense, events, dimension)
        self.occurrences = FirstOccurrences(events.count, dimension)

    @inline
    def memory(self, watched: ReviewArguments) -> ReviewMemory:
        """Return memory for the search for events on the steps of one member."""
        count, n = self.events.count, self.dimension
        watch = ReviewedEvents(
            review=Review(),
            sign=wholes(count),
            near=wholes(count),
            direction=watched.direction,
            remaining=wholes(count),
            zero_sizes=reals(count),
            arrivals=wholes(count),
            which=wholes(ZERO_ROOM + 1),
            when=reals(ZERO_ROOM + 1),
            there=reals((ZERO_ROOM + 1) * n),
            step_sides=wholes(4 * count),
            levels=reals(count),
        )
        return ReviewMemory(watch, reals(n), self.occurrences.memory())

    @inline
    def begin(self, memory: ReviewMemory, watched: ReviewArguments) -> None:
        """Reset the search at the start of a member's run: no events, and unknown signs of event functions."""
        self.occurrences.begin(memory.seen)
        watch = memory.watch
        clear(watch.review)
        watch.review.end, watch.review.room = 1, ZERO_ROOM
        for e in unrolled(self.events.count):
            watch.sign[e], watch.near[e] = 0, 0
            watch.remaining[e], watch.arrivals[e] = watched.terminal[e], IGNORED
            watch.zero_sizes[e] = 0.0

    @inline
    def search(
        self, memory: ReviewMemory, job: Any, member: Any, index: int, step: BlockSteps, end: float
    ) -> tuple[int, float, float]:
        """Search a step for events up to time `end`. Return an outcome, and the time and fraction of the step's end.

        The outcome is PAUSED if the run continues, ENDED_BY_EVENT if an event ends it, and WATCHED if the zeros on the
        step cannot be resolved. If an event ends the run, the time and the fraction are those of the event, whose state
        is in `memory.there`. `index` is the number of the member.
        """
        watch, steps, watched = memory.watch, member.counts.steps, job.watched
        review = watch.review
        review.written, review.starts = 0, int(steps == 1)
        review.last = 0 if end == job.t1 else -1
        review.rounded = float(steps - 1) * (1.0 / NOISE_HALVES)
        why = review_step(watch, member.numbers, job.table, watched.factors, step.memory, end, functions=self.functions)
        is_changed = why == CHANGED
        is_regular = why == ENDED or is_changed
        if unlikely(review.written > 0 and is_regular):
            for slot in range(review.written):
                zero = watch.there[slot * self.dimension :]
                self.occurrences.keep(watched, memory.seen, index, watch.which[slot], watch.when[slot], zero)
        t, part = end, 1.0
        if unlikely(is_changed):
            t, part = self.place_of_end(memory, step, end)
            self.occurrences.keep(watched, memory.seen, index, review.event, t, memory.there)
        return ENDED_BY_EVENT if is_changed else Outcome.PAUSED if is_regular else Outcome.WATCHED, t, part

    @inline
    def place_of_end(self, memory: ReviewMemory, step: BlockSteps, end: float) -> tuple[float, float]:
        """Write the state at the event that ends the run to `memory.there`.

        Return the time of the event and its fraction of the step. If the event is at an end of the step, the state is
        the accepted one, which is not interpolated. `end` is the time at the end of the step.
        """
        watch, part, slot = memory.watch, memory.watch.review.fraction, memory.watch.review.written
        is_begin, is_end, zero = part <= 0.0, part >= 1.0, watch.there[slot * self.dimension :]
        when, t = watch.when[slot], step.t[0]
        for i in each(self.dimension, width=1):
            before, after, between = step.y[i], step.new[i], zero[i]
            memory.there[i] = before if is_begin else after if is_end else between
        return t if is_begin else end if is_end else when, part


@dataclass(frozen=True)
class StepMemory:
    """Memory of a run by steps: the vectors of a step, and memory to evaluate expressions and events on it."""

    work: Out
    effort: Effort
    unused: Out
    path: Any
    """Memory for the dense output of one step, a `PathMemory`, or None."""

    outputs: Any
    """Record `OutputCounts` that counts the output times with states; None without dense output."""

    search: Any
    """Memory of the search for events on one step; None without events."""


class StepMembers(MemberMethod):
    """Runs members by the steps of an explicit method, the same as in single runs.

    The procedure `law`, which the steps evaluate, is built in. With `dense`, the dense output of single runs, it
    writes the states at output times and reduces `sampled` expressions. The search for `events` also uses the dense
    output.
    """

    def __init__(
        self,
        step: StepProgram,
        dimension: int,
        law: Procedure,
        numbers: SystemNumbers,
        observed: Observed,
        dense: MemberDenseOutput | None = None,
        sampled: Sampled | None = None,
        events: StepEvents | None = None,
    ) -> None:
        reductions = None
        if sampled is not None:
            some = polynomial_path.form(entries=sampled.entries, dimension=dimension)
            reductions = RunReductions(sampled, bound(some, {}, prefix="expressions_"), dimension)
        super().__init__(dimension, numbers, observed, reductions)
        self.program, self.functions = step, {"law": law}
        self.layout = Layout(step, dimension, block=1)
        self.steps = steps_of(self.layout)
        self.takes_all = dense is None and step.control is None
        """True if one call takes all steps."""
        self.path = None if dense is None else MemberStepPath.of(dense.kind, dense.column, dimension, "path_")
        path_form = polynomial_path.form(entries=tuple(range(dimension)), dimension=dimension)
        self.outputs = bound(states_on_step.form(), {"path": path_form}, prefix="path_")
        self.search = None if dense is None or events is None else StepEventSearch(events, dense, dimension)
        self.watched_type = None if self.search is None else ReviewArguments

    @inline
    def memory(self, job: MemberJob, numbers: In) -> tuple[tuple[Out, ...], StepMemory]:
        """Return memory for the state, and an object with the other memory of a run.

        The state is one vector [q, v], or two vectors of coordinates and of velocities.
        """
        work = reals(self.layout.size)
        parts = tuple([work[self.layout.place(k) :] for k in range(self.program.states)])
        path = None if self.path is None else self.path.memory()
        outputs = None if self.path is None else OutputCounts()
        search = None if self.search is None else self.search.memory(job.watched)
        return parts, StepMemory(work, Effort(), reals(1), path, outputs, search)

    @inline
    def begin(self, job: MemberJob, member: Member) -> None:
        """Reset the search for events and the outputs at the start of a member's run.

        If the step moves only coordinates, the velocities, which the law reads and no step writes, are set to zero.
        """
        method_memory = member.method_memory
        if self.program.law == "accelerations":
            velocities = method_memory.work[self.layout.argument + self.layout.length :]
            for i in each(self.layout.length, width=1):
                velocities[i] = 0.0
        if self.path is not None:
            method_memory.outputs.done = 0
        if self.search is not None:
            self.search.begin(method_memory.search, job.watched)

    @inline
    def attempts(self, job: MemberJob, member: Member) -> int:
        """Return the number of trial steps of the member; the whole budget if one call takes all steps."""
        return job.budget if self.takes_all else member.counts.steps + member.counts.rejected

    @inline
    def advance(self, job: MemberJob, member: Member, index: int, last: bool) -> int:
        """Take a trial step; or take all steps of a run with fixed steps, if no dense output is needed.

        Return an outcome: PAUSED if the run continues, else why it ends. `index` is the number of the member,
        and `last` is true if the budget allows no more steps.
        """
        run, counts, method_memory = member.run, member.counts, member.method_memory
        trials = 0 if last else job.budget if self.takes_all else 1
        before = counts.steps
        if self.path is not None:
            method_memory.path.step.t[0] = run.t
            copy_state(member, method_memory.path.step.y, self.dimension)
        numbers = member.numbers
        arguments = Running(
            law=job.law,
            parameters=numbers,
            jacobian=job.law,
            constants=numbers,
            run=run,
            counts=counts,
            floors=member.floors,
            effort=method_memory.effort,
            newtons=(),
            starters=(),
            work=method_memory.work,
            projection=None,
            projection_numbers=None,
        )
        outcome: int = generated(self.steps, arguments, trials, method_memory.unused, method_memory.unused)
        if self.path is not None and counts.steps > before:
            ended = self.follow(self.path, job, member, index)
            outcome = outcome if ended == Outcome.PAUSED else ended
        return outcome

    @inline
    def follow(self, path: MemberStepPath, job: MemberJob, member: Member, index: int) -> int:
        """Search an accepted step for events, and write output states and reductions of expressions on it.

        `path` is the dense output, and `index` the number of the `member`. `job` has the settings of all members,
        such as the output times. Return the outcome PAUSED if the next step may follow, ENDED_BY_EVENT if an event ends
        the run, and WATCHED if the zeros cannot be resolved, so that the member must be run alone.
        """
        run, method_memory = member.run, member.method_memory
        memory: PathMemory = method_memory.path
        step, end = memory.step, run.t
        t = step.t[0]
        direction = -1.0 if job.t1 < job.t0 else 1.0
        is_due = outstanding(job.output_times, method_memory.outputs.done, end, direction)
        step.h[0], step.side[0] = end - t, 0.0
        copy_state(member, step.new, self.dimension)
        outcome, part, last = int(Outcome.PAUSED), 1.0, end
        if self.search is not None:
            outcome, last, part = self.search.search(method_memory.search, job, member, index, step, end)
            if unlikely(outcome == ENDED_BY_EVENT):
                run.t = last
                member.counts.steps -= int(part <= 0.0)
                move_to(member, method_memory.search.there, self.dimension)
        if self.reductions is not None:
            path.find(memory, job.table, member.numbers)
            if self.search is not None:
                copy_state(member, step.new, self.dimension)
            sampled = SampledStep(t, last, last - t, part, memory.c, step.new, path.kind.degree)
            self.reductions.follow(member.reduced, sampled, member.numbers, job.points)
            self.reductions.accept(member.reduced)
        if unlikely(is_due):
            if self.reductions is None:
                path.find(memory, job.table, member.numbers)
            states, degree = job.outputs[index * (job.output_count * self.dimension) :], path.kind.degree
            arrays = job.output_times, memory.c, states, self.dimension, degree, method_memory.outputs.done
            method_memory.outputs.done = generated(self.outputs, t, end, direction, *arrays)
        return outcome
