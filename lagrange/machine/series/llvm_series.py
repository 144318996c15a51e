"""Taylor series in machine code: the jet (function that computes the series), its numbers, and the loop over steps.

The numbers of a series are one array: the parameters, then constants, results of order 0 that need no state, and
inverses of constant matrices. Constants joined to vectors follow, in the order in which the code reads them.

The loop over steps calls a series by its address, so all series of a layout share it. The procedures that find events
are the same for all layouts, and are compiled once per process.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, cached_property, lru_cache, partial
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from lagrange.algorithm.blocks import WIDEST_VECTOR, whole_blocks
from lagrange.algorithm.linear.symmetric import invert
from lagrange.algorithm.series.cost import cheapest_order, is_large
from lagrange.algorithm.series.jets import NAME as JET_NAME
from lagrange.algorithm.series.jets import ByOrderJet, Row, WrittenJet, by_order_scratch
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import Packing, pack
from lagrange.algorithm.taylor.event_zeros import inspect_step
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.algorithm.taylor.resets import begin_sides, cross_surface, reset_state
from lagrange.errors import RunError
from lagrange.machine.backend import BlockPolynomial, FloatArray, SingularMassMatrix
from lagrange.machine.copies import Shared
from lagrange.machine.dense.llvm_dense import LlvmDense, of_series
from lagrange.machine.kernel.llvm_kernel import LlvmKernel, cached_kernel
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.called import CompiledProcedure
from lagrange.machine.llvm.engine import Module, TieredModule, calling_solver, linear_solver
from lagrange.machine.llvm.procedures import declaration
from lagrange.machine.llvm.procedures import function as procedure_ir
from lagrange.machine.llvm.procedures import joined as module_ir
from lagrange.machine.llvm.processor import lanes
from lagrange.machine.series.constants import constants
from lagrange.procedure.form import Procedure, transitive_callees
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram

_PREPARE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
_SERIES = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_double, *([ctypes.c_void_p] * 4), ctypes.c_int64)


class LlvmSeries(Shared):
    """A Taylor series program in machine code: unrolled for each order requested, or in loops that serve all orders."""

    def __init__(self, program: SeriesProgram) -> None:
        self.program = program
        self._packing = pack(program, lanes())
        self._compiled: dict[int, CompiledJet] = {}
        self._is_large = cache(partial(is_large, self._packing))
        self._order = cache(partial(cheapest_order, self._packing))

    def __reduce__(self) -> tuple[Any, ...]:
        return LlvmSeries, (self.program,)

    def form(self, order: int) -> str:
        """Return "written out" for code without loops, else "in loops"."""
        return "in loops" if self._is_large(order) else "written out"

    def order(self, tolerance: float) -> int:
        """Return the order of the series with which a run to a relative tolerance costs least."""
        return self._order(tolerance)

    def code(self, order: int) -> CompiledJet:
        """Return the machine code that computes the series up to an order. It is compiled at the first request."""
        key = 0 if self._is_large(order) else order
        if key not in self._compiled:
            with refused():
                self._compiled[key] = CompiledJet(self._packing, key)
        return self._compiled[key]

    @cached_property
    def values(self) -> LlvmKernel:
        """The kernel that evaluates the event functions and switching surfaces at a state."""
        return function(self.program.values)

    def dense(self, order: int, parameters: FloatArray) -> LlvmDense:
        """Return the dense output of Taylor steps of an order: the Taylor polynomial on each step."""
        return LlvmDense(self.program.states, order, partial(_polynomial, self, order, parameters))

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return the scaled Taylor coefficients of the motion at a state y (2n,), with order k in row k."""
        return self.code(order).rows(order, t, y, scale, parameters)


def _polynomial(series: LlvmSeries, order: int, parameters: FloatArray) -> BlockPolynomial:
    """Return the callback that writes the polynomials of a block of Taylor steps, for one set of parameters."""
    compiled = series.code(order)
    return of_series(compiled.address, compiled.numbers(parameters), compiled.layout, order)


def function(program: Program) -> LlvmKernel:
    """Return the kernel of a program in machine code, for calls from the loop over steps.

    Raises RunError if LLVM refuses the program.
    """
    with refused():
        return cached_kernel(program)


@contextmanager
def refused() -> Iterator[None]:
    """Context that turns an error of LLVM into a RunError, whose message advises to use the numpy machine."""
    try:
        yield
    except RuntimeError as error:
        raise RunError(f"LLVM could not compile the series: {error}. Use target='numpy'.") from error


class CompiledJet:
    """Machine code that computes a Taylor series up to one order, or up to any order by loops (order 0)."""

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
        # Code with loops serves all orders and is slow if compiled quickly: it has no tiers.
        self.tiers = TieredModule(ir, JET_NAME) if order else None
        self._module = self.tiers.quick if self.tiers else Module(ir)
        self._prepare = _PREPARE(self._module.address("prepare_start"))
        self._prepared: tuple[bytes, tuple[FloatArray, FloatArray]] | None = None
        self._joined: tuple[tuple[bytes, LlvmKernel | None], tuple[FloatArray, list[int]]] | None = None

    @property
    def ir(self) -> str:
        """The LLVM IR of the series."""
        return self._module.ir

    @property
    def address(self) -> int:
        """Address of the compiled function that computes the series.

        It changes once, when optimized code replaces the code compiled quickly.
        """
        return self.tiers.address if self.tiers else self._module.address(JET_NAME)

    function = address

    @property
    def loop(self) -> CompiledProcedure:
        """The compiled loop over Taylor steps, which serves all series with the same layout in memory."""
        with refused():
            loop: CompiledProcedure = compiled_steps(self.layout)
        return loop

    @property
    def is_final(self) -> bool:
        """True if the code will not be compiled again."""
        return self.tiers is None or self.tiers.is_final

    def count(self, steps: int) -> bool:
        """Count `steps` more steps. Return True if optimized code replaces the quickly compiled code from now on."""
        if self.tiers is None or self.tiers.is_final:
            return False
        self.tiers.count(steps)
        return self.tiers.is_final

    def load(self, program: Program) -> LlvmKernel:
        """Return the kernel of a program, compiled once per process."""
        return function(program)

    @property
    def _series(self) -> Any:
        return _SERIES(self.address)

    def numbers(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the numbers that the code reads and that do not change along a run, as two arrays.

        The first has the parameters and all numbers that depend on them alone. The second is a single zero that the
        code does not read: the loop over steps expects two arrays. Raises SingularMassMatrix.
        """
        key, known = parameters.tobytes(), self._prepared
        if known is not None and known[0] == key:
            return known[1]
        prepared = self._numbers.array(parameters, *constants(self.program, parameters))
        self._prepare(address(prepared))
        numbers = prepared, np.zeros(1)
        self._prepared = (key, numbers)
        return numbers

    def joined(self, parameters: FloatArray, values: Any) -> tuple[FloatArray, list[int]]:
        """Return one array of all numbers that a run reads, and the lengths of its parts. It is cached."""
        key, known = (parameters.tobytes(), values), self._joined
        if known is None or known[0] != key:
            parts = [*self.numbers(parameters), *([] if values is None else [values.prepare(parameters)])]
            known = self._joined = key, (np.concatenate(parts), list(map(len, parts)))
        return known[1]

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return the scaled Taylor coefficients at a state (2n,), with order k in row k. Raises SingularMassMatrix."""
        layout, numbers = self.layout, self.numbers(parameters)
        work = np.zeros(layout.size(order))
        state = np.zeros(2 * layout.padded)
        state[: layout.dimension] = y
        if self._series(t, scale, *map(address, (state, *numbers, work)), order):
            raise SingularMassMatrix
        return layout.coefficients(work, order)


def layout_of(packing: Packing, order: int) -> TaylorLayout:
    """Return the layout in memory of a series at one order. Order 0 means code with loops for every order.

    `packing` says how values with the same rule are joined to vectors.
    """
    program = packing.program
    block = 2 if program.states <= 2 else 4 if program.states <= 4 else 8
    if order:
        return TaylorLayout.of(program, block=block, chains=True)
    width = whole_blocks(Row(packing, whole_blocks(program.states, block)).size, WIDEST_VECTOR)
    return TaylorLayout.of(program, width, block=block, scratch=by_order_scratch(packing))


def series_ir(jet: Procedure, prepare: Procedure) -> str:
    """Return the IR of a module with the two procedures of a series.

    `jet` computes the Taylor coefficients. `prepare` computes the numbers that depend on parameters alone. Procedures
    of other modules that they call are compiled first.
    """
    called = dict.fromkeys((*prepare.callees, *jet.callees))
    if invert.form() in called:
        calling_solver(invert.form())
    elif called:
        linear_solver(often=False)
    functions = [procedure_ir(prepare, outside=(prepare,), quickly=True), procedure_ir(jet, outside=(jet,))]
    return module_ir(functions, [declaration(callee) for callee in called])


_BUILDING = threading.RLock()
"""Locked while a loop is built and linked, so that two threads do not do it twice."""


@lru_cache(maxsize=64)
def compiled_steps(layout: TaylorLayout) -> CompiledProcedure:
    """Return the compiled loop over Taylor steps, for series with a given layout in memory."""
    with _BUILDING:
        loop = taylor_steps.form(layout=layout)
        if not layout.watched:
            return CompiledProcedure(loop, tiers=True)
        return CompiledProcedure(loop, tiers=True, elsewhere=event_procedures(), needs=link_events)


def event_procedures() -> tuple[Procedure, ...]:
    """Return the procedures that find events and crossings of switching surfaces on Taylor steps."""
    return inspect_step.form(), begin_sides.form(), reset_state.form(), cross_surface.form()


def link_events(*, well: bool) -> None:
    """Compile the procedures that find events on Taylor steps, and make them known to modules loaded later.

    If `well`, they are optimized. Else they are compiled quickly, unless this was done before.
    """
    with _BUILDING:
        if well or not _events.cache_info().currsize:
            _events(well)


@cache
def _events(well: bool) -> Module:
    """Compile the procedures that find events on Taylor steps, and register their addresses by name.

    If `well`, they are optimized, else compiled quickly.
    """
    reached = transitive_callees(event_procedures())
    texts = [procedure_ir(each, hidden=each not in event_procedures(), merged=not each.apart) for each in reached]
    module = Module(module_ir(texts), merge=well, quickly=not well)
    for procedure in event_procedures():
        llvm.add_symbol(procedure.name, module.address(procedure.name))
    return module
