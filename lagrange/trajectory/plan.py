"""Prepare a method for a model as a plan, with drivers (loops over steps), and cache it for later runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

from lagrange.machine.backend import Driver, FloatArray
from lagrange.machine.drivers import StepDriver
from lagrange.machine.model import Model
from lagrange.machine.state import NO_OUTPUTS, DriverState
from lagrange.program.step import LAWS, StepProgram
from lagrange.trajectory.dense_output import MotionsPath, StepPath
from lagrange.trajectory.events.compiled_loop import WatchedEvents
from lagrange.trajectory.events.series_watch import SeriesWatch
from lagrange.trajectory.events.step_watch import StepWatch
from lagrange.trajectory.integrator import Integrator, Problem, Tolerances

PathFunction = Callable[[FloatArray], FloatArray]
"""Dense output: from times (K,) to states (2n, K)."""

Watcher = StepWatch | SeriesWatch
"""Object that finds events along a run and handles them. Its `memory` serves the next run by the same driver."""


class Plan(Protocol):
    """Protocol of a method that is prepared for a model: it makes drivers, watchers of events, and dense output."""

    @property
    def tolerances(self) -> Tolerances:
        """The tolerances and step lengths of the driver."""

    @property
    def form(self) -> str:
        """Text that says how a step is computed, for the printed summary of the run. Empty if there is no choice."""

    @property
    def watched(self) -> bool:
        """True if a run by this plan has events or switching surfaces."""

    @property
    def writes_outputs(self) -> bool:
        """True if the driver writes the states at output times during the run."""

    def driver(self, model: Model, parameters: FloatArray) -> Driver:
        """Return a driver, the loop over steps, for parameters (k,)."""

    def watch(self, problem: Problem, driver: Any, memory: Any = None) -> Watcher | None:
        """Return the watcher, which finds events and switching surfaces on the driver's steps, or None without any.

        `memory` is the memory of the watcher in a former run by this driver, which is used again, or None.
        """

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: Any) -> PathFunction:
        """Return the dense output through the accepted times (S+1,) and states (S+1, 2n) of a run.

        `watch` is the watcher of events, which has the states at which the motion jumps, or None without events.
        """


@runtime_checkable
class Planned(Protocol):
    """Protocol of an integrator whose driver can be prepared once for many runs."""

    @property
    def name(self) -> str:
        """The name under which the method is registered."""

    def plan(self, problem: Problem) -> Plan:
        """Return the plan for a problem. Raises StatementError for a setting that the method does not use."""


@runtime_checkable
class Stepped(Protocol):
    """Protocol of an integrator whose step is a program, the same for all problems."""

    @property
    def program(self) -> StepProgram:
        """The program that computes one step."""


def locates_events(integrator: Integrator) -> bool:
    """Return True if a method locates events: it prepares a plan, or says so in its `claims`."""
    return hasattr(integrator, "plan") or integrator.claims.events


@dataclass(frozen=True)
class StepPlan:
    """The plan of a method whose step is a program, `step`, such as a Runge-Kutta step.

    `tolerances` are the tolerances and step lengths of the driver. `path_of` returns the dense output from a problem
    and its accepted times (S+1,) and states (S+1, 2n). `form` says how a step is computed, "" if there is no choice.
    """

    step: StepProgram
    tolerances: Tolerances
    path_of: Callable[[Problem, FloatArray, FloatArray], StepPath]
    form: str = ""
    projected: bool = True
    """True if steps are projected onto the constraints, or False if they end on them already."""

    writes_outputs = False
    watched = False  # a step program passes switching surfaces without locating them

    def driver(self, model: Model, parameters: FloatArray) -> Driver:
        """Return the driver, a loop over steps, for parameters (k,).

        The driver evaluates the right-hand side that the steps of the method need, such as accelerations or forces.
        """
        law = LAWS[self.step.law]
        derivative = model.law(law.derivative) if self.step.solves else None
        has_constraints = self.projected and len(model.equations.constraints) > 0
        projection = model.law("projection") if has_constraints else None
        return StepDriver(model.machine, self.step, model.law(law.quantity), parameters, derivative, projection)

    def watch(self, problem: Problem, driver: Driver, memory: WatchedEvents | None = None) -> StepWatch | None:
        """Return the watcher, which finds the events of the run on the driver's steps, or None without events.

        `memory` is the memory of the watcher in a former run by this driver, which is used again, or None.
        """
        if not problem.events:
            return None
        fixed = self.step.control is None
        return StepWatch(problem, partial(self.path_of, problem), fixed=fixed, memory=memory)

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: StepWatch | None) -> PathFunction:
        """Return the dense output through accepted times (S+1,) and states (S+1, 2n), with jumps at resets.

        `watch` is the watcher of events, which has the resets, or None without events.
        """
        dense = None if watch is None else watch.memory.dense
        path = self.path_of(problem, times, states) if dense is None else replace(dense, times=times, states=states)
        return (
            MotionsPath(times, states, watch.breaks.since(0), path) if watch is not None and len(watch.breaks) else path
        )


PLANS_KEPT = 8
"""Largest number of plans that a model keeps. The oldest is dropped."""

DRIVERS_KEPT = 4
"""Largest number of idle drivers that a plan keeps, each for different parameters. The oldest is dropped."""

MOST_BYTES = 2**20
"""Largest memory, in bytes, of the event watcher of a driver that is kept: enough for some 30 entries of the state.
Runs of larger systems take so long that making a new driver does not matter."""


class IdleDriver(NamedTuple):
    """A driver that waits for the next run with the same parameters, and the `state` that it advanced.

    `first` are the `reals` of that state at the start of a run: time, step length, tolerances. `steps` is the number of
    steps that the first driver call of the next run takes. It is the number of steps of the last run, or 0 if these
    took too long for one call. `memory` is the memory of the watcher of events, or None.
    """

    driver: Driver
    state: DriverState
    first: FloatArray
    steps: int
    memory: Any = None


@dataclass(eq=False)
class PreparedPlan:
    """A plan, the method that made it, and its `idle` drivers, which wait for the next run with their parameters.

    The keys of `idle` are the bytes of these parameters. `span` is the only time span for which the plan is valid, or
    None for any span. `steps` is the number of steps of the last run whose driver was not kept, or 0 if these steps
    took too long for one call.
    """

    plan: Plan
    method: Planned | None = None
    span: tuple[float, float] | None = None
    idle: dict[bytes, IdleDriver] = field(default_factory=dict)
    steps: int = 0

    def take(self, problem: Problem) -> IdleDriver | None:
        """Remove and return an idle driver with the parameters of the problem, or return None if there is none.

        The state of the driver is set to the start of the problem.
        """
        idle = self.idle.pop(problem.parameter_array.tobytes(), None)
        if idle is not None:
            settings = self.plan.tolerances
            step = settings.step if problem.t1 >= problem.t0 else -settings.step
            idle.state.restart(idle.first, (problem.t0, problem.t1), problem.y0, step, settings.longest)
            idle.state.integers[DriverState.RECORD] = 1
            if idle.memory is not None:
                idle.state.restart_series()
        return idle

    def give(
        self,
        problem: Problem,
        reused: IdleDriver | None,
        driver: Driver,
        state: DriverState,
        steps: int,
        watch: Watcher | None,
    ) -> None:
        """Keep the driver of a successful run for the next run with the same parameters.

        `reused` is the idle driver that the run used, None for a new driver. `state` is the state that the driver
        advanced, and `steps` its number of steps. `watch` is the watcher of events, or None.
        """
        if self.method is None:
            return
        memory = None if watch is None else watch.memory
        if reused is None and memory is not None and memory.nbytes > MOST_BYTES:
            self.steps = steps
            return
        state.outputs = NO_OUTPUTS
        if reused is not None:
            first = reused.first
        else:
            # With events, the state is not in the memory of the driver.
            if memory is None:
                driver.adopt(state)
            first = self.plan.tolerances.begin(problem.t0, problem.t1, problem.y0).reals
        self.idle[problem.parameter_array.tobytes()] = IdleDriver(driver, state, first, steps, memory)
        drop_oldest(self.idle, DRIVERS_KEPT)


def prepared(method: Planned, problem: Problem) -> PreparedPlan:
    """Return the plan of a method for a problem. The plan of a former run of the model is used again if it is valid.

    Methods and events are compared by identity, since comparing two tableaux takes longer than making a plan.
    """
    if not isinstance(problem, Problem):
        return PreparedPlan(method.plan(problem))
    options = problem.rtol, problem.atol, problem.step
    # Zeros and other types cannot be part of the key, since 0.0 and -0.0 are equal.
    if not all(option is None or (isinstance(option, float) and option > 0.0) for option in options):
        return PreparedPlan(method.plan(problem))
    watched = (problem.events,) if problem.events else ()
    cache, key, span = problem.model.prepared, (id(method), *options, *watched), (problem.t0, problem.t1)
    kept_plan: PreparedPlan | None = cache.get(key)
    if kept_plan is None or kept_plan.span not in (None, span):
        plan = method.plan(problem)
        whenever = plan.tolerances.rtol > 0.0 and plan.tolerances.longest == math.inf
        kept_plan = PreparedPlan(plan, method, None if whenever else span, {} if kept_plan is None else kept_plan.idle)
        cache[key] = kept_plan
        drop_oldest(cache, PLANS_KEPT)
    return kept_plan


def drop_oldest(cache: dict[Any, Any], most: int) -> None:
    """Drop the oldest entries of `cache` until `most` are left. Other threads may drop entries at the same time."""
    if len(cache) > most:
        for key in tuple(cache)[:-most]:
            cache.pop(key, None)
