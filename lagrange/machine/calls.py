"""Calls of kernels by a model: quick calls if possible, and tests of the results."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray, Kernel, QuickCalls, SingularMassMatrix


class Quick(dict[str, QuickCalls]):
    """The quick calls of a model by quantity, for the default parameters, created on first use.

    For a quantity without quick calls, both functions return None.
    """

    def __init__(self, kernel: Callable[[str], Kernel], parameters: Callable[[], FloatArray]) -> None:
        super().__init__()
        self._kernel, self._parameters = kernel, parameters

    def __missing__(self, name: str) -> QuickCalls:
        try:
            calls = self._kernel(name).quick(self._parameters())
        except SingularMassMatrix:
            calls = None
        self[name] = QuickCalls(nothing, nothing) if calls is None else calls
        return self[name]


def one_state(kernel: Kernel, parameters: FloatArray) -> Callable[[float, FloatArray], FloatArray]:
    """Return a kernel as a function of a time and one state (2n,). Quick calls are used if the kernel has them.

    The state must be a plain array of doubles. Raises SingularMassMatrix, here and in calls.
    """
    quick = kernel.quick(parameters)
    if quick is None:
        return lambda t, y: kernel(t, y, parameters)
    whole = quick.whole

    def call(t: float, y: FloatArray) -> FloatArray:
        result = whole(t, y)
        return kernel(t, y, parameters) if result is None else result

    return call


def quickly(kernel: Kernel, parameters: FloatArray, t: float, y: FloatArray) -> FloatArray | None:
    """Return the result of a kernel's quick call at one state.

    Return None if the kernel has no quick calls or the result is not finite.
    """
    quick = kernel.quick(parameters)
    return None if quick is None else quick.whole(t, y)


def nothing(*_: Any) -> None:
    """Return None: a quick call that asks the caller to evaluate the kernel itself."""


def may_vanish(kernel: Kernel, parameters: FloatArray) -> bool:
    """Return True if a result of a kernel may be zero at some state.

    Results that depend on parameters alone are evaluated. Testing the results of 100,000 states takes as long as
    computing them for a small system.
    """
    program = kernel.program
    if any(instruction.op in ("state", "time") for instruction in program.instructions):
        return True
    results = quickly(kernel, parameters, 0.0, np.zeros(program.states))
    return results is None or 0.0 in results.tolist()


FEW_ENTRIES = 64
"""Largest number of entries that Python sums faster than NumPy, whose two calls take 1 us."""


def surely_finite(array: FloatArray) -> bool:
    """Return True if every entry is finite. Return False if an entry is not, or if the sum of a short array overflows.

    Python adds few entries: NumPy would warn of an overflow, and public functions give no warnings.
    """
    if array.size <= FEW_ENTRIES:
        return math.isfinite(sum(array.ravel().tolist()))
    return bool(np.isfinite(array).all())


def scalar(value: FloatArray) -> Any:
    """Return a zero-dimensional array as a float, and other arrays unchanged."""
    return float(value) if value.ndim == 0 else value
