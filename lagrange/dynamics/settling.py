"""Motions followed until they settle: at an equilibrium, or on a cycle of a driven motion.

Attractors are found on the way: an end at rest is refined by Newton's method and kept if its eigenvalues attract;
points after whole periods of a driving that come again are a cycle. A run ends when it is close to a known one.
Source: G. Datseris, A. Wagemakers, Effortless estimation of basins of attraction, Chaos 32, 2022.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lagrange.dynamics.angles import TURN, angles, difference
from lagrange.dynamics.axes import Plane
from lagrange.dynamics.cells import NONE, NOT_COMPUTED, states_of
from lagrange.dynamics.driving import depends_on_time, driving_period
from lagrange.dynamics.runs import Runs, time_scale
from lagrange.errors import RunError
from lagrange.machine.backend import FloatArray
from lagrange.members.chunk import SUCCESS, Ends, Starts, Stopped
from lagrange.members.keep import END, STATE, STATUS
from lagrange.members.lanes import LaneEngine
from lagrange.trajectory.flow import Flow
from lagrange.trajectory.methods.settings import check_options

LABEL, WHEN = "label", "when"
"""Columns: the place of the attractor of a member among those that are known, and when it is close to it."""

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


@dataclass(frozen=True, eq=False)
class Attractor:
    """An equilibrium, one state, or a cycle of a driven motion, its states after each period: `states` (p, 2n)."""

    states: FloatArray

    @property
    def period(self) -> int:
        """The number of periods of the driving after which it comes again; 1 for an equilibrium."""
        return len(self.states)


class Settling:
    """Runs members of a map until they settle; what they share: the measure of distances, the attractors found so far.

    With `many` members they are run side by side where that can be.
    """

    form = "legs between two looks"

    def __init__(self, runs: Runs, plane: Plane, base: FloatArray, t_end: float | None, *, many: bool) -> None:
        model, statement = runs.model, runs.model.statement
        self.model, self.parameters = model, runs.parameters
        values = dict(zip(statement.parameters, runs.parameters.tolist(), strict=True))
        self.period = driving_period(statement, values) if depends_on_time(statement) else None
        corners = states_of(plane, base, np.array([[i, j] for i in (0, -1) for j in (0, -1)]))
        self.scale = self.period or time_scale(model, corners, runs.parameters, statement.run.t_end / 10)
        self.leg = self.period or LEG * self.scale
        self.end = DEFAULT_PERIODS * self.scale if t_end is None else t_end
        self.periodic = angles(statement)
        self.sizes = _sizes(plane, self.periodic, self.scale)
        runs = _within(runs, CLOSE * float(self.sizes.min()))
        self.flow, self.values = Flow(model, runs.options), None if _are_defaults(runs) else values
        # A flow is faster than an engine that runs members one by one.
        engine = runs.job(0.0, self.leg, (END,)).engine() if many else None
        self.lanes = engine if isinstance(engine, LaneEngine) else None
        self.attractors: list[Attractor] = []
        self.lock = threading.Lock()

    @property
    def side_by_side(self) -> int:
        """How many members take as long as one."""
        return 1 if self.lanes is None else self.lanes.side_by_side

    def distance(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return distances of states (..., 2n), in parts of the plane."""
        return np.asarray(np.linalg.norm(difference(a, b, self.periodic) / self.sizes, axis=-1))

    def run(self, starts: Starts, stopped: Stopped) -> Ends:
        """Return the `LABEL` of the attractor of each member, and the `WHEN` at which it is close to it.

        A member has the label `NONE` if it does not settle, and `NOT_COMPUTED` if `stopped()` became true before.
        """
        count = len(starts)
        labels, times = np.full(count, NONE), np.full(count, np.nan)
        active, passed, legs = np.arange(count), [starts.states], 0
        while legs * self.leg < self.end and len(active):
            if stopped():
                labels[active] = NOT_COMPUTED
                break
            passed.append(self.moved(passed[-1], active))
            legs += 1
            t = legs * self.leg
            active = active[np.isfinite(passed[-1][active]).all(axis=1)]
            found, when = self.known(passed, active, t)
            settled = active[(found == NONE) & self.settled(passed, active)]
            if sum(self.add(passed, int(i)) for i in settled):
                found, when = self.known(passed, active, t)
            labels[active], times[active] = found, when
            active = active[found == NONE]
            del passed[: -2 * LONGEST_CYCLE - 1]
        return Ends({LABEL: labels, WHEN: times})

    def moved(self, states: FloatArray, active: NDArray[np.int_]) -> FloatArray:
        """Return states (k, 2n) one leg later, the active ones; NaN where a run has no end.

        Every leg begins at time 0: equations have no time in them, or that of the driving, and a leg is its period.
        """
        found = np.full_like(states, np.nan)
        if self.lanes is not None:
            ends = self.lanes.run(Starts(states[active], self.parameters[None]), lambda: False).columns
            there = ends[STATUS] == SUCCESS
            found[active[there]] = ends[STATE][there]
            return found
        for i in active.tolist():
            try:
                found[i] = self.flow(states[i], 0.0, self.leg, self.values)
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
        if not len(active):
            return np.zeros(0, dtype=bool)
        if self.period is not None:
            return self.cycles([states[active] for states in passed], REPEATS) > 0
        try:
            rates = self.model.rhs(0.0, np.ascontiguousarray(passed[-1][active].T), self.parameters).T
        except RunError:
            return np.zeros(len(active), dtype=bool)
        return np.asarray(np.linalg.norm(rates * self.scale / self.sizes, axis=1) <= AT_REST)

    def cycles(self, passed: Sequence[FloatArray], tolerance: float) -> NDArray[np.int_]:
        """Return the least number of periods after which the last states (a, 2n) come again, 0 if none, (a,)."""
        found = np.zeros(len(passed[-1]), dtype=int)
        for p in range(1, LONGEST_CYCLE + 1):
            left = np.flatnonzero(found == 0)
            for i in range(p if len(passed) > 2 * p else 0):
                left = left[self.distance(passed[-1 - i][left], passed[-1 - i - p][left]) <= tolerance]
            if len(passed) > 2 * p:
                found[left] = p
        return found

    def add(self, passed: Sequence[FloatArray], run: int) -> bool:
        """Refine what a run has settled at, and add it to the attractors unless it is there; return whether it is."""
        last = passed[-1][run]
        made = self.equilibrium(last) if self.period is None else self.refined_cycle(last)
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

    def refined_cycle(self, y: FloatArray) -> Attractor | None:
        """Return the cycle that a motion settles on."""
        passed = [y]
        for _ in range(SETTLING):
            try:
                passed.append(self.flow(passed[-1], 0.0, self.leg, self.values))
            except RunError:
                return None
        p = int(self.cycles([state[None] for state in passed], REPEATS)[0])
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


def _within(runs: Runs, size: float) -> Runs:
    """Return runs whose error is bounded relative to a size, where a relative tolerance alone is given.

    Next to an equilibrium the state is as small as the rounding of forces that cancel, and a tolerance relative to it
    would ask for ever shorter steps.
    """
    options = runs.options
    check_options(rtol=options.rtol)
    if options.rtol is None or options.atol is not None:
        return runs
    return replace(runs, options=replace(options, atol=options.rtol * size))


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
