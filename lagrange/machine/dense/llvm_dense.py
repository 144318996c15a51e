"""Dense output in machine code: the polynomials of steps, and one call for many times.

    void polynomial(ptr given, i64 columns, ptr own, ptr beside, ptr work, ptr out)

writes the polynomials of a block of steps, see `POLYNOMIAL`; `given` are the addresses and numbers that the kind of
path wants beside. What evaluates is one function for all of them, which takes this by its address.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.machine.backend import BlockPolynomial, FloatArray, Places, SingularMassMatrix
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.llvm.address import address, workspace
from lagrange.machine.llvm.called import compiled
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.operations import declarations
from lagrange.machine.llvm.procedures import ATTRIBUTES, METADATA, argument_type, function
from lagrange.procedure.dense.block import LANES, POLYNOMIAL, StepPolynomial, block_size
from lagrange.procedure.dense.evaluate import outputs, polynomials
from lagrange.procedure.form import Procedure


@lru_cache(maxsize=64)
def compiled_polynomial(procedure: Procedure) -> Module:
    """Return what writes polynomials, compiled with the function `polynomial` that takes what is given by place."""
    own = len(procedure.parameters) - len(POLYNOMIAL.parameters) + 1
    e = Emitter()
    kinds = [argument_type(parameter.type) for parameter in procedure.parameters]
    given = [f"{kind} {e.get('%given', place, kind)}" for place, kind in enumerate(kinds[:own])]
    handed = ", ".join([*given, "i64 %columns", *(f"ptr %{name}" for name in ("own", "beside", "work", "out"))])
    e.do(f"call void @{procedure.name}({handed})")
    e.do("ret void")
    head = "define void @polynomial(ptr %given, i64 %columns, ptr %own, ptr %beside, ptr %work, ptr %out) #1"
    return _module(procedure, e.function(head))


def _module(procedure: Procedure, entry: str) -> Module:
    functions = [function(one, hidden=True) for one in (*procedure.callees, procedure)]
    return Module("\n".join([declarations(), *functions, entry, METADATA, ATTRIBUTES]), merge=True)


class LlvmDense:
    """A kind of path for one right-hand side and one set of parameters; see `DensePath`."""

    def __init__(
        self, kind: StepPolynomial, kernel: LlvmKernel, parameters: FloatArray, jacobian: LlvmKernel | None = None
    ) -> None:
        self._kind, self._kernels, self._parameters = kind, (kernel, jacobian), parameters
        self._dimension = kernel.program.states

    @property
    def degree(self) -> int:
        """The degree of the polynomials."""
        return self._kind.degree

    def polynomial(self) -> BlockPolynomial:
        """Return what writes the polynomials of a block of steps; see `DensePath`."""
        kind, n = self._kind, self._dimension
        module = compiled_polynomial(kind.written.procedure)
        kept: list[Any] = [module, kind.table]
        places = []
        for kernel in self._kernels:
            prepared = None if kernel is None else kernel.prepare(self._parameters)
            kept.append(prepared)
            places += [0, 0] if kernel is None or prepared is None else [kernel.columns_address, address(prepared)]
        given = np.array([*places, address(kind.table), kind.stages, kind.degree, n], dtype=np.int64)
        function = module.address("polynomial")
        return BlockPolynomial(function, given, LANES, kind.size(n, LANES), kind.derivative, tuple(kept))

    def _run(self, procedure: Procedure, times: FloatArray, states: FloatArray, **own: Any) -> bool:
        """Run a procedure with what writes polynomials, and its own arguments; return whether there are any."""
        n = self._dimension
        try:
            written = self.polynomial()
        except SingularMassMatrix:
            return False
        given = {
            "polynomial": written.function,
            "given": written.given,
            "dimension": n,
            "degree": self.degree,
            "columns": LANES,
            "both": int(written.both),
            "steps": len(times) - 1,
            "times": times,
            "states": states,
            **{name: np.zeros(block_size(n, LANES) + LANES) for name in ("own", "beside")},
            "work": workspace(written.work),
            **own,
        }
        run = compiled(procedure)
        run(*[given[name] for name in run.places])
        return True

    def coefficients(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the polynomials of some steps; see `DensePath`."""
        n, count, blocks = self._dimension, len(steps), -(-len(steps) // LANES)
        starts = np.concatenate([steps, np.repeat(steps[-1:], blocks * LANES - count)]).astype(np.int64)
        out = np.full(blocks * (self.degree + 1) * n * LANES + LANES, np.nan)
        self._run(polynomials(), times, states, starts=starts, blocks=blocks, out=out)
        c = out[:-LANES].reshape(blocks, self.degree + 1, n, LANES)
        return np.moveaxis(c, 0, 2).reshape(self.degree + 1, n, -1)[:, :, :count]

    def at(self, times: FloatArray, states: FloatArray, found: Places, wanted: FloatArray) -> FloatArray:
        """Return the states at sorted times; see `DensePath`."""
        n, count = self._dimension, len(wanted)
        out = np.empty((n, count))
        places = {"found": np.append(found, -1), "wanted": np.append(wanted, np.zeros(LANES)), "count": count}
        c = np.empty((self.degree + 1) * n * LANES + LANES)
        if not self._run(outputs(), times, states, **places, c=c, out=out, stride=count):
            out[:] = np.nan
        return out
