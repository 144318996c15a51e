"""The driver of step programs on every machine: it calls the compiled or printed loop over steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from lagrange.algorithm.step.memory import EFFORT, NEWTON, Kept, kept
from lagrange.graph.node import Node
from lagrange.machine.backend import FloatArray, Kernel, Machine
from lagrange.machine.kernel.interpreted import FLOATS
from lagrange.machine.llvm.address import workspace
from lagrange.machine.state import OUTCOMES, DriverState, Outcome
from lagrange.machine.step_events import StepFunction
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
        loop, layout = machine.loop(step, kernel.program.states, projected=projection is not None)
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
        """Return a record (a structure of named numbers) that begins at index `index` of the work array."""
        memory: Any = self._work
        return record.structure.from_buffer(memory, 8 * index)

    def adopt(self, state: DriverState) -> None:
        """Do nothing: unlike a driver by Taylor series, this driver does not replace the memory of the state."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Try up to `budget` steps of a run, and return the outcome: why the loop over steps stopped.

        The times and states of accepted steps are written to `times` (c,) and `rows` (c, 2n).
        """
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
        """Return the compiled function that takes steps of a state, for another compiled loop.

        After many steps another function replaces it.
        """
        self._use(state)
        self._budget = None
        if self._function is None:
            loop, call = self._loop, self._call
            self._function = StepFunction(loop.steps, call.words, self._work, self._entries)
        return self._function

    def count(self, steps: int) -> None:
        """Report that `steps` more steps were taken, and switch to optimized code when it is ready."""
        if self._call.count(steps):
            self._function = None

    def kept(self) -> tuple[Kept, ...]:
        """Return what each solve by Newton's method keeps from step to step: for the steps, then for the starter."""
        layout, starting = self._layout, self._layout.starting
        solves = [(layout, self._work, *pair) for pair in zip(self._newtons, layout.solves, strict=True)]
        if self._starters:
            work = self._work[layout.end :]
            solves += [(starting, work, *pair) for pair in zip(self._starters, starting.solves, strict=True)]
        return tuple(kept(where, newton.matrix_step, solve, work) for where, work, newton, solve in solves)


def numbers_of(step: StepProgram, scalars: Program, t: float, h: float, ratio: float) -> dict[Node, float]:
    """Return the value of every coefficient of a step at time t with step size h, by the coefficient's node.

    `ratio` is h divided by the step before. `scalars` is the program of all coefficients, built once for many steps.
    """
    values = FLOATS.evaluate(scalars, t, [h, ratio], [])
    return dict(zip(step.numbers, map(float, values), strict=True))
