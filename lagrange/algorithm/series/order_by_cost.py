"""Choose the order of a Taylor series by the cost of a step, and whether its code is written without loops.

The cost of a Taylor step is in about nanoseconds. The formulas are fits to the measured steps of nine systems, from a
pendulum to 64 masses, at orders 6 to 24 (AMD Zen 4). Only ratios of costs matter. They are accurate to a fifth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lagrange.algorithm.series.packing import Packing
from lagrange.algorithm.taylor.memory import LOWEST_ORDER
from lagrange.program.elimination import block_eliminations, is_factored

HIGHEST_ORDER = 32
"""Highest order that may be chosen for a Taylor series. The lowest order is `LOWEST_ORDER`."""


@dataclass(frozen=True)
class Cost:
    """Cost of a step of order p, in about nanoseconds: fixed + each * p + pairs * p**2."""

    fixed: float
    each: float
    pairs: float


COST_MARGIN = 1.07
"""Largest ratio of the cost of the chosen order to the least cost of all orders. The lowest order within this ratio is
chosen. Costs hardly depend on the order there. Lower orders compile sooner, stay farther from the radius of convergence
and have less rounding. At a tolerance of 1e-13 six scenes, from the pendulum to sun, earth and moon, run in 0.74 to
1.04 of the time of the order of least cost, and compile in 0.58 to 0.77 of its time.
"""


def best_order(cost: Cost, tolerance: float) -> int:
    """Return the order p at which the cost of a step, divided by its length, is about lowest.

    The length of a step is proportional to tolerance**(1/p). Of the orders that cost nearly the least, the
    lowest is chosen.
    """
    prices = {
        p: (cost.fixed + cost.each * p + cost.pairs * p * p) * math.exp(-math.log(tolerance) / p)
        for p in range(LOWEST_ORDER, HIGHEST_ORDER + 1)
    }
    return min(p for p, price in prices.items() if price <= COST_MARGIN * min(prices.values()))


LARGEST_WRITTEN_OUT = 4000
"""Largest number of vector operations of a series that is printed without loops. A larger series does not fit the
processor's cache, and takes more than a third of a second to compile.
"""


ROUNDING_TOLERANCE, HIGHEST_ROUNDED = 1e-14, 16
"""Below the tolerance `ROUNDING_TOLERANCE` the order is at most `HIGHEST_ROUNDED`, except for the smallest systems.
Rounding then is most of the error, and shorter steps average it. The outer solar system ends with an error of 2e-13 at
order 16, and 5e-13 at order 20, in the same time.
"""


def cheapest_order(widest: Packing, tolerance: float) -> int:
    """Return the order of a series with about the lowest cost for a relative tolerance.

    The cost is that of code without loops, or of loops if the series is large. Below a tolerance of
    `ROUNDING_TOLERANCE` the order is bounded, except for the smallest systems. `widest` is the series packed into
    vectors of `WIDEST_VECTOR` values on every machine and processor: then a run takes the same steps everywhere.
    """
    order = best_order(jet_cost(widest, looped=False), tolerance)
    if is_large(widest, order):
        order = best_order(jet_cost(widest, looped=True), tolerance)
    rounds = any(stage.plan.inverted for stage in widest.stages) or widest.program.dimension > 2
    return min(order, HIGHEST_ROUNDED) if tolerance < ROUNDING_TOLERANCE and rounds else order


def inversion_size(packing: Packing, *, looped: bool) -> int:
    """Return the sum of n**3 over the n-by-n matrices that are inverted at each step.

    If `looped`, sparse matrices are factored instead, and do not count.
    """
    plans = [stage.plan for stage in packing.stages if stage.plan.inverted]
    return sum(plan.size**3 for plan in plans if not (looped and is_factored(plan)))


def operations(packing: Packing, order: int) -> int:
    """Return the number of vector operations of a series without loops, up to an order.

    Sums, rules, the values of order 0, and the inverses of matrices are counted.
    """
    program = packing.program
    inverse = inversion_size(packing, looped=False) // 2
    start = len(program.start.instructions) + inverse
    return sums(packing) * order * (order - 1) // 2 + 3 * chunks(packing) * order + start


def single_operations(packing: Packing, order: int) -> int:
    """Return the number of operations of a series without loops, up to an order, with values one by one."""
    summed = sum(chunk.count * len(chunk.sums) for chunk in packing.computed)
    values = sum(chunk.count for chunk in packing.computed)
    return summed * order * (order - 1) // 2 + 3 * values * order + len(packing.program.start.instructions)


def is_large(packing: Packing, order: int) -> bool:
    """Return True if a series up to an order has too many operations for code without loops."""
    return operations(packing, order) > LARGEST_WRITTEN_OUT


def chunks(packing: Packing) -> int:
    """Return the number of vectors of series values that are computed by rules at each order."""
    return len(packing.before) + sum(len(stage.trial) + len(stage.found) for stage in packing.stages)


def sums(packing: Packing) -> int:
    """Return the number of vectors of sums over lower orders that are computed at each order."""
    return sum(len(chunk.sums) for chunk in packing.computed)


def jet_cost(packing: Packing, *, looped: bool) -> Cost:
    """Return the cost of a Taylor step of a packed series as a function of the order.

    With `looped` the series is computed in a loop over orders, otherwise by code without loops.
    """
    program, count = packing.program, chunks(packing)
    fixed = 50.0 + 6.0 * count
    each = 3.0 + 0.8 * count + 0.9 * sums(packing)
    if looped:
        factored = [stage.plan for stage in packing.stages if is_factored(stage.plan)]
        entries = sum(len(block.places) for plan in factored for block in block_eliminations(plan))
        fixed += 0.4 * len(program.start.instructions) + 0.1 * inversion_size(packing, looped=True) + 2.0 * entries
        each = 1.15 * each + 9.0 + 0.8 * entries
    width = sum(len(chunk.values) * len(chunk.sums) for chunk in packing.computed)
    return Cost(fixed=fixed, each=each, pairs=0.027 * width)
