"""A TOML file as data. Every refusal names file, line and column."""

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

from lagrange.errors import TOO_LARGE, SceneError, listing, shown, suggestion
from lagrange.statement.scene import places

LARGEST_FILE, LARGEST_STORED = 1_048_576, 67_108_864
"""Largest size of a scene file, and of a statement in a file of a run or in a pickle, in bytes."""
MOST_DOTS = 20_000_000
"""Largest sum over the lines of (number of dots outside of strings)**2. The time and memory of tomllib for keys such as
a.a.a grow like this sum."""
MOST_HEADERS = 5_000
"""Largest number of lines that start with a bracket; tomllib takes 30 us for each."""

_POSITION = re.compile(r"(?s)(.*) \(at (?:line (\d+), column (\d+)|end of document)\)")
_DECIMAL = re.compile(r"(?<![\w.])[+-]?[0-9][0-9_]*(?:\.[0-9_]+)?(?:[eE][+-]?[0-9_]+)?(?![\w.])")
_STRING = re.compile(r"\"(?:[^\"\\\n]|\\.)*+(?:\"|$)|'[^'\n]*(?:'|$)", re.MULTILINE)
_LONG_STRING = re.compile(r"\"\"\"|'''")
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

    `text` is the content of the file; None reads it from `path`. `most` is its largest size in bytes.
    """

    def __init__(self, path: str | os.PathLike[str], text: str | None = None, most: int = LARGEST_FILE) -> None:
        if not isinstance(path, (str, os.PathLike)):
            raise SceneError(f"{shown(path)} ({type(path).__name__}) is no path: give the path of a scene file.")
        self.file, self.most = str(path), most
        content = self._read(path) if text is None else text.encode()
        self.content = self._decode(self._within(content)).replace("\r\n", "\n")
        self.data = self._parse()

    def refuse(self, reason: str, *path: str | int, column: int | None = None, key: bool = False) -> NoReturn:
        """Raise a SceneError with line and column of the value at `path`, or of the nearest table around it.

        `key` points at the key instead; `column` points into the text of the value.
        """
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
        """Raise SceneError for a key of the table at `path` that is not in `known`."""
        for name in table:
            if name not in known:
                self.refuse(
                    f"{name[:80]!r} is no {what}; there are {listing(known)}.{suggestion(name[:80], known)}",
                    *path,
                    name,
                    key=True,
                )

    def table(self, key: str, known: Collection[str] | None = None, what: str = "") -> Mapping[str, Any]:
        """Return a table of the file, empty if it is missing. Raises SceneError for a key that is not in `known`."""
        table = self.data.get(key, {})
        if not isinstance(table, Mapping):
            self.refuse(f"{key} is {kind_of(table)}: write a table [{key}] of names and values.", key)
        if known is not None:
            self.check_keys(table, known, what, key)
        return table

    def text(self, *path: str | int) -> str:
        """Return the text at a path. Raises SceneError for another type."""
        value = self.value(*path)
        if not isinstance(value, str):
            self.refuse(f"{path[-1]} is {kind_of(value)}: give a text in quotation marks.", *path)
        return value

    def words(self, key: str) -> str:
        """Return the text of a key on one line, empty if it is missing.

        Raises SceneError for control characters, which a terminal would act on.
        """
        text = " ".join(self.text(key).split()) if key in self.data else ""
        if not text.isprintable():
            self.refuse(f"{key} contains a control character: write plain text.", key)
        return text

    def value(self, *path: str | int) -> Any:
        """Return the value at an existing path."""
        value: Any = self.data
        for key in path:
            value = value[key]
        return value

    @cached_property
    def _places(self) -> tuple[dict[places.KeyPath, int], dict[places.KeyPath, int]]:
        return places.places(self.content)

    def _read(self, path: str | os.PathLike[str]) -> bytes:
        """Return the bytes of a regular file. Other kinds are refused: a pipe would block, a device may have no end."""
        data, mode = b"", 0
        try:
            mode = Path(path).stat().st_mode
            if stat.S_ISREG(mode):
                with Path(path).open("rb") as stream:
                    data = stream.read(self.most + 1)
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
        if len(data) > self.most:
            self._fail(f"the file has more than {self.most} bytes, the most that a scene may have.")
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
        bare = lines if _LONG_STRING.search(self.content) else _STRING.sub("", self.content).split("\n")
        if (
            sum(line.count(".") ** 2 for line in bare) > MOST_DOTS
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
            # An integer has more digits than Python's limit, or `_double` refused a float.
            self._refuse_number()

    def _refuse_number(self) -> NoReturn:
        """Raise SceneError at the first number of the file that is out of the range of doubles.

        The file is valid TOML up to this number.
        """
        for path, offset in sorted(self._places[1].items(), key=itemgetter(1)):
            match = _DECIMAL.match(self.content, offset)
            if match and (reason := _out_of_range(match.group())):
                line, column = places.line_and_column(self.content, offset)
                self._fail(f"{dotted(path)[:80]} is {reason}.", line, column)
        raise AssertionError("a number that the reader refuses stands in the file")

    def _fail(self, reason: str, line: int | None = None, column: int | None = None) -> NoReturn:
        raise SceneError(reason, file=self.file, line=line, column=column)


def kind_of(value: Any) -> str:
    """Return the type of a TOML value in words, such as "a list"."""
    return next((word for kind, word in _KINDS if isinstance(value, kind)), "a date or time")


def dotted(path: tuple[str | int, ...]) -> str:
    """Return a path as it is written in TOML, with indices in brackets: positions.bob[0]."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)[1:]


def _double(text: str) -> float:
    """Return the double of a TOML float. Raises ValueError if it overflows to infinity or underflows to zero."""
    if _out_of_range(text):
        raise ValueError(text)
    return float(text)


def _out_of_range(text: str) -> str:
    """Return the words of a message if a decimal has no double, else "".

    Also for an integer with more digits than Python's limit, which tomllib cannot read.
    """
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
