"""Write files whole or not at all, name the reason if a file cannot be written, and format CSV files."""

from __future__ import annotations

import errno
import numbers
import os
import stat
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from lagrange.errors import RunError, StatementError, shortened, shown, with_type

_FULL = {errno.ENOSPC: "the disk is full", errno.EDQUOT: "the disk quota is used up", errno.EFBIG: "it is too large"}

Writer = Callable[[BinaryIO], object]  # Callback that writes the content of an open binary file


def write_atomically(path: str | os.PathLike[str], write: Writer) -> Path:
    """Write a file whole or not at all, and return its path. `write` receives an open file and writes the content.

    The content goes to a temporary file in the same folder, which is synced to the disk and then moved to `path`. A
    link is followed; an existing file keeps its permissions. Raises StatementError for a path that cannot be written,
    RunError if the disk is full or fails.
    """
    target = real_path(path)
    try:
        part = filled_part(target, write, old_mode(target))
        try:
            part.replace(target)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise in_words(target, error) from error
    sync_folder(target.parent)
    return target


def filled_part(target: Path, write: Writer, mode: int | None) -> Path:
    """Call `write` with a new hidden file in the folder of `target`, and return the path of the hidden file.

    The file has the permissions `mode`, None for the default, and is synced to the disk. If `write` raises an
    exception, the file is removed.
    """
    part = target.with_name(f".{target.name[:32]}.{os.urandom(8).hex()}.part")
    try:
        with part.open("xb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        if mode is not None:
            part.chmod(mode)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return part


def sync_folder(folder: Path) -> None:
    """Sync a folder to the disk, if the system supports this, so that new file names survive a power failure."""
    if os.name == "posix":
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def _name(target: Path) -> str:
    return shortened(str(target), 140)


def real_path(path: str | os.PathLike[str]) -> Path:
    """Return the path with its links followed. Raises StatementError for an invalid path."""
    if not isinstance(path, (str, os.PathLike)):
        raise StatementError(f"the path is {with_type(path)}: give the path of a file or folder.")
    if not os.fsdecode(path).isprintable():
        raise StatementError(f"the path {shown(os.fsdecode(path))} has control characters: give another name.")
    try:
        return Path(os.path.realpath(path))
    except ValueError as error:
        raise StatementError(f"Cannot write {shown(os.fspath(path))}: {error}. Name another file.") from None


def check_place(path: str | os.PathLike[str]) -> None:
    """Raise StatementError or RunError for a path that cannot be written, before its content is computed."""
    target = real_path(path)
    try:
        old_mode(target)
    except OSError as error:  # a name that is too long
        raise in_words(target, error) from error
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise in_words(target, PermissionError(errno.EACCES, os.strerror(errno.EACCES)))


def old_mode(target: Path) -> int | None:
    """Return the permissions of the existing file `target`, None if there is no file.

    Raises StatementError for a folder or a device, and if the folder of `target` does not exist.
    """
    if not target.parent.is_dir():
        raise StatementError(
            f"Cannot write {_name(target)}: there is no folder {_name(target.parent)}. Make this folder, or name "
            "another."
        )
    if not target.exists():
        return None
    mode = target.stat().st_mode
    if stat.S_ISDIR(mode):
        raise StatementError(f"Cannot write {_name(target)}: it is a folder. Name a file in it.")
    if not stat.S_ISREG(mode):
        raise StatementError(f"Cannot write {_name(target)}: it is a device or a pipe, not a file. Name a file.")
    return stat.S_IMODE(mode)


def in_words(target: Path, error: OSError) -> StatementError | RunError:
    """Return the error to raise for the OSError `error`, which occurred while `target` was written.

    Its message names the cause and says what to do.
    """
    reason = _FULL.get(error.errno or 0)
    if reason:
        return RunError(
            f"Cannot write {_name(target)}: {reason}. Nothing was written; free some space or write elsewhere."
        )
    if isinstance(error, PermissionError) or error.errno == errno.EROFS:
        return StatementError(
            f"Cannot write {_name(target)}: the folder {_name(target.parent)} may not be written to. Name another "
            "folder."
        )
    reason = error.strerror or str(error)
    return RunError(f"Cannot write {_name(target)}: {reason}. Nothing was written; name another file or folder.")


def write_together(folder: str | os.PathLike[str], files: Mapping[str, Writer | None]) -> list[Path]:
    """Write files into a folder and return their paths; a file without a writer is removed if it exists.

    An error while the new files are written changes nothing. If the replacement of the old files is interrupted,
    every file is whole. The last file is then missing, unless all files are old or all are new. Other files of the
    folder stay. Links are followed, existing files keep their permissions. Raises StatementError for a folder that
    cannot be written to, RunError if the disk is full or fails.
    """
    home = real_path(folder)
    targets = {name: real_path(home / name) for name in files}
    parts: dict[str, Path] = {}
    current_path = home
    try:
        modes = {name: old_mode(target) for name, target in targets.items()}
        for name, write in files.items():
            current_path = targets[name]
            if write is not None:
                parts[name] = filled_part(current_path, write, modes[name])
        _exchange(home, targets, parts)
    except BaseException as error:
        for part in parts.values():
            part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise in_words(current_path, error) from error
        raise
    return [targets[name] for name in parts]


def _exchange(home: Path, targets: Mapping[str, Path], parts: Mapping[str, Path]) -> None:
    """Replace the files `targets` by the new files `parts`, both by name; a target without a new file is removed.

    The last target is removed first and replaced last, so that it is missing after an interruption. Errors name the
    folder `home`.
    """
    *_, last = targets
    try:
        for name in reversed([*targets]):
            if name == last or name not in parts:
                targets[name].unlink(missing_ok=True)
        for name, part in parts.items():
            part.replace(targets[name])
    except OSError as error:
        raise RunError(
            f"Cannot exchange the files of {home}: {error.strerror}. They are incomplete without {last}: write them "
            "again, or to another folder."
        ) from error
    for folder in {target.parent for target in targets.values()}:
        sync_folder(folder)


def write_rows(file: BinaryIO, names: Sequence[str], columns: Sequence[Iterable[object]]) -> None:
    """Write columns under their names as CSV to `file`, with enough digits to read back the same numbers."""
    file.write((",".join(map(cell, names)) + "\n").encode())
    file.writelines((",".join(map(cell, row)) + "\n").encode() for row in zip(*columns, strict=True))


def cell(value: object) -> str:
    """Return `value`, a number or a text, as a cell of a CSV file (RFC 4180). A number round-trips.

    A text that starts with ``= + - @`` or a control character gets an apostrophe in front, because spreadsheets would
    run it as a formula.
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
