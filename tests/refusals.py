"""The sentence with which a call is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from lagrange.errors import StatementError


def refusal(call: Callable[..., Any], *arguments: Any, **named: Any) -> str:
    """Return the message of the StatementError that a call raises. A call that raises none fails the test."""
    with pytest.raises(StatementError) as raised:
        call(*arguments, **named)
    return str(raised.value)
