"""The operations of a program on numbers: NumPy's doubles, or any other arithmetic with a table of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.program.program import Program


def _error_function(a: Any) -> Any:
    """Return the error function of a number or of each number; NumPy has none, and SciPy's takes 0.2 s to import."""
    return np.array([math.erf(x) for x in np.ravel(a).tolist()]).reshape(np.shape(a))[()]


OPERATIONS: dict[str, Callable[..., Any]] = {
    "neg": np.negative,
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "fma": lambda a, b, c: a * b + c,
    "sqrt": np.sqrt,
    "power": np.power,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "exp": np.exp,
    "log": np.log,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh,
    "erf": _error_function,
    "abs": np.abs,
    "sign": np.sign,
    "min": np.minimum,
    "max": np.maximum,
    "less": np.less,
    "less_equal": np.less_equal,
    "equal": np.equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
    "select": np.where,
}
"""The spelling of each operation, on numbers or on one number per column."""


@dataclass(frozen=True)
class Arithmetic:
    """A number type: its function for each operation of a program, and the conversion from a double.

    `systems` has factor and solve, as functions of the order and the operands, if there are any.
    """

    operations: Mapping[str, Callable[..., Any]]
    number: Callable[[float], Any]
    dtype: Any
    systems: Mapping[str, Callable[..., Any]] = field(default_factory=dict)

    def evaluate(
        self, program: Program, t: Any, y: Sequence[Any] | NDArray[Any], parameters: Sequence[Any] | NDArray[Any]
    ) -> list[Any]:
        """Return the outputs of a program."""
        values: list[Any] = []
        for op, args, place, value, order, _ in program.instructions:
            if op == "state":
                values.append(y[place])
            elif op == "parameter":
                values.append(parameters[place])
            elif op == "time":
                values.append(t)
            elif op == "constant":
                values.append(self.number(value))
            elif op == "component":
                values.append(values[args[0]][place])
            elif op in self.systems:
                values.append(self.systems[op](order, *[values[arg] for arg in args]))
            else:
                values.append(self.operations[op](*[values[arg] for arg in args]))
        return [values[output] for output in program.outputs]


FLOATS = Arithmetic(OPERATIONS, np.float64, float)
