"""The effect of rounding on the unknowns of a solve: the unit in which corrections of equal steps are measured."""

from __future__ import annotations

from lagrange.algorithm.newton.constants import LEAST_ROUND_OFF, UNIT_ROUND_OFF
from lagrange.algorithm.step.memory import SolveLayout
from lagrange.algorithm.step.vectors import Vectors
from lagrange.procedure.values import Memory
from lagrange.program.actions import LAWS, LawCall


def weigh_by_rounding(vectors: Vectors, solve: SolveLayout, point: LawCall, shares: Memory) -> None:
    """Set the weights of corrections: the effect of rounding a residual and the arguments of its calls on the unknowns.

    The sizes of the terms of a residual, and J times those of the arguments, are an error of one unit of round-off. The
    inverse maps it to the unknowns. In any units, no iteration can reach a smaller error.
    """
    p, work, rows = vectors.p, vectors.work, vectors.layout.rows
    count, length, law = solve.solve.count, solve.length, LAWS[vectors.layout.step.law]
    sizes, places = work.at(solve.sizes), work.at(solve.places)
    for number, residual in enumerate(solve.solve.residuals):
        vectors.combine(residual, sizes.at(number * solve.width), sizes=True)
    for number, argument in enumerate(point.arguments):
        vectors.combine(argument, places.at(number * solve.width), sizes=True)
    derivative, calls = work.at(solve.derivative), len(solve.solve.calls)
    with p.loop(0, count) as i, p.loop(0, law.results) as r:
        share = p.variable(0.0, "share")
        with p.loop(0, calls) as c:
            share.value = share.value + shares[(i * law.results + r) * calls + c]
        with p.loop(0, length) as a:
            total = p.variable(sizes[i * solve.width + a], "total")
            with p.loop(0, law.arguments) as s, p.loop(0, length) as b:
                entry = abs(derivative[(s * length + b) * rows + r * length + a])
                total.value = p.fma(share.value, entry * places[s * solve.width + b], total.value)
            sizes[i * solve.width + a] = total.value
    inverse, weights = work.at(solve.inverse), work.at(solve.weights)
    with p.loop(0, count) as i, p.loop(0, length) as a:
        row = (i * solve.width + a).called("row")
        total = p.variable(0.0, "moved")
        with p.loop(0, count) as j, p.loop(0, length) as b:
            entry = abs(inverse[(j * length + b) * solve.all + row])
            total.value = p.fma(entry, sizes[j * solve.width + b], total.value)
        weights[row] = 1.0 / p.fma(total.value, UNIT_ROUND_OFF, LEAST_ROUND_OFF)
