"""The message that refuses a call."""

from collections.abc import Callable
from typing import Any

import pytest
import sympy

from lagrange.errors import StatementError


def refusal(call: Callable[..., Any], *arguments: Any, **named: Any) -> str:
    """Return the message of the StatementError that a call raises. A call that raises none fails the test."""
    with pytest.raises(StatementError) as raised:
        call(*arguments, **named)
    return str(raised.value)


def nested(inner: Any, levels: int) -> Any:
    """Return an expression that is nested too deeply for SymPy's recursive functions."""
    for _ in range(levels):
        inner = sympy.sin(inner, evaluate=False)
    return inner
