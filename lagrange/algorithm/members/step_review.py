"""The review of one step of a member for events: the same samples and decisions as on the blocks of single runs.

The review of single runs is in `lagrange.algorithm.events.step_review`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.dense.hermite import hermite_polynomial
from lagrange.algorithm.events.step_samples import Lines, Samples, work_size
from lagrange.algorithm.events.step_zeros import ENDED, IRREGULAR, ReviewedEvents, step_zeros
from lagrange.algorithm.members.paths import MemberDenseOutput, MemberStepPath
from lagrange.procedure.form import Array, Procedure
from lagrange.procedure.front.plain import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, WholesIn, generated, reals, unlikely, unrolled, wholes


@dataclass(frozen=True)
class StepEvents:
    """The event functions of members: `count` of them, which the procedure `values` evaluates.

    If `screened`, cubics exclude events on most steps, as in single runs of methods with error control.
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

    def path(self, prefix: str) -> MemberStepPath:
        """Return the dense output of steps; `prefix` is added to the names of its procedures."""
        return MemberStepPath.of(self.dense.kind, self.dense.column, self.dimension, prefix)

    def cubic(self) -> MemberStepPath:
        """Return the dense output by cubics through the ends of steps, which screen events."""
        return MemberStepPath.of(hermite_polynomial(3), self.dense.column, self.dimension, "screen_")

    @inline
    def law(self, columns: int, t: In, q: In, v: In, numbers: In, out: Out) -> int:
        """Write the right-hand side of a column. The arguments and the result are those of the type `COLUMNS`."""
        failed: int = generated(self.dense.column, columns, t, q, v, numbers, out)
        return failed

    @inline
    def kernel(self, columns: int, t: In, q: In, v: In, numbers: In, out: Out) -> int:
        """Write the event functions of each column. The arguments and the result are those of the type `COLUMNS`."""
        return events_of_columns(columns, t, q, numbers, out, functions=self)


@procedure
def events_of_columns(columns: int, t: In, y: In, numbers: In, out: Out, *, functions: MemberFunctions) -> int:
    """Write the event functions of each column; return the first column without an acceleration, or -1."""
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
    """Samples of one step of a member. The memory of the block already has the step; each lane has one member."""

    end: float
    """Time at the end of the step."""

    columns = 1

    @inline
    def gather(self, lines: Lines, places: WholesIn, both: int) -> None:
        """Store the end time of the step; its other data are in the block already. Others are unused."""
        lines.t_end[0] = self.end


@procedure(watch=lambda: Bundle(ReviewedEvents, {}), own=lambda: Array(room=WIDEST_VECTOR))
def review_step(
    watch: ReviewedEvents, numbers: In, table: In, factors: In, own: Out, end: float, *, functions: MemberFunctions
) -> int:
    """Find the zeros of events on a step up to the time `end`, and return the reason for the end of the search.

    `own` is the step, `table` has the coefficients of the method, and `factors` perturb a state.
    """
    n, events, degree = functions.dimension, functions.events.count, functions.dense.kind.degree
    path, cubic, given = functions.path("review_"), functions.cubic(), (numbers, table)
    work = reals(max(path.size, cubic.size), room=WIDEST_VECTOR)
    c, memory = reals((max(degree, 3) + 1) * n, room=WIDEST_VECTOR), reals(work_size(n, events, 1), room=WIDEST_VECTOR)
    paths = path.write, given, degree, 0, functions.events.screened, cubic.write, given, functions.law, numbers
    watched = functions.kernel, numbers, n, events, factors, memory
    arguments: Any = *paths, own, own, work, c, *watched, None, None, 0, end
    samples = StepSamples(*arguments)
    lines, places, is_close = samples.lines(), wholes(1), watch.review.starts != 0
    zeros = step_zeros(samples, lines, watch)
    for e in range(events):
        sign, near = watch.sign[e], watch.near[e]
        is_close = is_close or sign == 0 or near != 0
    if samples.screens and not is_close:
        is_bad = samples.sift(lines, places)
        is_close = samples.some_doubtful(lines, 0) or is_bad
    if not samples.screens or is_close:
        if unlikely(samples.follow(lines, places) or zeros.begin_at_zero(0)):
            return IRREGULAR
        if zeros.some_may_vanish(0):
            return zeros.visit(0, 0, samples.sample_fully(lines))
    return ENDED
