"""End steps before switching surfaces that depend only on time, such as jumps of Mod(t, T), and begin after them.

A step over a jump of the forces would be rejected until it is short enough for its error. The surfaces of time are
known without the motion, so no step has to cross one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from weakref import WeakKeyDictionary

import numpy as np

from lagrange.graph.node import Binding, Node
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.program.switching import switch
from lagrange.trajectory.events.event_log import Breaks
from lagrange.trajectory.events.step_watch import StepWatch
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray

SIDES_PER_STEP = 4
"""Number of times, within the longest step that is allowed, at which the signs of surfaces of time are compared. It is
at most the number of stages of the method."""

SWITCH_MARGIN = 2.0
"""Time between the end of a step and the switching surface of time that follows, in spacings of floating-point times.
Rounding changes the times of the step's stages by one spacing, and no stage may lie behind the surface."""

TOGETHER = 4
"""Largest distance between the last time before a change of sign of a surface and the first time after it, in spacings
of floating-point times. At the times between them the function of the surface may round to zero."""

LEAST = 2.0**-80
"""Shortest time, as a fraction of the run, by which a run moves from before a switching surface to after it. Near
t = 0 floating-point times are so close that dense output over one spacing between them cannot be computed."""

SPREAD = 2.0 ** np.arange(32)
"""Distances in time, in spacings of floating-point numbers, from the estimated zero of a surface of time. The sign of
the surface is tested at these distances before and after the estimate."""

_SURFACES: WeakKeyDictionary[Model, tuple[Node, ...]] = WeakKeyDictionary()


def surfaces_of_time(model: Model) -> tuple[Node, ...]:
    """Return the switching surfaces of the accelerations that depend only on time and parameters, as expressions."""
    if model not in _SURFACES:
        expressions = switch(model.equations.graph, model.equations.accelerations).expressions
        _SURFACES[model] = tuple(g for g in expressions if g.binding is Binding.TIME)
    return _SURFACES[model]


class TimeSwitches:
    """Stops a run's driver just before each switching surface of time, and continues just after it."""

    def __init__(
        self, problem: Problem, surfaces: tuple[Node, ...], state: DriverState, watch: StepWatch | None
    ) -> None:
        self._problem, self._watch = problem, watch
        self.breaks = Breaks(len(problem.y0)) if watch is None else watch.breaks
        self._kernel = problem.model.function("surfaces", surfaces)
        self._forward = 1.0 if problem.t1 >= problem.t0 else -1.0
        count = SIDES_PER_STEP * math.ceil(abs(problem.t1 - problem.t0) / state.reals[DriverState.LONGEST])
        self._coming = self._switches(np.linspace(problem.t0, problem.t1, count + 1))
        self._after = problem.t0
        self._look_ahead(state)

    @classmethod
    def of(cls, problem: Problem, state: DriverState, watch: StepWatch | None) -> TimeSwitches | None:
        """Return the object that stops a run at its surfaces of time, or None if there are no such surfaces.

        A surface of time is a switching surface that depends only on time and parameters. `watch` searches for the
        events of the run, or is None.
        """
        limited = state.reals[DriverState.LONGEST] < math.inf
        surfaces = surfaces_of_time(problem.model) if limited else ()
        return cls(problem, surfaces, state, watch) if surfaces else None

    def _look_ahead(self, state: DriverState) -> None:
        """Set the time at which the driver stops next: just before the next surface, or at the end of the run."""
        for before, after in self._coming:
            if self._forward * (after - state.t) > 0:
                end = before - self._forward * SWITCH_MARGIN * float(np.spacing(max(abs(before), abs(state.t))))
                state.reals[DriverState.END] = self._forward * max(self._forward * end, self._forward * state.t)
                self._after = after
                return
        state.reals[DriverState.END] = self._after = self._problem.t1

    def passes(self, state: DriverState) -> bool:
        """Move the time of a driver that stopped before a surface of time to the first time after the surface.

        These two times are a few floating-point spacings apart, so the state does not change. Return False, and change
        nothing, at the end of the run.
        """
        if state.t == self._problem.t1:
            return False
        jumps = 0
        if self._watch is not None:
            jumps, self._watch.shared.run.before = self._watch.jumps, 0
        self.breaks.append(state.count(DriverState.STEPS) + jumps, None)
        least = state.t + self._forward * LEAST * abs(self._problem.t1 - self._problem.t0)
        state.reals[DriverState.T] = self._forward * max(self._forward * self._after, self._forward * least)
        # A first step chosen by slopes would be too short if a force grows like the root of the time since the switch.
        state.reals[DriverState.H] = self._forward * state.reals[DriverState.LONGEST]
        state.reals[DriverState.PREVIOUS] = 1.0
        state.counts[[DriverState.SLOPE_KNOWN, DriverState.AFTER_REJECT, DriverState.KEPT]] = 0
        state.counts[DriverState.STEPS] += 1
        self._look_ahead(state)
        return True

    def _switches(self, grid: FloatArray) -> Iterator[tuple[float, float]]:
        """Yield, for each switch, the last time before it and the first time after it.

        A switch is a change of sign of a surface of time between neighbouring times of the `grid` (k,). A surface that
        is zero only at the start, or only at the end, of the run counts as a switch at this time.
        """
        sides = np.sign(self._values(grid))
        last_nonzero = np.maximum.accumulate(np.where(sides != 0, np.arange(len(grid)), 0), axis=1)
        filled = np.take_along_axis(sides, last_nonzero, axis=1)
        changes = filled[:, 1:] * filled[:, :-1] < 0
        changes[:, 0] |= (sides[:, 0] == 0) & (sides[:, 1] != 0)
        changes[:, -1] |= (sides[:, -1] == 0) & (sides[:, -2] != 0)
        for index in np.flatnonzero(changes.any(axis=0)).tolist():
            low, high = float(grid[index]), float(grid[index + 1])
            switches = [self._between(i, low, high) for i in np.flatnonzero(changes[:, index]).tolist()]
            yield from sorted(switches, key=lambda switch: self._forward * switch[0])

    def _between(self, surface: int, low: float, high: float) -> tuple[float, float]:
        """Return the last time before a surface changes sign between `low` and `high`, and the first time after it.

        `surface` is the index of the surface. Its sign at the first result is that at `low`, and its sign at the second
        that at `high`.
        """
        first, last = self._values(np.array([low, high]))[surface]
        old, new = np.sign(first), np.sign(last)
        while np.nextafter(low, high) != high:
            zero = low + first / (first - last) * (high - low) if first != last else low
            spread = SPREAD * np.spacing(abs(zero))
            tested = np.concatenate([zero - spread, zero + spread, [zero, low, 0.5 * (low + high), high]])
            grid = np.unique(np.clip(tested, min(low, high), max(low, high)))[:: int(self._forward)]
            values = self._values(grid)[surface]
            index = int(np.argmax(np.sign(values) != old))
            low, high = float(grid[index - 1]), float(grid[index])
            first, last = values[index - 1], values[index]
        beyond: FloatArray = low + np.arange(1.0, TOGETHER + 1.0) * (high - low)
        return low, float(beyond[np.argmax(np.sign(self._values(beyond)[surface]) == new)])

    def _values(self, times: FloatArray) -> FloatArray:
        """Return the values (surfaces, k) of the surfaces of time at times (k,), or 0 where a surface has no value."""
        states = np.broadcast_to(0.0, (len(self._problem.y0), len(times)))
        with np.errstate(all="ignore"):
            return np.nan_to_num(self._kernel(times, states, self._problem.parameter_array))
