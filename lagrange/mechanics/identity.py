"""Whether an expression vanishes identically, decided at random states to many digits."""

from __future__ import annotations

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
        if found != found:
            continue
        terms = [abs(number(term, values)) for term in sympy.Add.make_args(given)]
        if abs(found) > 10.0 ** (10 - DIGITS) * max(terms):
            return False
        seen += 1
        if seen == STATES:
            return True
    return is_zero(given)
