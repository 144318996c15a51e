"""Compute a phase portrait: default window, vector field, nullclines, equilibria, separatrices, orbits."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.dynamics.axes import Axis, Plane, angles, plane_of, row_of, wrapped
from lagrange.dynamics.fixed_points import FixedPoint, fixed_points, zero_lines
from lagrange.dynamics.orbits import PERIODS, Orbit, PlaneWindow, Separatrix, orbit, sampled, separatrices_of
from lagrange.dynamics.runs import Report, Runs, depends_on_time, initial_of, starts_of, time_scale
from lagrange.errors import RunError, StatementError, counted, listing
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.expression import real_number
from lagrange.statement.parameters import table_of
from lagrange.statement.statement import Statement
from lagrange.trajectory.constraints.consistent import with_rates
from lagrange.trajectory.trajectory import Status

FIELD = 25  # Number of arrows of the field along each axis
NULLCLINE_CELLS = 240  # Number of cells along each axis for the nullclines, whose lines are then exact within a pixel

CELLS = 22
"""Number of cells along each axis for the choice of orbits.

An orbit begins in each cell that no orbit has crossed, from the middle of the window outwards."""

MOST_ORBITS, MOST_PROJECTED = 60, 8
"""Largest numbers of orbits if the user gives no starts. The first one is for a plane that contains whole orbits, which
do not cross. The second one is for a plane that orbits leave, and for a driven system: orbits may cross in a plane."""

FEW_PERIODS = 2
"""Duration of an orbit, in mean periods of small oscillations, if orbits leave the plane, and for a driven system. Such
orbits may cross in the plane, and are followed forwards in time only."""

SAMPLES_PER_CELL = 64  # Number of states in each step that mark the cells that an orbit crosses
SAME_PLACE = 1e-9  # Distance below which two equilibria are the same, as a fraction of the window

START_DISPLACEMENT = np.array([0.1, 0.0])
"""Displacement (x, v) from an initial state that is an equilibrium. The motions from the two displaced states set the
default window."""

MOST_RESTS = 16
"""Largest number of equilibria that the default window is made to contain.

An equilibrium is a coordinate between -1000 and 1000 at which the acceleration at rest changes its sign. If there are
more of them, the window ignores all."""


@dataclass(frozen=True, eq=False)
class PortraitData:
    """The parts of a phase portrait; states have 2n entries, coordinates and then velocities.

    - `plane` has the horizontal and the vertical axis, each with an entry of the state and its range.
    - `x` (k,) and `y` (m,) are the coordinates of the grid of arrows on the horizontal and the vertical axis.
    - `u` and `v` (m, k) are the time derivatives of the entry on the horizontal and on the vertical axis at the arrows.
    - `nullclines` maps the name of an entry to the lines (j, 2) on which its time derivative is zero.
    - `equilibria` have a state and a kind each.
    - `separatrices` have an orbit each.
    - `orbits` are the orbits through the states `starts` (s, 2n).
    - `turns` is true if the entry on the horizontal axis is an angle.
    - `held` maps the names of the entries that are not on the axes to their fixed values.
    - `time` is the time at which the field is evaluated, None if the system does not depend on time.
    - `status` is SUCCESS, or INTERRUPTED after Ctrl-C, and `message` names orbits that ended early.
    """

    statement: Statement
    plane: Plane
    turns: bool
    held: Mapping[str, float]
    time: float | None
    x: FloatArray
    y: FloatArray
    u: FloatArray
    v: FloatArray
    nullclines: Mapping[str, tuple[FloatArray, ...]]
    equilibria: tuple[FixedPoint, ...]
    separatrices: tuple[Separatrix, ...]
    starts: FloatArray
    orbits: tuple[Orbit, ...]
    status: Status
    message: str


class _Portrait:
    """Computes the parts of a phase portrait on one plane.

    `base` (2n,) has the values of the entries off the axes. `time` is the time of the field, and `reach` the longest
    duration of an orbit, or None for the default.
    """

    def __init__(self, runs: Runs, plane: Plane, base: FloatArray, time: float, reach: float | None) -> None:
        model = runs.model
        self.runs, self.plane, self.base, self.time = runs, plane, base, time
        self.periodic = angles(model.statement)
        self.driven = depends_on_time(model.statement)
        self.alone = len(_free(model, {})) == 2 and not self.driven
        states = np.array([self.state(x, y) for x in plane[0].values[::6] for y in plane[1].values[::6]])
        scale = time_scale(model, states, runs.parameters, model.statement.run.t_end / PERIODS)
        periods = PERIODS if self.alone else FEW_PERIODS
        self.window = PlaneWindow(plane, self.periodic, periods * scale if reach is None else reach)

    def state(self, x: float, y: float) -> FloatArray:
        """Return the state (2n,) at the point (x, y) of the plane."""
        state = self.base.copy()
        state[self.plane[0].row], state[self.plane[1].row] = x, y
        return state

    def rates(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the time derivatives of the two entries on the axes, (2, k), at points x (k,), y (k,) of the plane."""
        states = np.repeat(self.base[:, None], len(x), axis=1)
        states[self.plane[0].row], states[self.plane[1].row] = x, y
        try:
            slopes = self._slopes(states)
        except RunError:
            # The mass matrix is singular at some point, so the points are evaluated one by one.
            slopes = np.full_like(states, np.nan)
            for k, column in enumerate(states.T):
                with suppress(RunError):
                    slopes[:, k] = self._slopes(column[:, None])[:, 0]
        return slopes[[self.plane[0].row, self.plane[1].row]]

    def _slopes(self, states: FloatArray) -> FloatArray:
        """Return the time derivatives (2n, k) of states (2n, k).

        Velocities of coordinates without inertia are replaced by the values that follow from the other entries.
        """
        followed = with_rates(self.runs.model, self.time, states, self.runs.parameters)
        return self.runs.model.rhs(self.time, followed, self.runs.parameters)

    def field(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the grid of arrows, x (k,) and y (m,), and the time derivatives of the two entries there.

        The derivatives are (m, k) each, of the entry on the horizontal and of the entry on the vertical axis.
        """
        x, y = (np.linspace(axis.low, axis.high, 2 * axis.count + 1)[1::2] for axis in self.plane)
        columns, rows = np.meshgrid(x, y)
        u, v = self.rates(columns.ravel(), rows.ravel())
        return x, y, u.reshape(columns.shape), v.reshape(columns.shape)

    def nullclines(self) -> dict[str, tuple[FloatArray, ...]]:
        """Return the nullclines by the name of the entry on each axis: lines (j, 2) where its time derivative is zero.

        The grid extends half a cell beyond the window, to include lines on its border.
        """
        halves = (axis.width / NULLCLINE_CELLS / 2 for axis in self.plane)
        x, y = (
            np.linspace(axis.low - half, axis.high + half, NULLCLINE_CELLS + 2)
            for axis, half in zip(self.plane, halves, strict=True)
        )
        first, second = self.plane
        return {
            first.name: zero_lines(lambda a, b: self.rates(a, b)[0], x, y),
            second.name: zero_lines(lambda a, b: self.rates(a, b)[1], x, y),
        }

    def distinct(self, equilibria: Sequence[FixedPoint]) -> list[int]:
        """Return the indices of distinct equilibria. Equilibria that differ by full turns of angles count as one."""
        numbers: list[int] = []
        for k, equilibrium in enumerate(equilibria):
            others = np.array([equilibria[i].state for i in numbers]).reshape(-1, len(equilibrium.state))
            if not (self.window.distance(others, equilibrium.state) < SAME_PLACE).any():
                numbers.append(k)
        return numbers

    def seeds(self) -> FloatArray:
        """Return candidates for initial states of orbits: the middles of all cells of the window, (CELLS**2, 2n).

        The innermost cells come first.
        """
        middles = [np.linspace(axis.low, axis.high, 2 * CELLS + 1)[1::2] for axis in self.plane]
        columns, rows = np.meshgrid(*middles)
        away = np.hypot(*(np.indices(columns.shape) - (CELLS - 1) / 2))
        order = np.argsort(away.ravel(), kind="stable")
        return np.array([self.state(columns.ravel()[k], rows.ravel()[k]) for k in order])


def portrait(
    runs: Runs,
    window: Any,
    at: Mapping[Any, Any] | None,
    starts: Any,
    *,
    time: float = 0.0,
    reach: float | None = None,
    progress: Report | None = None,
) -> PortraitData:
    """Return the phase portrait of the model of `runs` on the plane `window`.

    - `window` maps the two entries of the state on the axes to their ranges. With None and one coordinate, the ranges
      are chosen.
    - `at` maps the other entries of the state to their fixed values.
    - `starts` are the initial states of orbits; if None, the orbits fill the plane.
    - `time` is the time at which the field is evaluated, and `reach` the longest duration of an orbit.
    - `progress` is called with the number of orbits, or of cells of the plane that orbits have crossed.
    """
    statement = runs.model.statement
    if statement.constraints:
        raise StatementError(
            f"{statement.name} has constraints, so a phase portrait cannot be drawn: remove them first with "
            "system.eliminate(...)."
        )
    fixed = held_entries(runs.model, at, window)
    base = initial_of(runs.model, None)
    base[runs.model.equations.following] = 0.0
    for row, value in fixed.items():
        base[row] = value
    plane = default_plane(runs, base) if window is None else plane_of(statement, window, "window", FIELD)
    free = _free(runs.model, fixed)
    if sorted(axis.row for axis in plane) != free:
        names = statement.state_names
        raise StatementError(
            f"window names {listing(axis.name for axis in plane)}, but the entries of the state without a value in at= "
            f"are {listing(names[row] for row in free)}: give a window of these two."
        )
    work = _Portrait(runs, plane, base, time, reach)
    return _computed(work, fixed, starts, progress)


def _computed(work: _Portrait, fixed: Mapping[int, float], starts: Any, progress: Report | None) -> PortraitData:
    """Return the phase portrait, with all its parts, that `work` computes.

    `fixed` maps the indices of the entries off the axes to their values. `starts` are the user's initial states of
    orbits; if None, orbits fill the plane. `progress` is called with the number of finished orbits, or of crossed
    cells; it may be None.
    """
    runs, plane, names = work.runs, work.plane, work.runs.model.statement.state_names
    single = work.alone and len(names) == 2
    equilibria, note = fixed_points(runs.model, runs.parameters, plane[0].low, plane[0].high) if single else ((), "")
    equilibria = tuple(equilibrium for equilibrium in equilibria if plane[1].low <= 0.0 <= plane[1].high)
    branches: list[Separatrix] = []
    orbits: list[Orbit] = []
    chosen_starts = None if starts is None else starts_of(runs.model, starts, work.base)
    chosen = [] if chosen_starts is None else list(chosen_starts)
    interrupted = False
    try:
        exits = work.window.exits(runs)
        for number in work.distinct(equilibria):
            branches += separatrices_of(runs, work.window, equilibria, number, exits)
        for start in _unvisited(work, branches, orbits, progress) if chosen_starts is None else chosen:
            orbits.append(orbit(runs, work.window, start, exits, work.time, both_ways=work.alone))
            if chosen_starts is None:
                chosen.append(start)
            if progress is not None and chosen_starts is not None:
                progress(float(len(orbits)))
            if orbits[-1].status is Status.INTERRUPTED:
                break
    except KeyboardInterrupt:
        interrupted = True
    status, message = _ended(work, orbits, len(chosen), note, interrupted=interrupted)
    x, y, u, v = work.field()
    return PortraitData(
        statement=runs.model.statement,
        plane=plane,
        turns=work.window.wraps(plane[0]),
        held={names[row]: value for row, value in fixed.items()},
        time=work.time if work.driven else None,
        x=x,
        y=y,
        u=u,
        v=v,
        nullclines=work.nullclines(),
        equilibria=equilibria,
        separatrices=tuple(branches),
        starts=np.array(chosen[: len(orbits)]).reshape(len(orbits), len(names)),
        orbits=tuple(orbits),
        status=status,
        message=message,
    )


def _unvisited(
    work: _Portrait, branches: Sequence[Separatrix], orbits: Sequence[Orbit], progress: Report | None
) -> Iterator[FloatArray]:
    """Yield initial states of orbits that fill the plane: the middle of each cell that is still empty.

    A cell is empty if no orbit or branch in `branches` has crossed it or a neighbouring cell. The caller appends the
    orbit through each state to `orbits`. `progress` is called with the number of cells that are not empty.
    """
    visited = np.zeros((CELLS + 2, CELLS + 2), dtype=bool)
    most = MOST_ORBITS if work.alone else MOST_PROJECTED
    for branch in branches:
        _mark(work, visited, branch.orbit)
    for start in work.seeds():
        row, column = _cells(work, start[None, :])
        if visited[row[0], column[0]] or not np.isfinite(work.rates(*start[list(work.window.rows), None])).all():
            continue
        if len(orbits) >= most:
            return
        yield start
        _mark(work, visited, orbits[-1])
        if progress is not None:
            progress(float(visited[1:-1, 1:-1].sum()))


def _mark(work: _Portrait, taken: FloatArray, orbit: Orbit) -> None:
    """Set True in `taken` at the cells of the window of `work` that an `orbit` crosses, and at their neighbours.

    `taken` (CELLS + 2, CELLS + 2) has a margin of one cell around the window.
    """
    for part in orbit.parts:
        rows, columns = _cells(work, sampled(part, SAMPLES_PER_CELL)[1])
        for down, right in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            taken[np.clip(rows + down, 0, CELLS + 1), np.clip(columns + right, 0, CELLS + 1)] = True


def _cells(work: _Portrait, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rows (k,) and the columns (k,) of the cells that contain the states (k, 2n), for the window of `work`.

    Cells of the window have the numbers 1 to CELLS. A state outside of the window has the number 0 or CELLS + 1.
    """
    indices = []
    for axis in reversed(work.plane):
        values = states[:, axis.row]
        if work.window.wraps(axis):
            values = wrapped(values, axis.low)
        cells = np.floor((values - axis.low) / axis.width * CELLS)
        indices.append(np.clip(np.nan_to_num(cells, nan=-1.0), -1, CELLS).astype(int) + 1)
    return indices[0], indices[1]


def _ended(
    work: _Portrait, orbits: Sequence[Orbit], begun_count: int, note: str, *, interrupted: bool
) -> tuple[Status, str]:
    """Return the status and the message of a portrait.

    `orbits` are the orbits that were kept, and `begun_count` is the number of orbits that were to be run. The message
    names orbits that ended early, and contains `note`. `interrupted` is True after Ctrl-C; the status is then
    INTERRUPTED. `work` has the system and the time of the field.
    """
    statement = work.runs.model.statement
    interrupted = interrupted or any(orbit.status is Status.INTERRUPTED for orbit in orbits)
    status = Status.INTERRUPTED if interrupted else Status.SUCCESS
    words = [f"interrupted after {counted(len(orbits), 'orbit')}, which are kept."] if interrupted else []
    stopped = [orbit for orbit in orbits if orbit.status not in (Status.SUCCESS, Status.EVENT)]
    if stopped and not interrupted:
        words.append(f"{len(stopped)} of {counted(begun_count, 'orbit')} did not reach the end: {stopped[0].message}")
    if note:
        words.append(note)
    if work.driven:
        words.append(
            f"{statement.name} depends on time: the field is drawn at t = {work.time:g}. Orbits begin then and may "
            "cross. lg.poincare(...) with the period of the driving shows them as points."
        )
    elif not work.alone:
        words.append(
            "The plane is a slice of the state space: orbits begin on it and leave it, and are drawn projected onto it."
        )
    return status, " ".join(words)


def held_entries(model: Model, at: Mapping[Any, Any] | None, window: Any) -> dict[int, float]:
    """Return the fixed values of entries of the state that the user's `at` gives, by index in the state.

    `window` are the ranges of the axes, or None for the default. Raises StatementError unless two entries remain for
    the axes, and for a system without a default window.
    """
    statement = model.statement
    fixed = {}
    for key, value in table_of(at, "at", "coordinate or velocity to value").items():
        row = row_of(statement, key, "at")
        if row in model.equations.following:
            raise StatementError(
                f"the argument at has a value for {statement.state_names[row]}, which follows from the coordinates, "
                f"since {statement.names[row - len(statement.names)]} has no inertia: leave it out."
            )
        fixed[row] = real_number(value, f"the value of {statement.state_names[row]} in at")
    free = [statement.state_names[row] for row in _free(model, fixed)]
    if len(statement.names) == len(free) == 1 and not fixed:
        raise StatementError(
            f"{free[0]} has no inertia, so the state of {statement.name} is one number, and a phase plane needs two: "
            f"plot the motion in time, system.run(t_end).plot({free[0]!r})."
        )
    if window is None and len(free) == 2 and len(statement.coordinates) > 1:
        noun = f"{'a slice of ' if fixed else ''}{counted(len(statement.coordinates), 'coordinate')}"
        raise StatementError(
            f"no window is given, and there is no default window for {noun}: give one, such as "
            f"window={{{free[0]!r}: (-3, 3), {free[1]!r}: (-5, 5)}}."
        )
    if len(free) != 2:
        raise StatementError(_too_many(model, len(free)))
    return fixed


def _free(model: Model, fixed: Collection[int]) -> list[int]:
    """Return the indices in the state of the entries that are not fixed: two, if they determine a plane.

    Entries in `fixed` are left out, and so are velocities of coordinates without inertia, which follow from the others.
    """
    return [row for row in range(model.layout.size) if row not in fixed and row not in model.equations.following]


def _too_many(model: Model, left: int) -> str:
    """Return the error message for `left` entries of the state without a fixed value, where a plane needs two."""
    statement = model.statement
    names = [statement.state_names[row] for row in _free(model, ())]
    n = len(statement.coordinates)
    if n == 1:
        return (
            f"the argument at has a value for an entry of the state, but {statement.name} has only two, and "
            "both are axes: leave at out."
        )
    shown_axes = (0, n) if len(names) == 2 * n else (0, 1)
    others = ", ".join(f"{name!r}: 0" for k, name in enumerate(names) if k not in shown_axes)
    return (
        f"{statement.name} has {counted(n, 'coordinate')}, and {counted(left, 'entry')} of its state "
        f"{'is' if left == 1 else 'are'} free: a portrait has two axes. Give all others a value, as at={{{others}}}, "
        "or take a section of the motion with lg.poincare(...)."
    ).replace("entrys", "entries")


def default_plane(runs: Runs, base: FloatArray) -> Plane:
    """Return a window for the model of `runs`, with one coordinate: it has the equilibria and motions between them.

    An angle has the range of a full turn. Another coordinate has the range of the equilibria and of the motion from the
    initial state `base`, enlarged at both ends. If `base` is an equilibrium, the motion begins next to it.
    """
    model = runs.model
    (name,) = model.statement.names
    turns = angles(model.statement)[0]
    scale = time_scale(model, base[None, :], runs.parameters, model.statement.run.t_end / 3)
    low, high = (-math.pi, math.pi) if turns else _extent(runs, base, scale)
    speeds = [0.0]
    for x in np.linspace(low, high, 13)[1:-1]:
        # A step may last half an oscillation and end at rest, so states inside of the steps are needed.
        _, states = sampled(runs(np.array([x, 0.0]), 0.0, 2 * scale))
        inside = turns | ((states[:, 0] >= low) & (states[:, 0] <= high))
        speeds.append(float(np.abs(states[inside, 1]).max(initial=0.0)))
    finite = [x for x in speeds if math.isfinite(x)]
    top = 1.4 * max(finite) or (high - low) / scale
    return Axis(name, 0, low, high, FIELD), Axis(f"{name}_dot", 1, -top, top, FIELD)


def _extent(runs: Runs, base: FloatArray, scale: float) -> tuple[float, float]:
    """Return the range (low, high) of the only coordinate of a system, which is not an angle, for the default window.

    It contains the equilibria and the motion from the initial state `base`. `scale` is a period of small oscillations,
    which sets the duration of this motion.
    """
    model, sizes = runs.model, np.logspace(-3, 3, 1200)
    x = np.concatenate([-sizes[::-1], [0.0], sizes])
    try:
        a = model.accelerations(x[None, :], np.zeros((1, len(x))), 0.0, runs.parameters)[0]
    except RunError:
        a = np.full(len(x), np.nan)
    rests = x[:-1][(np.sign(a[:-1]) * np.sign(a[1:]) < 0) | (a[:-1] == 0.0)]
    rests = rests[:MOST_RESTS] if len(rests) <= MOST_RESTS else np.zeros(0)
    starts = [base]
    if abs(float(model.accelerations(base[:1], base[1:], 0.0, runs.parameters)[0])) < 1e-9 and not base[1]:
        starts = [base + START_DISPLACEMENT, base - START_DISPLACEMENT]
    # A driven motion may move far from its start before it settles, so it is run for longer.
    longest = (30 if depends_on_time(model.statement) else 3) * scale
    passed = [runs(begin, 0.0, longest).y[0] for begin in starts]
    among = np.concatenate([rests, *(x[np.isfinite(x)] for x in passed)])
    low, high = float(among.min()), float(among.max())
    margin = 0.3 * (high - low) or 1.0
    return low - margin, high + margin
