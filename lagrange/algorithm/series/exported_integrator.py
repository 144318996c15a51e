"""Exported Taylor integrator: one procedure that runs from a start time to an end time.

    taylor(t, t_end, y, p, rtol, atol, max_steps) -> an `Outcome`

It advances the state y from time t[0] to t_end with the same steps as a run in this package: it chooses the order,
computes the series, and tests the defect of each step. `p` has the parameters and the numbers computed from them. If
the run ends early, t and y are the last time and state. PAUSED means that `max_steps` steps were taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

from lagrange.algorithm.constants import LEAST_FLOOR, WIDEST_VECTOR, Outcome
from lagrange.algorithm.projection import CORRECTIONS, starts_on_constraints
from lagrange.algorithm.series.jets import ByOrderJet, WrittenJet
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.order_by_cost import cheapest_order, operations, single_operations
from lagrange.algorithm.series.packing import Packing, pack
from lagrange.algorithm.step.memory import Counts, Run
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import (
    JET,
    SMALLEST_RTOL,
    Held,
    OutputCounts,
    TaylorLayout,
    TaylorState,
    step_margin,
)
from lagrange.algorithm.taylor.watched_functions import Arguments
from lagrange.errors import LagrangeError, StatementError
from lagrange.procedure.form import Array, Procedure
from lagrange.procedure.front.decorators import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, generated, larger, reals
from lagrange.procedure.rewrite import bound, without_vectors
from lagrange.program.series import SeriesProgram

MOST_WRITTEN_OUT = 5000
"""Largest number of operations, up to its highest order, of a series that is printed without a loop. A double pendulum
has 2,700 (130 kB of C), which gcc compiles in 3 s; in a loop over orders it takes 1.2 times as long. With more
operations the values do not fit into registers: the outer solar system would take 2.5 times as long.
"""

EXPORTED_TILE = 12
"""Largest number of sums over lower orders that exported code computes together. Their totals stay in the 16 registers
of most processors. With 24 sums the series of the scene pleiades takes 1.1 to 1.6 times as long.
"""

LOOP_LANES, LOOP_TILE = 48, 2
"""Sizes of code with loops over values that have the same rule. `LOOP_LANES`: number of values in such a loop.
`LOOP_TILE`: number of vectors of sums that are computed together, one order at a time. Compilers unroll loops of 16 and
fewer iterations, and then do not find vectors.
"""

LEAST_LANES = 6.0
"""Least mean length of vectors, of at most 8 values with the same recurrence rule, for which exported code has loops
over the values of a vector. The outer solar system (6.7) then takes 0.7 of the time; a quadrotor (5.7) would take 1.2
times as long.
"""

ORDER_BITS, ORDER_GRID = 53, 1060
"""Grid of tolerances at which the best order of a series is computed: `ORDER_GRID` + 1 tolerances from 1 to
2**-`ORDER_BITS`. The grid is so fine that each order is chosen at several of them.
"""


@dataclass(frozen=True)
class TaylorProcedures:
    """Builds the procedures of a Taylor integrator for export from a series program.

    The numbers of the series that depend on parameters alone are stored in the array p from index `begin` on. A run
    takes at least `steps_at_least` steps. `projection` computes the corrections of a state onto its constraints.
    With `relations` some constraints determine the velocities of coordinates of first order. With `rotations` the
    state contains quaternions. With `watches` the series may have event functions, for callers that use single
    procedures. Raises StatementError for a system with switching surfaces.
    """

    program: SeriesProgram
    begin: int
    steps_at_least: int = 0
    projection: Procedure | None = None
    watches: bool = False
    relations: bool = False
    rotations: bool = False

    def __post_init__(self) -> None:
        if self.program.sides or (self.program.watched and not self.watches):
            raise StatementError(
                "an exported Taylor integrator crosses no switching surfaces (abs, sign, Piecewise, min, max): leave "
                "'taylor' out of contents."
            )
        if (self.projection is None) != (self.program.projection is None):
            raise LagrangeError(
                f"series program {self.program.name}: give a projection if the system has constraints, else None."
            )

    @cached_property
    def packing(self) -> Packing:
        """The series packed into vectors of `WIDEST_VECTOR` values. Its cost decides the order for each tolerance."""
        return pack(self.program, WIDEST_VECTOR)

    @cached_property
    def single(self) -> Packing:
        """The series packed as single values, without vectors."""
        return pack(self.program, 1)

    @cached_property
    def numbers(self) -> SeriesNumbers:
        """Layout of the numbers of the series that depend on parameters alone, in the array of parameters."""
        return SeriesNumbers(self.program, self.begin)

    @cached_property
    def orders(self) -> list[tuple[float, int]]:
        """Pairs (tolerance, order), by decreasing tolerance. An order is used below its tolerance."""
        exponents = [-k * ORDER_BITS / ORDER_GRID for k in range(ORDER_GRID + 1)]
        pairs = [(math.inf, self.order(1.0))]
        for above, below in pairwise(exponents):
            low, high = 2.0**below, 2.0**above
            if self.order(low) != pairs[-1][1]:
                while (middle := math.sqrt(low * high)) not in (low, high):
                    low, high = (middle, high) if self.order(middle) != pairs[-1][1] else (low, middle)
                pairs.append((high, self.order(low)))
        return pairs

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
        jet: ByOrderJet | WrittenJet
        lanes = single_operations(self.packing, self.highest) / operations(self.packing, self.highest)
        if not self.looped:
            jet = WrittenJet(self.single, self.numbers, self.highest)
        elif lanes < LEAST_LANES:
            jet = ByOrderJet(self.single, self.numbers, tile=EXPORTED_TILE)
        else:
            packing = pack(self.program, LOOP_LANES)
            jet = ByOrderJet(packing, self.numbers, tile=LOOP_TILE, paired=False)
        return without_vectors(jet.build()), jet.layout

    def prepare(self, functions: Procedure) -> Procedure:
        """Return the procedure that computes all numbers that depend on parameters alone.

        It first runs the procedure `functions`, which computes these numbers for the other functions of the system, and
        then computes those of the series.
        """
        first = replace(functions, name=f"{functions.name}_functions")
        combined = prepare_both.form(first=first, second=self.numbers.prepare())
        return replace(combined, name=functions.name, about=functions.about)

    def taylor(self) -> Procedure:
        """Return the procedure that runs from a start time to an end time by Taylor series."""
        jet, layout = self.jet
        functions = {"jet": jet} if self.projection is None else {"jet": jet, "projection": self.projection}
        known = {"highest": self.highest, "steps_at_least": self.steps_at_least}
        flags = {"relations": self.relations, "rotations": self.rotations}
        form = taylor_run.form(layout=layout, orders=tuple(self.orders), **known, **flags)
        return replace(bound(form, functions, prefix="taylor_"), name="taylor")


@procedure(parameters=lambda first: first.parameters[0].type, p=lambda second: second.parameters[0].type)
def prepare_both(parameters: In, p: Out, *, first: Procedure, second: Procedure) -> bool:
    """Write the parameters, and all numbers that depend on them alone, to `p`. This is done once for a run.

    The procedure `first` computes the numbers of the right-hand side from the `parameters`. Then the procedure
    `second` computes the numbers of the series from `p`. Return True if a matrix is singular.
    """
    is_first_singular: bool = generated(first, parameters, p)
    is_second_singular: bool = generated(second, p)
    return is_first_singular or is_second_singular


@dataclass(frozen=True)
class SeriesFunctions:
    """The functions that an exported Taylor run calls.

    `jet` computes the Taylor coefficients at a state. `projection` computes the corrections of a state onto its
    constraints; it is None without constraints.
    """

    jet: Callable[..., bool]
    projection: Any


@inline
def order_at(rtol: float, orders: tuple[tuple[float, int], ...]) -> int:
    """Return the order of the series at a relative tolerance, from the pairs (tolerance, order) at which it changes."""
    order = orders[0][1]
    for (_, before), (tolerance, after) in pairwise(orders):
        order = order + int(rtol < tolerance) * (after - before)
    return order


@inline
def begin(of: SeriesFunctions, p: In, order: int, highest: int, layout: TaylorLayout) -> Arguments:
    """Return the arguments of the loop over Taylor steps, with new memory for series up to the order `highest`.

    `of` are the functions of the system, p its parameters with all values that depend only on them, and `order` the
    order of the series. There are no output times, and no steps are recorded. The records of the run are zero.
    """
    work = reals(layout.size(highest), room=WIDEST_VECTOR)
    floors, states = reals(layout.dimension), reals(layout.dimension)
    output_times, times, rows = reals(1), reals(1), reals(1)
    output_times[0] = math.nan
    return Arguments(
        jet=of.jet,
        prepared=p,
        constants=p,
        run=Run(),
        counts=Counts(),
        taylor=TaylorState(),
        floors=floors,
        held=Held(),
        outputs=OutputCounts(),
        output_times=output_times,
        output_states=states,
        times=times,
        rows=rows,
        watched=None,
        projection=of.projection,
        projection_numbers=None if of.projection is None else p,
        work=work,
        order=order,
    )


@procedure(
    of=lambda layout: Bundle(SeriesFunctions, {"jet": JET, "projection": CORRECTIONS if layout.projected else None}),
    t=lambda: Array(size=1),
    y=lambda layout: Array(size=layout.dimension),
)
def taylor_run(
    of: SeriesFunctions,
    t: Out,
    t_end: float,
    y: Out,
    p: In,
    rtol: float,
    atol: float,
    max_steps: int,
    *,
    layout: TaylorLayout,
    orders: tuple[tuple[float, int], ...],
    highest: int,
    steps_at_least: int,
    relations: bool,
    rotations: bool,
) -> Outcome:
    """Run from the state y at time t[0] to t_end by Taylor series, and return an outcome.

    The last state is written to y, and its time to t[0]. The outcome is DONE at t_end, and PAUSED after
    `max_steps` steps. `of` are the functions of the system, and `p` has the parameters and the numbers computed
    from them. The order follows from `rtol` and the pairs (tolerance, order) in `orders`; `highest` is the
    highest of them. No step is longer than the run divided by `steps_at_least`, unless that is 0. With
    `relations` some constraints determine velocities. With `rotations` the state contains quaternions.
    """
    n, projection = layout.dimension, of.projection
    if projection is not None and not starts_on_constraints(projection, p, t[0], y, dimension=n, relations=relations):
        return Outcome.UNPROJECTED
    tolerance_used = SMALLEST_RTOL if rtol < SMALLEST_RTOL else rtol
    order = order_at(tolerance_used, orders)
    margin = step_margin(tolerance_used, rotations)
    arguments = begin(of, p, order, highest, layout)
    run, floors, work = arguments.run, arguments.floors, arguments.work
    run.t, run.start, run.end, run.rtol, run.previous = t[0], t[0], t_end, margin * tolerance_used, 1.0
    run.cause = float(Outcome.STEP_TOO_SMALL)
    run.longest = abs(t_end - t[0]) / float(steps_at_least) if steps_at_least else math.inf
    floor = larger(margin * atol, LEAST_FLOOR)
    for i in each(n, width=1):
        floors[i] = floor
    work[:n] = y[:n]
    outcome = taylor_steps(arguments, max_steps, layout=layout)
    t[0] = run.t
    y[:n] = work[:n]
    return outcome
