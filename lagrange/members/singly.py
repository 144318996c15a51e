"""Members one by one, each a run of its own: for any method and any system."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.members.along import SampledRun
from lagrange.members.chunk import STATUSES, Ends, Starts, Stopped
from lagrange.members.energies import energies_of
from lagrange.members.keep import (
    DRIFT,
    OUTPUTS,
    STATE,
    STATUS,
    TIME,
    Column,
    Keep,
    event_states,
    event_times,
)
from lagrange.procedure.members.queue import COUNTED
from lagrange.trajectory.integrate import integrate
from lagrange.trajectory.options import RunOptions
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

BY_NUMPY = " by numpy"
"""How the form of runs ends for which nothing is compiled."""


class Explained(NamedTuple):
    """How a run ended: its status, the time, and its sentence."""

    status: Status
    t: float
    message: str


@dataclass(frozen=True, eq=False)
class RunEngine:
    """Runs of a model over a span with the same options; `columns` are kept."""

    model: Model
    span: tuple[float, float]
    options: RunOptions
    times: FloatArray | None
    keep: Keep
    columns: tuple[Column, ...]

    @property
    def form(self) -> str:
        """How members are run."""
        return "runs one after the other" + (BY_NUMPY if self.model.target == "numpy" else "")

    @property
    def side_by_side(self) -> int:
        """One after the other."""
        return 1

    def run(self, starts: Starts, stopped: Stopped) -> Ends:
        """Run members; a start that a run refuses is a member that did not begin, and says why."""
        found = Ends({column.name: column.empty(len(starts)) for column in self.columns})
        for i in range(len(starts)):
            if stopped():
                return Ends({name: rows[:i] for name, rows in found.columns.items()}, found.messages)
            start = starts.of(slice(i, i + 1))
            try:
                run = self.alone(start)
            except StatementError as refusal:
                found.columns[STATUS][i], found.columns[TIME][i] = STATUSES.index(Status.NON_FINITE), self.span[0]
                found.messages[i] = str(refusal)
                continue
            for name, value in self.row(run, start).items():
                found.columns[name][i] = value
            if run.status is not Status.SUCCESS:
                found.messages[i] = run.message
        return found

    def again(self, starts: Starts, ends: Ends, which: NDArray[np.intp]) -> Ends:
        """Run some members, and put what they give in the place of what is there."""
        if not len(which):
            return ends
        found = self.run(starts.of(which), lambda: False)
        for name, rows in found.columns.items():
            ends.columns[name][which] = rows
        ends.messages.update({int(which[i]): text for i, text in found.messages.items()})
        return ends

    def explained(self, start: Starts) -> Explained:
        """Return how a run of one member ends, in words."""
        try:
            run = self.alone(start)
        except StatementError as refusal:
            return Explained(Status.NON_FINITE, self.span[0], str(refusal))
        return Explained(run.status, run.span[1], run.message)

    def alone(self, start: Starts) -> Trajectory:
        """Run one member."""
        statement, names = self.model.statement, self.model.layout.names()
        values = dict(zip(statement.parameters, start.parameters[0].tolist(), strict=True))
        initial = dict(zip(names, start.states[0].tolist(), strict=True))
        options = replace(self.options, parameters=values, t_eval=self.recorded)
        return integrate(self.model, self.span, initial, options)[0]

    @property
    def recorded(self) -> FloatArray | None:
        """The times at which a run keeps its states, None for all steps: of events alone it need not keep those."""
        keep = self.keep
        if keep.reductions or (self.times is None and (keep.end or keep.drift)):
            return None
        return np.array(self.span[1:]) if self.times is None else self.times

    def row(self, run: Trajectory, start: Starts) -> dict[str, Any]:
        """Return what is kept of a run."""
        dimension = self.model.layout.size
        found: dict[str, Any] = {TIME: run.span[1], STATUS: STATUSES.index(run.status)}
        if self.keep.end:
            found[STATE] = self.end(run)
        if self.times is not None:
            found[OUTPUTS] = self.outputs(run, self.times)
        if self.keep.counts:
            found |= {name: getattr(run, name) for name in COUNTED}
        if self.keep.drift:
            values = None if run.history is None else run.history.values[-1:]
            found[DRIFT] = energies_of(self.model, start, self.end(run)[None], run.span, values).drift[0]
        found |= SampledRun(self.model, run, start.parameters[0]).reduced(self.keep.reductions)
        for k in range(len(run.t_events) if self.keep.events else 0):
            most = self.keep.events
            times, states = np.full(most, np.nan), np.full((most, dimension), np.nan)
            first = run.t_events[k][:most]
            times[: len(first)], states[: len(first)] = first, run.y_events[k][:most]
            found |= {event_times(k): times, event_states(k): states}
        return found

    def end(self, run: Trajectory) -> FloatArray:
        """Return the last state that a run reached."""
        return run.dense(np.array([run.span[1]]))[:, 0]

    def outputs(self, run: Trajectory, times: FloatArray) -> FloatArray:
        """Return the states (K, 2n) at the output times (K,) that the run reached, NaN behind."""
        found = np.full((len(times), self.model.layout.size), np.nan)
        if not self.keep.reductions:
            found[: len(run.t)] = run.y.T
            return found
        low, high = sorted(run.span)
        reached = (times >= low) & (times <= high)
        found[reached] = run.dense(times[reached]).T
        return found
