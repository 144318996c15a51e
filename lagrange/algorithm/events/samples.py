"""Event functions sampled on a block of steps: steps that may contain zeros, and a polynomial for each function.

Functions are sampled at Chebyshev points. Source: L. N. Trefethen, Approximation Theory and Approximation Practice,
2013, chapters 2 and 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import RELATIVE_PERTURBATION, WIDEST_VECTOR
from lagrange.algorithm.dense.block import COLUMNS, POLYNOMIAL, BlockSteps, chebyshev_points, gather, steps_in
from lagrange.algorithm.events.constants import DENSE_ROUND_OFF, EPSILON, LARGEST_NOISE, NOISE, SURELY, TAIL, TINY
from lagrange.procedure.form import Array
from lagrange.procedure.front.decorators import Bundle, Stated, inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    WholesIn,
    each,
    fma,
    larger,
    magnitude,
    quotient,
    reals,
    unlikely,
    unrolled,
)

FloatArray = NDArray[np.float64]

DEGREE = 16
"""Degree of the polynomial of an event function on a step. If the polynomial does not resolve the function, the step is
halved. A polynomial event function of at most this degree is represented exactly.
"""

COARSE = 8
"""Degree at which many steps are sampled first. It suffices to prove that most functions keep their sign."""


@lru_cache(maxsize=8)
def to_chebyshev(degree: int = DEGREE) -> FloatArray:
    """Return the matrix that maps values at the nodes to coefficients of Chebyshev's polynomials on [0, 1]."""
    ranks = np.arange(degree + 1)
    halves = np.where((ranks == 0) | (ranks == degree), 0.5, 1.0)
    signs = (-1.0) ** ranks
    angles = np.cos(np.pi * (np.outer(ranks, ranks) % (2 * degree)) / degree)
    return np.asarray(2 / degree * (halves * signs)[:, None] * angles * halves)


@lru_cache(maxsize=8)
def to_powers(degree: int = DEGREE) -> FloatArray:
    """Return the matrix that maps coefficients of Chebyshev's polynomials on [0, 1] to those of powers."""
    matrix = np.zeros((degree + 1, degree + 1))
    matrix[0, 0], matrix[:2, 1] = 1, (-1, 2)
    for rank in range(1, degree):
        last = matrix[:, rank]
        matrix[:, rank + 1] = 2 * (2 * np.roll(last, 1) - last) - matrix[:, rank - 1]
    return matrix


Reals = tuple[float, ...]


@inline
def weighted(terms: Sequence[float], weights: Sequence[float]) -> float:
    """Return the sum of products of terms and weights. Weights without a term are ignored."""
    total = terms[0] * weights[0]
    for term, weight in zip(terms[1:], weights[1:], strict=False):
        total = fma(term, weight, total)
    return total


@inline
def transform(values: Reals) -> Reals:
    """Return the Chebyshev coefficients of a function from its `values` at the nodes.

    Polynomials of even degree are symmetric about the middle, polynomials of odd degree antisymmetric. So half
    of the products suffice.
    """
    degree = len(values) - 1
    middle = degree // 2
    sums = (*(values[k] + values[degree - k] for k in range(middle)), values[middle])
    differences = tuple(values[k] - values[degree - k] for k in range(middle))
    rows = enumerate(to_chebyshev(degree).tolist())
    return tuple(weighted(differences if rank % 2 else sums, row) for rank, row in rows)


@inline
def keeps_sign(coefficients: Reals, noise: float) -> bool:
    """Return True if the Chebyshev coefficients of a function prove that it keeps its sign on [0, 1].

    `noise` is the error of its values. The coefficients beyond the last one are estimated as `TAIL` times the
    last ones.
    """
    variation = abs(coefficients[1])
    for coefficient in coefficients[2:]:
        variation = variation + abs(coefficient)
    variation = variation + TAIL * magnitude(coefficients[-2], coefficients[-1]) + 4.0 * noise
    return abs(coefficients[0]) > SURELY * variation


@inline
def largest(values: Reals) -> float:
    """Return the largest magnitude of the values, NaN if one of them is NaN."""
    size = values[0]
    for number in values[1:]:
        size = magnitude(size, number)
    return size


@procedure(noinline=True)
def chebyshev(values: In, out: Out) -> float:
    """Write the Chebyshev coefficients of a function to `out`, from its `values` at the nodes.

    Return the largest magnitude of the values.
    """
    numbers = tuple(values[k] for k in unrolled(DEGREE + 1))
    for k, coefficient in enumerate(transform(numbers)):
        out[k] = coefficient
    return largest(numbers)


@procedure
def local_polynomial(
    chebyshev: In, size: float, noise: float, before: float, least: float, powers: Out
) -> tuple[int, float, float]:
    """Write the coefficients of a polynomial that resolves a function on a part of a step to `powers`.

    Return the number of coefficients, the error of the polynomial, and the size of the last Chebyshev
    coefficients. The number is 0 if the function is not resolved, and 1 if only its sign is certain.
    `chebyshev` are the Chebyshev coefficients of the function, `size` its largest sampled magnitude, and
    `noise` its rounding error. Coefficients below rounding, or below `least`, are omitted and counted as noise.
    So are the coefficients beyond the degree: at a kink their sum is several times the last one. The last
    coefficients are noise too if they hardly decreased when the interval was halved; `before` is their size
    before that.
    """
    coefficients = tuple(chebyshev[k] for k in unrolled(DEGREE + 1))
    tail = magnitude(coefficients[-2], coefficients[-1])
    is_grain = tail > before * 0.25 and tail <= LARGEST_NOISE * size
    error = noise + (8.0 * tail if is_grain else TINY)
    if unlikely(not size < math.inf):
        return 0, error, tail
    if unlikely(not tail <= error + 8 * EPSILON * size):
        if keeps_sign(coefficients, error):
            powers[0] = coefficients[0]
            return 1, error, tail
        return 0, error, tail
    floor = larger(EPSILON * size, least)
    count, left = 1, 0.0
    for k, coefficient in enumerate(coefficients):
        count = k + 1 if abs(coefficient) > floor else count
    for k, coefficient in enumerate(coefficients):
        left = left + (0.0 if count > k else abs(coefficient))
    kept = tuple(coefficient if count > k else 0.0 for k, coefficient in enumerate(coefficients))
    for power, row in enumerate(to_powers(DEGREE).tolist()):
        powers[power] = weighted(kept[power:], row[power:])
    return count, error + (left + 4.0 * DEGREE * tail), tail


SLOPE_AT = 0.5 - 12**-0.5
"""Fraction of the step at which s**2 (1 - s)**2 has its largest slope."""

MISSED = 1 / 16 / (2 * SLOPE_AT * (1 - SLOPE_AT) * (1 - 2 * SLOPE_AT))
"""Largest value of s**2 (1 - s)**2 on [0, 1], divided by its largest slope. The error of a cubic has this form, so this
factor converts the error of its slope to the error of its states.
"""

SAFELY = 4.0
"""Safety factor of the estimated error of a cubic, in addition to the factor of four for all noise."""

UNRESOLVED = 0.02
"""Largest error of a cubic, as a fraction of the change of an entry of the state, at which the cubic may exclude events
on a step.
"""


class Widths(NamedTuple):
    """Numbers of columns in memory for the samples of a block of steps; each sample takes one column.

    `wide` is for the first samples: at few nodes, and at both ends perturbed by rounding. `full` is for all nodes of
    the block. `part` is for the nodes of a part of one step.
    """

    wide: int
    full: int
    part: int

    @classmethod
    def of(cls, columns: int) -> Widths:
        """Return the numbers of columns in memory for samples of blocks of `columns` steps."""
        return cls((COARSE + 3) * columns, (DEGREE + 1) * columns, (DEGREE // columns + 1) * columns)


@dataclass(frozen=True)
class Lines:
    """Work memory for samples of event functions: times and states by columns, then arrays for the events.

    These arrays have a column for each step. `far` is 1.0 for a step whose cubic cannot exclude events.
    `missed` and `moved` are the event functions at a perturbed start of each step. The state is perturbed by a
    small part of the error of the cubic for `missed`, and of the state's change over the step for `moved`.
    `noise` and `edge_end` are the errors of event functions on a step and at its end. `doubtful` is 1.0 if an
    event function may be zero on the step.
    """

    t_end: Out
    far: Out
    time: Out
    state: Out
    part_time: Out
    part_state: Out
    missed: Out
    noise: Out
    edge_end: Out
    moved: Out
    doubtful: Out
    size: Out
    coarse: Out
    fine: Out
    chebyshev: Out
    part: Out


@inline
def sizes_of(dimension: int, events: int, columns: int) -> tuple[int, ...]:
    """Return the number of doubles of each array of `Lines`, in order, for blocks of `columns` steps.

    `dimension` is the length of a state, and `events` the number of event functions.
    """
    wide, full, part = Widths.of(columns)
    shared = columns, columns, full, dimension * full, part, dimension * part
    return (*shared, *(events * width for width in (columns,) * 6 + (wide, full, full, part)))


def work_size(dimension: int, events: int, columns: int = WIDEST_VECTOR) -> int:
    """Return the number of doubles of work memory for the search for events, for blocks of `columns` steps."""
    return sum(sizes_of(dimension, events, columns)) + WIDEST_VECTOR


@dataclass(frozen=True)
class Samples:
    """Steps of a run, with the functions and memory that evaluate the event functions along them, block by block.

    `polynomial` writes the dense output of a block, of a `degree`, to `c`; it needs the neighbours of steps if
    `both` is 1. `kernel` evaluates the event functions. If `screens` is true, cubics are tried first: they
    exclude events on most steps. `screen` writes the cubics, and the right-hand side `law` gives their error.
    `factors` perturb the entries of a state, and then the time, by `RELATIVE_PERTURBATION`. Vectors of a block,
    and the arrays of events, are by columns, as in `dense.block`.
    """

    polynomial: Callable[..., Any]
    given: In
    degree: int
    both: int
    screens: bool
    screen: Callable[..., Any]
    screen_given: In
    law: Callable[..., Any]
    law_parameters: In
    step_data: Out
    neighbours: Out
    path_work: Out
    c: Out
    kernel: Callable[..., Any]
    parameters: In
    dimension: int
    events: int
    factors: In
    work: Out
    times: Any
    states: Any
    steps: int

    columns = WIDEST_VECTOR
    """Number of steps of a block: one for each column."""

    @inline
    def lines(self) -> Lines:
        """Return the parts of the work memory: times, states, event functions at sample points, and errors."""
        arrays: tuple[Any, ...] = ()
        unused = self.work
        for size in sizes_of(self.dimension, self.events, self.columns):
            arrays, unused = (*arrays, unused), unused[size:]
        return Lines(*arrays)

    @inline
    def block(self) -> BlockSteps:
        """Return the steps of the block that is sampled: their times, lengths and states."""
        return steps_in(self.step_data, self.dimension, self.columns)

    @inline
    def each_column(self) -> Iterator[int]:
        """Loop over the columns of the block, one for each step."""
        yield from each(self.columns, width=self.columns, disjoint=True)

    @inline
    def gather(self, lines: Lines, step_numbers: WholesIn, with_neighbours: int) -> None:
        """Copy the steps with the numbers `step_numbers` to the memory of the block, one to each column.

        If `with_neighbours` is 1, their neighbours are copied too.
        """
        run = self.steps, self.times, self.states
        gather(self.dimension, self.columns, step_numbers, *run, with_neighbours, self.step_data, self.neighbours)
        for b in range(self.columns):
            lines.t_end[b] = self.times[step_numbers[b] + 1]

    @inline
    def follow(self, lines: Lines, step_numbers: WholesIn) -> bool:
        """Compute the dense output of some steps, and find those on which an event function may be zero.

        `step_numbers` has the numbers of the steps, one for each column. The flags are written to
        `lines.doubtful`. Return True if an event function has no value.
        """
        self.gather(lines, step_numbers, self.both)
        self.polynomial(self.given, self.columns, self.step_data, self.neighbours, self.path_work, self.c)
        return self.find_doubtful(lines, self.degree, screening=False)

    @inline
    def sift(self, lines: Lines, step_numbers: WholesIn) -> bool:
        """Find the steps on which an event function may be zero, by cubics. Write the flags to `lines.doubtful`.

        `step_numbers` has the numbers of the steps. The path differs from the cubic through the ends of a step by K
        s**2 (1 - s)**2 at the fraction s. The difference of their slopes, evaluated at `SLOPE_AT`, where it is largest,
        gives K. The result is True if an event function has no value, or a mass matrix is singular.
        """
        self.gather(lines, step_numbers, 0)
        self.screen(self.screen_given, self.columns, self.step_data, self.neighbours, self.path_work, self.c)
        columns, total, step = self.columns, self.dimension * self.columns, self.block()
        y, slopes = lines.part_state, lines.state
        for b in self.each_column():
            lines.time[b] = fma(step.h[b], SLOPE_AT, step.t[b])
        for j in range(self.dimension):
            to, c = y[j * columns :], tuple(self.c[total * k :][j * columns :] for k in unrolled(4))
            for b in self.each_column():
                to[b] = fma(fma(fma(c[3][b], SLOPE_AT, c[2][b]), SLOPE_AT, c[1][b]), SLOPE_AT, c[0][b])
        half = quotient(self.dimension, 2) * columns
        is_singular = self.law(columns, lines.time, y, y[half:], self.law_parameters, slopes) >= 0
        for b in self.each_column():
            lines.far[b] = 0.0
        for j in range(self.dimension):
            to, c = y[j * columns :], tuple(self.c[total * k :][j * columns :] for k in unrolled(4))
            start, slope, factor = step.y[j * columns :], slopes[j * columns :], self.factors[j] - 1.0
            for b in self.each_column():
                expected = fma(fma(3.0 * SLOPE_AT, c[3][b], 2.0 * c[2][b]), SLOPE_AT, c[1][b])
                missed = MISSED * abs(step.h[b] * slope[b] - expected)
                to[b] = fma(missed, factor, start[b])
                last = fma(fma(3.0, c[3][b], 2.0 * c[2][b]), 1.0, c[1][b])
                moves = larger(abs(c[3][b] + c[2][b] + c[1][b]), 0.25 * magnitude(c[1][b], last))
                before, is_far = lines.far[b], not missed <= UNRESOLVED * moves + DENSE_ROUND_OFF * abs(start[b])
                lines.far[b] = 1.0 if is_far else before
        is_bad = self.evaluate(columns, step.t, y, lines.missed)
        return self.find_doubtful(lines, 3, screening=True) or is_bad or is_singular

    @inline
    def find_doubtful(self, lines: Lines, degree: int, screening: bool) -> bool:
        """Find the steps on which an event function may be zero: write 1.0 for these to `lines.doubtful`, else 0.0.

        The polynomials of the steps have a `degree`. If `screening`, they are cubics, and their error is part
        of the noise. Return True if an event function has no value.
        """
        columns = self.columns
        is_bad = self.sample_coarsely(lines, degree)
        for e in range(self.events):
            values = lines.coarse[e * Widths.of(columns).wide :]
            of_event = lines.missed, lines.noise, lines.edge_end, lines.moved, lines.doubtful
            missed, noise, edge_end, moved, doubtful = tuple(line[e * columns :] for line in of_event)
            for b in self.each_column():
                samples = tuple(values[k * columns :][b] for k in unrolled(COARSE + 3))
                edge = edge_noise(samples[0], samples[COARSE + 1])
                end = edge_noise(samples[COARSE], samples[COARSE + 2])
                edge_end[b] = end
                wrong = (edge if edge > end else end) + path_noise(samples[: COARSE + 1], moved[b])
                noise[b] = wrong
                if screening:
                    far = lines.far[b]
                    wrong = wrong + abs(missed[b] - samples[0]) * (SAFELY / RELATIVE_PERTURBATION)
                    wrong = math.inf if far > 0.0 else wrong
                doubtful[b] = 0.0 if keeps_sign(transform(samples[: COARSE + 1]), wrong) else 1.0
        return is_bad

    @inline
    def some_doubtful(self, lines: Lines, b: int) -> bool:
        """Return True if some event function may be zero on the step in column `b`."""
        is_doubtful = False
        for e in range(self.events):
            doubtful = lines.doubtful[e * self.columns + b]
            is_doubtful = is_doubtful or doubtful != 0.0
        return is_doubtful

    @inline
    def sample_coarsely(self, lines: Lines, degree: int) -> bool:
        """Write the event functions at a few points of each step to `lines`. Return True if one has no value.

        The points are a few nodes, by polynomials of a `degree`, and both ends perturbed by rounding: these
        values are in `lines.coarse`. For `lines.moved` the start is perturbed by a small part of the range of
        the state.
        """
        columns, thetas, step, n = self.columns, chebyshev_points(COARSE).tolist(), self.block(), self.dimension
        wide, total, factor_of_time = Widths.of(columns).wide, n * columns, self.factors[n]
        for b in self.each_column():
            t, end = step.t[b], lines.t_end[b]
            for k, time in enumerate((*times_at(t, end, thetas), t * factor_of_time, end * factor_of_time)):
                lines.time[k * columns :][b] = time
        for j in range(n):
            to, factor, c = lines.state[j * wide :], self.factors[j], self.c[j * columns :]
            start, new, part = step.y[j * columns :], step.new[j * columns :], lines.part_state[j * columns :]
            for b in self.each_column():
                y, end = start[b], new[b]
                inside = values_at(c, total, degree, b, thetas[1:-1])
                for k, value in enumerate((y, *inside, end, y * factor, end * factor)):
                    to[k * columns :][b] = value
                low, high = extent((y, *inside, end))
                part[b] = fma(high - low, factor - 1.0, y)
        is_bad = self.evaluate(wide, lines.time, lines.state, lines.coarse)
        return self.evaluate(columns, step.t, lines.part_state, lines.moved) or is_bad

    @inline
    def evaluate(self, columns: int, t: In, y: In, out: Out) -> bool:
        """Write the event functions at times t and states y to `out`. Return True if one has no value.

        The arrays have one of `columns` samples in each column.
        """
        half = quotient(self.dimension, 2) * columns
        is_bad: bool = self.kernel(columns, t, y, y[half:], self.parameters, out) >= 0
        return is_bad

    @inline
    def sample_fully(self, lines: Lines) -> bool:
        """Write the Chebyshev coefficients of event functions on each step to `lines.chebyshev`.

        Return True if an event function has no value at a node.
        """
        columns, thetas, step = self.columns, chebyshev_points(DEGREE).tolist(), self.block()
        full, total = Widths.of(columns).full, self.dimension * columns
        for b in self.each_column():
            for k, time in enumerate(times_at(step.t[b], lines.t_end[b], thetas)):
                lines.time[k * columns :][b] = time
        for j in range(self.dimension):
            to, c = lines.state[j * full :], self.c[j * columns :]
            start, new = step.y[j * columns :], step.new[j * columns :]
            for b in self.each_column():
                inside = values_at(c, total, self.degree, b, thetas[1:-1])
                for k, value in enumerate((start[b], *inside, new[b])):
                    to[k * columns :][b] = value
        is_bad = self.evaluate(full, lines.time, lines.state, lines.fine)
        for e in range(self.events):
            values, to, size = lines.fine[e * full :], lines.chebyshev[e * full :], lines.size[e * columns :]
            for b in self.each_column():
                samples = tuple(values[k * columns :][b] for k in unrolled(DEGREE + 1))
                for k, value in enumerate(transform(samples)):
                    to[k * columns :][b] = value
                size[b] = largest(samples)
        return is_bad

    @inline
    def sample_part(self, lines: Lines, b: int, start: float, width: float) -> bool:
        """Write the event functions at the nodes of a part of the step in column b to `lines.part`.

        Return True if an event function has no value. `start` and `width` are the start and the width of the part, as
        fractions of the step. Unused columns repeat the end of the part.
        """
        columns, step, part = self.columns, self.block(), Widths.of(self.columns).part
        total, t = self.dimension * columns, step.t[b]
        h, fractions = lines.t_end[b] - t, reals(part, room=WIDEST_VECTOR)
        for k in unrolled(part):
            fractions[k] = chebyshev_points(DEGREE).tolist()[k] if k <= DEGREE else 1.0
        for k in each(part, width=columns):
            lines.part_time[k] = fma(h, fma(width, fractions[k], start), t)
        for j in range(self.dimension):
            c, to = self.c[j * columns + b :], lines.part_state[j * part :]
            for k in each(part, width=columns):
                theta, value = fma(width, fractions[k], start), c[self.degree * total]
                for power in range(self.degree):
                    value = fma(value, theta, c[(self.degree - 1 - power) * total])
                to[k] = value
        return self.evaluate(part, lines.part_time, lines.part_state, lines.part)


def samples_type(*without: str) -> Bundle:
    """Return the type of a procedure's parameter of class `Samples`. The fields `without` are not passed."""
    types: dict[str, Stated] = {"polynomial": POLYNOMIAL, "screen": POLYNOMIAL, "law": COLUMNS, "kernel": COLUMNS}
    types |= dict.fromkeys(("step_data", "neighbours", "path_work", "c", "work"), Array(room=WIDEST_VECTOR))
    types |= dict.fromkeys(("times", "states"), Array(read=True))
    return Bundle(Samples, types | dict.fromkeys(without))


@inline
def times_at(t: float, end: float, thetas: Sequence[float]) -> Reals:
    """Return the times at the fractions `thetas` of a step. The first and the last are exactly its ends."""
    return (t, *(fma(end - t, theta, t) for theta in thetas[1:-1]), end)


@inline
def values_at(c: In, total: int, degree: int, b: int, thetas: Sequence[float]) -> Reals:
    """Return the values of one entry of the state in column `b`, at the fractions `thetas` of the step.

    The coefficients of the entry begin at c. Coefficients of consecutive powers, up to `degree`, are `total`
    doubles apart.
    """
    top = c[degree * total :][b]
    sums = tuple(top for _ in thetas)
    for k in range(degree):
        coefficient = c[(degree - 1 - k) * total :][b]
        sums = tuple(fma(value, theta, coefficient) for value, theta in zip(sums, thetas, strict=True))
    return sums


@inline
def extent(values: Reals) -> tuple[float, float]:
    """Return the smallest and the largest of the values, ignoring NaN."""
    low = high = values[0]
    for value in values[1:]:
        low, high = value if value < low else low, value if value > high else high
    return low, high


@inline
def edge_noise(value: float, moved: float) -> float:
    """Return the rounding error of an event function at an accepted state.

    `value` is the function at the state, and `moved` at the state perturbed by `RELATIVE_PERTURBATION`.
    """
    error = abs(moved - value) * (NOISE / RELATIVE_PERTURBATION)
    return error if error < math.inf else 0.0


@inline
def path_noise(values: Reals, moved: float) -> float:
    """Return the error of an event function on a step due to the rounding of the step's dense output.

    `values` are samples of the function. `moved` is its value after the state at the start has moved by a small
    part of its change over the step. The error scales with the change of the state, not of the function: x**2 +
    v**2 may be constant while x and v change.
    """
    low, high = extent(values)
    spread, gain = high - low, abs(moved - values[0]) * (1.0 / RELATIVE_PERTURBATION)
    most = spread if spread == spread and not gain > spread else gain
    return DENSE_ROUND_OFF * most if most < math.inf else 0.0
