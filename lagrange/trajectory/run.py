"""Run a compiled model: `integrate` for a Solution, `flow` for the state at the end as a plain function."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lagrange.errors import RunError, StatementError, counted, listing, shown
from lagrange.machine.backend import Driver, SingularMassMatrix
from lagrange.machine.model import Model, Stated, stated
from lagrange.machine.parameter_arrays import ordered
from lagrange.machine.state import NO_OUTPUTS, DriverState, Outcome, Outputs
from lagrange.statement.declare import initial_state
from lagrange.statement.display import announced, progress_bar
from lagrange.statement.event import declare_events
from lagrange.statement.expression import flag, real_array, real_number
from lagrange.statement.given.function import check_span, require_values
from lagrange.statement.rotation import check_moments
from lagrange.statement.run_settings import DEFAULT_METHOD, PreparationTooLongError, preparation
from lagrange.trajectory.constraints.consistent import consistent_start, moved_sentence, violation
from lagrange.trajectory.constraints.dependence import check_independent, dependent_passage, refuse_dependent
from lagrange.trajectory.constraints.discontinuities import may_be_discontinuous
from lagrange.trajectory.contact.run import run_through_contacts
from lagrange.trajectory.ending_messages import interrupted
from lagrange.trajectory.endings import table_left, with_resolution, with_singular_state_ahead, with_touching_bodies
from lagrange.trajectory.integrator import DEFAULT_OPTIONS, Integrator, Problem, RunOptions, memory_limit, run_by
from lagrange.trajectory.measures.conservation import energy, verified
from lagrange.trajectory.measures.stiffness import with_stiff_end
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.outputs import output_times
from lagrange.trajectory.plan import Plan, Planned, locates_events
from lagrange.trajectory.run_loop import MOST_STEPS_PER_CALL, not_begun
from lagrange.trajectory.segments import run_in_segments
from lagrange.trajectory.sizes import raise_to_noise, survey
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

_GOES_ON = (Outcome.PAUSED, Outcome.UNSCALED)

FIRST_STEPS = 1024
"""Number of steps of a flow before the first test of its pace. Interpreted steps take about a second for it."""

STEPS_RECORDED = 2**14
"""Largest number of steps of a flow with constraints. For a longer run the flow calls `integrate`."""

HOPELESS = 4.0
"""An adaptive run is stopped if it needs more than this multiple of max_steps, at its pace so far."""

_NO_TIMES, _NO_ROWS = np.empty(0), np.empty((0, 0))


class _Prepared(threading.local):
    """Memory of a flow between its runs in one thread: the driver, its state, and accepted states.

    `times` (k,) and `states` (k, 2n) have rows for the start and `STEPS_RECORDED` steps.
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
        # With events, switching surfaces or discontinuous constraints each call of the flow is a complete run.
        handled = plan is None or plan.watched or bool(model.statement.contacts) or may_be_discontinuous(model)
        self._plan: Plan | None = None if handled else plan
        # Fixed steps are not shortened near dependent constraints, so runs with fixed steps do not search for them.
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
            # A run names the velocities without inertia in its message.
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
        """Return the last output time, and all output times `times` as an array (N,).

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
                # Drivers write whole blocks, which may extend beyond the last row.
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

        The run goes from the state `y0` (2n,) at `t0` to `t1`. If `times` is None, the result has all accepted states.
        Raises RunError with the message of a run that failed.
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


def integrate(
    model: Model,
    span: Sequence[float],
    initial: Mapping[Any, Any] | None = None,
    *,
    method: Any = None,
    rtol: float | None = None,
    atol: float | None = None,
    t_eval: ArrayLike | None = None,
    events: Any = None,
    step: float | None = None,
    max_steps: int | None = None,
    max_wall: float | None = None,
    max_memory: float | None = None,
    parameters: Mapping[Any, Any] | None = None,
    progress: bool = False,
) -> Solution:
    """Integrate a model over `span` = (t0, t1), which may run backwards, and return the Solution.

    `initial` replaces entries of the statement's initial state, by coordinate, velocity or name. `method` is a
    registered name or an instance; `lg.methods.table()` lists them. Adaptive methods take `rtol` and `atol`, others a
    `step`. Without `atol` the absolute tolerance of an entry of the state follows its largest size so far. `t_eval`
    (k,) are the output times; without it every accepted step is stored. `events` are the events to locate. `parameters`
    replaces values of the statement's parameters. `max_steps` is the largest number of trial steps. `max_wall` is the
    time limit in seconds for the steps, and for compiling before them. `max_memory` is the largest number of bytes for
    stored steps, by default a quarter of the machine's memory. With `progress` a bar is shown.

    A failure during the run ends it: `solution.status` is the reason, and the states until then are kept. Raises
    StatementError for an invalid request.
    """
    return integrate_since(
        time.perf_counter(),
        model,
        span,
        initial,
        RunOptions(method, rtol, atol, step, t_eval, events, max_steps, max_wall, max_memory, parameters),
        progress=progress,
    )


def integrate_since(
    began: float, model: Model, span: Sequence[float], initial: Any, options: RunOptions, *, progress: bool
) -> Solution:
    """Integrate a model over the times `span` with the given options, and return the Solution.

    `initial` replaces entries of the stated initial state. `began` is the time of the request by `time.perf_counter`.
    """
    if flag(progress, "progress"):
        with progress_bar(time_span(span), enabled=True) as report:
            trajectory, values = trajectory_of(model, span, initial, options, progress=report, began=began)
    else:
        trajectory, values = trajectory_of(model, span, initial, options, began=began)
    try:
        explained = with_stiff_end(model, trajectory, values, float(span[1]))
    except KeyboardInterrupt:
        explained = interrupted(trajectory, span)
    return Solution(explained, model, values)


def compiled(system: Stated | Model, example: str, *, progress: bool | str = False) -> Model:
    """Return `system` itself if it is a model, else the model compiled from it.

    With `progress` a terminal shows a line if compiling takes long. Raises StatementError for a system with functions
    of time that have no values, and for an object that is not a system. The error message then suggests the built-in
    system with the name `example`.
    """
    statement = stated(system, example)
    require_values(statement)
    with announced("compiling", statement.name, enabled=bool(progress)):
        return system if isinstance(system, Model) else system.compile()


def run_stated(
    system: Stated,
    t_start: float,
    t_end: float | None,
    initial: Any,
    options: RunOptions,
    target: str,
    *,
    check: bool,
    progress: bool,
) -> Solution:
    """Compile a system for the machine `target` and run it from `t_start` to `t_end`, for `lagrange.System.run`.

    `initial` replaces entries of the stated initial state. If `check`, the compiled accelerations are tested first. A
    `t_end` or an option that is None comes from the system's scene.
    """
    began, scene = time.perf_counter(), system.statement.run
    end = scene.t_end if t_end is None else real_number(t_end, "t_end, the time at which the run ends,")
    chosen = scene.method or DEFAULT_METHOD if options.method is None else options.method
    defaults: dict[str, Any] = {"method": chosen, "events": scene.events}
    if isinstance(chosen, str):
        adaptive = find(chosen).claims.adaptive
        defaults |= {"rtol": scene.rtol, "atol": scene.atol} if adaptive else {"step": scene.step}
    options = options._replace(**{name: x for name, x in defaults.items() if getattr(options, name) is None})
    with announced("compiling", system.statement.name, enabled=flag(progress, "progress")):
        try:
            with preparation(began, options.wall_limit):
                model = system.compile(target, check=check)
        except PreparationTooLongError as late:
            # The run ends before its first step, with a status.
            if late.model is None:
                raise RunError(str(late)) from None
            model = late.model
    return integrate_since(began, model, (t_start, end), initial, options, progress=progress)


def flow(
    model: Model,
    *,
    method: Any = None,
    rtol: float | None = None,
    atol: float | None = None,
    step: float | None = None,
    max_steps: int | None = None,
) -> Flow:
    """Prepare the flow of a model: a function of (y0, t0, t1, parameters=None) that maps y0 (2n,) to y1 (2n,).

    For a list of N times in place of t1 it returns the states (2n, N) at these times. The driver is prepared once: a
    call costs a few microseconds in addition to its steps. Calls raise RunError if the run does not reach t1. Raises
    StatementError for an unknown method, or a setting that it does not use.
    """
    return Flow(model, RunOptions(method, rtol, atol, step, max_steps=max_steps))


def trajectory_of(
    model: Model,
    span: Sequence[float],
    initial: Mapping[Any, Any] | None = None,
    options: RunOptions = DEFAULT_OPTIONS,
    *,
    progress: Callable[[float], None] | None = None,
    began: float | None = None,
) -> tuple[Trajectory, dict[Any, float]]:
    """Run a model over a span of time. Return the trajectory and the values of the parameters.

    `progress` is called with the time that the run has reached. `began` is the time of the request by `perf_counter`.
    Raises StatementError for an invalid request. A failure during the run sets the status of the trajectory.
    """
    if not isinstance(model, Model):
        raise StatementError(f"{shown(model)} is not a compiled model: give system.compile(), or call system.run().")
    (t0, t1), statement = time_span(span), model.statement
    require_values(statement)
    check_span(statement, t0, t1)
    values = model.parameter_values(options.parameters)
    for name in statement.rotations if options.parameters else ():
        check_moments(statement.kinetic, name, values)
    stated_start = np.array(initial_state({} if initial is None else initial, statement.coordinates, statement.initial))
    start, constrained = stated_start, bool(model.equations.constraints)
    began = time.perf_counter() if began is None else began
    if constrained:
        # If the search for the start exceeds the time limit, it is unchanged: the run then ends before its first step.
        with suppress(PreparationTooLongError), preparation(began, options.wall_limit):
            start = consistent_start(model, t0, stated_start, ordered(values, statement.parameters))
    problem = Problem(
        model=model,
        parameters=values,
        t0=t0,
        t1=t1,
        y0=start,
        t_eval=output_times(options.t_eval, t0, t1, model.layout.size),
        rtol=options.rtol,
        atol=options.atol,
        step=options.step,
        max_steps=options.step_limit,
        max_wall=options.wall_limit,
        max_memory=options.memory_limit,
        events=declare_events(options.events, statement),
        progress=progress,
        began=began,
    )
    integrator = find(DEFAULT_METHOD if options.method is None else options.method)
    _check_request(problem, integrator)
    if statement.contacts:
        trajectory = run_through_contacts(problem, integrator, _run)
    elif any(event.settings for event in problem.events):
        trajectory = run_in_segments(problem, partial(_run, integrator))
    else:
        trajectory = _run(integrator, problem)
    # Test the whole run, because over a short segment all coordinates change only by rounding.
    trajectory = with_resolution(problem, trajectory)
    if start is not stated_start:
        trajectory = replace(trajectory, message=f"{trajectory.message}{moved_sentence(model, stated_start, start)}")
    return trajectory, values


def _run(integrator: Integrator, problem: Problem) -> Trajectory:
    """Run a problem with constant parameters, check its result, and return the trajectory."""
    model, constrained = problem.model, bool(problem.model.equations.constraints)
    try:
        with preparation(problem.began, problem.max_wall):
            before = _check_start(problem)
            if constrained:
                check_independent(model, problem.t0, problem.y0, problem.parameter_array)
    except PreparationTooLongError as late:
        return not_begun(problem, integrator.name, str(late))
    trajectory = run_by(integrator, problem)
    if trajectory.status is Status.DIVERGED and constrained:
        trajectory = with_singular_state_ahead(problem, trajectory, partial(run_by, find("dop853")))
    if trajectory.status is Status.SINGULAR and not trajectory.steps and constrained:
        refuse_dependent(model, problem.t0, problem.y0, problem.parameter_array)
    if trajectory.status.complete and constrained and trajectory.y.size:
        t, y = float(trajectory.t[-1]), np.ascontiguousarray(trajectory.y[:, -1])
        fastest = np.abs(trajectory.y[model.layout.v]).max(axis=1)
        if off := violation(model, t, y, problem.parameter_array, abs(t - problem.t0), fastest):
            trajectory = replace(trajectory, status=Status.UNRELIABLE, message=f"{trajectory.message} {off}")
    if len(problem.events) > 1:
        trajectory = with_touching_bodies(problem, trajectory)
    return verified(problem, trajectory, before, adaptive=integrator.claims.adaptive)


def _check_request(problem: Problem, integrator: Integrator) -> None:
    """Raise StatementError for output times that do not fit into memory, and for events that cannot be located."""
    if problem.t_eval is not None:
        size, limit = 8 * len(problem.t_eval) * (len(problem.y0) + 1), memory_limit(problem)
        if size > limit:
            raise StatementError(
                f"t_eval has {len(problem.t_eval)} times, which take {size:.4g} bytes with their states, more than "
                f"max_memory = {limit:.6g} bytes: give fewer times, raise max_memory, or run the span in parts."
            )
    if problem.events and not locates_events(integrator):
        raise StatementError(
            f"{integrator.name} does not locate events: use {DEFAULT_METHOD} or another method that does, such as "
            "dop853, or leave events out and search the values of solution.at(t) for the crossing."
        )


def _check_start(problem: Problem) -> float:
    """Return the energy of the initial state. Raises StatementError if it is not finite."""
    model, y0 = problem.model, problem.y0
    value = energy(problem, y0)
    if math.isfinite(value):
        return value
    if outside := table_left(problem, problem.t0, y0):
        raise StatementError(f"the motion cannot start at the initial state: {outside}")
    state = listing(f"{name} = {x:.6g}" for name, x in zip(model.layout.names(".dot"), y0, strict=True))
    raise StatementError(
        f"the energy of {model.statement.name} is {value} at the initial state ({state}), so the motion cannot start "
        "there. Look for an overflow, a division by zero, or a sqrt or log outside its domain, in the kinetic and "
        "potential energy; give another initial state or other parameters."
    )


def time_span(span: Sequence[float]) -> tuple[float, float]:
    """Return the first and the last time. Raises StatementError if these are not two numbers."""
    is_list = type(span) is tuple or (span.ndim == 1 if isinstance(span, np.ndarray) else isinstance(span, Sequence))
    if not is_list or isinstance(span, (str, bytes)) or len(span) != 2:
        raise StatementError(f"the time span is {shown(span)}: give two times, such as (0.0, 10.0).")
    return real_number(span[0], "the first time"), real_number(span[1], "the last time")


def span_or_end(span: float | Sequence[float]) -> tuple[float, float]:
    """Return the first and the last time of a span. If `span` is a number, the first time is 0."""
    if isinstance(span, (Sequence, np.ndarray)):
        return time_span(span)
    return 0.0, real_number(span, "t_end")
