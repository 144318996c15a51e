"""L D L^T of a small symmetric matrix written out, over any number of lanes, skipping what is identically zero."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.spelling import element, flag_type, number
from lagrange.procedure.linear.ldl import PIVOT

Entries = dict[tuple[int, int], str]
"""Values of a lower triangle by (row, column); what is missing is zero."""


def factor(e: Emitter, lanes: int, n: int, a: Entries, negative: int = 0) -> list[str]:
    """Return L by rows with 1/d on its diagonal, then whether every pivot can be trusted.

    The last `negative` pivots are negative. A pivot is compared with its diagonal entry, or, for a multiplier, which
    has none, with what is subtracted: G M^-1 G^T of the constraint.
    """
    kind, zero = element(lanes), number(0.0, lanes)
    lower: Entries = {}
    scaled: Entries = {}
    trusted = ""
    for j in range(n):
        for i in range(j, n):
            value = _reduced(e, kind, a.get((i, j)), [(scaled.get((i, k)), lower.get((j, k))) for k in range(j)])
            if value is not None:
                scaled[i, j] = value
        diagonal = scaled.get((j, j), zero)
        if j < n - negative:
            pivot, size = diagonal, e.fabs(a.get((j, j), zero), kind)
        else:
            pivot, size = e.value(f"fneg {kind} {diagonal}"), _size(e, kind, scaled, lower, j, lanes)
        least = e.value(f"fmul {kind} {size}, {number(PIVOT, lanes)}")
        good = e.value(f"fcmp ogt {kind} {pivot}, {least}")
        trusted = e.value(f"and {flag_type(lanes)} {trusted}, {good}") if trusted else good
        lower[j, j] = e.value(f"fdiv {kind} {number(1.0, lanes)}, {diagonal}")
        for i in range(j + 1, n):
            if (i, j) in scaled:
                lower[i, j] = e.value(f"fmul {kind} {scaled[i, j]}, {lower[j, j]}")
    return [*(lower.get((i, j), zero) for i in range(n) for j in range(i + 1)), trusted]


def _size(e: Emitter, kind: str, scaled: Entries, lower: Entries, j: int, lanes: int) -> str:
    """Return the sum of the sizes of what is subtracted from a diagonal entry."""
    total = number(0.0, lanes)
    for k in range(j):
        if (j, k) in scaled:
            product = e.value(f"fmul {kind} {scaled[j, k]}, {lower[j, k]}")
            total = e.value(f"fadd {kind} {total}, {e.fabs(product, kind)}")
    return total


def _reduced(e: Emitter, kind: str, value: str | None, products: list[tuple[str | None, str | None]]) -> str | None:
    """Return value - sum of products, None for zero."""
    for a, b in products:
        if a is not None and b is not None:
            minus = e.value(f"fneg {kind} {a}")
            value = e.value(f"fmul {kind} {minus}, {b}") if value is None else e.fma(minus, b, value, kind)
    return value


def solve(e: Emitter, lanes: int, rows: list[str], right: list[str]) -> list[str]:
    """Return the solution for factors as `factor` gives them, without their last entry."""
    kind, zero, n = element(lanes), number(0.0, lanes), len(right)

    def less(value: str, entry: str, other: str) -> str:
        return value if entry == zero else e.fma(e.value(f"fneg {kind} {entry}"), other, value, kind)

    x = list(right)
    for i in range(n):
        for k in range(i):
            x[i] = less(x[i], rows[i * (i + 1) // 2 + k], x[k])
    for i in reversed(range(n)):
        x[i] = e.value(f"fmul {kind} {x[i]}, {rows[i * (i + 3) // 2]}")
        for k in range(i + 1, n):
            x[i] = less(x[i], rows[k * (k + 1) // 2 + i], x[k])
    return x
