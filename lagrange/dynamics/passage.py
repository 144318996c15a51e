"""First passages: when a motion first meets an event, for every start on a plane, such as the first flip of a pendulum.

Source: J. S. Heyl, The double pendulum fractal, 2008; S. Redner, A Guide to First-Passage Processes, 2001.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy

from lagrange.dynamics.angles import angles
from lagrange.dynamics.axes import Plane, plane_of
from lagrange.dynamics.cells import NONE, NOT_COMPUTED, Places, each_cell, workers_of
from lagrange.dynamics.runs import Report, Runs, initial_of
from lagrange.errors import StatementError, counted, shown
from lagrange.machine.backend import FloatArray
from lagrange.statement.event import Event, declare_events, event
from lagrange.statement.number import real_number
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import Status

CELLS = 100
"""Cells along an axis that is given no number of them."""


@dataclass(frozen=True, eq=False)
class PassageData:
    """The first passage of each start on a plane: `times` (m, k), rows upwards, NaN where there was none until `t_end`.

    `which` (m, k) is the place among `events` of the one that was met first, -1 where none was, -2 where nothing was
    computed. `base` (2n,) has the other entries of the starts.
    """

    statement: Statement
    plane: Plane
    base: FloatArray
    events: tuple[Event, ...]
    labels: tuple[str, ...]
    t_end: float
    times: FloatArray
    which: FloatArray
    status: Status
    message: str


def flips(statement: Statement) -> tuple[list[Event], list[str]]:
    """Return the events of angles that pass pi, an odd number of half turns from zero, with their names."""
    turning = [i for i, turns in enumerate(angles(statement)) if turns]
    if not turning:
        raise StatementError(
            f"{statement.name} has no angle that could flip over: give event=..., an expression that is zero there."
        )
    return (
        [event(sympy.cos(statement.coordinates[i] / 2), terminal=True) for i in turning],
        [f"{statement.names[i]} flips" for i in turning],
    )


def first_passage(
    runs: Runs,
    grid: Any,
    given: Any,
    initial: Mapping[Any, Any] | None,
    t_end: Any,
    *,
    workers: Any = None,
    progress: Report | None = None,
) -> PassageData:
    """Return the first passage for every start on a plane; see `lagrange.first_passage`."""
    statement = runs.model.statement
    plane = plane_of(statement, grid, "grid", CELLS)
    end = real_number(statement.run.t_end if t_end is None else t_end, "t_end")
    if end <= 0:
        raise StatementError(f"t_end is {end:g}: give a positive time, until which runs wait for the event.")
    if given is None:
        events, labels = flips(statement)
    else:
        declared = declare_events(given, statement)
        if not declared:
            raise StatementError("event is empty: give an expression, or leave it out for flips of angles.")
        events = [replace(one, terminal=1) for one in declared]
        labels = [str(one.expression.xreplace(dict(statement.plain)))[:40] for one in events]
    base = initial_of(runs.model, initial)
    shape = plane[1].count, plane[0].count
    times, which = np.full(shape, np.nan), np.full(shape, NOT_COMPUTED)
    ends: dict[tuple[int, int], Status] = {}
    watched, last = replace(runs, options=replace(runs.options, events=events)), np.array([end])

    def run(places: Places, states: FloatArray, stopped: Callable[[], bool]) -> int:
        for done, ((row, column), state) in enumerate(zip(places.tolist(), states, strict=True)):
            if stopped():
                return done
            found = watched(state, 0.0, end, last)
            met = [k for k, passed in enumerate(found.t_events) if len(passed)]
            if found.status is Status.EVENT and met:
                first = min(met, key=lambda k: float(found.t_events[k][0]))
                times[row, column], which[row, column] = found.t_events[first][0], first
                continue
            which[row, column] = NONE
            if not found.status.complete:
                ends[row, column] = found.status
        return len(places)

    whole = each_cell(plane, base, run, workers_of(workers), progress)
    status, message = _ended(which, ends, end, whole=whole)
    return PassageData(statement, plane, base, tuple(events), tuple(labels), end, times, which, status, message)


def _ended(which: FloatArray, ends: dict[tuple[int, int], Status], t_end: float, *, whole: bool) -> tuple[Status, str]:
    done, met = int((which != NOT_COMPUTED).sum()), int((which >= 0).sum())
    words = f"{met} of {counted(done, 'run')} met the event until t = {t_end:g}."
    if not whole:
        return Status.INTERRUPTED, f"interrupted: {done} of {counted(which.size, 'run')} are done, and kept. {words}"
    if ends:
        first = next(iter(ends.values()))
        return first, f"{words} {len(ends)} ended before: {shown(first.value)} the first of them."
    return Status.SUCCESS, words
