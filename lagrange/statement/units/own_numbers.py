"""Bare numbers in given functions and events. Their units are taken to be those of the terms that they are added to."""

from __future__ import annotations

from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.statement.coordinate import t


def without_own_numbers(expression: Any) -> Any:
    """Return an expression without its parts made of numbers and time alone: the units of such numbers are not stated.

    Such terms are left out, such factors are replaced by 1: `a*sin(2*t) + 0.1` becomes a, an event `x - 3` is x.
    """
    return sympy.S.Zero if _own(expression) else expression.replace(_replaced, _without)


def _own(node: Any) -> bool:
    """Return True if a node contains only numbers and time."""
    return node.free_symbols <= {t} and not node.has(AppliedUndef)


def _replaced(node: Any) -> bool:
    return node.is_Add or (isinstance(node, (sympy.Function, sympy.Piecewise)) and _own(node))


def _without(node: Any) -> Any:
    if not node.is_Add:
        return sympy.S.One
    left = [term for term in node.args if not _own(term)]
    return sympy.Add(*left) if left else sympy.S.One
