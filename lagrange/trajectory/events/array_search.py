"""Find the zeros of an event function on one step with NumPy arrays, and its sign at the end of the step.

The function is sampled at Chebyshev points of subintervals. A subinterval is halved until its Chebyshev series
resolves the function, so that the last coefficients are at rounding level. Source: L. N. Trefethen, Approximation
Theory and Approximation Practice, 2013, chapters 3, 4 and 8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagrange.algorithm.dense.block import chebyshev_points
from lagrange.algorithm.events.constants import (
    DEEPEST_HALVING,
    EPSILON,
    JUMP,
    MOST_COEFFICIENTS,
    MOST_ROOTS,
    UNFIT,
)
from lagrange.algorithm.events.roots import roots as root_isolation
from lagrange.algorithm.events.samples import DEGREE, local_polynomial, to_chebyshev
from lagrange.machine.python_source import called
from lagrange.trajectory.events.step_batch import Sample, StepBatch
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True)
class Root:
    """A time on a step at which an event function crosses zero, or touches it.

    `time` is counted from the start of the step, and lies between 0 and the step length h. `rising` is 1 if the
    function goes from negative to positive along the integration, -1 for the reverse, and 0 if it touches zero. `jump`
    is True if the function changes its sign without a zero.
    """

    time: float
    rising: int
    jump: bool = False


@dataclass(frozen=True)
class EventZero:
    """A root of the event function with index `which` on a step.

    The time of `root` is a fraction of the step. For a Taylor series, it is a multiple of the time scale of the
    series.
    """

    which: int
    root: Root


@dataclass(frozen=True)
class Side:
    """The sign of an event function at the end of a step, which the search on the next step starts from.

    `sign` is the last sign beyond noise, 1 or -1. It is 0 at the start of a run, and after a reset. `near` is True if
    the function has come within its noise of zero since it had this sign. The next step then decides whether it crosses
    or touches zero.
    """

    sign: int = 0
    near: bool = False

    @property
    def settled(self) -> bool:
        """True if the sign is known and the function is not near zero: a step without zeros keeps this side."""
        return self.sign != 0 and not self.near


Isolate = Callable[..., Any]
"""Type of a compiled procedure that isolates the roots of a polynomial on a step (`roots` of `algorithm.events`)."""


def printed() -> Isolate:
    """Return the procedure that isolates the roots of a polynomial, as a Python function."""
    return called(root_isolation.form())


def roots(
    coefficients: FloatArray,
    h: float,
    before: Side | None = None,
    *,
    noise: float = 0.0,
    last: bool = False,
    isolate: Isolate | None = None,
) -> tuple[list[Root], Side]:
    """Return the roots of g(tau) = sum c[k] tau**k on a step, in order, and the side (sign) of g at its end.

    `coefficients` (m,) are c, with m at most 65. `h` is the length of the step, negative in a backward run. `before` is
    the `Side` that the previous step returned. None means that g starts on this step; a root at the start is then not
    an event. `noise` is an error of g in addition to the rounding of the coefficients, which is estimated as 8 * 2**-52
    sum |c[k] h**k|. `last` is True if no step follows.

    `isolate` is the procedure that isolates the roots, by default in Python. Raises ValueError if a coefficient, the
    noise or the length is not finite, for no coefficients, and for too many.
    """
    polynomial = np.array(coefficients, dtype=float)
    before = Side() if before is None else before
    times, rising = np.empty(MOST_ROOTS), np.empty(MOST_ROOTS, dtype=np.int64)
    side = before.sign, before.near, last
    run = printed() if isolate is None else isolate
    count, sign, near = UNFIT, 0, False
    if 0 < len(polynomial) <= MOST_COEFFICIENTS:
        count, sign, near = run(polynomial, len(polynomial), float(h), float(noise), *side, times, rising, MOST_ROOTS)
    if count < 0:
        raise ValueError(
            f"the zeros of an event function need 1 to {MOST_COEFFICIENTS} coefficients; these, the noise and the "
            "length of the step must be finite numbers"
        )
    zeros = zip(times[:count].tolist(), rising[:count].tolist(), strict=True)
    return [Root(time, way) for time, way in zeros], Side(sign, near)


SAMPLED_HALVINGS = 5000
"""Largest number of halvings of one step, enough for some hundreds of roots. After them a line through the ends of each
unresolved part replaces the event function there."""

POLE_LEVELS = 26
"""Number of halvings that distinguish a pole from a jump. A function that grows by more than a factor of 1000 over them
has a pole. Near a pole each halving doubles the size of the function, while at a jump the size is constant."""


NOWHERE = np.empty(0)
"""Empty array of polynomial coefficients, for a part of a step on which an event function has no value."""


@dataclass(frozen=True, eq=False)
class LocalPolynomial:
    """A polynomial that represents an event function on a part of a step.

    The part begins at `start` and has the length `width`, both fractions of the step. `coefficients`, the constant
    first, belong to powers of the time since the start of the part, in units of its width. They are empty on a part
    where the function has no value, or a pole. `noise` bounds the error of the polynomial. `jump` is True if the
    function changes its sign on the part without a zero. The part is then too short to be halved.
    """

    start: float
    width: float
    coefficients: FloatArray
    noise: float
    jump: bool = False


def local_polynomials(
    g: Callable[[FloatArray], FloatArray], values: FloatArray, noise: float, *, smooth: bool = False
) -> Iterator[LocalPolynomial]:
    """Yield polynomials of an event function g on parts of a step, in order.

    On each part the polynomial resolves g, or g certainly keeps its sign. `g` maps fractions (K,) of the step to
    values (K,); `values` are its values at the Chebyshev points of the whole step. `noise` is the error of g. The
    parts end where g has no value. With `smooth`, coefficients below the noise are omitted on a part at the start of
    the step, where derivatives are needed.
    """
    stack = [(0.0, 0, values, math.inf, 0.0)]
    halvings = 0
    while stack:
        start, depth, samples, before, above = stack.pop()
        width, finite = 0.5**depth, bool(np.isfinite(samples).all())
        size = _size(samples) if finite else math.inf
        least = noise if smooth and start == 0 else 0.0
        chebyshev = to_chebyshev() @ np.where(np.isfinite(samples), samples, 0.0)
        coefficients, error, tail = _resolved(chebyshev, size, noise, before, least)
        if len(coefficients):
            yield LocalPolynomial(start, width, coefficients, error)
        elif depth < DEEPEST_HALVING and halvings < SAMPLED_HALVINGS:
            halvings += 1
            above = _size(samples) if depth == DEEPEST_HALVING - POLE_LEVELS else above
            for begin in (start + width / 2, start):
                stack.append((begin, depth + 1, g(begin + width / 2 * chebyshev_points(DEGREE)), tail, above))
        elif not finite or (depth == DEEPEST_HALVING and _size(samples) > 1e3 * above):
            yield LocalPolynomial(start, width, NOWHERE, noise)
            return
        else:
            jump = depth == DEEPEST_HALVING and samples[0] * samples[-1] < 0 and min(abs(samples[[0, -1]])) > noise
            yield LocalPolynomial(start, width, np.array([samples[0], samples[-1] - samples[0]]), noise, bool(jump))


def _resolved(
    chebyshev: FloatArray, size: float, noise: float, before: float, least: float
) -> tuple[FloatArray, float, float]:
    """Return the power coefficients (k,) of a function on a part of a step, their error, and the tail.

    The tail is the size of the last of the function's Chebyshev coefficients, `chebyshev` (17,), and `before` is the
    tail on the interval of twice the length. `size` is the largest sampled magnitude of the function, and `noise` its
    rounding error. Chebyshev coefficients below `least` are omitted. The result has no coefficients if the function is
    not resolved.
    """
    powers = np.empty(DEGREE + 1)
    count, error, tail = called(local_polynomial.form())(chebyshev, size, noise, before, least, powers)
    return powers[:count], error, tail


def _size(values: FloatArray) -> float:
    """Return the largest magnitude of the finite values in an array, or 0 if none is finite."""
    sizes = np.abs(values[np.isfinite(values)])
    return float(sizes.max(initial=0.0))


RATE_NOISE = 1024 * EPSILON
"""Error of the time derivative of an event function on a step, as a fraction of its largest magnitude there. The
weights of DOP853's dense output amplify rounding by a factor of 500."""

SAME_JUMP = 2.0**-44
"""Largest distance in time of two crossings of one jump, as a fraction of the step. It is 256 relative spacings of
floating-point numbers, because rounding of the state moves the crossings."""


@dataclass(frozen=True, eq=False)
class StepZeros:
    """The `zeros` of an event function on a step, in order, with times as fractions of the step.

    `parts` are pairs of a polynomial on a part of the step and the side (sign of the function) before this part.
    `after` is the side at the end of the step. `until` is the fraction of the step from which the function has no
    value, else infinity. For a function that starts at zero, `leaving` has its sign just after the start (0 if it stays
    zero) and its lowest power of time.
    """

    parts: tuple[tuple[LocalPolynomial, Side], ...]
    zeros: tuple[Root, ...]
    after: Side
    until: float
    leaving: tuple[int, int]


def trace(
    sample: Sample,
    index: int,
    noise: float,
    before: Side,
    *,
    level: float = 0.0,
    starting: bool = False,
    last: bool = False,
    isolate: Isolate | None = None,
) -> StepZeros:
    """Return the zeros of one event function on a step, and its sides (signs) on the parts of the step.

    `sample` evaluates all event functions on the step, and `index` is the index of this one. `noise` is the error of
    the function, and `before` its side before the step. `level` is first subtracted from the function. `starting` is
    True if the function starts at `level` with an undecided side. `last` is True if no step follows. `isolate` is the
    procedure that isolates the roots of a polynomial.
    """
    parts: list[tuple[LocalPolynomial, Side]] = []
    located: list[Root] = []
    leaving = (0, 0)
    for piece in local_polynomials(
        lambda s: sample.events(s)[index] - level, sample.values[index] - level, noise, smooth=starting
    ):
        if not len(piece.coefficients):
            return StepZeros(tuple(parts), tuple(located), before, piece.start, leaving)
        if starting and piece.start == 0:
            piece = _divided(piece)
            leaving = _leaving(piece)
            if leaving[1] != 1:
                piece = _integrated(sample, index, piece)
                leaving = _leaving(piece)
            before = Side(leaving[0])
        if len(piece.coefficients):
            parts.append((piece, before))
            final = last and piece.start + piece.width == 1.0
            zeros, before = roots(piece.coefficients, 1.0, before, noise=piece.noise, last=final, isolate=isolate)
            begins = starting and piece.start == 0
            # A change of sign at the start of a part is a jump if the polynomial there is far from zero.
            sizes = np.abs(piece.coefficients)
            starts_clear = not begins and bool(sizes[0] > JUMP * sizes.sum())
            for root in zeros:
                jump = piece.jump or (root.time == 0 and starts_clear)
                located.append(replace(root, time=piece.start + piece.width * root.time, jump=jump))
    return StepZeros(tuple(parts), _merged(located), before, math.inf, leaving)


def ended(step_zeros: StepZeros, s: float, isolate: Isolate | None = None, *, decided: bool) -> tuple[list[Root], Side]:
    """Return the zeros of an event function on a step up to the fraction `s`, and the side (sign) at this point.

    At `s` another event acts, so that the step is shortened. `step_zeros` are the zeros of the function on the whole
    step. If the function is zero at `s`, its slope decides the side if `decided` is True; otherwise the side stays
    undecided. `isolate` is the procedure that isolates the roots of a polynomial.
    """
    zeros: list[Root] = []
    side = step_zeros.parts[0][1] if step_zeros.parts else step_zeros.after
    for piece, before in step_zeros.parts:
        length = (s - piece.start) / piece.width
        if length > 0:
            cut, last = min(length, 1.0), decided and length <= 1
            part_zeros, side = roots(piece.coefficients, cut, before, noise=piece.noise, last=last, isolate=isolate)
            zeros += [replace(root, time=piece.start + piece.width * root.time) for root in part_zeros]
    return zeros, side


def _merged(located: list[Root]) -> tuple[Root, ...]:
    """Return the roots of an event function on a step, without crossings of a jump that cancel each other.

    Because of rounding the motion may cross one jump several times. Two crossings in opposite directions cancel.
    """
    merged: list[Root] = []
    for root in located:
        if merged and merged[-1].jump and root.jump and root.time - merged[-1].time <= SAME_JUMP:
            merged.pop()
        else:
            merged.append(root)
    return tuple(merged)


def _divided(piece: LocalPolynomial) -> LocalPolynomial:
    """Return a polynomial that is zero at the start of its part, divided by time from the start.

    The division removes this zero, so that a second zero close to it is found. The noise is multiplied by 2 k**2, the
    slope of Chebyshev's polynomial of degree k at the end of [0, 1].
    """
    rank = max(len(piece.coefficients) - 1, 1)
    return replace(piece, coefficients=piece.coefficients[1:], noise=2 * rank * rank * piece.noise)


def _integrated(sample: Sample, index: int, piece: LocalPolynomial) -> LocalPolynomial:
    """Return the polynomial of an event function that starts at zero, divided by time from the start.

    It is the integral of the function's time derivative, divided by time. `index` is the index of the function, and
    `sample` the step. `piece` is the same quotient, computed from the values of the function, and is returned if a
    derivative is not finite. The derivative avoids the rounding of a large constant in the function, such as the height
    of the floor on which a ball lands.
    """
    values = sample.rates(piece.width * chebyshev_points(DEGREE))[index] * piece.width
    if not np.isfinite(values).all():
        return piece
    size, chebyshev = float(np.abs(values).max()), to_chebyshev() @ values
    noise = RATE_NOISE * size + DEGREE * float(np.abs(chebyshev[-2:]).max())
    slopes, _, _ = _resolved(chebyshev, size, noise, math.inf, noise)
    return replace(piece, coefficients=slopes / np.arange(1, len(slopes) + 1), noise=noise)


def _leaving(piece: LocalPolynomial) -> tuple[int, int]:
    """Return the sign of a function just after a start at zero, and the lowest power of time in its polynomial.

    `piece` is the polynomial of the function, divided by time. Terms within its noise are left out. The sign and the
    power are 0 if no term is left, so that the function stays zero.
    """
    beyond = np.flatnonzero(np.abs(piece.coefficients) > piece.noise)
    if not len(beyond):
        return 0, 0
    first = int(beyond[0])
    return int(np.sign(piece.coefficients[first])), 1 + first


def rests(batch: StepBatch, step: int, sample: Sample, index: int) -> bool:
    """Return True if an event function that started at zero stays zero on the whole step, like a conserved quantity.

    `index` is the index of the event function, and `sample` the step with index `step` in the `batch`. The test uses
    the time derivative of the function along the solution, since the dense output deviates from the solution by more
    than rounding.
    """
    return bool((np.abs(sample.rates(chebyshev_points(DEGREE))[index]) <= batch.sensitive[index, step]).all())


def velocity(sample: Sample, index: int) -> float:
    """Return the derivative of an event function at the start of a step, or 0 if it is within rounding of zero.

    It is taken with respect to the fraction of the step. `index` is the index of the function, and `sample` the step.
    """
    rates = sample.rates(chebyshev_points(DEGREE))[index]
    return 0.0 if abs(rates[0]) <= RATE_NOISE * np.abs(rates).max() else float(rates[0])
