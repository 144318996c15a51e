"""The texts of each language, in files beside this one: programs, helper functions and reserved words."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files as resources
from string import Template


class Fields(Template):
    """Template of a text with fields such as @{name}; @@ is the sign @."""

    delimiter = "@"


@cache
def templates(language: str) -> Mapping[str, Fields]:
    """Return the templates of a language by name, from its file in this folder.

    A line such as "@@@ head" precedes the template of this name.
    """
    text = resources("lagrange.export.templates").joinpath(f"{language}.txt").read_text("ascii")
    _, *parts = re.split(r"^@@@ ([\w ]+)\n", text, flags=re.MULTILINE)
    return dict(zip(parts[::2], map(Fields, parts[1::2]), strict=True))


def filled(language: str, name: str, /, **fields: object) -> str:
    """Return the text of a template of a language with values for its fields, without line ends after it."""
    return templates(language)[name].substitute(fields).rstrip()


def words(language: str, name: str) -> list[str]:
    """Return the words of a list of a language, such as the list "reserved"."""
    return templates(language)[name].template.split()


def helpers(language: str) -> dict[str, str]:
    """Return the definitions of a language's helper functions by operation: the templates such as "helper min"."""
    mark = "helper "
    return {
        name.removeprefix(mark): fields.substitute().rstrip()
        for name, fields in templates(language).items()
        if name.startswith(mark)
    }


def named_helpers(language: str) -> dict[str, tuple[str, str]]:
    """Return (name, definition) of the helper functions in C or JavaScript, by operation."""
    names = re.compile(r"^(?:function|double|int64_t) (\w+)", re.MULTILINE)
    return {op: (names.findall(text)[0], text) for op, text in helpers(language).items()}
