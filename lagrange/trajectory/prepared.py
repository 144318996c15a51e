"""What a model keeps from run to run: the plans of its methods, and drivers with their memory that no run uses.

A short run takes a few microseconds, and its plan and its driver took ten times as long. A driver of a run with events
is kept with the memory that it shares with what watches them, which begins anew with each run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from lagrange.machine.backend import Driver
from lagrange.machine.state import NO_OUTPUTS, DriverState
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.plan import Plan, Planned, Watcher, WatchMemory
from lagrange.trajectory.trajectory import FloatArray

PLANS_KEPT = 8
"""Most plans that a model keeps; the oldest is dropped."""

DRIVERS_KEPT = 4
"""Most idle drivers that a plan keeps, each for other parameters; the oldest is dropped."""

MOST_BYTES = 2**20
"""Most bytes that a driver is kept with for what watches its events: enough for some 30 entries of the state.

Runs of larger systems take so long that it hardly counts.
"""


class IdleDriver(NamedTuple):
    """A driver between two runs, the state that it advanced, and the `reals` with which such a run begins.

    `steps` are as many as its last run took, for the first call of the next, or 0 where they took too long for one.
    `memory` is what its watcher has left for the next.
    """

    driver: Driver
    state: DriverState
    first: FloatArray
    steps: int
    memory: WatchMemory | None = None


@dataclass(eq=False)
class Prepared:
    """A plan, the method that made it, for a span of time, None for any; idle drivers by the bytes of parameters.

    `steps` are as many as the last run took whose driver is not kept, or 0 where they took too long for one call.
    """

    plan: Plan
    method: Planned | None = None
    span: tuple[float, float] | None = None
    idle: dict[bytes, IdleDriver] = field(default_factory=dict)
    steps: int = 0

    def take(self, problem: Problem) -> IdleDriver | None:
        """Return an idle driver, which no other run has from now on, with the state at the start of the problem."""
        found = self.idle.pop(problem.parameter_array.tobytes(), None)
        if found is not None:
            settings = self.plan.tolerances
            step = settings.step if problem.t1 >= problem.t0 else -settings.step
            found.state.restart(found.first, (problem.t0, problem.t1), problem.y0, step, settings.longest)
            found.state.integers[DriverState.RECORD] = 1
            if found.memory is not None:
                found.state.restart_series()
        return found

    def give(
        self,
        problem: Problem,
        taken: IdleDriver | None,
        driver: Driver,
        state: DriverState,
        steps: int,
        watch: Watcher | None,
    ) -> None:
        """Keep the driver of a run that has succeeded, and was `taken` or is new, for the next with its parameters."""
        if self.method is None:
            return
        memory = None if watch is None else watch.memory
        if taken is None and memory is not None and memory.nbytes > MOST_BYTES:
            self.steps = steps
            return
        state.outputs = NO_OUTPUTS
        if taken is not None:
            first = taken.first
        else:
            # What watches a run keeps its state apart from that in the driver's memory.
            if memory is None:
                driver.adopt(state)
            first = self.plan.tolerances.begin(problem.t0, problem.t1, problem.y0).reals
        self.idle[problem.parameter_array.tobytes()] = IdleDriver(driver, state, first, steps, memory)
        drop_oldest(self.idle, DRIVERS_KEPT)


def prepared(method: Planned, problem: Problem) -> Prepared:
    """Return the plan of a method for a problem, as a former run of the model left it where that holds for this one.

    A method and an event are known by their identity: to compare two tableaux takes longer than to make a plan.
    """
    if not isinstance(problem, Problem):
        return Prepared(method.plan(problem))
    options = problem.rtol, problem.atol, problem.step
    if not (_is_key(options[0]) and _is_key(options[1]) and _is_key(options[2])):
        return Prepared(method.plan(problem))
    # A plan with events has the parameters of their resets.
    watched = (problem.events, problem.parameter_array.tobytes()) if problem.events else ()
    kept, key, span = problem.model.prepared, (id(method), *options, *watched), (problem.t0, problem.t1)
    found: Prepared | None = kept.get(key)
    if found is None or found.span not in (None, span):
        plan = method.plan(problem)
        whenever = plan.tolerances.rtol > 0.0 and plan.tolerances.longest == math.inf
        found = Prepared(plan, method, None if whenever else span, {} if found is None else found.idle)
        kept[key] = found
        drop_oldest(kept, PLANS_KEPT)
    return found


def _is_key(option: Any) -> bool:
    """Return whether an option is left out or a positive float: zero and its negative would be one key."""
    return option is None or (isinstance(option, float) and option > 0.0)


def drop_oldest(kept: dict[Any, Any], most: int) -> None:
    """Drop the oldest entries beyond so many; other threads may do so too."""
    if len(kept) > most:
        for key in tuple(kept)[:-most]:
            kept.pop(key, None)
