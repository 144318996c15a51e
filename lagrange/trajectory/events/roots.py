"""Where an event function, a polynomial on each step, passes through zero: each root once, in order, with direction."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

EPSILON = 2.0**-52

ROUND_OFF = 8 * EPSILON
"""Times sum |c[k] h**k|: the least noise. The worst that was met, to degree 40 and 30 halvings deep, is 2.6 EPSILON."""

MODEST = 40
"""Powers up to this one of a step between 1e-6 and 1e6 are computed as they are."""

DEEPEST = 50
"""Halvings of the step, at most: what is narrower is a single place."""

_DECIDED = frozenset(
    ((0,), (1,), (-1,), (0, 1), (0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1), (1, 0, -1), (-1, 0, 1)),
)
"""Signs of Bernstein coefficients, repetitions left out, that leave at most one passage through zero."""


@dataclass(frozen=True)
class Root:
    """A place where the event function passes through zero, or touches it.

    `time` is counted from the start of the step, in the units of h and between 0 and h. `rising` is 1 where the
    function goes from negative to positive in the direction of the integration, -1 where it falls, and 0 where it
    reaches zero and turns back.
    """

    time: float
    rising: int


@dataclass(frozen=True)
class Side:
    """On which side of zero an event function stands between two steps, which is all that a step leaves to the next.

    `sign` is the last sign, 1 or -1, that was beyond doubt, and 0 as long as there was none: at the start of a run,
    and of a new motion after an impact. `near` says that since then the function has come to zero within its noise,
    and that it is for the next step to tell whether it passes or turns back.
    """

    sign: int = 0
    near: bool = False

    @property
    def settled(self) -> bool:
        """Whether a step on which the function cannot vanish has nothing to add."""
        return self.sign != 0 and not self.near


def may_vanish(coefficients: FloatArray, h: float, *, noise: float = 0.0) -> bool:
    """Return False if sum c[k] tau**k is certain to keep the sign of c[0] from tau = 0 to h; takes 1 or 2 microseconds.

    The arguments are those of `roots`, which need not be called for such a step if the side before it is settled: the
    step has no root then, and the side stays. Coefficients that are not finite may vanish.
    """
    first, *rest = coefficients.tolist()
    length = abs(h)
    others = 0.0
    for c in reversed(rest):
        others = (others + abs(c)) * length
    # The margins stand for the round-off and the underflow of this sum, and for the least noise of `roots`.
    return not math.inf > abs(first) > 1.001 * (others + noise) + 1e-300


def roots(
    coefficients: FloatArray, h: float, before: Side | None = None, *, noise: float = 0.0, last: bool = False
) -> tuple[list[Root], Side]:
    """Return the roots of g(tau) = sum c[k] tau**k on a step, as the integration meets them, and the side at its end.

    `coefficients` (m,), from the constant up, and `h`, the length of the step, negative for a run backwards.
    `before` is the side that the step before returned; without it g starts here, and a root at the start is no event.
    `noise`, in the units of g, is by how much g may be wrong besides the round-off of the given coefficients, which is
    taken to be 8 * 2**-52 sum |c[k] h**k|. The two steps that meet at a joint must agree on g there within their noise.
    `last` says that no step follows: a root at the very end is then decided here, by the slope.

    The contract is that of a relay. A sign counts once it is beyond the noise, a crossing is reported by the step in
    which the opposite sign first counts, and a touch by the step in which g, having come within its noise of zero,
    counts again with the sign it had. So crossings alternate over a whole run, a root at a joint is reported once
    whatever the round-off on its two sides (by the later step, at time 0), and g that stays clear of zero by more than
    its noise has no root. Roots so close that g stays within its noise between them are one: two of them a touch,
    three a crossing. Measured on h = 1: two roots by themselves merge when closer than 1e-7 to 2e-7, three at
    spacings below 2e-5 to 5e-5; of roots strewn over the whole step, double coefficients keep up to 8 apart, 12 in
    six cases of ten, and never 16. A simple root is refined to the round-off of g divided by its slope.

    Descartes' rule counts the roots by the signs of the Bernstein coefficients; a part of the step where they may
    stand for more than one is halved, at most 50 times (Lane and Riesenfeld, BIT 21, 1981). Raises ValueError for
    coefficients, noise or a length that are not finite, and for no coefficients.
    """
    c, doubt = _scaled(coefficients, h, noise)
    before = Side() if before is None else before
    values = c.tolist()
    signs = _signs(c, doubt)
    _, start = next(signs)
    sign, low = before.sign, 0.0
    leaving = len(values) < 2 or sign * values[1] >= 0
    # Without `near`, what leaves zero at a joint was counted by the step before, and what comes to it is new.
    # With it, a start that counts and leaves is a touch at the joint, and one still on its way there is not yet.
    fresh = before.near or not leaving if start == 0 else before.near and leaving
    near = [0.0] if fresh else []
    counted = start == 0 and not fresh
    found: list[Root] = []
    for place, now in _from(start, signs):
        if now == 0:
            near += [] if counted else [place]
            continue
        if now == -sign:
            found.append(Root(h * _crossing(values, low, place, now), now))
        elif now == sign and near:
            found.append(Root(h * _turn(values, low, near, place, sign, doubt), 0))
        sign, low, near, counted = now, place, [], False
    if last and sign and near:
        found.append(_at_the_end(values, h, low, near, sign, doubt))
    return found, Side(sign, bool(sign and near))


def _from(start: int, rest: Iterator[tuple[float, int]]) -> Iterator[tuple[float, int]]:
    if start:
        yield 0.0, start
    yield from rest


def _at_the_end(c: list[float], h: float, low: float, near: list[float], sign: int, doubt: float) -> Root:
    """Return the root that the end of the run leaves open: a crossing if g is still on its way to zero."""
    if sign * _value(_derivative(c), 1.0) < 0:
        return Root(h, -sign)
    return Root(h * _turn(c, low, near, 1.0, sign, doubt), 0)


def _scaled(coefficients: FloatArray, h: float, noise: float) -> tuple[FloatArray, float]:
    """Return c[k] h**k and the noise of their sum, both over a power of two that keeps them from overflow."""
    plain = _plain(np.asarray(coefficients, dtype=float).tolist(), h, noise)
    if plain is not None:
        return plain
    given = np.append(np.asarray(coefficients, dtype=float), noise)
    if len(given) < 2 or not np.isfinite(given).all() or not math.isfinite(h):
        raise ValueError(
            "the event function has no coefficients, or they, its noise or the length of the step are not finite"
        )
    powers = _powers(len(given))
    fraction, exponent = math.frexp(h)
    mantissas, exponents = np.frexp(given)
    mantissas = mantissas * fraction**powers
    exponents = exponents + exponent * powers.astype(np.int32)
    top = exponents[mantissas != 0].max(initial=-(2**20))
    scaled = np.ldexp(mantissas, exponents - top)
    c = scaled[:-1]
    return c, float(scaled[-1] + ROUND_OFF * np.abs(c).sum())


def _plain(coefficients: list[float], h: float, noise: float) -> tuple[FloatArray, float] | None:
    """Return the same without the power of two where nothing comes near the ends of the range of doubles."""
    if not 1e-6 < abs(h) < 1e6 or len(coefficients) > MODEST:
        return None
    terms = [c * h**k for k, c in enumerate(coefficients)]
    total = sum(map(abs, terms))
    if not 1e-100 < total < 1e100 or not 0 <= noise < 1e100:
        return None
    return np.array(terms), noise + ROUND_OFF * total


@lru_cache(maxsize=64)
def _powers(count: int) -> FloatArray:
    """Return the powers of h that belong to count - 1 coefficients and the noise."""
    return np.append(np.arange(count - 1.0), 0.0)


@lru_cache(maxsize=64)
def _to_bernstein(m: int) -> FloatArray:
    """Return the matrix (m, m) from coefficients of s**k to Bernstein coefficients on [0, 1]."""
    n = m - 1
    return np.array([[math.comb(j, k) / math.comb(n, k) for k in range(m)] for j in range(m)])


@lru_cache(maxsize=64)
def _halving(m: int) -> FloatArray:
    """Return the matrix (2 m, m) to the Bernstein coefficients of the left half and then of the right half."""
    left = np.array([[math.comb(j, k) / 2**j for k in range(m)] for j in range(m)])
    return np.concatenate((left, left[::-1, ::-1]))


def _signs(c: FloatArray, doubt: float) -> Iterator[tuple[float, int]]:
    """Yield places in [0, 1], from 0 up, and the sign of sum c[k] s**k there, 0 for a size up to `doubt`.

    Between neighbours there is one passage through zero if their signs are opposite, and none if they are equal.
    """
    m = len(c)
    halving = _halving(m)
    parts: list[tuple[float, int, FloatArray]] = [(0.0, 0, _to_bernstein(m) @ c)]
    sign = _sign(float(c[0]), doubt)
    yield 0.0, sign
    while parts:
        start, depth, bernstein = parts.pop()
        width = 0.5**depth
        coefficients = bernstein.tolist()
        pattern = _pattern(sign, coefficients, doubt)
        decided = pattern in _DECIDED
        # At the edge of its noise a function would be halved everywhere, for its round-off: hence the factor 2.
        if decided or depth == DEEPEST or max(map(abs, coefficients)) <= 2 * doubt:
            if not decided:
                yield start + width / 2, 0
            sign = pattern[-1]
            yield start + width, sign
        else:
            halves = halving @ bernstein
            parts.append((start + width / 2, depth + 1, halves[m:]))
            parts.append((start, depth + 1, halves[:m]))


def _sign(value: float, doubt: float) -> int:
    return (value > doubt) - (value < -doubt)


def _pattern(first: int, values: list[float], doubt: float) -> tuple[int, ...]:
    """Return the signs of the values in their order, without repetitions.

    `first` is that of the first value, as it was decided for the neighbour: round-off must not decide it twice.
    """
    signs = [first]
    previous = first
    for value in values[1:]:
        sign = 1 if value > doubt else -1 if value < -doubt else 0
        if sign != previous:
            signs.append(sign)
            previous = sign
    return tuple(signs)


def _value(c: list[float], s: float) -> float:
    value = 0.0
    for coefficient in reversed(c):
        value = value * s + coefficient
    return value


def _derivative(c: list[float]) -> list[float]:
    return [k * coefficient for k, coefficient in enumerate(c)][1:]


def _crossing(c: list[float], low: float, high: float, sign: int) -> float:
    """Return where sum c[k] s**k takes on `sign` between low and high, or the end that is nearer to doing so.

    Newton's method, and bisection where it would leave the bracket or does not halve its steps.
    """
    below, above = sign * _value(c, low), sign * _value(c, high)
    if below >= 0:
        return low
    if above <= 0:
        return high
    s = low + (high - low) * (below / (below - above))
    step = high - low
    slopes = _derivative(c)
    while low < s < high:
        value = sign * _value(c, s)
        if value == 0:
            return s
        low, high = (s, high) if value < 0 else (low, s)
        slope = sign * _value(slopes, s)
        if slope > 0 and 2 * abs(value) < abs(step) * slope and low <= s - value / slope <= high:
            step = value / slope
        else:
            step = s - (low + high) / 2
        if abs(step) <= EPSILON * s:
            return s - step
        s -= step
    return s


def _turn(c: list[float], low: float, near: list[float], high: float, sign: int, doubt: float) -> float:
    """Return where sign * sum c[k] s**k is least, close to one of the places `near` between low and high."""
    depths = [sign * _value(c, s) for s in near]
    depth = min(depths)
    place = near[depths.index(depth)]
    slopes = _derivative(c)
    ends = (place, high) if sign * _value(slopes, place) < 0 else (low, place)
    turn = _crossing(slopes, *ends, sign)
    return turn if sign * _value(c, turn) <= depth + doubt else place
