"""Offsets of the keys and values of a TOML text, so that an error can name line and column."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

KeyPath = tuple[str | int, ...]
"""Keys and list indices from the top: ("positions", "bob", 0)."""

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
    """A table, an inline table or a list that is being read."""

    path: KeyPath
    kind: str  # "table", "inline" or "list"
    keys: list[str] = field(default_factory=list)
    start: int = 0
    valued: bool = False  # past the "=", or inside a list
    index: int = 0

    def here(self) -> KeyPath:
        """Return the path of the value that is being read."""
        return (*self.path, self.index) if self.kind == "list" else (*self.path, *self.keys)


def places(text: str) -> tuple[dict[KeyPath, int], dict[KeyPath, int]]:
    """Return the offsets of keys and of values by path, for a TOML text with single-character line ends.

    If the text is not valid TOML, the offsets before its first error are right.
    """
    keys: dict[KeyPath, int] = {}
    values: dict[KeyPath, int] = {}
    frames = [_Frame((), "table")]
    header = 0  # brackets at the beginning of a line: 1 for a table, 2 for an entry of a list of tables
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
    """Return the path of a table header; a name of a list of tables is followed by the index of its last entry.

    `counts` has the index of the last entry of each list. With `entry` the header begins another one.
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
    """Return line and column of an offset, both counted from 1."""
    return text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset)


def inside(text: str, offset: int, column: int) -> int:
    """Return the offset of the character in this column, from 1, of the string that starts at `offset`."""
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
    """Return the offset after backslashes at ends of lines, which add no character to the string."""
    fold = re.compile(r"(?:\\[ \t]*\n\s*)+").match(text, at) if quotes == '"""' else None
    return fold.end() if fold else at
