"""Words from users: a text, or one of a few known words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from lagrange.errors import StatementError, listing, shown, suggestion


def text(value: Any, what: str) -> str:
    """Return a text. Raises StatementError for anything else."""
    if not isinstance(value, str):
        raise StatementError(f"{what} is {shown(value)} ({type(value).__name__}): give a text.")
    return value


def one_of(value: Any, known: Iterable[str], refusal: str) -> str:
    """Return a word that is among the known ones.

    `refusal` says what the value is not, and what there is, with {given} and {known} for them.
    """
    words = list(known)
    if not isinstance(value, str) or value not in words:
        hint = suggestion(value, words) if isinstance(value, str) else ""
        raise StatementError(refusal.format(given=shown(value), known=listing(words)) + hint)
    return value
