"""Orbits on a section: followed one by one to their crossings, or in parallel from period to period."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from lagrange.dynamics.runs import Report, Runs, time_scale
from lagrange.errors import counted
from lagrange.machine.backend import FloatArray
from lagrange.members.chunk import STATUSES, Ends, Engine, Starts, Table
from lagrange.members.job import ChunkResult
from lagrange.members.keep import END, OUTPUTS, STATUS
from lagrange.members.lanes import LaneEngine
from lagrange.members.varied import MemberNumbers
from lagrange.members.work import ThreadRunner, run_members, threads_of
from lagrange.statement.event import Event
from lagrange.trajectory.trajectory import Status, Trajectory

CROSSINGS_PER_RUN = 2000
"""Crossings after which an orbit continues in a new run, which bounds the memory for its steps."""

PERIODS_PER_CROSSING = 2.0
"""Length of the first run of an orbit: mean periods of small motions per crossing."""

LONGEST_WAIT = 200
"""Longest wait for a crossing, in mean periods of small motions; then the orbit ends."""

MANY = 300_000
"""Number of points from which orbits run in parallel lanes, which halves the time.

A driven oscillator takes 0.25 s to compile, and then 0.3 us a point; orbits one by one take 2 us a point. An event
takes 1 s to compile, and lanes halve the time only from a million crossings on: such orbits run one by one.
"""


@dataclass(frozen=True, eq=False)
class Crossings:
    """Times (k,) and states (k, 2n) of one orbit on a section, with its final status and message."""

    times: FloatArray
    states: FloatArray
    status: Status
    message: str

    @classmethod
    def interrupted(cls, dimension: int) -> Crossings:
        """Return the empty crossings of an orbit that did not begin before Ctrl-C."""
        return cls(np.empty(0), np.empty((0, dimension)), Status.INTERRUPTED, "was interrupted.")


class Crosser:
    """Follows orbits to a number of crossings of one section; the event is prepared once."""

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
        """Return the crossings of the orbit from a state (2n,)."""
        return self._at_times(start, begin) if self.period is not None else self._at_events(start, begin)

    def _at_times(self, start: FloatArray, begin: float) -> Crossings:
        times = begin + (self.period or 0.0) * np.arange(1.0, self.count + 1.0)
        run = self.runs(start, begin, float(times[-1]), t_eval=times)
        return Crossings(run.t, run.y.T, run.status, run.message)

    def _at_events(self, start: FloatArray, begin: float) -> Crossings:
        times: list[FloatArray] = []
        states: list[FloatArray] = []
        left, since, y, leg, first = self.count, begin, start, self._first_leg(), begin
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
            seen = self.count - left
            leg = max(self.wait / 2, 1.2 * left * (begin - first) / seen) if seen else self.wait

    def _first_leg(self) -> float:
        return PERIODS_PER_CROSSING * self.scale * min(self.count, CROSSINGS_PER_RUN)

    def _end(self, run: Trajectory, left: int, since: float) -> tuple[Status, str]:
        """Return the status of an orbit, and a message."""
        if left == 0:
            return Status.EVENT, "all crossings are there."
        if run.status.complete:
            return Status.SUCCESS, (
                f"passed the section {counted(self.count - left, 'time')}, and not again between t = {since:.6g} and "
                f"{run.span[1]:.6g}; longest=... waits for more than {self.wait:.3g}."
            )
        return run.status, run.message


def followed(cross: Crosser, states: FloatArray, progress: Report | None) -> list[Crossings]:
    """Return the crossings of orbits from states (m, 2n); after Ctrl-C the last one is INTERRUPTED."""
    if cross.period is not None:
        starts = Starts(states, cross.runs.parameters[None])
        found = points_side_by_side(cross.runs, cross.period, cross.count, starts, progress)
        if found is not None:
            return found
    done: list[Crossings] = []
    try:
        for start in states:
            done.append(cross(start))
            if progress is not None:
                progress(float(len(done)))
            if done[-1].status is Status.INTERRUPTED:
                break
    except KeyboardInterrupt:
        done.append(Crossings.interrupted(states.shape[1]))
    return done


@dataclass(frozen=True, eq=False)
class Orbits:
    """Orbits as members of an ensemble, numbered by their starts."""

    all: Starts

    def __len__(self) -> int:
        return len(self.all)

    def starts(self, which: MemberNumbers) -> Starts:
        """Return the starts of some members."""
        return self.all.of(which)


def points_side_by_side(
    runs: Runs, period: float, count: int, starts: Starts, progress: Report | None = None
) -> list[Crossings] | None:
    """Return the points of orbits at multiples of a period from t = 0, or None if runs one by one are faster.

    After Ctrl-C the list ends with an INTERRUPTED orbit.
    """
    if len(starts) == 1 or len(starts) * count < MANY:
        return None
    times, table = period * np.arange(1.0, count + 1.0), Orbits(starts)
    job = runs.job(0.0, float(times[-1]), (END,), t_eval=times, varying=len(starts.parameters) > 1)
    engine = job.engine()
    if not isinstance(engine, LaneEngine):
        return None
    found = [Crossings.interrupted(starts.states.shape[1])] * len(starts)

    def take(first: int, ends: Ends) -> None:
        for k in range(ends.members):
            states, status = ends.columns[OUTPUTS][k], STATUSES[ends.columns[STATUS][k]]
            states = states[np.isfinite(states).all(axis=1)].copy()
            message = "all points are there." if status.complete else job.explained(table, first + k).message
            found[first + k] = Crossings(times[: len(states)], states, status, message)

    each_member(table, engine, threads_of(None), take, progress)
    whole = next((k for k, orbit in enumerate(found) if orbit.status is Status.INTERRUPTED), len(found))
    return found[: whole + 1]


class Listed(Table, Protocol):
    """Table of members of known number."""

    def __len__(self) -> int: ...


def each_member(
    table: Listed, engine: Engine, workers: int, take: Callable[[int, Ends], None], progress: Report | None = None
) -> bool:
    """Run all members on `workers` threads; return True if all were run, False after Ctrl-C.

    `take` is called for each chunk of members, with the number of its first member and the ends of the runs.
    """
    done = 0

    def keep(first: int, found: ChunkResult) -> None:
        nonlocal done
        take(first, found.ends)
        done += found.ends.members
        if progress is not None:
            progress(float(done))

    try:
        run_members(table, [(0, len(table))], ThreadRunner(engine, workers), keep)
    except KeyboardInterrupt:
        return False
    return True
