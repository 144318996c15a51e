"""What a method prepares for a run, and what a model keeps from run to run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from lagrange.machine.backend import Driver, SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.machine.state import NO_OUTPUTS, DriverState
from lagrange.procedure.step.constants import AFTER_BROKEN
from lagrange.program.actions import LAWS
from lagrange.program.step import StepProgram
from lagrange.trajectory.events.ending import EventResult
from lagrange.trajectory.events.event_loop import WatchedEvents
from lagrange.trajectory.events.step_watch import StepWatch
from lagrange.trajectory.integrator import Claims, Integrator, Problem
from lagrange.trajectory.options import Tolerances
from lagrange.trajectory.outputs import FollowedSteps
from lagrange.trajectory.paths.step_paths import MotionsPath, StepPath
from lagrange.trajectory.trajectory import FloatArray

PathFunction = Callable[[FloatArray], FloatArray]
"""Dense output: from times (K,) to states (2n, K)."""


class WatchMemory(Protocol):
    """What a watcher keeps for the next run by its driver."""

    @property
    def nbytes(self) -> int:
        """How many bytes it takes."""


class Watcher(Protocol):
    """Finds events along a run, and handles them."""

    @property
    def driver(self) -> Driver:
        """The driver that advances the run; it returns where an event is to be handled."""

    @property
    def memory(self) -> WatchMemory:
        """What another run by the same driver, with the same parameters and events, may begin with."""

    @property
    def occurrences(self) -> Sequence[Sized]:
        """The occurrences so far of each event."""

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """The times of each event, (k,), up to the last accepted step."""

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """The states at each event, (k, 2n)."""

    def begin(self, state: DriverState) -> EventResult:
        """Begin at the start of a run."""

    def process(self, state: DriverState) -> EventResult:
        """Handle the event at which the driver returned."""

    def end(self, state: DriverState) -> EventResult:
        """Handle the events at the end of the run."""

    def is_due(self, state: DriverState) -> bool:
        """Whether an event is to be handled at the state although the driver found no step from there."""

    def continue_past(self, state: DriverState) -> EventResult | None:
        """Continue past a point from which the driver finds no step; return the result, or None if that is impossible.

        The state has then jumped, or the result has another reason for the end of the run.
        """


class Plan(Protocol):
    """A method prepared for a model."""

    @property
    def tolerances(self) -> Tolerances:
        """The tolerances and step lengths of the driver."""

    @property
    def form(self) -> str:
        """How a step is computed, for the status card; "" if there is no choice."""

    @property
    def watched(self) -> bool:
        """Whether a run by this plan has events or switching surfaces."""

    @property
    def writes_outputs(self) -> bool:
        """Whether the driver writes the states at output times as it goes."""

    def driver(self, model: Model, parameters: FloatArray) -> Driver:
        """Return a driver for parameters (k,)."""

    def watch(self, problem: Problem, driver: Any, memory: Any = None) -> Watcher | None:
        """Return the watcher of events and switching surfaces for the plan's driver, or None if there are none.

        A `memory` is that of the watcher of a former run by this driver.
        """

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: Any) -> PathFunction:
        """Return the dense output from the accepted times (S+1,) and states (S+1, 2n), and the watcher."""

    def failed(self, problem: Problem, state: DriverState) -> FloatArray:
        """Return the end of the step from the last accepted state, with its entries that are not finite."""


@runtime_checkable
class Planned(Protocol):
    """An integrator whose driver can be prepared once for many runs."""

    def plan(self, problem: Problem) -> Plan:
        """Return the plan. Raises StatementError for a setting without a use."""


@runtime_checkable
class Stepped(Protocol):
    """An integrator whose steps are a program that does not depend on the problem."""

    @property
    def program(self) -> StepProgram:
        """The step."""


def locates_events(integrator: Integrator) -> bool:
    """Return whether a method locates events: one with a plan has those of the driver."""
    return hasattr(integrator, "plan") or integrator.claims.events


def promises(integrator: Integrator) -> Claims:
    """Return the claims of a method; a method with a plan has the events of the driver."""
    claims = integrator.claims
    return replace(claims, events=locates_events(integrator))


@dataclass(frozen=True)
class StepPlan:
    """The plan of a method that is a step program."""

    step: StepProgram
    tolerances: Tolerances
    path_of: Callable[[Problem, FloatArray, FloatArray], StepPath]
    form: str = ""
    projected: bool = True
    """Whether steps are projected onto the constraints of a system, unless they end there by themselves."""

    writes_outputs = False

    @property
    def watched(self) -> bool:
        """Nothing but the events of a run: a step program goes over switching surfaces."""
        return False

    def driver(self, model: Model, parameters: FloatArray) -> Driver:
        """Return the driver of the step around its law."""
        law = LAWS[self.step.law]
        derivative = model.law(law.derivative) if self.step.solves else None
        held = self.projected and len(model.equations.constraints) > 0
        projection = model.law("projection") if held else None
        return model.machine.driver(self.step, model.law(law.quantity), parameters, derivative, projection)

    def watch(self, problem: Problem, driver: Driver, memory: WatchedEvents | None = None) -> StepWatch | None:
        """Return what watches the events of the run, if it has any."""
        if not problem.events:
            return None
        fixed = self.step.control is None
        return StepWatch(problem, driver, partial(self.path_of, problem), fixed=fixed, memory=memory)

    def followed(self, problem: Problem, wanted: FloatArray, watch: Any) -> FollowedSteps:
        """Return what evaluates output times as a run goes."""
        return FollowedSteps(problem, wanted, partial(self.path_of, problem), None if watch is None else watch.breaks)

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: StepWatch | None) -> PathFunction:
        """Return the dense output that the method has, of each motion between two resets by itself."""
        if watch is None:
            return self.path_of(problem, times, states)
        known = watch.path_of.known
        path = self.path_of(problem, times, states) if known is None else replace(known, times=times, states=states)
        return MotionsPath(times, states, watch.breaks.since(0), path) if len(watch.breaks) else path

    def failed(self, problem: Problem, state: DriverState) -> FloatArray:
        """Take the failed step again, in a simpler way if it is implicit; see `Plan`."""
        step, parameters = self.step, problem.parameter_array
        kernel, layout = problem.model.kernel("rhs"), problem.model.layout
        h = float(state.reals[DriverState.STEP] or state.reals[DriverState.H] / AFTER_BROKEN)

        def f(t: float, y: FloatArray) -> FloatArray:
            split = step.law == "accelerations"
            slope = kernel(t, np.concatenate([y, np.zeros(len(layout.rates))]) if split else y, parameters)
            return slope[layout.v] if split else slope

        with np.errstate(all="ignore"):
            try:
                if step.solves:
                    return _state_moved_by_slope(f, state, h)
                if step.partitioned:
                    return np.concatenate(step.function(f, state.t, *layout.split(state.y), h))
                moved = step.function(f, state.t, state.y, h)
            except SingularMassMatrix:
                return state.y
        return np.asarray(moved if step.control is None else moved[0])


def _state_moved_by_slope(f: Callable[[float, FloatArray], FloatArray], state: DriverState, h: float) -> FloatArray:
    """Return the state moved by the first slope ahead that is not finite; the search goes a few steps ahead."""
    first = f(state.t, state.y)
    for reach in (1, 2, 4, 8):
        slope = f(state.t + reach * h, state.y + reach * h * first)
        if not np.isfinite(slope).all():
            break
    return np.asarray(state.y + h * slope)


PLANS_KEPT = 8
"""Most plans that a model keeps; the oldest is dropped."""

DRIVERS_KEPT = 4
"""Most idle drivers that a plan keeps, each for other parameters; the oldest is dropped."""

MOST_BYTES = 2**20
"""Most bytes that a driver is kept with for what watches its events: enough for some 30 entries of the state.

Runs of larger systems take so long that it hardly counts.
"""


class IdleDriver(NamedTuple):
    """A driver between two runs, the state that it advanced, and the `reals` with which such a run begins.

    `steps` are as many as its last run took, for the first call of the next, or 0 where they took too long for one.
    `memory` is what its watcher has left for the next.
    """

    driver: Driver
    state: DriverState
    first: FloatArray
    steps: int
    memory: WatchMemory | None = None


@dataclass(eq=False)
class Prepared:
    """A plan, the method that made it, for a span of time, None for any; idle drivers by the bytes of parameters.

    `steps` are as many as the last run took whose driver is not kept, or 0 where they took too long for one call.
    """

    plan: Plan
    method: Planned | None = None
    span: tuple[float, float] | None = None
    idle: dict[bytes, IdleDriver] = field(default_factory=dict)
    steps: int = 0

    def take(self, problem: Problem) -> IdleDriver | None:
        """Return an idle driver, which no other run has from now on, with the state at the start of the problem."""
        found = self.idle.pop(problem.parameter_array.tobytes(), None)
        if found is not None:
            settings = self.plan.tolerances
            step = settings.step if problem.t1 >= problem.t0 else -settings.step
            found.state.restart(found.first, (problem.t0, problem.t1), problem.y0, step, settings.longest)
            found.state.integers[DriverState.RECORD] = 1
            if found.memory is not None:
                found.state.restart_series()
        return found

    def give(
        self,
        problem: Problem,
        taken: IdleDriver | None,
        driver: Driver,
        state: DriverState,
        steps: int,
        watch: Watcher | None,
    ) -> None:
        """Keep the driver of a run that has succeeded, and was `taken` or is new, for the next with its parameters."""
        if self.method is None:
            return
        memory = None if watch is None else watch.memory
        if taken is None and memory is not None and memory.nbytes > MOST_BYTES:
            self.steps = steps
            return
        state.outputs = NO_OUTPUTS
        if taken is not None:
            first = taken.first
        else:
            # What watches a run keeps its state apart from that in the driver's memory.
            if memory is None:
                driver.adopt(state)
            first = self.plan.tolerances.begin(problem.t0, problem.t1, problem.y0).reals
        self.idle[problem.parameter_array.tobytes()] = IdleDriver(driver, state, first, steps, memory)
        drop_oldest(self.idle, DRIVERS_KEPT)


def prepared(method: Planned, problem: Problem) -> Prepared:
    """Return the plan of a method for a problem, as a former run of the model left it where that holds for this one.

    A method and an event are known by their identity: to compare two tableaux takes longer than to make a plan.
    """
    if not isinstance(problem, Problem):
        return Prepared(method.plan(problem))
    options = problem.rtol, problem.atol, problem.step
    if not (_is_key(options[0]) and _is_key(options[1]) and _is_key(options[2])):
        return Prepared(method.plan(problem))
    # A plan with events has the parameters of their resets.
    watched = (problem.events, problem.parameter_array.tobytes()) if problem.events else ()
    kept, key, span = problem.model.prepared, (id(method), *options, *watched), (problem.t0, problem.t1)
    found: Prepared | None = kept.get(key)
    if found is None or found.span not in (None, span):
        plan = method.plan(problem)
        whenever = plan.tolerances.rtol > 0.0 and plan.tolerances.longest == math.inf
        found = Prepared(plan, method, None if whenever else span, {} if found is None else found.idle)
        kept[key] = found
        drop_oldest(kept, PLANS_KEPT)
    return found


def _is_key(option: Any) -> bool:
    """Return whether an option is left out or a positive float: zero and its negative would be one key."""
    return option is None or (isinstance(option, float) and option > 0.0)


def drop_oldest(kept: dict[Any, Any], most: int) -> None:
    """Drop the oldest entries beyond so many; other threads may do so too."""
    if len(kept) > most:
        for key in tuple(kept)[:-most]:
            kept.pop(key, None)
