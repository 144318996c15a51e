"""A whole Taylor integrator as one procedure, for exports: choice of the order, series, steps and defect tests.

    taylor(t, t_end, y, p, rtol, atol, max_steps) -> an `Outcome`

It advances the state y from t[0] to t_end with the steps of this package's driver. If it ends earlier, t and y are the
last state. PAUSED means that `max_steps` steps were taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.projection import starts_on_constraints
from lagrange.algorithm.series.cost import cheapest_order, single_operations
from lagrange.algorithm.series.looped import LoopedJet
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import Packing, pack
from lagrange.algorithm.series.written_out import WrittenJet
from lagrange.algorithm.step.constants import LEAST_FLOOR
from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.algorithm.taylor.constants import LEAST_MARGIN, SMALLEST_RTOL, STEP_MARGIN, TIGHT_RTOL
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import HELD, OUTPUTS, TAYLOR, TaylorLayout
from lagrange.errors import LagrangeError, StatementError
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.rewrite import bound
from lagrange.procedure.values import Real, Whole
from lagrange.program.series import SeriesProgram

MOST_WRITTEN_OUT = 5000
"""Largest number of operations of a series that is printed without a loop up to its highest order. A double pendulum
has 2,700 (130 kB of C), which gcc compiles in 3 s; in a loop over orders it takes 1.2 times as long. With more
operations the values do not fit into registers: the outer solar system would take 2.5 times as long.
"""

ORDER_BITS, ORDER_GRID = 53, 1060
"""Orders are compared at `ORDER_GRID` + 1 tolerances from 1 to 2**-`ORDER_BITS`, so that each order is valid for
several of them.
"""


@dataclass(frozen=True)
class TaylorProcedures:
    """The integrator of a series program, whose numbers are in the prepared array from index `begin` on.

    The run takes at least `steps_at_least` steps. `projection` computes the corrections of a state onto its
    constraints, with the type `CORRECTIONS` and the same prepared array. With `relations` some constraints are those of
    coordinates of first order. With `watches` the series has event functions, for callers that use single procedures.
    Raises StatementError for a system with switching surfaces.
    """

    program: SeriesProgram
    begin: int
    steps_at_least: int = 0
    projection: Procedure | None = None
    watches: bool = False
    relations: bool = False

    def __post_init__(self) -> None:
        if self.program.sides or (self.program.watched and not self.watches):
            raise StatementError(
                "an exported Taylor integrator crosses no switching surfaces (abs, sign, Piecewise, min, max): leave "
                "out the content taylor."
            )
        if (self.projection is None) != (self.program.projection is None):
            raise LagrangeError(f"series program {self.program.name}: a projection belongs to constraints.")

    @cached_property
    def packing(self) -> Packing:
        """The packed series by which orders are chosen."""
        return pack(self.program, WIDEST_VECTOR)

    @cached_property
    def single(self) -> Packing:
        """The series packed as single values, for code without loops and for lanes."""
        return pack(self.program, 1)

    @cached_property
    def aligned(self) -> Packing:
        """The series with adjacent values that are read together, for a loop over orders."""
        return pack(self.program, WIDEST_VECTOR, aligned=True)

    @cached_property
    def numbers(self) -> SeriesNumbers:
        """The numbers of the series after the parameters: `size` numbers, written by `prepare`."""
        return SeriesNumbers(self.program, self.begin)

    @cached_property
    def orders(self) -> list[tuple[float, int]]:
        """Pairs (tolerance, order), by decreasing tolerance: each order is used below its tolerance."""
        exponents = [-k * ORDER_BITS / ORDER_GRID for k in range(ORDER_GRID + 1)]
        found = [(math.inf, self.order(1.0))]
        for above, below in pairwise(exponents):
            low, high = 2.0**below, 2.0**above
            if self.order(low) != found[-1][1]:
                while (middle := math.sqrt(low * high)) not in (low, high):
                    low, high = (middle, high) if self.order(middle) != found[-1][1] else (low, middle)
                found.append((high, self.order(low)))
        return found

    def order(self, rtol: float) -> int:
        """Return the order of the series for a relative tolerance."""
        return cheapest_order(self.packing, rtol)

    @property
    def highest(self) -> int:
        """Highest order that is chosen for any tolerance."""
        return max(order for _, order in self.orders)

    @cached_property
    def looped(self) -> bool:
        """True if the series is computed in a loop over orders."""
        return single_operations(self.packing, self.highest) > MOST_WRITTEN_OUT

    @cached_property
    def jet(self) -> tuple[Procedure, TaylorLayout]:
        """The procedure that computes the series, and the layout of its memory."""
        jet: LoopedJet | WrittenJet
        if self.looped:
            jet = LoopedJet(self.aligned, self.numbers)
        else:
            jet = WrittenJet(self.single, self.numbers, self.highest)
        return jet.build(), jet.layout

    def prepare(self, others: Procedure) -> Procedure:
        """Return the procedure that prepares the numbers of other functions, followed by those of the series."""
        first = replace(others, name=f"{others.name}_functions")
        p = Builder(others.name, others.about)
        parameters = p.array("parameters", size=self.numbers.given, read=True)
        to = p.array("p", size=self.begin + self.numbers.size)
        singular = p.call(first, parameters, to)
        p.leave(singular | p.call(self.numbers.prepare(), to))
        return p.finish(FLAG)

    def taylor(self) -> Procedure:
        """Return the procedure of the whole integrator."""
        jet, layout = self.jet
        n = layout.dimension
        p = Builder(
            "taylor",
            "Run from y at t[0] to t_end by Taylor series whose order follows rtol; both become those where it ends.",
        )
        time, t_end = p.array("t", size=1), p.given("t_end", REAL)
        y, prepared = p.array("y", size=n), p.array("p", read=True)
        rtol, atol, most = p.given("rtol", REAL), p.given("atol", REAL), p.given("max_steps", WHOLE)
        if self.projection is not None:
            start = starts_on_constraints.form(dimension=n, relations=self.relations)
            near = bound(start, {"corrections": self.projection}, prefix="start_" if self.relations else "taylor_")
            p.leave_if(~p.call(near, prepared, time[0], y), Outcome.UNPROJECTED)
        work = p.reserve(layout.size(self.highest), room=WIDEST_VECTOR, name="work")
        asked = p.choose(rtol < SMALLEST_RTOL, SMALLEST_RTOL, rtol).called("asked")
        order = self.chosen(p, asked)
        margin = p.choose(asked >= TIGHT_RTOL, p.real(STEP_MARGIN), LEAST_MARGIN).called("margin")
        run, counts = self.begin_run(p, time[0], t_end, margin * asked)
        taylor, held, outputs = (p.reserve_record(one) for one in (TAYLOR, HELD, OUTPUTS))
        floors, floor = p.reserve(n, name="floors"), p.larger(margin * atol, LEAST_FLOOR)
        with p.each(n, width=1) as i:
            floors[i] = floor
        p.copy(y, work, n, spill=False)
        p.note("There are no output times, and no steps are recorded.")
        times, none, rows = (p.reserve(1, name=name) for name in ("output_times", "times", "rows"))
        states = p.reserve(n, name="output_states")
        times[0] = math.nan
        given = {"prepared": prepared, "constants": prepared, "run": run, "counts": counts, "taylor": taylor}
        given |= {"floors": floors, "held": held, "outputs": outputs, "output_times": times, "output_states": states}
        given |= {"times": none, "rows": rows, "budget": most, "work": work, "order": order}
        given["projection_numbers"] = prepared
        functions = {"jet": jet} if self.projection is None else {"jet": jet, "projection": self.projection}
        loop = bound(taylor_steps.form(layout=layout), functions, prefix="taylor_")
        outcome = p.call(loop, *(given[one.name] for one in loop.parameters)).called("outcome")
        time[0] = run.t
        p.copy(work, y, n, spill=False)
        p.leave(outcome)
        return p.finish(WHOLE)

    def begin_run(self, p: Builder, t0: Real, t1: Real, rtol: Real) -> tuple[Any, Any]:
        """Return the records of a run."""
        run: Any = p.reserve_record(RUN)
        counts: Any = p.reserve_record(COUNTS)
        run.t, run.start, run.end, run.rtol, run.previous = t0, t0, t1, rtol, 1.0
        run.cause = float(Outcome.STEP_TOO_SMALL)
        run.longest = abs(t1 - t0) / float(self.steps_at_least) if self.steps_at_least else math.inf
        return run, counts

    def chosen(self, p: Builder, rtol: Real) -> Whole:
        """Build the order for a tolerance, by comparison with the tolerances at which the order changes."""
        found: Whole = p.whole(self.orders[0][1])
        for (_, before), (tolerance, order) in pairwise(self.orders):
            found = found + p.whole(rtol < tolerance) * (order - before)
        found.called("order")
        return found
