"""Rewritten functions of this package, stored beside the byte code of their modules.

Parsing and rewriting a function takes 0.9 ms, and an integration method has up to a hundred functions. A stored file is
used only if its digest agrees with its content, the source file, the front end, and Python's version.
"""

from __future__ import annotations

import ast
import linecache
import marshal
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.util import cache_from_source
from pathlib import Path
from types import CodeType, FunctionType

from lagrange.errors import LagrangeError
from lagrange.procedure.front.rewriting import Rewriter, as_module

FRONT = Path(__file__).parent
PACKAGE = FRONT.parents[1]


class _Stored:
    """The rewritten functions of one source file, by key: {(first line, name, True if it is inlined): code}."""

    def __init__(self, file: str) -> None:
        self.path = Path(cache_from_source(file)).with_suffix(".plain")
        self.key = "".join([_front_end(), file, *linecache.getlines(file)]).encode()
        self.codes: dict[tuple[int, str, bool], CodeType] = {}
        with suppress(OSError):
            stored = self.path.read_bytes()
            content = stored[sha256().digest_size :]
            if stored == sha256(self.key + content).digest() + content:
                self.codes = marshal.loads(content)
        self.count = len(self.codes)

    def write(self) -> None:
        """Write the cache file if there are new functions. A folder without write permission is no error."""
        if len(self.codes) > self.count and not sys.dont_write_bytecode:
            self.count = len(self.codes)
            part = self.path.with_suffix(f".{os.getpid()}")
            with suppress(OSError):
                self.path.parent.mkdir(parents=True, exist_ok=True)
                content = marshal.dumps(self.codes)
                part.write_bytes(sha256(self.key + content).digest() + content)
                part.replace(self.path)


@cache
def _front_end() -> str:
    """Return a digest of Python's version and of the files of this folder: every rewritten function depends on them."""
    return sha256(
        b"".join([sys.version.encode(), *(path.read_bytes() for path in sorted(FRONT.glob("*.py")))])
    ).hexdigest()


_STORED: dict[str, _Stored] = {}
"""Stored functions by source file."""


def _stored(file: str) -> _Stored | None:
    """Return the stored functions of a file, or None for a file outside this package."""
    if file not in _STORED and Path(file).is_relative_to(PACKAGE):
        _STORED[file] = _Stored(file)
    return _STORED.get(file)


def rewritten_code(function: FunctionType, *, inlined: bool) -> CodeType:
    """Return the code object of a plain function, rewritten by `rewriting` to build a procedure.

    It is taken from the cache file of the function's module if that has it. `inlined` is true for a function that is
    inlined into its callers. Raises LagrangeError if the function cannot be rewritten.
    """
    code = function.__code__
    FILES.add(code.co_filename)
    stored, key = _stored(code.co_filename), (code.co_firstlineno, code.co_qualname, inlined)
    if stored is not None and key in stored.codes:
        return stored.codes[key]
    tree, comments = source_of(function)
    plain = Rewriter(tree, comments, inlined=inlined).function(code.co_freevars)
    result = compile(as_module(plain), code.co_filename, "exec").co_consts[0]
    assert isinstance(result, CodeType)
    if stored is not None:
        stored.codes[key] = result
    return result


def store() -> None:
    """Write the functions that were rewritten since the last call to the cache files."""
    for stored in list(_STORED.values()):
        stored.write()


def source_of(function: FunctionType) -> tuple[ast.FunctionDef, Mapping[int, str]]:
    """Return the syntax tree of a function, and the comments that fill whole lines of its module, by line.

    A comment is a line that begins with `#`, even inside a string. Raises LagrangeError if the source cannot be read.
    """
    code = function.__code__
    functions, comments = _module(code.co_filename)
    tree = functions.get(code.co_firstlineno)
    if tree is None or tree.name != function.__name__:
        raise LagrangeError(
            f"procedure {function.__name__}: its source is not in {code.co_filename}. "
            "Install lagrange with its .py files."
        )
    return tree, comments


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
