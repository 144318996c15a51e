"""Difference between a typed term and the right one: a sign, a factor, an extra or a missing term."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, product
from typing import Any, Literal

import sympy

from lagrange.mechanics.grading.budget import LARGEST_EXPANSION, LARGEST_POWER, check_budget, expansion
from lagrange.mechanics.grading.student_equations import HELD

Numbers = list[Any]  # Values of an expression at the samples
Write = Callable[[Any], str]  # Function that returns the text of an expression in plain symbols
LARGEST_MULTIPLE = 20  # Largest multiple of an angle whose sine is expanded
MOST_TERMS = 2_000  # Largest number of terms of an expanded sum in which a wrong term is searched
LARGEST_FACTOR = 1000  # Largest denominator of a fraction that approximates a constant factor

# Largest constant factor: the fraction of a number with an exponent of many digits takes minutes
LARGEST_NUMERATOR = 10**6


@dataclass(frozen=True)
class Difference:
    """Difference of a term: the expression that was typed, and the right one in its place.

    If `kind` is "scaled", `typed` is the constant `ratio` times `right`.
    """

    kind: Literal["missing", "extra", "scaled", "wrong"]
    typed: Any
    right: Any
    ratio: Fraction = Fraction(1)

    def told(self, factor: Any, write: Write) -> str:
        """Return the end of a sentence on the difference. Both expressions are first multiplied by `factor`.

        `write` turns an expression into text.
        """
        typed, right = self.typed * factor, self.right * factor
        shown = right if self.kind == "missing" else typed
        named = f"the {'sum' if shown.is_Add else 'term'} {write(shown)}"
        if self.kind in ("missing", "extra"):
            return f"{named} {'is missing' if self.kind == 'missing' else 'should not be there'}."
        if self.kind == "scaled" and self.ratio != -1:
            return f"{named} has the wrong factor: it is {self.ratio} times what it should be, {write(right)}."
        return f"{named} {'is wrong' if self.kind == 'wrong' else 'has the wrong sign'}: it should be {write(right)}."


def summands(expression: Any) -> tuple[Any, ...]:
    """Return the terms of an expression after products of sums are expanded; powers and denominators are unchanged.

    An expression with more than MOST_TERMS terms is returned whole, as a single term.
    """
    terms: list[Any] = []
    waiting = [*reversed(sympy.Add.make_args(expression))]
    while waiting:
        factors = sympy.Mul.make_args(waiting.pop())
        sums = [factor for factor in factors if factor.is_Add]
        if sums:
            rest = [factor for factor in factors if not factor.is_Add]
            choices = islice(product(*(total.args for total in sums)), MOST_TERMS + 1)
            waiting += (sympy.Mul(*rest, *choice) for choice in choices)
        else:
            terms.append(sympy.Mul(*factors))
        if len(terms) + len(waiting) > MOST_TERMS:
            return (expression,)
    return tuple(terms)


def expanded(expression: Any) -> tuple[Any, ...]:
    """Return the terms of an expression after full expansion, also of powers and denominators.

    An expression with a large power of a sum, or with too many terms, is returned whole, as a single term. Raises
    BudgetSpent if the time is up.
    """
    check_budget()
    powers = (power for power in expression.atoms(sympy.Pow) if power.base.is_Add)
    large = any(power.exp.is_Integer and abs(power.exp) > LARGEST_POWER for power in powers)
    if not (large or expansion(expression) > LARGEST_EXPANSION):
        calls = expression.atoms(sympy.sin, sympy.cos, sympy.tan)
        factors = (abs(term.as_coeff_Mul()[0]) for call in calls for term in sympy.Add.make_args(call.args[0]))
        # The sine of n times an angle becomes a polynomial of degree n.
        many = any(factor > LARGEST_MULTIPLE for factor in factors)
        expression = sympy.expand(expression if many else sympy.expand_trig(expression))
    terms: tuple[Any, ...] = sympy.Add.make_args(expression)
    return terms


def scaled_by(number: Fraction, expression: Any) -> Any:
    """Return a number times an expression, distributed over the terms of a sum.

    Common factors of denominators are taken out: 3*R - 3*r becomes 3*(R - r).
    """
    quotients = map(sympy.fraction, sympy.Add.make_args(expression))
    return sympy.Add(*(sympy.Rational(number) * above / sympy.factor_terms(below) for above, below in quotients))


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
