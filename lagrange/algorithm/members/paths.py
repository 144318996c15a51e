"""The path of a member on a step, by the dense output of single runs: its polynomials, and states on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.dense.block import OwnStep, StepPolynomial, block_size, steps_in
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.algorithm.taylor.sums import outstanding, powers_of, series_sum
from lagrange.procedure.form import READ, REAL, WHOLE, Array, Callee, Procedure
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, fma, generated, reals
from lagrange.procedure.rewrite import bound

PATH = Callee((REAL, REAL, READ, Array(), WHOLE), ())
"""A callback that writes the state at a fraction of a step, or some entries of it. Arguments: the fraction, the length
of the step in the unit of the polynomial, the coefficients, the state, and the degree."""


@procedure
def polynomial_path(
    fraction: float, ratio: float, c: In, out: Out, degree: int, *, entries: tuple[int, ...], dimension: int
) -> None:
    """Write the `entries` of the state at a fraction of a step to `out`, by polynomials in time.

    `ratio` is the length of the step in the unit of the polynomials. The coefficient of power k and entry j is
    at index k * dimension + j of c. The type of the procedure is `PATH`.
    """
    theta = fraction * ratio
    totals = tuple(c[degree * dimension + j] for j in entries)
    for k in range(degree):
        line = c[(degree - 1 - k) * dimension :]
        totals = tuple(fma(total, theta, line[j]) for total, j in zip(totals, entries, strict=True))
    for total, j in zip(totals, entries, strict=True):
        out[j] = total


@procedure
def series_path(
    fraction: float, ratio: float, work: In, out: Out, order: int, *, layout: TaylorLayout, entries: tuple[int, ...]
) -> None:
    """Write the `entries` of the state at a fraction of a step to `out`, by the Taylor series of the last step.

    `ratio` is the length of the step in units of the scale of time. The work array has the state before the
    step and the rows of the series, in a `layout`. The type of the procedure is `PATH`.
    """
    before, lost = work[layout.held :], work[layout.held + layout.padded :]
    powers = powers_of(fraction * ratio)
    for j in entries:
        out[j] = before[j] + (series_sum(work, order, powers, j, layout) + lost[j])


@procedure(path=lambda: PATH)
def states_on_step(
    path: Callable[..., None],
    t: float,
    end: float,
    sign: float,
    times: In,
    memory: In,
    states: Out,
    dimension: int,
    degree: int,
    done: int,
) -> int:
    """Write the states at the output times on a step from t to `end`; return the number of times that are done.

    `times` are all output times, of which `done` were done before, and row i of `states` is the state at time
    i. `path` writes the state at a fraction of the step, from `memory` and `degree`; `sign` is the direction of
    the run. A time at the end belongs to the next step.
    """
    h, index = end - t, done
    while outstanding(times, index, end, sign):
        path((times[index] - t) / h, 1.0, memory, states[index * dimension :], degree)
        index += 1
    return index


@dataclass(frozen=True)
class MemberDenseOutput:
    """Dense output of members' steps: its kind, and the right-hand side as a procedure."""

    kind: StepPolynomial
    law: Procedure

    @cached_property
    def column(self) -> Procedure:
        """The right-hand side as a procedure of type `COLUMNS`, for one column."""
        return law_of_column.form(law=self.law)


@dataclass(frozen=True)
class PathMemory:
    """Memory of the polynomial of a step: the step, work memory, and the coefficients `c`."""

    step: OwnStep
    work: Out
    c: Out


@dataclass(frozen=True, eq=False)
class MemberStepPath:
    """Dense output on one step of a member: its kind, and its procedure with the right-hand side built in."""

    kind: StepPolynomial
    procedure: Procedure
    dimension: int

    @classmethod
    def of(cls, kind: StepPolynomial, law: Procedure, dimension: int, prefix: str) -> MemberStepPath:
        """Return the dense output for a `law` of type `COLUMNS`; `prefix` is part of its procedures' names."""
        return cls(kind, bound(kind.procedure, {"law": law}, prefix=prefix), dimension)

    @property
    def size(self) -> int:
        """Number of doubles of work memory for the polynomial of a step."""
        return self.kind.size(self.dimension, 1)

    @inline
    def write(self, tables: tuple[In, In], columns: int, own: In, beside: In, work: Out, out: Out) -> None:
        """Write the coefficients of the polynomials of a block of steps to `out`, by powers.

        `tables` are two arrays: the prepared numbers of the law, and the coefficients of the method. `own` are
        the steps and `beside` their neighbours, each with data as in `OwnStep`, in a number of `columns`.
        """
        numbers, table = tables
        names = "parameters", "table", "stages", "degree", "dimension", "columns", "own", "beside", "work", "out"
        layout = self.kind.stages, self.kind.degree, self.dimension, columns
        arguments = dict(zip(names, (numbers, table, *layout, own, beside, work, out), strict=True))
        generated(self.procedure, *[arguments[parameter.name] for parameter in self.procedure.parameters])

    @inline
    def memory(self) -> PathMemory:
        """Return memory for the polynomial of a step."""
        step_memory = reals(block_size(self.dimension, 1), room=WIDEST_VECTOR)
        work = reals(self.size, room=WIDEST_VECTOR)
        c = reals((self.kind.degree + 1) * self.dimension, room=WIDEST_VECTOR)
        return PathMemory(steps_in(step_memory, self.dimension, 1), work, c)

    @inline
    def find(self, memory: PathMemory, table: In, numbers: In) -> None:
        """Write the coefficients of the polynomial of the step `memory.step` to `memory.c`.

        `table` has the coefficients of the method, and `numbers` are the prepared numbers of the law.
        """
        step_memory = memory.step.memory
        self.write((numbers, table), 1, step_memory, step_memory, memory.work, memory.c)


@procedure
def law_of_column(_columns: int, t: In, q: In, _v: In, numbers: In, out: Out, *, law: Procedure) -> int:
    """Write the right-hand side `law` of one column to `out`. Return 0 if a matrix is singular, else -1.

    t has the time, q the whole state, and `numbers` are the prepared numbers. The type of the procedure is
    `COLUMNS`, with one column.
    """
    return int(generated(law, t[0], q, numbers, out)) - 1
