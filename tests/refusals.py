"""The message that refuses a call."""

from collections.abc import Callable
from typing import Any

import pytest
import sympy

from lagrange.errors import StatementError

LONGEST = 400
"""Largest number of characters of a message."""


def refusal(call: Callable[..., Any], *arguments: Any, **named: Any) -> str:
    """Return the message of the StatementError that a call raises. A call without one, or a long message, fails."""
    with pytest.raises(StatementError) as raised:
        call(*arguments, **named)
    message = str(raised.value)
    assert len(message) <= LONGEST, message
    return message


def nested(inner: Any, levels: int) -> Any:
    """Return an expression that is nested too deeply for SymPy's recursive functions."""
    for _ in range(levels):
        inner = sympy.sin(inner, evaluate=False)
    return inner
