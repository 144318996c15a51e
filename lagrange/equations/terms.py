"""Arithmetic of sums of monomials in sines, cosines, powers and symbols, which textbook derivations and proofs use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache, reduce
from itertools import starmap
from math import gcd, lcm, prod
from typing import Any

import sympy
from sympy import Add, Expr, Function, Mul, Pow, Rational, S

Monomial = tuple[tuple[int, Any], ...]
"""Product of powers: pairs (index of a factor, exponent), sorted by index. Exponents are int or Rational."""

MonomialSum = dict[Monomial, Any]  # A sum: {monomial: SymPy number}

ONE: Monomial = ()


def raise_power(powers: dict[int, Any], factor: int, exponent: Any) -> None:
    """Multiply a monomial {index of a factor: exponent} by factor number `factor` to the power `exponent`, in place."""
    total = powers.get(factor, 0) + exponent
    if total == 0:
        del powers[factor]
    else:
        powers[factor] = int(total) if total == int(total) else total


def accumulate(terms: MonomialSum, monomial: Monomial, number: Any) -> None:
    """Add number * monomial to a sum, in place. Terms with the number zero are removed."""
    total = terms.get(monomial, S.Zero) + number
    if total == 0:
        terms.pop(monomial, None)
    else:
        terms[monomial] = total


def common_factor(terms: MonomialSum) -> tuple[Any, Monomial, MonomialSum]:
    """Return (number, monomial, rest), whose product is the sum. The rest has coprime integer coefficients."""
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


WIDEST_PRODUCT = 2000
"""Largest number of terms of a product of sums that is multiplied out. A chain of 30 links needs 900."""
SHORT_PRODUCT = 30
HIGHEST_POWER = 6

_CO = {sympy.sin: sympy.cos, sympy.cos: sympy.sin}


class TooLargeError(Exception):
    """Error: a sum has too many monomials for a proof, or for a person to read. Callers turn it into a message."""


class Magnitude(Function):
    """Function |x| of a real x, whose derivative is sign(x). SymPy's derivative of Abs has re(x) for a general x."""

    is_real = True

    def fdiff(self, argindex: int = 1) -> Any:
        """Return the derivative of |x|, which is sign(x)."""
        return Direction(self.args[0])


class _Flat(Function):
    """Base class of functions of a real x that jump. Their derivative is zero, so equations have no Dirac delta."""

    is_real = True

    def fdiff(self, argindex: int = 1) -> Any:
        """Return the derivative of this function, which is zero."""
        return S.Zero


class Direction(_Flat):
    """Function sign(x) of a real x, in place of SymPy's sign, whose derivative is a Dirac delta."""


class Step(_Flat):
    """Step function of a real x, in place of SymPy's Heaviside, whose derivative is a Dirac delta."""


def differentiable(expression: Any) -> Any:
    """Return the expression with Abs, sign, Heaviside, Min and Max in forms whose derivatives have no Dirac delta."""
    return _exchange(
        expression,
        {
            sympy.Abs: Magnitude,
            sympy.sign: Direction,
            sympy.Heaviside: Step,
            sympy.Max: lambda *numbers: reduce(lambda a, b: sympy.Piecewise((a, a >= b), (b, True)), numbers),
            sympy.Min: lambda *numbers: reduce(lambda a, b: sympy.Piecewise((a, a <= b), (b, True)), numbers),
        },
    )


def printable(expression: Any) -> Any:
    """Return the expression with Magnitude, Direction and Step replaced by SymPy's Abs, sign and Heaviside."""
    return _exchange(expression, {Magnitude: sympy.Abs, Direction: sympy.sign, Step: sympy.Heaviside})


def with_known_signs(expression: Any) -> Any:
    """Return the expression with |x|, sign(x) and steps evaluated where the sign of x is known: sign(0) becomes 0."""

    def is_known(node: Any) -> bool:
        return node.func in (Magnitude, Direction, Step) and not printable(node).has(
            sympy.Abs, sympy.sign, sympy.Heaviside
        )

    return expression.replace(is_known, printable)


def _exchange(expression: Any, table: Mapping[Any, Any]) -> Any:
    if not expression.has(*table):
        return expression
    return expression.replace(lambda node: node.func in table, lambda node: table[node.func](*node.args))


class Algebra:
    """Arithmetic on sums of monomials (`MonomialSum`). Monomials refer by index to one growing table of factors.

    A factor is a symbol, a function such as sin(x), or a sum in parentheses. `budget` is the number of monomials that
    may still be created. Operations raise TooLargeError beyond this number.
    """

    def __init__(self, budget: int) -> None:
        self.budget = budget
        self.factors: list[Any] = []
        self._numbers: dict[Any, int] = {}
        self._numeric: list[int] = []
        self._angles: dict[int, tuple[Any, Any]] = {}
        self._circle: dict[tuple[Any, Any], int] = {}
        self._directions: dict[int, tuple[int, int]] = {}
        self._sizes: list[int] = []
        self._free: list[frozenset[Any]] = []
        self._read: dict[Any, MonomialSum] = {}
        self._slopes: dict[tuple[int, Any], MonomialSum] = {}

    def read(self, expression: Any) -> MonomialSum:
        """Return the expression as a sum of monomials. Products of at most `WIDEST_PRODUCT` terms are expanded."""
        stored = self._read.get(expression)
        if stored is None:
            stored = self._read[expression] = self._read_new(expression)
        return stored

    def write(self, terms: MonomialSum) -> Any:
        """Return the sum of monomials as a SymPy sum, without grouping."""
        return Add(*(Mul(number, self.power(monomial)) for monomial, number in terms.items()))

    def power(self, monomial: Monomial) -> Any:
        """Return a monomial as a SymPy product."""
        return Mul(*(Pow(self.factors[k], e) for k, e in monomial))

    def size(self, monomial: Monomial) -> int:
        """Return the number of operations inside the factors of a monomial."""
        return sum(self._sizes[k] for k, _ in monomial)

    def free(self, number: int) -> frozenset[Any]:
        """Return the symbols in the factor with the index `number`."""
        return self._free[number]

    def add(self, *sums: MonomialSum) -> MonomialSum:
        """Return the sum of one or more sums, without terms that cancel."""
        total = dict(sums[0])
        for terms in sums[1:]:
            for monomial, number in terms.items():
                accumulate(total, monomial, number)
        return total

    def scale(self, terms: MonomialSum, number: Any) -> MonomialSum:
        """Return the sum `terms` times `number`, a SymPy number other than zero."""
        return {monomial: number * value for monomial, value in terms.items()}

    def multiply(self, a: MonomialSum, b: MonomialSum) -> MonomialSum:
        """Return the product of two sums, multiplied out."""
        self.spend(len(a) * len(b))
        product: MonomialSum = {}
        for left, x in a.items():
            for right, y in b.items():
                monomial, number = self._join(left, right)
                accumulate(product, monomial, x * y * number)
        return product

    def differentiate(self, terms: MonomialSum, symbol: Any) -> MonomialSum:
        """Return the partial derivative of a sum by a symbol."""
        result: MonomialSum = {}
        for monomial, number in terms.items():
            for k, e in monomial:
                if symbol in self._free[k]:
                    rest, _ = self._join(monomial, ((k, -1),))
                    for inner, slope in self._slope(k, symbol).items():
                        self.spend(1)
                        joined, scale = self._join(rest, inner)
                        accumulate(result, joined, number * e * slope * scale)
        return result

    def divide(self, terms: MonomialSum, divisor: MonomialSum) -> MonomialSum:
        """Return the sum divided by `divisor`, a sum of one term."""
        ((monomial, number),) = divisor.items()
        return self.multiply(terms, {tuple((k, -e) for k, e in monomial): 1 / number})

    def spend(self, amount: int) -> None:
        """Subtract `amount` monomials from the budget. Raises TooLargeError if the budget becomes negative."""
        self.budget -= amount
        if self.budget < 0:
            raise TooLargeError

    @contextmanager
    def at_most(self, amount: int) -> Iterator[None]:
        """Context manager that limits the budget to `amount` monomials inside the `with` block."""
        reserve = max(self.budget - amount, 0)
        self.budget -= reserve
        try:
            yield
        finally:
            self.budget = max(self.budget, 0) + reserve

    def unfold(self, terms: MonomialSum) -> MonomialSum:
        """Return the sum with whole positive powers of short sums expanded: a (x + y)**2 becomes a x**2 + ..."""

        def unfolded(monomial: Monomial, number: Any) -> MonomialSum:
            sums = [(k, e) for k, e in monomial if isinstance(e, int) and e > 0 and self.factors[k].is_Add]
            if prod(len(self.factors[k].args) ** e for k, e in sums) > SHORT_PRODUCT:
                sums = []
            product: MonomialSum = {tuple(factor for factor in monomial if factor not in sums): number}
            for k, e in sums:
                for _ in range(e):
                    product = self.multiply(product, self.read(self.factors[k]))
            return product

        return self.add({}, *starmap(unfolded, terms.items()))

    def merge_angles(self, terms: MonomialSum) -> MonomialSum:
        """Return the sum simplified by sin^2 + cos^2 = 1 and the addition theorems.

        Terms are replaced only if this lowers their number, or keeps their number and lowers their degree. So the
        replacements come to an end.
        """
        terms = dict(terms)
        changed = True
        while changed:
            changed = False
            for monomial in list(terms):
                if monomial in terms:
                    changed |= self._merge(terms, monomial)
        return terms

    def _merge(self, terms: MonomialSum, monomial: Monomial) -> bool:
        number = terms[monomial]
        for partner, sign, (rest, merged), exact in self._identities(monomial):
            other = terms.get(partner)
            if (
                other is None
                or (other.is_negative == number.is_negative) != (sign > 0)
                or (exact and other * sign != number)
            ):
                continue
            self.spend(1)
            amount = number if abs(number) <= abs(other) else other * sign
            accumulate(terms, monomial, -amount)
            accumulate(terms, partner, -amount * sign)
            for new, value in self.multiply({rest: amount}, self.read(merged)).items():
                accumulate(terms, new, value)
            return True
        return False

    def _identities(self, monomial: Monomial) -> Iterator[tuple[Monomial, int, tuple[Monomial, Any], bool]]:
        """Yield (partner, sign, (rest, expression), exact): each says monomial + sign * partner = rest * expression.

        The identities are sin^2 + cos^2 = 1 and the addition theorems. The monomial m sin(a)**2 has the partner
        m cos(a)**2, the rest m and the expression 1. If `exact` is true, both terms must have equal coefficients, since
        otherwise the sum would not get shorter.
        """
        circular = [(k, self._angles[k]) for k, e in monomial if k in self._angles and isinstance(e, int) and e > 0]
        exponents = dict(monomial)
        for index, (k, (kind, a)) in enumerate(circular):
            co = self._circle.get((_CO[kind], a))
            if exponents[k] >= 2:
                rest, _ = self._join(monomial, ((k, -2),))
                yield rest, -1, (rest, -(_CO[kind](a) ** 2)), True
                if co is not None:
                    yield self._join(rest, ((co, 2),))[0], 1, (rest, S.One), False
            for other, (other_kind, b) in circular[index + 1 :]:
                other_co = self._circle.get((_CO[other_kind], b))
                if co is not None and other_co is not None and other != co:
                    rest, _ = self._join(monomial, ((k, -1), (other, -1)))
                    partner, _ = self._join(rest, ((co, 1), (other_co, 1)))
                    for sign in (1, -1):
                        yield partner, sign, (rest, _addition_theorem(kind, other_kind, a, b, sign)), False

    def _join(self, left: Monomial, right: Monomial) -> tuple[Monomial, Any]:
        """Return the product of two monomials as (monomial, number): sqrt(2) sqrt(2) gives the number 2."""
        powers = dict(left)
        for k, e in right:
            raise_power(powers, k, e)
        number = S.One
        if self._directions:
            self._absorb_directions(powers)
        for k in self._numeric:
            if isinstance(powers.get(k), int):
                number *= self.factors[k] ** powers.pop(k)
        return tuple(sorted(powers.items())), number

    def _absorb_directions(self, powers: dict[int, Any]) -> None:
        """Simplify |x|**2 to x**2, sign(x) x to |x|, and sign(x) |x| to x in a monomial {index: exponent}, in place."""
        for direction, (plain, magnitude) in self._directions.items():
            exponent = powers.get(magnitude)
            if isinstance(exponent, int) and exponent % 2 == 0:
                raise_power(powers, plain, powers.pop(magnitude))
            for factor, product in ((plain, magnitude), (magnitude, plain)):
                exponent = powers.get(factor)
                if direction in powers and isinstance(exponent, int) and exponent > 0:
                    raise_power(powers, direction, -1)
                    raise_power(powers, factor, -1)
                    raise_power(powers, product, 1)

    def _slope(self, number: int, symbol: Any) -> MonomialSum:
        key = (number, symbol)
        if key not in self._slopes:
            factor = self.factors[number]
            self._slopes[key] = {ONE: S.One} if factor == symbol else self.read(factor.diff(symbol))
        return self._slopes[key]

    def _factor(self, base: Any, exponent: Any = 1) -> MonomialSum:
        return {((self._number(base), exponent),): S.One}

    def _number(self, base: Any) -> int:
        number = self._numbers.get(base)
        if number is None:
            size = 0 if base.is_Atom else int(base.count_ops())
            self.spend(size)
            number = self._numbers[base] = len(self.factors)
            self.factors.append(base)
            self._sizes.append(size)
            self._free.append(frozenset(base.free_symbols))
            if base.is_Rational:
                self._numeric.append(number)
            if isinstance(base, (sympy.sin, sympy.cos)):
                self._angles[number] = (base.func, base.args[0])
                self._circle[self._angles[number]] = number
            if isinstance(base, (Direction, Magnitude)):
                argument = base.args[0]
                plain, magnitude = self._number(argument), self._number(Magnitude(argument))
                self._directions[self._number(Direction(argument))] = (plain, magnitude)
        return number

    def _read_new(self, node: Any) -> MonomialSum:
        if node.is_Number:
            return {ONE: node} if node != 0 else {}
        if node.is_Add:
            self.spend(len(node.args))
            return self.add({}, *(self.read(part) for part in node.args))
        if node.is_Mul:
            return self._read_product(node)
        if node.is_Pow:
            return self._read_power(node)
        if isinstance(node, Function) and not isinstance(node, sympy.Piecewise):
            tidy = node.func(*(self._tidy(part) for part in node.args))
            return self._factor(tidy) if tidy.func == node.func else self.read(tidy)
        return self._factor(node)

    def _read_product(self, node: Any) -> MonomialSum:
        parts = [self.read(part) for part in node.args]
        width = prod(max(len(terms), 1) for terms in parts)
        if width > WIDEST_PRODUCT:
            parts = [
                terms if len(terms) < 2 else self._factor(self._tidy(part))
                for terms, part in zip(parts, node.args, strict=True)
            ]
        product: MonomialSum = {ONE: S.One}
        for terms in parts:
            product = self.multiply(product, terms)
        return product

    def _read_power(self, node: Any) -> MonomialSum:
        base, exponent = node.as_base_exp()
        if not exponent.is_Rational:
            return self._factor(Pow(self._tidy(base), exponent))
        terms = self.read(base)
        if exponent.is_Integer and len(terms) == 1:
            return self._whole_power(terms, int(exponent))
        if exponent.is_Integer and 0 < exponent <= HIGHEST_POWER and len(terms) ** int(exponent) <= WIDEST_PRODUCT:
            product = terms
            for _ in range(int(exponent) - 1):
                product = self.multiply(product, terms)
            return product
        if exponent.is_Integer and terms:
            outside, inside = self._primitive(terms, base)
            return self.multiply(self._whole_power(outside, int(exponent)), self._factor(inside, int(exponent)))
        tidy = differentiable(Pow(self._tidy(base), exponent))  # SymPy returns Abs for the root of a square
        if tidy != node and not (tidy.is_Pow and tidy.exp.is_Rational):
            return self.read(tidy)
        return self._factor(tidy.base, tidy.exp) if tidy.is_Pow else self._factor(node)

    def _whole_power(self, term: MonomialSum, exponent: int) -> MonomialSum:
        ((monomial, number),) = term.items()
        joined, scale = self._join((), tuple((k, e * exponent) for k, e in monomial))
        return {joined: scale * number**exponent}

    def _primitive(self, terms: MonomialSum, stated: Any) -> tuple[MonomialSum, Any]:
        """Return (common factor, rest) of a sum of monomials, the rest as a SymPy expression.

        `stated` is the sum before it was simplified. It is returned as the rest if no factor was taken out and it has
        no more operations. Multiples of a sum get the same rest, as in 1/(2 x - 2 y) and 1/(y - x).
        """
        number, monomial, rest = common_factor(self.merge_angles(terms))
        inside = self.write(rest)
        if inside.could_extract_minus_sign():
            number, inside = -number, -inside
        as_stated = monomial == ONE and number == 1 and stated.count_ops() <= inside.count_ops()
        return {monomial: number}, stated if as_stated else inside

    def tidy_roots(self, expression: Any) -> Any:
        """Return the expression with the arguments of roots merged: sqrt(r^2 cos(a)^2 + r^2 sin(a)^2) becomes |r|."""
        return expression.replace(
            lambda node: node.is_Pow and node.base.is_Add and node.exp.is_Rational and not node.exp.is_Integer,
            lambda node: differentiable(Pow(self._tidy(node.base), node.exp)),
        )

    def _tidy(self, expression: Any) -> Any:
        """Return `expression`, the argument of a root or function, with merged terms and its common factor taken out.

        It is returned unchanged if that is not shorter.
        """
        if not isinstance(expression, Expr) or not expression.is_Add:
            return expression
        number, monomial, rest = common_factor(self.merge_angles(self.read(expression)))
        tidy = Mul(number, self.power(monomial), self.write(rest))
        return tidy if tidy.count_ops() < expression.count_ops() else expression


@lru_cache(maxsize=10_000)
def _addition_theorem(first: Any, second: Any, a: Any, b: Any, sign: int) -> Any:
    """Return first(a) second(b) + sign * cofirst(a) cosecond(b) as one sine or cosine.

    `first` and `second` are sin or cos. The prefix co exchanges sin and cos.
    """
    if first is not second:
        return sympy.sin(a + sign * b) if first is sympy.sin else sympy.sin(b + sign * a)
    if sign > 0:
        return sympy.cos(a - b)
    return sympy.cos(a + b) if first is sympy.cos else -sympy.cos(a + b)
