"""Evaluation of dense output at many times. The polynomial of a step is computed once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.dense.block import POLYNOMIAL, steps_in
from lagrange.procedure.form import Array
from lagrange.procedure.front.decorators import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, WholesIn, each, fma, quotient, reals, unrolled, wholes

CHUNK = 256
"""Largest number of times on one step that are evaluated together."""

READ_BLOCKS, BLOCKS = Array(read=True, room=WIDEST_VECTOR), Array(room=WIDEST_VECTOR)


@procedure(theta=lambda: READ_BLOCKS, out=lambda: BLOCKS)
def horner(
    degree: int, dimension: int, row: int, column: int, c: In, theta: In, count: int, out: Out, stride: int
) -> None:
    """Write the values of a polynomial with vector values at `count` fractions `theta` of a step to `out`.

    c has its coefficients: that of power k and entry j at index k * row + j * column. Entry j at fraction i is
    written to index j * stride + i of `out`. Two entries are computed at a time, so `dimension` is even.
    """
    for j in range(0, dimension, 2):
        sources = tuple(c[(j + i) * column :] for i in unrolled(2))
        first, second = out[j * stride :], out[(j + 1) * stride :]
        for i in each(count, width=WIDEST_VECTOR, disjoint=True):
            values = tuple(source[degree * row] for source in sources)
            for k in range(degree):
                index = (degree - 1 - k) * row
                pairs = zip(values, sources, strict=True)
                values = tuple(fma(value, theta[i], source[index]) for value, source in pairs)
            first[i], second[i] = values


@procedure
def gather(
    dimension: int,
    columns: int,
    starts: WholesIn,
    steps: int,
    times: In,
    states: In,
    with_neighbours: int,
    own: Out,
    beside: Out,
) -> None:
    """Copy the times and states of `columns` steps of a run to `own`, by columns in the layout of `OwnStep`.

    `starts` has the indices of these steps. `times` and `states` are those of the whole run, which has `steps`
    steps. If `with_neighbours` is 1, a neighbour of each step is copied to `beside`: the previous step, or the
    next one for the first step.
    """
    for b in range(columns):
        s = starts[b]
        gather_one(dimension, columns, b, s, times, states, own)
        if with_neighbours == 1:
            is_first = s == 0
            gather_one(dimension, columns, b, min(s + 1, steps - 1) if is_first else s - 1, times, states, beside)
            side = 0.0 if steps == 1 else 1.0 if is_first else -1.0
            steps_in(beside, dimension, columns).side[b] = side


@procedure
def gather_one(dimension: int, columns: int, b: int, s: int, times: In, states: In, block: Out) -> None:
    """Copy start time, length and both states of step number s of a run to column b of `block`.

    `block` is memory in the layout of `OwnStep`. `times` and `states` are those of the run.
    """
    step = steps_in(block, dimension, columns)
    step.t[b] = times[s]
    step.h[b] = times[s + 1] - times[s]
    step.side[b] = 0.0
    y, new = states[s * dimension :], states[(s + 1) * dimension :]
    for j in range(dimension):
        index = j * columns + b
        step.y[index], step.new[index] = y[j], new[j]


@dataclass(frozen=True)
class RunPath:
    """A run whose states between the ends of its steps are computed by dense output.

    The callback `polynomial` writes the polynomials of a block of `columns` steps. Its first argument `given`
    has the data of the method. If `both` is 1 it needs the neighbours of the steps. `times` and `states` are
    those at the ends of the `steps` steps of the run. `own` and `beside` are memory for a block of steps and
    for their neighbours, and `work` is work memory.
    """

    polynomial: Callable[..., None]
    given: In
    dimension: int
    degree: int
    columns: int
    both: int
    steps: int
    times: In
    states: In
    own: Out
    beside: Out
    work: Out

    @inline
    def write(self, starts: WholesIn, out: Out) -> None:
        """Write the coefficients of the polynomials of `columns` steps to `out`; `starts` are their indices."""
        steps = self.steps, self.times, self.states
        gather(self.dimension, self.columns, starts, *steps, self.both, self.own, self.beside)
        self.polynomial(self.given, self.columns, self.own, self.beside, self.work, out)


def path_type() -> Bundle:
    """Return the type of a `RunPath` parameter of a procedure."""
    return Bundle(RunPath, {"polynomial": POLYNOMIAL})


@procedure(path=path_type)
def polynomials(path: RunPath, starts: WholesIn, blocks: int, out: Out) -> None:
    """Write the coefficients of the polynomials of `blocks` blocks of steps to `out`, block by block.

    `starts` are the indices of the steps in the run, `columns` of them for each block.
    """
    for k in range(blocks):
        path.write(starts[k * path.columns :], out[(path.degree + 1) * path.dimension * path.columns * k :])


@procedure
def locate(times: In, steps: int, step: int, time: float, sign: float) -> int:
    """Return the index of the last step that begins at or before a `time`, but at least `step`.

    `times` has the starts of the `steps` steps. They increase if `sign` is 1.0, and decrease if it is -1.0. The
    search interval begins at `step`, is doubled until it contains the time, and is then bisected.
    """
    low, reach = step, 1
    while has_begun(times, steps, low + reach, time, sign):
        low = low + reach
        reach = reach * 2
    while reach > 1:
        reach = quotient(reach, 2)
        low = low + reach if has_begun(times, steps, low + reach, time, sign) else low
    return low


@inline
def has_begun(times: In, steps: int, step: int, time: float, sign: float) -> bool:
    """Return True if step number `step` exists and begins at or before a `time`, in the direction of the run.

    `times` has the starts of the `steps` steps, and `sign` is the direction, 1.0 or -1.0.
    """
    begin = times[min(step, steps - 1)]
    return (begin - time) * sign <= 0.0 and step < steps


@inline
def lies_before(output_times: In, count: int, index: int, end: float, sign: float) -> bool:
    """Return True if output time number `index` exists and is before the time `end`, along the run.

    There are `count` output times, and `sign` is the direction of the run, 1.0 or -1.0.
    """
    time = output_times[min(index, count - 1)]
    return (time - end) * sign < 0.0 and index < count


@procedure(path=path_type, out=lambda: BLOCKS)
def outputs(path: RunPath, output_times: In, count: int, sign: float, out: Out, stride: int, c: Out) -> None:
    """Write the states at `count` sorted times `output_times` along a run to `out`.

    Entry j at time i has the index j * stride + i. The polynomial of a step is computed once, in the memory c.
    At the time of a step the accepted state is copied; of two states at one time, the later one. `sign` is the
    direction of the run, 1.0 or -1.0.
    """
    times, columns, dimension = path.times, path.columns, path.dimension
    starts, begins = wholes(WIDEST_VECTOR), wholes(WIDEST_VECTOR + 1)
    index, step = 0, 0
    while index < count:
        used = 0
        while used < columns and index < count:
            step = locate(times, path.steps, step, output_times[index], sign)
            starts[used], begins[used] = step, index
            used += 1
            end = times[step + 1]
            index += 1
            while lies_before(output_times, count, index, end, sign):
                index += 1
        begins[used] = index
        for b in range(used, columns):
            starts[b] = starts[used - 1]
        path.write(starts, c)
        for b in range(used):
            first, s = begins[b], starts[b]
            step_ends, target = (times[s:], path.states[s * dimension :]), (output_times[first:], begins[b + 1] - first)
            on_step(path.degree, dimension, columns, c[b:], *step_ends, *target, out[first:], stride)


@procedure(c=lambda: READ_BLOCKS, times=lambda: READ_BLOCKS, states=lambda: READ_BLOCKS, out=lambda: BLOCKS)
def on_step(
    degree: int,
    dimension: int,
    columns: int,
    c: In,
    times: In,
    states: In,
    output_times: In,
    count: int,
    out: Out,
    stride: int,
) -> None:
    """Write the states at `count` sorted times `output_times` on one step to `out`.

    Entry j at time i has the index j * stride + i. c has the coefficients of the step's polynomial: that of
    power k and entry j at index (k * dimension + j) * columns. `times` and `states` begin with the start and
    the end of the step. At these times the state is copied.
    """
    theta = reals(CHUNK, room=WIDEST_VECTOR)
    t, end = times[0], times[1]
    h = end - t
    for begin in range(0, count, CHUNK):
        part = min(count - begin, CHUNK)
        block_times = output_times[begin:]
        # Whole vectors are computed. Numbers after the last must not be denormal, because multiplying these is slow.
        padding = theta[part:]
        for i in each(WIDEST_VECTOR, width=WIDEST_VECTOR, spill=True):
            padding[i] = 0.0
        for i in range(part):
            theta[i] = (block_times[i] - t) / h
        horner(degree, dimension, dimension * columns, columns, c, theta, part, out[begin:], stride)
    lowest, highest = 0, count
    while lowest < highest and output_times[max(highest - 1, 0)] == end:
        highest -= 1
        copy_state(states[dimension:], dimension, out[highest:], stride)
    while lowest < highest and output_times[min(lowest, count - 1)] == t:
        copy_state(states, dimension, out[lowest:], stride)
        lowest += 1


@inline
def copy_state(state: In, dimension: int, out: Out, stride: int) -> None:
    """Write the entries of a state to `out`, at indices that are multiples of `stride`."""
    for j in range(dimension):
        out[j * stride] = state[j]
