"""Comparison of an answer with a system; its messages spell formulas in plain text, in the order of textbooks."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, TypeGuard

from sympy import Add, Mul

from lagrange.equations.derivation import Derivation
from lagrange.errors import SceneError
from lagrange.mechanics.grading.comparison import EquationsComparison, compare_equations
from lagrange.mechanics.grading.student_equations import MULTIPLIER, read_equations
from lagrange.mechanics.plain_form import names_of
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.text import Notation
from lagrange.statement.scene.expressions import read_expression
from lagrange.statement.statement import Statement

LONGEST_DIFFERENCE = 60
"""Most characters of a difference whose signs are quoted as typed."""


def graded_answer(statement: Statement, derivation: Derivation, answer: Any) -> EquationsComparison:
    """Return the comparison of an answer, as texts or SymPy, with the equations of a statement.

    Sums in its messages have the signs that were typed, m1 - m2 or m2 - m1. Raises StatementError for an answer that
    cannot be read.
    """
    typeset = Typesetter(statement, Notation(names_of(statement)))
    typeset.letters |= {one.multiplier: f"{MULTIPLIER}{one.name}" for one in statement.constraints}
    equations = read_equations(answer, statement)
    sides = [side for equation in equations for side in (equation.right, equation.zero + equation.right)]
    built = {node for side in sides for node in side.atoms(Add, Mul)}
    symbols = {symbol.name: symbol for symbol in (*statement.plain.values(), *statement.parameters)}
    differences = {node for equation in equations for node in _typed_differences(equation.read, symbols)}
    typeset.order.typed = frozenset(differences | {node for node in built if -node not in differences})
    return compare_equations(statement, derivation, equations, typeset.write)


def _typed_differences(text: str, symbols: Mapping[str, Any]) -> Iterator[Any]:
    """Yield the short differences in a text: SymPy turns cos(a - b) to cos(b - a), and -(a - b) to b - a."""
    for side in text.split("="):
        with suppress(SyntaxError, RecursionError, SceneError):
            for node in ast.walk(ast.parse(side.strip(), mode="eval").body):
                inside = ast.iter_child_nodes(node) if not _is_sum(node) else ()
                for part in filter(_is_sum, inside):
                    if (part.end_col_offset or LONGEST_DIFFERENCE) - part.col_offset <= LONGEST_DIFFERENCE:
                        yield read_expression(ast.unparse(part), symbols)


def _is_sum(node: ast.AST) -> TypeGuard[ast.BinOp]:
    return isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Sub))
