"""Evaluation of a program with NumPy's doubles, or with another number type and its own table of functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.graph.evaluate import DOUBLE_FUNCTIONS
from lagrange.program.program import Program

OPERATIONS: dict[str, Callable[..., Any]] = {
    "neg": np.negative,
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "fma": lambda a, b, c: a * b + c,
    "sqrt": np.sqrt,
    "power": np.power,
    **DOUBLE_FUNCTIONS,
    "select": np.where,
}
"""The function of each operation, on numbers or on arrays with one number per column."""


@dataclass(frozen=True)
class Arithmetic:
    """A number type: the function for each operation of a program, and the conversion from a double.

    `systems` has the functions `factor` and `solve` for linear systems, if the number type supports them. They take the
    size of the matrix and the operands.
    """

    operations: Mapping[str, Callable[..., Any]]
    number: Callable[[float], Any]
    dtype: Any
    systems: Mapping[str, Callable[..., Any]] = field(default_factory=dict)

    def evaluate(
        self, program: Program, t: Any, y: Sequence[Any] | NDArray[Any], parameters: Sequence[Any] | NDArray[Any]
    ) -> list[Any]:
        """Return the outputs of a program, as a list, at time `t`, for the inputs `y` and the parameters."""
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
