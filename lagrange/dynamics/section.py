"""Compute Poincare sections: the states of orbits at each crossing of a surface, or after each period of a driving.

Source: E. Ott, Chaos in Dynamical Systems, 2nd ed., 2002, section 1.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy

from lagrange.dynamics.axes import row_of
from lagrange.dynamics.fixed_points import zero_lines
from lagrange.dynamics.runs import Report, Runs, initial_of, starts_of, time_scale
from lagrange.errors import StatementError, counted
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t as time_symbol
from lagrange.statement.event import Event, declare_events
from lagrange.statement.expression import MOST_NUMBERS, expression, positive_number, real_number, whole_number
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import Status, Trajectory

CROSSINGS_PER_RUN = 2000
"""Number of crossings after which an orbit continues in a new run, to bound the memory for its steps."""

PERIODS_PER_CROSSING = 2.0  # Duration of an orbit's first run, per crossing, in mean periods of small oscillations
LONGEST_WAIT = 200  # Longest time without a crossing, in mean periods of small oscillations; then the orbit ends


@dataclass(frozen=True, eq=False)
class Crossings:
    """The crossings of a section by one orbit: times (k,), states (k, 2n), and the orbit's final status and message."""

    times: FloatArray
    states: FloatArray
    status: Status
    message: str


class Crosser:
    """Callable that follows an orbit until it has crossed a section `count` times.

    The section `passed` is an event, whose zeros are the crossings, or a period, after whose multiples the states are
    taken. `states` (m, 2n) are the starts of all orbits, which set the time scale. `longest` is the longest time
    without a crossing, or None for the default.
    """

    def __init__(
        self, runs: Runs, passed: Event | float, count: int, states: FloatArray, longest: float | None = None
    ) -> None:
        statement = runs.model.statement
        self.runs, self.count = runs, count
        self.period = passed if isinstance(passed, float) else None
        self.event = None if isinstance(passed, float) else replace(passed, terminal=min(count, CROSSINGS_PER_RUN))
        self.scale = time_scale(runs.model, states, runs.parameters, statement.run.t_end / 10)
        self.wait = LONGEST_WAIT * self.scale if longest is None else longest

    def __call__(self, start: FloatArray, begin: float = 0.0) -> Crossings:
        """Return the crossings of the orbit that starts from the state `start` (2n,) at the time `begin`."""
        if self.period is None:
            return self._at_events(start, begin)
        times = begin + self.period * np.arange(1.0, self.count + 1.0)
        run = self.runs(start, begin, float(times[-1]), t_eval=times)
        return Crossings(run.t, run.y.T, run.status, run.message)

    def _at_events(self, start: FloatArray, begin: float) -> Crossings:
        times: list[FloatArray] = []
        states: list[FloatArray] = []
        leg = PERIODS_PER_CROSSING * self.scale * min(self.count, CROSSINGS_PER_RUN)
        left, since, y, first = self.count, begin, start, begin
        while True:
            run = self.runs(y, begin, begin + leg, events=[self.event])
            times.append(run.t_events[0][:left])
            states.append(run.y_events[0][:left])
            left -= len(times[-1])
            since = float(times[-1][-1]) if len(times[-1]) else since
            ended = run.status is not Status.SUCCESS and run.status is not Status.EVENT
            if left == 0 or ended or run.span[1] - since >= self.wait or not run.y.size:
                return Crossings(np.concatenate(times), np.concatenate(states), *self._end(run, left, since))
            begin, y = run.span[1], np.ascontiguousarray(run.y[:, -1])
            passed = self.count - left
            leg = max(self.wait / 2, 1.2 * left * (begin - first) / passed) if passed else self.wait

    def _end(self, run: Trajectory, missing_count: int, last_crossing: float) -> tuple[Status, str]:
        """Return the status and the message of an orbit, after the last of its runs, `run`.

        `missing_count` is the number of crossings that the orbit lacks, and `last_crossing` is the time of its last
        crossing.
        """
        if missing_count == 0:
            return Status.EVENT, "all crossings were found."
        if run.status.complete:
            return Status.SUCCESS, (
                f"passed the section {counted(self.count - missing_count, 'time')}, and not again between "
                f"t = {last_crossing:.6g} and {run.span[1]:.6g}; give longest=... above {self.wait:.3g} to wait longer."
            )
        return run.status, run.message


def followed(cross: Crosser, states: FloatArray, progress: Report | None) -> list[Crossings]:
    """Return the crossings that `cross` finds on the orbits from the states (m, 2n).

    `progress` is called with the number of finished orbits, unless it is None. After Ctrl-C the list ends with the
    interrupted orbit, whose status is INTERRUPTED.
    """
    finished: list[Crossings] = []
    try:
        for start in states:
            finished.append(cross(start))
            if progress is not None:
                progress(float(len(finished)))
            if finished[-1].status is Status.INTERRUPTED:
                break
    except KeyboardInterrupt:
        finished.append(Crossings(np.empty(0), states[:0], Status.INTERRUPTED, "was interrupted."))
    return finished


ENERGY_CORRECTIONS = 30
"""Number of Newton steps that find the velocity for which a state has a prescribed energy.

They start from the solution for an energy that is quadratic in the velocity. One step removes its rounding errors. The
others are for other energies, such as that of a relativistic particle."""

PROBES = (1.0, 1e-3, 1e-6)
"""Trial velocities. The energies at v and at -v, for one of them, give the coefficients of an energy that is quadratic
in the velocity. The first trial velocity at which the energies are finite is used."""

ENERGY_ERROR = 1e-10  # Largest accepted error of the energy, relative to the sum of energy and energy at zero velocity


@dataclass(frozen=True, eq=False)
class EnergyLevel:
    """The states of a model with the energy `energy`, which determines the velocity in row `row` of the state.

    For most systems the energy is a quadratic function of this velocity. `parameters` (k,) are the model's parameters.
    """

    model: Model
    parameters: FloatArray
    row: int
    energy: float

    def margin(self, states: FloatArray) -> FloatArray:
        """Return a discriminant (k,) at states (2n, k): positive where two velocities give the energy.

        The velocity v in row `row` enters the energy as a v^2 + b v + c. The discriminant is b^2 - 4 a (c - `energy`).
        """
        a, b, c = self._quadratic(states)
        return np.asarray(b * b - 4 * a * (c - self.energy))

    def _quadratic(self, states: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return a, b and c, (k,) each, of the energy a v^2 + b v + c at states (2n, k).

        The velocity v is in row `row` of the state. The results are NaN where the energy has no value.
        """
        middle = self._energy(states, 0.0)
        a = b = np.full_like(middle, np.nan)
        for probe in PROBES:
            below, above = (self._energy(states, v) for v in (-probe, probe))
            with np.errstate(invalid="ignore"):
                a, b = ((above + below) / 2 - middle) / probe**2, (above - below) / 2 / probe
            if np.isfinite(a).all():
                break
        return a, b, middle

    def _energy(self, states: FloatArray, v: float | FloatArray) -> FloatArray:
        changed = states.copy()
        changed[self.row] = v
        q, rates = self.model.layout.split(changed)
        return np.asarray(self.model.energy(q, rates, 0.0, self.parameters))

    def reached(self, starts: FloatArray, event: Event | None) -> FloatArray:
        """Return the starts (m, 2n) with the velocity in row `row` replaced, so that each has the energy `energy`.

        Two velocities are possible. The one with which the value of `event` changes in the direction of the event is
        chosen, else the larger one. Raises StatementError if a start has more energy even with the velocity zero.
        """
        states, row = np.ascontiguousarray(starts.T), self.row
        a, b, c = self._quadratic(states)
        square = np.asarray(b * b - 4 * a * (c - self.energy))
        scale = b * b + np.abs(4 * a * (np.abs(c) + abs(self.energy)))
        square = np.where(np.abs(square) <= 1e-15 * scale, 0.0, square)
        outside = ~((a != 0) & (square >= 0))
        if outside.any():
            names, index = self.model.statement.state_names, int(np.argmax(outside))
            entries = enumerate(zip(names, starts[index], strict=True))
            others = ", ".join(f"{name} = {x:g}" for k, (name, x) in entries if k != row)
            raise StatementError(
                f"start {index} with {others} has the energy {c[index]:g} if {names[row]} is zero, so no {names[row]} "
                f"gives energy = {self.energy:g}: give a start nearer to rest, or a larger energy."
            )
        first, second = (self._corrected(states, (-b + side * np.sqrt(square)) / (2 * a)) for side in (1.0, -1.0))
        ordered = first[row] >= second[row]
        larger, smaller = np.where(ordered, first, second), np.where(ordered, second, first)
        if event is None or not event.direction:
            return np.ascontiguousarray(larger.T)
        slope, zeros = event.expression.diff(time_symbol), np.zeros(states.shape[1])
        rates = [
            self.model.evaluate_expression(slope, zeros, solution, self.parameters) * event.direction
            for solution in (larger, smaller)
        ]
        return np.ascontiguousarray(np.where((rates[0] > 0) | (rates[1] <= 0), larger, smaller).T)

    def _corrected(self, states: FloatArray, v: FloatArray) -> FloatArray:
        """Return states (2n, m) whose velocity in row `row` is changed so that they have the prescribed energy.

        Newton's method starts from the velocities `v` (m,). Raises StatementError if no such velocity is found.
        """
        for _ in range(ENERGY_CORRECTIONS):
            step = 1e-6 * np.abs(v) + 1e-9
            left = self._energy(states, v) - self.energy
            with np.errstate(all="ignore"):
                ahead, behind = (self._energy(states, v + side * step) for side in (1.0, -1.0))
                moved = v - left * 2 * step / (ahead - behind)
                # If the energy is not finite, halve the velocity: the energy may be finite at a smaller velocity.
                v = np.where(np.isfinite(left), np.where(np.isfinite(moved) & (left != 0), moved, v), v / 2)
        left = np.abs(self._energy(states, v) - self.energy)
        wrong = ~(left <= ENERGY_ERROR * (abs(self.energy) + np.abs(self._energy(states, 0.0))))
        if wrong.any():
            name = self.model.statement.state_names[self.row]
            raise StatementError(
                f"no {name} was found with which start {int(np.argmax(wrong))} has the energy {self.energy:g}: give "
                f"{name} in starts, and leave energy and solve_for out."
            )
        result = states.copy()
        result[self.row] = v
        return result


MOST_SECTION_POINTS = 100_000_000
"""Largest number of points of an orbit that a user may request. A driven system takes minutes for this number."""

BORDER_CELLS = 200  # Number of cells along each axis for the border of a section

BORDER_MARGINS = (0.5, 1.5, 4.0, 10.0, 25.0)
"""Margins of the rectangle in which the border of the allowed region is searched, around the points of a section, as
fractions of the extent of the points. They are tried in turn until the border is a closed line."""


@dataclass(frozen=True, eq=False)
class SectionData:
    """The points of a section, for each of m starts: `times` (k,) and `states` (k, 2n), k crossings.

    - `starts` (m, 2n) are the states at which orbits began.
    - `statuses` and `messages` say how each orbit ended: EVENT with all of its crossings, SUCCESS with fewer.
    - `status` and `message` summarize all orbits.
    - `event` defines the section; it is None for states at times `period` apart.
    - `energy` is the energy of all starts, or None if it was not prescribed.
    - `border` are the closed lines (j, 2) around the states of that energy, in the plane of `axes`.
    - `axes` are the names of the two entries to draw.
    - `drift` is the largest change of the energy relative to its size, None for a system that does not conserve energy.
    """

    statement: Statement
    event: Event | None
    period: float | None
    starts: FloatArray
    times: tuple[FloatArray, ...]
    states: tuple[FloatArray, ...]
    statuses: tuple[Status, ...]
    messages: tuple[str, ...]
    axes: tuple[str, str]
    energy: float | None
    border: tuple[FloatArray, ...]
    drift: float | None
    status: Status
    message: str

    @property
    def points(self) -> FloatArray:
        """States of all orbits, one orbit after the other, (k, 2n)."""
        return np.concatenate(self.states) if self.states else np.empty((0, self.starts.shape[1]))


def section_of(definition: Any, model: Model, parameters: FloatArray) -> Event | float:
    """Return the event that defines a section, or the period after which a section takes points.

    The result is a period if the user's `definition` is a number, or an expression in parameters, whose values are
    `parameters` (k,).
    """
    if isinstance(definition, Event):
        return declare_events([definition], model.statement, constant="a section")[0]
    constant = isinstance(definition, sympy.Expr) and not expression(definition, "the section").has(time_symbol)
    if constant or (not isinstance(definition, (sympy.Basic, str, bytes)) and not callable(definition)):
        pairs = zip(model.statement.parameters, parameters.tolist(), strict=True)
        by_name = {parameter.name: value for parameter, value in pairs}
        known = {p: by_name[p.name] for p in definition.free_symbols if p.name in by_name} if constant else {}
        period = definition.xreplace(known) if constant else definition
        return positive_number(period, "the period of the section", "give a positive time")
    return declare_events([definition], model.statement)[0]


def section(
    runs: Runs,
    definition: Any,
    starts: Any,
    *,
    crossings: Any = 500,
    skip: Any = 0,
    energy: Any = None,
    solve_for: Any = None,
    longest: Any = None,
    progress: Report | None = None,
) -> SectionData:
    """Return the Poincare section of a model's orbits. `definition` is the event or the period of the section.

    - `starts` are the initial states. With `energy` all get this energy, by a change of the velocity `solve_for`.
    - Each orbit is followed for `skip` crossings, and then for `crossings` that are kept.
    - An orbit ends early if no crossing occurs within the time `longest`.
    - `progress` is called with the number of finished orbits.
    """
    model = runs.model
    count, dropped = point_counts(crossings, skip, "crossings", 1)
    remedy = "give a positive time to wait for a crossing"
    wait = None if longest is None else positive_number(longest, "longest", remedy)
    passed = section_of(definition, model, runs.parameters)
    event = passed if isinstance(passed, Event) else None
    states = starts_of(model, starts, initial_of(model, None))
    level = _level(runs, energy, solve_for)
    if level is not None:
        states = level.reached(states, event)
    check_memory((len(states), count + dropped, model.layout.size))
    cross = Crosser(runs, passed, count + dropped, states, wait)
    orbits = [
        replace(orbit, times=orbit.times[dropped:], states=orbit.states[dropped:])
        for orbit in followed(cross, states, progress)
    ]
    axes = drawn_axes(model.statement, event)
    status, message = _ended(orbits, len(states), event, model.statement)
    return SectionData(
        statement=model.statement,
        event=event,
        period=None if isinstance(passed, Event) else passed,
        starts=states[: len(orbits)],
        times=tuple(orbit.times for orbit in orbits),
        states=tuple(orbit.states for orbit in orbits),
        statuses=tuple(orbit.status for orbit in orbits),
        messages=tuple(orbit.message for orbit in orbits),
        axes=axes,
        energy=None if level is None else level.energy,
        border=_border(level, states[0], axes, orbits),
        drift=_drift(runs, states, orbits),
        status=status,
        message=message,
    )


def point_counts(points: Any, skip: Any, label: str, smallest: int) -> tuple[int, int]:
    """Return (`points`, `skip`): the numbers of points to keep and to skip on each orbit.

    Raises StatementError unless both are integers in the allowed range; `smallest` is the least number to keep. `label`
    is the user's name of the argument `points`, for messages.
    """
    kept = whole_number(points, label, smallest, MOST_SECTION_POINTS)
    return kept, whole_number(skip, "skip", 0, MOST_SECTION_POINTS)


def check_memory(shape: Sequence[int]) -> None:
    """Raise StatementError if states of this shape (..., points, 2n) would take too much memory."""
    if math.prod(shape) > MOST_NUMBERS:
        raise StatementError(
            f"the states of {math.prod(shape[:-1]):.3g} points, with those that skip= leaves out, take "
            f"{8 * math.prod(shape):.3g} bytes, more than the limit of {8 * MOST_NUMBERS:.3g}: give fewer points, a "
            "smaller skip, or fewer starts."
        )


def _level(runs: Runs, energy: Any, solve_for: Any) -> EnergyLevel | None:
    """Return the prescribed `energy` of all starts, with the velocity `solve_for` that is changed to reach it.

    Returns None if the user gives neither. Raises StatementError if only one of them is given, and for a `solve_for`
    that is not a velocity.
    """
    model = runs.model
    if energy is None and solve_for is None:
        return None
    if energy is None or solve_for is None:
        raise StatementError(
            "give energy and solve_for together: the energy of all starts, and the velocity that follows from it, such "
            f"as energy=1.0, solve_for='{model.statement.names[0]}_dot'."
        )
    row = row_of(model.statement, solve_for, "solve_for")
    if row < len(model.statement.coordinates):
        raise StatementError(f"solve_for is the coordinate {model.statement.names[row]}: give a velocity.")
    return EnergyLevel(model, runs.parameters, row, real_number(energy, "energy"))


def drawn_axes(statement: Statement, event: Event | None) -> tuple[str, str]:
    """Return the names of the two entries that the picture of a section shows: a coordinate and its velocity.

    The coordinate is the first one that does not occur in the `event` of the section, which may be None.
    """
    names = statement.names
    plain = None if event is None else event.expression.xreplace(dict(statement.plain))
    among = set() if plain is None else {symbol.name for symbol in plain.free_symbols}
    free = [name for name in names if name not in among and f"{name}_dot" not in among]
    chosen = (free or list(names))[0]
    return chosen, f"{chosen}_dot"


def _border(
    level: EnergyLevel | None, start: FloatArray, axes: tuple[str, str], orbits: Sequence[Crossings]
) -> tuple[FloatArray, ...]:
    """Return the border lines (j, 2), in the plane of `axes`, of the region that the energy allows.

    There are lines only if the energy `level` is prescribed, the state has four entries, and the velocity that follows
    from the energy is not one of the axes. `start` (2n,) has the entries that are not drawn. The border is searched
    around the points of `orbits`.
    """
    if level is None or len(start) != 4:
        return ()
    points = np.concatenate([orbit.states for orbit in orbits]) if orbits else np.empty((0, 0))
    columns = [level.model.statement.state_names.index(name) for name in axes]
    if len(points) < 2 or level.row in columns:
        return ()
    low, high = points[:, columns].min(axis=0), points[:, columns].max(axis=0)

    def inside(a: FloatArray, b: FloatArray) -> FloatArray:
        states = np.repeat(start[:, None], len(a), axis=1)
        states[columns[0]], states[columns[1]] = a, b
        return level.margin(states)

    for margin in BORDER_MARGINS:
        beyond = margin * (high - low) + 1e-12
        x, y = (np.linspace(a - r, b + r, BORDER_CELLS) for a, b, r in zip(low, high, beyond, strict=True))
        closed = tuple(line for line in zero_lines(inside, x, y) if (line[0] == line[-1]).all())
        if closed:
            return closed
    return ()


def _drift(runs: Runs, states: FloatArray, orbits: Sequence[Crossings]) -> float | None:
    """Return the drift of the energy along `orbits`, or None if the system does not conserve energy or has no orbit.

    The drift is the largest change from the energy at the start of an orbit, divided by the largest absolute energy on
    all orbits. `states` (m, 2n) are the starts of the orbits.
    """
    model = runs.model
    if not model.conservative or not orbits:
        return None
    worst, size = 0.0, 1e-300
    for start, orbit in zip(states, orbits, strict=False):
        whole = np.vstack([start[None, :], orbit.states])
        q, v = model.layout.split(np.ascontiguousarray(whole.T))
        energies = np.asarray(model.energy(q, v, 0.0, runs.parameters))
        worst, size = max(worst, float(np.abs(energies - energies[0]).max())), max(size, float(np.abs(energies).max()))
    return worst / size


def _ended(orbits: Sequence[Crossings], count: int, event: Event | None, statement: Statement) -> tuple[Status, str]:
    """Return the status and the message of a section.

    `orbits` are the finished orbits, and `count` is the number of orbits that were to be run. `event` defines the
    section; it is None if points are taken after each period.
    """
    total = sum(len(orbit.times) for orbit in orbits)
    noun = "point" if event is None else "crossing"
    if len(orbits) < count or any(orbit.status is Status.INTERRUPTED for orbit in orbits):
        return Status.INTERRUPTED, (
            f"interrupted: {counted(total, noun)} of {len(orbits)} among {counted(count, 'orbit')} were computed and "
            "are kept."
        )
    short = [(k, orbit) for k, orbit in enumerate(orbits) if orbit.status is not Status.EVENT and event is not None]
    short = short or [(k, orbit) for k, orbit in enumerate(orbits) if not orbit.status.complete]
    words = f"{counted(total, noun)} of {counted(count, 'orbit')}."
    if not short:
        return Status.SUCCESS, words
    index, first = short[0]
    if event is not None and not total:
        direction = {1: " rising", -1: " falling"}.get(event.direction, "")
        words = f"no orbit passes {surface(event, statement)}{direction}."
    failed = [orbit.status for orbit in orbits if not orbit.status.complete]
    return (failed or [Status.SUCCESS])[0], f"{words} Start {index}: {first.message}" + (
        f" {len(short) - 1} more ended early." if len(short) > 1 else ""
    )


def surface(event: Event, statement: Statement) -> str:
    """Return the equation of a section, such as "theta = 0", as text: the expression of its event is zero.

    A long expression is cut to about 60 characters.
    """
    return f"{statement.quote(event.expression, 60)} = 0"
