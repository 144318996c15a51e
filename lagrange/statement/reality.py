"""Removal of real and imaginary parts: all quantities of a statement are real, but SymPy's functions of time are not.

SymPy turns Abs(exp(x(t))) into exp(re(x(t))), and differentiates Abs(x(t)) to a formula in re(x(t)) and im(x(t)). This
module evaluates such parts with real symbols in place of functions and parameters.
"""

from __future__ import annotations

from typing import Any

import sympy
from sympy.core.function import AppliedUndef

_PARTS = (sympy.re, sympy.im, sympy.conjugate)


def real(expression: Any) -> Any:
    """Return the expression with re, im and conjugate evaluated for real functions and parameters."""
    if not expression.has(*_PARTS):
        return expression
    parts = sorted(expression.atoms(*_PARTS), key=lambda part: (sympy.count_ops(part), str(part)))
    known: dict[Any, Any] = {}
    for part in parts:  # inner ones first: the outer ones contain them
        known[part.xreplace(known)] = known[part] = _evaluated(part.xreplace(known))
    replaced = expression.xreplace(known)
    return replaced.replace(
        lambda node: isinstance(node, sympy.Derivative) and not isinstance(node.expr, AppliedUndef),
        lambda node: node.doit(deep=False),
    )


def _evaluated(part: Any) -> Any:
    """Return re(...), im(...) or conjugate(...) evaluated with a real symbol in place of each name."""
    names = [*part.atoms(AppliedUndef, sympy.Derivative), *part.free_symbols]
    stand_ins = {name: sympy.Dummy(real=True) for name in sorted(names, key=str) if not name.is_real}
    return part.xreplace(stand_ins).xreplace({symbol: name for name, symbol in stand_ins.items()})
