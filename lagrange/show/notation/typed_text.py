"""Expressions as people type them: in the order of a book, and with lambda_name for the multiplier of a constraint."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lagrange.mechanics.plain_form import names_of
from lagrange.mechanics.student_equations import MULTIPLIER
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.text import AsciiNotation
from lagrange.statement.statement import Statement


def typed_text(statement: Statement) -> Callable[[Any], str]:
    """Return a function that writes an expression of a statement as an answer is typed."""
    typeset = Typesetter(statement, AsciiNotation(names_of(statement)))
    typeset.letters |= {one.multiplier: f"{MULTIPLIER}{one.name}" for one in statement.constraints}
    return typeset.write
