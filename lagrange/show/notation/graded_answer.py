"""Compare a student's equations with those of a system, and spell the formulas in the messages as textbooks do."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

from sympy import Add, Mul

from lagrange.equations.derivation import Derivation
from lagrange.errors import SceneError
from lagrange.mechanics.grading import time_limit
from lagrange.mechanics.grading.comparison import EquationsComparison, compare_equations
from lagrange.mechanics.grading.student_equations import MULTIPLIER, read_equations
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.text import Notation
from lagrange.statement.scene.expressions import read_expression
from lagrange.statement.statement import Statement

_DIFFERENCE = re.compile(r"\(([^()]{1,30}-[^()]{1,30})\)")
"""Pattern of a difference in parentheses, such as (m1 - m2), with at most 30 characters on each side."""


def graded_answer(statement: Statement, derivation: Derivation, answer: Any) -> EquationsComparison:
    """Return the comparison of a student's `answer`, as texts or SymPy, with the equations of a statement.

    `derivation` is the derivation of the statement. Sums in the messages have the signs that the student typed, m1 - m2
    or m2 - m1. Raises StatementError for an answer that cannot be read.
    """
    typeset = Typesetter(statement, Notation((*statement.names, *(p.name for p in statement.parameters))))
    typeset.letters |= {constraint.multiplier: f"{MULTIPLIER}{constraint.name}" for constraint in statement.constraints}
    symbols = {symbol.name: symbol for symbol in (*statement.plain.values(), *statement.parameters)}
    with time_limit.limited(time_limit.SECONDS):  # limits the search for a wrong term
        equations = read_equations(answer, statement)
        sides = [side for equation in equations for side in (equation.right, equation.zero + equation.right)]
        built = {node for side in sides for node in side.atoms(Add, Mul)}
        # SymPy turns cos(a - b) to cos(b - a), and -(a - b) to b - a.
        differences = set()
        for inside in _DIFFERENCE.findall("\n".join(equation.read for equation in equations)):
            with suppress(SceneError):
                differences.add(read_expression(inside, symbols))
        typeset.order.typed = frozenset(differences | {node for node in built if -node not in differences})
        return compare_equations(statement, derivation, equations, typeset.write)
