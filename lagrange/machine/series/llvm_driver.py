"""Series programs in machine code: the jet, the numbers that it reads, and the driver that takes steps with it.

`c` is the inverse of a constant mass matrix by columns, or the diagonal of a diagonal one, then the constants as
vectors, each where the code reads it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from lagrange.algorithm.blocks import WIDEST_VECTOR, whole_blocks
from lagrange.algorithm.linear.inverse import invert
from lagrange.algorithm.series.by_order import ByOrderJet, Row, by_order_scratch
from lagrange.algorithm.series.cost import cheapest_order, is_large
from lagrange.algorithm.series.jet import NAME as JET_NAME
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import Packing, pack
from lagrange.algorithm.series.written_out import WrittenJet
from lagrange.algorithm.taylor.memory import HELD, TaylorLayout
from lagrange.errors import RunError
from lagrange.machine.backend import BlockPolynomial, FloatArray, SingularMassMatrix
from lagrange.machine.copies import Shared
from lagrange.machine.dense.llvm_dense import LlvmDense, of_series
from lagrange.machine.event_memory import EventMemory, idle
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.llvm.address import address, workspace
from lagrange.machine.llvm.engine import Module, inversion, linear_solver
from lagrange.machine.llvm.procedures import declaration
from lagrange.machine.llvm.procedures import function as procedure_ir
from lagrange.machine.llvm.procedures import joined as module_ir
from lagrange.machine.llvm.processor import lanes
from lagrange.machine.llvm.tiers import TieredModule
from lagrange.machine.series.constants import constants
from lagrange.machine.series.llvm_steps import compiled_steps
from lagrange.machine.state import OUTCOMES, DriverState, Outcome
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram

WATCHED = (
    *((name, name) for name in ("tilts", "sides", "settings", "combinations", "switch_rows", "switch_combinations")),
    *((name, name) for name in ("scratch", "whole_scratch")),
    *((f"event_{name}", name) for name in ("times", "states", "places")),
)
"""The arrays of an `EventMemory`: the name of each as an argument of the loop, and as an attribute."""

_PREPARE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
_SERIES = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_double, *([ctypes.c_void_p] * 4), ctypes.c_int64)


class LlvmSeries(Shared):
    """A series program in machine code: written out for each order that is asked for, or in loops for all orders."""

    def __init__(self, program: SeriesProgram) -> None:
        self.program = program
        self._packing = pack(program, lanes())
        self._compiled: dict[int, CompiledJet] = {}
        self._orders: dict[float, int] = {}
        self._large: dict[int, bool] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return LlvmSeries, (self.program,)

    def form(self, order: int) -> str:
        """Return whether the code of an order is in loops or written out; see `Series`."""
        return "in loops" if self._is_large(order) else "written out"

    def _is_large(self, order: int) -> bool:
        if order not in self._large:
            self._large[order] = is_large(self._packing, order)
        return self._large[order]

    def order(self, tolerance: float) -> int:
        """Return the order by cost; see `Series`."""
        if tolerance not in self._orders:
            self._orders[tolerance] = cheapest_order(self._packing, tolerance)
        return self._orders[tolerance]

    def compiled(self, order: int) -> CompiledJet:
        """Return the machine code for an order."""
        key = 0 if self._is_large(order) else order
        if key not in self._compiled:
            with refused():
                self._compiled[key] = CompiledJet(self._packing, key)
        return self._compiled[key]

    @cached_property
    def values(self) -> LlvmKernel:
        """The event functions and switching surfaces as a kernel of the state; see `Series`."""
        return function(self.program.values)

    def driver(self, order: int, parameters: FloatArray) -> LlvmTaylorDriver:
        """Return a driver of Taylor steps of an order, for parameters (k + sides,).

        Raises SingularMassMatrix if a constant mass matrix has no inverse.
        """
        compiled = self.compiled(order)
        with refused():
            return LlvmTaylorDriver(compiled, order, parameters)

    def dense(self, order: int, parameters: FloatArray) -> LlvmSeriesDense:
        """Return the dense output of steps; see `Series`."""
        return LlvmSeriesDense(self, order, parameters)

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return the series at a state; see `Series`."""
        return self.compiled(order).rows(order, t, y, scale, parameters)


@dataclass(frozen=True, eq=False)
class LlvmSeriesDense(LlvmDense):
    """The dense output of steps by a series at one order, for one set of parameters and sides."""

    series: LlvmSeries
    order: int
    parameters: FloatArray

    @property
    def dimension(self) -> int:
        """The length of a state."""
        return self.series.program.states

    @property
    def degree(self) -> int:
        """The order."""
        return self.order

    def polynomial(self) -> BlockPolynomial:
        """Return the callback that writes the polynomials, with the address of the series; see `LlvmDense`."""
        compiled = self.series.compiled(self.order)
        return of_series(compiled.address, compiled.numbers(self.parameters), compiled.layout, self.order)


@lru_cache(maxsize=64)
def function(program: Program) -> LlvmKernel:
    """Return the kernel of a program, which the loop over steps calls. Raises RunError if LLVM refuses it."""
    with refused():
        return LlvmKernel(program)


@contextmanager
def refused() -> Iterator[None]:
    """Raise RunError in place of an error of LLVM, with the advice to use the numpy machine."""
    try:
        yield
    except RuntimeError as error:
        raise RunError(f"LLVM could not compile the series: {error}. Use target='numpy'.") from error


class CompiledJet:
    """A packed series in machine code at one order; order 0 means loops that serve every order."""

    def __init__(self, packing: Packing, order: int) -> None:
        self.program = packing.program
        self._numbers = SeriesNumbers(self.program, self.program.constants.parameters, packing)
        self.layout = layout_of(packing, order)
        jet: WrittenJet | ByOrderJet
        if order:
            jet = WrittenJet(packing, self._numbers, order, lowest=order, layout=self.layout)
        else:
            jet = ByOrderJet(packing, self._numbers, self.layout)
        ir = series_ir(jet.build(), self._numbers.prepare_start("prepare_start"))
        # Loops run more slowly where they are compiled quickly, and serve all orders.
        self.tiers = TieredModule(ir, JET_NAME) if order else None
        self._module = self.tiers.quick if self.tiers else Module(ir)
        self._prepare = _PREPARE(self._module.address("prepare_start"))
        self._prepared: tuple[bytes, tuple[FloatArray, FloatArray]] | None = None
        self._joined: tuple[tuple[bytes, LlvmKernel | None], tuple[FloatArray, list[int]]] | None = None

    @property
    def ir(self) -> str:
        """The LLVM IR."""
        return self._module.ir

    @property
    def address(self) -> int:
        """Address of the compiled series. It changes once, when optimized code replaces the code compiled quickly."""
        return self.tiers.address if self.tiers else self._module.address(JET_NAME)

    @property
    def _series(self) -> Any:
        return _SERIES(self.address)

    def numbers(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the two arrays of numbers that do not change along a run: `p` and `c`. Raises SingularMassMatrix."""
        key, known = parameters.tobytes(), self._prepared
        if known is not None and known[0] == key:
            return known[1]
        prepared = self._numbers.array(parameters, *constants(self.program, parameters))
        self._prepare(address(prepared))
        found = prepared, np.zeros(1)
        self._prepared = (key, found)
        return found

    def joined(self, parameters: FloatArray, values: LlvmKernel | None) -> tuple[FloatArray, list[int]]:
        """Return `p`, `c` and the numbers of the kernel of event functions in one array, with the length of each."""
        key, known = (parameters.tobytes(), values), self._joined
        if known is None or known[0] != key:
            parts = [*self.numbers(parameters), *([] if values is None else [values.prepare(parameters)])]
            known = self._joined = key, (np.concatenate(parts), list(map(len, parts)))
        return known[1]

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return the scaled coefficients of the state and of the watched functions; see `Series`."""
        layout, numbers = self.layout, self.numbers(parameters)
        work = np.zeros(layout.size(order))
        state = np.zeros(2 * layout.padded)
        state[: layout.dimension] = y
        if self._series(t, scale, *map(address, (state, *numbers, work)), order):
            raise SingularMassMatrix
        return layout.coefficients(work, order)


def layout_of(packing: Packing, order: int) -> TaylorLayout:
    """Return the layout of a series at one order, or for every order with an order of 0."""
    program = packing.program
    block = 2 if program.states <= 2 else 4 if program.states <= 4 else 8
    if order:
        return TaylorLayout.of(program, block=block, chains=True)
    width = whole_blocks(Row(packing, whole_blocks(program.states, block)).size, WIDEST_VECTOR)
    return TaylorLayout.of(program, width, block=block, scratch=by_order_scratch(packing))


def series_ir(jet: Procedure, prepare: Procedure) -> str:
    """Return the IR of the module of a series. Procedures of other modules that it calls are compiled first."""
    called = dict.fromkeys((*prepare.callees, *jet.callees))
    if invert.form() in called:
        inversion()
    elif called:
        linear_solver(often=False)
    functions = [procedure_ir(prepare, outside=(prepare,), quickly=True), procedure_ir(jet, outside=(jet,))]
    return module_ir(functions, [declaration(one) for one in called])


class LlvmTaylorDriver:
    """Advances a run by compiled Taylor steps. The arguments of the loop are one array of addresses and integers."""

    def __init__(self, compiled: CompiledJet, order: int, parameters: FloatArray) -> None:
        self._compiled, self._steps = compiled, compiled_steps(compiled.layout)
        self._work = workspace(compiled.layout.size(order))
        self._y = self._work[: compiled.layout.dimension]
        self._held, self._sizes = HELD.structure(), compiled.layout.sizes
        self._arguments = np.zeros(len(self._steps.places), dtype=np.int64)
        self._entries: Any = self._arguments.data
        self._give(work=address(self._work), held=ctypes.addressof(self._held), order=order)
        self._use_tiers()
        self._place, self._budget = address(self._arguments), self._steps.places["budget"]
        self._state: DriverState | None = None
        self._output_record: Any = None
        self._memory: EventMemory | None = None
        self._numbers: FloatArray | None = None
        projection = compiled.program.projection
        self._projection = None if projection is None else function(projection)
        self._parameters = parameters
        if not compiled.layout.watched:
            self.use(parameters)

    def _give(self, **arguments: int) -> None:
        """Set arguments of the compiled loop by name."""
        entries, places = self._entries, self._steps.places
        for name, value in arguments.items():
            entries[places[name]] = value

    def _use_tiers(self) -> None:
        """Use the best code compiled so far, of the series and of the loop."""
        self._give(jet=self._compiled.address)
        self._run = self._steps.run
        self._tiers = [tiers for tiers in (self._compiled.tiers, self._steps.module) if tiers and not tiers.is_final]

    def _count(self, steps: int) -> None:
        """Count steps for code compiled quickly. After many of them optimized code replaces it."""
        for tiers in self._tiers:
            tiers.count(steps)
        if any(tiers.is_final for tiers in self._tiers):
            self._use_tiers()

    def use(self, parameters: FloatArray) -> None:
        """Use other values of the parameters and sides; see `TaylorDriver`."""
        self._parameters, memory = parameters, self._memory
        if self._projection is not None:
            self._project(self._projection, parameters[: len(parameters) - self._compiled.program.sides])
        values = None if memory is None or not isinstance(memory.values, LlvmKernel) else memory.values
        numbers, sizes = self._compiled.joined(parameters, values)
        if memory is None or not memory.surfaces:
            if memory is not None:
                memory.hold(parameters[:0], 0)
            self._numbers = numbers
            self._point(address(numbers), sizes)
            return
        place = memory.hold(parameters[len(parameters) - memory.surfaces :], len(numbers))
        if self._numbers is None:
            self._numbers = np.zeros(len(numbers) * (1 + len(memory.combinations)))
            self._point(address(self._numbers), sizes)
        self._numbers[place : place + len(numbers)] = numbers

    def _project(self, projection: LlvmKernel, parameters: FloatArray) -> None:
        """Set the kernel that corrects a state to satisfy the constraints, with its parameters."""
        self._projection_numbers = projection.prepare(parameters)
        self._give(projection=projection.address, projection_numbers=address(self._projection_numbers))

    def _point(self, begin: int, sizes: Sequence[int]) -> None:
        """Set the addresses of the three parts of the array of numbers, which begins at `begin`, from their lengths."""
        for name, size in zip(("prepared", "constants", "value_numbers"), sizes, strict=False):
            self._give(**{name: begin})
            begin += 8 * size

    def watch(self, memory: EventMemory) -> None:
        """Set event functions, surfaces and resets; see `TaylorDriver`."""
        self._memory, self._numbers = memory, None
        entries, places = self._entries, self._steps.places
        entries[places["watch"]], entries[places["sizes"]] = map(ctypes.addressof, (memory.record, self._sizes))
        for name, attribute in WATCHED:
            entries[places[name]] = address(getattr(memory, attribute))
        if isinstance(memory.values, LlvmKernel):
            self._give(values=memory.values.address)
        self.use(self._parameters)
        if memory.resets is not None:
            self._resets = function(memory.resets.program)
            self._reset_numbers = self._resets.prepare(memory.parameters)
            self._give(resets=self._resets.address, reset_numbers=address(self._reset_numbers))

    def restart(self, state: DriverState) -> None:
        """Clear the rounding errors carried from step to step; see `TaylorDriver`."""
        layout = self._compiled.layout
        self._work[layout.lost : layout.lost + layout.padded] = 0.0
        state.taylor.low = 0.0

    def adopt(self, state: DriverState) -> None:
        """Keep the state in the memory of the driver, so that no step copies it; see `Driver`."""
        state.y = self._y

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`."""
        if state is not self._state or state.outputs.record is not self._output_record:
            self._state, self._output_record = state, state.outputs.record
            if self._memory is None and self._compiled.layout.watched:
                self.watch(idle(self._compiled.program))
            reals, counts = address(state.reals), address(state.counts)
            self._give(run=reals, counts=counts, floors=reals + 8 * DriverState.FLOORS)
            self._give(taylor=ctypes.addressof(state.taylor), outputs=ctypes.addressof(state.outputs.record))
            self._give(output_times=address(state.outputs.times), output_states=address(state.outputs.states))
        foreign = state.y is not self._y
        if foreign:
            self._y[:] = state.y
        self._entries[self._budget] = budget
        if state.integers[DriverState.RECORD]:
            self._give(times=address(times), rows=address(rows))
        before = state.integers[DriverState.STEPS]
        outcome: Outcome = OUTCOMES[self._run(self._place)]
        if self._tiers:
            self._count(state.integers[DriverState.STEPS] - before)
        if foreign:
            state.y[:] = self._y
        return outcome
