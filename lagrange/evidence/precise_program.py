"""Evaluation of a straight-line program with mpmath, to a chosen number of digits."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

from lagrange.graph.evaluate import FUNCTIONS, precise
from lagrange.program.program import Instruction, Program

Numbers = list[Any]


class NoValue(ArithmeticError):
    """An operation without a real, finite value."""


VANISHING = 1e-16
"""Pivots below this fraction of the largest entry need row exchanges; of 40 digits at least 24 are then left."""

_context = cache(precise)


def evaluate(program: Program, t: float, y: Sequence[float], parameters: Sequence[float], digits: int = 40) -> Numbers:
    """Return the outputs at a time, a state and parameters, as numbers with `digits` digits.

    Doubles are converted exactly. Raises NoValue if an operation has no real, finite value, or a matrix is singular.
    """
    return _Evaluation(program, _context(digits)).run(t, y, parameters)


class _Evaluation:
    """One evaluation: numbers, conditions, and lists of numbers for factors and solutions."""

    def __init__(self, program: Program, context: Any) -> None:
        self.program, self.context = program, context
        self.operations = _operations(context)

    def run(self, t: float, y: Sequence[float], parameters: Sequence[float]) -> Numbers:
        values: list[Any] = []
        number = self.context.mpf
        inputs = {"state": [number(x) for x in y], "parameter": [number(x) for x in parameters], "time": [number(t)]}
        for instruction in self.program.instructions:
            if instruction.op in inputs:
                values.append(inputs[instruction.op][instruction.place])
            elif instruction.op == "constant":
                values.append(number(instruction.value))
            else:
                values.append(self.computed(instruction, [values[arg] for arg in instruction.args]))
        outputs = [values[ref] for ref in self.program.outputs]
        if any(not self.context.isfinite(value) for value in outputs):
            raise NoValue("a result is not finite")
        return outputs

    def computed(self, instruction: Instruction, args: list[Any]) -> Any:
        if instruction.op == "factor":
            return self.factored(instruction.order, args)
        if instruction.op == "solve":
            return self.solved(args[0], args[1:])
        if instruction.op == "component":
            return args[0][instruction.place]
        try:
            value = self.operations[instruction.op](*args)
        except (ZeroDivisionError, ValueError, OverflowError) as error:
            raise NoValue(f"{instruction.op} has no value") from error
        if isinstance(value, self.context.mpc):
            raise NoValue(f"{instruction.op} has no real value")
        return value

    def factored(self, n: int, lower: Sequence[Any]) -> Any:
        """Return the factors of L D L^T by rows, with D on the diagonal, or the inverse matrix if a pivot vanishes.

        `lower` has the lower triangle of the symmetric n x n matrix by rows.
        """
        rows = [list(lower[i * (i + 1) // 2 : i * (i + 1) // 2 + i + 1]) for i in range(n)]
        least = VANISHING * max(map(abs, lower))
        for i, row in enumerate(rows):
            scaled: Numbers = []
            for j in range(i):
                scaled.append(row[j] - sum(a * b for a, b in zip(scaled, rows[j], strict=False)))
                row[j] = scaled[j] / rows[j][j]
            row[i] -= sum(a * b for a, b in zip(scaled, row, strict=False))
            if not abs(row[i]) > least:
                return self.inverse(n, lower)
        return rows

    def inverse(self, n: int, lower: Sequence[Any]) -> Any:
        """Return the inverse of a symmetric matrix, by elimination with pivoting."""
        matrix = self.context.zeros(n)
        for i in range(n):
            for j in range(i + 1):
                matrix[i, j] = matrix[j, i] = lower[i * (i + 1) // 2 + j]
        try:
            return self.context.inverse(matrix)
        except ZeroDivisionError as error:
            raise NoValue("a matrix is singular") from error

    def solved(self, factors: Any, right: Sequence[Any]) -> Numbers:
        """Return the solution of a linear system from the result of `factored`."""
        if not isinstance(factors, list):
            return list(factors * self.context.matrix(right))
        x = list(right)
        for i, row in enumerate(factors):
            x[i] -= sum(a * b for a, b in zip(row[:i], x, strict=False))
        for i in reversed(range(len(x))):
            x[i] = x[i] / factors[i][i] - sum(factors[k][i] * x[k] for k in range(i + 1, len(x)))
        return x


@cache
def _operations(context: Any) -> dict[str, Callable[..., Any]]:
    """Return the operations of a program by name, on numbers of an mpmath context.

    The functions are those of the graph module, which uses mpmath. `lagrange.evidence.precise` is independent of graph
    and program: it evaluates the stated expressions.
    """
    return {
        **{name: partial(function, context) for name, function in FUNCTIONS.items()},
        "sqrt": context.sqrt,
        "power": context.power,
        "neg": operator.neg,
        "add": operator.add,
        "sub": operator.sub,
        "mul": operator.mul,
        "div": operator.truediv,
        "fma": lambda a, b, c: a * b + c,
        "select": lambda c, a, b: a if c else b,
    }
