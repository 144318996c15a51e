"""Exclude watched functions without a zero on a step: their coefficients show that they keep their signs."""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, PARTIAL, REAL, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.memory import BLOCK, SeriesMemory, TaylorLayout, work_array
from lagrange.procedure.values import Real, Whole

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
