"""Procedures printed as Python, called in the same way as those in machine code."""

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
        """Return an object that keeps arguments of the procedure between calls, and runs it when called."""
        return PrintedCall(self)

    def __call__(self, *args: Any) -> Any:
        """Run the procedure with arguments in the order of its parameters; return None, a value or several values."""
        return self.function(*[arg.data if isinstance(arg, np.ndarray) else arg for arg in args])


class PrintedCall:
    """Arguments of a printed procedure, kept between calls. Calling the object runs the procedure with them."""

    is_final = True

    def __init__(self, code: PrintedProcedure) -> None:
        self.code = code
        self._arguments: dict[str, Any] = dict.fromkeys(code.names, EMPTY)

    def give(self, **arguments: Any) -> None:
        """Set arguments of the procedure by name, and ignore other names. None stands for no array or no function.

        Arrays and records are not copied.
        """
        for name, value in arguments.items():
            if name in self._arguments:
                flat = value.reshape(-1).data if isinstance(value, np.ndarray) else value
                self._arguments[name] = EMPTY if flat is None else flat

    def __call__(self) -> Any:
        """Run the procedure with the present arguments; return None, a value or a tuple of values."""
        with np.errstate(all="ignore"):
            return self.code.function(*self._arguments.values())

    def count(self, steps: int) -> bool:
        """Return False: unlike machine code, printed code is not replaced by optimized code after many steps."""
        return False


@lru_cache(maxsize=64)
def called(procedure: Procedure) -> PrintedProcedure:
    """Return a procedure printed as Python, from a cache if possible."""
    return PrintedProcedure(procedure)


def between_arrays(kernel: Kernel) -> Any:
    """Return a kernel as a function f(t, y, parameters, out) for printed procedures; it writes to `out`.

    The function returns True if the mass matrix is singular, else False.
    """
    states, count = kernel.program.states, kernel.program.parameters

    def evaluate(t: float, y: memoryview, numbers: memoryview, out: memoryview) -> bool:
        try:
            results: FloatArray = kernel(t, np.frombuffer(y, count=states), np.asarray(numbers[:count]))
        except SingularMassMatrix:
            return True
        out[: results.size] = np.ascontiguousarray(results).reshape(-1).data
        return False

    return evaluate
