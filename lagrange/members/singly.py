"""Run members of an ensemble one by one, and test whether their energies are conserved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.members.queue import COUNTED
from lagrange.errors import LagrangeError, StatementError
from lagrange.machine.model import Model
from lagrange.members.results import (
    DRIFT,
    OUTPUTS,
    STATE,
    STATUS,
    STATUSES,
    SUCCESS,
    TIME,
    Column,
    Keep,
    Results,
    SampledRun,
    Starts,
    Stopped,
    event_states,
    event_times,
)
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.measures.conservation import NOTABLE_CHANGE, SMALL_CHANGE
from lagrange.trajectory.run import Flow, trajectory_of
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory


@dataclass(frozen=True, eq=False)
class Energies:
    """States, energies and momenta of m members of an ensemble at the start and the end of their runs.

    `before` (m, 2n) are the states at the start, and `after` (m, 2n) those at the end. `first` (m, 1 + n) has for each
    member the energy, then the n momenta, at the start, and `last` (m, 1 + n) those at the end.
    """

    before: FloatArray
    after: FloatArray
    first: FloatArray
    last: FloatArray

    def kinetic(self, y: FloatArray, observed: FloatArray) -> FloatArray:
        """Return kinetic energies |v.p| / 2 (m,) of states y (m, 2n), with energies and p in `observed` (m, 1 + n)."""
        with np.errstate(all="ignore"):
            return np.asarray(np.abs(np.sum(y[:, y.shape[1] // 2 :] * observed[:, 1:], axis=1)) / 2)

    @property
    def drift(self) -> FloatArray:
        """The relative drift of the energy of each member between its start and its end, (m,).

        It is the change of the energy, divided by the largest of |energy| at the start and the kinetic energies at the
        start and the end.
        """
        first, last = self.first[:, 0], self.last[:, 0]
        kinetic = np.maximum(self.kinetic(self.before, self.first), self.kinetic(self.after, self.last))
        scale = np.maximum(np.abs(first), kinetic)
        with np.errstate(all="ignore"):
            change = np.where(scale > 0, (last - first) / scale, last - first)
        # Every NaN is replaced by the same NaN: the sign bit of a computed one depends on its position in the array.
        return np.asarray(np.where(np.isnan(change), np.nan, change))

    @property
    def moved(self) -> NDArray[np.bool_]:
        """A mask (m,) of members whose energy changed so much that they have to run again one by one.

        A single run tests the energy more precisely. The limits of the change are `NOTABLE_CHANGE` and `SMALL_CHANGE`
        of `lagrange.trajectory.measures.conservation`.
        """
        with np.errstate(all="ignore"):
            change = np.abs(self.last[:, 0] - self.first[:, 0])
            kinetic = np.maximum(self.kinetic(self.before, self.first), self.kinetic(self.after, self.last))
            small = change <= NOTABLE_CHANGE * np.abs(self.first[:, 0])
            return np.asarray(~(small | (change <= SMALL_CHANGE * kinetic)))


def energies_of(
    model: Model,
    starts: Starts,
    after: FloatArray,
    span: tuple[float, float],
    last_parameters: FloatArray | None = None,
) -> Energies:
    """Return the energies and momenta of m members at their initial values `starts` and last states `after` (m, 2n).

    `span` has the times of both. `last_parameters` (m, k) are the parameters at the end if events have set some, else
    None.
    """
    first = _observed(model, starts.states, span[0], starts.parameters)
    last = _observed(model, after, span[1], starts.parameters if last_parameters is None else last_parameters)
    return Energies(starts.states, after, first, last)


def _observed(model: Model, y: FloatArray, t: float, parameters: FloatArray) -> FloatArray:
    """Return the energy, then the momenta, of states y (m, 2n) at time t, as an array (m, 1 + n).

    `parameters` are (1, k) if all states share them, else (m, k).
    """
    if len(parameters) > 1:
        return np.concatenate([_observed(model, y[i : i + 1], t, parameters[i : i + 1]) for i in range(len(y))])
    q, v = model.layout.split(y.T)
    times = np.full(len(y), t)
    return np.vstack([model.energy(q, v, times, parameters[0]), model.momenta(q, v, times, parameters[0])]).T


BY_NUMPY = " by numpy"
"""Suffix of the phrase that describes how members are run, if they run without compiled code."""


class Explained(NamedTuple):
    """The end of a member's run: status, time, and message that explains the status."""

    status: Status
    t: float
    message: str


@dataclass(frozen=True, eq=False)
class RunEngine:
    """Runs members of one model one by one, over the same time span with the same options.

    `times` (K,) are output times, or None. `keep` is the selection of results that are stored, and `columns` describes
    the arrays of these results.
    """

    model: Model
    span: tuple[float, float]
    options: RunOptions
    times: FloatArray | None
    keep: Keep
    columns: tuple[Column, ...]

    @property
    def form(self) -> str:
        """Phrase that says how members are run, such as "runs one after the other", for the summary of an ensemble."""
        return "runs one after the other" + (BY_NUMPY if self.model.target == "numpy" else "")

    side_by_side = 1  # members run one by one

    def run(self, starts: Starts, stopped: Stopped) -> Results:
        """Run members one by one from the initial values `starts`, and return their results.

        If the initial values of a member are refused, its run has the status NON_FINITE and the error as message.
        `stopped` is a function without arguments: when it returns True, no further member begins, and the results have
        only the rows of finished members.
        """
        ends = Results.empty(len(starts), self.columns)
        for i in range(len(starts)):
            if stopped():
                return Results({name: rows[:i] for name, rows in ends.columns.items()}, ends.messages)
            start = starts.of(slice(i, i + 1))
            try:
                run = self.run_one(start)
            except StatementError as refusal:
                ends.columns[STATUS][i], ends.columns[TIME][i] = STATUSES.index(Status.NON_FINITE), self.span[0]
                ends.messages[i] = str(refusal)
                continue
            for name, value in self.row(run, start).items():
                ends.columns[name][i] = value
            if run.status is not Status.SUCCESS:
                ends.messages[i] = run.message
        return ends

    def again(self, starts: Starts, ends: Results, which: NDArray[np.intp]) -> Results:
        """Run some members of a chunk again, one by one, because a faster engine gave no certain result for them.

        `which` are their indices in `starts`, the initial values of the chunk, and in `ends`, its results. Their rows
        and messages in `ends` are replaced. Return `ends`.
        """
        if not len(which):
            return ends
        results = self.run(starts.of(which), lambda: False)
        for name, rows in results.columns.items():
            ends.columns[name][which] = rows
        ends.messages.update({int(which[i]): text for i, text in results.messages.items()})
        return ends

    def explained(self, start: Starts) -> Explained:
        """Run one member from its initial values `start`, and return the status, time and message of its end."""
        try:
            run = self.run_one(start)
        except StatementError as refusal:
            return Explained(Status.NON_FINITE, self.span[0], str(refusal))
        return Explained(run.status, run.span[1], run.message)

    def run_one(self, start: Starts) -> Trajectory:
        """Run one member from its initial values `start`, and return its trajectory."""
        statement, names = self.model.statement, self.model.layout.names()
        values = dict(zip(statement.parameters, start.parameters[0].tolist(), strict=True))
        initial = dict(zip(names, start.states[0].tolist(), strict=True))
        # Reductions need all steps. Without output times the last state and the energy drift need them, too.
        keep, times = self.keep, np.array(self.span[1:]) if self.times is None else self.times
        whole = keep.reductions or (self.times is None and (keep.end or keep.drift))
        options = self.options._replace(parameters=values, t_eval=None if whole else times)
        return trajectory_of(self.model, self.span, initial, options)[0]

    def row(self, run: Trajectory, start: Starts) -> dict[str, Any]:
        """Return {column name: result} for the run of one member. `start` has the initial values of this member."""
        dimension = self.model.layout.size
        entries: dict[str, Any] = {TIME: run.span[1], STATUS: STATUSES.index(run.status)}
        if self.keep.end:
            entries[STATE] = self.end(run)
        if self.times is not None:
            entries[OUTPUTS] = self.outputs(run, self.times)
        if self.keep.counts:
            entries |= {name: getattr(run, name) for name in COUNTED}
        if self.keep.drift:
            values = None if run.history is None else run.history.values[-1:]
            entries[DRIFT] = energies_of(self.model, start, self.end(run)[None], run.span, values).drift[0]
        entries |= SampledRun(self.model, run, start.parameters[0]).reduced(self.keep.reductions)
        for k in range(len(run.t_events) if self.keep.events else 0):
            most = self.keep.events
            times, states = np.full(most, np.nan), np.full((most, dimension), np.nan)
            first = run.t_events[k][:most]
            times[: len(first)], states[: len(first)] = first, run.y_events[k][:most]
            entries |= {event_times(k): times, event_states(k): states}
        return entries

    def end(self, run: Trajectory) -> FloatArray:
        """Return the last state (2n,) that a run reached."""
        return run.dense(np.array([run.span[1]]))[:, 0]

    def outputs(self, run: Trajectory, times: FloatArray) -> FloatArray:
        """Return the states (K, 2n) of a run at the output times (K,), NaN at times that it did not reach."""
        states = np.full((len(times), self.model.layout.size), np.nan)
        if not self.keep.reductions:
            states[: len(run.t)] = run.y.T
            return states
        low, high = sorted(run.span)
        reached = (times >= low) & (times <= high)
        states[reached] = run.dense(times[reached]).T
        return states


@dataclass(frozen=True, eq=False)
class FlowEngine:
    """Runs members one by one by `flow`, a compiled function that returns only the last state of a run.

    `single` runs a member again to get a status and a message if it does not reach the end, or if its energy changed.
    """

    single: RunEngine
    flow: Flow

    @property
    def form(self) -> str:
        """Phrase that says how members are run, such as "runs one after the other", for the summary of an ensemble."""
        return self.single.form

    side_by_side = 1  # members run one by one

    def run(self, starts: Starts, stopped: Stopped) -> Results:
        """Run members from the initial values `starts`, and return their results.

        When the callback `stopped` returns True, no further member begins, and only finished members have results.
        """
        single, (_, t1) = self.single, self.single.span
        reached: list[FloatArray] = []
        for i in range(len(starts)):
            if stopped():
                break
            reached.append(self.end(starts.of(slice(i, i + 1))))
        done, states = starts.of(slice(len(reached))), np.reshape(reached, (len(reached), starts.states.shape[1]))
        doubtful = np.isnan(states).any(axis=1)
        if single.model.conservative:
            doubtful |= energies_of(single.model, done, states, single.span).moved
        columns = {STATE: states, TIME: np.full(len(done), t1), STATUS: np.full(len(done), SUCCESS, dtype=np.uint8)}
        ends = Results({column.name: columns[column.name] for column in single.columns})
        return single.again(done, ends, np.flatnonzero(doubtful))

    def end(self, start: Starts) -> FloatArray:
        """Return the last state (2n,) of the member that starts from `start`, NaN if its run does not reach the end."""
        try:
            return self.flow(start.states[0], *self.single.span, start.parameters[0])
        except LagrangeError:
            return np.full_like(start.states[0], np.nan)


BY_FLOW = frozenset((STATE, TIME, STATUS))
"""Names of the only result columns that a `FlowEngine` can fill: last state, its time and status."""
