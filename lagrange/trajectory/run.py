"""Run a compiled model: `integrate` for a Solution, `flow` for the state at the end as a plain function.

The request of a run is checked here.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lagrange.errors import RunError, StatementError, listing, shown
from lagrange.machine.model import Model, Stated, stated
from lagrange.machine.parameters import ordered
from lagrange.statement.declare import initial_state
from lagrange.statement.display import announced, progress_bar
from lagrange.statement.event import declare_events
from lagrange.statement.expression import flag, real_number
from lagrange.statement.given.function import check_span, require_values
from lagrange.statement.rotation import check_moments
from lagrange.statement.run_settings import DEFAULT_METHOD, PreparationTooLongError, preparation
from lagrange.trajectory.constraints.consistent import consistent_start, moved_sentence, violation
from lagrange.trajectory.constraints.dependence import check_independent, refuse_dependent
from lagrange.trajectory.contact.run import run_through_contacts
from lagrange.trajectory.ending_messages import interrupted
from lagrange.trajectory.endings import table_left, with_resolution, with_singular_state_ahead, with_touching_bodies
from lagrange.trajectory.flow import Flow
from lagrange.trajectory.integrator import DEFAULT_OPTIONS, Integrator, Problem, RunOptions, memory_limit, run_by
from lagrange.trajectory.measures.conservation import energy, verified
from lagrange.trajectory.measures.stiffness import with_stiff_end
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.outputs import output_times
from lagrange.trajectory.plan import locates_events
from lagrange.trajectory.run_loop import not_begun
from lagrange.trajectory.segments import run_in_segments
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status, Trajectory


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
    (k,) are the output times; without it every accepted step is stored. `max_steps` is the largest number of trial
    steps. `max_wall` is the time limit in seconds for the steps, and for compiling before them. `max_memory` is the
    largest number of bytes for stored steps, by default a quarter of the machine's memory.

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

    `initial` replaces entries of the statement's initial state. `began` is the time of the request by
    `time.perf_counter`.
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
    """Run a model over a span of time; return the trajectory and the values of the parameters.

    `progress` is called with the time that the run has reached; `began` is the time of the request by `perf_counter`.
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
    _check_memory(problem)
    integrator = find(DEFAULT_METHOD if options.method is None else options.method)
    _check_events(problem, integrator)
    if statement.contacts:
        trajectory = run_through_contacts(problem, integrator, _run)
    elif any(event.settings for event in problem.events):
        trajectory = run_in_segments(problem, partial(_run, integrator))
    else:
        trajectory = _run(integrator, problem)
    # Tested for the whole run, because over a short segment all coordinates change only by rounding.
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


def _check_events(problem: Problem, integrator: Integrator) -> None:
    """Raise StatementError for events if the method cannot locate them."""
    if problem.events and not locates_events(integrator):
        raise StatementError(
            f"{integrator.name} does not locate events: use {DEFAULT_METHOD} or another method that does, such as "
            "dop853, or leave events out and search the values of solution.at(t) for the crossing."
        )


def _check_memory(problem: Problem) -> None:
    """Raise StatementError for output times that do not fit into the memory of the run."""
    if problem.t_eval is None:
        return
    size, limit = 8 * len(problem.t_eval) * (len(problem.y0) + 1), memory_limit(problem)
    if size > limit:
        raise StatementError(
            f"t_eval has {len(problem.t_eval)} times, which take {size:.4g} bytes with their states, more than "
            f"max_memory = {limit:.6g} bytes: give fewer times, raise max_memory, or run the span in parts."
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
    """Return the first and the last time of a span; 0 and `span` if it is a number."""
    if isinstance(span, (Sequence, np.ndarray)):
        return time_span(span)
    return 0.0, real_number(span, "t_end")
