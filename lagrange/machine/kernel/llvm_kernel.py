"""A program in machine code, called through ctypes. The kernel for many states is compiled at its first call."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise
from operator import itemgetter
from typing import Any

import numpy as np

from lagrange.algorithm.blocks import whole_blocks
from lagrange.algorithm.linear.ldl import solve_columns
from lagrange.machine.backend import FloatArray, QuickCalls, SingularMassMatrix
from lagrange.machine.copies import Shared, UnpickledKernel
from lagrange.machine.kernel.llvm_arrays import quick_calls
from lagrange.machine.kernel.llvm_module import KernelCode, in_registers, solves
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.engine import Module, calling_solver, linear_solver
from lagrange.machine.llvm.processor import lanes
from lagrange.program.program import Program

SHORT_PROGRAM = 4096
"""Largest number of instructions of a program that keeps the interpreter lock for one state: releasing the lock takes
as long as the call.
"""

_PREPARE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
_SCALAR = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


class LlvmKernel(Shared):
    """A kernel in machine code. Calls release the interpreter lock; threads may share a kernel."""

    def __init__(self, program: Program) -> None:
        self.program = program
        if solves(program):
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
        """Number of doubles in the array `prepared`: parameters, and all values that depend on them alone."""
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
        """The LLVM IR of the kernel for one state."""
        return self._module.ir

    @property
    def prepare_address(self) -> int:
        """Address of ``int32_t f(double *prepared)``, which computes all values that depend on parameters alone.

        They are written after the parameters, with which the array `prepared` begins.
        """
        return self._module.address(f"{self.program.name}_prepare")

    @property
    def law_address(self) -> int:
        """Address of the kernel that the steps of methods call.

        For a small state it is the kernel that takes the state in registers, else `address`.
        """
        name = self.program.name
        return self._module.address(f"{name}_registers") if in_registers(self.program) else self.address

    @property
    def columns_address(self) -> int:
        """Address of the kernel for many states.

        Its arguments are the number of states, their times, each input, the array `prepared`, and the array for the
        results.
        """
        module, _ = self._column_kernel
        return module.address(f"{self.program.name}_columns")

    def prepare(self, parameters: FloatArray) -> FloatArray:
        """Return an array of the parameters, followed by all values that depend on them alone.

        Raises SingularMassMatrix if a matrix that depends on parameters alone is singular.
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
        """Return calls for one state that check their own arguments in machine code, or None for long programs.

        These calls do not release the interpreter lock, which is acceptable for some microseconds.
        """
        if len(self.program.instructions) > SHORT_PROGRAM:
            return None
        prepared, known = self.prepare(parameters), self._quick
        if known is None or known[0] is not prepared:
            made = quick_calls((self._module, self.address), prepared, self.program.states, self.program.shape)
            known = self._quick = prepared, made
        return known[1]

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the program's result for many states, which are columns.

        `inputs` has an array (size, batch) for each input of the program, such as q and v. States are computed by
        blocks of a vector's width. The last block is filled up with copies of the last state.
        """
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
        """Return the index of the first state of a block with a singular mass matrix. Each state is evaluated alone."""
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
        # The stack has no space for the working memory of a large linear system in eight lanes.
        largest = max((i.order for i in self.program.instructions if i.op == "factor"), default=0)
        return lanes() if largest <= 64 else 1

    @cached_property
    def _column_kernel(self) -> tuple[Module, ctypes._CFunctionType]:
        """The compiled module of the kernel for many states, and the function in it that ctypes calls.

        They are one value, so that threads that compile at the same time each use a module and a function that belong
        together.
        """
        module = Module(self._code.column_module(self._lanes))
        pointers = [ctypes.c_void_p] * (3 + len(self.program.inputs))
        columns = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, *pointers)
        return module, columns(module.address(f"{self.program.name}_columns"))


@lru_cache(maxsize=64)
def cached_kernel(program: Program) -> LlvmKernel:
    """Return the kernel of a program in machine code, compiled once for all runs."""
    return LlvmKernel(program)


def _filled(array: FloatArray, count: int) -> FloatArray:
    """Return an array as contiguous doubles with `count` columns. The last column is repeated as often as needed."""
    if array.shape[1] != count:
        array = np.concatenate([array, np.repeat(array[:, -1:], count - array.shape[1], axis=1)], axis=1)
    return np.ascontiguousarray(array, dtype=float)
