"""Basins of attraction: at which equilibrium, or on which cycle of a driven motion, each start of a plane ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.dynamics.axes import Plane, plane_of
from lagrange.dynamics.cells import NONE, NOT_COMPUTED, Cells, Places, each_cell
from lagrange.dynamics.passage import CELLS
from lagrange.dynamics.runs import Report, Runs, initial_of, starts_of
from lagrange.dynamics.settling import CLOSE, LABEL, WHEN, Attractor, Settling
from lagrange.errors import StatementError, counted
from lagrange.machine.backend import FloatArray
from lagrange.members.chunk import Ends
from lagrange.members.processors import threads_of
from lagrange.statement.number import real_number
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import Status

FIRST_CELLS = 64
"""Cells of a coarse grid that look for attractors."""

MANY = 1000
"""From so many cells on it is worth while to compile their runs side by side, some tenths of a second."""


@dataclass(frozen=True, eq=False)
class BasinsData:
    """Which attractor each start on a plane goes to: `labels` (m, k), rows upwards, places among `attractors`.

    -1 stands where a run did not settle until `t_end` or had no end, -2 where nothing was computed. `times` (m, k) are
    those at which runs came close to their attractors. `base` (2n,) has the other entries of the starts.
    """

    statement: Statement
    plane: Plane
    base: FloatArray
    attractors: tuple[Attractor, ...]
    labels: FloatArray
    times: FloatArray
    period: float | None
    t_end: float
    status: Status
    message: str


def basins(
    runs: Runs,
    grid: Any,
    initial: Mapping[Any, Any] | None,
    attractors: Any,
    t_end: Any,
    *,
    workers: Any = None,
    progress: Report | None = None,
) -> BasinsData:
    """Return the basins of attraction on a plane of starts; see `lagrange.basins`."""
    model, statement = runs.model, runs.model.statement
    plane = plane_of(statement, grid, "grid", CELLS)
    if model.conservative:
        raise StatementError(
            f"{statement.name} conserves its energy, so that no motion settles and there are no basins: state "
            "dissipation or forces that brake, or map when an event happens first with lg.first_passage(...)."
        )
    if statement.constraints:
        raise StatementError(
            f"{statement.name} has constraints, and a plane of starts leaves them: eliminate(...) coordinates first."
        )
    end = None if t_end is None else real_number(t_end, "t_end")
    if end is not None and end <= 0:
        raise StatementError(f"t_end is {end:g}: give a positive time, until which motions may settle.")
    base = initial_of(model, initial)
    cells = Cells(plane, base, runs.parameters)
    work = Settling(runs, plane, base, end, many=len(cells) >= MANY)
    if attractors is not None:
        work.attractors = _given(work, starts_of(model, attractors, np.zeros(model.layout.size)))
    shape = plane[1].count, plane[0].count
    labels, times = np.full(shape, NOT_COMPUTED), np.full(shape, np.nan)

    def take(places: Places, found: Ends) -> None:
        here = places[:, 0], places[:, 1]
        labels[here], times[here] = found.columns[LABEL], found.columns[WHEN]

    threads = threads_of(workers)
    whole = _looked_around(work, cells) and each_cell(cells, work, threads, take, progress)
    made, labels = _in_order(work, labels)
    status, message = _ended(labels, made, work.end, whole=whole)
    return BasinsData(statement, plane, base, made, labels, times, work.period, work.end, status, message)


def _looked_around(work: Settling, cells: Cells) -> bool:
    """Find the attractors of a coarse grid, and return whether that was done, false after Ctrl-C.

    Runs that find one settle on it late, and the times of a map are to be those of runs that know it.
    """
    try:
        if not work.attractors:
            work.run(cells.starts(np.arange(min(FIRST_CELLS, len(cells)))), lambda: False)
    except KeyboardInterrupt:
        return False
    return True


def _given(work: Settling, states: FloatArray) -> list[Attractor]:
    """Return the attractors next to states that a user gives."""
    found = []
    for k, state in enumerate(states):
        made = work.equilibrium(state) if work.period is None else work.refined_cycle(state)
        if made is None:
            place = ", ".join(
                f"{name} = {x:g}" for name, x in zip(work.model.statement.state_names, state, strict=True)
            )
            raise StatementError(
                f"attractor {k}, {place}, is none: there is no stable equilibrium within {10 * CLOSE:g} of the grid's "
                "width. Leave attractors out, and they are found on the way."
            )
        found.append(made)
    return found


def _in_order(work: Settling, labels: FloatArray) -> tuple[tuple[Attractor, ...], FloatArray]:
    """Return the attractors in the order of their states, and the labels that go with it.

    Threads find them in any order.
    """
    made = work.attractors
    order = sorted(range(len(made)), key=lambda k: tuple(np.round(made[k].states[0] / work.sizes, 6).tolist()))
    table = np.arange(NOT_COMPUTED, len(made))
    for new, old in enumerate(order):
        table[old - NOT_COMPUTED] = new
    return tuple(made[k] for k in order), table[labels - NOT_COMPUTED]


def _ended(labels: FloatArray, made: Sequence[Attractor], t_end: float, *, whole: bool) -> tuple[Status, str]:
    done = int((labels != NOT_COMPUTED).sum())
    lost = int((labels == NONE).sum())
    words = f"{counted(len(made), 'attractor')}, {counted(done, 'run')}."
    if lost:
        words += f" {lost} did not settle on an equilibrium or a cycle until t = {t_end:g}."
    if not whole:
        return Status.INTERRUPTED, f"interrupted: {done} of {counted(labels.size, 'run')} are done, and kept. {words}"
    return Status.SUCCESS, words
