"""Steps with events in machine code: one call takes steps, finds the zeros of events on them, and resets the state."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.dense.block import block_size
from lagrange.algorithm.events.event_steps import event_steps
from lagrange.algorithm.events.step_samples import work_size
from lagrange.algorithm.step.constants import RELATIVE_PERTURBATION, perturbation_factors
from lagrange.machine.backend import DensePath, FloatArray
from lagrange.machine.kernel.llvm_kernel import cached_kernel
from lagrange.machine.llvm.address import workspace
from lagrange.machine.llvm.called import compiled
from lagrange.machine.state import DriverState
from lagrange.machine.step_events import StepEventMemory, StepFunction
from lagrange.program.program import Program

STANDING = (
    *("times", "states", "sign", "near", "direction", "remaining", "stayed", "came", "which", "when", "there"),
    *("settings", "break_rows", "break_times", "break_states", "kept_reals", "kept_counts"),
)
"""Arguments of the loop, by name, that are arrays of a `StepEventMemory`."""


class SteppingDriver(Protocol):
    """Protocol of a driver whose compiled step function is called by another compiled loop."""

    def function(self, state: DriverState) -> StepFunction:
        """Return the compiled function that takes steps of this driver, set to continue the run `state`."""

    def count(self, steps: int) -> None:
        """Report that `steps` more steps were accepted.

        After many steps the code is compiled again with optimization.
        """


class LlvmEventSteps:
    """Compiled loop that takes steps of a driver and finds events on them, for one set of parameters.

    It implements `EventSteps`.
    """

    def __init__(
        self,
        driver: SteppingDriver,
        events: Program,
        resets: Program | None,
        parameters: FloatArray,
        dense: DensePath,
        screen: DensePath | None,
    ) -> None:
        self._driver, self._written = driver, dense.polynomial()
        # Implicit methods take long steps: a cubic through the ends of a step is not a safe screen for them.
        screens = screen is not None and not self._written.both
        self._screen = screen.polynomial() if screen is not None and screens else self._written
        self._kernel = kernel = cached_kernel(events)
        self._resets = kernel if resets is None else cached_kernel(resets)
        n, count = events.states, events.shape[0]
        written, prepared = self._written, kernel.prepare(parameters)
        self.both = written.both
        results = 0 if resets is None else resets.shape[0]
        arguments: dict[str, Any] = {
            "polynomial": written.function,
            "given": written.context,
            "degree": dense.degree,
            "both": int(written.both),
            **{name: np.zeros(block_size(n, WIDEST_VECTOR) + WIDEST_VECTOR) for name in ("own", "beside")},
            "screen": self._screen.function,
            "screen_given": self._screen.context,
            # The arguments of a block polynomial begin with the law over columns and its parameters.
            "law": int(self._screen.context[0]),
            "law_parameters": int(self._screen.context[1]),
            "screens": screens,
            "path_work": workspace(max(written.work, self._screen.work)),
            "c": workspace((dense.degree + 1) * n * WIDEST_VECTOR + WIDEST_VECTOR),
            "kernel": kernel.columns_address,
            "parameters": prepared,
            "values": kernel.address,
            "value_numbers": prepared,
            "resets": self._resets.address,
            "reset_numbers": self._resets.prepare(parameters),
            "dimension": n,
            "events": count,
            "factors": 1 + RELATIVE_PERTURBATION * perturbation_factors(n + 1),
            "noted": np.zeros(4 * count, dtype=np.int64),
            "levels": np.zeros(count),
            "work": workspace(work_size(n, count)),
            "scratch": np.zeros(n + 2 * count + results + WIDEST_VECTOR),
        }
        self._call = compiled(event_steps.form()).bound()
        self._call.give(**arguments)
        self._memory: StepEventMemory | None = None
        self._function: StepFunction | None = None
        self._state: DriverState | None = None

    def __call__(self, state: DriverState, memory: StepEventMemory, times: FloatArray, rows: FloatArray) -> int:
        """Take steps of a run, and find the events on them. Return a number that says why the loop stopped.

        The times and states of accepted steps are written to `times` (c,) and `rows` (c, 2n). The number is an
        outcome of the driver, or says that a step is irregular or that the arrays of `memory` are full.
        """
        if memory is not self._memory:
            self._memory = memory
            self._call.give(**_of_memory(memory))
        function = self._driver.function(state)
        if function is not self._function or state is not self._state:
            self._function, self._state = function, state
            self._call.give(drive=function.address, words=function.words, entries=function.entries)
            self._call.give(driver_work=function.work, reals=state.reals, counts=state.counts, y=state.y)
        self._call.give(row_times=times, row_states=rows)
        before = state.integers[DriverState.STEPS]
        code = self._call()
        self._driver.count(max(0, state.integers[DriverState.STEPS] - before))
        return int(code)


def _of_memory(memory: StepEventMemory) -> dict[str, Any]:
    """Return the arrays and records of `memory` that the compiled loop takes as arguments, by name."""
    arrays = {name: getattr(memory, name) for name in STANDING}
    return {**arrays, "review": memory.review, "event_run": memory.run}
