"""Dense output in machine code: the polynomials of steps, and one call for many times.

    void polynomial(ptr given, i64 columns, ptr own, ptr beside, ptr work, ptr out)

writes the polynomials of a block of `columns` steps to `out`, in the layout of `POLYNOMIAL`. `own` are the steps of
the block, `beside` the neighbouring steps, and `work` is working memory. `given` are addresses and numbers that
depend on the kind of step. One function evaluates all kinds of polynomials: it calls `polynomial` by its address.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.dense.block import POLYNOMIAL, StepPolynomial, block_size
from lagrange.algorithm.dense.evaluate import outputs, polynomials
from lagrange.algorithm.dense.polynomials import series_polynomial
from lagrange.algorithm.linear.gauss_jordan import invert_columns
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.machine.backend import BlockPolynomial, FloatArray, Places, SingularMassMatrix
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.llvm.address import address, workspace
from lagrange.machine.llvm.called import compiled
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.operations import argument_type, declarations
from lagrange.machine.llvm.procedures import ATTRIBUTES, METADATA, function, module
from lagrange.procedure.form import Procedure


@lru_cache(maxsize=64)
def compiled_polynomial(procedure: Procedure) -> Module:
    """Return the compiled module of a procedure that writes polynomials.

    The module has the function `polynomial`, which calls the procedure.
    """
    context_size = len(procedure.parameters) - len(POLYNOMIAL.parameters) + 1
    e = Emitter()
    kinds = [argument_type(parameter.type) for parameter in procedure.parameters]
    context = [f"{kind} {e.get('%given', index, kind)}" for index, kind in enumerate(kinds[:context_size])]
    handed = ", ".join([*context, "i64 %columns", *(f"ptr %{name}" for name in ("own", "beside", "work", "out"))])
    e.do(f"call void @{procedure.name}({handed})")
    e.do("ret void")
    head = "define void @polynomial(ptr %given, i64 %columns, ptr %own, ptr %beside, ptr %work, ptr %out) #1"
    return _module(procedure, e.function(head))


@cache
def inversion() -> Module:
    """Return the module that inverts a matrix for each of many states, compiled once per process."""
    return Module(module([invert_columns.form()]), merge=True)


def _module(procedure: Procedure, entry: str) -> Module:
    functions = [function(each, hidden=True) for each in (*procedure.callees, procedure)]
    return Module("\n".join([declarations(), *functions, entry, METADATA, ATTRIBUTES]), merge=True)


@dataclass(frozen=True, eq=False)
class LlvmDense:
    """The dense output in machine code (implements `DensePath`) for states with `dimension` entries.

    `degree` is that of the polynomials. `polynomial()` returns the callback that writes the polynomials of a block of
    steps. The call raises SingularMassMatrix if a constant mass matrix is singular.
    """

    dimension: int
    degree: int
    polynomial: Callable[[], BlockPolynomial]

    def coefficients(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the coefficients (degree + 1, 2n, k) of the polynomials on the k steps with the indices `steps`."""
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
        """Write the states of a run at `requested_times` (K,) to `out` (2n, K)."""
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
        """Run a compiled procedure on the steps of a run with accepted `times` (S+1,) and `states` (S+1, 2n).

        `polynomial` is the callback that writes the polynomials of steps. `arguments` are the other arguments of the
        procedure by name; it writes its results to them. The procedure serves all kinds of steps, and is compiled
        once per process.
        """
        n = self.dimension
        values = {
            "polynomial": polynomial.function,
            "given": polynomial.context,
            "dimension": n,
            "degree": self.degree,
            "columns": polynomial.columns,
            "both": int(polynomial.both),
            "steps": len(times) - 1,
            "times": np.ascontiguousarray(times),
            "states": np.ascontiguousarray(states),
            "own": np.zeros(block_size(n, polynomial.columns) + WIDEST_VECTOR),
            "beside": np.zeros(block_size(n, polynomial.columns) + WIDEST_VECTOR),
            "work": workspace(polynomial.work),
            **arguments,
        }
        run = compiled(procedure)
        run(*[values[name] for name in run.places])


def of_steps(
    kind: StepPolynomial, kernel: LlvmKernel, parameters: FloatArray, jacobian: LlvmKernel | None
) -> BlockPolynomial:
    """Return the callback that writes the polynomials of steps, with the addresses of the kernels that it calls.

    `kind` says how the polynomial follows from the ends of a step. `kernel` is the right-hand side and `jacobian` its
    derivative, None if the polynomial does not need it.
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


def of_series(jet: int, numbers: tuple[FloatArray, FloatArray], layout: TaylorLayout, order: int) -> BlockPolynomial:
    """Return the callback that writes the polynomials of Taylor steps of an order.

    `jet` is the address of the function that computes Taylor coefficients. `numbers` are the two arrays of constants
    that this function reads; the first begins with the parameters. `layout` is that of the series in memory.
    """
    code, padded = compiled_polynomial(series_polynomial.form()), layout.padded
    words = [jet, *map(address, numbers), order, layout.width, padded, layout.dimension]
    context, work = np.array(words, dtype=np.int64), 2 * padded + layout.size(order)
    return BlockPolynomial(code.address("polynomial"), context, 1, work, both=False, kept=(code, numbers))
