"""Shorten and write sums of monomials as a textbook would: common factors cancel, terms are grouped by velocities."""

from __future__ import annotations

from collections.abc import Sequence
from math import lcm, prod
from typing import Any

import sympy
from sympy import QQ, Add, Integer, Mul, Rational, S, ring

from lagrange.equations.terms import ONE, Algebra, Monomial, MonomialSum, common_factor, raise_power

LONGEST_DENOMINATOR = 12
"""Largest number of terms of a denominator for which a common factor with the numerator is searched."""
LARGEST_DEGREE = 5000
"""Largest product of (degree + 1) over all variables for which a common factor of numerator and denominator is
searched. The search uses integers with about as many digits as this product.
"""
LONGEST_SUM = 6  # Largest number of terms of a sum in parentheses that is expanded, or used as a divisor, on trial
HIGHEST = 3  # Largest difference of the powers of a sum in parentheses in terms that are merged


def cancelled(above: MonomialSum, below: MonomialSum) -> tuple[MonomialSum, MonomialSum]:
    """Return the numerator `above` and the denominator `below` of a fraction without their common factor.

    The caller has already taken out every factor that divides all of `below`. Long fractions are returned unchanged.
    """
    variables = _Variables([above, below])
    parts = _parts(above, below)
    short = all(len(part) > 1 for part in parts) and 1 < len(below) <= LONGEST_DENOMINATOR
    if not short or not variables.usable or _Variables([below, *parts]).degree > LARGEST_DEGREE:
        return above, below
    shared = variables.polynomial(below)
    for part in sorted(parts, key=len):
        shared = shared.gcd(variables.polynomial(part))
        if shared.is_ground:
            return above, below
    first, second = (variables.polynomial(terms).exquo(shared) for terms in (above, below))
    return variables.terms(first), variables.terms(second)


def _parts(above: MonomialSum, below: MonomialSum) -> list[MonomialSum]:
    """Return the sums that every common factor of numerator `above` and denominator `below` must divide.

    These sums are the coefficients of `above` as a polynomial in the factors that do not occur in `below`.
    """
    common = {k for monomial in below for k, _ in monomial}
    parts: dict[Monomial, MonomialSum] = {}
    for monomial, number in above.items():
        outside = tuple(pair for pair in monomial if pair[0] not in common)
        parts.setdefault(outside, {})[tuple(pair for pair in monomial if pair[0] in common)] = number
    return list(parts.values())


def shortened(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return the sum `terms`, shortened by multiplying out powers of sums in parentheses and merging like terms.

    A factor such as (x + y) is multiplied out only if fewer terms result.
    """
    sums = list(dict.fromkeys(k for monomial in terms for k, _ in monomial if algebra.factors[k].is_Add))
    for k in sums:
        if len(algebra.factors[k].args) <= LONGEST_SUM and _is_worthwhile(algebra, terms, k):
            terms = _merge_powers(algebra, terms, k)
    return terms


def _is_worthwhile(algebra: Algebra, terms: MonomialSum, k: int) -> bool:
    """Return True if merging terms with powers of factor `k` of the algebra, a sum, may shorten the sum `terms`.

    It may in three cases: the exponents of the factor differ between terms; an exponent is whole, so that the power can
    be multiplied out; or at least as many terms contain the factor as the factor has terms.
    """
    exponents = [powers[k] for powers in map(dict, terms) if k in powers]
    several = len(set(exponents)) > 1 or any(isinstance(exponent, int) for exponent in exponents)
    return several or len(exponents) >= len(algebra.read(algebra.factors[k]))


def _merge_powers(algebra: Algebra, terms: MonomialSum, k: int) -> MonomialSum:
    """Return the sum `terms`, shortened by merging terms that contain different powers of one factor.

    The factor is a sum such as s = x + y, and has the index `k` in the algebra. Terms that differ only in powers of s,
    x and y are merged if fewer terms result: x/s + y/s becomes 1.
    """
    inside = algebra.free(k)
    groups: dict[Any, MonomialSum] = {}
    for monomial, number in terms.items():
        exponent = dict(monomial).get(k, 0)
        rest = tuple(pair for pair in monomial if pair[0] != k and algebra.factors[pair[0]] not in inside)
        groups.setdefault((rest, exponent - int(exponent // 1)), {})[monomial] = number
    return algebra.add({}, *(_factor_out(algebra, group, k) for group in groups.values()))


def _factor_out(algebra: Algebra, group: MonomialSum, k: int) -> MonomialSum:
    """Return the terms `group` with the lowest power of factor `k` of the algebra, a sum, taken out.

    The rest is multiplied out. The terms are returned unchanged if there would not be fewer of them.
    """
    exponents = [dict(monomial).get(k, 0) for monomial in group]
    lowest, highest = min(exponents), max(exponents)
    if len(group) < 2 or lowest >= 1 or highest - lowest > HIGHEST:
        return group
    base = algebra.read(algebra.factors[k])
    expanded: MonomialSum = {}
    for monomial, number in group.items():
        product: MonomialSum = {tuple(pair for pair in monomial if pair[0] != k): number}
        for _ in range(int(dict(monomial).get(k, 0) - lowest)):
            product = algebra.multiply(product, base)
        expanded = algebra.add(expanded, product)
    while lowest < 0 and len(expanded) > 1 and (quotient := _exact_quotient(expanded, base)) is not None:
        expanded, lowest = quotient, lowest + 1
    if len(expanded) >= len(group):
        return group
    return algebra.multiply(expanded, {((k, lowest),): Integer(1)} if lowest else {(): Integer(1)})


def _exact_quotient(terms: MonomialSum, base: MonomialSum) -> MonomialSum | None:
    """Return the quotient of the sums `terms` and `base`, or None if the division has a remainder."""
    number, monomial, rest = common_factor(terms)
    variables = _Variables([rest, base])
    if not variables.usable:
        return None
    quotient, remainder = divmod(variables.polynomial(rest), variables.polynomial(base))
    if remainder:
        return None
    joined: MonomialSum = {}
    for left, value in variables.terms(quotient).items():
        powers = dict(left)
        for k, e in monomial:
            raise_power(powers, k, e)
        joined[tuple(sorted(powers.items()))] = value * number
    return joined


class _Variables:
    """Translator of sums of monomials into SymPy polynomials and back.

    Each factor becomes a variable. For a factor x with an exponent such as 1/2, the variable is sqrt(x). The lowest
    power of each factor is taken out of all sums first, so that no exponent is negative.
    """

    def __init__(self, sums: Sequence[MonomialSum]) -> None:
        self.factors = sorted({k for terms in sums for monomial in terms for k, _ in monomial})
        powers = {k: [dict(monomial).get(k, 0) for terms in sums for monomial in terms] for k in self.factors}
        self.roots = {k: lcm(*(int(Rational(e).q) for e in powers[k])) for k in self.factors}
        self.lowest = {k: min(0, *powers[k]) for k in self.factors}
        self.degrees = {k: int((max(0, *powers[k]) - self.lowest[k]) * self.roots[k]) + 1 for k in self.factors}
        self.usable = bool(self.factors) and all(value.is_Rational for terms in sums for value in terms.values())
        self.ring: Any = ring([f"f{k}" for k in self.factors], QQ)[0] if self.usable else None

    @property
    def degree(self) -> int:
        """Product of (largest degree + 1) over all variables, a bound on the number of terms of a polynomial."""
        return prod(self.degrees.values())

    def polynomial(self, terms: MonomialSum) -> Any:
        """Return a sum of monomials as a SymPy polynomial, with the lowest power of each factor taken out."""
        coefficients = {}
        for monomial, value in terms.items():
            powers = dict(monomial)
            key = tuple(int((powers.get(k, 0) - self.lowest[k]) * self.roots[k]) for k in self.factors)
            coefficients[key] = QQ(int(value.p), int(value.q))
        return self.ring.from_dict(coefficients)

    def terms(self, polynomial: Any) -> MonomialSum:
        """Return a SymPy polynomial, a quotient of two results of the method `polynomial`, as a sum of monomials.

        That method takes the same powers of factors out of both results, so they cancel in the quotient.
        """
        result: MonomialSum = {}
        for exponents, value in polynomial.terms():
            powers = [(k, Rational(e, self.roots[k])) for k, e in zip(self.factors, exponents, strict=True) if e != 0]
            monomial = tuple((k, int(e) if e.is_Integer else e) for k, e in powers)
            result[monomial] = Rational(int(value.numerator), int(value.denominator))
        return result


FACTORED_TERMS = 16
"""Largest number of terms of a polynomial that is factored. SymPy takes a few milliseconds for 16 terms."""
WORTHWHILE = 0.75
"""Largest ratio (operations in factored form) / (operations in expanded form) at which a coefficient is written in
factored form."""
WRITING = 5
"""Cost of writing a term, in monomials of the algebra's budget, in addition to the size of its factors."""
LONGER_SUM = 1.4
"""Largest ratio (operations in a sum) / (operations in one fraction) at which a quotient is written as a sum."""

_BESIDE = sympy.Dummy("motion")


class SumWriter:
    """Writer of sums of monomials (`MonomialSum`) of one algebra as SymPy expressions.

    `positions` are the symbols of the coordinates. `moving` are the symbols that vary in time: positions, velocities,
    accelerations and the time.
    """

    def __init__(self, algebra: Algebra, positions: frozenset[Any], moving: frozenset[Any]) -> None:
        self.algebra = algebra
        self.positions = positions
        self.moving = moving
        self._factored: dict[Any, Any] = {}

    def write(self, terms: MonomialSum) -> Any:
        """Return a sum as an expression, grouped by velocities, accelerations and functions, then by coordinates."""
        self.algebra.spend(sum(WRITING + self.algebra.size(monomial) for monomial in terms))
        groups: dict[Monomial, dict[Monomial, MonomialSum]] = {}
        for monomial, number in terms.items():
            outer, position, constant = self._split(monomial)
            groups.setdefault(outer, {}).setdefault(position, {})[constant] = number
        return Add(*(self._group(inner, outer) for outer, inner in groups.items()))

    def quotient(self, above: MonomialSum, below: MonomialSum) -> Any:
        """Return above / below with common factors cancelled, as a sum or as one fraction, whichever is shorter."""
        outside, rest = self._factors(shortened(self.algebra, below))
        above = shortened(self.algebra, self.algebra.divide(above, outside))
        divided = self.write(above)
        # The set has one element if all terms have the same denominator, as r in -(2*v*w + g*sin(q))/r
        denominators = {tuple((k, e) for k, e in m if e < 0 and self.algebra.free(k) & self.moving) for m in above}
        divisible = divided.is_Add and len(denominators) == 1 and () not in denominators
        outside, above = self._factors(above)
        above, rest = cancelled(above, rest)
        ((monomial, number),) = outside.items()
        roots = tuple((k, e) for k, e in monomial if e < 0 and self.algebra.factors[k].is_Add)
        above = shortened(self.algebra, self.algebra.multiply(above, {roots: S.One}))
        numerator = self._take_out_sums(self.write(above))
        if len(above) == 2 and numerator.could_extract_minus_sign():
            number, numerator = -number, -numerator
        common = self.algebra.power(tuple(factor for factor in monomial if factor not in roots))
        fraction = Mul(number, common, numerator, 1 / self._take_out_sums(self.write(rest)))
        one_term = rest == {ONE: S.One}
        apart = one_term and not divisible and divided.count_ops() <= LONGER_SUM * fraction.count_ops()
        return divided if apart else fraction

    def _factors(self, terms: MonomialSum) -> tuple[MonomialSum, MonomialSum]:
        """Return the common factor of all terms, as a sum of one term, and the rest with powers of sums expanded."""
        number, monomial, rest = common_factor(terms)
        unfolded = self.algebra.merge_angles(self.algebra.unfold(rest))
        more, extracted, rest = common_factor(unfolded)
        return self.algebra.multiply({monomial: number}, {extracted: more}), rest

    def _split(self, monomial: Monomial) -> tuple[Monomial, Monomial, Monomial]:
        outer, position, constant = [], [], []
        for k, e in monomial:
            if not self.algebra.free(k) & self.moving:
                constant.append((k, e))
            elif self.algebra.factors[k] in self.positions and isinstance(e, int) and e > 0:
                position.append((k, e))
            else:
                outer.append((k, e))
        return tuple(outer), tuple(position), tuple(constant)

    def _group(self, inner: dict[Monomial, MonomialSum], outer: Monomial) -> Any:
        outer_factors = self.algebra.power(outer)
        expanded = Add(
            *(Mul(*self._coefficient(part), self.algebra.power(position)) for position, part in inner.items())
        )
        if len(inner) == 1:
            ((position, part),) = inner.items()
            return Mul(*self._coefficient(part), self.algebra.power(position), outer_factors)
        whole = {
            tuple(sorted(position + constant)): number
            for position, part in inner.items()
            for constant, number in part.items()
        }
        coefficient = self._coefficient(whole)
        sign = -1 if coefficient[0].is_negative else 1
        short, long = Mul(sign, *coefficient, _BESIDE), Mul(sign * expanded, _BESIDE)
        if short.count_ops() <= WORTHWHILE * long.count_ops():
            return Mul(*coefficient, outer_factors)
        return Mul(expanded, outer_factors)

    def _coefficient(self, terms: MonomialSum) -> tuple[Any, Any, Any]:
        """Return SymPy expressions (number, monomial, rest) whose product is the sum.

        The caller multiplies all three in one call. Otherwise SymPy distributes the number over the sum.
        """
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

    def _take_out_sums(self, expression: Any) -> Any:
        """Return a sum with shared factors that are sums taken out: x*(a + b) + y*(a + b) becomes (a + b)*(x + y)."""
        if not expression.is_Add:
            return expression
        powers = [part.as_powers_dict() for part in expression.args]
        shared = [
            base
            for base in powers[0]
            if base.is_Add and all(base in power and power[base].is_Integer and power[base] > 0 for power in powers)
        ]
        outside = Mul(*(base ** min(power[base] for power in powers) for base in shared))
        return outside * Add(*(part / outside for part in expression.args))
