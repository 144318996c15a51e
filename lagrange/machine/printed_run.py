"""Procedures printed as Python, called like those in machine code."""

from __future__ import annotations

from array import array
from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray, Kernel, SingularMassMatrix
from lagrange.machine.copies import Shared
from lagrange.machine.python_source import loaded
from lagrange.procedure.form import Procedure

EMPTY = memoryview(array("d"))
"""Placeholder for an array or a function that is not used."""


class PrintedProcedure(Shared):
    """A procedure printed as Python, called with numbers, arrays, records and functions."""

    def __init__(self, procedure: Procedure) -> None:
        self.names = [parameter.name for parameter in procedure.parameters]
        self.function = loaded(procedure)

    def bound(self) -> PrintedCall:
        """Return memory for the arguments of calls."""
        return PrintedCall(self)

    def __call__(self, *args: Any) -> Any:
        """Return None, a value or a tuple of values, for arguments in the order of the parameters."""
        return self.function(*[arg.data if isinstance(arg, np.ndarray) else arg for arg in args])


class PrintedCall:
    """Arguments of a printed procedure, which are set by name, and calls with them."""

    is_final = True

    def __init__(self, code: PrintedProcedure) -> None:
        self.code = code
        self._arguments: dict[str, Any] = dict.fromkeys(code.names, EMPTY)

    def give(self, **arguments: Any) -> None:
        """Set arguments by name. Arrays and records are shared, None stands for no array and no function."""
        for name, value in arguments.items():
            if name in self._arguments:
                flat = value.reshape(-1).data if isinstance(value, np.ndarray) else value
                self._arguments[name] = EMPTY if flat is None else flat

    def __call__(self) -> Any:
        """Return None, a value or a tuple of values."""
        with np.errstate(all="ignore"):
            return self.code.function(*self._arguments.values())

    def count(self, steps: int) -> bool:
        """Return False: no code is compiled again."""
        return False


@lru_cache(maxsize=64)
def called(procedure: Procedure) -> PrintedProcedure:
    """Return a procedure printed as Python, from a cache if possible."""
    return PrintedProcedure(procedure)


def between_arrays(kernel: Kernel) -> Any:
    """Return a kernel as the function between arrays that procedures call. It returns True for a singular matrix."""
    states, count = kernel.program.states, kernel.program.parameters

    def evaluate(t: float, y: memoryview, numbers: memoryview, out: memoryview) -> bool:
        try:
            results: FloatArray = kernel(t, np.frombuffer(y, count=states), np.asarray(numbers[:count]))
        except SingularMassMatrix:
            return True
        out[: results.size] = np.ascontiguousarray(results).reshape(-1).data
        return False

    return evaluate
