"""Say in a sentence how a typed term differs from the correct one, as in "has the wrong sign".

Other functions expand expressions into terms, and compare lists of values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, product
from typing import Any, Literal

import sympy

from lagrange.mechanics.grading.student_equations import LARGEST_RESIDUAL
from lagrange.mechanics.grading.time_limit import LARGEST_EXPANSION, check_budget
from lagrange.mechanics.plain_form import term_count

Numbers = list[Any]  # Values of an expression at the samples
Write = Callable[[Any], str]  # Function that returns the text of an expression for messages
LARGEST_MULTIPLE = 20  # Largest multiple of an angle whose sine is expanded
LARGEST_POWER = 4  # Largest power of a sum that is multiplied out
MOST_TERMS = 2_000  # Largest number of terms of an expanded sum in which a wrong term is searched
LARGEST_FACTOR = 1000  # Largest denominator of a fraction that approximates a constant factor
LARGEST_NUMERATOR = 10**6
"""Largest constant factor that is converted to a fraction. The conversion of larger numbers may take minutes."""


@dataclass(frozen=True)
class Difference:
    """Difference of a term of a student's equation: `typed` is the typed term, `right` the correct one in its place.

    `kind` says how they differ: "missing" (`typed` is 0), "extra" (`right` is 0), "scaled" (`typed` is the constant
    `ratio` times `right`), or "wrong".
    """

    kind: Literal["missing", "extra", "scaled", "wrong"]
    typed: Any
    right: Any
    ratio: Fraction = Fraction(1)

    def ending(self, factor: Any, write: Write) -> str:
        """Return the end of a sentence on the difference, such as "the term m*g has the wrong sign: ...".

        The typed and the correct term are multiplied by `factor` in it. `write` turns an expression into text.
        """
        typed, right = self.typed * factor, self.right * factor
        shown = right if self.kind == "missing" else typed
        named = f"the {'sum' if shown.is_Add else 'term'} {write(shown)}"
        if self.kind == "missing":
            return f"{named} is missing."
        if self.kind == "extra":
            return f"{named} should not be there."
        if self.kind == "scaled" and self.ratio != -1:
            return f"{named} has the wrong factor: it is {self.ratio} times what it should be, {write(right)}."
        return f"{named} {'is wrong' if self.kind == 'wrong' else 'has the wrong sign'}: it should be {write(right)}."


def summands(expression: Any) -> tuple[Any, ...]:
    """Return the terms of an expression after expansion of products of sums, but not of powers and denominators.

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
    """Return the terms of an expression after full expansion, also of powers, denominators and sines of sums.

    An expression with a large power of a sum, or with too many terms, is returned whole, as a single term. Raises
    BudgetSpent if the time is up.
    """
    check_budget()
    powers = [power for power in expression.atoms(sympy.Pow) if power.base.is_Add and power.exp.is_Integer]
    if all(abs(power.exp) <= LARGEST_POWER for power in powers) and term_count(expression) <= LARGEST_EXPANSION:
        angles = [call.args[0] for call in expression.atoms(sympy.sin, sympy.cos, sympy.tan)]
        multiples = (abs(term.as_coeff_Mul()[0]) for angle in angles for term in sympy.Add.make_args(angle))
        # The sine of n times an angle becomes a polynomial of degree n.
        if all(multiple <= LARGEST_MULTIPLE for multiple in multiples):
            expression = sympy.expand_trig(expression)
        expression = sympy.expand(expression)
    terms: tuple[Any, ...] = sympy.Add.make_args(expression)
    return terms


def scaled_by(number: Fraction, expression: Any) -> Any:
    """Return a number times an expression. Each term is multiplied: 2 times x + y is 2*x + 2*y.

    Common factors in denominators are taken out: 3*R - 3*r becomes 3*(R - r).
    """
    quotients = map(sympy.fraction, sympy.Add.make_args(expression))
    return sympy.Add(*(sympy.Rational(number) * above / sympy.factor_terms(below) for above, below in quotients))


def constant_of(values: Numbers) -> Fraction | None:
    """Return the fraction that all values of an expression equal up to rounding, or None if there is none.

    Its denominator is at most `LARGEST_FACTOR`, and its absolute value at most `LARGEST_NUMERATOR`.
    """
    if values[0] and not 0.5 <= abs(values[0]) * LARGEST_FACTOR <= LARGEST_FACTOR * LARGEST_NUMERATOR:
        return None
    fraction = Fraction(str(values[0])).limit_denominator(LARGEST_FACTOR)
    constant = [values[0] * 0 + fraction.numerator] * len(values)
    return fraction if same(values, constant, fraction.denominator) else None


def same(left: Numbers, right: Numbers, times: int = 1) -> bool:
    """Return True if `times` * x equals y up to rounding, for all pairs of values x in `left` and y in `right`."""
    return all(
        abs(times * a - b) <= LARGEST_RESIDUAL * (abs(times * a) + abs(b)) for a, b in zip(left, right, strict=True)
    )
