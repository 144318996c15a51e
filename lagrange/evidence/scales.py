"""Characteristic sizes of coordinates and velocities: where the terms of a sum balance, and arguments are of order one.

A size is a monomial in logarithms. 1 + (x/l)**2 says x = l, sin(w*x) says x = 1/w, and m*v**2/2 - k*x**2/2 says
v = x*sqrt(k/m). Each such equation is a row; a row with one unknown gives it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import sympy

from lagrange.evidence.precise import children
from lagrange.statement.statement import Statement

ORDINARY = math.log(300.0)
"""A size between 1/300 and 300 counts as one: samples of order one suit it."""

EXTREME = math.log(1e100)
"""Sizes are kept within 1e-100 and 1e100: their squares are doubles."""

Form = dict[Any, float]
"""A monomial: powers of its symbols, and under `UNIT` the logarithm of its coefficient."""

UNIT = sympy.S.One


class Scales:
    """Sizes of the coordinates and velocities of a statement, for any values of its parameters."""

    def __init__(self, statement: Statement) -> None:
        self._unknown = (*statement.coordinates, *statement.velocities)
        self._rows: list[Form] = []
        self._forms: dict[Any, Form] = {}
        stated = (statement.lagrangian, *statement.forces, statement.dissipation)
        for expression in (*stated, *(one.expression for one in statement.constraints)):
            self._read(expression)

    def sizes(self, parameters: Mapping[Any, float], start: Sequence[float] = ()) -> tuple[float, ...]:
        """Return the 2n sizes. One that nothing determines, or that is of order one, is 1.

        A state `start` (2n,) gives sizes to what no constants and parameters do.
        """
        logarithms = {p: math.log(abs(x)) for p, x in parameters.items() if x and math.isfinite(x)}
        rows = [row for row in (self._with(form, logarithms) for form in self._rows) if row is not None]
        solution = _Solution(rows)
        for unknown, value in zip(self._unknown, start, strict=False):
            if value:
                solution.settle(unknown, math.log(abs(value)))
        for unknown in self._unknown:
            solution.settle(unknown, 0.0)
        bounded = (max(-EXTREME, min(EXTREME, solution.sizes[unknown])) for unknown in self._unknown)
        return tuple(1.0 if abs(size) <= ORDINARY else math.exp(size) for size in bounded)

    def _with(self, form: Form, logarithms: Mapping[Any, float]) -> Form | None:
        """Return a row in the unknowns alone, None if a parameter has no size or no unknown is left."""
        row: Form = {UNIT: 0.0}
        for symbol, power in form.items():
            if symbol in logarithms:
                row[UNIT] += power * logarithms[symbol]
            elif symbol is UNIT:
                row[UNIT] += power
            elif symbol in self._unknown:
                row[symbol] = power
            else:
                return None
        return row if len(row) > 1 and math.isfinite(row[UNIT]) else None

    def _read(self, expression: Any) -> None:
        """Add the rows of an expression, children first."""
        stack = [(expression, False)]
        while stack:
            node, ready = stack.pop()
            if node in self._forms:
                continue
            if ready or not children(node):
                self._forms[node] = self._form(node)
            else:
                stack += [(node, True), *((child, False) for child in children(node))]

    def _form(self, node: Any) -> Form:
        parts = [self._forms[child] for child in children(node)]
        if not parts:
            if not node.is_number:
                return {node: 1.0}
            size = abs(float(node)) if node.is_finite and node.is_real else 0.0
            return {UNIT: math.log(size)} if size else {UNIT: -math.inf}
        if isinstance(node, sympy.Mul):
            return _product(parts)
        if isinstance(node, sympy.Pow) and node.exp.is_number:
            return {symbol: power * float(node.exp) for symbol, power in parts[0].items()}
        if isinstance(node, (sympy.Abs, sympy.Max, sympy.Min, sympy.Add, *RELATIONS)):
            # Terms that balance have one size: that of the first which has no unknown, if there is one.
            parts.sort(key=lambda part: any(symbol in self._unknown for symbol in part))
            self._rows += [_product([part, {s: -power for s, power in parts[0].items()}]) for part in parts[1:]]
            return parts[0]
        if isinstance(node, sympy.Function) and not isinstance(node, (sympy.Piecewise, sympy.sign)):
            self._rows += parts
        return {UNIT: 0.0} if not isinstance(node, sympy.Piecewise) else parts[0]


RELATIONS = (sympy.StrictLessThan, sympy.LessThan, sympy.StrictGreaterThan, sympy.GreaterThan)


def _product(parts: Sequence[Form]) -> Form:
    found: Form = {}
    for part in parts:
        for symbol, power in part.items():
            found[symbol] = found.get(symbol, 0.0) + power
    return {symbol: power for symbol, power in found.items() if power or symbol is UNIT}


class _Solution:
    """Logarithms of the sizes that are found, and the rows that wait for one of their unknowns."""

    def __init__(self, rows: Sequence[Form]) -> None:
        self.sizes: dict[Any, float] = {}
        self._rows = rows
        self._waiting: dict[Any, list[int]] = {}
        for k, row in enumerate(rows):
            for symbol in row.keys() - {UNIT}:
                self._waiting.setdefault(symbol, []).append(k)
        self._left = [len(row) - 1 for row in rows]
        for k, left in enumerate(list(self._left)):
            if left == 1:
                self._follow(k)

    def settle(self, symbol: Any, size: float) -> None:
        """Give an unknown its size, unless it has one, and find those that follow from it."""
        if symbol in self.sizes:
            return
        self.sizes[symbol] = size
        fresh = deque([symbol])
        while fresh:
            for k in self._waiting.get(fresh.popleft(), ()):
                self._left[k] -= 1
                if self._left[k] == 1 and (follower := self._alone(k)):
                    fresh.append(follower)

    def _follow(self, k: int) -> None:
        row = self._rows[k]
        for symbol in row.keys() - {UNIT, *self.sizes}:
            self.settle(symbol, -row[UNIT] / row[symbol])

    def _alone(self, k: int) -> Any:
        """Return the last unknown of a row, whose size is found then, or None if it was found meanwhile."""
        row = self._rows[k]
        for symbol in row.keys() - {UNIT, *self.sizes}:
            known = sum(power * self.sizes[s] for s, power in row.items() if s in self.sizes)
            self.sizes[symbol] = -(row[UNIT] + known) / row[symbol]
            return symbol
        return None
