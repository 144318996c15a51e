"""Switches: the conditions, Abs, sign, Min and Max that select between formulas of an energy."""

from __future__ import annotations

from typing import Any

import sympy

from lagrange.statement.statement import Statement


def all_ways(switch: Any) -> tuple[int, ...]:
    """Return every outcome of a switch: 0 and 1 for a condition, -1 and 1 for a sign, an index for Min and Max."""
    if isinstance(switch, (sympy.Min, sympy.Max)):
        return tuple(range(len(switch.args)))
    return (-1, 1) if isinstance(switch, (sympy.Abs, sympy.sign, sympy.Heaviside)) else (0, 1)


def describe_way(switch: Any, way: int, statement: Statement) -> str:
    """Return a clause in the user's symbols, such as ``x > 1 does not hold``."""
    if isinstance(switch, (sympy.Min, sympy.Max)):
        return f"{_text(switch.args[way], statement)} is the one that {_text(switch, statement)} takes"
    if isinstance(switch, (sympy.Abs, sympy.sign, sympy.Heaviside)):
        return f"{_text(switch.args[0], statement)} is {'positive' if way > 0 else 'negative'}"
    return f"{_text(switch, statement)} {'holds' if way else 'does not hold'}"


def _text(expression: Any, statement: Statement) -> str:
    text = str(expression.xreplace(dict(statement.plain)))
    return text if len(text) <= 80 else f"{text[:77]}..."
