"""Each message quoted on the page of errors occurs in the source."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ANY = "\0"
"""Stands in a text of the source for a value that is formatted into it, and in a quotation for "..."."""

ROW = re.compile(r"^\| ([^|]+) \|", re.MULTILINE)
HEADER = "the message contains"
OF_NUMPY = "loop of ufunc"
"""A message that NumPy raises for a function of an expression."""


def quotations() -> list[str]:
    """Return the quotations of two words or more in the first column of the tables of messages."""
    page = (ROOT / "docs" / "errors.md").read_text("utf-8")
    tables = [part for part in page.split("\n\n") if part.startswith(f"| {HEADER}")]
    cells = [cell for table in tables for cell in ROW.findall(table)[2:]]
    return [
        quoted for cell in cells for quoted in re.findall(r"`([^`]+)`", cell) if " " in quoted and quoted != OF_NUMPY
    ]


@cache
def texts() -> dict[tuple[str, ...], frozenset[str]]:
    """Return the words of each text with a space in the source, in order and as a set; a formatted value is `ANY`."""
    result: list[tuple[str, ...]] = []
    for path in sorted((ROOT / "lagrange").rglob("*.py")):
        result += [words(text) for text in strings(ast.parse(path.read_text("utf-8"))) if " " in text]
    return {text: frozenset(text) for text in result}


def strings(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
        elif isinstance(node, ast.JoinedStr):
            yield "".join(str(x.value) if isinstance(x, ast.Constant) else ANY for x in node.values)


def words(text: str) -> tuple[str, ...]:
    return tuple(ANY if ANY in word or word == "..." else word.strip(".,:;'()") for word in text.split())


def common(quoted: tuple[str, ...], text: tuple[str, ...]) -> int:
    """Return the number of words of `quoted` that occur literally and in succession in a text; -1 for no match.

    `ANY` in the text stands for any number of words.
    """
    reached = dict.fromkeys(range(len(text) + 1), 0)
    for word in quoted:
        after: dict[int, int] = {}
        for place, count in reached.items():
            if place < len(text) and (text[place] == word or ANY in (text[place], word)):
                after[place + 1] = max(after.get(place + 1, -1), count + (text[place] == word))
            if place and text[place - 1] == ANY:
                after[place] = max(after.get(place, -1), count)
        reached = after
    return max(reached.values(), default=-1)


def is_message(quoted: str) -> bool:
    """Return True if a text of the source matches a quotation, and has at least a third of its words literally."""
    parts = words(quoted)
    stated = sum(word != ANY for word in parts)
    literal = {*parts} - {ANY}
    near = [text for text, known in texts().items() if len(literal & known) * 3 >= len(literal)]
    return any(3 * common(parts, text) >= stated for text in near)


@pytest.mark.parametrize("quoted", quotations())
def test_a_quotation_is_a_message(quoted: str) -> None:
    assert is_message(quoted), f"no message contains {quoted!r}"


def test_other_words_are_no_message() -> None:
    assert not is_message("leaves accelerations closed there")
    assert not is_message("is a given function of space without values")
