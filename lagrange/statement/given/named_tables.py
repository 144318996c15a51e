"""Tables as named functions, for people: S(x) in place of the cubics of a spline."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import Any

import sympy

from lagrange.statement.given.motion import OVERHANG, table_range
from lagrange.statement.statement import Statement

LETTER = "S"
"""Letter of a table; several tables are S1, S2."""


def with_named_tables(statement: Statement) -> tuple[Statement, tuple[str, ...]]:
    """Return the statement with each table as a function of its argument, and a sentence on each of these functions.

    A statement without tables is returned as it is.
    """
    expressions = (statement.kinetic, statement.potential, statement.dissipation, *statement.forces)
    expressions += tuple(constraint.expression for constraint in statement.constraints)
    nodes = [sorted(expression.atoms(sympy.Piecewise), key=sympy.default_sort_key) for expression in expressions]
    tables = [(node, found) for node in dict.fromkeys(chain(*nodes)) if (found := table_range(node))]
    if not tables:
        return statement, ()
    taken = {*statement.names, *(p.name for p in statement.parameters)}
    names = [LETTER] if len(tables) == 1 and LETTER not in taken else [f"{LETTER}{i + 1}" for i in range(len(tables))]
    named: dict[Any, Any] = {}
    sentences = []
    for name, (table, (argument, low, high)) in zip(names, tables, strict=True):
        named[table] = sympy.Function(name, real=True)(argument)
        knots = [float(pair.cond.rhs) for pair in table.args[0].expr.args[:-1]]
        first, last = ((end + OVERHANG * knot) / (1 + OVERHANG) for end, knot in ((low, knots[0]), (high, knots[-1])))
        sentences.append(f"{name} is a table of {len(knots) + 2} points from {first:.6g} to {last:.6g}.")
    written = statement.mapped(lambda expression: expression.xreplace(named))
    return replace(written, unknown=(*statement.unknown, *named.values())), tuple(sentences)
