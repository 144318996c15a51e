"""First passages: when a motion first meets an event, for every start on a plane, such as the first flip of a pendulum.

Source: J. S. Heyl, The double pendulum fractal, 2008; S. Redner, A Guide to First-Passage Processes, 2001.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy

from lagrange.dynamics.angles import angles
from lagrange.dynamics.axes import Plane, plane_of
from lagrange.dynamics.cells import NONE, NOT_COMPUTED, Cells, Places, each_cell
from lagrange.dynamics.runs import Report, Runs, initial_of
from lagrange.errors import StatementError, counted, formula, shown
from lagrange.machine.backend import FloatArray
from lagrange.members.chunk import STATUSES, Ends
from lagrange.members.keep import EVENTS, STATUS, event_times
from lagrange.members.processors import threads_of
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
        labels = [formula(one.expression.xreplace(dict(statement.plain)), 40) for one in events]
    base = initial_of(runs.model, initial)
    shape = plane[1].count, plane[0].count
    times, which = np.full(shape, np.nan), np.full(shape, NOT_COMPUTED)
    early: list[Status] = []

    def take(places: Places, found: Ends) -> None:
        here = places[:, 0], places[:, 1]
        passed = np.stack([found.columns[event_times(k)][:, 0] for k in range(len(events))])
        first = np.where(np.isnan(passed), np.inf, passed).argmin(axis=0)
        times[here] = passed[first, np.arange(len(first))]
        which[here] = np.where(np.isnan(times[here]), NONE, first)
        early.extend(one for one in (STATUSES[code] for code in found.columns[STATUS].tolist()) if not one.complete)

    cells = Cells(plane, base, runs.parameters)
    engine = runs.job(0.0, end, ((EVENTS, 1),), tuple(events)).engine()
    whole = each_cell(cells, engine, threads_of(workers), take, progress)
    status, message = _ended(which, early, end, whole=whole)
    return PassageData(statement, plane, base, tuple(events), tuple(labels), end, times, which, status, message)


def _ended(which: FloatArray, early: Sequence[Status], t_end: float, *, whole: bool) -> tuple[Status, str]:
    done, met = int((which != NOT_COMPUTED).sum()), int((which >= 0).sum())
    words = f"{met} of {counted(done, 'run')} met the event until t = {t_end:g}."
    if not whole:
        return Status.INTERRUPTED, f"interrupted: {done} of {counted(which.size, 'run')} are done, and kept. {words}"
    if early:
        words = f"{words} {len(early)} ended before: {shown(early[0].value)} the first of them."
        return early[0], f"{words} Raise max_steps, or lower t_end." if Status.MAX_STEPS in early else words
    return Status.SUCCESS, words
