"""The review of one step of a member for events: the same samples and decisions as on the blocks of single runs.

Inputs are the step with its end, and the memory of each event. Results are the zeros that count, and the reason why the
review ended. See `lagrange.algorithm.events.step_review`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.dense.block import LANES, StepPolynomial
from lagrange.algorithm.dense.hermite import hermite_polynomial
from lagrange.algorithm.events.step_samples import Samples, work_size
from lagrange.algorithm.events.step_zeros import ENDED, IRREGULAR, ReviewArguments, StepZeros
from lagrange.algorithm.members.paths import DenseOutput, write_polynomial
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.rewrite import bound
from lagrange.procedure.values import Flag, Memory, Real, Whole

ONE = 1
"""Steps in a block: one, because the lanes hold members."""


@dataclass(frozen=True)
class StepEvents:
    """The event functions of members on steps: `count` of them, by a procedure of time, state, numbers and results.

    With `screened` steps are screened by cubics, as in single runs of methods with error control.
    """

    values: Procedure
    count: int
    screened: bool


def review_step(dense: DenseOutput, events: StepEvents, dimension: int) -> Procedure:
    """Return the procedure that reviews a step, and returns the reason for its end; see `review`."""
    p = Builder("review_step", "Find the zeros of events on a step, and say why that ended.")
    given = ReviewArguments(p)
    samples = _StepSamples(p, dense, events, dimension)
    samples.lay_out()
    zeros = StepZeros(p, samples, given)
    step = p.whole(0)
    first: Flag = (~given.record.starts.equals(0)).called("first")
    close = p.variable(first, "close")
    with p.loop(0, events.count) as e:
        close.value = close.value | given.sign[e].equals(0) | ~given.near[e].equals(0)
    with p.when(given.screens & ~close.value):
        samples.sift()
        close.value = samples.is_doubtful(step)
    # Branches alone skip members that have left a procedure.
    with p.when(~given.screens | close.value):
        samples.follow()
        zeros.leave(IRREGULAR, step, condition=samples.bad.value)
        zeros.begin_at_zero(step)
        watched = p.variable(p.false, "watched")
        with p.loop(0, events.count) as e:
            watched.value = watched.value | zeros.may_vanish(step, e)
        with p.when(watched.value):
            samples.sample_fully()
            zeros.visit(step, step)
    p.leave(ENDED)
    return p.finish(WHOLE)


class _StepSamples(Samples):
    """Samples of one step, with known laws and paths, in memory of the procedure itself."""

    columns = ONE

    def __init__(self, p: Builder, dense: DenseOutput, events: StepEvents, dimension: int) -> None:
        self.p = p
        kind, cubic, n = dense.kind, hermite_polynomial(3), dimension
        self.parameters = self.law_parameters = p.array("numbers", read=True)
        self.given = self.screen_given = p.array("table", read=True)
        self.factors = p.array("factors", read=True)
        self.own_memory = self.beside = p.array("own", read=True, room=LANES)
        self.end: Real = p.given("end", REAL)
        self.dimension, self.events = p.whole(n), p.whole(events.count)
        self.degree, self.both = p.whole(kind.degree), p.whole(0)
        law = dense.column
        self.polynomial, self.screen = self.writing(kind, law, "review_"), self.writing(cubic, law, "screen_")
        self.law, self.kernel = _calling(p, law), _calling(p, _of_columns(events, n))
        size = max(kind.size(n, ONE), cubic.size(n, ONE))
        self.path_work = p.reserve(size, room=LANES, name="path_work")
        self.c = p.reserve((max(kind.degree, cubic.degree) + 1) * n, room=LANES, name="c")
        self.work = p.reserve(work_size(n, events.count, ONE), room=LANES, name="work")

    def gather(self, both: Any) -> None:
        """Do nothing: the caller passes the step."""
        del both
        self.t_end[0] = self.end

    def writing(self, kind: StepPolynomial, law: Procedure, prefix: str) -> Callable[..., Any]:
        """Return the callback that writes the polynomial of a step, with the signature `POLYNOMIAL`."""
        procedure = bound(kind.procedure, {"law": law}, prefix=prefix)

        def write(table: Memory, columns: int, own: Memory, beside: Memory, work: Memory, c: Memory) -> None:
            del columns, own, beside
            write_polynomial(self.p, kind, procedure, (self.parameters, table), self.own, work, c)

        return write


def _calling(p: Builder, procedure: Procedure) -> Callable[..., Any]:
    """Return a Python function that calls a procedure, in the place of a function parameter."""
    return lambda *args: p.call(procedure, *args)


def _of_columns(events: StepEvents, dimension: int) -> Procedure:
    """Return the values of events as a law over columns; see `COLUMNS`."""
    p = Builder("events_of_columns", "Write the events of each column; return the first without an acceleration.")
    columns: Whole = p.given("columns", WHOLE)
    t, y = p.array("t", read=True), p.array("q", read=True)
    p.array("v", read=True)
    numbers, out = p.array("numbers", read=True), p.array("out")
    state, there = p.reserve(dimension, name="state"), p.reserve(events.count, name="there")
    failed = p.variable(-1, "failed")
    with p.loop(0, columns) as b:
        for j in range(dimension):
            state[j] = y[columns * j + b]
        singular = p.call(events.values, t[b], state, numbers, there)
        failed.value = p.choose(singular & (failed.value < 0), b, failed.value)
        for k in range(events.count):
            out[columns * k + b] = there[k]
    p.leave(failed.value)
    return p.finish(WHOLE)
