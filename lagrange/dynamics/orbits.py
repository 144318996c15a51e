"""Compute orbits in a plane (x, v), and separatrices of saddles, for phase portraits.

An orbit is run forwards and backwards in time until it leaves a window, closes or comes to rest. Separatrices are the
orbits that begin or end at a saddle. Near a saddle s the motion along an eigenvector w is s + d w up to an error of the
second order in d. The distance d is halved until the error of the start is below `LINEAR_ERROR` of the window. The
component of the velocity along the other eigenvector gives an estimate of this error. Source: T. S. Parker, L. O. Chua,
Practical Numerical Algorithms for Chaotic Systems, 1989, chapter 6.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagrange.dynamics.axes import Axis, Plane, difference
from lagrange.dynamics.fixed_points import SADDLE, FixedPoint
from lagrange.dynamics.runs import Runs
from lagrange.machine.backend import FloatArray
from lagrange.statement.coordinate import velocity_of
from lagrange.statement.event import Event, event
from lagrange.trajectory.measures.times_and_points import divided
from lagrange.trajectory.trajectory import FloatArray as States
from lagrange.trajectory.trajectory import Status, Trajectory, run_until

WINDOW_MARGIN = 0.02
"""Distance outside of the window, as a fraction of its width, at which a run ends. The end is not visible."""

PERIODS = 20  # Time for which an orbit is followed, in mean periods of small oscillations

SAMPLES_PER_STEP = 32
"""Number of states in each step that are tested for the return of an orbit and the arrival at an equilibrium.

A step of a Taylor series covers at most three periods."""

CLOSED = 1e-6  # Distance from its start, as a fraction of the window, below which an orbit counts as closed
ARRIVED = 5e-4  # Distance from an equilibrium, as a fraction of the window, at which an orbit ends


@dataclass(frozen=True, eq=False)
class PlaneWindow:
    """A rectangle in the plane of two entries of the state.

    `plane` has the horizontal and the vertical axis with their ranges. `periodic` has for each coordinate True if it is
    an angle. `reach` is the longest time for which an orbit is followed.
    """

    plane: Plane
    periodic: tuple[bool, ...]
    reach: float

    def wraps(self, axis: Axis) -> bool:
        """Return True if the entry on an axis is an angle."""
        return axis.row < len(self.periodic) and self.periodic[axis.row]

    @property
    def rows(self) -> tuple[int, int]:
        """Indices in the state of the entries on the horizontal and on the vertical axis."""
        return self.plane[0].row, self.plane[1].row

    @property
    def widths(self) -> FloatArray:
        """Lengths of the ranges on the horizontal and on the vertical axis, (2,)."""
        return np.array([axis.width for axis in self.plane])

    def exits(self, runs: Runs) -> list[Event]:
        """Return the events that end a run of the model of `runs` where it leaves the window.

        There is one event for each axis whose entry is not an angle.
        """
        statement = runs.model.statement
        entries = (*statement.coordinates, *(velocity_of(q) for q in statement.coordinates))
        axes = [axis for axis in self.plane if not self.wraps(axis)]
        return [
            event(
                (entries[axis.row] - (axis.low - WINDOW_MARGIN * axis.width))
                * (entries[axis.row] - (axis.high + WINDOW_MARGIN * axis.width)),
                direction=1,
                terminal=True,
            )
            for axis in axes
        ]

    def holds(self, state: FloatArray) -> bool:
        """Return True if a state is inside the window."""
        return all(axis.low <= state[axis.row] <= axis.high or self.wraps(axis) for axis in self.plane)

    def distance(self, states: States, point: FloatArray) -> FloatArray:
        """Return the distances (k,) in the plane of states (k, 2n) from a point (2n,), as fractions of the window."""
        rows = list(self.rows)
        return np.asarray(np.linalg.norm(difference(states, point, self.periodic)[:, rows] / self.widths, axis=1))


@dataclass(frozen=True, eq=False)
class Orbit:
    """A run through the plane: increasing times `t` (k,) and states (k, 2n).

    `status` and `message` say how the run ended. `at(times)` interpolates states. `closed` is true if the orbit
    returned to its start. `parts` are the runs that make up the orbit. Angles are not wrapped.
    """

    t: FloatArray
    states: FloatArray
    status: Status
    message: str
    closed: bool
    parts: tuple[Trajectory, ...]

    def at(self, times: FloatArray) -> FloatArray:
        """Return the states (j, 2n) at times (j,) within the orbit, from the dense output of its runs."""
        chosen = np.clip(np.asarray(times, dtype=float), self.t[0], self.t[-1])
        states = np.empty((len(chosen), self.states.shape[1]))
        for part in self.parts:
            low, high = sorted(part.span)
            inside = (chosen >= low) & (chosen <= high)
            if inside.any():
                states[inside] = part.dense(chosen[inside]).T
        return states


def orbit(
    runs: Runs, window: PlaneWindow, start: FloatArray, exits: Sequence[Event], begin: float, *, both_ways: bool
) -> Orbit:
    """Return the orbit from the state `start` at the time `begin` to the first event of `exits`.

    Without an event it lasts `window.reach`. If `both_ways` is true, the orbit ends at its first return to its start,
    or is also followed backwards in time if it does not return.
    """
    forwards = runs(start, begin, begin + window.reach, events=exits)
    forwards, closed = _closed(window, forwards) if both_ways else (forwards, False)
    if closed or not both_ways or forwards.status is Status.INTERRUPTED:
        return orbit_of((forwards,), closed=closed)
    backwards = runs(start, begin, begin - window.reach, events=exits)
    return orbit_of((backwards, forwards), closed=False)


def orbit_of(parts: Sequence[Trajectory], *, closed: bool) -> Orbit:
    """Return the orbit that joins the runs `parts`, in the order of time. `closed` is True if it returns to its start.

    Its status and message come from the first incomplete run, or from the last run if all are complete.
    """
    ways = [1 if part.span[1] >= part.span[0] else -1 for part in parts]
    ordered = [(part.t[::way], part.y.T[::way]) for part, way in zip(parts, ways, strict=True)]
    t = np.concatenate([ordered[0][0], *(times[1:] for times, _ in ordered[1:])])
    states = np.concatenate([ordered[0][1], *(rows[1:] for _, rows in ordered[1:])])
    last = next((part for part in parts if not part.status.complete), parts[-1])
    return Orbit(t, states, last.status, last.message, closed, tuple(parts))


def sampled(run: Trajectory, per_step: int = SAMPLES_PER_STEP) -> tuple[FloatArray, FloatArray]:
    """Return times (k,) along a run, `per_step` in each step, and the states (k, 2n) at these times."""
    if len(run.t) < 2:
        return run.t, run.y.T
    times = divided(run.t, per_step)
    return times, run.dense(times).T


def cut(run: Trajectory, end: float) -> Trajectory:
    """Return the part of a run up to the time `end`, with the state at this time as its last state."""
    if not (min(run.span) < end < max(run.span)):
        return run
    short = run_until(run, end)
    at_end = run.dense(np.array([end]))
    return replace(short, t=np.append(short.t, end), y=np.hstack([short.y, at_end]), status=Status.SUCCESS)


def _closed(window: PlaneWindow, run: Trajectory) -> tuple[Trajectory, bool]:
    """Cut a run at its first return to its start, within CLOSED of the window: return (the part before it, True).

    If the run does not return to its start, the result is (the whole run, False).
    """
    times, states = sampled(run)
    if len(times) < 3:
        return run, False
    start, way = states[0], states[1] - states[0]
    rows = list(window.rows)

    def ahead(states: FloatArray) -> FloatArray:
        """Return the progress (k,) of states (k, 2n) from the start of the run, in the direction of its first step.

        It is the component of the displacement in the plane, in widths of the window, and negative for a state behind
        the start. So the orbit passes its start where the sign becomes positive.
        """
        moved = difference(states, start, window.periodic)[:, rows] / window.widths
        return np.asarray(moved @ (way[rows] / window.widths))

    passed = ahead(states)
    near = window.distance(states, start) < 0.25
    for k in np.nonzero((passed[:-1] < 0) & (passed[1:] >= 0) & near[:-1] & near[1:])[0].tolist():
        low, high = float(times[k]), float(times[k + 1])
        for _ in range(60):
            middle = low + (high - low) / 2
            before = ahead(run.dense(np.array([middle])).T)[0] < 0
            low, high = (middle, high) if before else (low, middle)
        if window.distance(run.dense(np.array([high])).T, start)[0] <= CLOSED:
            return cut(run, high), True
    return run, False


def until_arrival(window: PlaneWindow, run: Trajectory, equilibria: Sequence[FixedPoint]) -> Trajectory:
    """Return the part of a run up to its first arrival at one of the `equilibria`, or the whole run if there is none.

    A run arrives if its distance from the equilibrium in the plane, as a fraction of the window, was above 10 ARRIVED
    and falls below ARRIVED.
    """
    times, states = sampled(run)
    best = math.inf
    end = run.span[1]
    for equilibrium in equilibria:
        distance = window.distance(states, equilibrium.state)
        away = np.nonzero(distance > 10 * ARRIVED)[0]
        if not len(away):
            continue
        close = away[0] + np.nonzero(distance[away[0] :] < ARRIVED)[0]
        if not len(close):
            continue
        k = int(close[0])
        if abs(times[k] - run.span[0]) < best:
            best, end = abs(times[k] - run.span[0]), float(times[k])
    return cut(run, end)


LINEAR_ERROR = 1e-10
"""Largest distance between the start of a computed separatrix and the exact separatrix, as a fraction of the window.

Rounding of the saddle itself is 1e-16 and grows along the motion, so a smaller limit has no effect."""

FIRST_DISTANCE, LEAST_DISTANCE = 1e-2, 1e-7
"""First and least distance from the saddle at which a separatrix may begin, as fractions of the window. The distance is
halved until the error of the start is small enough."""


@dataclass(frozen=True, eq=False)
class Separatrix:
    """A branch of the stable or the unstable manifold of a saddle: an orbit with one end close to the saddle.

    `saddle` is the index of the saddle among the fixed points. `stable` is true if the motion approaches the saddle
    with increasing time. `distance` is the distance between the saddle and this end, in units of the state.
    """

    saddle: int
    stable: bool
    orbit: Orbit
    distance: float


def separatrices_of(
    runs: Runs, window: PlaneWindow, equilibria: Sequence[FixedPoint], number: int, exits: Sequence[Event]
) -> list[Separatrix]:
    """Return the four separatrices of the saddle `equilibria[number]`, two in each direction of time.

    The list is empty if the equilibrium is not a saddle, or outside of the window. A separatrix ends at an event of
    `exits`, at an equilibrium of `equilibria`, or after the time `window.reach`.
    """
    saddle = equilibria[number]
    if saddle.kind != SADDLE or not window.holds(saddle.state):
        return []
    branches = []
    rates, inverse = saddle.eigenvalues.real, np.linalg.inv(saddle.eigenvectors.real)
    for column in (0, 1):
        rate = float(saddle.eigenvalues[column].real)
        vector = saddle.eigenvectors[:, column].real / np.linalg.norm(
            saddle.eigenvectors[:, column].real / window.widths
        )
        for side in (1.0, -1.0):
            part = FIRST_DISTANCE
            while part > LEAST_DISTANCE:
                aside = inverse @ runs.model.rhs(0.0, saddle.state + part * side * vector, runs.parameters)
                # The deviation `off` along the other eigenvector is of order d**2 and grows at twice the rate, so that
                # aside = (2 rate - other rate) off.
                off = abs(aside[1 - column]) / abs(2 * rates[column] - rates[1 - column])
                size = off * np.linalg.norm(saddle.eigenvectors.real[:, 1 - column] / window.widths)
                if np.isfinite(size) and size <= LINEAR_ERROR:
                    break
                part /= 2
            span = math.copysign(math.log(1.0 / part) / abs(rate) + window.reach, rate)
            run = runs(saddle.state + side * part * vector, 0.0, span, events=exits)
            run = until_arrival(window, run, equilibria)
            length = float(np.linalg.norm(part * vector))
            branches.append(Separatrix(number, rate < 0, orbit_of((run,), closed=False), length))
    return branches
