"""Limits of the search for a wrong term: processor time, and size of the expressions that SymPy expands."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from math import inf
from typing import Any

import sympy

from lagrange.mechanics.plain_form import term_count

SECONDS = 1.2
"""Processor time in seconds after which the search for wrong terms in an answer stops, counted from its reading.

Most searches take 0.1 s. A search in a chain of eight links takes 2 s. An answer of 500 terms takes 0.6 s to read.
"""

# Sentence on a wrong equation whose wrong term was not found in time
UNNAMED = "It is too long, or its numbers are too large, to find its wrong term in good time."
LARGEST_EXPANSION = 5_000
"""Largest number of terms, after expansion, of an equation in which a wrong term is searched.

A product of 12 sums has 4,096 terms and takes 0.9 s. The expansion of a larger one cannot be interrupted.
"""

LARGEST_NUMBER = 1_000  # Largest number in the argument of an exponential: SymPy expands exp(n*x) in degree n
_GROWING = (sympy.exp, sympy.sinh, sympy.cosh, sympy.tanh)

_END: ContextVar[float] = ContextVar("end of the budget", default=inf)


class BudgetSpent(Exception):
    """Raised when the processor time for the search of a wrong term is spent."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Limit the processor time of a `with` block: after `seconds`, `check_budget` raises BudgetSpent in it."""
    token = _END.set(time.process_time() + seconds)
    try:
        yield
    finally:
        _END.reset(token)


def is_spent() -> bool:
    """Return True if the processor time of the enclosing block `with limited(...)` is spent."""
    return time.process_time() >= _END.get()


def check_budget() -> None:
    """Raise BudgetSpent if the processor time of the enclosing block `with limited(...)` is spent."""
    if is_spent():
        raise BudgetSpent


def check_size(*expressions: Any) -> None:
    """Raise BudgetSpent if one of the `expressions` is so large that SymPy would take too long to expand it."""
    calls = {call for expression in expressions for call in expression.atoms(*_GROWING)}
    numbers = {abs(number) for call in calls for number in call.args[0].atoms(sympy.Number)}
    if max(numbers, default=0) > LARGEST_NUMBER or any(term_count(x) > LARGEST_EXPANSION for x in expressions):
        raise BudgetSpent
