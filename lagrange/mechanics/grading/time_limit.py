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
"""Processor time of a comparison, from reading on, after which the search for wrong terms and slips stops.

Most searches take 0.1 s; a search in a chain of eight links takes 2 s. An answer of 500 terms takes 0.6 s to read.
"""

# Sentence on a wrong equation whose wrong term was not found in time
UNNAMED = "It is too long, or its numbers are too large, to find its wrong term in good time."
LARGEST_EXPANSION = 5_000
"""Largest number of terms, after expansion, of an equation in which a wrong term is searched.

A product of 12 sums has 4,096 and takes 0.9 s; SymPy cannot be interrupted in a larger one.
"""

LARGEST_NUMBER = 1_000  # Largest number in the argument of an exponential: SymPy expands exp(n*x) in degree n
_GROWING = (sympy.exp, sympy.sinh, sympy.cosh, sympy.tanh)

_END: ContextVar[float] = ContextVar("end of the budget", default=inf)


class BudgetSpent(Exception):
    """Raised when the processor time for naming a wrong term is spent."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Context in which `check_budget` raises BudgetSpent after `seconds` of processor time."""
    token = _END.set(time.process_time() + seconds)
    try:
        yield
    finally:
        _END.reset(token)


def is_spent() -> bool:
    """Return True if the processor time of the enclosing `limited` block is spent."""
    return time.process_time() >= _END.get()


def check_budget() -> None:
    """Raise BudgetSpent if the processor time of the enclosing `limited` block is spent."""
    if is_spent():
        raise BudgetSpent


def check_size(*expressions: Any) -> None:
    """Raise BudgetSpent if an expression is so large that a single call of SymPy would take too long."""
    calls = {call for expression in expressions for call in expression.atoms(*_GROWING)}
    numbers = {abs(number) for call in calls for number in call.args[0].atoms(sympy.Number)}
    if max(numbers, default=0) > LARGEST_NUMBER or any(term_count(x) > LARGEST_EXPANSION for x in expressions):
        raise BudgetSpent
