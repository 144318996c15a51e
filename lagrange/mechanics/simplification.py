"""The shortest of a few forms of an expression; each is exact, and none is tried on what is long."""

from __future__ import annotations

import math
from typing import Any

import sympy

from lagrange.equations.terms import Algebra, TooLargeError

LONGEST_FACTORED = 400
"""Operations up to which an expression is multiplied out and factored; that many take SymPy some 0.2 s."""

MOST_SYMBOLS = 12
"""Symbols, functions and roots of an expression up to which it is factored: polynomials in more take long."""

MERGED_TERMS = 20_000
"""Products that merging sines and cosines may take, some 0.2 s."""

LARGEST_FRACTION = 10
"""Numerator and denominator of a fraction that is shown as one, where decimals were given."""

_ANGLES = (sympy.sin, sympy.cos, sympy.tan)
_INVERSES = (sympy.asin, sympy.acos, sympy.atan)


def simplest(given: Any) -> Any:
    """Return the form of an expression with the fewest operations, of those that are tried."""
    if not given.args or given.is_Piecewise or given.has(sympy.Piecewise):
        return given
    if given.has(sympy.Float):  # polynomials of decimals have no factors
        return in_decimals(simplest(in_fractions(given)))
    best = given
    few = _generators(best) <= MOST_SYMBOLS
    if size(best) <= LONGEST_FACTORED:
        best = min((best, sympy.expand(best), sympy.factor_terms(best)), key=size)
        if few:
            best = min((best, sympy.factor(best)), key=size)
    if any(f.args[0].has(*_INVERSES) for f in best.atoms(*_ANGLES)):
        best = min((best, sympy.expand_trig(best), sympy.factor(sympy.expand_trig(best))), key=size)
    if best.has(*_ANGLES) and size(best) <= LONGEST_FACTORED:
        merged = _merged(best)
        best = min((best, merged, sympy.factor(merged) if few else sympy.factor_terms(merged)), key=size)
    return best


def rational_below(given: Any) -> Any:
    """Return an expression with square roots out of its denominator; as it is where that is long or roots are nested.

    A root r of a base b is a symbol with r^2 = b, and the fraction is multiplied by the conjugate of its denominator.
    """
    powers = [x for x in sorted(given.atoms(sympy.Pow), key=str) if x.exp.is_Rational and x.exp.q == 2]
    roots = {base: sympy.Dummy("r") for base in dict.fromkeys(x.base for x in powers)}
    nested = any(base.has(*powers) for base in roots) if powers else True
    if nested or size(given) > LONGEST_FACTORED or _generators(given) > MOST_SYMBOLS:
        return given
    put = given.xreplace({x: roots[x.base] ** x.exp.p for x in powers})
    above, below = sympy.fraction(sympy.together(put))
    for base, root in roots.items():
        if below.has(root):
            conjugate = below.xreplace({root: -root})
            above, below = above * conjugate, below * conjugate
        above, below = (sympy.rem(sympy.expand(x), root**2 - base, root) for x in (above, below))
    short = sympy.factor(sympy.cancel(above / below))
    return short.xreplace({root: sympy.sqrt(base) for base, root in roots.items()})


def root_of_square(given: Any) -> Any:
    """Return a square root, what is a square in roots of positive symbols taken out of it.

    Of a - 2 sqrt(a b) + b, which is a polynomial in sqrt(a) and sqrt(b), it is the distance of these two.
    """
    powers = [x for x in given.atoms(sympy.Pow) if x.base.is_Symbol and x.base.is_positive and x.exp.is_Rational]
    bases = sorted({x.base for x in powers if not x.exp.is_Integer}, key=str)
    if not bases or size(given) > LONGEST_FACTORED or _generators(given) > MOST_SYMBOLS:
        return sympy.sqrt(given)
    degree = {base: math.lcm(*(x.exp.q for x in powers if x.base == base)) for base in bases}
    roots = {base: sympy.Dummy(base.name, positive=True) for base in bases}
    table = {x: roots[x.base] ** (x.exp * degree[x.base]) for x in powers if x.base in roots}
    table |= {base: root ** degree[base] for base, root in roots.items()}
    found = sympy.sqrt(sympy.factor(given.xreplace(table)))
    return found.xreplace({root: base ** sympy.Rational(1, degree[base]) for base, root in roots.items()})


def in_fractions(given: Any) -> Any:
    """Return an expression with its decimals as the fractions that they are written as: 0.1 is one tenth."""
    decimals = sorted(given.atoms(sympy.Float), key=str)
    return given.xreplace({x: sympy.Rational(repr(float(x))) for x in decimals})


def in_decimals(given: Any) -> Any:
    """Return an expression with decimals for fractions that are longer than eighths."""
    fractions = [x for x in sorted(given.atoms(sympy.Rational), key=str) if max(abs(x.p), x.q) > LARGEST_FRACTION]
    return given.xreplace({x: sympy.Float(float(x)) for x in fractions if x.q > 1})


def _merged(given: Any) -> Any:
    """Return an expression with sin^2 + cos^2 = 1 and the addition theorems put in, above and below the fraction."""
    above, below = sympy.fraction(sympy.together(given))
    algebra = Algebra(MERGED_TERMS)
    try:
        above, below = (algebra.write(algebra.merge_angles(algebra.read(part))) for part in (above, below))
    except TooLargeError:
        return given
    return above / below


def _generators(given: Any) -> int:
    """Return how many symbols, functions and roots an expression is made of."""
    roots = [power for power in given.atoms(sympy.Pow) if not power.exp.is_Integer]
    return len(given.free_symbols) + len(given.atoms(*_ANGLES)) + len(roots)


def size(given: Any) -> int:
    """Return the number of operations of an expression."""
    return int(sympy.count_ops(given))


def is_zero(given: Any) -> bool:
    """Return whether SymPy sees that an expression vanishes identically."""
    if given.is_zero is not None:
        return bool(given.is_zero)
    short = simplest(given)
    return bool(short.is_zero)
