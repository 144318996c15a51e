"""L D L^T of a small or sparse symmetric matrix written out, over any number of lanes; zeros are left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.spelling import element, flag_type, number
from lagrange.procedure.linear.ldl import RESIDUAL, least_pivot
from lagrange.program.elimination import Elimination

Entries = dict[tuple[int, int], str]
"""Values of a lower triangle by (row, column); what is missing is zero."""


def by_place(plan: Elimination, entries: Sequence[str]) -> Callable[[int, int], str]:
    """Return the entries of L, in the order of `places`, as a function of (i, j)."""
    table = dict(zip(plan.places, entries, strict=True))
    return lambda i, j: table[i, j]


def factor(e: Emitter, lanes: int, plan: Elimination, a: Entries) -> list[str]:
    """Return the entries of L by `places` of the plan, with 1/d on its diagonal, then whether every pivot is trusted.

    A pivot is compared with its diagonal entry, or, for a multiplier, which has none, with what is subtracted:
    G M^-1 G^T of the constraint.
    """
    kind, zero = element(lanes), number(0.0, lanes)
    lower: Entries = {}
    scaled: Entries = {}
    trusted = ""
    for j in range(plan.order):
        row = plan.rows[j]
        for i in (j, *plan.columns[j]):
            products = [(scaled[i, k], lower[j, k]) for k in row if (i, k) in scaled and (j, k) in lower]
            value = _reduced(e, kind, a.get((i, j)), products)
            if value is not None:
                scaled[i, j] = value
        diagonal = scaled.get((j, j), zero)
        if j in plan.negative:
            terms = [(scaled[j, k], lower[j, k]) for k in row if (j, k) in scaled]
            pivot, size = e.value(f"fneg {kind} {diagonal}"), _size(e, kind, terms, lanes)
        else:
            pivot, size = diagonal, e.fabs(a.get((j, j), zero), kind)
        least = e.value(f"fmul {kind} {size}, {number(least_pivot(plan.negative), lanes)}")
        good = e.value(f"fcmp ogt {kind} {pivot}, {least}")
        trusted = e.value(f"and {flag_type(lanes)} {trusted}, {good}") if trusted else good
        lower[j, j] = e.value(f"fdiv {kind} {number(1.0, lanes)}, {diagonal}")
        for i in plan.columns[j]:
            if (i, j) in scaled:
                lower[i, j] = e.value(f"fmul {kind} {scaled[i, j]}, {lower[j, j]}")
    return [*(lower.get(place, zero) for place in plan.places), trusted]


def _size(e: Emitter, kind: str, products: list[tuple[str, str]], lanes: int) -> str:
    """Return the sum of the sizes of what is subtracted from a diagonal entry."""
    total = number(0.0, lanes)
    for a, b in products:
        product = e.value(f"fmul {kind} {a}, {b}")
        total = e.value(f"fadd {kind} {total}, {e.fabs(product, kind)}")
    return total


def _reduced(e: Emitter, kind: str, value: str | None, products: list[tuple[str, str]]) -> str | None:
    """Return value - sum of products, None for zero."""
    for a, b in products:
        minus = e.value(f"fneg {kind} {a}")
        value = e.value(f"fmul {kind} {minus}, {b}") if value is None else e.fma(minus, b, value, kind)
    return value


def solve(
    e: Emitter, lanes: int, plan: Elimination, lower: Callable[[int, int], str], right: Sequence[str]
) -> list[str]:
    """Return the solution with an L whose entries (i, j) a function gives, on its diagonal 1/d."""
    kind, zero = element(lanes), number(0.0, lanes)

    def less(value: str, entry: str, other: str) -> str:
        return value if zero in (entry, other) else e.fma(e.value(f"fneg {kind} {entry}"), other, value, kind)

    x = list(right)
    for i, row in enumerate(plan.rows):
        for k in row:
            x[i] = less(x[i], lower(i, k), x[k])
    for i in reversed(range(plan.order)):
        x[i] = x[i] if x[i] == zero else e.value(f"fmul {kind} {x[i]}, {lower(i, i)}")
        for k in plan.columns[i]:
            x[i] = less(x[i], lower(k, i), x[k])
    return x


def satisfied(
    e: Emitter, lanes: int, plan: Elimination, a: Entries, x: Sequence[str], right: Sequence[str]
) -> list[str]:
    """Return whether a solution satisfies the rows of the multipliers, one flag for each row.

    With inertias that differ by many digits pivots are large and the solution is still wrong: what is light gets the
    difference of two forces that nearly cancel. Its accelerations then violate the constraints.
    """
    kind, found = element(lanes), []
    for i in plan.negative:
        row = [(a[max(i, j), min(i, j)], x[j]) for j in range(plan.order) if (max(i, j), min(i, j)) in a]
        left, size = right[i], e.fabs(right[i], kind)
        for entry, value in row:
            product = e.value(f"fmul {kind} {entry}, {value}")
            left = e.value(f"fsub {kind} {left}, {product}")
            size = e.value(f"fadd {kind} {size}, {e.fabs(product, kind)}")
        most = e.value(f"fmul {kind} {size}, {number(RESIDUAL, lanes)}")
        found.append(e.value(f"fcmp ole {kind} {e.fabs(left, kind)}, {most}"))
    return found
