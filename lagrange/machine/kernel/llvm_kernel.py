"""Kernels in machine code: a program is compiled by LLVM and called through ctypes, for one state or for many states.

The kernel for many states is compiled at its first call. Parameters are one array: the k stated values, followed by all
values that depend only on them. `prepare` computes these values once for each set of parameters.

    i32 NAME_prepare(ptr parameters)                       writes the values after the parameters
    i32 NAME(double t, ptr y, ptr parameters, ptr out)     1 if a matrix is singular, else 0
    {double, ..., i32} NAME_registers(double t, double y0, ..., ptr parameters)
    i64 NAME_columns(i64 count, ptr t, ptr INPUT ..., ptr parameters, ptr out)

Kernels of small models have the third function, for steps, which pass a state from one call to the next. A state passed
through memory costs some ten cycles each way, as long as the call itself, because a block of coordinates and velocities
waits for the slowest of its entries. A right-hand side returns only the accelerations, `Program.returned`.

The last function takes C-ordered arrays with one column for each of `count` states, a multiple of the lanes: t[count],
each input of the program as [size][count], out[size][count]. It returns -1, or the first column of the block of lanes
that contains a singular matrix.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise
from operator import itemgetter
from typing import Any

import numpy as np

from lagrange.algorithm.constants import whole_blocks
from lagrange.algorithm.kernel.body import PreparedLayout, Style
from lagrange.algorithm.kernel.kernels import cleared_outputs, kernel, kernel_by_value, kernel_through_values, prepare
from lagrange.algorithm.linear.symmetric import solve_columns
from lagrange.machine.backend import FloatArray, QuickCalls, Shared, SingularMassMatrix, UnpickledKernel
from lagrange.machine.kernel.llvm_arrays import quick_calls
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import Module, calling_solver, linear_solver
from lagrange.machine.llvm.operations import splat
from lagrange.machine.llvm.procedures import Printer, declaration, function, joined
from lagrange.machine.llvm.processor import lanes
from lagrange.machine.llvm.vectors import number_of_angles
from lagrange.procedure.form import FLAG, Kind, Leave, Procedure
from lagrange.procedure.lane_values import UNIFORM, VARYING
from lagrange.procedure.lanes import MemberProcedures
from lagrange.program.elimination import LARGEST_IN_LINE
from lagrange.program.program import SYSTEMS, Program

STORED_TOGETHER = 4
"""Number of doubles in one load or store of kernels and steps. Vectors of a step are padded to a multiple of it."""

MOST_IN_REGISTERS = 8
"""Largest length of a state that kernels take in registers. The results are returned in registers, too."""

SCALAR = Style(largest=LARGEST_IN_LINE, substituted=1_000_000, systems=32, entries=32, side_by_side=True, early=False)
"""Form of the code for linear systems in kernels for one state. Written-out solutions have at most 32 entries in total,
since all are in use at their common test of pivots. Systems in memory are solved for up to 32 right-hand sides at once:
four vectors of eight reals for each row.
"""

LANES = Style(substituted=4_000, systems=1, pivoting=False)
"""Form of the code for linear systems in kernels with one state in each vector lane. Matrices of up to 20 unknowns are
eliminated in lanes. If the matrix of a state needs pivoting, this state is evaluated again by the kernel for one state.
"""


def fit(dimension: int) -> bool:
    """Return True if states with `dimension` entries are small enough to be passed in registers."""
    return dimension <= MOST_IN_REGISTERS


def in_registers(program: Program) -> bool:
    """Return True if a program has a kernel that takes its state in registers.

    This is the case if the steps of methods evaluate the program, and its state is small.
    """
    return bool(program.returned) and fit(program.states)


@dataclass(frozen=True, eq=False)
class KernelCode:
    """The procedures that evaluate a program, for one state and for many states, and their LLVM IR."""

    program: Program

    @cached_property
    def prepared(self) -> PreparedLayout:
        """The layout of the array `prepared`: the parameters, then all values that depend only on them."""
        return PreparedLayout.of([self.program], LARGEST_IN_LINE)

    @cached_property
    def prepare(self) -> Procedure:
        """The procedure that computes all values that depend only on parameters, once for each set of parameters."""
        about = f"Prepare {self.program.name}."
        return prepare(self.prepared, about, name=f"{self.program.name}_prepare", in_place=True, style=SCALAR)

    @cached_property
    def scalar(self) -> tuple[Procedure, ...]:
        """The procedures that evaluate the program at one state.

        If the program has a kernel that takes the state in registers, this kernel comes first.
        """
        program, prepared = self.program, self.prepared
        if not in_registers(program):
            return (kernel(program, prepared, program.name, f"Evaluate {program.name}.", style=SCALAR),)
        outputs = [
            ref for block in program.results if block.name in program.returned for ref in program.part(block.name)
        ]
        by_value = kernel_by_value(program, prepared, outputs, style=SCALAR, suffix="registers")
        return by_value, kernel_through_values(program, prepared, by_value)

    @property
    def called(self) -> tuple[Procedure, ...]:
        """The procedures that the kernels call but whose code is in other modules, such as solvers."""
        every = (callee for caller in (self.prepare, *self.scalar) for callee in caller.callees)
        return tuple(dict.fromkeys(procedure for procedure in every if procedure not in self.scalar))

    def scalar_module(self) -> str:
        """Return the IR of `prepare`, and of the kernels for one state."""
        made = [function(procedure, outside=self.scalar) for procedure in self.scalar]
        first = function(self.prepare, outside=(self.prepare,), quickly=True)
        return joined([first, *made], [declaration(procedure) for procedure in self.called])

    def column_module(self, lanes: int) -> str:
        """Return the IR of the kernel for many states, with `lanes` states in a vector."""
        quickly, by_value = lanes > 1, None
        if lanes > 1:
            # The vector code evaluates `lanes` states at once: arguments and results have one entry for each state.
            outputs = [self.program.outputs[k] for k in self._places]
            single = kernel_by_value(self.program, self.prepared, outputs, style=LANES)
            signature = tuple(
                VARYING if isinstance(parameter.type, Kind) else UNIFORM for parameter in single.parameters
            )
            by_value = MemberProcedures(lanes).of(single, signature)
        alone = [function(procedure, hidden=True, outside=self.scalar, quickly=quickly) for procedure in self.scalar]
        called = [] if by_value is None else [function(procedure, hidden=True) for procedure in by_value.callees]
        made = [*alone, *called, self._alone(), self._columns(lanes, by_value)]
        return joined(made, [declaration(procedure) for procedure in self.called])

    @cached_property
    def _places(self) -> list[int]:
        """Indices of the outputs that the kernel for many states computes: those that are not always zero."""
        cleared = cleared_outputs(self.program)
        return [k for k in range(len(self.program.outputs)) if k not in cleared]

    @property
    def _bases(self) -> list[str]:
        """The names, in IR, of the arrays that the kernel for many states reads: the times, then each input."""
        return ["%t", *(f"%{block.name}" for block in self.program.inputs)]

    def _alone(self) -> str:
        """Return the IR of a function that evaluates one state of a batch, for states that the vector code gives up.

        The state is one column of the arrays of all states; the function takes the index of the column.
        """
        e, name, program = Emitter(), self.program.name, self.program
        state, out = e.reserve("double", program.states), e.reserve("double", len(program.outputs))
        first = 0
        for block in program.inputs:
            with e.loop(0, block.size) as k:
                e.put(
                    e.get(f"%{block.name}", _row(e, k, "%column")),
                    state,
                    e.value(f"add nsw i64 {k}, {first}") if first else k,
                )
            first += block.size
        t = e.get("%t", "%column")
        status = e.value(f"call i32 @{name}(double {t}, ptr {state}, ptr %p, ptr {out})")
        with e.loop(0, len(program.outputs)) as k:
            e.put(e.get(out, k), "%out", _row(e, k, "%column"))
        e.do(f"ret i32 {status}")
        arguments = ", ".join(f"ptr noalias {base}" for base in (*self._bases, "%p", "%out"))
        return e.function(f"define internal i32 @{name}_alone(i64 %count, i64 %column, {arguments}) noinline #1")

    def _columns(self, lanes: int, by_value: Procedure | None) -> str:
        e, name = Emitter(), self.program.name
        arguments = ", ".join(f"ptr {base}" for base in (*self._bases, "%p", "%out"))
        if by_value is not None and len(self._places) < len(self.program.outputs):
            with e.loop(0, e.value(f"mul nsw i64 %count, {len(self.program.outputs)}")) as k:
                e.put("0.0", "%out", k)
        with e.loop(0, "%count", lanes) as i:
            if by_value is None:
                _leave_if(e, e.value(f"call i32 @{name}_alone(i64 %count, i64 {i}, {arguments})"), i)
            else:
                self._block(e, i, lanes, arguments, by_value)
        e.do("ret i64 -1")
        return e.function(f"define i64 @{name}_columns(i64 %count, {arguments.replace('ptr', 'ptr noalias')}) #0")

    def _block(self, e: Emitter, i: str, lanes: int, arguments: str, by_value: Procedure) -> None:
        """Emit the evaluation of `lanes` states as vectors. The operand `i` is the index of the first of them.

        `arguments` is the text of the kernel's arguments in IR. `by_value` is the procedure that evaluates the states
        in lanes. States whose matrix needs pivoting are evaluated again one by one.
        """
        program = self.program
        kind = f"<{lanes} x double>"
        rows = [(f"%{block.name}", row) for block in program.inputs for row in range(block.size)]
        times = e.load(e.address("%t", i), kind)
        state = [e.load(e.address(base, _row(e, row, i)), kind) for base, row in rows]
        *results, bad = _spliced(e, by_value, lanes, [splat(e, "true", FLAG, lanes), times, *state, "%p"])
        for row, value in zip(self._places, results, strict=True):
            e.store(value, e.address("%out", _row(e, row, i)), kind)
        if not bad.startswith("%"):
            return
        bits = e.value(f"bitcast <{lanes} x i1> {bad} to i{lanes}")
        with e.when(e.value(f"icmp ne i{lanes} {bits}, 0")), e.loop(0, lanes) as lane:
            picked = e.value(f"extractelement <{lanes} x i1> {bad}, i64 {lane}")
            with e.when(picked):
                column = e.value(f"add nsw i64 {i}, {lane}")
                _leave_if(e, e.value(f"call i32 @{program.name}_alone(i64 %count, i64 {column}, {arguments})"), i)


def _spliced(e: Emitter, procedure: Procedure, lanes: int, arguments: Sequence[str]) -> list[str]:
    """Print the statements of `procedure` into the function that `e` collects; return the operands of its results.

    The procedure computes `lanes` states at once, and each result is a vector. `arguments` are the operands of its
    parameters. The procedure must have a single return, at its end.
    """
    printer = Printer(procedure, e=e, angles=number_of_angles(procedure.body))
    for parameter, argument in zip(procedure.parameters, arguments, strict=True):
        printer.define(parameter.ref, argument, parameter.type)
    *statements, end = procedure.body
    assert isinstance(end, Leave)
    printer.block(tuple(statements))
    pairs = zip(end.values, procedure.results, strict=True)
    return [
        splat(e, printer.values[ref], kind, lanes) if isinstance(kind, Kind) else printer.values[ref]
        for ref, kind in pairs
    ]


def _leave_if(e: Emitter, status: str, column: str) -> None:
    """Emit an early return from the kernel for many states, taken if `status` reports a singular matrix.

    The kernel then returns `column`. `status` and `column` are operands.
    """
    with e.when(e.value(f"icmp ne i32 {status}, 0")):
        e.do(f"ret i64 {column}")
        e.label(e.fresh("never"))


def _row(e: Emitter, row: int | str, column: str) -> str:
    """Emit the index of the entry (row, column) in a C-ordered array with one column for each state; return it.

    `column` and the result are operands, and `row` is an operand or a number. The number of columns is %count.
    """
    return e.value(f"add nsw i64 {e.value(f'mul nsw i64 %count, {row}')}, {column}") if row else column


SHORT_PROGRAM = 4096
"""Largest number of instructions of a program whose kernel keeps Python's interpreter lock during a call for one state.
For a short program, to release the lock would take as long as the call.
"""

_PREPARE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
_SCALAR = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


class LlvmKernel(Shared):
    """A program in machine code (implements `Kernel`). Calls release the interpreter lock; threads may share it."""

    def __init__(self, program: Program) -> None:
        self.program = program
        # The code of a small system calls the solver of dense systems only if a pivot is too small.
        if any(instruction.op in SYSTEMS for instruction in program.instructions):
            linear_solver(often=not all(plan.written_out for plan in program.eliminations.values()))
        self._code = KernelCode(program)
        if solve_columns.form() in self._code.called:
            calling_solver(solve_columns.form())
        self._module = Module(self._code.scalar_module())
        self.address = self._module.address(program.name)
        """Address of ``int32_t f(double t, const double *y, const double *prepared, double *out)``.

        `prepared` is the array that `prepare` returns. The return value is 1 if the mass matrix is singular, else 0.
        """
        self._prepare = _PREPARE(self._module.address(f"{program.name}_prepare"))
        self._scalar = _SCALAR(self.address)
        self._prepared: tuple[bytes, FloatArray] | None = None
        self._quick: tuple[FloatArray, QuickCalls | None] | None = None
        self.prepared_size = self._code.prepared.size + 1
        """Length of the array that `prepare` returns: the parameters, and all values that depend only on them."""
        ends = [0, *accumulate(block.size for block in program.inputs)]
        rows = [slice(*pair) for pair in pairwise(ends)]
        self._split: Callable[[FloatArray], Sequence[FloatArray]] = (
            itemgetter(*rows) if len(rows) > 1 else lambda y: (y,)
        )
        self._shape, self._count = program.shape, len(program.outputs)

    def __reduce__(self) -> tuple[Any, ...]:
        return UnpickledKernel, (LlvmKernel, self.program)

    @property
    def ir(self) -> str:
        """The LLVM IR of `prepare` and of the kernel for one state."""
        return self._module.ir

    @property
    def prepare_address(self) -> int:
        """Address of ``int32_t f(double *prepared)``, which computes all values that depend only on parameters.

        The array begins with the parameters, and the function writes these values after them. It returns 1 if a matrix
        that depends only on parameters is singular, else 0.
        """
        return self._module.address(f"{self.program.name}_prepare")

    @property
    def law_address(self) -> int:
        """Address of the kernel that compiled steps of methods call.

        If the program has a kernel that takes the state in registers, it is the address of this kernel, else `address`.
        """
        name = self.program.name
        return self._module.address(f"{name}_registers") if in_registers(self.program) else self.address

    @property
    def columns_address(self) -> int:
        """Address of the kernel for many states.

        Its arguments are the number of states, the array of their times, an array for each input, the array
        `prepared` (parameters and values that depend only on them), and the array that receives the results.
        """
        module, _ = self._column_kernel
        return module.address(f"{self.program.name}_columns")

    def prepare(self, parameters: FloatArray) -> FloatArray:
        """Return an array of the parameters, followed by all values that depend only on them.

        Raises SingularMassMatrix if a matrix that depends only on parameters is singular.
        """
        key = parameters.tobytes()
        known = self._prepared
        if known is not None and known[0] == key:
            return known[1]
        prepared = np.zeros(self.prepared_size)
        prepared[: len(parameters)] = parameters
        if self._prepare(address(prepared)):
            raise SingularMassMatrix
        self._prepared = (key, prepared)
        return prepared

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the program's result at time t, for a state y (2n,) or many states (2n, batch)."""
        if y.ndim > 1:
            return self.columns(t, self._split(y), parameters)
        prepared = self.prepare(parameters)
        y = np.ascontiguousarray(y, dtype=float)
        out = np.empty(self.program.shape)
        if self._scalar(float(t), address(y), address(prepared), address(out)):
            raise SingularMassMatrix
        return out

    def quick(self, parameters: FloatArray) -> QuickCalls | None:
        """Return fast functions that evaluate one state and check their arguments, or None for a long program.

        They keep Python's lock, so that other threads wait during a call. That is acceptable for some microseconds.
        """
        if len(self.program.instructions) > SHORT_PROGRAM:
            return None
        prepared, known = self.prepare(parameters), self._quick
        if known is None or known[0] is not prepared:
            made = quick_calls((self._module, self.address), prepared, self.program.states, self.program.shape)
            known = self._quick = prepared, made
        return known[1]

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the results for many states, from an array (size, batch) for each of the program's `inputs`."""
        prepared = self.prepare(parameters)
        batch = inputs[0].shape[1]
        if batch == 0:
            return np.empty((*self._shape, 0))
        width = self._lanes
        count = whole_blocks(batch, width)
        arrays = [_filled(array, count) for array in inputs]
        times = _filled(np.broadcast_to(t, (1, batch)), count) if self._reads_time else arrays[0]
        out = np.empty((self._count, count))
        _module, run = self._column_kernel
        addresses = [address(array) for array in (times, *arrays, prepared, out)]
        first = run(count, *addresses)
        if first >= 0:
            states = np.concatenate(arrays)
            raise SingularMassMatrix(
                self._singular_column(range(first, min(first + width, batch)), times, states, prepared)
            )
        return out[:, :batch].reshape(*self._shape, batch)

    def _singular_column(self, block: range, times: FloatArray, states: FloatArray, prepared: FloatArray) -> int:
        """Return the index of the first state of a block at which the mass matrix is singular.

        Each state of the block is evaluated alone. `block` has the indices of its states in the batch. `times`
        (1, batch) and `states` (2n, batch) are those of the batch. `prepared` is the array that `prepare` returns.
        """
        out = np.empty(self.program.shape)
        for column in block:
            y = np.ascontiguousarray(states[:, column])
            if self._scalar(times[0, column], address(y), address(prepared), address(out)):
                return column
        return block.start

    @cached_property
    def _reads_time(self) -> bool:
        return any(instruction.op == "time" for instruction in self.program.instructions)

    @cached_property
    def _lanes(self) -> int:
        # The working memory of a large linear system in eight lanes does not fit on the stack.
        largest = max((i.order for i in self.program.instructions if i.op == "factor"), default=0)
        return lanes() if largest <= 64 else 1

    @cached_property
    def _column_kernel(self) -> tuple[Module, ctypes._CFunctionType]:
        """The compiled module of the kernel for many states, and the function in it that ctypes calls.

        They are one value, so that a thread never gets the function of a module that another thread has compiled.
        """
        module = Module(self._code.column_module(self._lanes))
        pointers = [ctypes.c_void_p] * (3 + len(self.program.inputs))
        columns = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, *pointers)
        return module, columns(module.address(f"{self.program.name}_columns"))


@lru_cache(maxsize=64)
def cached_kernel(program: Program) -> LlvmKernel:
    """Return the kernel of a program in machine code, from a cache if the program was compiled before."""
    return LlvmKernel(program)


def _filled(array: FloatArray, count: int) -> FloatArray:
    """Return a copy of `array` as contiguous doubles, padded to `count` columns by copies of its last column."""
    if array.shape[1] != count:
        array = np.concatenate([array, np.repeat(array[:, -1:], count - array.shape[1], axis=1)], axis=1)
    return np.ascontiguousarray(array, dtype=float)
