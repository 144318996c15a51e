"""Words from users: a text, or one of a few known words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

from lagrange.errors import StatementError, UnknownKey, listing, shown, singular, suggestion

Value = TypeVar("Value")

MOST_WORDS = 16
"""Largest number of known words that a message lists."""


def text(value: Any, what: str) -> str:
    """Return a text. Raises StatementError for anything else."""
    if not isinstance(value, str):
        raise StatementError(f"{what} is {shown(value)} ({type(value).__name__}): give a text.")
    return value


def printable(value: Any, what: str) -> str:
    """Return a text whose lines have no characters on which a terminal acts. Raises StatementError otherwise."""
    if not text(value, what).replace("\n", " ").isprintable():
        raise StatementError(f"{what} is {shown(value)}, which has control characters: give plain text.")
    return str(value)


def one_of(value: Any, known: Iterable[str], refusal: str) -> str:
    """Return the value if it is one of the known words. Raises StatementError otherwise.

    `refusal` is the message, with the placeholders {given} and {known}.
    """
    words = list(known)
    if not isinstance(value, str) or value not in words:
        hint = suggestion(value, words) if isinstance(value, str) else ""
        raise StatementError(refusal.format(given=shown(value), known=listing(words, MOST_WORDS)) + hint)
    return value


class ByName(dict[str, Value]):
    """Values by name; an unknown name raises a StatementError that lists the known ones."""

    def __init__(self, noun: str, values: Iterable[tuple[str, Value]] = ()) -> None:
        super().__init__(values)
        self.noun = noun

    def __reduce__(self) -> tuple[Any, ...]:
        return ByName, (self.noun, tuple(self.items()))

    def __getitem__(self, name: str) -> Value:
        if not isinstance(name, str) or name not in self:
            hint = suggestion(name, self) if isinstance(name, str) else ""
            raise UnknownKey(
                f"{shown(name)} is not {singular(self.noun)} of this system; "
                f"they are {listing(self, MOST_WORDS)}.{hint}"
            )
        return super().__getitem__(name)
