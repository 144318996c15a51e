"""Files that are either written whole or not at all."""

from __future__ import annotations

import errno
import numbers
import os
import secrets
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from lagrange.errors import RunError, StatementError

_FULL = {errno.ENOSPC: "the disk is full", errno.EDQUOT: "the disk quota is used up", errno.EFBIG: "it is too large"}

_ROWS_AT_ONCE = 4096


def write_atomically(path: str | os.PathLike[str], write: Callable[[BinaryIO], object]) -> Path:
    """Let `write` fill a temporary file in the same folder, sync it and move it to `path`, which is returned.

    Whatever stops it, there is either the whole new file or what was there before. A link is followed; an existing
    file keeps its permissions. Raises StatementError for a path that cannot be written, RunError if the disk is full
    or fails.
    """
    target = Path(os.path.realpath(path))
    try:
        return _write(target, write)
    except OSError as error:
        raise _in_words(target, error) from error


def write_csv(path: str | os.PathLike[str], names: Sequence[str], columns: Sequence[Iterable[object]]) -> Path:
    """Write columns under their names, atomically; see `write_atomically`. Numbers are written to round-trip."""

    def write(file: BinaryIO) -> None:
        lines = _lines(names, columns)
        while block := list(islice(lines, _ROWS_AT_ONCE)):
            file.write("".join(block).encode())

    return write_atomically(path, write)


def cell(value: object) -> str:
    """Return a CSV cell (RFC 4180): a number as its shortest round-trip text, a text so that no spreadsheet runs it.

    A text that starts with ``= + - @`` or a control character gets an apostrophe in front: spreadsheets would take it
    for a formula.
    """
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        return repr(float(value))
    text = str(value)
    if text.lstrip(" ").startswith(("=", "+", "-", "@", "\t", "\r", "\n")):
        text = "'" + text
    quoted = not text or any(mark in text for mark in ',"\r\n')
    return '"' + text.replace('"', '""') + '"' if quoted else text


def _lines(names: Sequence[str], columns: Sequence[Iterable[object]]) -> Iterator[str]:
    yield ",".join(map(cell, names)) + "\n"
    for row in zip(*columns, strict=True):
        yield ",".join(map(cell, row)) + "\n"


def _write(target: Path, write: Callable[[BinaryIO], object]) -> Path:
    mode = _mode(target)
    part = target.with_name(f".{target.name[:32]}.{secrets.token_hex(8)}.part")
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    try:
        with os.fdopen(descriptor, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        if mode is not None:
            part.chmod(mode)
        part.replace(target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _sync_folder(target.parent)
    return target


def _mode(target: Path) -> int | None:
    """Return the old file's permissions, None if there is none; refuse to replace what is not a file."""
    if not target.parent.is_dir():
        raise StatementError(f"Cannot write {target}: there is no folder {target.parent}. Make it or name another.")
    if not target.exists():
        return None
    found = target.stat().st_mode
    if stat.S_ISDIR(found):
        raise StatementError(f"Cannot write {target}: it is a folder. Name a file in it.")
    if not stat.S_ISREG(found):
        raise StatementError(f"Cannot write {target}: it is a device or a pipe, not a file. Name a file.")
    return stat.S_IMODE(found)


def _sync_folder(folder: Path) -> None:
    """Make the new name last through a power cut, where the system can do that to a folder."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _in_words(target: Path, error: OSError) -> StatementError | RunError:
    reason = _FULL.get(error.errno or 0)
    if reason:
        return RunError(f"Cannot write {target}: {reason}. Nothing was written; free some space or write elsewhere.")
    if isinstance(error, PermissionError) or error.errno == errno.EROFS:
        return StatementError(
            f"Cannot write {target}: the folder {target.parent} may not be written to. Name another folder."
        )
    reason = error.strerror or str(error)
    return RunError(f"Cannot write {target}: {reason}. Nothing was written; name another file or folder.")
