"""Run a compiled model: `integrate` for a Solution, `flow` for the state at the end as a plain function."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import ArrayLike

from lagrange.errors import RunError
from lagrange.machine.model import Model, Stated, stated
from lagrange.statement.given.function import require_values
from lagrange.statement.number import flag, real_number
from lagrange.statement.progress import compiling, progress_bar
from lagrange.statement.run_settings import DEFAULT_METHOD, PreparationTooLongError, preparation
from lagrange.trajectory.flow import Flow
from lagrange.trajectory.integrate import integrate as trajectory_of
from lagrange.trajectory.integrate import time_span
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.measures.stiffness import with_stiff_end
from lagrange.trajectory.messages import interrupted
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.solution import Solution


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
    `step`. Without `atol` the absolute tolerance of an entry of the state follows its largest size so far.
    `t_eval` (k,) are the output times; without it every accepted step is kept. `max_steps` is the largest number of
    tried steps. `max_wall` is the time limit in seconds for the steps, and for compiling before them. `max_memory`
    is the largest number of bytes for kept steps, by default a quarter of the machine's memory. A failure during the
    run ends it: `solution.status` says how, and the states until then are kept. Raises StatementError for an invalid
    request.
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
    """Integrate as `integrate` does; `began` is the time of the request by `time.perf_counter`."""
    if flag(progress, "progress"):
        with progress_bar(time_span(span), wanted=True) as report:
            trajectory, values = trajectory_of(model, span, initial, options, progress=report, began=began)
    else:
        trajectory, values = trajectory_of(model, span, initial, options, began=began)
    try:
        explained = with_stiff_end(model, trajectory, values, float(span[1]))
    except KeyboardInterrupt:
        explained = interrupted(trajectory, span)
    return Solution(explained, model, values)


def compiled(system: Stated | Model, example: str, *, progress: bool | str = False) -> Model:
    """Return a model as it is, and a system compiled. `progress` says on a terminal that this takes long.

    Raises StatementError for anything else, with the scene `example`, and for given functions without values.
    """
    statement = stated(system, example)
    require_values(statement)
    with compiling(statement.name, wanted=bool(progress)):
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
    """Compile a system and run it, as `lagrange.System.run`. Options that are None come from the system's scene."""
    began, scene = time.perf_counter(), system.statement.run
    end = scene.t_end if t_end is None else real_number(t_end, "t_end, the time at which the run ends,")
    chosen = scene.method or DEFAULT_METHOD if options.method is None else options.method
    options = replace(options, method=chosen, events=scene.events if options.events is None else options.events)
    if isinstance(chosen, str):
        if find(chosen).claims.adaptive:
            rtol, atol = scene.rtol if options.rtol is None else options.rtol, options.atol
            options = replace(options, rtol=rtol, atol=scene.atol if atol is None else atol)
        elif options.step is None:
            options = replace(options, step=scene.step)
    with compiling(system.statement.name, wanted=flag(progress, "progress")):
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

    The driver is prepared once: a call costs a few microseconds beside the steps themselves. Calls raise RunError if
    the run does not reach t1. Raises StatementError for an unknown method or a setting that it does not take.
    """
    return Flow(model, RunOptions(method, rtol, atol, step, max_steps=max_steps))
