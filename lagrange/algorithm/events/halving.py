"""Bernstein coefficients of a polynomial: their signs bound how often it passes through zero; and those of halves."""

from __future__ import annotations

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Real, Whole


def sign_of(p: Builder, x: Real, doubt: Real) -> Whole:
    """Return 1, -1, or 0 for a size up to `doubt`."""
    found: Whole = p.choose(x > doubt, p.whole(1), p.choose(x < -doubt, p.whole(-1), p.whole(0)))
    return found


AT_ONCE = 4
"""Passes of a triangle of sums that are taken in one: each number is read and written once for all."""


@shared
def bernstein() -> Procedure:
    """Return the procedure that writes the Bernstein coefficients on [0, 1] of a polynomial.

    Those of s**k of degree n are the forward differences of the rank k over the binomial coefficient of n and k.
    """
    p = Builder("bernstein", "Write the Bernstein coefficients of a polynomial.", apart=True)
    c, count, b = p.array("c", read=True), p.given("count", WHOLE), p.array("b")
    weight = p.variable(1.0, "weight")
    with p.loop(0, count) as k:
        b[k] = c[k] * weight.value
        weight.value = weight.value * (p.real(k + 1) / p.real(count - 1 - k))
    rest = (count - 1 - (count - 1) // AT_ONCE * AT_ONCE).called("rest")
    with p.loop(0, rest) as done:
        _summed(p, b, done, count, 1)
    with p.loop(rest, count - 1, AT_ONCE) as done:
        _summed(p, b, done, count, AT_ONCE)
    p.leave()
    return p.finish()


def _summed(p: Builder, b: Memory, done: Whole, count: Whole, passes: int) -> None:
    """Add to each number the one before it, in a number of passes: each pass leaves out one more at the beginning."""
    before = [p.variable(b[done]) for _ in range(passes)]
    for behind in range(1, passes):
        total = b[done + behind]
        for one in before[:behind]:
            one.value, total = total, total + one.value
        for one in before[behind:]:
            one.value = total
        b[done + behind] = total
    with p.loop(done + passes, count) as place:
        total = b[place]
        for one in before:
            one.value, total = total, total + one.value
        b[place] = total


@shared
def signs() -> Procedure:
    """Return the procedure that tests whether coefficients allow at most one passage through zero.

    It also returns the sign of the last coefficient and the size of the largest. `first` is the sign of the first one,
    as decided for the interval before: round-off must not decide it twice.
    """
    p = Builder("signs", "Return whether signs change once at most, the last sign, and the largest size.")
    b, count = p.array("b", read=True), p.given("count", WHOLE)
    first, doubt = p.given("first", WHOLE), p.given("doubt", REAL)
    now, before, changes = p.variable(first, "now"), p.variable(first, "before"), p.variable(0, "changes")
    size = p.variable(abs(b[0]), "size")
    with p.loop(1, count) as j:
        x = b[j].called("x")
        sign = sign_of(p, x, doubt).called("sign")
        size.value = p.magnitude(size.value, x)
        with p.when(~sign.equals(now.value)):
            changes.value = changes.value + 1
            before.value = now.value
            now.value = sign
    # From one side through zero to the other is one passage; from zero and back to it is zero or two.
    through = changes.value.equals(2) & before.value.equals(0) & now.value.equals(-first)
    p.leave((changes.value < 2) | through, now.value, size.value)
    return p.finish(FLAG, WHOLE, REAL)


@shared
def halve() -> Procedure:
    """Return de Casteljau's algorithm: what turns coefficients on a part into those on its halves, right in place."""
    p = Builder("halve", "Turn Bernstein coefficients into those of the right half, and write the left.", apart=True)
    b, count, left = p.array("b"), p.given("count", WHOLE), p.array("left")
    with p.loop(1, count) as done:
        left[done - 1] = b[0]
        with p.loop(0, count - done) as j:
            b[j] = (b[j] + b[j + 1]) * 0.5
    left[count - 1] = b[0]
    p.leave()
    return p.finish()
