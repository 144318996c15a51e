"""Names and lines of source text in plain ASCII: legal names, breaks in long lines, and comments."""

from __future__ import annotations

import re
import textwrap
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
    """Return a name, with an underscore as suffix if it is one of the reserved `words`."""
    return f"{name}_" if name in words else name


def distinct(
    names: Sequence[str], reserved: Iterable[str] = (), *, key: Callable[[str], str] = lambda name: name
) -> tuple[str, ...]:
    """Return distinct legal names in order; a name that is taken or reserved gets a number as suffix.

    Two names count as the same if `key` maps them to the same text: `str.lower` for a language that ignores case.
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


TEXT_WIDTH = 110
"""Largest length of a line of comment, or of the head of a function, in exported files."""


DEFAULT_LINE_LENGTH = 120
"""Default limit of characters per line, for languages without a limit."""


def continued(line: str, room: int = DEFAULT_LINE_LENGTH, mark: str = "") -> list[str]:
    """Return a statement as lines of at most `room` characters, broken at spaces; all but the last end with `mark`.

    A line without a space to break at stays longer.
    """
    indent, lines = " " * (len(line) - len(line.lstrip()) + 4), []
    while len(line) > room:
        cut = line.rfind(" ", len(indent), room - len(mark))
        if cut < 0:
            break
        lines.append(f"{line[:cut]} {mark}".rstrip())
        line = indent + line[cut + 1 :]
    return [*lines, line]


def number_lines(values: Iterable[str], indent: str, width: int = 110, end: str = ",") -> list[str]:
    """Return number literals on indented lines of at most `width` characters; `end`, a comma, follows each."""
    text = textwrap.wrap(" ".join(f"{value}{end}" for value in values), width - len(indent), break_long_words=False)
    return [f"{indent}{line}" for line in text]


TOGETHER, KEPT = "\N{NO-BREAK SPACE}", "\x1f"
"""A space at which no line is broken, and the character that replaces it while lines are broken."""


def plain(text: str) -> str:
    """Return a text in ASCII that cannot end a comment; Greek letters are spelled by name."""
    spelled = "".join(map(spelled_letter, text))
    ascii_only = unicodedata.normalize("NFKD", spelled).encode("ascii", "replace").decode("ascii")
    printable = "".join(letter if letter.isprintable() else " " for letter in ascii_only)
    return printable.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def wrapped(text: str, width: int) -> list[str]:
    """Return a text as lines of at most `width` characters, at least one line; continuation lines are indented."""
    ascii_text = KEPT.join(map(plain, text.split(TOGETHER)))
    lines = textwrap.wrap(ascii_text, width, subsequent_indent="  ", break_long_words=False)
    return [line.replace(KEPT, " ") for line in lines] or [""]


def commented(text: str, mark: str, width: int = 110) -> list[str]:
    """Return a text as comment lines that begin with a mark, such as "//"."""
    return [f"{mark} {line}".rstrip() for line in wrapped(text, width - len(mark) - 1)]
