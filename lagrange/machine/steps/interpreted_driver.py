"""The driver of the numpy machine: the procedures that machine code runs, printed as Python source."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.algorithm.step.controlled_steps import steps_of
from lagrange.algorithm.step.memory import EFFORT, NEWTON, Kept, Layout, kept
from lagrange.machine.backend import FloatArray, Kernel, SingularMassMatrix
from lagrange.machine.printed_run import EMPTY, Recorded, Records, advance
from lagrange.machine.python_source import loaded
from lagrange.machine.state import DriverState, Outcome
from lagrange.program.actions import LAWS
from lagrange.program.step import StepProgram


@lru_cache(maxsize=64)
def _loaded(step: StepProgram, dimension: int, projected: bool) -> tuple[Layout, Callable[..., int]]:
    """Return the layout of a step's vectors, and the loop over steps as a Python function."""
    layout = Layout(step, dimension, block=1, projected=projected)
    return layout, loaded(steps_of(layout))


class NumpyDriver:
    """Takes the steps of a step program, and keeps the data of its Newton solves; see `Driver`."""

    def __init__(
        self,
        step: StepProgram,
        kernel: Kernel,
        parameters: FloatArray,
        jacobian: Kernel | None = None,
        projection: Kernel | None = None,
    ) -> None:
        dimension = LAWS[step.law].dimension(kernel.program.states)
        self._layout, self._run = _loaded(step, dimension, projection is not None)
        derivative = None if jacobian is None else between_arrays(jacobian, parameters)
        self._laws = between_arrays(kernel, parameters), EMPTY, derivative, EMPTY
        self._work = np.zeros(self._layout.size)
        layouts = [self._layout] if step.starter is None else [self._layout, self._layout.starting]
        self._newtons: list[list[Any]] = [[NEWTON.structure() for _ in layout.solves] for layout in layouts]
        newtons = [newton for known in self._newtons for newton in known]
        self._kept: tuple[Any, ...] = EFFORT.structure(), *newtons, memoryview(self._work.data)
        if projection is not None:
            self._kept = *self._kept, between_arrays(projection, parameters), EMPTY

    def adopt(self, state: DriverState) -> None:
        """Do nothing: the state keeps its own memory; see `Driver`."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`."""

        def steps(records: Records, recorded: Recorded) -> int:
            return self._run(*self._laws, *records, state.floors.data, *self._kept, budget, *recorded)

        return advance(state, self._work, times, rows, steps)

    def kept(self) -> tuple[Kept, ...]:
        """Return the kept data of each solve of the steps, followed by those of the starter."""
        layout = self._layout
        places = (layout, self._work), (layout.starting, self._work[layout.end :])
        return tuple(
            kept(where, newton.matrix_step, solve, work)
            for (where, work), newtons in zip(places, self._newtons, strict=False)
            for newton, solve in zip(newtons, where.solves, strict=True)
        )


def between_arrays(kernel: Kernel, parameters: FloatArray) -> Callable[..., bool]:
    """Return a kernel as the callback between arrays that procedures call. It returns True for a singular matrix."""
    count = kernel.program.states

    def evaluate(t: float, y: memoryview, _: memoryview, out: memoryview) -> bool:
        try:
            found = kernel(t, np.frombuffer(y, count=count), parameters)
        except SingularMassMatrix:
            return True
        out[: found.size] = np.ascontiguousarray(found).reshape(-1).data
        return False

    return evaluate
