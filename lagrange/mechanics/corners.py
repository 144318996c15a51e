"""Corners and jumps of expressions: where they are, and what an expression is on either side of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy

from lagrange.equations.terms import Direction, Magnitude, Step

_COMPARED = sympy.core.relational.Relational


def edges(given: Any) -> Sequence[Any]:
    """Return expressions whose zeros are the corners and jumps of an expression from `PlainForm.read`."""
    found = [node.args[0] for node in sorted(given.atoms(Magnitude, Direction, Step), key=str)]
    for node in sorted(given.atoms(sympy.Piecewise), key=str):
        for _, when in node.args:
            found += [one.lhs - one.rhs for one in sorted(when.atoms(_COMPARED), key=str)]
    return list(dict.fromkeys(found))


def on_side(given: Any, edge: Any, sign: int) -> Any:
    """Return an expression as it is where an edge has a sign, 1 or -1."""
    table = {Magnitude(edge): sign * edge, Direction(edge): sympy.Integer(sign), Step(edge): sympy.Integer(sign > 0)}
    for one in sorted(given.atoms(_COMPARED), key=str):
        if one.lhs - one.rhs == edge:
            table[one] = _compared(one, sign)
    return given.xreplace(table)


def _compared(one: Any, sign: int) -> Any:
    """Return whether a comparison holds where its left side, less its right one, has a sign."""
    above: Mapping[str, bool] = {">": sign > 0, ">=": sign > 0, "<": sign < 0, "<=": sign < 0, "!=": True}
    return sympy.true if above.get(one.rel_op, False) else sympy.false
