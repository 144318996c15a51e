"""Calls of kernels by a model: quick calls if possible, with a test of the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray, Kernel, QuickCalls, SingularMassMatrix


class Quick(dict[str, QuickCalls]):
    """The quick calls of a model by quantity, for the parameters of its statement, created on first use.

    For a quantity without quick calls, both functions return None.
    """

    def __init__(self, kernel: Callable[[str], Kernel], parameters: Callable[[], FloatArray]) -> None:
        super().__init__()
        self._kernel, self._parameters = kernel, parameters

    def __missing__(self, name: str) -> QuickCalls:
        try:
            found = self._kernel(name).quick(self._parameters())
        except SingularMassMatrix:
            found = None
        self[name] = QuickCalls(nothing, nothing) if found is None else found
        return self[name]


def one_state(kernel: Kernel, parameters: FloatArray) -> Callable[[float, FloatArray], FloatArray]:
    """Return a kernel as a function of a time and one state (2n,), by quick calls if it has them.

    The state must be a plain array of doubles. Raises SingularMassMatrix, here and in calls.
    """
    quick = kernel.quick(parameters)
    if quick is None:
        return lambda t, y: kernel(t, y, parameters)
    whole = quick.whole

    def call(t: float, y: FloatArray) -> FloatArray:
        found = whole(t, y)
        return kernel(t, y, parameters) if found is None else found

    return call


def quickly(kernel: Kernel, parameters: FloatArray, t: float, y: FloatArray) -> FloatArray | None:
    """Return the result of a kernel's quick call at one state.

    Return None without quick calls or if it is not finite.
    """
    quick = kernel.quick(parameters)
    return None if quick is None else quick.whole(t, y)


def nothing(*_: Any) -> None:
    """Return None, so that the caller evaluates the kernel itself."""


def may_vanish(kernel: Kernel, parameters: FloatArray) -> bool:
    """Return True if a result may be zero at some state. Results of parameters alone are evaluated here.

    Testing the results of 100,000 states takes as long as computing those of small systems.
    """
    program = kernel.program
    if any(one.op in ("state", "time") for one in program.instructions):
        return True
    found = quickly(kernel, parameters, 0.0, np.zeros(program.states))
    return found is None or 0.0 in found.tolist()


def column_of_zero(kernel: Kernel, t: Any, inputs: Sequence[FloatArray], parameters: FloatArray) -> int | None:
    """Return the first column with a zero result, or None without zeros. For one state the column is 0."""
    zeros = (kernel.columns(t, [one.reshape(len(one), -1) for one in inputs], parameters) == 0.0).any(axis=0)
    return int(np.argmax(zeros)) if zeros.any() else None


FEW_ENTRIES = 64
"""Largest number of entries that Python sums faster than NumPy, whose two calls take 1 us."""


def surely_finite(array: FloatArray) -> bool:
    """Return True if every entry is finite. Return False if one is not, and also if their sum overflows.

    Python adds the entries: NumPy would warn of an overflow, and public functions give no warnings.
    """
    if array.size <= FEW_ENTRIES:
        return math.isfinite(sum(array.ravel().tolist()))
    return bool(np.isfinite(array).all())


def scalar(value: FloatArray) -> Any:
    """Return a zero-dimensional array as a float, and other arrays unchanged."""
    return float(value) if value.ndim == 0 else value
