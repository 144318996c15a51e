"""Whether an expression vanishes identically, decided at random states to many digits."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Any

import sympy

from lagrange.evidence.sample import SAMPLE_KINDS, Sampler
from lagrange.mechanics.number_check import MOST_DRAWS
from lagrange.mechanics.plain_form import DIGITS, PlainForm, number
from lagrange.mechanics.simplification import is_zero

STATES = 3
"""Random states at which an expression that vanishes has to be zero: any other is zero there with probability zero."""


def vanishes(form: PlainForm, given: Any) -> bool:
    """Return whether an expression in plain symbols is zero at every state, time and value of the parameters."""
    if given == 0:
        return True
    sampler, seen = Sampler(form.statement, seed=7), 0
    for attempt in range(MOST_DRAWS):
        values = form.at(sampler.point(SAMPLE_KINDS[(attempt + 1) % 4], attempt))
        found = number(given, values)
        terms = size_of_terms(given, values)
        if found != found or terms != terms:
            continue
        if abs(found) > 10.0 ** (10 - DIGITS) * terms:
            return False
        seen += 1
        if seen == STATES:
            return True
    return is_zero(given)


def vanishes_in_symbols(given: Any) -> bool:
    """Return whether an expression in plain symbols is zero for all real values of them, False where it has none."""
    if given == 0:
        return True
    dice, seen = random.Random(7), 0
    symbols = sorted(given.free_symbols, key=str)
    for _ in range(MOST_DRAWS):
        values = {symbol: sympy.Rational(dice.randrange(64, 256), 128) for symbol in symbols}
        found, terms = number(given, values), size_of_terms(given, values)
        if found != found or terms != terms:
            continue
        if abs(found) > 10.0 ** (10 - DIGITS) * terms:
            return False
        seen += 1
    return seen >= STATES


def size_of_terms(given: Any, values: Mapping[Any, Any]) -> float:
    """Return the size of the terms that a value is the sum of, those of sums in products and powers among them.

    The value itself is no measure of rounding: (x - y) z has one factor of two terms that may cancel.
    """
    if given.is_Add:
        return sum(size_of_terms(term, values) for term in given.args)
    if given.is_Mul:
        return math.prod(size_of_terms(factor, values) for factor in given.args)
    if given.is_Pow and given.exp.is_Integer and given.exp.is_positive:
        return size_of_terms(given.base, values) ** int(given.exp)
    return abs(number(given, values))
