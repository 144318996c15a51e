"""Limit on the processor time that a comparison spends on naming a wrong term. The verdict is computed without it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from math import comb, inf, prod
from typing import Any

import sympy

SECONDS = 1.2
"""Processor time of a comparison after which no wrong term or slip is searched.

Most searches take 0.1 s, and that in a chain of eight links 2 s.
Reading counts, so that an answer of 500 terms, which takes 0.6 s to read, ends in time, too.
"""

# Sentence on a wrong equation whose wrong term was not found within the budget
UNNAMED = "It is too long, or its numbers are too large, to find its wrong term in good time."
LARGEST_EXPANSION = 5_000
"""Largest number of terms of an equation, multiplied out, in which a wrong term is searched.

A product of 12 sums has 4,096 and takes 0.9 s; SymPy cannot be interrupted in a larger one.
"""

LARGEST_POWER = 4  # Largest power of a sum that is multiplied out

# Largest number in the argument of an exponential: exp(1000*x) is a polynomial of degree 1000 in exp(x) for SymPy
LARGEST_NUMBER = 1_000
_GROWING = (sympy.exp, sympy.sinh, sympy.cosh, sympy.tanh)

_END: ContextVar[float] = ContextVar("end of the budget", default=inf)


class BudgetSpent(Exception):
    """Raised when the processor time for naming a wrong term is spent."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Context in which `check_budget` raises BudgetSpent after some seconds of processor time."""
    token = _END.set(time.process_time() + seconds)
    try:
        yield
    finally:
        _END.reset(token)


def check_budget() -> None:
    """Raise BudgetSpent if the processor time of the enclosing `limited` block is spent."""
    if time.process_time() >= _END.get():
        raise BudgetSpent


def check_size(*expressions: Any) -> None:
    """Raise BudgetSpent if an expression is so large that a single call of SymPy would take too long."""
    calls = {call for expression in expressions for call in expression.atoms(*_GROWING)}
    numbers = {abs(number) for call in calls for number in call.args[0].atoms(sympy.Number)}
    if max(numbers, default=0) > LARGEST_NUMBER or any(expansion(x) > LARGEST_EXPANSION for x in expressions):
        raise BudgetSpent


def expansion(expression: Any) -> int:
    """Return the number of terms that an expression has after expansion; functions and large powers count as one."""
    if expression.is_Add:
        return sum(map(expansion, expression.args))
    if expression.is_Mul:
        return prod(map(expansion, expression.args))
    if expression.is_Pow and expression.exp.is_Integer and 1 < expression.exp <= LARGEST_POWER:
        return comb(expansion(expression.base) + int(expression.exp) - 1, int(expression.exp))
    return 1
