"""Store the results of an ensemble on disk in the zarr format, in blocks of members with checksums."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import socket
import sys
import tempfile
import threading
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, shown
from lagrange.members.jobs import Job
from lagrange.members.results import INTERRUPTED, OUTPUT_TIME, OUTPUTS, STATE, STATUS, STATUSES, Results
from lagrange.members.store_description import (
    BLOCK,
    CHECKSUM,
    MEMBER,
    VARIABLE,
    difference,
    origin,
    start_name,
    stored_names,
)
from lagrange.members.table import MemberTable

if sys.platform != "win32":
    import fcntl

LOCK = ".lock"
"""Name of the lock file in a store's folder. The process that writes to the store writes its name to the file, and
removes it at the end. The file of a killed process has no effect."""

_HELD: set[str] = set()
_CHANGING = threading.Lock()
"""Lock of the set `_HELD`, which has the paths of the stores to which this process writes. The lock file excludes other
processes, but not other threads of this process."""


class StoreLock:
    """The exclusive right to write to the store of results in the folder `path`, until `close` is called.

    Creating it raises RunError if another call has this right. The lock is made by `lockf`, so forked workers do not
    keep it after their parent process was killed. No lock is taken if its file cannot be made, as in a read-only store,
    or if the system has no locks.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._key, self._descriptor = path / LOCK, os.path.realpath(path), -1
        with _CHANGING:
            if self._key in _HELD:
                raise _taken(path, "another thread of this process")
            self._descriptor = _locked(path, self._path)
            _HELD.add(self._key)

    def close(self) -> None:
        """Release the lock of the store, so that other calls can write to it."""
        with _CHANGING:
            _HELD.discard(self._key)
            if self._descriptor >= 0:
                with suppress(OSError):
                    self._path.unlink()
                os.close(self._descriptor)
                self._descriptor = -1


def _locked(store: Path, path: Path) -> int:
    """Make and lock the file `path`, and return its descriptor, or -1 if the file cannot be made or locked.

    Raises RunError, with the name of the store, if another process has locked it.
    """
    if sys.platform == "win32":
        return -1
    while True:
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError:
            return -1
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            owner = os.read(descriptor, 200).decode(errors="replace")
            os.close(descriptor)
            raise _taken(store, owner or "another process") from None
        except OSError:
            os.close(descriptor)
            return -1
        if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
            with suppress(OSError):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
            return descriptor
        os.close(descriptor)  # The former owner of the lock has removed the file in the meantime.


def _taken(store: Path, owner: str) -> RunError:
    return RunError(
        f"{store} is written to by {owner}: wait until that is done, and make the same call again, which goes on from "
        "there; or give another store."
    )


DAMAGE = (
    *(KeyError, TypeError, ValueError, RuntimeError, AttributeError, ArithmeticError, IndexError, EOFError),
    *(ImportError, MemoryError, OSError, zlib.error),
)
"""Errors that zarr raises if files of a store are missing, changed, or not in its format."""


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Context manager for reading from the store `path`: errors of zarr become a RunError for a damaged store."""
    try:
        yield
    except DAMAGE as error:
        raise damaged(path, _reason(error)) from error


def damaged(path: Path, reason: str) -> RunError:
    """Return the error for a damaged store at `path`. `reason` is a phrase that says what is wrong, for the message."""
    return RunError(
        f"{str(path)[:120]} is damaged ({reason}): make the same call again, which runs the members of damaged blocks "
        "again, give another store, or restore this one."
    )


def _reason(error: Exception) -> str:
    return (" ".join(str(error).split()) or type(error).__name__)[:120]


def checksum(rows: Any) -> int:
    """Return a 64-bit checksum of an array, its dtype and its shape. It is never 0, because 0 marks unwritten rows."""
    digest = hashlib.blake2b(f"{rows.dtype.str} {rows.shape}".encode(), digest_size=8)
    digest.update(np.ascontiguousarray(rows).data if rows.size else b"")
    return int.from_bytes(digest.digest(), "little") or 1


ATTRIBUTES = "lagrange"
"""Name of the zarr attribute in which a store has the description of its ensemble."""


def folder_of(store: Any) -> Path:
    """Return the user's `store` argument as a path. Raises StatementError if it is not the name of a local folder."""
    if not isinstance(store, (str, os.PathLike)) or not str(store):
        raise StatementError(f'store is {shown(store)}: give the name of a folder, such as "runs.zarr".')
    if "://" in str(store):
        raise StatementError(f"store is {shown(store)}: give the name of a folder of this machine, such as runs.zarr.")
    if "\0" in str(store):
        raise StatementError(f"store is {shown(store)}, which no folder can be called: give a name, such as runs.zarr.")
    return Path(store).expanduser()


def _zarr() -> Any:
    try:
        import zarr
    except ModuleNotFoundError as error:
        raise StatementError(
            "store= needs zarr, which is not installed: pip install zarr xarray, or in a checkout "
            "pip install '.[store]'."
        ) from error
    return zarr


def _check(zarr: Any, path: Path, made_of: Mapping[str, Any]) -> None:
    """Raise StatementError unless the folder `path` is the store of the ensemble with the description `made_of`."""
    try:
        stored = dict(zarr.open_group(str(path), mode="r").attrs).get(ATTRIBUTES)
    except PermissionError as error:
        raise StatementError(
            f"{path} cannot be read without permission: give another store, or change its permissions."
        ) from error
    except DAMAGE:
        stored = None
    if not isinstance(stored, dict):
        raise StatementError(
            f"{path} exists and is not a store of an ensemble: give another name. It was left as it is."
        )
    if differs := difference(stored, made_of):
        raise StatementError(
            f"{path} holds another ensemble, which differs in {differs}. It was left as it is: give another store, or "
            "repeat the call that made it."
        )


def _make(zarr: Any, path: Path, job: Job, table: MemberTable, made_of: Mapping[str, Any]) -> None:
    """Make a store without results in the folder `path`. `made_of` is the description of the ensemble.

    The store is written to a temporary folder, which is renamed when it is complete. Raises StatementError or RunError
    if it cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except (OSError, ValueError) as error:  # A name that no file system accepts raises ValueError.
        raise _not_made(path, error) from error
    try:
        for name, content in _files(zarr, job, table, made_of).items():
            write_file(folder / name, content)
        folder.chmod(0o755)
        folder.rename(path)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError) and error.errno in (errno.ENOTEMPTY, errno.EEXIST) and path.is_dir():
            return  # Another call has made the store in the meantime.
        if isinstance(error, OSError):
            raise _not_made(path, error) from error
        raise


def _files(zarr: Any, job: Job, table: MemberTable, made_of: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the contents of the files of a store without results, by path relative to its folder.

    `made_of` is the description of the ensemble. The contents are made in memory, since zarr writes files with several
    threads, some of which continue after a failure.
    """
    members, block = len(table), made_of["block"]
    attributes = {ATTRIBUTES: dict(made_of), "statuses": [status.value for status in STATUSES]}
    contents: dict[str, Any] = {}
    group = zarr.open_group(zarr.storage.MemoryStore(contents), mode="w", attributes=attributes)
    names = job.problem.model.layout.names()
    dimensions = {part: column.dimensions for column in job.columns for part in stored_names(column.name, names)}
    variables = variables_of(job, table, 0, 0, Results.empty(0, job.columns))
    for name, rows in variables.items():
        entry_shape = rows.shape[1:]
        group.create_array(
            name,
            shape=(members, *entry_shape),
            chunks=(min(block, members), *entry_shape),
            dtype=rows.dtype,
            fill_value=INTERRUPTED if name == STATUS else np.nan if rows.dtype.kind == "f" else 0,
            dimension_names=(MEMBER, *dimensions.get(name, ())),
        )
    count = len(variables)
    group.create_array(
        CHECKSUM,
        shape=(-(-members // block), count),
        chunks=(1, count),
        dtype="u8",
        fill_value=0,
        dimension_names=(BLOCK, VARIABLE),
    )
    if job.problem.t_eval is not None:
        shape = job.problem.t_eval.shape
        times = group.create_array(OUTPUT_TIME, shape=shape, dtype="f8", dimension_names=(OUTPUT_TIME,))
        times[:] = job.problem.t_eval
    return {name: content.to_bytes() for name, content in contents.items()}


def write_file(path: Path, content: bytes) -> None:
    """Write the bytes `content` to a file, and make its folder if it does not exist."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _not_made(path: Path, error: OSError | ValueError) -> StatementError | RunError:
    """Return the error for a store that could not be made: RunError for a failing disk, else StatementError."""
    number, reason = (error.errno, error.strerror) if isinstance(error, OSError) else (None, None)
    reason = reason or str(error)
    if number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
        return RunError(f"{path} could not be made ({reason}): make room, and make the same call again.")
    return StatementError(f"{path} cannot be made ({reason}): give a folder that can be written to, such as runs.zarr.")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Context manager for writing to the store `path`: a disk error becomes a RunError that says how to continue."""
    try:
        yield
    except OSError as error:
        raise RunError(
            f"{path} could not be written ({error.strerror or error}). The blocks of members that were written before "
            "are kept: free some space, or remove the cause, and make the same call again: it continues from there."
        ) from error


def variables_of(job: Job, table: MemberTable, begin: int, end: int, results: Results) -> dict[str, Any]:
    """Return {name: array} for the variables of a store, with a row for each member from `begin` to before `end`.

    They are the `results` of these members, and the values that vary between members.
    """
    names = job.problem.model.layout.names()
    variables: dict[str, Any] = {}
    for column in job.columns:
        rows, parts = results.column(column.name), stored_names(column.name, names)
        apart = column.name in (STATE, OUTPUTS)
        variables |= {part: rows[..., i] for i, part in enumerate(parts)} if apart else {parts[0]: rows}
    which = np.arange(begin, end)
    for key, label in zip(table.varied.keys, table.labels, strict=True):
        variables[start_name(label, names)] = table.varied.values(key, which)
    return variables


BLOCK_BYTES, LARGEST_BLOCK = 2**23, 2**16
"""Largest size of a block of members in a store, in bytes (8 MB), and its largest number of members. A billion numbers
make a thousand files."""

MOST_BLOCKS = 10**6
"""Largest number of blocks of members in a store (8 TB of results): each block has a file for every variable."""


class StoredResults:
    """The results of an ensemble in the store `path`, in blocks of successive members, each with checksums.

    Each access reads from the store; blocks that are not written have blank values. New results are kept in memory
    until their block is complete. `left` are the bounds (first, end) of the blocks of members that had no results at
    the start of the call, also if a stopped call has written them in part. `made_of` is the description of the
    ensemble. `messages` is empty, because a store has no messages.
    """

    messages: Mapping[int, str] = MappingProxyType({})

    def __init__(self, path: Path, job: Job, table: MemberTable, made_of: Mapping[str, Any], lock: StoreLock) -> None:
        self._path, self._job, self._table, self._lock = path, job, table, lock
        self._size: int = made_of["block"]
        self._names = tuple(variables_of(job, table, 0, 0, Results.empty(0, job.columns)))
        with writing(path):
            for partial in path.rglob("*.partial"):  # files of a killed call
                partial.unlink(missing_ok=True)
        try:
            self._group = _zarr().open_group(str(path), mode="r+")
            for name in (*self._names, CHECKSUM):
                self._group[name]
        except DAMAGE as error:
            raise RunError(
                f"{str(path)[:120]} is damaged in a file that describes it ({_reason(error)}): give another store, or "
                "restore this one."
            ) from error
        with reading(path), writing(path):
            self.left = [self._bounds(k) for k in range(-(-len(table) // self._size)) if not self._is_written(k)]
        self._open: dict[int, tuple[Results, int]] = {}

    def _bounds(self, k: int) -> tuple[int, int]:
        """Return the bounds of block k: the index of its first member, and the index after its last member."""
        return k * self._size, min((k + 1) * self._size, len(self._table))

    def _is_written(self, k: int) -> bool:
        """Return True if block k is written and not damaged. A damaged block is marked as not written."""
        try:
            sums, (begin, end) = np.asarray(self._group[CHECKSUM][k]), self._bounds(k)
            rows = (np.asarray(self._group[name][begin:end]) for name in self._names)
            whole = sums.all() and all(checksum(part) == sums[i] for i, part in enumerate(rows))
        except DAMAGE:
            sums, whole = None, False
        if not whole and (sums is None or sums.any()):
            self._group[CHECKSUM][k] = 0
        return bool(whole)

    def close(self) -> None:
        """Release the lock of the store."""
        self._lock.close()

    def take(self, first: int, ends: Results) -> None:
        """Add the results `ends` of a chunk of members to their block, and write the block once it is complete.

        `first` is the index of the first member. All members of the chunk are in one block.
        """
        k = first // self._size
        begin, end = self._bounds(k)
        if k not in self._open:
            self._open[k] = Results.empty(end - begin, self._job.columns), end - begin
        results, missing = self._open.pop(k)
        results.take(first - begin, ends)
        if missing > ends.members:
            self._open[k] = results, missing - ends.members
        else:
            self.write(k, results)

    def write(self, k: int, results: Results) -> None:
        """Write the `results` of all members of block k to the store: the status last, and then the checksums."""
        begin, end = self._bounds(k)
        rows = variables_of(self._job, self._table, begin, end, results)
        with reading(self._path), writing(self._path):
            for name in sorted(rows, key=STATUS.__eq__):
                self._group[name][begin:end] = rows[name]
            self._group[CHECKSUM][k] = np.array([checksum(rows[name]) for name in self._names], dtype="u8")

    def column(self, name: str) -> Any:
        """Return the column `name`, an array with a row for each member. Raises RunError for a damaged store."""
        return self._rows(name, 0, -(-len(self._table) // self._size))

    def row(self, name: str, member: int) -> Any:
        """Return the row of column `name` of the member with index `member`. Raises RunError for a damaged store."""
        k = member // self._size
        return self._rows(name, k, k + 1)[member - k * self._size]

    def _rows(self, name: str, low: int, high: int) -> Any:
        """Return the rows of column `name` for the members in the blocks from `low` to before `high`, as one array.

        A column of states is stored as one variable for each entry of the state; these are joined. Raises RunError if a
        block is damaged.
        """
        blank = next(column.blank for column in self._job.columns if column.name == name)
        first, last = low * self._size, self._bounds(high - 1)[1]
        variables = []
        for part in stored_names(name, self._job.problem.model.layout.names()):
            with reading(self._path):
                sums, rows = np.asarray(self._group[CHECKSUM][low:high]), np.asarray(self._group[part][first:last])
            for k in range(low, high):
                begin, end = self._bounds(k)
                block = rows[begin - first : end - first]
                if not sums[k - low].all():
                    block[:] = blank
                elif checksum(block) != sums[k - low][self._names.index(part)]:
                    raise damaged(self._path, f"{part} of members {begin} to {end - 1} has changed")
            variables.append(rows)
        return np.stack(variables, axis=-1) if name in (STATE, OUTPUTS) else variables[0]


def results_in_store(job: Job, table: MemberTable, store: str | os.PathLike[str]) -> StoredResults:
    """Return the object that reads and writes the results of an ensemble in the folder `store`.

    The store is made, or continued if it exists. Raises StatementError for a folder with other contents, for too many
    results, and if zarr is not installed. Raises RunError for a full disk, for a damaged store, and for a store to
    which another call writes.
    """
    path = folder_of(store)
    size = sum(column.bytes for column in job.columns)
    block = max(1, min(BLOCK_BYTES // size, LARGEST_BLOCK))
    if len(table) > MOST_BLOCKS * block:
        raise StatementError(
            f"the results of {len(table):.3g} members take {size * len(table):.3g} bytes, and a store has room for "
            f"{size * block * MOST_BLOCKS:.3g}: divide the ensemble into several, each with its store, or keep less."
        )
    made_of = origin(job, table, block)
    zarr = _zarr()
    if not os.path.lexists(path):
        _make(zarr, path, job, table, made_of)
    _check(zarr, path, made_of)
    lock = StoreLock(path)
    try:
        return StoredResults(path, job, table, made_of, lock)
    except BaseException:
        lock.close()
        raise
