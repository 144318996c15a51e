"""Drivers of steps on every machine: each calls the compiled or printed loop over its steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lagrange.algorithm.step.memory import EFFORT, NEWTON, Kept, kept
from lagrange.algorithm.taylor.memory import HELD
from lagrange.graph.node import Node
from lagrange.machine.backend import FloatArray, Kernel, Machine, SeriesCode
from lagrange.machine.kernel.interpreted import FLOATS
from lagrange.machine.llvm.address import workspace
from lagrange.machine.state import OUTCOMES, DriverState, Outcome, Outputs
from lagrange.machine.step_event_memory import StepFunction
from lagrange.machine.taylor_event_memory import EventMemory, idle
from lagrange.procedure.form import Record
from lagrange.program.program import Program
from lagrange.program.step import StepProgram


class StepDriver:
    """Advances a run by the steps of a method, given as a step program (implements `Driver`).

    It serves one right-hand side and one set of parameters. Data of Newton's method, such as matrices, are kept in
    the driver's work array.
    """

    def __init__(
        self,
        machine: Machine,
        step: StepProgram,
        kernel: Kernel,
        parameters: FloatArray,
        jacobian: Kernel | None = None,
        projection: Kernel | None = None,
    ) -> None:
        loop, layout = machine.loop(step, kernel.program, projected=projection is not None)
        self._loop: Any = loop
        self._layout, self._work = layout, workspace(layout.size)
        self._call: Any = self._loop.bound()
        n = layout.dimension // 2
        second = layout.width if step.partitioned else n
        self._entries = np.array([*range(n), *range(second, second + n)])
        """Indices of the entries of the state in the work array: one vector, or coordinates and velocities."""
        self._kernels = kernel, jacobian, projection
        law = machine.callback(kernel, parameters, of_steps=True)
        self._call.give(law=law.function, parameters=law.numbers, work=self._work)
        for name, corrections, numbers in (
            ("jacobian", jacobian, "constants"),
            ("projection", projection, "projection_numbers"),
        ):
            if corrections is not None:
                callback = machine.callback(corrections, parameters)
                self._call.give(**{name: callback.function, numbers: callback.numbers})
        self._call.give(effort=self._record(EFFORT, layout.effort))
        self._newtons = [self._record(NEWTON, solve.flags) for solve in layout.solves]
        # The layout of the starter, the method of the first steps, follows the vectors of the step.
        starting = () if step.starter is None else layout.starting.solves
        self._starters = [self._record(NEWTON, layout.end + solve.flags) for solve in starting]
        self._call.give(**{f"newtons_{i}": record for i, record in enumerate(self._newtons)})
        self._call.give(**{f"starters_{i}": record for i, record in enumerate(self._starters)})
        self._budget: int | None = None
        """The budget of calls without rows, None if the arguments of the loop may be others."""
        self._state: DriverState | None = None
        self._function: StepFunction | None = None

    def _record(self, record: Record, index: int) -> Any:
        """Return the record of type `record` that begins at index `index` of the driver's work array.

        A record is a structure of named numbers. It shares memory with the array.
        """
        memory: Any = self._work
        return record.structure.from_buffer(memory, 8 * index)

    def adopt(self, state: DriverState) -> None:
        """Do nothing. Only a driver by Taylor series replaces the array `state.y` by its own."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Try up to `budget` steps of a run, and return why the loop over steps stopped."""
        self._work[self._entries] = state.y
        self._use(state)
        if state.integers[DriverState.RECORD]:
            self._budget = None
            self._call.give(budget=budget, times=times, rows=rows)
        elif budget != self._budget:
            self._budget = budget
            self._call.give(budget=budget, times=None, rows=None)
        before = state.integers[DriverState.STEPS]
        try:
            outcome: Outcome = OUTCOMES[self._call()]
        finally:
            state.y[:] = self._work[self._entries]
        self.count(state.integers[DriverState.STEPS] - before)
        return outcome

    def _use(self, state: DriverState) -> None:
        """Advance the run `state` from now on: pass its arrays to the loop over steps."""
        if state is not self._state:
            self._state = state
            self._call.give(**state.records())

    def function(self, state: DriverState) -> StepFunction:
        """Return the compiled function that takes steps of a state, which another compiled loop calls.

        After many steps the result is another function, with optimized code.
        """
        self._use(state)
        self._budget = None
        if self._function is None:
            loop, call = self._loop, self._call
            self._function = StepFunction(loop.steps, call.words, self._work, self._entries)
        return self._function

    def count(self, steps: int) -> None:
        """Add `steps` steps to the count of steps. After many steps, optimized code is compiled and used."""
        if self._call.count(steps):
            self._function = None

    def kept(self) -> tuple[Kept, ...]:
        """Return the data that Newton's method keeps from step to step, for each system of implicit equations.

        The systems of the step come first, then those of the starter, the method of the first steps.
        """
        layout, starting = self._layout, self._layout.starting
        solves = [(layout, self._work, *pair) for pair in zip(self._newtons, layout.solves, strict=True)]
        if self._starters:
            work = self._work[layout.end :]
            solves += [(starting, work, *pair) for pair in zip(self._starters, starting.solves, strict=True)]
        return tuple(kept(where, newton.matrix_step, solve, work) for where, work, newton, solve in solves)


def numbers_of(step: StepProgram, scalars: Program, t: float, h: float, ratio: float) -> dict[Node, float]:
    """Return the value of every coefficient of a step at time t with step size h, by the coefficient's node.

    `ratio` is h divided by the previous step size. `scalars` is the program that computes all coefficients; it is
    built once for many steps.
    """
    values = FLOATS.evaluate(scalars, t, [h, ratio], [])
    return dict(zip(step.numbers, map(float, values), strict=True))


WATCHED = (
    *((name, name) for name in ("tilts", "sides", "settings", "combinations", "switch_rows", "switch_combinations")),
    *((name, name) for name in ("scratch", "whole_scratch")),
    *((f"event_{name}", name) for name in ("times", "states", "places")),
)
"""The arrays of an `EventMemory`: the name of each as an argument of the loop, and as an attribute."""


class SeriesDriver:
    """Advances a run by Taylor steps (implements `Driver`).

    The parameters may change during a run. They are an array (k + s,): k parameters, then one entry for each of the s
    switching surfaces. This entry is the sign of the surface's function, 1.0 or -1.0, or 0.0 if the motion stays on
    the surface.
    """

    def __init__(self, machine: Machine, code: SeriesCode, order: int, parameters: FloatArray) -> None:
        self._machine, self._code, self._call = machine, code, code.loop.bound()
        self._work = workspace(code.layout.size(order))
        self._y = self._work[: code.layout.dimension]
        self._call.give(jet=code.function, work=self._work, held=HELD.structure(), order=order)
        self._budget: int | None = None
        """The budget of calls without rows."""
        self._is_final = False
        self._state: DriverState | None = None
        self._outputs: Outputs | None = None
        self._memory: EventMemory | None = None
        self._numbers: FloatArray | None = None
        projection = code.program.projection
        self._projection = None if projection is None else code.load(projection)
        self._parameters = parameters
        if not code.layout.watched:
            self.use(parameters)

    def use(self, parameters: FloatArray) -> None:
        """Continue the run with other parameters (k + s,): k values, then the signs of the s switching surfaces.

        A sign is that of the surface's function: 1.0, -1.0, or 0.0 if the motion stays on the surface.
        """
        self._parameters, memory, code = parameters, self._memory, self._code
        if self._projection is not None:
            callback = self._machine.callback(self._projection, parameters[: len(parameters) - code.program.sides])
            self._call.give(projection=callback.function, projection_numbers=callback.numbers)
        numbers, sizes = code.joined(parameters, None if memory is None else memory.values)
        if memory is None or not memory.surfaces:
            if memory is not None:
                memory.hold(parameters[:0], 0)
            self._numbers = numbers
            self._point(numbers, sizes)
            return
        offset = memory.hold(parameters[len(parameters) - memory.surfaces :], len(numbers))
        if self._numbers is None:
            self._numbers = np.zeros(len(numbers) * (1 + len(memory.combinations)))
            self._point(self._numbers, sizes)
        self._numbers[offset : offset + len(numbers)] = numbers

    def _point(self, numbers: FloatArray, sizes: Sequence[int]) -> None:
        """Pass parts of the array `numbers` to the loop over steps: `prepared`, `constants` and `value_numbers`.

        The parts follow one another and have the lengths `sizes`. `prepared` begins with the parameters.
        `value_numbers` are the numbers that the kernel of the event functions reads.
        """
        begin = 0
        for name, size in zip(("prepared", "constants", "value_numbers"), sizes, strict=False):
            self._call.give(**{name: numbers[begin:]})
            begin += size

    def watch(self, memory: EventMemory) -> None:
        """Find zeros of event functions and switching surfaces from now on.

        `memory` lists these functions. The loop over steps writes the events that it finds to `memory`.
        """
        self._memory, self._numbers, code = memory, None, self._code
        self._call.give(watch=memory.record, sizes=code.layout.sizes)
        self._call.give(**{name: getattr(memory, attribute) for name, attribute in WATCHED})
        if memory.values is not None:
            self._call.give(values=self._machine.callback(memory.values, self._parameters).function)
        self.use(self._parameters)
        if memory.resets is not None:
            self._resets = code.load(memory.resets.program)
            callback = self._machine.callback(self._resets, memory.parameters)
            self._call.give(resets=callback.function, reset_numbers=callback.numbers)

    def restart(self, state: DriverState) -> None:
        """Set the carried rounding errors of the state to zero, because the state has jumped.

        The loop carries them from step to step by compensated sums.
        """
        layout = self._code.layout
        self._work[layout.lost : layout.lost + layout.padded] = 0.0
        state.taylor.low = 0.0

    def adopt(self, state: DriverState) -> None:
        """Replace the array `state.y` by the driver's own array, so that steps do not copy the state."""
        state.y = self._y

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Try up to `budget` steps of a run, and return why the loop over steps stopped."""
        if state is not self._state:
            self._state = state
            if self._memory is None and self._code.layout.watched:
                self.watch(idle(self._code.program))
            self._call.give(**state.records(), taylor=state.taylor)
        if state.outputs is not self._outputs:
            outputs = self._outputs = state.outputs
            self._call.give(outputs=outputs.record, output_times=outputs.times, output_states=outputs.states)
        foreign = state.y is not self._y
        if foreign:
            self._y[:] = state.y
        if state.integers[DriverState.RECORD]:
            self._budget = None
            self._call.give(budget=budget, times=times, rows=rows)
        elif budget != self._budget:
            self._budget = budget
            self._call.give(budget=budget)
        before = state.integers[DriverState.STEPS]
        try:
            outcome: Outcome = OUTCOMES[self._call()]
        finally:
            if foreign:
                state.y[:] = self._y
        if not self._is_final:
            self._count(state.integers[DriverState.STEPS] - before)
        return outcome

    def _count(self, steps: int) -> None:
        """Add `steps` steps to the count of steps. After many steps, optimized code is compiled and used."""
        self._call.count(steps)
        if self._code.count(steps):
            self._call.give(jet=self._code.function)
        self._is_final = self._call.is_final and self._code.is_final
