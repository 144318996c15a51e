"""Decide whether the loop over steps with events is compiled, and store the memory that the loop shares with Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagrange.algorithm.dense.polynomials import hermite_polynomial
from lagrange.algorithm.events.search import IGNORED, UNKNOWN
from lagrange.graph.node import Binding
from lagrange.machine.backend import Driver, Kernel
from lagrange.machine.state import EventSteps, StepEventMemory
from lagrange.trajectory.dense_output import StepPath
from lagrange.trajectory.events.array_search import Side
from lagrange.trajectory.events.event_log import Breaks, EventLog, Occurrences, until_end
from lagrange.trajectory.events.model_events import ModelEvent, model_events
from lagrange.trajectory.events.step_batch import PathOf, StepsPath
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray

WORTH_COMPILING = 512
"""The loop is compiled if a run is expected to have at least this number of steps. Compiling takes 0.5 s once per
process, as long as searching 10,000 to 40,000 steps on arrays. Later runs with events are 20 to 100 times as fast."""

ENOUGH = 16
"""Smallest number of steps from which the length of a run is estimated, because the first steps are short."""

CHANGE_STEPS = 8
"""Cost of a reset outside the compiled loop, as the number of steps that are searched on arrays in the same time."""


@dataclass(eq=False)
class WatchedEvents:
    """The events of a run by a step program, kept for the next run of its driver with the same events.

    `events` are the events of the run, and `kernel` evaluates their functions. `memory` is shared with the compiled
    loop `steps`, which is None if no run was long enough to compile it. `dense` is the first dense output, whose
    compiled code all later ones use.
    """

    events: tuple[ModelEvent, ...]
    kernel: Kernel
    memory: StepEventMemory
    steps: EventSteps | None = None
    dense: StepPath | None = None

    @classmethod
    def of(cls, problem: Problem) -> WatchedEvents:
        """Return the events of a problem, with the kernel that evaluates them and the memory of the loop."""
        model = problem.model
        events = model_events(model, problem.events)
        kernel = model.function("events", tuple(event.node for event in events))
        memory = StepEventMemory(len(problem.y0), [event.reaction for event in events])
        checked = any(event.constrained for event in events)
        # If the inertia of an uncoupled coordinate is constant, no reset can make it zero.
        alone = [block[0] for block in model.equations.plan.blocks if len(block) == 1]
        constant = all(model.equations.mass[i][i].binding <= Binding.PARAMETER for i in alone)
        memory.run.resets = int(constant and not checked)
        memory.keep_start()
        return cls(events, kernel, memory)

    @property
    def nbytes(self) -> int:
        """Size of the memory of the loop in bytes."""
        return self.memory.nbytes

    def path(self, path_of: PathOf, times: FloatArray, states: FloatArray) -> StepsPath:
        """Return the dense output through accepted times (S+1,) and states (S+1, 2n).

        `path_of` is called with times and states to make the first dense output. Later calls reuse its compiled code.
        """
        if self.dense is not None:
            return replace(self.dense, times=times, states=states)
        path = path_of(times, states)
        self.dense = path if isinstance(path, StepPath) else None
        return path

    def compiled(
        self, problem: Problem, driver: Driver, t: float, steps: int, changes: int, *, fixed: bool
    ) -> EventSteps | None:
        """Return the compiled loop over steps, or None if the machine has none, or if compiling does not pay.

        The remaining length of the run is estimated from `steps`, the number of steps up to time t, and from `changes`,
        the number of resets. `fixed` is True for fixed steps. Otherwise the loop first tests each step on a cubic, the
        Hermite polynomial through both ends of the step; it searches only steps that may have an event.
        """
        work, covered, span = steps + CHANGE_STEPS * changes, abs(t - problem.t0), abs(problem.t1 - problem.t0)
        if self.dense is None or work <= ENOUGH or work * span < WORTH_COMPILING * covered:
            return None
        if self.steps is None:
            model, parameters, dense = problem.model, problem.parameter_array, self.dense.dense
            cubic = hermite_polynomial(3)
            screened = not fixed and dense.degree > cubic.degree
            screen = model.machine.dense(cubic, model.kernel("rhs"), parameters) if screened else None
            resets = next((event.kernel.program for event in self.events if event.kernel is not None), None)
            self.steps = model.machine.event_steps(driver, self.kernel.program, resets, parameters, dense, screen)
        return self.steps

    def write(
        self,
        zero_sides: Sequence[Side],
        occurrences: Sequence[Occurrences],
        zero_sizes: Mapping[int, float],
        zeros: Mapping[int, int],
    ) -> None:
        """Write the signs of the event functions and the counts of events to the memory of the compiled loop.

        `zero_sides` has the sign of each function. `occurrences` are the occurrences of each event so far. They
        determine the number of further ones until the caller has to act. `zero_sizes` maps each event whose function
        counts as zero at the start of a smooth piece to the size of the function. `zeros` maps each event that has just
        occurred to the direction of its zero.
        """
        memory, events = self.memory, self.events
        memory.sign[:] = [side.sign for side in zero_sides]
        memory.near[:] = [side.near for side in zero_sides]
        memory.until_end[:] = until_end(events, occurrences)
        memory.remaining[:] = np.where([event.reset for event in events], 1, memory.until_end)
        memory.zero_sizes[:] = [zero_sizes.get(i, 0.0) for i in range(len(events))]
        unmet = [UNKNOWN if event.reset else IGNORED for event in events]
        memory.arrivals[:] = [2 + zeros[i] if i in zeros else other for i, other in enumerate(unmet)]

    def collect(self, log: EventLog, breaks: Breaks) -> None:
        """Copy the events and resets that the compiled loop has found to `log` and `breaks`.

        Events on steps that are not yet searched completely begin to count when these steps are accepted.
        """
        memory = self.memory
        proven, new = memory.run.proven if memory.waits else 0, memory.new_events()
        steps = memory.reviewed if memory.waits else log.steps
        for part, accepted in ((slice(proven), memory.taken), (slice(proven, None), steps)):
            log.keep(new.which[part], new.when[part], new.event_states[part], accepted)
        breaks.extend(new.rows, new.times, new.states)
