"""Proofs that a sum of monomials is zero for all values of its symbols.

Roots and quotients are multiplied out. Sines and cosines of sums and multiples become those of their smallest parts.
Even powers of sines are written in cosines. The result is a polynomial in nearly independent factors: if all its
coefficients are zero, so is the sum. A sum that is not reduced to zero may still vanish: it stays undecided.
"""

from __future__ import annotations

from math import gcd, lcm
from typing import Any

import sympy
from sympy import Dummy, Rational, S

from lagrange.equations.terms import ONE, Algebra, MonomialSum, TooLargeError, accumulate

ROUNDS = 6
"""Most rounds of multiplying out roots and quotients; each removes one level of nesting."""

LARGEST = 40_000
"""Most monomials of one proof: half a second."""

_SQUARES = {sympy.sin: (sympy.cos, -1), sympy.cosh: (sympy.sinh, 1)}
"""f**2 = 1 + sign * g**2 by function."""


def is_identity(algebra: Algebra, terms: MonomialSum) -> bool:
    """Return True if the sum is proven to be zero; False if no proof was found."""
    try:
        with algebra.at_most(LARGEST):
            return not canonical(algebra, terms)
    except TooLargeError:
        return False


def canonical(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return a reduced multiple of the sum, which is empty if the sum is proven to be zero."""
    terms = algebra.merge_angles(terms)
    for _ in range(ROUNDS):
        if not terms:
            break
        before = terms
        terms = _polynomial(algebra, _with_least_angles(algebra, _cleared(algebra, terms)))
        if terms == before:
            break
    return terms


def _cleared(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return the sum times its denominators, with sums to whole powers expanded."""
    lowest: dict[int, Any] = {}
    for monomial in terms:
        for k, e in monomial:
            if _composite(algebra.factors[k]):
                lowest[k] = min(lowest.get(k, 0), e)
    cleared: MonomialSum = {}
    for monomial, number in terms.items():
        powers = dict(monomial)
        product: MonomialSum = {
            tuple((k, e) for k, e in monomial if k not in lowest): number,
        }
        for k, least in lowest.items():
            total = powers.get(k, 0) - least
            whole = int(total // 1)
            if total != whole:
                product = algebra.multiply(product, {((k, Rational(total) - whole),): S.One})
            product = _times(algebra, product, k, whole)
        for new, value in product.items():
            accumulate(cleared, new, value)
    return cleared


def _composite(factor: Any) -> bool:
    return bool(factor.is_Add or isinstance(factor, (sympy.sin, sympy.cos, sympy.sinh, sympy.cosh, sympy.tan)))


def _times(algebra: Algebra, product: MonomialSum, k: int, exponent: int) -> MonomialSum:
    """Return the product times a factor to a power of at least zero; a factor that is a sum is multiplied out."""
    factor = algebra.factors[k]
    if not exponent:
        return product
    if not factor.is_Add:
        return algebra.multiply(product, {((k, exponent),): S.One})
    inner = algebra.add({}, *(algebra.read(part) for part in factor.args))
    for _ in range(exponent):
        product = algebra.multiply(product, inner)
    return product


def _with_least_angles(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return the sum with sines and cosines of sums and multiples in terms of those of the smallest parts."""
    present = dict.fromkeys(k for monomial in terms for k, _ in monomial)
    angles = [k for k in present if isinstance(algebra.factors[k], (sympy.sin, sympy.cos, sympy.tan))]
    units = _units([algebra.factors[k].args[0] for k in angles])
    table = {k: _expanded(algebra, algebra.factors[k], units) for k in angles}
    table = {k: new for k, new in table.items() if new != algebra.factors[k]}
    if not table:
        return terms
    result: MonomialSum = {}
    for monomial, number in terms.items():
        product: MonomialSum = {tuple(factor for factor in monomial if factor[0] not in table): number}
        for k, e in monomial:
            if k in table:
                above, below = table[k].as_numer_denom()
                for part, power in ((above, e), (below, -e)):
                    product = algebra.multiply(product, algebra.read(part**power))
        for new, value in product.items():
            accumulate(result, new, value)
    return result


def _units(arguments: list[Any]) -> dict[Any, Any]:
    """Return the smallest part of each kind of angle: all of the arguments have whole multiples of it."""
    shares: dict[Any, list[Any]] = {}
    for argument in arguments:
        for part in sympy.Add.make_args(argument.expand()):
            number, rest = part.as_coeff_Mul()
            if number.is_Rational:
                shares.setdefault(rest, []).append(number)
    return {
        rest: Rational(gcd(*(int(n.p) for n in numbers)), lcm(*(int(n.q) for n in numbers)))
        for rest, numbers in shares.items()
    }


def _expanded(algebra: Algebra, function: Any, units: dict[Any, Any]) -> Any:
    """Return a function of an angle in sines and cosines of the smallest parts.

    The cosine of N x is a polynomial of degree N, made in about N^2 operations. The number of terms of a cosine of a
    sum is the product of those of its parts. Both costs are subtracted from the budget in advance.
    """
    symbols: dict[Any, Any] = {}
    argument, terms = S.Zero, 1
    for part in sympy.Add.make_args(function.args[0].expand()):
        number, rest = part.as_coeff_Mul()
        unit = rest * units[rest] if rest in units and number.is_Rational else part
        multiple = number / units.get(rest, number)
        argument += symbols.setdefault(unit, Dummy(real=True)) * multiple
        terms *= 1 + abs(int(multiple))
        algebra.spend(int(multiple) ** 2 + terms)
    expanded = function.func(argument)
    if isinstance(expanded, sympy.tan):
        expanded = sympy.sin(argument) / sympy.cos(argument)
    back = {symbol: unit for unit, symbol in symbols.items()}
    return sympy.expand_trig(expanded).xreplace(back)


def _polynomial(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return the sum with even powers of sines in cosines, and those of hyperbolic cosines in hyperbolic sines."""
    result: MonomialSum = {}
    for monomial, number in terms.items():
        product: MonomialSum = {ONE: number}
        for k, e in monomial:
            factor = algebra.factors[k]
            other = _SQUARES.get(factor.func)
            if other is None or not isinstance(e, int) or e < 2:
                product = algebra.multiply(product, {((k, e),): S.One})
                continue
            function, sign = other
            square = algebra.read(1 + sign * function(factor.args[0]) ** 2)
            for _ in range(e // 2):
                product = algebra.multiply(product, square)
            if e % 2:
                product = algebra.multiply(product, {((k, 1),): S.One})
        for new, value in product.items():
            accumulate(result, new, value)
    return result
