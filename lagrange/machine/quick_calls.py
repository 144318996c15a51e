"""Calls of kernels (loaded programs) by a model: by fast functions if possible, and tests of the results."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray, Kernel, QuickCalls, SingularMassMatrix


class Quick(dict[str, QuickCalls]):
    """Fast functions that evaluate the quantities of a model at one state, by name, for the default parameters.

    They are created on first use. For a quantity without such functions, both functions return None.
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
    """Return the result of a kernel at one state y by its fast function.

    Return None if the kernel has no such function or the result is not finite.
    """
    quick = kernel.quick(parameters)
    return None if quick is None else quick.whole(t, y)


def nothing(*_: Any) -> None:
    """Return None: a fast function for kernels that have none. The caller then evaluates the kernel itself."""


def may_vanish(kernel: Kernel, parameters: FloatArray) -> bool:
    """Return True if some result of a kernel may be zero at some state.

    Results that depend on the state or time always may. Others are evaluated once with the parameters. If none is
    zero, the caller need not test the results of a large batch, which takes as long as computing them.
    """
    program = kernel.program
    if any(instruction.op in ("state", "time") for instruction in program.instructions):
        return True
    results = quickly(kernel, parameters, 0.0, np.zeros(program.states))
    return results is None or 0.0 in results.tolist()


FEW_ENTRIES = 64
"""Largest number of entries that Python sums faster than NumPy, whose two calls take 1 us."""


def surely_finite(array: FloatArray) -> bool:
    """Return True if every entry is finite. Return False if not, or if the sum of a short array overflows.

    A short array is added in Python: NumPy would warn of an overflow, and public functions give no warnings.
    """
    if array.size <= FEW_ENTRIES:
        return math.isfinite(sum(array.ravel().tolist()))
    return bool(np.isfinite(array).all())


def scalar(value: FloatArray) -> Any:
    """Return a zero-dimensional array as a float, and other arrays unchanged."""
    return float(value) if value.ndim == 0 else value
