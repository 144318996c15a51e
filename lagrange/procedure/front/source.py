"""Find the syntax tree of a function in its module, with the comments that fill whole lines."""

from __future__ import annotations

import ast
import linecache
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from types import FunctionType
from typing import NamedTuple

from lagrange.errors import LagrangeError


class Source(NamedTuple):
    """The syntax tree of a function, and the comments of its module by line.

    A comment is a line that begins with `#`, even inside a string.
    """

    tree: ast.FunctionDef
    comments: Mapping[int, str]


def source_of(function: FunctionType) -> Source:
    """Return the syntax tree of a function. Raises LagrangeError if its source cannot be read."""
    code = function.__code__
    functions, comments = _module(code.co_filename)
    tree = functions.get(code.co_firstlineno)
    if tree is None or tree.name != function.__name__:
        raise LagrangeError(
            f"procedure {function.__name__}: its source is not in {code.co_filename}. "
            "Install lagrange with its .py files."
        )
    return Source(tree, comments)


FILES: set[str] = set()
"""Files that contain plain functions, for locations in messages."""


@cache
def _module(file: str) -> tuple[Mapping[int, ast.FunctionDef], Mapping[int, str]]:
    """Return the functions of a file by first line (the line of the first decorator), and its comments by line."""
    FILES.add(file)
    lines = linecache.getlines(file)
    functions = {
        min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)]): node
        for node in _functions(ast.parse("".join(lines)).body)
    }
    stripped = {number: line.strip() for number, line in enumerate(lines, 1)}
    return functions, {number: line.lstrip("# ") for number, line in stripped.items() if line.startswith("#")}


def _functions(body: Iterable[ast.stmt]) -> Iterator[ast.FunctionDef]:
    """Yield the functions of a block, including those inside classes, functions and branches."""
    for statement in body:
        if isinstance(statement, ast.FunctionDef):
            yield statement
        yield from _functions(getattr(statement, "body", ()))
        yield from _functions(getattr(statement, "orelse", ()))
