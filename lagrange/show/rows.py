"""What the rows of a solution are called."""

from __future__ import annotations

from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import formula, shown
from lagrange.statement.coordinate import name_of, velocity_of

MOST_LETTERS = 10_000
"""Letters of an expression as the name of a row: as many as two expressions may need to differ in."""


def row_label(key: Any) -> str:
    """Return what a row is called: ``theta`` for theta(t), ``theta_dot`` for its derivative."""
    if isinstance(key, sympy.Derivative) and isinstance(key.expr, AppliedUndef) and key == velocity_of(key.expr):
        return f"{name_of(key.expr)}_dot"
    if isinstance(key, AppliedUndef):
        return name_of(key)
    if isinstance(key, sympy.Basic):
        return formula(key, MOST_LETTERS)
    return key if isinstance(key, str) else shown(key)
