"""The few errors a person meets, each named after who can act on it."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class LagrangeError(Exception):
    """Base of every error that this package raises on purpose."""


class StatementError(LagrangeError, ValueError):
    """What was stated or asked for cannot be: the message says what to change."""


class SceneError(StatementError):
    """A scene file cannot be used: the message names file, line and column."""

    def __init__(self, reason: str, *, file: str = "", line: int | None = None, column: int | None = None) -> None:
        place = ":".join(str(part) for part in (file, line, column) if part not in ("", None))
        super().__init__(f"{place}: {reason}" if place else reason)
        self.reason = reason
        self.file = file
        self.line = line
        self.column = column


class RunError(LagrangeError):
    """A run, or one evaluation of a model, did not give a usable answer."""


def suggestion(given: str, known: Iterable[str]) -> str:
    """Return `` Did you mean 'x'?`` for the closest known name, or an empty string."""
    match = get_close_matches(given, sorted(known), n=1, cutoff=0.6)
    return f" Did you mean {match[0]!r}?" if match else ""


def listing(names: Iterable[str]) -> str:
    """Return the names as ``a, b and c`` for a sentence."""
    words = list(names)
    if len(words) < 2:
        return "".join(words) or "none"
    return ", ".join(words[:-1]) + " and " + words[-1]
