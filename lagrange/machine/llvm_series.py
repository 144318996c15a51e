"""Dense output and Taylor series in machine code: modules, their addresses, and the loop over Taylor steps.

    void polynomial(ptr given, i64 columns, ptr step_data, ptr neighbours, ptr work, ptr out)

writes the polynomials of a block of `columns` steps to `out`, in the layout of `POLYNOMIAL`. `step_data` has the steps
of the block, `neighbours` a neighbour of each step, and `work` is work memory. `given` are addresses and numbers that
depend on the kind of step. One function evaluates all kinds of polynomials: it calls `polynomial` by its address.

The numbers of a series are one array: the parameters, then constants, results of order 0 that need no state, and
inverses of constant matrices. Constants joined to vectors follow, in the order in which the code reads them. The jet is
the function that computes the series. The loop over steps calls it by its address, so all series of a layout share the
loop. The procedures that find events are the same for all layouts, and are compiled once per process.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, partial
from typing import Any

import numpy as np

from lagrange.algorithm.constants import WIDEST_VECTOR, whole_blocks
from lagrange.algorithm.dense.block import POLYNOMIAL, StepPolynomial, block_size, outputs, polynomials
from lagrange.algorithm.dense.polynomials import series_polynomial
from lagrange.algorithm.linear.gauss_jordan import invert_columns
from lagrange.algorithm.linear.symmetric import invert
from lagrange.algorithm.series.jets import NAME as JET_NAME
from lagrange.algorithm.series.jets import ByOrderJet, WrittenJet, by_order_layout
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.order_by_cost import cheapest_order, is_large
from lagrange.algorithm.series.packing import Packing, pack
from lagrange.algorithm.series.rules import Row
from lagrange.algorithm.taylor.event_zeros import inspect_step
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.algorithm.taylor.resets import begin_sides, cross_surface, reset_state
from lagrange.errors import RunError
from lagrange.machine.backend import BlockPolynomial, FloatArray, Places, Shared, SingularMassMatrix
from lagrange.machine.kernel.interpreted import constants
from lagrange.machine.kernel.llvm_kernel import LlvmKernel, cached_kernel
from lagrange.machine.llvm.address import address, workspace
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import (
    CompiledProcedure,
    Module,
    TieredModule,
    calling_solver,
    compiled,
    linear_solver,
    provide,
)
from lagrange.machine.llvm.operations import argument_type, declarations
from lagrange.machine.llvm.procedures import ATTRIBUTES, METADATA, declaration, function, joined, module
from lagrange.machine.llvm.processor import lanes
from lagrange.procedure.form import Procedure, transitive_callees
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram


@lru_cache(maxsize=64)
def compiled_polynomial(procedure: Procedure) -> Module:
    """Return the machine code of a procedure that writes the dense output polynomials of steps.

    The code has the function `polynomial`, of the type `POLYNOMIAL`, which calls the procedure.
    """
    context_size = len(procedure.parameters) - len(POLYNOMIAL.parameters) + 1
    e = Emitter()
    kinds = [argument_type(parameter.type) for parameter in procedure.parameters]
    context = [f"{kind} {e.get('%given', index, kind)}" for index, kind in enumerate(kinds[:context_size])]
    passed = ", ".join([*context, "i64 %columns", "ptr %step_data, ptr %neighbours, ptr %work, ptr %out"])
    e.do(f"call void @{procedure.name}({passed})")
    e.do("ret void")
    head = "define void @polynomial(ptr %given, i64 %columns, ptr %step_data, ptr %neighbours, ptr %work, ptr %out) #1"
    functions = [function(each, hidden=True) for each in (*procedure.callees, procedure)]
    return Module("\n".join([declarations(), *functions, e.function(head), METADATA, ATTRIBUTES]), merge=True)


@cache
def inversion() -> Module:
    """Return the machine code of `invert_columns`, which inverts many matrices, compiled once per process."""
    return Module(module([invert_columns.form()]), merge=True)


@dataclass(frozen=True, eq=False)
class LlvmDense:
    """The dense output in machine code (implements `DensePath`) for states with `dimension` entries.

    `degree` is the degree of the polynomials. `polynomial()` returns the callback that writes the polynomials of a
    block of steps. The call raises SingularMassMatrix if a constant mass matrix is singular.
    """

    dimension: int
    degree: int
    polynomial: Callable[[], BlockPolynomial]

    def coefficients(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the polynomial coefficients (degree + 1, 2n, k) of k steps of a run, those with indices `steps`."""
        n, count = self.dimension, len(steps)
        if (written := self._written()) is None:
            return np.full((self.degree + 1, n, count), np.nan)
        columns = written.columns
        blocks = -(-count // columns)
        starts = np.concatenate([steps, np.repeat(steps[-1:], blocks * columns - count)]).astype(np.int64)
        out = np.empty(blocks * (self.degree + 1) * n * columns + WIDEST_VECTOR)
        self._run(polynomials.form(), written, times, states, starts=starts, blocks=blocks, out=out)
        c = out[:-WIDEST_VECTOR].reshape(blocks, self.degree + 1, n, columns)
        return np.moveaxis(c, 0, 2).reshape(self.degree + 1, n, -1)[:, :, :count]

    def at(self, times: FloatArray, states: FloatArray, requested_times: FloatArray, out: FloatArray) -> None:
        """Write the states at `requested_times` (K,) of a run with accepted `times` and `states` to `out` (2n, K)."""
        if (written := self._written()) is None:
            out[:] = np.nan
            return
        c = np.empty((self.degree + 1) * self.dimension * written.columns + WIDEST_VECTOR)
        sign = 1.0 if times[-1] >= times[0] else -1.0
        arguments = {"output_times": np.ascontiguousarray(requested_times), "count": len(requested_times), "sign": sign}
        self._run(
            outputs.form(), written, times, states, **arguments, c=c, out=out, stride=out.strides[0] // out.itemsize
        )

    def _written(self) -> BlockPolynomial | None:
        """Return the callback that writes polynomials, or None if a constant mass matrix is singular."""
        try:
            return self.polynomial()
        except SingularMassMatrix:
            return None

    def _run(
        self, procedure: Procedure, polynomial: BlockPolynomial, times: FloatArray, states: FloatArray, **arguments: Any
    ) -> None:
        """Run `procedure` on the steps of a run with accepted `times` (S+1,) and `states` (S+1, 2n).

        The procedure evaluates the dense output. It calls `polynomial`, the callback that writes the polynomials of
        steps. `arguments` are its other arguments by name; it writes its results to some of them. It serves all kinds
        of steps, and is compiled once per process.
        """
        n, columns = self.dimension, polynomial.columns
        values = {
            "polynomial": polynomial.function,
            "given": polynomial.context,
            "dimension": n,
            "degree": self.degree,
            "columns": columns,
            "both": int(polynomial.both),
            "steps": len(times) - 1,
            "times": np.ascontiguousarray(times),
            "states": np.ascontiguousarray(states),
            **{name: np.zeros(block_size(n, columns) + WIDEST_VECTOR) for name in ("step_data", "neighbours")},
            "work": workspace(polynomial.work),
            **arguments,
        }
        run = compiled(procedure)
        run(*[values[name] for name in run.places])


def of_steps(
    kind: StepPolynomial, kernel: LlvmKernel, parameters: FloatArray, jacobian: LlvmKernel | None
) -> BlockPolynomial:
    """Return the callback that writes the dense output polynomials of steps, with the data that it reads.

    `kind` states how the polynomial follows from the two ends of a step. `kernel` is the right-hand side and `jacobian`
    its derivative, None if the polynomial does not need it. The callback calls both with the given `parameters`.
    """
    code, n = compiled_polynomial(kind.procedure), kernel.program.states
    references: list[Any] = [code, kind.table]
    addresses = []
    for called in (kernel, jacobian):
        prepared = None if called is None else called.prepare(parameters)
        references.append(prepared)
        addresses += [0, 0] if called is None or prepared is None else [called.columns_address, address(prepared)]
    addresses.append(inversion().address(invert_columns.form().name) if kind.derivative else 0)
    context = np.array([*addresses, address(kind.table), kind.stages, kind.degree, n], dtype=np.int64)
    work = kind.size(n, WIDEST_VECTOR)
    return BlockPolynomial(code.address("polynomial"), context, WIDEST_VECTOR, work, kind.derivative, tuple(references))


_PREPARE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
_SERIES = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_double, *([ctypes.c_void_p] * 4), ctypes.c_int64)


class LlvmSeries(Shared):
    """The Taylor series of a motion in machine code (implements `Series`).

    The code of a small series is unrolled, for each order separately. That of a large one has loops for all orders.
    """

    def __init__(self, program: SeriesProgram) -> None:
        self.program = program
        self._packing = pack(program, lanes())
        widest = self._packing if lanes() == WIDEST_VECTOR else pack(program, WIDEST_VECTOR)
        self._compiled: dict[int, CompiledJet] = {}
        self._is_large = cache(partial(is_large, self._packing))
        self._order = cache(partial(cheapest_order, widest))

    def __reduce__(self) -> tuple[Any, ...]:
        return LlvmSeries, (self.program,)

    def form(self, order: int) -> str:
        """Return "written out" if the code for an `order` has no loops, else "in loops"."""
        return "in loops" if self._is_large(order) else "written out"

    def order(self, tolerance: float) -> int:
        """Return the order of the series with which a run to a relative tolerance costs least."""
        return self._order(tolerance)

    def code(self, order: int) -> CompiledJet:
        """Return the machine code that computes the series up to an `order`, compiled at the first request."""
        key = 0 if self._is_large(order) else order
        if key not in self._compiled:
            with refused():
                self._compiled[key] = CompiledJet(self._packing, key)
        return self._compiled[key]

    @cached_property
    def values(self) -> LlvmKernel:
        """The kernel that evaluates the event functions and switching surfaces at a state."""
        with refused():
            return cached_kernel(self.program.values)

    def dense(self, order: int, parameters: FloatArray) -> LlvmDense:
        """Return the dense output of Taylor steps of an `order`: the Taylor polynomial of this order on each step."""
        return LlvmDense(self.program.states, order, partial(self.polynomial, order, parameters))

    def polynomial(self, order: int, parameters: FloatArray) -> BlockPolynomial:
        """Return the callback that writes the Taylor polynomials of steps of an `order`, for one set of parameters."""
        jet, code = self.code(order), compiled_polynomial(series_polynomial.form())
        numbers, layout = jet.numbers(parameters), jet.layout
        words = [jet.address, *map(address, numbers), order, layout.width, layout.padded, layout.dimension]
        context, work = np.array(words, dtype=np.int64), 2 * layout.padded + layout.size(order)
        return BlockPolynomial(code.address("polynomial"), context, 1, work, both=False, kept=(code, numbers))

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return the Taylor coefficients at a state y (2n,). Row k has those of order k, times `scale`**k."""
        return self.code(order).rows(order, t, y, scale, parameters)


@contextmanager
def refused() -> Iterator[None]:
    """Context manager that turns an error of LLVM into a RunError, whose message advises to use target="numpy"."""
    try:
        yield
    except RuntimeError as error:
        raise RunError(f"LLVM could not compile the series: {error}. Use target='numpy'.") from error


class CompiledJet:
    """Machine code that computes a Taylor series up to one `order`, or by loops up to any order if `order` is 0.

    It implements `SeriesCode`. `packing` states how the operations of the series are joined to vector operations.
    """

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
        # Code with loops serves all orders, and is slow without optimization. So it is optimized from the start.
        self.module = TieredModule(ir) if order else Module(ir)
        self._prepare = _PREPARE(self.module.address("prepare_start"))
        self._prepared: tuple[bytes, tuple[FloatArray, FloatArray]] | None = None
        self._joined: tuple[tuple[bytes, LlvmKernel | None], tuple[FloatArray, list[int]]] | None = None

    @property
    def ir(self) -> str:
        """The LLVM IR of the function that computes the series."""
        return self.module.ir

    @property
    def address(self) -> int:
        """Address of the compiled function that computes the series.

        The address changes once, when optimized code replaces the code compiled quickly.
        """
        return self.module.address(JET_NAME)

    function = address

    @property
    def loop(self) -> CompiledProcedure:
        """The compiled loop over Taylor steps, which serves all series with the same layout in memory."""
        with refused():
            loop: CompiledProcedure = compiled_steps(self.layout)
        return loop

    @property
    def is_final(self) -> bool:
        """True if the present code will not be replaced by optimized code."""
        return self.module.is_final

    def count(self, steps: int) -> bool:
        """Count `steps` more steps. Return True if optimized code has now replaced the quickly compiled code."""
        return not self.module.is_final and self.module.count(steps)

    def load(self, program: Program) -> LlvmKernel:
        """Return the kernel of a program, compiled once per process."""
        with refused():
            return cached_kernel(program)

    @property
    def _series(self) -> Any:
        return _SERIES(self.address)

    def numbers(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the numbers that the code reads and that do not change along a run, as two arrays.

        The first has the parameters and all numbers that depend only on them. The second is a single zero that the
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
        """Return one array of all numbers that are constant along a run, and the lengths of its parts, from a cache.

        The parts are the two arrays of `numbers`, then the parameters of `values`, the kernel of the event functions,
        with all values that depend only on them. There is no third part if `values` is None.
        """
        key, known = (parameters.tobytes(), values), self._joined
        if known is None or known[0] != key:
            parts = [*self.numbers(parameters), *([] if values is None else [values.prepare(parameters)])]
            known = self._joined = key, (np.concatenate(parts), list(map(len, parts)))
        return known[1]

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return Taylor coefficients at y (2n,), row k those of order k times `scale`**k. Raises SingularMassMatrix."""
        layout, numbers = self.layout, self.numbers(parameters)
        work = np.zeros(layout.size(order))
        state = np.zeros(2 * layout.padded)
        state[: layout.dimension] = y
        if self._series(t, scale, *map(address, (state, *numbers, work)), order):
            raise SingularMassMatrix
        return layout.coefficients(work, order)


def layout_of(packing: Packing, order: int) -> TaylorLayout:
    """Return the layout in memory of the coefficients of a series, for code of one `order`.

    `order` 0 means code that loops over orders. `packing` states how values that are computed by the same rule are
    joined to vectors.
    """
    program = packing.program
    block = 2 if program.states <= 2 else 4 if program.states <= 4 else 8
    if order:
        return TaylorLayout.of(program, block=block, chains=True)
    width = whole_blocks(Row(packing, whole_blocks(program.states, block)).size, WIDEST_VECTOR)
    return by_order_layout(packing, width, block=block)


def series_ir(jet: Procedure, prepare: Procedure) -> str:
    """Return the LLVM IR of a module with the two procedures of a series, `jet` and `prepare`.

    `jet` computes the Taylor coefficients. `prepare` computes the numbers that depend only on parameters. Both may call
    solvers of linear systems, which are in other modules. These are compiled first.
    """
    called = dict.fromkeys((*prepare.callees, *jet.callees))
    if invert.form() in called:
        calling_solver(invert.form())
    elif called:
        linear_solver(often=False)
    functions = [function(prepare, outside=(prepare,), quickly=True), function(jet, outside=(jet,))]
    return joined(functions, [declaration(callee) for callee in called])


_BUILDING = threading.RLock()
"""Lock of the compilation of the loop over Taylor steps, so that two threads do not compile the same code."""


@lru_cache(maxsize=64)
def compiled_steps(layout: TaylorLayout) -> CompiledProcedure:
    """Return the compiled loop that takes Taylor steps, for all series whose coefficients have this `layout`."""
    with _BUILDING:
        loop = taylor_steps.form(layout=layout)
        if not layout.watched:
            return CompiledProcedure(loop, tiers=True)
        return CompiledProcedure(loop, tiers=True, elsewhere=event_procedures(), needs=link_events)


def event_procedures() -> tuple[Procedure, ...]:
    """Return the procedures by which the loop over Taylor steps finds events and crosses switching surfaces."""
    return inspect_step.form(), begin_sides.form(), reset_state.form(), cross_surface.form()


def link_events(*, well: bool) -> None:
    """Compile the procedures of `event_procedures`, so that modules loaded later can call them.

    With `well` they are optimized. Otherwise they are compiled quickly, but only if no version exists yet.
    """
    with _BUILDING:
        if well or not _events.cache_info().currsize:
            _events(well)


@cache
def _events(well: bool) -> Module:
    """Compile the procedures of `event_procedures`, register their addresses by name, and return their module.

    With `well` they are optimized, otherwise compiled quickly.
    """
    reached = transitive_callees(event_procedures())
    texts = [function(each, hidden=each not in event_procedures(), merged=not each.noinline) for each in reached]
    return provide(event_procedures(), Module(joined(texts), merge=well, quickly=not well))
