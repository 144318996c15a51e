"""Write a sum of monomials the way a book sets it: like motions together, their coefficients factored."""

from __future__ import annotations

from typing import Any

import sympy
from sympy import Add, Mul, S

from lagrange.equations.cancelling import cancelled, shortened
from lagrange.equations.monomials import ONE, Monomial, MonomialSum, common_factor
from lagrange.equations.terms import Algebra

FACTORED_TERMS = 16
"""Longer polynomials are not factored: a polynomial this long takes SymPy a few milliseconds."""
WORTHWHILE = 0.75
"""A factored coefficient replaces its expanded form when it has at most this share of its operations."""
WRITING = 5
"""What writing a term costs, in monomials of the algebra's budget, beside the size of its factors."""
LONGER_SUM = 1.4
"""A quotient stays a sum of quotients up to this many times the operations of a single fraction."""

_BESIDE = sympy.Dummy("motion")


class Collector:
    """Writes `MonomialSum` of one algebra.

    `moving` are the symbols that vary: the positions, velocities, accelerations and time.
    """

    def __init__(self, algebra: Algebra, positions: frozenset[Any], moving: frozenset[Any]) -> None:
        self.algebra = algebra
        self.positions = positions
        self.moving = moving
        self._factored: dict[Any, Any] = {}

    def write(self, terms: MonomialSum) -> Any:
        """Return the sum, grouped by velocities, accelerations and functions, in each group by coordinates."""
        self.algebra.spend(sum(WRITING + self.algebra.size(monomial) for monomial in terms))
        groups: dict[Monomial, dict[Monomial, MonomialSum]] = {}
        for monomial, number in terms.items():
            outer, place, constant = self._split(monomial)
            groups.setdefault(outer, {}).setdefault(place, {})[constant] = number
        return Add(*(self._group(inner, outer) for outer, inner in groups.items()))

    def quotient(self, above: MonomialSum, below: MonomialSum) -> Any:
        """Return above / below, the factors that all terms share cancelled: a sum or one fraction, the shorter."""
        outside, rest = self._factors(shortened(self.algebra, below))
        above = shortened(self.algebra, self.algebra.divide(above, outside))
        divided = self.write(above)
        outside, above = self._factors(above)
        above, rest = cancelled(above, rest)
        ((monomial, number),) = outside.items()
        roots = tuple((k, e) for k, e in monomial if e < 0 and self.algebra.factors[k].is_Add)
        above = shortened(self.algebra, self.algebra.multiply(above, {roots: S.One}))
        numerator = self._together(self.write(above))
        if len(above) == 2 and numerator.could_extract_minus_sign():
            number, numerator = -number, -numerator
        common = self.algebra.power(tuple(factor for factor in monomial if factor not in roots))
        fraction = Mul(number, common, numerator, 1 / self._together(self.write(rest)))
        one_term = rest == {ONE: S.One}
        return divided if one_term and divided.count_ops() <= LONGER_SUM * fraction.count_ops() else fraction

    def _factors(self, terms: MonomialSum) -> tuple[MonomialSum, MonomialSum]:
        """Return the one-term common factor and the rest, in which sums that are now whole powers are expanded."""
        number, monomial, rest = common_factor(terms)
        unfolded = self.algebra.merge_angles(self.algebra.unfold(rest))
        more, beside, rest = common_factor(unfolded)
        return self.algebra.multiply({monomial: number}, {beside: more}), rest

    def _split(self, monomial: Monomial) -> tuple[Monomial, Monomial, Monomial]:
        outer, place, constant = [], [], []
        for k, e in monomial:
            if not self.algebra.free(k) & self.moving:
                constant.append((k, e))
            elif self.algebra.factors[k] in self.positions and isinstance(e, int) and e > 0:
                place.append((k, e))
            else:
                outer.append((k, e))
        return tuple(outer), tuple(place), tuple(constant)

    def _group(self, inner: dict[Monomial, MonomialSum], outer: Monomial) -> Any:
        motion = self.algebra.power(outer)
        expanded = Add(*(Mul(*self._coefficient(part), self.algebra.power(place)) for place, part in inner.items()))
        if len(inner) == 1:
            ((place, part),) = inner.items()
            return Mul(*self._coefficient(part), self.algebra.power(place), motion)
        whole = {
            tuple(sorted(place + constant)): number
            for place, part in inner.items()
            for constant, number in part.items()
        }
        coefficient = self._coefficient(whole)
        sign = -1 if coefficient[0].is_negative else 1
        short, long = Mul(sign, *coefficient, _BESIDE), Mul(sign * expanded, _BESIDE)
        if short.count_ops() <= WORTHWHILE * long.count_ops():
            return Mul(*coefficient, motion)
        return Mul(expanded, motion)

    def _coefficient(self, terms: MonomialSum) -> tuple[Any, Any, Any]:
        """Return number, monomial and rest, to be multiplied at once: SymPy distributes a number over a lone sum."""
        number, monomial, rest = common_factor(terms)
        written = self._factor(rest)
        if len(rest) == 2 and written.could_extract_minus_sign():
            number, written = -number, -written
        return number, self.algebra.power(monomial), written

    def _factor(self, rest: MonomialSum) -> Any:
        expression = self.algebra.write(rest)
        if not 2 < len(rest) <= FACTORED_TERMS or max(sum(abs(e) for _, e in monomial) for monomial in rest) < 2:
            return expression
        if expression not in self._factored:
            polynomial = all(isinstance(e, int) and e > 0 for monomial in rest for _, e in monomial)
            self._factored[expression] = sympy.factor(expression) if polynomial else expression
        return self._factored[expression]

    def _together(self, expression: Any) -> Any:
        """Return a sum with the factors that all its terms share taken out."""
        if not expression.is_Add:
            return expression
        powers = [part.as_powers_dict() for part in expression.args]
        outside = Mul(*(base ** min(power[base] for power in powers) for base in powers[0] if _shared(base, powers)))
        return outside * Add(*(part / outside for part in expression.args))


def _shared(base: Any, powers: list[Any]) -> bool:
    """Whether a sum in parentheses is a factor, to a positive integer power, of every term."""
    return bool(base.is_Add) and all(base in power and power[base].is_Integer and power[base] > 0 for power in powers)
