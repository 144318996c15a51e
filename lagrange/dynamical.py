"""Functions that show the dynamics of a system: portraits, sections and bifurcations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lagrange.dynamics.branches import equilibrium_branches
from lagrange.dynamics.driving import depends_on_time
from lagrange.dynamics.portrait import CELLS as CELLS_OF_PLANE
from lagrange.dynamics.portrait import portrait
from lagrange.dynamics.runs import Runs
from lagrange.dynamics.section import point_counts
from lagrange.dynamics.section import section as section_of
from lagrange.dynamics.sweep import parameter_of, sweep, values_of, with_value
from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.show.dynamics import (
    Bifurcation,
    EquilibriumBranches,
    PhasePortrait,
    PoincareSection,
    shown_as,
)
from lagrange.statement.number import flag, real_number, whole_number
from lagrange.statement.statement import Statement
from lagrange.system import System
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.settings import check_options
from lagrange.trajectory.options import RunOptions
from lagrange.trajectory.progress import counter, wanted_progress
from lagrange.trajectory.run import compiled

TIGHT, USUAL = 1e-12, 1e-9
"""Default relative tolerances: for portraits and sections, whose orbits visibly close, and for bifurcations."""

ORBIT_STEPS = 20_000
"""Default limit of steps for an orbit of a portrait with an adaptive method: thousands of oscillations."""


def phase_portrait(
    system: System | Model,
    window: Mapping[Any, Any] | None = None,
    *,
    at: Mapping[Any, Any] | None = None,
    starts: Any = None,
    parameters: Mapping[Any, Any] | None = None,
    t: float = 0.0,
    t_end: float | None = None,
    method: Any = None,
    rtol: float | None = None,
    step: float | None = None,
    max_steps: int | None = None,
    progress: bool | str = False,
) -> PhasePortrait:
    """Return the phase portrait on a plane of the state: field, nullclines, equilibria, separatrices and orbits.

    `window` gives two entries of the state with their ranges, {theta: (-3, 3), theta.dot: (-5, 5)}. The first is the
    horizontal axis; (low, high, count) sets the number of arrows. By default, for a system with one coordinate, the
    window contains the equilibria and the motions between them. For more coordinates the portrait is a slice: `at`
    fixes all other entries, {phi: 0, phi.dot: 0}, and orbits leave the plane. `starts` are initial states, dicts or
    rows (m, 2n); by default orbits fill the plane evenly. Each orbit is followed forwards and backwards until it leaves
    the window, closes, or ends after the time `t_end` or after `max_steps` steps, which the message reports. Their
    defaults are 20 periods of small motions and, unless `step` is given, 20,000 steps. A coordinate with a period of 2
    pi is an angle, and is wrapped.

    Separatrices begin on the eigenvectors of a saddle, with an error below 1e-10 of the window. For a system that
    depends on time, the field is that of the time `t`, at which orbits begin. Ctrl-C keeps the finished parts, with
    `Status.INTERRUPTED`. Raises StatementError for an invalid plane.
    """
    _, runs = _runs(system, (method, rtol, step), TIGHT, parameters, progress, _limit(max_steps, step))
    reach = None if t_end is None else _positive(t_end, "t_end, the time for which orbits are followed,")
    total, noun = (CELLS_OF_PLANE**2, "cell") if starts is None else (_length(starts), "orbit")
    with counter(total, noun, wanted=progress) as report:
        data = portrait(runs, window, at, starts, time=real_number(t, "t"), reach=reach, progress=report)
    return shown_as(PhasePortrait, data)


def poincare(
    system: System | Model,
    event: Any,
    starts: Any = None,
    *,
    crossings: int = 500,
    skip: int = 0,
    energy: float | None = None,
    solve_for: Any = None,
    longest: float | None = None,
    parameters: Mapping[Any, Any] | None = None,
    method: Any = None,
    rtol: float | None = None,
    step: float | None = None,
    progress: bool | str = False,
) -> PoincareSection:
    """Return the Poincare section of orbits from many starts: their states each time an event happens.

    `event` is an expression that is zero on the section, or `lg.event(x, direction=1)` for one direction of crossing. A
    number, or an expression in parameters such as 2*pi/w, is a sampling period instead, as for a driven system.
    `starts` are initial states, a list of dicts or rows (m, 2n); a dict overlays the initial state of the system. With
    `energy` all starts have that energy: the velocity `solve_for` follows from it, in the direction of the event. Each
    orbit is followed for `skip` crossings, and then for `crossings` that are kept. It ends early if no crossing occurs
    within the time `longest`, 200 periods of small motions by default. With a sampling period, 300,000 points or more
    of several starts are computed in parallel as in `lagrange.ensemble`.

    The result has `times` and `states`, (k,) and (k, 2n) for each start, `points` of all, and `plot(x, y)`. Ctrl-C
    keeps the finished orbits. Raises StatementError for an invalid section, and for starts whose energy is too high.
    """
    _, runs = _runs(system, (method, rtol, step), TIGHT, parameters, progress)
    with counter(_length(starts), "orbit", wanted=progress) as report:
        data = section_of(
            runs,
            event,
            starts,
            crossings=crossings,
            skip=skip,
            energy=energy,
            solve_for=solve_for,
            longest=longest,
            progress=report,
        )
    return shown_as(PoincareSection, data)


def bifurcation(
    system: System | Model,
    parameter: Any,
    values: ArrayLike,
    *,
    section: Any = None,
    starts: Any = None,
    points: int = 64,
    skip: int = 200,
    follow: bool = True,
    parameters: Mapping[Any, Any] | None = None,
    method: Any = None,
    rtol: float | None = None,
    step: float | None = None,
    progress: bool | str = False,
) -> Bifurcation | EquilibriumBranches:
    """Return the bifurcation diagram of a system along a parameter.

    `values` are a list, or (low, high, count), in any order. A system that is driven in time is sampled after each
    period of its driving. The period follows from the sines and cosines of time, or is given as `section`. With an
    event as `section`, as in `poincare`, any system is sampled at its crossings. At each value the orbits from `starts`
    are followed for `skip` samples, and then for `points` samples that are kept. With `follow` they begin where the
    orbits of the previous value ended, so that rising and falling values show hysteresis. Without it, if all values
    have one period, 300,000 points or more are computed in parallel as in `lagrange.ensemble`. The result has `states`
    (k, m, points, 2n), and `cycles` (k, m), the number of points after which each orbit repeats.

    For a system without driving and without a section the result shows its equilibria: `branches`, with formulas where
    they are found, and stability.

    Ctrl-C keeps the finished values. Raises StatementError for an unknown parameter, and for an empty range.
    """
    model, runs = _runs(system, (method, rtol, step), USUAL, parameters, progress)
    name = parameter_of(model.statement, parameter)
    chosen = values_of(values, name)
    count, dropped = point_counts(points, skip, "points", 2)
    followed = flag(follow, "follow")
    place = [p.name for p in model.statement.parameters].index(name)
    for value in chosen.tolist():
        with_value(runs, place, value)  # refuse an invalid value of the parameter before the first run
    if section is None and not depends_on_time(model.statement):
        if starts is not None:
            raise StatementError(
                f"{model.statement.name} is not driven, and its equilibria have no starts: give section=..., an event "
                "at which its motion is looked at, or leave starts out."
            )
        with counter(3, "value", wanted=progress) as report:
            return shown_as(EquilibriumBranches, equilibrium_branches(name, chosen, _at(model, runs, name), report))
    with counter(len(chosen), "value", wanted=progress) as report:
        data = sweep(
            runs, name, chosen, section, starts, count=count, dropped=dropped, followed=followed, progress=report
        )
    return shown_as(Bifurcation, data)


def _runs(
    system: System | Model,
    how: tuple[Any, Any, Any],
    tight: float,
    parameters: Mapping[Any, Any] | None,
    progress: bool | str,
    max_steps: int | None = None,
) -> tuple[Model, Runs]:
    """Return the model of a system, and its runs. `how` is (method, rtol, step); `tight` is the default of rtol."""
    method, rtol, step = how
    if rtol is None and (method is None or (isinstance(method, str) and find(method).claims.adaptive)):
        rtol = tight
    model = compiled(system, "pendulum", progress=wanted_progress(progress))
    options = RunOptions(method, rtol, None, step, max_steps=max_steps)
    check_options(step, rtol)
    if method is not None:
        find(method)
    if max_steps is not None:
        whole_number(max_steps, "max_steps", 1)
    return model, Runs(model, model.parameter_array(parameters), options)


def _limit(max_steps: int | None, step: float | None) -> int | None:
    """Return the limit of steps of an orbit: `max_steps`, else `ORBIT_STEPS` for adaptive methods."""
    return ORBIT_STEPS if max_steps is None and step is None else max_steps


def _at(model: Model, runs: Runs, name: str) -> Callable[[float], tuple[Statement, Model]]:
    """Return a function of a value of the parameter `name` that returns the statement and a model with that value."""
    statement = model.statement
    values = dict(zip(statement.parameters, runs.parameters.tolist(), strict=True))
    chosen = next(p for p in statement.parameters if p.name == name)

    def at(value: float) -> tuple[Statement, Model]:
        system = System.from_statement(replace(statement, defaults=MappingProxyType({**values, chosen: value})))
        return system.statement, system.compile("numpy", check=False)

    return at


def _positive(given: Any, what: str) -> float:
    number = real_number(given, what)
    if number <= 0:
        raise StatementError(f"{what} is {number:g}: give a positive number.")
    return number


def _length(starts: Any) -> int:
    many = isinstance(starts, (list, tuple)) or (isinstance(starts, np.ndarray) and starts.ndim > 0)
    return max(len(starts), 1) if many else 1
