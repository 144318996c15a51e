"""The Taylor driver of the numpy machine: the procedures that machine code runs, printed as Python source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from lagrange.algorithm.series.cost import Cost, best_order
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import HELD, TaylorLayout
from lagrange.machine.backend import FloatArray, Kernel, SingularMassMatrix
from lagrange.machine.copies import Shared
from lagrange.machine.dense.interpreted_dense import NumpyDense, write_series
from lagrange.machine.event_memory import EventMemory, idle
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.kernel.python_kernel import PythonKernel
from lagrange.machine.kernel.straight_lines import fits
from lagrange.machine.printed_run import EMPTY, Recorded, Records, advance
from lagrange.machine.python_source import loaded
from lagrange.machine.series.interpreted_jet import Jet
from lagrange.machine.state import DriverState, Outcome
from lagrange.program.series import SeriesProgram


@lru_cache(maxsize=64)
def _steps(layout: TaylorLayout) -> Callable[..., int]:
    """Return the loop over steps for a layout."""
    return loaded(taylor_steps.form(layout=layout))


class NumpySeries(Shared):
    """A series program that is interpreted."""

    def __init__(self, program: SeriesProgram) -> None:
        self.program = program
        self._prepared: tuple[bytes, Jet] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return NumpySeries, (self.program,)

    def form(self, order: int) -> str:
        """Return the word for the status card; see `Series`."""
        return "interpreted"

    def order(self, tolerance: float) -> int:
        """Return the order by cost; see `Series`. Interpreting costs as much at every order."""
        return best_order(Cost(fixed=2.0, each=1.0, pairs=0.0), tolerance)

    @cached_property
    def values(self) -> Kernel:
        """The event functions and switching surfaces as a kernel of the state; see `Series`."""
        program = self.program.values
        return PythonKernel(program) if fits(program) else InterpretedKernel(program)

    @cached_property
    def projection(self) -> Kernel | None:
        """The kernel that corrects a state to satisfy the constraints, or None without constraints."""
        program = self.program.projection
        if program is None:
            return None
        return PythonKernel(program) if fits(program) else InterpretedKernel(program)

    def driver(self, order: int, parameters: FloatArray) -> NumpyTaylorDriver:
        """Return a driver; see `Series`."""
        return NumpyTaylorDriver(self, order, parameters)

    def dense(self, order: int, parameters: FloatArray) -> NumpySeriesDense:
        """Return the dense output of steps; see `Series`."""
        return NumpySeriesDense(self, order, parameters)

    def rows(
        self,
        order: int,
        t: float,
        y: FloatArray,
        scale: float,
        parameters: FloatArray,
        low: FloatArray | None = None,
    ) -> FloatArray:
        """Return the scaled coefficients at the state y + low, where `low` is below rounding; see `Series`."""
        with np.errstate(all="ignore"):
            found = self._jet(parameters).coefficients(t, y, order, scale, low)
            zero = np.zeros(order + 1)
            watched = [zero if i is None else found[:, i] for i in self.program.watched]
            rows: FloatArray = np.column_stack([found[:, : self.program.states], *watched])
            return rows

    def _jet(self, parameters: FloatArray) -> Jet:
        """Return the series for some parameters and sides, kept until these change."""
        key, known = parameters.tobytes(), self._prepared
        if known is None or known[0] != key:
            known = self._prepared = key, Jet(self.program, parameters.copy())
        return known[1]


@dataclass(frozen=True, eq=False)
class NumpySeriesDense(NumpyDense):
    """The dense output of steps by a series at one order, for one set of parameters and sides."""

    series: NumpySeries
    order: int
    parameters: FloatArray
    both = False

    @property
    def dimension(self) -> int:
        """The length of a state."""
        return self.series.program.states

    @property
    def degree(self) -> int:
        """The order."""
        return self.order

    @property
    def width(self) -> int:
        """The length of a row of the series."""
        return self.dimension + len(self.series.program.watched)

    def size(self, columns: int) -> int:
        """Return the length of the work memory: a state, its rounding errors, and the rows of one series."""
        return 2 * self.dimension + (self.order + 1) * self.width

    def write(self, columns: int, own: FloatArray, beside: FloatArray, work: FloatArray, out: FloatArray) -> None:
        """Write the polynomials by the series; see `NumpyDense`."""
        jet = _between_arrays(self.series, self.parameters)
        write_series(jet, self.dimension, self.width, self.order, columns, own, beside, work, out)


class NumpyTaylorDriver:
    """Advances a run by interpreted Taylor steps."""

    def __init__(self, series: NumpySeries, order: int, parameters: FloatArray) -> None:
        self._series, self._order, self._parameters = series, order, parameters
        self._projection = series.projection
        self._layout = TaylorLayout.of(series.program)
        self._work = np.zeros(self._layout.size(order))
        self._held, self._sizes = HELD.structure(), self._layout.sizes
        self._memory: EventMemory | None = None
        self._numbers = np.array(parameters)

    def watch(self, memory: EventMemory) -> None:
        """Set event functions, surfaces and resets; see `TaylorDriver`."""
        self._memory = memory
        self._numbers = np.zeros((1 + len(memory.combinations)) * len(self._parameters))
        self.use(self._parameters)

    def use(self, parameters: FloatArray) -> None:
        """Use other values of the parameters and sides; see `TaylorDriver`."""
        self._parameters, place = parameters, 0
        if self._memory is not None:
            place = self._memory.hold(parameters[len(parameters) - self._memory.surfaces :], len(parameters))
        self._numbers[place : place + len(parameters)] = parameters

    def restart(self, state: DriverState) -> None:
        """Clear the rounding errors carried from step to step; see `TaylorDriver`."""
        self._work[self._layout.lost : self._layout.held] = 0.0
        state.taylor.low = 0.0

    def adopt(self, state: DriverState) -> None:
        """Do nothing: steps work on the state in place; see `Driver`."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`."""
        outputs = state.outputs.record, state.outputs.times.data, state.outputs.states.reshape(-1).data
        jet = _with_numbers(self._series, len(self._parameters))
        series, kept = (jet, self._numbers.data, EMPTY), (state.taylor, state.floors.data, self._held, *outputs)

        watched = self._watched() if self._layout.watched else ()
        sides = self._series.program.sides
        own = self._parameters[: len(self._parameters) - sides]
        projected = () if self._projection is None else (_function(self._projection, len(state.y), len(own)), own.data)

        def steps(records: Records, recorded: Recorded) -> int:
            given = *series, *records, *kept, *recorded, *watched, *projected
            return _steps(self._layout)(*given, self._work.data, self._order, budget)

        return advance(state, self._work, times, rows, steps)

    def _watched(self) -> tuple[Any, ...]:
        """Return the arguments of the loop for events and switching surfaces."""
        memory = self._memory = self._memory or idle(self._series.program)
        count, dimension = len(self._parameters), self._layout.dimension
        resets = _function(memory.resets, dimension, len(memory.parameters))
        functions = _function(memory.values, dimension, count), resets
        numbers = self._numbers.data, memory.parameters.data
        arrays = (getattr(memory, name).data for name in WATCHED)
        return memory.record, self._sizes, *functions, *numbers, *arrays


WATCHED = (
    *("tilts", "sides", "settings", "times", "states", "places"),
    *("combinations", "switch_rows", "switch_combinations", "scratch", "whole_scratch"),
)
"""The arrays of an `EventMemory` in the order of the arguments of the loop."""


def _function(kernel: Kernel | None, dimension: int, count: int) -> Callable[..., bool]:
    """Return a kernel of `count` parameters as a function between arrays, which returns True for a singular matrix."""

    def called(t: float, y: memoryview, numbers: memoryview, out: memoryview) -> bool:
        if kernel is None:
            return True
        try:
            found = kernel(t, np.frombuffer(y, count=dimension), np.asarray(numbers[:count]))
        except SingularMassMatrix:
            return True
        out[: found.size] = found.reshape(-1).data
        return False

    return called


def _with_numbers(series: NumpySeries, count: int) -> Callable[..., bool]:
    """Return a series as the function that the loop calls, which reads parameters and sides from an array."""

    def jet(t: float, scale: float, y: Any, numbers: Any, constants: Any, rows: Any, order: int) -> bool:
        between = _between_arrays(series, np.asarray(numbers[:count]))
        return between(t, scale, y, numbers, constants, rows, order)

    return jet


def _between_arrays(series: NumpySeries, parameters: FloatArray) -> Callable[..., bool]:
    """Return a series for fixed parameters as the function that the loop over steps calls.

    It returns True for a singular matrix. The array of the state has its 2n entries, then their rounding errors.
    """

    def jet(t: float, scale: float, y: Any, _: Any, __: Any, rows: Any, order: int) -> bool:
        state = np.frombuffer(y, count=2 * series.program.states).reshape(2, -1)
        try:
            found = series.rows(order, t, state[0], scale, parameters, state[1])
        except SingularMassMatrix:
            return True
        rows[: found.size] = found.reshape(-1).data
        return False

    return jet
