"""Orbits on a section: followed to their crossings, or from period to period."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lagrange.dynamics.runs import Report, Runs, time_scale
from lagrange.errors import counted
from lagrange.machine.backend import FloatArray
from lagrange.statement.event import Event
from lagrange.trajectory.trajectory import Status, Trajectory

CROSSINGS_PER_RUN = 2000
"""Crossings after which an orbit continues in a new run, which bounds the memory for its steps."""

PERIODS_PER_CROSSING = 2.0
"""Length of the first run of an orbit: mean periods of small motions per crossing."""

LONGEST_WAIT = 200
"""Longest wait for a crossing, in mean periods of small motions; then the orbit ends."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """Times (k,) and states (k, 2n) of one orbit on a section, with its final status and message."""

    times: FloatArray
    states: FloatArray
    status: Status
    message: str


class Crosser:
    """Follows orbits to a fixed number of crossings of one section: an event, or the multiples of a period."""

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
        """Return the status and the message of an orbit after its last run, which lacks `missing_count` crossings."""
        if missing_count == 0:
            return Status.EVENT, "all crossings are there."
        if run.status.complete:
            return Status.SUCCESS, (
                f"passed the section {counted(self.count - missing_count, 'time')}, and not again between "
                f"t = {last_crossing:.6g} and {run.span[1]:.6g}; longest=... waits for more than {self.wait:.3g}."
            )
        return run.status, run.message


def followed(cross: Crosser, states: FloatArray, progress: Report | None) -> list[Crossings]:
    """Return the crossings of the orbits that start from states (m, 2n).

    After Ctrl-C the list ends with an interrupted orbit, whose status is INTERRUPTED.
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
