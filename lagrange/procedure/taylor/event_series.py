"""The series of a watched function: its round-off noise, how far it can be trusted, and its sign at the start."""

from __future__ import annotations

import math
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.events.constants import MOST_COEFFICIENTS, ROUND_OFF, SURELY
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.constants import BALANCE, DOUBT, EVENT_NOISE, RADIUS_FRACTION, ROW_DISTANCE
from lagrange.procedure.taylor.memory import BLOCK
from lagrange.procedure.taylor.watching import FUNCTION, Watched
from lagrange.procedure.values import Memory, Real

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
