"""The series of a watched function on a Taylor step: its round-off noise, its range of trust, and its sign.

Three tests use it. The coefficients may show that the function keeps its sign, so that it is excluded. The sums of its
terms usually decide that it has one zero, or none. And the sign at the end of a step must agree with the series: a
function that saturates, such as erf(x), looks constant where it is flat, and its series does not show a slope further
ahead. The next series begins with the exact value, which reveals the error.
"""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.events.constants import JUMP, MOST_COEFFICIENTS, ROUND_OFF, SURELY
from lagrange.algorithm.events.halving import sign_of
from lagrange.algorithm.events.polynomial import approach, inverse_cubic, pad
from lagrange.algorithm.events.scaling import is_plain, is_plain_step
from lagrange.algorithm.taylor.constants import BALANCE, DOUBT, EVENT_NOISE, EVENT_SLACK, RADIUS_FRACTION, ROW_DISTANCE
from lagrange.algorithm.taylor.memory import BLOCK, SeriesMemory, TaylorLayout, work_array
from lagrange.algorithm.taylor.watching import FUNCTION, NEAR, SIDES, SIGN, SMOOTH, STARTING, TERM_SUMS, Watched
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, PARTIAL, REAL, WHOLE, Array, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real, Whole

READ = Array(read=True)


@shared
def event_noise() -> Procedure:
    """Return the procedure that estimates the noise of watched functions from rounding of the state.

    The state here and at the end of the last step may be rounded. The time and the `size` entries of the state are
    perturbed by about the square root of round-off, each by another factor: with equal factors the difference of two
    equal entries would seem exact.
    """
    p = Builder("event_noise", "Write how wrong what is watched may be; `values` is what it is.", apart=True)
    function = p.function("function", FUNCTION)
    numbers, tilts = p.array("numbers", read=True), p.array("tilts", read=True)
    t, size, count = p.given("t", REAL), p.given("size", WHOLE), p.given("count", WHOLE)
    y, values = p.array("y", read=True), p.array("values", read=True)
    noise, moved = p.array("noise", room=BLOCK), p.array("moved", room=BLOCK)
    with p.loop(0, size) as i:
        moved[i] = y[i] * tilts[i]
    function(t * tilts[size], moved, numbers, noise)
    with p.loop(0, count) as i:
        found = abs(noise[i] - values[i]) * EVENT_NOISE
        noise[i] = p.choose(found < math.inf, found, 0.0)
    return p.finish()


def write_noise(watched: Watched, numbers: Memory, t: Real, state: Memory) -> None:
    """Write the noise of watched functions to the scratch memory, from their values there."""
    kept, layout = watched.kept, watched.layout
    function, sizes = (watched.values, numbers, watched.tilts), (layout.dimension, layout.watched)
    watched.p.call(event_noise(), *function, t, *sizes, state, kept.reals("values"), kept.reals("noise"), kept.moved)


@shared
def reach() -> Procedure:
    """Return the part of a step that a series covers within its accuracy or noise: s if the series terminates.

    The truncation error of an expression's series may exceed that of the state: it is a sum of products.
    """
    p = Builder("reach", "Return how far a series can be trusted.", apart=True)
    c, count = p.array("c", read=True), p.given("count", WHOLE)
    s, tolerance, noise = (p.given(name, REAL) for name in ("s", "tolerance", "noise"))
    far, ratio = p.variable(s, "far"), p.variable(math.inf, "ratio")
    tries = p.variable(0, "tries")
    share = -1.0 / p.real(count - 1)
    with p.when(c[count - 1].equals(0.0) & c[count - 2].equals(0.0)):
        p.leave(s)
    with p.repeat(lambda: (ratio.value > 1.0) & (tries.value < 60)):
        tries.value = tries.value + 1
        early, late = p.variable(0.0), p.variable(0.0)
        power: Any = p.variable(1.0)
        with p.loop(0, count) as k:
            term = abs(c[k]) * power.value
            early.value = p.choose(k <= (count - 1) // 2, p.larger(early.value, term), early.value)
            late.value = p.choose(k >= count - 2, p.larger(late.value, term), late.value)
            power.value = power.value * far.value
        found = late.value / p.fma(tolerance, early.value, noise)
        ratio.value = p.choose(found >= 0.0, found, math.inf)
        with p.when(ratio.value > 1.0):
            shorter = p.real(ratio.value) ** share
            far.value = far.value * p.smaller(p.larger(shorter, 0.05), 0.9)
    p.leave(far.value)
    return p.finish(REAL)


@shared
def safe_step() -> Procedure:
    """Return the longest safe step: within the radius of convergence that the last coefficients of a series show."""
    p = Builder("safe_step", "Return how far a series goes that may hide what it grows to.", apart=True)
    c, count = p.array("c", read=True), p.given("count", WHOLE)
    radius: Any = p.variable(0.0)
    for less in (2, 1):
        late = count - less
        early = p.larger(late - ROW_DISTANCE, 1)
        sizes = abs(c[early]), abs(c[late])
        known = (sizes[0] > 0.0) & (sizes[1] > 0.0)
        shown = (sizes[0] / sizes[1]) ** (1.0 / p.real(late - early))
        radius.value = p.larger(radius.value, p.choose(known, shown, math.inf))
    p.leave(radius.value * 2.0**RADIUS_FRACTION)
    return p.finish(REAL)


@shared
def is_balanced() -> Procedure:
    """Return whether the high powers of a series on a step are small enough for the low ones; see `BALANCE`."""
    p = Builder("is_balanced", "Whether high powers do not drown low ones in round-off.", apart=True)
    c, count, s = p.array("c", read=True), p.given("count", WHOLE), p.given("s", REAL)
    low = p.larger(abs(c[0]), abs(c[1]) * s)
    high, power = p.variable(0.0), p.variable(s * s)
    with p.loop(2, count) as k:
        high.value = p.larger(high.value, abs(c[k]) * power.value)
        power.value = power.value * s
    p.leave(~((low > 0.0) & (high.value > BALANCE * low)))
    return p.finish(FLAG)


@shared
def keeps_sign() -> Procedure:
    """Return whether a series surely keeps its sign on a step: its linear part outweighs the rest at both ends.

    Between the ends the linear part lies between its values there.
    """
    p = Builder("keeps_sign", "Whether a series surely keeps a sign on a step.", apart=True)
    c, count, s, noise, sign = p.array("c", read=True), p.given("count", WHOLE), *_reals(p, "s", "noise", "sign")
    rest, power = p.variable(0.0), p.variable(s * s)
    with p.loop(2, count) as k:
        rest.value = rest.value + abs(c[k]) * power.value
        power.value = power.value * s
    start, end = sign * c[0], sign * p.fma(c[1], s, c[0])
    sizes = (abs(c[0]) + abs(c[1]) * s) + rest.value
    least = p.fma(ROUND_OFF, sizes, rest.value + noise) * SURELY
    p.leave((start > least) & (end > least))
    return p.finish(FLAG)


def _reals(p: Builder, *names: str) -> list[Any]:
    return [p.given(name, REAL) for name in names]


@shared
def largest_term() -> Procedure:
    """Return the largest |c[k]| s**k."""
    p = Builder("largest_term", "Return the largest term of a series on a step.", apart=True)
    c, count, s = p.array("c", read=True), p.given("count", WHOLE), p.given("s", REAL)
    most, power = p.variable(0.0), p.variable(1.0)
    with p.loop(0, count) as k:
        most.value = p.larger(most.value, abs(c[k]) * power.value)
        power.value = power.value * s
    p.leave(most.value)
    return p.finish(REAL)


@shared
def start_of_series() -> Procedure:
    """Return the sign and order with which a watched function leaves its value at a start.

    The order is 0 if the function is not zero at its start, beyond its `margin` and the round-off of its terms over a
    comparable time. Otherwise it is the order of the first term that decides, and the sign is that of this term. The
    order is -1 if no term decides.
    """
    p = Builder("start_of_series", "Return the sign with which a series begins, and the order that tells.", apart=True)
    c, count = p.array("c", read=True), p.given("count", WHOLE)
    unit, tolerance, noise, margin = (p.given(name, REAL) for name in ("unit", "tolerance", "noise", "margin"))
    far: Real = p.call(reach(), c, count, unit, tolerance, noise)
    near = p.reserve(MOST_COEFFICIENTS, name="near")
    total, power = p.variable(0.0), p.variable(1.0)
    with p.loop(0, count) as k:
        near[k] = c[k] * power.value
        total.value = total.value + p.choose(k.equals(0), 0.0, abs(near[k]))
        power.value = power.value * far
    doubt = p.choose(total.value < math.inf, DOUBT * total.value, 0.0)
    with p.when(~(abs(near[0]) <= margin + doubt)):
        p.leave(_sign(p, near[0]), 0)
    with p.loop(1, count) as k, p.when(abs(near[k]) > DOUBT * total.value):
        p.leave(_sign(p, near[k]), k)
    p.leave(0, -1)
    return p.finish(WHOLE, WHOLE)


def _sign(p: Builder, value: Real) -> Any:
    return p.whole(value > 0.0) - p.whole(value < 0.0)


def comparable_unit(p: Builder, t: Real, scale: Real) -> Real:
    """Return the time, in units of the scale, at which a velocity is compared with an acceleration.

    The scale of a polynomial motion has no meaning. Motions that take less than some spacings of floating-point times
    cannot be resolved in any case.
    """
    part = p.larger(p.smaller(abs(t / scale) * (1.0 / 64), 1.0), 2.0**-40)
    found: Real = p.choose(t.equals(0.0), 1.0, part)
    return found


REST, RATES, END, SLOPE, LATE = range(len(TERM_SUMS))

LEAST_COUNT = 3
"""Least number of coefficients of a series; shorter ones are padded with zeros."""


class _Chain:
    """Sums of every other term from an order on. Two such chains hide the latency of additions."""

    def __init__(self, p: Builder, k: int, power: Real, square: Real, end: Any, slope: Any) -> None:
        self.p, self.square, self.first = p, square, k
        self.number, self.power, self.end = p.variable(float(k)), p.variable(power), p.variable(end)
        self.rest, self.rates, self.slope = p.variable(0.0), p.variable(0.0), p.variable(slope)

    def add(self, coefficient: Real) -> tuple[Real, Real]:
        """Add the next term; return the term, and the term times its order."""
        term: Real = coefficient * self.power.value
        rate: Real = self.number.value * term
        self.rest.value = self.rest.value + abs(term)
        self.rates.value = self.rates.value + abs(rate)
        self.end.value, self.slope.value = self.end.value + term, self.slope.value + rate
        self.power.value = self.power.value * self.square
        self.number.value = self.number.value + 2.0
        return term, rate


@shared
def event_terms() -> Procedure:
    """Return the procedure that writes the terms x[k] s**k of a watched function, k times each, and `TERM_SUMS`.

    The coefficients are read from rows that are `width` apart.
    """
    p = Builder("event_terms", "Write the terms of something that is watched on a step, and their sums.")
    rows, width, order = p.array("rows", read=True), p.given("width", WHOLE), p.given("order", WHOLE)
    s = p.given("s", REAL)
    c, slopes, sums = p.array("c"), p.array("slopes"), p.array("sums")
    start, slope, square, pairs = rows[0], rows[width] * s, s * s, (order - 1) // 2
    c[0], c[1], slopes[0] = start, slope, slope
    even, odd = _Chain(p, 2, square, square, start, 0.0), _Chain(p, 3, square * s, square, slope, slope)
    with p.loop(0, pairs) as j:
        for chain in (even, odd):
            k = j * 2 + chain.first
            c[k], slopes[k - 1] = chain.add(rows[k * width])
    with p.loop(pairs * 2 + 2, order + 1) as k:
        c[k], slopes[k - 1] = even.add(rows[k * width])
    pad(p, c, order + 1, order + 1)
    pad(p, slopes, order, order + 1)
    late = p.magnitude(c[order - 1], c[order])
    totals = (getattr(even, name).value + getattr(odd, name).value for name in ("rest", "rates", "end", "slope"))
    for place, value in enumerate((*totals, late)):
        sums[place] = value
    return p.finish()


@shared
def only_zero() -> Procedure:
    """Return the procedure that decides from the sums of terms whether a watched function has a zero on the step.

    The result is 0 if the function surely keeps its sign, and 1 or -1 if it surely changes to this sign, once. It is 2
    if that is undecided: the slope may change its sign, or a value at an end is within its noise.
    """
    p = Builder("only_zero", "Return the sign that a series takes on, once, on a step; 0 for none, 2 if unknown.")
    s, order, sign = p.given("s", REAL), p.given("order", WHOLE), p.given("sign", WHOLE)
    noise, terms, sums = p.given("noise", REAL), p.array("terms", read=True), p.array("sums", read=True)
    start, slope, rest, rates, end = terms[0], terms[1], sums[REST], sums[RATES], sums[END]
    rate, side = abs(slope), p.real(sign)
    total = abs(start) + rate + rest
    # The linear part outweighs the rest at both ends, and is between its end values in the middle.
    least = p.fma(ROUND_OFF, total, rest + noise) * SURELY
    clear = (side * start > least) & (side * (start + slope) > least)
    p.leave_if(clear, 0)
    doubt = noise + ROUND_OFF * total
    monotonic = 2.0 * rate > SURELY * (rate + rates)
    plain = is_plain_step(s, order + 1) & is_plain(total, noise)
    there = sign_of(p, end, doubt)
    decided = plain & monotonic & ~sign.equals(0) & sign_of(p, start, doubt).equals(sign) & ~there.equals(0)
    p.leave(p.choose(decided, p.choose(there.equals(sign), p.whole(0), there), p.whole(2)))
    return p.finish(WHOLE)


@shared
def only_passage() -> Procedure:
    """Return the procedure that finds the zero in 0 to 1 of a polynomial that changes to a sign exactly once."""
    p = Builder("only_passage", "Return where terms add up to a sign for the only time between 0 and 1.")
    c, slopes, sums = (p.array(name, read=True) for name in ("terms", "slopes", "sums"))
    order, sign = p.given("order", WHOLE), p.given("sign", WHOLE)
    count, side = p.variable(order + 1, "count"), p.real(sign)
    with p.repeat(lambda: (count.value > LEAST_COUNT) & c[count.value - 1].equals(0.0)):
        count.value = count.value - 1
    ends = p.constant(0.0, REAL), p.constant(1.0, REAL)
    values, rates = (side * c[0], side * sums[END]), (side * slopes[0], side * sums[SLOPE])
    start = inverse_cubic(p, ends, values, rates)
    p.leave(p.call(approach(), c, slopes, count.value, *ends, start, sign))
    return p.finish(REAL)


@shared
def read_column() -> Procedure:
    """Return the procedure that copies the series of a watched function from rows, `width` apart, on first use.

    `counts` has the number of its coefficients up to the last nonzero one, or 0 before the copy. The result is whether
    the series is finite.
    """
    p = Builder("read_column", "Copy a series from the rows, once; return whether it is finite.", apart=True)
    rows, width, order = p.array("rows", read=True), p.given("width", WHOLE), p.given("order", WHOLE)
    c, counts = p.array("c"), p.array("counts", WHOLE)
    p.leave_if(~counts[0].equals(0), p.true)
    total, used = p.variable(0.0), p.variable(order + 1, "used")
    with p.loop(0, order + 1) as k:
        value = rows[k * width]
        c[k] = value
        total.value = total.value + value * 0.0
    with p.repeat(lambda: (used.value > LEAST_COUNT) & c[used.value - 1].equals(0.0)):
        used.value = used.value - 1
    counts[0] = used.value
    p.leave(total.value.equals(0.0))
    return p.finish(FLAG)


CHAINS = 4
"""Number of independent partial sums of coefficients, to hide the latency of additions."""

LOWEST = 2
"""Lowest order beyond the linear part."""


@shared
def doubtful_events(layout: TaylorLayout) -> Procedure:
    """Return the procedure that writes 1 for each watched function that may vanish on a step of length s, else 0.

    It returns whether any may. With `all`, all are written as doubtful. A function keeps its sign if its linear part
    outweighs the rest at both ends of the step, and has the same sign at both.
    both ends of the step, and has one sign there.
    """
    p = Builder("doubtful_events", "Find what may vanish on a step, and return whether anything may.")
    s, everything = p.given("s", REAL), p.given("all", FLAG)
    doubtful = p.array("doubtful", room=BLOCK)
    run = SeriesMemory(p, layout, work_array(p))
    width = 1 if layout.watched == 1 else PARTIAL
    with p.each(layout.watched, width=width, unrolled=True) as i:
        start: Real = _row(run, 0)[i]
        end: Real = p.fma(_row(run, 1)[i], s, start)
        outweighs = p.smaller(abs(start), abs(end)) > _rest(run, s, i)
        doubt = p.choose(outweighs & (start * end > 0.0), 0.0, 1.0)
        doubt = p.choose(everything, 1.0, doubt)
        doubtful[i] = doubt
        number = p.sum(doubt)
    p.leave(number.value > 0.0)
    return p.finish(FLAG)


def _row(run: SeriesMemory, k: Any) -> Any:
    """Return the coefficients of an order, of all watched functions."""
    return run.row(k).at(run.layout.watched_at)


def _rest(run: SeriesMemory, s: Real, i: Whole) -> Real:
    """Return the sum of |x[k]| s**k over k from `LOWEST` on."""
    p = run.p
    count = run.order - (LOWEST - 1)
    blocks = count // CHAINS
    beyond, square = count - blocks * CHAINS, s * s
    fourth = square * square
    top = p.variable(0.0)
    with p.loop(0, beyond) as j:
        top.value = p.fma(top.value, s, abs(_row(run, run.order - j)[i]))
    chains = [top, *(p.variable(0.0) for _ in range(CHAINS - 1))]
    with p.loop(0, blocks) as j:
        first = (blocks - 1 - j) * CHAINS + LOWEST
        for place, chain in enumerate(chains):
            chain.value = p.fma(chain.value, fourth, abs(_row(run, first + place)[i]))
    low, high = (p.fma(s, chains[k + 1].value, chains[k].value) for k in (0, 2))
    found: Real = square * p.fma(square, high, low)
    return found


@shared
def contradicts(layout: TaylorLayout) -> Procedure:
    """Return the procedure that tests whether the present series and that of the last step disagree on a side.

    Functions that may jump are excluded: their sign may change without a zero.
    """
    return _Contradiction(layout).build()


class _Contradiction:
    """Builds the procedure."""

    def __init__(self, layout: TaylorLayout) -> None:
        self.p = p = Builder("contradicts", "Whether the signs of what is watched are not those that series gave.")
        self.layout = layout
        self.t, self.rtol, self.length = (p.given(name, REAL) for name in ("t", "rtol", "length"))
        self.watched = Watched(p, layout)
        self.memory = SeriesMemory(p, layout, work_array(p))

    def build(self) -> Procedure:
        p, watched = self.p, self.watched
        doubt = p.variable(p.false, "doubt")
        with p.loop(0, self.layout.watched) as i:
            doubt.value = doubt.value | self.is_other(i)
        p.leave_if(~doubt.value, p.false, likely=True)
        values = watched.kept.reals("values")
        with p.loop(0, self.layout.watched) as i:
            values[i] = self.row(0, i)
        write_noise(watched, watched.own_numbers, self.t, self.memory.work)
        noise, found = watched.kept.reals("noise"), p.variable(p.false, "found")
        # The error of the state is its rounding times the ratio of tolerance to round-off.
        slack = EVENT_SLACK * p.fma(self.rtol, 2.0**50, 1.0)
        with p.loop(0, self.layout.watched) as i:
            found.value = found.value | (self.is_other(i) & (abs(values[i]) > slack * noise[i]))
        p.leave(found.value)
        return p.finish(FLAG)

    def row(self, order: int, i: Whole) -> Real:
        """Return a coefficient of a watched function."""
        found: Real = self.memory.row(order).at(self.layout.watched_at)[i]
        return found

    def is_other(self, i: Whole) -> Flag:
        """Return whether a function that cannot jump is on the other side, further than its slope explains."""
        p, watched, value = self.p, self.watched, self.row(0, i)
        before = watched.sides.at(self.layout.watched * (SIDES + STARTING))
        settled = watched.side(NEAR)[i].equals(0) & ~watched.setting(SMOOTH, i).equals(0) & before[i].equals(0)
        other = p.real(watched.side(SIGN)[i]) * value < 0.0
        far = abs(value) > JUMP * abs(self.row(1, i)) * self.length
        found: Flag = settled & other & far
        return found
