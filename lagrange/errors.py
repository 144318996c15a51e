"""The exceptions that this package raises, and helpers for messages: short values, lists of names, suggestions."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

MOST_DIGITS = 60
"""Longest whole number, in digits, that a message shows. For a longer number it gives the number of digits."""

LONGEST_NAME = 80  # Longest part of a text, in characters, that is compared with known names for a suggestion

LONGEST_SENTENCE, END_OF_SENTENCE = 400, 150
"""Longest message, and length of its end that is always kept, in characters. The end says what to do."""

MOST_PARTS, MOST_LEVELS = 400, 30
"""Largest number of parts and of nesting levels in an expression that a message quotes. SymPy prints larger expressions
in minutes, or not at all."""


class LagrangeError(Exception):
    """Base of every error that this package raises on purpose: its message has at most 400 printable characters."""

    def __init__(self, message: object = "") -> None:
        super().__init__(_sentence(str(message)))


class StatementError(LagrangeError, ValueError):
    """Error in a statement or a request of the user. Its message says what to change."""

    place: tuple[str | int, ...] = ()
    """Path of the wrong argument in a scene file, such as ("positions", "bob"); empty if it is not known."""


@contextmanager
def located(*path: str | int) -> Iterator[None]:
    """Return a context manager that puts `path` before the place of a StatementError which is raised inside.

    `path` is the name of an argument, with keys or indices of its entry, such as ("positions", "bob").
    """
    try:
        yield
    except StatementError as error:
        error.place = (*path, *error.place)
        raise


class UnknownKey(StatementError, KeyError, IndexError):
    """Error for a key that is missing from a mapping, or an index outside of a vector.

    Because it is a KeyError, `get` and `in` of mappings work; because it is an IndexError, a loop over a vector ends.
    """

    __str__ = Exception.__str__  # KeyError.__str__ would add quotation marks


class SceneError(StatementError):
    """Error in a scene file. Its message names the file, the line and the column."""

    def __init__(self, reason: str, *, file: str = "", line: int | None = None, column: int | None = None) -> None:
        location = ":".join(str(part) for part in (shortened(file), line, column) if part not in ("", None))
        super().__init__(f"{location}: {reason}" if location else reason)
        self.reason = reason
        self.file = file
        self.line = line
        self.column = column


class RunError(LagrangeError):
    """Error of a run, or of one evaluation of a model, that has no usable result."""


class _Short(reprlib.Repr):
    """Writer of short reprs, cut to about `most` characters, also of values whose own repr raises an exception."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.maxlevel = 3
        self.maxstring = self.maxother = most

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write more than 4,300 digits.
        digits = int(x.bit_length() * 0.30103) + 1
        return repr(x) if digits <= MOST_DIGITS else f"a whole number of about {digits} digits"

    def repr_instance(self, x: Any, level: int) -> str:
        if hasattr(type(x), "free_symbols") and has_many_parts(x):
            return MANY_PARTS
        return " ".join(super().repr_instance(x, level).split())


def shown(value: Any, most: int = 80) -> str:
    """Return a short repr of a value for a message, cut to about `most` characters."""
    return _Short(most).repr(value)


def with_type(value: Any, most: int = 80) -> str:
    """Return a short repr of a value and its type for a message, such as "2.5 (float)"; only "None" for None.

    The repr is cut to about `most` characters.
    """
    return "None" if value is None else f"{shown(value, most)} ({type(value).__name__})"


def shortened(text: str, most: int = 160) -> str:
    """Return a text, such as a path; the middle of a text with more than `most` characters is left out."""
    return text if len(text) <= most else f"{text[: most // 2 - 3]}...{text[-(most // 2) :]}"


MANY_PARTS = "an expression of many parts"
TOO_LARGE = "too large for a floating-point number: give a number below 1.8e308"


def has_many_parts(expression: Any) -> bool:
    """Return True if a SymPy expression has so many parts, or is nested so deeply, that no message shows it."""
    waiting, count = [(expression, 0)], 0
    while waiting:
        node, level = waiting.pop()
        count += 1
        if count > MOST_PARTS or level > MOST_LEVELS:
            return True
        arguments = getattr(node, "args", ())
        waiting += [(part, level + 1) for part in arguments] if isinstance(arguments, tuple) else []
    return False


def formula(expression: Any, most: int = 80) -> str:
    """Return a SymPy expression as text for a message, cut to about `most` characters; a huge one is only described."""
    if has_many_parts(expression):
        return MANY_PARTS
    try:
        return str(expression)[:most]
    except (ValueError, RecursionError):  # a number with thousands of digits
        return shown(expression, most)


def _sentence(text: str) -> str:
    """Return the message `text` without control characters, cut to `LONGEST_SENTENCE` characters in its middle."""
    if not text.isprintable():
        text = " ".join(text.split("\n"))
        text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    if len(text) <= LONGEST_SENTENCE:
        return text
    begin = text[: LONGEST_SENTENCE - END_OF_SENTENCE - 5].rpartition(" ")[0]
    end = text[-END_OF_SENTENCE:].partition(" ")[2]
    return f"{begin or text[:240]} ... {end or text[-140:]}"


def suggestion(given: str, known: Iterable[str]) -> str:
    """Return the text `` Did you mean 'x'?`` with the name in `known` that is closest to the user's name `given`.

    The text is empty if no name is close.
    """
    names, short = sorted(known), given[:LONGEST_NAME]
    alike = [name for name in names if name.lower() == short.lower()]
    match = alike or get_close_matches(short, names, n=1, cutoff=0.6)
    return f" Did you mean {match[0]!r}?" if match else ""


FAULT = "This is a fault of lagrange, please report it with this message."
"""End of a message about a fault of this package: two computations of the same quantity disagree."""


def listing(names: Iterable[str], most: int | None = None) -> str:
    """Return names as ``a, b and c``; for more than `most` names, the first `most` and the number of the others."""
    words = list(names)
    if most is not None and len(words) > most + 1:
        words = [*words[:most], f"{len(words) - most} others"]
    if len(words) < 2:
        return "".join(words) or "none"
    return ", ".join(words[:-1]) + " and " + words[-1]


def abridged(names: Iterable[str], most: int = 8) -> str:
    """Return names as ``a, b, c``; for more than `most` names, the first `most` and the number of the others."""
    words = list(names)
    left = len(words) - most
    return ", ".join(words) if left <= 1 else f"{', '.join(words[:most])} and {left} others"


def capitalized(text: str) -> str:
    """Return a text with its first letter in upper case, for the start of a sentence."""
    return text[0].upper() + text[1:]


def singular(noun: str) -> str:
    """Return a singular noun with its article: "a key", "an invariant"."""
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless the number is 1: ``1 step``, ``2 steps``."""
    return f"{number} {noun}{'s' * (number != 1)}"
