"""A Sphinx extension: docstrings, which are plain text with code between backticks, become what autodoc reads.

A name between backticks that has a page of its own becomes a link.
"""

from __future__ import annotations

import re
import textwrap
from typing import Any

from api import link_targets
from sphinx.application import Sphinx

CODE = re.compile(r"`([^`\n]+(?:\n[^`\n]+)?)`")
ERROR = re.compile(r"(^|(?<=[ (]))((?:Lagrange|Statement|Scene|Run)Error)\b")
MARKS = re.compile(r"([\\*_|<>])")


def marked(text: str, links: dict[str, str]) -> str:
    """Return a paragraph in reStructuredText: code in literal type or as a link, and no other marks in it."""
    parts = CODE.split(ERROR.sub(r"\1`\2`", text.replace("``", "`")))
    return "".join(code(part, links) if k % 2 else MARKS.sub(r"\\\1", part) for k, part in enumerate(parts))


def code(text: str, links: dict[str, str]) -> str:
    """Return a text between backticks as a link if it is a public name, else unchanged."""
    text = " ".join(text.split())
    name = text.removeprefix("lg.").removeprefix("lagrange.").removesuffix("(...)")
    # A zero-width break lets a mark follow a letter, as in `System`s.
    return f":py:obj:`{text} <{links[name]}>`\\ " if name in links else f"``{text}``\\ "


def lines_of(lines: list[str], links: dict[str, str]) -> list[str]:
    """Return the lines of a docstring, with indented lines as blocks of code."""
    result: list[str] = []
    for paragraph in re.split(r"\n\s*\n", textwrap.dedent("\n".join(lines)).strip("\n")):
        if paragraph.startswith("    "):
            result += ["::", "", *paragraph.split("\n"), ""]
        else:
            result += [*marked(paragraph, links).split("\n"), ""]
    return result


def convert(*event: Any) -> None:
    """Rewrite the lines of a docstring in place: they are the last that the event comes with."""
    lines = event[-1]
    lines[:] = lines_of(lines, link_targets())


def setup(app: Sphinx) -> dict[str, bool]:
    """Listen to every docstring."""
    app.connect("autodoc-process-docstring", convert)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
