"""The compiled loop over steps with events: whether a run is worth it, and what it shares with a watch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lagrange.equations.euler_lagrange import Equations
from lagrange.graph.node import Binding
from lagrange.machine.backend import DensePath, Driver, Kernel
from lagrange.machine.step_events import EventSteps, Reaction, StepEventMemory
from lagrange.procedure.dense.hermite import hermite_polynomial
from lagrange.procedure.events.step_zeros import ANYHOW, UNKNOWN
from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.events.actions import impacts as impacts_of
from lagrange.trajectory.events.event_log import Breaks, Occurrences
from lagrange.trajectory.events.roots import Side
from lagrange.trajectory.events.step_batch import Path, PathOf
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.paths.step_paths import StepPath
from lagrange.trajectory.trajectory import FloatArray

WORTH_COMPILING = 512
"""Steps that a run may be expected to take from which on the loop is compiled: that takes as long as to look at some
thousands of them on arrays, once for a process, and as long as some hundreds for each other event."""

ENOUGH = 16
"""Steps, at least, that tell how many a run will take: the first of all are short."""

CHANGE_STEPS = 8
"""A change of the motion costs as much on arrays as so many steps."""


class KnownPath:
    """Makes paths through accepted states: the dense output of steps is made once for all, or `known` before."""

    def __init__(self, path_of: PathOf, known: StepPath | None = None) -> None:
        self._path_of = path_of
        self.known = known

    def __call__(self, times: FloatArray, states: FloatArray) -> Path:
        """Return the path through accepted times (S+1,) and states (S+1, 2n)."""
        if self.known is not None:
            return replace(self.known, times=times, states=states)
        made = self._path_of(times, states)
        self.known = made if isinstance(made, StepPath) else None
        return made


def inertia_stays(equations: Equations) -> bool:
    """Whether the inertia of each coordinate that is coupled to no other is a number: no reset takes it away."""
    alone = [block[0] for block in equations.plan.blocks if len(block) == 1]
    return all(equations.mass[i][i].binding <= Binding.PARAMETER for i in alone)


@dataclass(eq=False)
class WatchedEvents:
    """The events of a run by a step program, and what the next run by its driver with the same events begins with.

    `kernel` gives the values of the events, and `steps` is the compiled loop, if a run was worth it. `dense` is a path
    through a first state, with the dense output of all.
    """

    impacts: tuple[Impact, ...]
    kernel: Kernel
    memory: StepEventMemory
    steps: EventSteps | None = None
    dense: StepPath | None = None

    @classmethod
    def of(cls, problem: Problem) -> WatchedEvents:
        """Return the events of a problem, translated."""
        model = problem.model
        impacts = impacts_of(model, problem.events, problem.parameter_array)
        kernel = model.function("events", tuple(one.node for one in impacts))
        memory = StepEventMemory(len(problem.y0), [Reaction(one.direction, one.first, one.rows) for one in impacts])
        checked = any(one.constrained for one in impacts)
        memory.run.resets = int(not checked and inertia_stays(model.equations))
        memory.keep_start()
        return cls(impacts, kernel, memory)

    @property
    def nbytes(self) -> int:
        """How many bytes the memory of the loop takes."""
        return self.memory.nbytes


class EventLoop:
    """Makes the loop when it is worth it, and has the memory that it shares with a watch."""

    def __init__(self, problem: Problem, watched: WatchedEvents, *, fixed: bool) -> None:
        self._problem, self._watched, self._fixed = problem, watched, fixed
        self._impacts, self.memory = watched.impacts, watched.memory
        self._possible = True

    def compiled(self, driver: Driver, path_of: KnownPath, t: float, steps: int, changes: int) -> EventSteps | None:
        """Return the loop if the machine has one and the run seems long by its steps and changes up to a time."""
        problem, work = self._problem, steps + CHANGE_STEPS * changes
        covered, span = abs(t - problem.t0), abs(problem.t1 - problem.t0)
        if not self._possible or work <= ENOUGH or work * span < WORTH_COMPILING * covered:
            return None
        self._possible = False
        if self._watched.steps is None and path_of.known is not None:
            self._watched.steps = self._made(driver, path_of.known.dense)
        return self._watched.steps

    def _made(self, driver: Driver, dense: DensePath) -> EventSteps | None:
        """Return the loop, with the cubic through both ends as a screen where the error of steps is under control."""
        model, parameters = self._problem.model, self._problem.parameter_array
        cubic = hermite_polynomial(3)
        screened = not self._fixed and dense.degree > cubic.degree
        screen = model.machine.dense(cubic, model.kernel("rhs"), parameters) if screened else None
        resets = next((one.kernel.program for one in self._impacts if one.kernel is not None), None)
        return model.machine.event_steps(driver, self._watched.kernel.program, resets, parameters, dense, screen)

    def write(
        self,
        zero_sides: Sequence[Side],
        occurrences: Sequence[Occurrences],
        stayed: Mapping[int, float],
        zeros: Mapping[int, int],
    ) -> None:
        """Leave to the loop where events stand, and how often they may count until something is to happen.

        Where the motion starts, some `stayed` at zero to a size, and came there with a direction by their `zeros`.
        """
        memory, impacts = self.memory, self._impacts
        memory.sign[:] = [side.sign for side in zero_sides]
        memory.near[:] = [side.near for side in zero_sides]
        memory.until_end[:] = [
            max(0, one.terminal - len(found)) for one, found in zip(impacts, occurrences, strict=True)
        ]
        resets = np.array([one.reset for one in impacts])
        memory.remaining[:] = np.where(resets, 1, memory.until_end)
        memory.stayed[:] = [stayed.get(i, 0.0) for i in range(len(impacts))]
        unmet = [UNKNOWN if one.reset else ANYHOW for one in impacts]
        memory.came[:] = [2 + zeros[i] if i in zeros else other for i, other in enumerate(unmet)]

    def collect(self, occurrences: Sequence[Occurrences], breaks: Breaks, steps: int) -> None:
        """Take over events and changes of the motion; those on steps that wait count when these do."""
        memory = self.memory
        waits, proven, found = memory.waits, memory.run.proven, memory.happened()
        if waits:
            _keep(occurrences, found.which[:proven], found.when[:proven], found.there[:proven], memory.taken)
            _keep(occurrences, found.which[proven:], found.when[proven:], found.there[proven:], memory.reviewed)
        else:
            _keep(occurrences, found.which, found.when, found.there, steps)
        breaks.extend(found.rows, found.times, found.states)

    @property
    def sides(self) -> list[Side]:
        """The sides that the loop has left."""
        pairs = zip(self.memory.sign.tolist(), self.memory.near.tolist(), strict=True)
        return [Side(sign, bool(near)) for sign, near in pairs]

    @property
    def zeros(self) -> dict[int, int]:
        """The directions with which events came to zero where the motion starts."""
        came = self.memory.came.tolist()
        return {i: way - 2 for i, way in enumerate(came) if way not in (UNKNOWN, ANYHOW)}


def _keep(
    occurrences: Sequence[Occurrences], which: NDArray[np.int64], when: FloatArray, there: FloatArray, steps: int
) -> None:
    """Keep zeros that have happened with so many steps: they are in order, those of each event are put together."""
    if len(occurrences) == 1:
        occurrences[0].extend(when, there, steps)
    elif len(which):
        order = np.argsort(which, kind="stable")
        when, there = when[order], there[order]
        ends = np.cumsum(np.bincount(which, minlength=len(occurrences))).tolist()
        for zeros, begin, end in zip(occurrences, [0, *ends], ends, strict=False):
            zeros.extend(when[begin:end], there[begin:end], steps)
