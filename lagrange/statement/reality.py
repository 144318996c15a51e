"""All that a statement contains is real, which SymPy is not told of a function of time.

SymPy makes exp(re(x(t))) of Abs(exp(x(t))), and differentiates Abs(x(t)) to a formula in re(x(t)) and im(x(t)). Here
these are evaluated with real symbols in the places of functions and parameters.
"""

from __future__ import annotations

from typing import Any

import sympy
from sympy.core.function import AppliedUndef

_PARTS = (sympy.re, sympy.im, sympy.conjugate)


def real(expression: Any) -> Any:
    """Return the expression without real and imaginary parts, as far as what is in them is real."""
    if not expression.has(*_PARTS):
        return expression
    parts = sorted(expression.atoms(*_PARTS), key=lambda part: (sympy.count_ops(part), str(part)))
    known: dict[Any, Any] = {}
    for part in parts:  # the inner ones first: they stand in the outer ones
        known[part.xreplace(known)] = known[part] = _evaluated(part.xreplace(known))
    made = expression.xreplace(known)
    return made.replace(
        lambda node: isinstance(node, sympy.Derivative) and not isinstance(node.expr, AppliedUndef),
        lambda node: node.doit(deep=False),
    )


def _evaluated(part: Any) -> Any:
    """Return re(...), im(...) or conjugate(...) of what is real, where a real symbol stands for each name."""
    names = [*part.atoms(AppliedUndef, sympy.Derivative), *part.free_symbols]
    stand_ins = {name: sympy.Dummy(real=True) for name in sorted(names, key=str) if not name.is_real}
    return part.xreplace(stand_ins).xreplace({symbol: name for name, symbol in stand_ins.items()})
