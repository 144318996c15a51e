"""The flow of a model as a function of the initial state, for shooting, maps and benchmarks."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lagrange.errors import RunError, StatementError, counted, shown
from lagrange.machine.backend import Driver, SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.machine.state import NO_OUTPUTS, DriverState, Outcome, Outputs
from lagrange.statement.expression import real_array, real_number
from lagrange.statement.given.function import check_span, require_values
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.trajectory.constraints.consistent import consistent_start
from lagrange.trajectory.constraints.dependence import check_independent, dependent_passage
from lagrange.trajectory.constraints.discontinuities import may_be_discontinuous
from lagrange.trajectory.contact.run import run_through_contacts
from lagrange.trajectory.integrator import DEFAULT_OPTIONS, Problem, RunOptions, run_by
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.outputs import output_times
from lagrange.trajectory.plan import Plan, Planned
from lagrange.trajectory.run_loop import MOST_STEPS_PER_CALL
from lagrange.trajectory.sizes import raise_to_noise, survey
from lagrange.trajectory.trajectory import FloatArray

_GOES_ON = (Outcome.PAUSED, Outcome.UNSCALED)

FIRST_STEPS = 1024
"""Number of steps before the first test of the pace of a run: one second for interpreted steps."""

STEPS_RECORDED = 2**14
"""Number of steps in which a run with constraints has to reach its end; a longer one is repeated by `integrate`."""

HOPELESS = 4.0
"""An adaptive run is stopped if it needs more than this multiple of max_steps, at its pace so far."""

_NO_TIMES, _NO_ROWS = np.empty(0), np.empty((0, 0))


class _Prepared(threading.local):
    """Memory of a flow between its runs in one thread: the driver, its state, and accepted states.

    `times` (k,) and `states` (k, 2n) have enough rows for the start and `STEPS_RECORDED` steps.
    """

    driver: Driver | None = None
    parameters: Mapping[Any, Any] | None = None
    state: DriverState
    times: FloatArray
    states: FloatArray


class Flow:
    """Function of (y0, t0, t1, parameters) that returns the state (2n,) at t1 of the run from (t0, y0).

    For a list of N times in place of t1 it returns the states (2n, N) at these times. Threads may share a flow.
    """

    def __init__(self, model: Model, options: RunOptions = DEFAULT_OPTIONS) -> None:
        if not isinstance(model, Model):
            raise StatementError(f"{shown(model)} is not a compiled model: give system.compile().")
        require_values(model.statement)
        self._integrator = find(DEFAULT_METHOD if options.method is None else options.method)
        self._options = options._replace(method=self._integrator)
        self._model = model
        self._dimension = model.layout.size
        self._constrained = bool(len(model.equations.constraints))
        self._given = bool(model.statement.given)
        self._max_steps = options.step_limit
        self._local = _Prepared()
        unit = Problem(
            model=model,
            parameters={},
            t0=0.0,
            t1=1.0,
            y0=np.zeros(self._dimension),
            rtol=options.rtol,
            atol=options.atol,
            step=options.step,
            max_steps=self._max_steps,
        )
        self._problem = unit
        plan = self._integrator.plan(unit) if isinstance(self._integrator, Planned) else None
        # Events, switching surfaces and discontinuous constraints require a whole run: then each call is a run.
        handled = plan is None or plan.watched or bool(model.statement.contacts) or may_be_discontinuous(model)
        self._plan: Plan | None = None if handled else plan
        # Equal steps are not shortened towards a crossing of motions, and runs do not search for one either.
        self._rtol = 0.0 if plan is None or not self._constrained else plan.tolerances.rtol

    def __repr__(self) -> str:
        return f"<Flow of {self._model.statement.name} by {self._integrator.name}: a function of (y0, t0, t1)>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Flow, (self._model, self._options)

    def __call__(
        self, y0: ArrayLike, t0: float, t1: ArrayLike, parameters: Mapping[Any, Any] | FloatArray | None = None
    ) -> FloatArray:
        """Return the state at t1, (2n,), of the run that starts at time `t0` from the state `y0` (2n,).

        Raises RunError with the message of a run that does not reach t1. If t1 is a list of N times, sorted in the
        direction of the run, the result has the states (2n, N) there. `parameters` is a dict from parameter to value,
        or an array (k,) of all values in the statement's order. A start that misses the constraints by rounding is
        moved onto them. If it misses a constraint by more, StatementError names this constraint.
        """
        if isinstance(parameters, (np.ndarray, list, tuple)):
            parameters = self._named(parameters)
        start = real_array(y0, "y0")
        if start.shape != (self._dimension,):
            advice = " A flow takes one state; lg.ensemble runs many." if start.ndim > 1 else ""
            raise StatementError(f"y0 has shape {start.shape}: give [q, v] of shape ({self._dimension},).{advice}")
        times = None
        if type(t0) is not float or type(t1) is not float or not math.isfinite(t1 - t0):
            t0 = real_number(t0, "the first time")
            several = (
                t1.ndim if isinstance(t1, np.ndarray) else isinstance(t1, Sequence) and not isinstance(t1, (str, bytes))
            )
            t1, times = self._last(t0, t1) if several else (real_number(t1, "the last time"), None)
        if self._given:
            check_span(self._model.statement, t0, t1)
        if self._constrained:
            array = self._model.parameter_array(parameters)
            start = consistent_start(self._model, t0, start, array)
            check_independent(self._model, t0, start, array)
        if t0 == t1:
            return start.copy() if times is None else np.repeat(start[:, None], len(times), axis=1)
        if self._plan is None or (times is not None and not (self._plan.writes_outputs and not self._constrained)):
            states = self._by_run(start, t0, t1, parameters, times)
            return states[:, -1].copy() if times is None else states
        try:
            driver, state = self._driver(self._plan, parameters)
        except SingularMassMatrix:
            # A run says in its message which motion has no inertia.
            self._by_run(start, t0, t1, parameters)
            raise
        settings, length = self._plan.tolerances, abs(t1 - t0)
        # The default step is a fraction of the span; it was prepared for a span of 1.
        step = settings.step * (length if self._problem.step is None and settings.notes else 1.0)
        signed = step if t1 >= t0 else -step
        state.restart(self._first, (t0, t1), start, signed, settings.longest * length)
        if times is not None:
            return self._at_times(driver, state, start, (t0, t1), parameters, times)
        if self._rtol:
            reached = self._to_end_on_constraints(driver, state, parameters, start)
        else:
            reached = self._to_end(driver, state, parameters)
        return state.y.copy() if reached else self._by_run(start, t0, t1, parameters)[:, -1].copy()

    def _named(self, values: FloatArray | Sequence[float]) -> dict[Any, float]:
        """Return {parameter: value} for an array (k,) of values. Raises StatementError for a list or tuple."""
        parameters = self._model.statement.parameters
        if not isinstance(values, np.ndarray):
            raise StatementError(
                f"parameters is a {type(values).__name__}: give a dict from parameter to value, or a NumPy array of "
                f"{counted(len(parameters), 'value')} in the order of model.statement.parameters."
            )
        return dict(zip(parameters, self._model.parameter_array(values).tolist(), strict=True))

    def _last(self, t0: float, times: ArrayLike) -> tuple[float, FloatArray]:
        """Return the last of the output times `times`, and all of them as an array (N,).

        Raises StatementError for times that are not sorted in one direction from `t0`.
        """
        last = real_array(times, "the times").ravel()[-1:]
        t1 = float(last[0]) if last.size else t0
        checked = output_times(times, t0, t1, self._dimension)
        return t1, np.empty(0) if checked is None else checked

    def _at_times(
        self,
        driver: Driver,
        state: DriverState,
        start: FloatArray,
        span: tuple[float, float],
        parameters: Mapping[Any, Any] | None,
        times: FloatArray,
    ) -> FloatArray:
        """Return the states (2n, N) at the output times `times` (N,) of a run from the state `start` (2n,).

        The run goes over `span` (t0, t1). `driver` advances it, with `state` as its memory, and writes the states at
        output times during its steps. If the driver does not reach the end, `integrate` repeats the run.
        """
        state.outputs = outputs = Outputs(times, self._dimension)
        try:
            if self._to_end(driver, state, parameters):
                end = state.y[:, None].copy()
                return outputs.joined(times, lambda _rest: end)
        finally:
            state.outputs = NO_OUTPUTS
        return self._by_run(start, *span, parameters, times)

    def _to_end(self, driver: Driver, state: DriverState, parameters: Mapping[Any, Any] | None) -> bool:
        """Advance a run from its start to its end. Return True if the end is reached.

        The result is False if the driver stops before, or if the run is slow because of rounding noise.
        """
        outcome, left, steps = Outcome.PAUSED, self._max_steps, FIRST_STEPS
        while outcome in _GOES_ON and left > 0:
            outcome = driver.advance(state, min(left, steps), _NO_TIMES, _NO_ROWS)
            left, steps = left - steps, MOST_STEPS_PER_CALL
            if outcome is Outcome.PAUSED and self._stays_slow(state, self._max_steps - left):
                return False
            if outcome is Outcome.UNSCALED:
                survey(self._model, self._model.parameter_array(parameters), state)
        return outcome is Outcome.DONE

    def _to_end_on_constraints(
        self, driver: Driver, state: DriverState, parameters: Mapping[Any, Any] | None, start: FloatArray
    ) -> bool:
        """Advance a run with constraints and step control from `start` (2n,). Return True if it reaches its end.

        Return False if the run needs many steps. Also return False if it passes dependent constraints, since rounding
        decides the motion after them.
        """
        local, counts = self._local, state.integers
        local.times[0], local.states[0] = state.t, start
        counts[DriverState.RECORD], counts[DriverState.ROWS] = 1, 0
        budget = min(self._max_steps, STEPS_RECORDED)
        if driver.advance(state, budget, local.times[1:], local.states[1:]) is not Outcome.DONE:
            return False
        written, array = slice(counts[DriverState.ROWS] + 1), self._model.parameter_array(parameters)
        times, states = local.times[written], local.states[written]
        return dependent_passage(self._model, times, states, array, self._rtol) is None

    def _stays_slow(self, state: DriverState, steps: int) -> bool:
        """Return True if a run is slow because of rounding noise. `steps` is its number of steps so far.

        The caller then repeats the run by `integrate`, which gives small entries a coarser tolerance. A run that is
        slow for another reason raises RunError if it would need more than `max_steps` at its pace so far.
        """
        t0, t1 = (float(state.reals[index]) for index in (DriverState.START, DriverState.END))
        share = (state.t - t0) / (t1 - t0)
        most = self._max_steps * (HOPELESS if self._integrator.claims.adaptive else 1.0)
        if steps < self._max_steps and steps > most * share:
            if raise_to_noise(self._model, self._model.parameter_array(self._local.parameters), state):
                return True
            needed = f"about {steps / share:.1g}" if share > 0 else "endlessly many"
            raise RunError(
                f"{self._integrator.name} came from t = {t0:g} to {state.t:g} in {steps} steps. At this pace the end, "
                f"t = {t1:g}, takes {needed}, more than max_steps = {self._max_steps}: end earlier, or raise max_steps."
            )
        return False

    def _driver(self, plan: Plan, parameters: Mapping[Any, Any] | None) -> tuple[Driver, DriverState]:
        local, model = self._local, self._model
        if local.driver is None or local.parameters != parameters:
            local.driver = plan.driver(model, model.parameter_array(parameters))
            local.parameters = None if parameters is None else dict(parameters)
            # Every run of the flow starts from a copy of a state for a run from 0 to 1.
            local.state = plan.tolerances.begin(0.0, 1.0, np.zeros(self._dimension))
            local.state.counts[:] = 0
            self._first = local.state.reals.copy()
            local.driver.adopt(local.state)
            if self._rtol:
                # There are spare rows, because drivers write whole blocks.
                local.times = np.empty(STEPS_RECORDED + 6)
                local.states = np.empty((STEPS_RECORDED + 6, self._dimension))
        return local.driver, local.state

    def _by_run(
        self,
        y0: FloatArray,
        t0: float,
        t1: float,
        parameters: Mapping[Any, Any] | None,
        times: FloatArray | None = None,
    ) -> FloatArray:
        """Return the states (2n, N) at `times` (N,) of a run by `integrate`, which is slower but handles all cases.

        If `times` is None, the result has all accepted states. Raises RunError with the message of a run that failed.
        """
        values = self._model.parameter_values(parameters)
        problem = replace(self._problem, t0=t0, t1=t1, y0=y0, parameters=values, t_eval=times)
        if self._model.statement.contacts:
            trajectory = run_through_contacts(problem, self._integrator, run_by)
        else:
            trajectory = run_by(self._integrator, problem)
        if not trajectory.status.complete:
            raise RunError(trajectory.message)
        return trajectory.y
