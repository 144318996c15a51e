"""The floors of the tolerances, if they follow the scale of the entries."""

from __future__ import annotations

import math
from functools import reduce
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.step.constants import LEAST_FLOOR
from lagrange.procedure.step.error_norm import higher
from lagrange.procedure.taylor.constants import START_ROWS
from lagrange.procedure.taylor.memory import SeriesMemory, TaylorLayout, entries, floors_array, work_array


@shared
def raise_floors(layout: TaylorLayout) -> Procedure:
    """Return the procedure that raises the floors to their share of the state."""
    p = Builder("raise_floors", "Raise the floor of each entry to a share of its size.")
    share, floors, work = p.given("share", REAL), floors_array(p, layout, read=False), work_array(p)
    with entries(p, layout) as i:
        floors[i] = higher(p, share * abs(work[i]), floors[i])
    return p.finish()


@shared
def first_floors(layout: TaylorLayout) -> Procedure:
    """Return the procedure that sets the floors of entries that are zero, to the sum of their series over the scale.

    It returns whether the series of some entry begins too late to show a size.
    """
    p = Builder("first_floors", "Begin floors of entries that are zero; return if some begin too late.", apart=True)
    share, floors = p.given("share", REAL), floors_array(p, layout, read=False)
    run = SeriesMemory(p, layout, work_array(p))
    rows = [run.row(k) for k in range(1, START_ROWS + 1)]
    late = [run.row(run.less(less)) for less in (1, 0)]

    def largest(values: list[Any]) -> Any:
        return reduce(p.magnitude, values)

    with entries(p, layout) as i:
        before, zero = floors[i], run.work[i].equals(0.0)
        reach = share * largest([row[i] for row in rows])
        reach = p.choose(reach > 0.0, reach, before)
        reach = p.choose(reach < math.inf, reach, before)
        reach = p.choose(reach < LEAST_FLOOR, LEAST_FLOOR, reach)
        floor = p.choose(zero, reach, before)
        floors[i] = floor
        last = p.choose(floor <= LEAST_FLOOR, largest([row[i] for row in late]), 0.0)
        blind = p.largest_magnitude(p.choose(zero, last, 0.0))
    p.leave(~blind.value.equals(0.0))
    return p.finish(FLAG)
