"""Read a TOML file as data and find the line and column of each value, for messages."""

from __future__ import annotations

import os
import re
import stat
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

from lagrange.errors import SceneError, listing, singular, suggestion, with_type

KeyPath = tuple[str | int, ...]
"""Path to a value: keys and list indices from the top of the file, such as ("positions", "bob", 0)."""

_TOKEN = re.compile(
    r'(?P<text>"""(?:\\.|[^\\])*?"""(?:"{0,2})|'
    r"'''.*?'''(?:'{0,2})|"
    r'"(?:\\.|[^"\\\n])*"|'
    r"'[^'\n]*')"
    r"|(?P<line>\n[ \t\r\n]*)"
    r"|(?P<skip>[ \t\r]+|#[^\n]*)"
    r"|(?P<mark>[][{}=,.])"
    r"|(?P<bare>[^][{}=,.\s\"'#]+)",
    re.DOTALL,
)
_ESCAPE = re.compile(r"\\(?:u[0-9A-Fa-f]{4}|U[0-9A-Fa-f]{8}|\r?[ \t]*\n\s*|.)", re.DOTALL)


@dataclass
class _Frame:
    """State of the scanner in one table, inline table or list, with its path from the top of the file.

    `keys` are the parts of the key that is being read, and `start` is its offset. `index` counts the entries of a list.
    """

    path: KeyPath
    kind: str  # "table", "inline" or "list"
    keys: list[str] = field(default_factory=list)
    start: int = 0
    valued: bool = False  # True after the sign =, or inside a list
    index: int = 0

    def here(self) -> KeyPath:
        """Return the path of the value that is being scanned."""
        return (*self.path, self.index) if self.kind == "list" else (*self.path, *self.keys)


def places(text: str) -> tuple[dict[KeyPath, int], dict[KeyPath, int]]:
    """Return {path: offset of its key} and {path: offset of its value} in a TOML text, up to its first error."""
    keys: dict[KeyPath, int] = {}
    values: dict[KeyPath, int] = {}
    frames = [_Frame((), "table")]
    header = 0  # Number of brackets at the beginning of a line: 1 for a table, 2 for an entry of a list of tables
    counts: dict[KeyPath, int] = {}
    for match in _TOKEN.finditer(text):
        if not frames:
            break
        kind, token, offset, frame = match.lastgroup, match.group(), match.start(), frames[-1]
        if kind == "skip":
            continue
        if kind == "line":
            if frame.kind == "table":
                path = _numbered(frame.keys, counts, entry=header == 2) if header else frame.path
                keys.setdefault(path, frame.start)
                frames[-1] = _Frame(path, "table")
                header = 0
        elif frame.valued and not header:
            _read_value(frames, token, offset, values)
        elif token == "[" and frame.kind == "table":
            header += 1
        elif token == "=":
            frame.valued = True
            keys.setdefault(frame.here(), frame.start)
        elif token == "}":
            frames.pop()
        elif kind in ("bare", "text"):
            frame.start = frame.start if frame.keys else offset
            frame.keys.append(token if kind == "bare" else token[1:-1])
            if header:
                keys.setdefault(tuple(frame.keys), frame.start)
    return keys, values


def _numbered(names: list[str], counts: dict[KeyPath, int], *, entry: bool) -> KeyPath:
    """Return the path of a table header. The name of a list of tables is followed by the index of its last entry.

    `counts` has the index of the last entry of each list. If `entry` is true, the header begins a new entry.
    """
    path: KeyPath = ()
    for name in names:
        path = (*path, name)
        if entry and len(path) == len(names):
            counts[path] = counts.get(path, -1) + 1
        if path in counts:
            path = (*path, counts[path])
    return path


def _read_value(frames: list[_Frame], token: str, offset: int, values: dict[KeyPath, int]) -> None:
    frame = frames[-1]
    if token == "," and frame.kind == "list":
        frame.index += 1
    elif token == "," and frame.kind == "inline":
        frames[-1] = _Frame(frame.path, "inline")
    elif token in ("]", "}"):
        frames.pop()
    else:
        values.setdefault(frame.here(), offset)
        if token == "[":
            frames.append(_Frame(frame.here(), "list", valued=True))
        elif token == "{":
            frames.append(_Frame(frame.here(), "inline"))


def line_and_column(text: str, offset: int) -> tuple[int, int]:
    """Return line and column of an offset in a text, both counted from 1."""
    return text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset)


def inside(text: str, offset: int, column: int) -> int:
    """Return the offset of a character in a TOML string, which begins at `offset` of the file's `text`.

    `column` is the number of the character in the string, counted from 1.
    """
    quotes = text[offset : offset + 3]
    at = offset + (3 if quotes in ('"""', "'''") else 1)
    if at == offset + 3:
        at += text[at : at + 1] == "\n"
    for _ in range(column - 1):
        at = _after_fold(text, at, quotes)
        escape = _ESCAPE.match(text, at) if quotes[0] == '"' else None
        at = escape.end() if escape else at + 1
    return _after_fold(text, at, quotes)


def _after_fold(text: str, at: int, quotes: str) -> int:
    """Return the offset after a fold at `at`: line breaks and blanks that a backslash removes from a string.

    Without a fold, or if `quotes` do not begin a multi-line string, the offset is `at`.
    """
    fold = re.compile(r"(?:\\[ \t]*\n\s*)+").match(text, at) if quotes == '"""' else None
    return fold.end() if fold else at


LARGEST_FILE, LARGEST_STORED = 1_048_576, 67_108_864
"""Largest size in bytes of a scene file, and of a statement in a file of a run or in a pickle."""
MOST_DOTS = 20_000_000
"""Largest sum over the lines of (number of dots outside of strings)**2. Time and memory of tomllib grow like this sum
for keys such as a.a.a."""
MOST_HEADERS = 5_000  # Largest number of lines that begin with a bracket; tomllib takes 30 us for each

_POSITION = re.compile(r"(?s)(.*) \(at (?:line (\d+), column (\d+)|end of document)\)")
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
    """TOML file as data. Raises SceneError for a file that cannot be read or is not TOML.

    `text` is the content of the file; None reads it from `path`. `most` is its largest size in bytes.
    """

    def __init__(self, path: str | os.PathLike[str], text: str | None = None, most: int = LARGEST_FILE) -> None:
        if not isinstance(path, (str, os.PathLike)):
            raise SceneError(f"{with_type(path)} is not a path: give the path of a scene file.")
        self.file, self.most = str(path), most
        content = self._read(path) if text is None else text.encode()
        if len(content) > most:
            self._fail(f"the file has more than {most} bytes, the most that a scene may have.")
        self.content = self._decode(content).replace("\r\n", "\n")
        self.data = self._parse()

    def refuse(self, reason: str, *path: str | int, column: int | None = None, key: bool = False) -> NoReturn:
        """Raise a SceneError with the message `reason`, located at the value at `path`.

        If `key` is true, the error is located at the key of this value. If the file has no such value, the error is
        located at the nearest table around it. With `column`, the error is located at this character, counted from 1,
        of the text at `path`.
        """
        keys, values = self._places
        offset = 0
        for ancestor in (path[:length] for length in range(len(path), 0, -1)):
            if ancestor in keys or ancestor in values:
                offset = keys.get(ancestor, 0) if key or ancestor not in values else values[ancestor]
                break
        if column is not None and path in values:
            offset = inside(self.content, offset, column)
        line, column_number = line_and_column(self.content, offset)
        raise SceneError(reason, file=self.file, line=line, column=column_number)

    def check_keys(self, table: Mapping[str, Any], known: Collection[str], what: str, *path: str | int) -> None:
        """Raise SceneError for a key of the table at `path` that is not in `known`.

        `what` is the kind of the key in the message, such as "key of a scene".
        """
        for name in table:
            if name not in known:
                self.refuse(
                    f"{name[:80]!r} is not {singular(what)}; there are {listing(known)}.{suggestion(name[:80], known)}",
                    *path,
                    name,
                    key=True,
                )

    def table(self, key: str, known: Collection[str] | None = None, what: str = "") -> Mapping[str, Any]:
        """Return the table `key` of the file, which is empty if the key is missing.

        Raises SceneError for a key in it that is not in `known` (None: any key). `what` is the kind of the key in the
        message.
        """
        table = self.data.get(key, {})
        if not isinstance(table, Mapping):
            self.refuse(f"{key} is {kind_of(table)}: write a table [{key}] of names and values.", key)
        if known is not None:
            self.check_keys(table, known, what, key)
        return table

    def text(self, *path: str | int) -> str:
        """Return the text at a path of keys and indices in the file. Raises SceneError for another type."""
        value = self.value(*path)
        if not isinstance(value, str):
            self.refuse(f"{path[-1]} is {kind_of(value)}: give a text in quotation marks.", *path)
        return value

    def words(self, key: str) -> str:
        """Return the text of a key as one line, or "" without the key. Raises SceneError for control characters."""
        text = " ".join(self.text(key).split()) if key in self.data else ""
        if not text.isprintable():
            self.refuse(f"{key} contains a control character: write plain text.", key)
        return text

    def value(self, *path: str | int) -> Any:
        """Return the value of the file at a path of keys and indices, which must exist."""
        value: Any = self.data
        for key in path:
            value = value[key]
        return value

    @cached_property
    def _places(self) -> tuple[dict[KeyPath, int], dict[KeyPath, int]]:
        return places(self.content)

    def _read(self, path: str | os.PathLike[str]) -> bytes:
        """Return the bytes of a regular file. Other files are refused: a pipe could block, a device may be endless."""
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
            return tomllib.loads(self.content)
        except RecursionError:
            self._fail("the file is nested too deeply: a scene has tables in tables at most.")
        except tomllib.TOMLDecodeError as error:
            match = _POSITION.fullmatch(str(error))
            reason, line, column = match.groups() if match else (str(error).rstrip("."), "0", "0")
            self._fail(f"this is not TOML: {reason}.", int(line or len(lines)) or None, int(column or 0) or None)
        except ValueError:  # The integer has more digits than Python allows
            self._fail("an integer has thousands of digits: write a decimal, such as 1.5e100.")

    def _fail(self, reason: str, line: int | None = None, column: int | None = None) -> NoReturn:
        raise SceneError(reason, file=self.file, line=line, column=column)


def kind_of(value: Any) -> str:
    """Return the type of a TOML value in words, such as "a list"."""
    return next((word for kind, word in _KINDS if isinstance(value, kind)), "a date or time")


def dotted(path: tuple[str | int, ...]) -> str:
    """Return a path as in TOML, with indices in brackets: positions.bob[0]."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)[1:]
