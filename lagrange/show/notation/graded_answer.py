"""Comparison of an answer with a system; its messages spell formulas in plain text, in the order of textbooks."""

from __future__ import annotations

from typing import Any

from sympy import Add

from lagrange.equations.derivation import Derivation
from lagrange.mechanics.grading.comparison import EquationsComparison, compare_equations
from lagrange.mechanics.grading.student_equations import MULTIPLIER, read_equations
from lagrange.mechanics.plain_form import names_of
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.text import Notation
from lagrange.statement.statement import Statement


def graded_answer(statement: Statement, derivation: Derivation, answer: Any) -> EquationsComparison:
    """Return the comparison of an answer, as texts or SymPy, with the equations of a statement.

    Sums in its messages have the signs that were typed, m1 - m2 or m2 - m1. Raises StatementError for an answer that
    cannot be read.
    """
    typeset = Typesetter(statement, Notation(names_of(statement)))
    typeset.letters |= {one.multiplier: f"{MULTIPLIER}{one.name}" for one in statement.constraints}
    equations = read_equations(answer, statement)
    sides = [side for equation in equations for side in (equation.right, equation.zero + equation.right)]
    typed = {node for side in sides for node in side.atoms(Add)}
    typeset.order.sums = frozenset({*typed, *(node for node in typeset.order.sums if -node not in typed)})
    return compare_equations(statement, derivation, equations, typeset.write)
