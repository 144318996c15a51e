"""Members one by one of which only the last state is kept: a flow records nothing on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lagrange.errors import LagrangeError
from lagrange.members.chunk import SUCCESS, Ends, Starts, Stopped
from lagrange.members.energies import energies_of
from lagrange.members.keep import STATE, STATUS, TIME
from lagrange.members.singly import RunEngine
from lagrange.trajectory.flow import Flow
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class FlowEngine:
    """Runs members by the flow of a model; `alone` runs those that do not get to the end, and says why."""

    alone: RunEngine
    flow: Flow

    @property
    def form(self) -> str:
        """How members are run."""
        return self.alone.form

    @property
    def side_by_side(self) -> int:
        """One after the other."""
        return 1

    def run(self, starts: Starts, stopped: Stopped) -> Ends:
        """Run members to their ends."""
        alone, (_, t1) = self.alone, self.alone.span
        reached: list[FloatArray] = []
        for i in range(len(starts)):
            if stopped():
                break
            reached.append(self.end(starts.of(slice(i, i + 1))))
        done, states = starts.of(slice(len(reached))), np.reshape(reached, (len(reached), starts.states.shape[1]))
        doubtful = np.isnan(states).any(axis=1)
        if alone.model.conservative:
            doubtful |= energies_of(alone.model, done, states, alone.span).moved
        found = {STATE: states, TIME: np.full(len(done), t1), STATUS: np.full(len(done), SUCCESS, dtype=np.uint8)}
        ends = Ends({column.name: found[column.name] for column in alone.columns})
        return alone.again(done, ends, np.flatnonzero(doubtful))

    def end(self, start: Starts) -> FloatArray:
        """Return the last state of a member, NaN if it does not get to the end."""
        try:
            return self.flow(start.states[0], *self.alone.span, start.parameters[0])
        except LagrangeError:
            return np.full_like(start.states[0], np.nan)


def flow_engine(alone: RunEngine) -> FlowEngine | None:
    """Return the engine that runs members by a flow, None where more than last states is kept."""
    if {column.name for column in alone.columns} - {STATE, TIME, STATUS}:
        return None
    return FlowEngine(alone, Flow(alone.model, alone.options))
