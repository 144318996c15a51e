"""What a method prepares for a run: its tolerances, and a driver for a model and its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from lagrange.machine.backend import Driver, SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.procedure.step.constants import AFTER_BROKEN
from lagrange.program.actions import LAWS
from lagrange.program.step import StepProgram
from lagrange.trajectory.events.ending import EventResult
from lagrange.trajectory.events.event_loop import WatchedEvents
from lagrange.trajectory.events.step_watch import StepWatch
from lagrange.trajectory.integrator import Claims, Integrator, Problem
from lagrange.trajectory.outputs import FollowedSteps
from lagrange.trajectory.paths.step_paths import MotionsPath, StepPath
from lagrange.trajectory.tolerances import Tolerances
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
