"""Monomials as sorted factor numbers with exponents, and sums of them: the data of the textbook derivation."""

from __future__ import annotations

from math import gcd, lcm
from typing import Any

from sympy import Rational, S

Monomial = tuple[tuple[int, Any], ...]
"""Factor numbers with their exponents (int or Rational), sorted by number."""

MonomialSum = dict[Monomial, Any]
"""A sum: its monomials, each with a SymPy number."""

ONE: Monomial = ()


def raise_power(powers: dict[int, Any], factor: int, by: Any) -> None:
    """Multiply by a factor to a power, in place; whole exponents are ints."""
    total = powers.get(factor, 0) + by
    if total == 0:
        del powers[factor]
    else:
        powers[factor] = int(total) if total == int(total) else total


def accumulate(terms: MonomialSum, monomial: Monomial, number: Any) -> None:
    """Add number * monomial, in place; a sum has no zeros."""
    total = terms.get(monomial, S.Zero) + number
    if total == 0:
        terms.pop(monomial, None)
    else:
        terms[monomial] = total


def common_factor(terms: MonomialSum) -> tuple[Any, Monomial, MonomialSum]:
    """Return (number, monomial, rest) with terms = number * monomial * rest, the rest in smallest integers."""
    if not terms:
        return S.One, ONE, terms
    number = Rational(
        gcd(*(int(value.p) for value in terms.values())), lcm(*(int(value.q) for value in terms.values()))
    )
    if all(value.is_negative for value in terms.values()):
        number = -number
    monomials = iter(terms)
    lowest = dict(next(monomials))
    for monomial in monomials:
        powers = dict(monomial)
        lowest = {k: min(lowest.get(k, 0), powers.get(k, 0)) for k in {**lowest, **powers}}
    shared = tuple(sorted((k, e) for k, e in lowest.items() if e != 0))
    rest: MonomialSum = {}
    for monomial, value in terms.items():
        powers = dict(monomial)
        for k, e in shared:
            powers[k] = powers.get(k, 0) - e
        rest[tuple(sorted((k, e) for k, e in powers.items() if e != 0))] = value / number
    return number, shared, rest
