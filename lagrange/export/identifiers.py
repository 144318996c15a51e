"""Names of a statement as names in a program: ASCII letters, digits and underscores."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Container, Iterable, Sequence

from lagrange.statement.vocabulary.letters import GREEK

LONGEST_NAME = 63
"""Longest name: the number of characters that C and Fortran distinguish."""


def ascii_name(name: str) -> str:
    """Return a name of ASCII letters, digits and underscores that begins with a letter: "θ1" becomes "theta1"."""
    spelled = "".join(map(spelled_letter, name))
    plain = re.sub(r"[^A-Za-z0-9]+", "_", spelled).strip("_")
    return (plain if plain[:1].isalpha() else f"x{plain}")[:LONGEST_NAME]


def spelled_letter(letter: str) -> str:
    """Return a letter in ASCII: a Greek letter by its name, an accented one without its accent."""
    bare = unicodedata.normalize("NFD", letter)[0]
    if bare in GREEK or bare.isascii():
        return GREEK.get(bare, bare)
    words = unicodedata.name(bare, "").split()
    return words[-1].lower() if words[:1] == ["GREEK"] else letter


def unreserved(name: str, words: Container[str]) -> str:
    """Return a name, with an underscore as suffix if it is one of the words."""
    return f"{name}_" if name in words else name


def distinct(
    names: Sequence[str], reserved: Iterable[str] = (), *, key: Callable[[str], str] = lambda name: name
) -> tuple[str, ...]:
    """Return distinct legal names in order; a name that is taken or reserved gets a number as suffix.

    `key` maps names that a language does not distinguish to the same text, such as `str.lower`.
    """
    taken, legal_names = {key(word) for word in reserved}, []
    for name in names:
        plain = ascii_name(name)
        legal, count = plain, 2
        while key(legal) in taken:
            tail = f"_{count}"
            legal, count = plain[: LONGEST_NAME - len(tail)] + tail, count + 1
        taken.add(key(legal))
        legal_names.append(legal)
    return tuple(legal_names)
