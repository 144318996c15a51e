"""Difference of a coefficient of an equation from the right one: a sign, a factor, an extra or a missing term."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from itertools import product as every_choice
from typing import Any

import sympy

from lagrange.mechanics.grading.student_equations import HELD

Numbers = list[Any]
"""Values of an expression at the samples."""

Write = Callable[[Any], str]
"""Function that returns the text of an expression in plain symbols."""

LARGEST_MULTIPLE = 20
"""Largest multiple of an angle whose sine is expanded."""

MOST_TERMS = 2_000
"""Largest number of terms of an expanded sum in which a wrong term is searched."""

MOST_PAIRS = 10_000
"""Largest number of pairs of a typed and a right term that are compared; each takes 10 us."""

LARGEST_POWER = 4
"""Largest power of a sum that is multiplied out."""

LARGEST_FACTOR = 1000
"""Largest denominator of a fraction that approximates a constant factor."""

LARGEST_NUMERATOR = 10**6
"""Largest constant factor: the fraction of a number with an exponent of many digits takes minutes."""

MISSING, EXTRA, SCALED, WRONG = range(4)


@dataclass(frozen=True)
class Difference:
    """Difference of a coefficient: `there` is the part that was typed, `wanted` the right expression for this part.

    `kind` is MISSING, EXTRA, SCALED or WRONG. If it is SCALED, `there` is the constant `ratio` times `wanted`. `whole`
    is true if the two are the whole coefficient.
    """

    kind: int
    there: Any
    wanted: Any
    ratio: Fraction = Fraction(1)
    whole: bool = False

    @property
    def whole_is_wrong(self) -> bool:
        """True if no single term explains the difference."""
        return self.kind == WRONG and self.whole

    def told(self, product: Any, sign: int, write: Write) -> str:
        """Return the difference as the end of a sentence. Both parts are multiplied by `product` and by `sign`."""
        there, wanted = (sign * part * product for part in (self.there, self.wanted))
        if self.kind == MISSING:
            return f"the {_kind(wanted)} {write(wanted)} is missing."
        named = f"the {_kind(there)} {write(there)}"
        if self.kind == EXTRA:
            return f"{named} should not be there."
        if self.kind == WRONG:
            return f"{named} is wrong: it should be {write(wanted)}."
        if self.ratio == -1:
            return f"{named} has the wrong sign: it should be {write(wanted)}."
        times = f"{self.ratio} times what it should be"
        return f"{named} has the wrong factor: it is {times}, {write(wanted)}."


def _kind(expression: Any) -> str:
    return "sum" if expression.is_Add else "term"


def difference_of(there: Any, wanted: Any, numbers: Callable[[Any], Numbers | None]) -> Difference:
    """Return the difference of the typed coefficient `there` from the right one, `wanted`.

    `numbers` returns the values of an expression at the samples, or None.
    """
    if there == 0:
        return Difference(MISSING, there, wanted)
    if wanted == 0:
        return Difference(EXTRA, there, wanted)
    ratio = ratio_of(numbers(there), numbers(wanted))
    if ratio is not None:
        right = wanted if there.has(sympy.Float) else scaled_by(1 / ratio, there)
        return Difference(SCALED, there, right, ratio, whole=True)
    off = numbers(there - wanted)
    scaled = scaled_product(there, off, numbers)
    if scaled is not None:
        return scaled
    for terms_of in (summands, _opened, expanded):
        difference = _one_term(terms_of(there), terms_of(wanted), off, numbers)
        if difference is not None:
            return difference
    typed, right = _without_common(summands(there), summands(wanted))
    if len(typed) < len(summands(there)):
        return difference_of(sympy.Add(*typed), sympy.Add(*right), numbers)
    return Difference(WRONG, there, wanted, whole=True)


def scaled_product(there: Any, off: Numbers | None, numbers: Callable[[Any], Numbers | None]) -> Difference | None:
    """Return the difference if one typed product with a sum, such as k*(x - y), has the wrong factor, else None.

    `off` has the values of typed minus right coefficient.
    """
    for term in sympy.Add.make_args(there):
        if any(factor.is_Add for factor in sympy.Mul.make_args(term)):
            scaled = scaled_term(term, off, numbers(term))
            if scaled is not None:
                return scaled
    return None


def scaled_term(term: Any, off: Numbers | None, values: Numbers | None) -> Difference | None:
    """Return the difference if a constant factor of a typed term with these values explains it, else None.

    `off` has the values of typed minus right coefficient.
    """
    share = ratio_of(off, values)
    return None if share in (None, 1) else Difference(SCALED, term, scaled_by(1 - share, term), 1 / (1 - share))


def _without_common(left: Sequence[Any], right: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """Return the terms of two sums without their common terms, counted with multiplicity."""
    kept, other = list[Any](), list(right)
    for term in left:
        if term in other:
            other.remove(term)
        else:
            kept.append(term)
    return kept, other


def _one_term(
    there: Sequence[Any], wanted: Sequence[Any], off: Numbers | None, numbers: Callable[[Any], Numbers | None]
) -> Difference | None:
    """Return the difference if a single term explains it, else None.

    `off` has the values of typed minus right coefficient.
    """
    typed, right = ([(term, numbers(term)) for term in terms] for terms in (there, wanted))
    for term, value in right:
        factor = ratio_of(off, value)
        if factor == -1:
            return Difference(MISSING, sympy.S.Zero, term)
        if factor is not None:
            return Difference(SCALED, scaled_by(factor + 1, term), term, factor + 1)
    for term, value in typed:
        if ratio_of(off, value) == 1:
            return Difference(EXTRA, term, sympy.S.Zero)
    for (term, value), (other, expected) in islice(every_choice(typed, right), MOST_PAIRS):
        if term == other or off is None or value is None or expected is None:
            continue
        if same(off, [a - b for a, b in zip(value, expected, strict=True)]):
            return Difference(WRONG, term, other)
    return None


def spread(expression: Any, opens: Callable[[Any], bool]) -> list[Any] | None:
    """Return the terms of an expression after expansion of those factors for which `opens` is true.

    None if there are more than MOST_TERMS.
    """
    expanded: list[Any] = []
    waiting = [*reversed(sympy.Add.make_args(expression))]
    while waiting:
        factors = [_power(factor, opens) for factor in sympy.Mul.make_args(waiting.pop())]
        sums = [factor for factor in factors if factor.is_Add and opens(factor)]
        rest = [factor for factor in factors if factor not in sums]
        if sums:
            waiting += _choices(rest, sums)
        else:
            expanded.append(sympy.Mul(*rest))
        if len(expanded) + len(waiting) > MOST_TERMS:
            return None
    return expanded


def _power(factor: Any, opens: Callable[[Any], bool]) -> Any:
    """Return a factor; a small power of a sum is expanded if `opens` is true for it."""
    small = factor.is_Pow and factor.exp.is_Integer and 1 < factor.exp <= LARGEST_POWER
    return sympy.expand_multinomial(factor) if small and factor.base.is_Add and opens(factor) else factor


def summands(expression: Any) -> tuple[Any, ...]:
    """Return the terms of an expression after products of sums are expanded; powers and denominators are unchanged."""
    return tuple(spread(expression, lambda factor: not factor.is_Pow) or [expression])


def _choices(rest: Sequence[Any], sums: Sequence[Any]) -> Iterator[Any]:
    """Yield the terms of the product of `sums` and the factors `rest`, at most MOST_TERMS + 1 of them."""
    for choice in islice(every_choice(*(total.args for total in sums)), MOST_TERMS + 1):
        yield sympy.Mul(*rest, *choice)


def _opened(expression: Any) -> tuple[Any, ...]:
    """Return the terms of an expression after addition theorems expand sines and cosines of sums."""
    return summands(_without_sums(expression))


def expanded(expression: Any) -> tuple[Any, ...]:
    """Return the terms of an expression after full expansion, powers and denominators included.

    An expression with a large power of a sum is its only term.
    """
    powers = (power for power in expression.atoms(sympy.Pow) if power.base.is_Add)
    large = any(power.exp.is_Integer and abs(power.exp) > LARGEST_POWER for power in powers)
    terms: tuple[Any, ...] = sympy.Add.make_args(expression if large else sympy.expand(_without_sums(expression)))
    return terms


def _without_sums(expression: Any) -> Any:
    """Return an expression with sines and cosines of sums expanded; the expression itself if a multiple is too large.

    The sine of n times an angle becomes a polynomial of degree n.
    """
    calls = expression.atoms(sympy.sin, sympy.cos, sympy.tan)
    factors = (abs(term.as_coeff_Mul()[0]) for call in calls for term in sympy.Add.make_args(call.args[0]))
    return expression if any(factor > LARGEST_MULTIPLE for factor in factors) else sympy.expand_trig(expression)


def scaled_by(number: Fraction, expression: Any) -> Any:
    """Return a number times an expression, distributed over the terms of a sum.

    Common factors of denominators are taken out: 3*R - 3*r becomes 3*(R - r).
    """
    quotients = map(sympy.fraction, sympy.Add.make_args(expression))
    return sympy.Add(*(sympy.Rational(number) * above / sympy.factor_terms(below) for above, below in quotients))


def ratio_of(above: Numbers | None, below: Numbers | None) -> Fraction | None:
    """Return the ratio of two expressions if it is the same small fraction at all samples, else None."""
    if above is None or below is None or not all(below):
        return None
    return constant_of([a / b for a, b in zip(above, below, strict=True)])


def constant_of(values: Numbers) -> Fraction | None:
    """Return the small fraction that all values equal, or None."""
    if values[0] and not 0.5 <= abs(values[0]) * LARGEST_FACTOR <= LARGEST_FACTOR * LARGEST_NUMERATOR:
        return None
    fraction = Fraction(str(values[0])).limit_denominator(LARGEST_FACTOR)
    constant = [values[0] * 0 + fraction.numerator] * len(values)
    return fraction if same(values, constant, fraction.denominator) else None


def same(left: Numbers, right: Numbers, times: int = 1) -> bool:
    """Return True if times * left equals right at all samples, up to rounding."""
    return all(abs(times * a - b) <= HELD * (abs(times * a) + abs(b)) for a, b in zip(left, right, strict=True))
