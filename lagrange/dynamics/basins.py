"""Basins of attraction: at which equilibrium, or on which cycle of a driven motion, each start of a plane ends.

Attractors are found on the way: an end at rest is refined by Newton's method and kept if its eigenvalues attract;
points after whole periods of a driving that come again are a cycle. A run ends when it is close to a known one.
Source: G. Datseris, A. Wagemakers, Effortless estimation of basins of attraction, Chaos 32, 2022.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.dynamics.angles import TURN, angles, difference
from lagrange.dynamics.axes import Plane, plane_of
from lagrange.dynamics.cells import NONE, NOT_COMPUTED, Places, coarse_first, each_cell, states_of, workers_of
from lagrange.dynamics.driving import depends_on_time, driving_period
from lagrange.dynamics.passage import CELLS
from lagrange.dynamics.runs import Report, Runs, initial_of, starts_of, time_scale
from lagrange.errors import RunError, StatementError, counted
from lagrange.machine.backend import FloatArray
from lagrange.statement.number import real_number
from lagrange.statement.statement import Statement
from lagrange.trajectory.flow import Flow
from lagrange.trajectory.trajectory import Status

CLOSE = 1e-3
"""Distance from an attractor, in parts of the plane and of its width in a mean period, at which a run has arrived."""

AT_REST = 1e-3
"""Way in a mean period, in the same measure, of a run that may be at rest."""

LEG = 2.0
"""Mean periods between two looks at a run without driving."""

LONGEST_CYCLE = 8
"""Most periods of the driving after which a motion may come again to be a cycle."""

REPEATS = 1e-4
"""Distance, in the measure of `CLOSE`, of points of a cycle that come again before it is refined."""

SETTLING = 200
"""Periods of the driving for which a new cycle is followed before its points are kept."""

DEFAULT_PERIODS = 200
"""Mean periods, or those of the driving, for which a run may go on to settle."""

NEWTON_STEPS = 12

FIRST_CELLS = 64
"""Cells of a coarse grid that look for attractors."""


@dataclass(frozen=True, eq=False)
class Attractor:
    """An equilibrium, one state, or a cycle of a driven motion, its states after each period: `states` (p, 2n)."""

    states: FloatArray

    @property
    def period(self) -> int:
        """The number of periods of the driving after which it comes again; 1 for an equilibrium."""
        return len(self.states)


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


class _Settling:
    """What the runs of a map share: the flow, the measure of distances, and the attractors found so far."""

    def __init__(self, runs: Runs, plane: Plane, base: FloatArray, t_end: float | None) -> None:
        model, statement = runs.model, runs.model.statement
        self.runs, self.model, self.parameters = runs, model, runs.parameters
        values = dict(zip(statement.parameters, runs.parameters.tolist(), strict=True))
        self.period = driving_period(statement, values) if depends_on_time(statement) else None
        corners = states_of(plane, base, np.array([[i, j] for i in (0, -1) for j in (0, -1)]))
        self.scale = self.period or time_scale(model, corners, runs.parameters, statement.run.t_end / 10)
        self.leg = self.period or LEG * self.scale
        self.end = DEFAULT_PERIODS * self.scale if t_end is None else t_end
        self.periodic = angles(statement)
        self.flow, self.values = Flow(model, runs.options), None if _are_defaults(runs) else values
        self.sizes = _sizes(plane, self.periodic, self.scale)
        self.attractors: list[Attractor] = []
        self.lock = threading.Lock()

    def distance(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return distances of states (..., 2n), in parts of the plane."""
        return np.asarray(np.linalg.norm(difference(a, b, self.periodic) / self.sizes, axis=-1))

    def settle(self, starts: FloatArray, stopped: Callable[[], bool]) -> tuple[NDArray[np.int_], FloatArray]:
        """Return the attractors (k,) of starts (k, 2n), and the times (k,) at which they are close to them.

        A start has the label `NONE` if it does not settle, and `NOT_COMPUTED` if `stopped()` became true before.
        """
        labels, times = np.full(len(starts), NONE), np.full(len(starts), np.nan)
        active, passed, t = np.arange(len(starts)), [starts], 0.0
        while t < self.end and len(active):
            if stopped():
                labels[active] = NOT_COMPUTED
                break
            passed.append(self.moved(passed[-1], active, t))
            t += self.leg
            active = active[np.isfinite(passed[-1][active]).all(axis=1)]
            found, when = self.known(passed, active, t)
            settled = active[(found == NONE) & self.settled(passed, active)]
            if sum(self.add(passed, int(i), t) for i in settled):
                found, when = self.known(passed, active, t)
            labels[active], times[active] = found, when
            active = active[found == NONE]
            del passed[: -2 * LONGEST_CYCLE - 1]
        return labels, times

    def moved(self, states: FloatArray, active: NDArray[np.int_], t: float) -> FloatArray:
        """Return states (k, 2n) one leg later, the active ones; NaN where a run has no end."""
        found = np.full_like(states, np.nan)
        for i in active.tolist():
            try:
                found[i] = self.flow(states[i], t, t + self.leg, self.values)
            except RunError:
                continue
        return found

    def known(
        self, passed: Sequence[FloatArray], active: NDArray[np.int_], t: float
    ) -> tuple[NDArray[np.int_], FloatArray]:
        """Return the attractors (a,) that active runs are close to, among those that are known, and since when."""
        labels, times = np.full(len(active), NONE), np.full(len(active), np.nan)
        for k, attractor in enumerate(tuple(self.attractors)):
            p = attractor.period
            if len(passed) <= p:
                continue
            apart = self.distance(passed[-1][active][:, None], attractor.states[None])
            place = apart.argmin(axis=1)
            now, before = apart.min(axis=1), self.distance(passed[-1 - p][active], attractor.states[place])
            near = (now <= CLOSE) & ((before <= 10 * CLOSE) | (self.period is None)) & (labels == NONE)
            labels[near] = k
            # On the way to it the distance falls exponentially.
            with np.errstate(all="ignore"):
                share = np.log(CLOSE / now) / np.log(before / now)
            share = np.clip(np.nan_to_num(share), 0.0, 1.0)
            times[near] = (t - p * self.leg * share)[near]
        return labels, times

    def settled(self, passed: Sequence[FloatArray], active: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Return which of the active runs may be on an attractor, (a,)."""
        if self.period is not None:
            return np.array([self.cycle([states[i] for states in passed], REPEATS) > 0 for i in active], dtype=bool)
        if not len(active):
            return np.zeros(0, dtype=bool)
        try:
            rates = self.model.rhs(0.0, np.ascontiguousarray(passed[-1][active].T), self.parameters).T
        except RunError:
            return np.zeros(len(active), dtype=bool)
        return np.asarray(np.linalg.norm(rates * self.scale / self.sizes, axis=1) <= AT_REST)

    def cycle(self, passed: Sequence[FloatArray], tolerance: float) -> int:
        """Return the least number of periods after which the last states come again, 0 if none."""
        for p in range(1, LONGEST_CYCLE + 1):
            if len(passed) > 2 * p and all(
                self.distance(passed[-1 - i], passed[-1 - i - p]) <= tolerance for i in range(p)
            ):
                return p
        return 0

    def add(self, passed: Sequence[FloatArray], run: int, t: float) -> bool:
        """Refine what a run has settled at, and add it to the attractors unless it is there; return whether it is."""
        last = passed[-1][run]
        made = self.equilibrium(last) if self.period is None else self.refined_cycle(last, t)
        if made is None:
            return False
        with self.lock:
            if not any((self.distance(one.states, made.states[0]) <= CLOSE).any() for one in self.attractors):
                self.attractors.append(made)
        return True

    def equilibrium(self, near: FloatArray) -> Attractor | None:
        """Return the equilibrium next to a state, if it is close and attracts."""
        y = near.copy()
        for _ in range(NEWTON_STEPS):
            try:
                slope = self.model.jacobian(0.0, y, self.parameters)
                step = np.linalg.lstsq(slope, self.model.rhs(0.0, y, self.parameters), rcond=1e-12)[0]
            except (RunError, np.linalg.LinAlgError):
                return None
            y = y - step
        if not np.isfinite(y).all() or self.distance(y, near) > 10 * CLOSE:
            return None
        values = np.linalg.eigvals(self.model.jacobian(0.0, y, self.parameters))
        if values.real.max() > 1e-9 * np.abs(values).max():
            return None
        y[np.abs(y) < 1e-12 * self.sizes] = 0.0
        return Attractor(self.in_one_turn(y[None, :]))

    def refined_cycle(self, y: FloatArray, t: float) -> Attractor | None:
        """Return the cycle that a motion settles on."""
        passed = [y]
        for _ in range(SETTLING):
            try:
                passed.append(self.flow(passed[-1], t, t + self.leg, self.values))
            except RunError:
                return None
            t += self.leg
        p = self.cycle(passed, REPEATS)
        if not p:
            return None
        states = self.in_one_turn(np.array(passed[-p:]))
        first = int(np.lexsort(np.round(states / self.sizes, 6).T[::-1])[0])
        return Attractor(np.roll(states, -first, axis=0))

    def in_one_turn(self, states: FloatArray) -> FloatArray:
        """Return states with angles between -pi and pi."""
        found = states.copy()
        for i, turns in enumerate(self.periodic):
            if turns:
                found[:, i] -= TURN * np.ceil(np.round(found[:, i] / TURN, 12) - 0.5)
        return found


def _are_defaults(runs: Runs) -> bool:
    """Return whether the parameters are those of the statement, which calls need not be given."""
    defaults = runs.model.statement.defaults
    stated = [defaults.get(p) for p in runs.model.statement.parameters]
    return bool(stated == runs.parameters.tolist())


def _sizes(plane: Plane, periodic: tuple[bool, ...], scale: float) -> FloatArray:
    """Return what counts as one for each entry of the state: the width of its axis, or that of the other's motion."""
    n = len(periodic)
    sizes = np.full(2 * n, np.nan)
    for axis in plane:
        sizes[axis.row] = axis.width
    for i in range(n):
        known = sizes[i] if np.isfinite(sizes[i]) else sizes[n + i] * scale / TURN
        sizes[i] = min(known, TURN) if periodic[i] and np.isfinite(known) else known
        if not np.isfinite(sizes[n + i]):
            sizes[n + i] = sizes[i] * TURN / scale
    for half in (slice(0, n), slice(n, 2 * n)):
        part = sizes[half]
        part[~np.isfinite(part)] = np.nanmax(part) if np.isfinite(part).any() else 1.0
    return sizes


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
    work = _Settling(runs, plane, base, end)
    if attractors is not None:
        work.attractors = _given(work, starts_of(model, attractors, np.zeros(model.layout.size)))
    shape = plane[1].count, plane[0].count
    labels, times = np.full(shape, NOT_COMPUTED), np.full(shape, np.nan)

    def run(places: Places, states: FloatArray, stopped: Callable[[], bool]) -> int:
        found, when = work.settle(states, stopped)
        labels[places[:, 0], places[:, 1]], times[places[:, 0], places[:, 1]] = found, when
        return int((found != NOT_COMPUTED).sum())

    whole = _looked_around(work, plane, base) and each_cell(plane, base, run, workers_of(workers), progress)
    made, labels = _in_order(work, labels)
    status, message = _ended(labels, made, work.end, whole=whole)
    return BasinsData(statement, plane, base, made, labels, times, work.period, work.end, status, message)


def _looked_around(work: _Settling, plane: Plane, base: FloatArray) -> bool:
    """Find the attractors of a coarse grid, and return whether that was done, false after Ctrl-C.

    Runs that find one settle on it late, and the times of a map are to be those of runs that know it.
    """
    places = coarse_first(plane[1].count, plane[0].count)[:FIRST_CELLS]
    try:
        if not work.attractors:
            work.settle(states_of(plane, base, places), lambda: False)
    except KeyboardInterrupt:
        return False
    return True


def _given(work: _Settling, states: FloatArray) -> list[Attractor]:
    """Return the attractors next to states that a user gives."""
    found = []
    for k, state in enumerate(states):
        made = work.equilibrium(state) if work.period is None else work.refined_cycle(state, 0.0)
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


def _in_order(work: _Settling, labels: FloatArray) -> tuple[tuple[Attractor, ...], FloatArray]:
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
