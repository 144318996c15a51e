"""Compute bifurcation diagrams: points of the motion after its transients, on a section, for each value of a parameter.

Source: S. H. Strogatz, Nonlinear Dynamics and Chaos, 2nd ed., 2015, section 10.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagrange.dynamics.axes import MOST_VALUES, angles, difference
from lagrange.dynamics.runs import Report, Runs, depends_on_time, driving_period, initial_of, starts_of, time_scale
from lagrange.dynamics.section import Crosser, Crossings, check_memory, drawn_axes, section_of
from lagrange.errors import StatementError, counted, listing
from lagrange.machine.backend import FloatArray
from lagrange.members.table import axis_values
from lagrange.statement.event import Event
from lagrange.statement.parameters import label_of, parameter_name
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import Status

SAME_POINT = 1e-6
"""Difference of an entry up to which two points are the same, as a fraction of the range of the entry at all points."""

DIFFERENCE_NOISE = 1e-12
"""Largest rounding noise of the difference of two states, relative to a scale of the entry.

The scale of a coordinate is its largest magnitude, or that of its velocity times a period of small oscillations,
whichever is larger. The scale of a velocity is its largest magnitude, or that of its coordinate over this period."""


@dataclass(frozen=True, eq=False)
class SweepData:
    """Points of a bifurcation diagram: k values of a parameter, m orbits at each value, s points on each orbit.

    - `values` (k,) are the values of the parameter.
    - `states` (k, m, s, 2n) are the last s states of each orbit on the section; missing states are NaN.
    - `cycles` (k, m) is the period of each orbit: the least number of points after which all points repeat. It is 0 if
      they do not repeat within s/2 points.
    - `statuses` has for each value how each orbit ended.
    - `event` defines the section. Without an event, points are taken once in a period of the driving, `periods` (k,).
    - `followed` is true if each orbit began where the orbit at the previous value ended.
    - `axes` are the names of a coordinate and its velocity; by default the picture shows the coordinate.
    - `status` and `message` summarize all orbits.
    """

    statement: Statement
    parameter: str
    values: FloatArray
    states: FloatArray
    cycles: FloatArray
    statuses: tuple[tuple[Status, ...], ...]
    event: Event | None
    periods: FloatArray | None
    followed: bool
    axes: tuple[str, str]
    status: Status
    message: str


def parameter_of(statement: Statement, parameter: Any) -> str:
    """Return the name of a parameter, given by symbol or name. Raises StatementError for anything else."""
    known = [p.name for p in statement.parameters]
    label = label_of(parameter)
    if label not in known and label.removesuffix("_dot") in statement.names:
        raise StatementError(
            f"{label} is not a parameter but an entry of the state of {statement.name}: give its parameters "
            f"{listing(known)}; give other starts as starts=[...]."
        )
    return parameter_name(label, known)


def values_of(values: Any, name: str) -> FloatArray:
    """Return the values (k,) of the parameter `name`, from the user's list or array, or from (low, high, count).

    Raises StatementError for more than MOST_VALUES values, and for several values that are all equal.
    """
    numbers = axis_values(name, values)
    if len(numbers) > MOST_VALUES:
        raise StatementError(
            f"there are {len(numbers)} values of {name}, more than a picture has columns: give {MOST_VALUES} at most."
        )
    if len(numbers) > 1 and not np.ptp(numbers):
        raise StatementError(f"the range of {name} is empty: all values are {numbers[0]:g}. Give values that differ.")
    return numbers


def sweep(
    runs: Runs,
    parameter: str,
    values: FloatArray,
    definition: Any,
    starts: Any,
    *,
    count: int,
    dropped: int,
    followed: bool,
    progress: Report | None = None,
) -> SweepData:
    """Return the motion after its transients at each of the `values` of a parameter, as points on a section.

    `definition` is the event or the period of the section; None means the period of the driving. On each orbit from
    `starts`, `dropped` points are left out, and then `count` are kept. If `followed` is True, later orbits begin at the
    last points of the orbits at the previous value. `progress` is called with the number of finished values.
    """
    model, statement = runs.model, runs.model.statement
    index = [p.name for p in statement.parameters].index(parameter)
    base = starts_of(model, starts, initial_of(model, None))
    check_memory((len(values), len(base), count + dropped, model.layout.size))
    arrays = [with_value(runs, index, value) for value in values.tolist()]
    scale = time_scale(model, base, runs.parameters, statement.run.t_end)
    sections = [_section(runs, definition, array) for array in arrays]
    event = sections[0] if isinstance(sections[0], Event) else None
    states = np.full((len(values), len(base), count, model.layout.size), np.nan)
    statuses: list[tuple[Status, ...]] = []
    begins = [(0.0, start) for start in base]
    try:
        for k, (array, passed) in enumerate(zip(arrays, sections, strict=True)):
            cross = Crosser(replace(runs, parameters=array), passed, count + dropped, base)
            orbits = [cross(start, begin) for begin, start in begins]
            statuses.append(tuple(orbit.status for orbit in orbits))
            if Status.INTERRUPTED in statuses[-1]:
                break
            for i, orbit in enumerate(orbits):
                last = orbit.states[dropped:]
                states[k, i, : len(last)] = last
            if followed:
                begins = [_next(orbit, start, passed, statement) for orbit, start in zip(orbits, base, strict=True)]
            if progress is not None:
                progress(float(k + 1))
    except KeyboardInterrupt:
        statuses.append((Status.INTERRUPTED,))
    status, message = _ended(statuses, len(values), parameter, len(base))
    return SweepData(
        statement=statement,
        parameter=parameter,
        values=values,
        states=states,
        cycles=_cycles(states, angles(statement), scale),
        statuses=tuple(statuses),
        event=event,
        periods=None if event is not None else np.array(sections),
        followed=followed,
        axes=drawn_axes(statement, event),
        status=status,
        message=message,
    )


def with_value(runs: Runs, index: int, value: float) -> FloatArray:
    """Return the parameters (k,) with `value` at the index `index`. Raises StatementError for an invalid value."""
    array = runs.parameters.copy()
    array[index] = value
    return runs.model.parameter_array(array)


def _section(runs: Runs, definition: Any, parameters: FloatArray) -> Event | float:
    if definition is not None:
        return section_of(definition, runs.model, parameters)
    values = dict(zip(runs.model.statement.parameters, parameters.tolist(), strict=True))
    return driving_period(runs.model.statement, values)


def _next(orbit: Crossings, start: FloatArray, passed: Event | float, statement: Statement) -> tuple[float, FloatArray]:
    """Return the time and the state at which the orbit for the next value of the parameter begins.

    The state is that of the last crossing of `orbit`, or `start` if the orbit has no crossing or is not complete. The
    time is that of this crossing if the section `passed` is an event and the system depends on time, else 0.
    """
    if not orbit.status.complete or not len(orbit.states):
        return 0.0, start
    # After whole periods of a driving the next orbit may begin at time 0. An event happens at any phase.
    begin = float(orbit.times[-1]) if isinstance(passed, Event) and depends_on_time(statement) else 0.0
    return begin, np.ascontiguousarray(orbit.states[-1])


def _cycles(states: FloatArray, periodic: tuple[bool, ...], scale: float) -> FloatArray:
    """Return the period (k, m) of each orbit in `states` (k, m, s, 2n), as a number of points.

    The period is the least p for which every point equals the point p before it, or 0 if there is none. `periodic` has
    for each coordinate True if it is an angle, for which full turns do not count. `scale` is a period of small
    oscillations; velocities are multiplied by it for the comparison with coordinates.
    """
    complete = states[np.isfinite(states).all(axis=-1)]
    if not len(complete):
        return np.zeros(states.shape[:2], dtype=int)
    size = np.maximum(np.ptp(complete, axis=0), 1e-300)
    size[: len(periodic)][list(periodic)] = np.minimum(size[: len(periodic)][list(periodic)], 2 * np.pi)
    # An entry that is constant up to rounding, such as one that the section fixes, is ignored.
    n, largest = len(periodic), np.abs(complete).max(axis=0)
    largest = np.maximum(largest, np.concatenate([largest[n:] * scale, largest[:n] / scale]))
    size = np.maximum(size, DIFFERENCE_NOISE * largest / SAME_POINT)
    whole = states.reshape(-1, *states.shape[2:])
    periods = np.zeros(len(whole), dtype=int)
    left = np.nonzero(np.isfinite(whole).all(axis=(1, 2)))[0]
    for p in range(1, states.shape[2] // 2 + 1):
        # Most orbits are excluded by the comparison of their first points.
        distance = np.abs(difference(whole[left, p], whole[left, 0], periodic)) / size
        for row in left[(distance <= SAME_POINT).all(axis=1)].tolist():
            distance = np.abs(difference(whole[row, p:], whole[row, :-p], periodic)) / size
            periods[row] = p if (distance <= SAME_POINT).all() else 0
        left = left[periods[left] == 0]
    return periods.reshape(states.shape[:2])


def _ended(statuses: Sequence[tuple[Status, ...]], value_count: int, parameter: str, starts: int) -> tuple[Status, str]:
    """Return the status and the message of a bifurcation diagram.

    `statuses` has for each computed value of the parameter how its orbits ended. `value_count` is the number of
    requested values of the parameter with the name `parameter`, and `starts` the number of orbits at each value.
    """
    flat = [status for row in statuses for status in row]
    if Status.INTERRUPTED in flat:
        return Status.INTERRUPTED, (
            f"interrupted: {len(statuses) - 1} of {counted(value_count, 'value')} of {parameter} were computed and are "
            "kept."
        )
    bad = [(k, status) for k, row in enumerate(statuses) for status in row if not status.complete]
    words = f"{counted(value_count, 'value')} of {parameter}, {counted(starts, 'orbit')} each."
    if bad:
        words += f" {len(bad)} ended early, as {listing(sorted({status.name for _, status in bad}))}."
    return (bad[0][1] if bad else Status.SUCCESS), words
