"""Export a quantity of a model as SymPy expressions, with a symbol for each value that is used more than once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import count
from typing import Any

import sympy

from lagrange.errors import StatementError
from lagrange.graph.sympy_nodes import SPELLING
from lagrange.machine.model import Model
from lagrange.program.program import Instruction, Program, uses_of
from lagrange.statement.vocabulary.functions import CONDITIONS

OPERATIONS: Mapping[str, Callable[..., Any]] = {
    **SPELLING,
    "neg": lambda a: -a,
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "fma": lambda a, b, c: a * b + c,
    "sqrt": sympy.sqrt,
    "power": lambda a, b: a**b,
    "select": lambda condition, a, b: sympy.Piecewise((a, condition), (b, True)),
}
"""Functions that return the SymPy expression of an operation of a program, by the name of the operation."""

MOST_DENOMINATOR = 64
"""Largest denominator with which a double is written as a fraction. Other doubles are written as exact Floats."""

DOUBLE_DIGITS = 17  # Decimal digits that determine every double


@dataclass(frozen=True, eq=False)
class SympyForm:
    """A quantity of a model as SymPy expressions in symbols, none of which is a function of time.

    The symbols are the time `t`, coordinates `q`, velocities `v`, named x and x_dot, and parameters `p`. `replacements`
    are pairs (symbol, expression), as from sympy.cse. An expression may contain symbols of earlier pairs. `results` are
    the entries of an array of `shape`, in C order.
    """

    t: Any
    q: tuple[Any, ...]
    v: tuple[Any, ...]
    p: tuple[Any, ...]
    replacements: tuple[tuple[Any, Any], ...]
    results: tuple[Any, ...]
    shape: tuple[int, ...]

    def __repr__(self) -> str:
        shape = " x ".join(map(str, self.shape)) or "a number"
        return f"<SympyForm: {shape}, of {len(self.arguments)} arguments, {len(self.replacements)} common expressions>"

    @property
    def arguments(self) -> tuple[Any, ...]:
        """All symbols that the results depend on: t, then q, v and p."""
        return (self.t, *self.q, *self.v, *self.p)

    def common(self, _: Any = None) -> tuple[list[tuple[Any, Any]], list[Any]]:
        """Return (replacements, results), as sympy.lambdify(..., cse=form.common) expects. The argument is ignored."""
        return list(self.replacements), list(self.results)

    def expanded(self) -> list[Any]:
        """Return the results with all replacements inserted. They may be very long."""
        expressions: dict[Any, Any] = {}
        for symbol, expression in self.replacements:
            expressions[symbol] = expression.xreplace(expressions)
        return [result.xreplace(expressions) for result in self.results]


def sympy_form(model: Model, quantity: str) -> SympyForm:
    """Return the quantity of a model with the name `quantity`, such as "rhs", as SymPy expressions."""
    program = model.interpreted(quantity).program
    parameters = model.statement.parameters
    t, *state = (sympy.Symbol(name, real=True) for name in ("t", *model.layout.names()))
    taken = {symbol.name for symbol in (t, *state, *parameters)}
    symbols = (sympy.Symbol(f"x{i}", real=True) for i in count() if f"x{i}" not in taken)
    writer = _Writer(program, t, state, parameters, symbols)
    results = tuple(writer.results())
    q, v = model.layout.split(tuple(state))
    return SympyForm(t, q, v, parameters, tuple(writer.replacements), results, program.shape)


def number(value: float) -> Any:
    """Return a double as the equal SymPy number, without rounding."""
    if not math.isfinite(value):
        return sympy.nan if math.isnan(value) else sympy.oo if value > 0 else -sympy.oo
    exact = Fraction(value)
    if exact.denominator <= MOST_DENOMINATOR and abs(value) < 2**53:
        return sympy.Rational(exact.numerator, exact.denominator)
    return sympy.Float(value, DOUBLE_DIGITS)


class _Writer:
    """Converts the instructions of a program to the expressions of a `SympyForm`."""

    def __init__(
        self, program: Program, t: Any, state: Sequence[Any], parameters: Sequence[Any], symbols: Iterator[Any]
    ) -> None:
        self.program, self.symbols = program, symbols
        self.inputs = {"time": (t,), "state": state, "parameter": parameters}
        self.replacements: list[tuple[Any, Any]] = []
        self.uses = uses_of(program)
        self.values: dict[int, Any] = {}
        self.matrices: dict[int, tuple[list[list[Any]], list[int]]] = {}

    def results(self) -> list[Any]:
        """Return the outputs of the program as expressions."""
        for i, instruction in enumerate(self.program.instructions):
            self.values[i] = self.value(i, instruction)
        return [self.values[ref] for ref in self.program.outputs]

    def named(self, expression: Any) -> Any:
        """Return a new symbol for an expression, and add the pair to `replacements`. A symbol or number is returned."""
        if expression.is_Symbol or expression.is_number:
            return expression
        symbol = next(self.symbols)
        self.replacements.append((symbol, expression))
        return symbol

    def value(self, i: int, instruction: Instruction) -> Any:
        """Return the SymPy value of instruction number `i`: an expression, factors of a matrix, or a solution."""
        args = [self.values[arg] for arg in instruction.args]
        if instruction.op in self.inputs:
            return self.inputs[instruction.op][instruction.place]
        if instruction.op == "constant":
            return number(instruction.value)
        if instruction.op == "factor":
            return self.factored(instruction.order, args)
        if instruction.op == "solve":
            return self.solved(args[0], args[1:])
        if instruction.op == "component":
            return args[0][instruction.place]
        if instruction.op == "select" and self.program.instructions[instruction.args[0]].op not in CONDITIONS:
            args[0] = sympy.Ne(args[0], 0)
        expression = OPERATIONS[instruction.op](*args)
        return self.named(expression) if self.uses[i] > 1 and instruction.op not in CONDITIONS else expression

    def factored(self, n: int, lower: Sequence[Any]) -> tuple[list[list[Any]], list[int]]:
        """Return the factors L and U of a symmetric matrix of order `n`, and an order of rows with nonzero pivots.

        `lower` is the lower triangle of the matrix, row by row. L, whose diagonal is one, and U share a matrix.
        """
        a = [[lower[max(i, j) * (max(i, j) + 1) // 2 + min(i, j)] for j in range(n)] for i in range(n)]
        order, symmetric = list(range(n)), True
        for j in range(n):
            pick = next((i for i in range(j, n) if a[i][j] != 0), None)
            if pick is None:
                raise StatementError(
                    "the mass matrix is singular at every state, so it has no inverse: add the missing kinetic energy."
                )
            if pick != j:
                a[j], a[pick], order[j], order[pick] = a[pick], a[j], order[pick], order[j]
                symmetric = False
            for i in range(j + 1, n):
                if a[i][j] == 0:
                    continue
                factor = self.named(a[i][j] / a[j][j])
                for k in range(i if symmetric else j + 1, n):
                    if a[j][k] != 0:
                        a[i][k] = self.named(a[i][k] - factor * a[j][k])
                        if symmetric:
                            a[k][i] = a[i][k]
                a[i][j] = factor
        return a, order

    def solved(self, factors: tuple[list[list[Any]], list[int]], right: Sequence[Any]) -> list[Any]:
        """Return the solution of a linear system, one expression for each unknown.

        `factors` are the factors of its matrix, a result of `factored`, and `right` is the right-hand side.
        """
        (a, order), n = factors, len(right)
        x = [right[i] for i in order]
        for i in range(n):
            x[i] = self.named(x[i] - sum(a[i][k] * x[k] for k in range(i)))
        for i in reversed(range(n)):
            x[i] = self.named((x[i] - sum(a[i][k] * x[k] for k in range(i + 1, n))) / a[i][i])
        return x
