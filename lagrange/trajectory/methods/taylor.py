"""The adaptive Taylor integrator. The recurrence of its coefficients is the Euler-Lagrange equation.

The order of the series is chosen by cost, in `lagrange/algorithm/series/order_by_cost.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, partial

import numpy as np

from lagrange.algorithm.taylor.memory import LOWEST_ORDER, SMALLEST_RTOL, step_margin
from lagrange.errors import StatementError, shown
from lagrange.graph.node import Node
from lagrange.machine.backend import Series
from lagrange.machine.drivers import EventMemory, SeriesDriver
from lagrange.machine.model import Model
from lagrange.trajectory.dense_output import SeriesPath, hermite_path
from lagrange.trajectory.events.model_events import ModelEvent, model_events
from lagrange.trajectory.events.series_watch import SeriesWatch
from lagrange.trajectory.events.surfaces import Continuations
from lagrange.trajectory.integrator import Claims, Problem, Tolerances, built_in
from lagrange.trajectory.methods.runge_kutta import DOP853
from lagrange.trajectory.methods.tolerances import adaptive_settings, check_options
from lagrange.trajectory.run_loop import drive_by
from lagrange.trajectory.trajectory import FloatArray

TOP_ORDER = 64
"""The highest order of a Taylor series that a user may request."""


@built_in("taylor")
@dataclass(frozen=True)
class Taylor:
    """The adaptive Taylor series method, compiled from the energies; order by cost, 4 to 32 (listed as 20).

    `rtol` and `atol` are the tolerances, and `order` is a fixed order from 4 to 64. If an option is None, the option of
    the run is used; without one, the method chooses.
    """

    rtol: float | None = None
    atol: float | None = None
    order: int | None = None

    def __post_init__(self) -> None:
        check_options(None, self.rtol, self.atol)
        whole = isinstance(self.order, int) and not isinstance(self.order, bool)
        if self.order is not None and not (whole and LOWEST_ORDER <= self.order <= TOP_ORDER):
            raise StatementError(
                f"order = {shown(self.order)}: give a whole number from {LOWEST_ORDER} to {TOP_ORDER}, or leave it out."
            )

    name = "taylor"

    @cached_property
    def claims(self) -> Claims:
        """The claimed properties of the method: order, adaptive steps, and events.

        The order is listed as 20 if it is not fixed, since it depends on the tolerance and the system.
        """
        return Claims(order=self.order or 20, adaptive=True, events=True, dense=self.order or 20)

    def plan(self, problem: Problem) -> TaylorPlan:
        """Return the plan of a run: the Taylor series of the system, its order, the tolerances, and the events."""

        def margin(rtol: float) -> float:
            return step_margin(rtol, bool(problem.model.statement.rotations))

        tolerances = adaptive_settings(
            self.name, problem, None, self.rtol, self.atol, least=SMALLEST_RTOL, margin=margin
        )
        events = model_events(problem.model, problem.events)
        # A square root ends the run: after its zero the series would have the wrong sign.
        roots = _square_roots(problem.model, tuple(event.node for event in events))
        events = (*events, *(ModelEvent(root, 0, 1, (), None, root=True) for root in roots))
        series, _ = problem.model.series(tuple(event.node for event in events))
        return TaylorPlan(series, self.order or series.order(tolerances.rtol), tolerances, events)

    integrate = drive_by


@dataclass(frozen=True, eq=False)
class TaylorPlan:
    """The plan of a run by Taylor series: the `series`, its `order`, the `tolerances`, and the `events`.

    The series computes coefficients of the state, then of the switching surfaces, then of the event functions.
    """

    series: Series
    order: int
    tolerances: Tolerances
    events: tuple[ModelEvent, ...] = ()

    @cached_property
    def form(self) -> str:
        """Text for the printed summary of a run: the order, and how the series is computed, such as "in loops"."""
        return f"order {self.order}, {self.series.form(self.order)}"

    writes_outputs = True

    @property
    def watched(self) -> bool:
        """True if a run has to search for zeros: of events, of switching surfaces, or of square roots."""
        return bool(self.series.program.watched)

    def driver(self, model: Model, parameters: FloatArray) -> SeriesDriver:
        """Return a driver of the steps for parameters (k,).

        The driver's array of parameters also has the signs of the switching surfaces, after the parameters. They are
        NaN until they are known.
        """
        if sides := self.series.program.sides:
            parameters = np.concatenate([parameters, np.full(sides, np.nan)])
        return SeriesDriver(model.machine, self.series.code(self.order), self.order, parameters)

    def watch(self, problem: Problem, driver: SeriesDriver, memory: EventMemory | None = None) -> SeriesWatch | None:
        """Return the watcher, which searches the steps for events and crossings of surfaces, or None without any.

        `memory` is the memory of the watcher in a former run by this driver, which is used again, or None.
        """
        if not self.watched:
            return None
        parameters, tolerances = problem.parameter_array, self.tolerances
        absolute = None if tolerances.share else tolerances.margin * tolerances.atol
        continuations = Continuations(problem, partial(DOP853, rtol=tolerances.margin * tolerances.rtol, atol=absolute))
        names = partial(watched_names, problem)
        return SeriesWatch(self.series, self.order, driver, parameters, self.events, names, continuations, memory)

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: SeriesWatch | None) -> SeriesPath:
        """Return the dense output through accepted times (S+1,) and states (S+1, 2n): the Taylor series of each step.

        `watch` has the parameters and the signs of switching surfaces at each step. A step without a series has a cubic
        Hermite path.
        """
        parameters = problem.parameter_array
        if watch is None:
            return SeriesPath(self.series, self.order, ((0, parameters),), times, states)
        paths = {i: hermite_path(4)(problem, times[i : i + 2], states[i : i + 2]) for i in watch.continuations.rows}
        return SeriesPath(self.series, self.order, tuple(watch.epochs), times, states, paths)


def _square_roots(model: Model, events: tuple[Node, ...]) -> Mapping[Node, Node]:
    """Return the square roots whose zeros end a Taylor series, as a mapping from root to a power of its radicand.

    The roots occur in the equations of motion or in the expressions `events`. A square root that is itself an event is
    left out, because its zeros are found as zeros of the event. The power is a term of these expressions, such as
    x**(1/3).
    """
    if not events:
        return model.square_roots
    inside = {root: power for root, power in model.square_roots_in(events).items() if root not in events}
    return {**model.square_roots, **inside}


def watched_names(problem: Problem) -> list[str]:
    """Return the texts of the watched functions in the user's symbols: surfaces, then events, then square roots."""
    model = problem.model
    events = tuple(model.equations.translate(event.expression) for event in problem.events)
    square_roots = _square_roots(model, events)
    _, switched = model.series((*events, *square_roots))
    surfaces = [model.equations.express(surface) for surface in switched.expressions]
    shown = [*surfaces, *(event.expression for event in problem.events)]
    # Do not print by SymPy, which simplifies sqrt(x**2) to Abs(x), the form that the message recommends.
    bases = [model.equations.express(power.args[0]) for power in square_roots.values()]
    names = [*map(model.statement.quote, (*shown, *bases))]
    for place, power in enumerate(square_roots.values(), len(shown)):
        base, exponent = names[place], abs(power.data)
        base_in_power = base if base.isidentifier() else f"({base})"
        names[place] = f"sqrt({base})" if exponent == Fraction(1, 2) else f"{base_in_power}**({exponent})"
    return names
