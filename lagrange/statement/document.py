"""One TOML file: read within bounds, with the place of everything in it."""

from __future__ import annotations

import math
import os
import re
import stat
import sys
import tomllib
from collections.abc import Collection, Mapping
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any, NoReturn

from lagrange.errors import SceneError, StatementError, listing, shown, suggestion
from lagrange.statement import places
from lagrange.statement.number import TOO_LARGE, real_number
from lagrange.statement.text import read_expression, read_number

LARGEST_FILE = 1_048_576
"""The most bytes of a file."""
MOST_DOTS = 20_000_000
"""The largest sum over all lines of the square of their number of dots: the time and the memory that tomllib takes for
a key such as a.a.a grow like this sum."""
MOST_HEADERS = 5_000
"""The most lines that start with a bracket; tomllib takes 30 us for each."""

_POSITION = re.compile(r"(?s)(.*) \(at (?:line (\d+), column (\d+)|end of document)\)")
_DECIMAL = re.compile(r"(?<![\w.])[+-]?[0-9][0-9_]*(?:\.[0-9_]+)?(?:[eE][+-]?[0-9_]+)?(?![\w.])")
_CONDITION = re.compile(r"\bif\b")
_INEQUALITY = re.compile(r"[<>]|!=")
_KINDS = (
    (bool, "true or false"),
    (str, "a text"),
    (int, "an integer"),
    (float, "a number"),
    (list, "a list"),
    (Mapping, "a table"),
)


class Document:
    """A TOML file as data. Raises SceneError for a file that cannot be read or is not TOML.

    `text` is what the file holds, where that is known.
    """

    def __init__(self, path: str | os.PathLike[str], text: str | None = None) -> None:
        if not isinstance(path, (str, os.PathLike)):
            raise SceneError(f"{shown(path)} ({type(path).__name__}) is no path: give the path of a scene file.")
        self.file = str(path)
        content = self._read(path) if text is None else text.encode()
        self.content = self._decode(self._within(content)).replace("\r\n", "\n")
        self.data = self._parse()

    def refuse(self, reason: str, *path: str | int, column: int | None = None, key: bool = False) -> NoReturn:
        """Raise a SceneError at a value (or its key), at a column inside its text, or at what is around it."""
        keys, values = self._places
        offset = 0
        for known in (path[:length] for length in range(len(path), 0, -1)):
            if known in keys or known in values:
                offset = keys.get(known, 0) if key or known not in values else values[known]
                break
        if column is not None and path in values:
            offset = places.inside(self.content, offset, column)
        line, place = places.line_and_column(self.content, offset)
        raise SceneError(reason, file=self.file, line=line, column=place)

    def check_keys(self, table: Mapping[str, Any], known: Collection[str], what: str, *path: str | int) -> None:
        """Refuse a key of the table at `path` that is not known."""
        for name in table:
            if name not in known:
                self.refuse(
                    f"{name[:80]!r} is no {what}; there are {listing(known)}.{suggestion(name[:80], known)}",
                    *path,
                    name,
                    key=True,
                )

    def table(self, key: str, known: Collection[str] | None = None, what: str = "") -> Mapping[str, Any]:
        """Return a table of the file, empty if it is not there, with none but the known keys."""
        table = self.data.get(key, {})
        if not isinstance(table, Mapping):
            self.refuse(f"{key} is {kind_of(table)}: write a table [{key}] of names and values.", key)
        if known is not None:
            self.check_keys(table, known, what, key)
        return table

    def text(self, *path: str | int) -> str:
        """Return a text."""
        value = self.value(*path)
        if not isinstance(value, str):
            self.refuse(f"{path[-1]} is {kind_of(value)}: give a text in quotation marks.", *path)
        return value

    def words(self, key: str) -> str:
        """Return a text for people, on one line; a terminal would obey control characters, so there are none."""
        text = " ".join(self.text(key).split()) if key in self.data else ""
        if not text.isprintable():
            self.refuse(f"{key} contains a control character: write plain text.", key)
        return text

    def number(self, *path: str | int) -> float:
        """Return a number, or the value of a constant expression such as "pi/6"."""
        value, what = self.value(*path), _dotted(path)
        if not isinstance(value, (int, float, str)) or isinstance(value, bool):
            self.refuse(f'{what} is {kind_of(value)}: give a number, or a constant expression such as "pi/6".', *path)
        try:
            return read_number(value) if isinstance(value, str) else real_number(value, what)
        except SceneError as error:
            self.refuse(f"{what}: {error.reason}", *path, column=error.column)
        except StatementError as error:
            self.refuse(str(error), *path)

    def expression(self, names: Mapping[str, Any], *path: str | int) -> Any:
        """Return the SymPy expression that a text, or a number, states in these names."""
        value, what = self.value(*path), _dotted(path)
        if not isinstance(value, (int, float, str)) or isinstance(value, bool):
            self.refuse(f'{what} is {kind_of(value)}: give an expression as a text, such as "2*x".', *path)
        if not isinstance(value, str):
            value = repr(self.number(*path))
        try:
            return read_expression(value, names)
        except SceneError as error:
            self.refuse(f"{what}: {error.reason}", *path, column=error.column)

    def equation(self, names: Mapping[str, Any], *path: str | int) -> Any:
        """Return the expression that a text says is zero: itself, or the difference of the sides of left == right."""
        value = self.value(*path)
        if not isinstance(value, str) or value.count("==") != 1 or _CONDITION.search(value):
            if isinstance(value, str) and _INEQUALITY.search(value) and not _CONDITION.search(value):
                self.refuse(
                    f"{_dotted(path)} is an inequality. Constraints are equations: state the one that holds, and end "
                    "the run by an event where the multiplier changes sign.",
                    *path,
                )
            return self.expression(names, *path)
        sides, begin = [], 0
        for side in value.split("=="):
            try:
                sides.append(read_expression(side, names))
            except SceneError as error:
                place = None if error.column is None else error.column + begin
                self.refuse(f"{_dotted(path)}: {error.reason}", *path, column=place)
            begin += len(side) + len("==")
        left, right = sides
        return left - right

    def value(self, *path: str | int) -> Any:
        """Return the value at a path that is there."""
        value: Any = self.data
        for key in path:
            value = value[key]
        return value

    @cached_property
    def _places(self) -> tuple[dict[places.KeyPath, int], dict[places.KeyPath, int]]:
        return places.places(self.content)

    def _read(self, path: str | os.PathLike[str]) -> bytes:
        """Return the bytes of a regular file; a pipe would block, and a device may have no end."""
        data, mode = b"", 0
        try:
            mode = Path(path).stat().st_mode
            if stat.S_ISREG(mode):
                with Path(path).open("rb") as stream:
                    data = stream.read(LARGEST_FILE + 1)
        except FileNotFoundError:
            self._fail("there is no such file: check the path.")
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            self._fail(f"the file cannot be read ({reason}): check the path and its permissions.")
        if not stat.S_ISREG(mode):
            kind = "folder" if stat.S_ISDIR(mode) else "device or pipe"
            self._fail(f"this is a {kind}: give the path of a scene file.")
        return data

    def _within(self, data: bytes) -> bytes:
        if len(data) > LARGEST_FILE:
            self._fail(f"the file has more than {LARGEST_FILE} bytes, the most that a scene may have.")
        return data

    def _decode(self, data: bytes) -> str:
        try:
            return data.decode("utf-8").removeprefix("\ufeff")
        except UnicodeDecodeError as error:
            before = data[: error.start]
            line, column = before.count(b"\n") + 1, error.start - before.rfind(b"\n")
            self._fail(f"byte 0x{data[error.start]:02x} is not UTF-8: save the file as UTF-8.", line, column)

    def _parse(self) -> dict[str, Any]:
        lines = self.content.split("\n")
        if (
            sum(line.count(".") ** 2 for line in lines) > MOST_DOTS
            or sum(line.lstrip().startswith("[") for line in lines) > MOST_HEADERS
        ):
            self._fail(
                "the file has too many dots in its lines, or too many brackets before them: state it in fewer tables."
            )
        try:
            return tomllib.loads(self.content, parse_float=_double)
        except RecursionError:
            self._fail("the file is nested too deeply: a scene has tables in tables at most.")
        except tomllib.TOMLDecodeError as error:
            reason, line, column = _split(str(error), len(lines))
            self._fail(f"this is not TOML: {reason}.", line, column)
        except ValueError:
            # Python reads no integer of more digits than its limit, and `_double` none of these.
            self._refuse_number()

    def _refuse_number(self) -> NoReturn:
        """Refuse the first number of the file that is none in doubles; the file is TOML up to there, if no further."""
        for path, offset in sorted(self._places[1].items(), key=itemgetter(1)):
            match = _DECIMAL.match(self.content, offset)
            if match and (reason := _out_of_range(match.group())):
                line, column = places.line_and_column(self.content, offset)
                self._fail(f"{_dotted(path)[:80]} is {reason}.", line, column)
        raise AssertionError("a number that the reader refuses stands in the file")

    def _fail(self, reason: str, line: int | None = None, column: int | None = None) -> NoReturn:
        raise SceneError(reason, file=self.file, line=line, column=column)


def kind_of(value: Any) -> str:
    """Return what a TOML value is, in words."""
    return next((word for kind, word in _KINDS if isinstance(value, kind)), "a date or time")


def _dotted(path: tuple[str | int, ...]) -> str:
    """Return a path as it is written in TOML, with indices in brackets: positions.bob[0]."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)[1:]


def _double(text: str) -> float:
    """Return the double of a TOML float. Raises ValueError where it is infinite, or zero, and the text is not."""
    if _out_of_range(text):
        raise ValueError(text)
    return float(text)


def _out_of_range(text: str) -> str:
    """Return why a decimal has no double, or nothing; tomllib reads no integer of more digits than Python's limit."""
    digits = sum(map(str.isdigit, text))
    shown = text if len(text) <= 20 else f"a number of {digits} digits"
    if text.lstrip("+-").replace("_", "").isdigit():
        limit = sys.get_int_max_str_digits()
        return f"{shown}, {TOO_LARGE}" if 0 < limit < digits else ""
    value = float(text)
    if math.isinf(value) and digits:
        return f"{shown}, {TOO_LARGE}"
    if value == 0.0 and text.lower().partition("e")[0].strip("+-0._"):
        return f"{shown}, too small for a floating-point number: give one above 4.9e-324, or 0"
    return ""


def _split(message: str, last: int) -> tuple[str, int | None, int | None]:
    match = _POSITION.fullmatch(message)
    if match is None:
        return message.rstrip("."), None, None
    line, column = match.group(2), match.group(3)
    return match.group(1), int(line) if line else last, int(column) if column else None
