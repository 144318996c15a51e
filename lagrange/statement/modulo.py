"""Remainders: Mod(a, p) as an angle by atan2, which has the derivative of a and jumps at multiples of p."""

from __future__ import annotations

from typing import Any

import sympy
from sympy.core.function import AppliedUndef


def modulo(dividend: Any, divisor: Any) -> Any:
    """Return Mod(dividend, divisor), which has the sign of the divisor, in sines and an arctangent."""
    angle = 2 * sympy.pi * dividend / divisor
    return divisor / 2 + divisor * sympy.atan2(-sympy.sin(angle), -sympy.cos(angle)) / (2 * sympy.pi)


def without_modulo(expression: Any) -> Any:
    """Return the expression with every Mod, such as x % 2, replaced by `modulo`."""
    if not expression.has(sympy.Mod):
        return expression
    known: dict[Any, Any] = {}
    # Inner ones first: the outer ones contain them.
    for part in sorted(expression.atoms(sympy.Mod), key=lambda part: (sympy.count_ops(part), str(part))):
        known[part] = modulo(*(argument.xreplace(known) for argument in part.args))
    return expression.xreplace(known).replace(
        lambda node: isinstance(node, sympy.Derivative) and not isinstance(node.expr, AppliedUndef),
        lambda node: node.doit(deep=False),
    )
