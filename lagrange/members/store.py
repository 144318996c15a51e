"""A store of results on a disk, in the format zarr, which xarray opens: written block by block, whole or not at all.

A block of members is written when all of it has been run, and noted as done behind that. The size of a block depends on
nothing but how much a member keeps, so a call that goes on where another one stopped writes the same bytes. What made
the results stands in the attributes; a store of anything else is never written to.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, listing, shown
from lagrange.members.chunk import INTERRUPTED, STATUSES
from lagrange.members.job import Done, Job
from lagrange.members.keep import OUTPUTS, STATE, STATUS, TIME
from lagrange.members.names import BLOCK, DONE, MEMBER, OCCURRENCE, OUTPUT_TIME, ROW, start_name, stored_names
from lagrange.members.origin import difference, origin
from lagrange.members.results import Results
from lagrange.members.storage import ResultStorage
from lagrange.members.table import MemberTable

BLOCK_BYTES, LARGEST_BLOCK = 2**23, 2**16
"""A block takes about 8 MB, or has 65,536 members: some thousand files for a billion numbers, each quickly written."""

ATTRIBUTES = "lagrange"

MOST_BLOCKS = 10**6
"""A store has no more blocks, each of which has a file for every variable: 8 TB of results are enough for one."""

DAMAGE = (KeyError, TypeError, ValueError, RuntimeError, AttributeError)
"""What zarr raises where files of a store are missing or are none of its own."""


class ZarrStorage(ResultStorage):
    """Results kept in a store on a disk; blocks that are not whole yet are in memory."""

    def __init__(self, job: Job, table: MemberTable, path: Path, group: Any, block: int) -> None:
        members = len(table)
        with reading(path):
            done = np.asarray(group[DONE][:])
        left = [(k * block, min((k + 1) * block, members)) for k in np.flatnonzero(done == 0).tolist()]
        super().__init__(job, left)
        self._table, self._path, self._group, self._block = table, path, group, block
        self._open: dict[int, tuple[Results, int]] = {}

    @property
    def results(self) -> StoredResults:
        """The results, read when they are asked for."""
        return StoredResults(self._group, self.job, self._path, self._block)

    def take(self, first: int, done: Done) -> None:
        """Keep members of a block; write it when it is whole."""
        k = first // self._block
        begin, end = k * self._block, min((k + 1) * self._block, len(self._table))
        if k not in self._open:
            self._open[k] = Results.empty(end - begin, self.job.columns), end - begin
        results, missing = self._open[k]
        results.take(first - begin, done.ends)
        missing -= len(done.ends.columns[TIME])
        self._open[k] = results, missing
        if not missing:
            self.write(k, begin, end, results)
            del self._open[k]

    def write(self, k: int, begin: int, end: int, results: Results) -> None:
        """Write a block, its status last, and note that it is done."""
        with _disk(self._path):
            rows = _columns(self.job, self._table, begin, end, results)
            for name in sorted(rows, key=STATUS.__eq__):
                self._group[name][begin:end] = rows[name]
            self._group[DONE][k] = 1


class StoredResults:
    """The results in a store; each column is read whole when it is asked for, and blocks that are not done are blank.

    A call that was stopped within a block may have written a part of it.
    """

    messages: Mapping[int, str] = MappingProxyType({})

    def __init__(self, group: Any, job: Job, path: Path, block: int) -> None:
        self._group, self._job, self._path, self._block = group, job, path, block

    def column(self, name: str) -> Any:
        """Return a column, with a row for each member. Raises RunError where the store cannot be read."""
        parts = stored_names(name, self._job.problem.model.layout.names())
        with reading(self._path):
            left = np.flatnonzero(np.asarray(self._group[DONE][:]) == 0)
            found = [np.asarray(self._group[one][:]) for one in parts]
        blank = next(column.blank for column in self._job.columns if column.name == name)
        for k in left:
            for rows in found:
                rows[k * self._block : (k + 1) * self._block] = blank
        return np.stack(found, axis=-1) if name in (STATE, OUTPUTS) else found[0]

    def row(self, name: str, member: int) -> Any:
        """Return the entry of a column for one member. Raises RunError where the store cannot be read."""
        parts = stored_names(name, self._job.problem.model.layout.names())
        with reading(self._path):
            if not self._group[DONE][member // self._block]:
                return next(column for column in self._job.columns if column.name == name).empty(1)[0]
            found = [np.asarray(self._group[one][member]) for one in parts]
        return np.stack(found, axis=-1) if name in (STATE, OUTPUTS) else found[0]


def kept_in_store(job: Job, table: MemberTable, store: str | os.PathLike[str]) -> ZarrStorage:
    """Return what keeps results in a store, which is made, or goes on where it stopped.

    Raises StatementError for a folder that holds something else, and without zarr; RunError for a full disk.
    """
    zarr = _zarr()
    if not isinstance(store, (str, os.PathLike)) or not str(store):
        raise StatementError(f'store is {shown(store)}: give the name of a folder, such as "runs.zarr".')
    path = _folder(store)
    one = sum(column.bytes for column in job.columns)
    block = max(1, min(BLOCK_BYTES // one, LARGEST_BLOCK))
    if len(table) > MOST_BLOCKS * block:
        raise StatementError(
            f"the results of {len(table):.3g} members take {one * len(table):.3g} bytes, and a store has room for "
            f"{one * block * MOST_BLOCKS:.3g}: divide the ensemble into several, each with its store, or keep less."
        )
    made_of = origin(job, table, block)
    if os.path.lexists(path):
        _check(zarr, path, made_of)
    else:
        _make(zarr, path, job, table, made_of)
    with _disk(path), reading(path):
        for rest in path.rglob("*.partial"):
            rest.unlink()
        group = zarr.open_group(str(path), mode="r+")
        missing = [
            name for name in (DONE, *_columns(job, table, 0, 0, Results.empty(0, job.columns))) if name not in group
        ]
    if missing:
        raise RunError(f"{path} is damaged: it has no {listing(missing)}. Give another store, or restore this one.")
    return ZarrStorage(job, table, path, group, block)


def _folder(store: str | os.PathLike[str]) -> Path:
    """Return the path of a store."""
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


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Say that files of a store are damaged."""
    try:
        yield
    except DAMAGE as error:
        raise RunError(
            f"{path} is damaged and cannot be read ({str(error) or type(error).__name__}): give another store, or "
            "restore this one."
        ) from error


@contextmanager
def _disk(path: Path) -> Iterator[None]:
    """Say what a disk that fails means for the ensemble."""
    try:
        yield
    except OSError as error:
        raise RunError(
            f"{path} could not be written ({error.strerror or error}). The blocks of members that were written before "
            "are kept: make room, or mend what is wrong, and make the same call again; it goes on from there."
        ) from error


def _check(zarr: Any, path: Path, made_of: Mapping[str, Any]) -> None:
    """Refuse a folder that holds anything but this ensemble."""
    try:
        found = dict(zarr.open_group(str(path), mode="r").attrs).get(ATTRIBUTES)
    except PermissionError as error:
        raise StatementError(f"{path} may not be read: give another store, or the right to read it.") from error
    except (OSError, *DAMAGE):
        found = None
    if not isinstance(found, dict):
        raise StatementError(f"{path} exists and is no store of an ensemble: give another name. It was left as it is.")
    if differs := difference(found, made_of):
        raise StatementError(
            f"{path} holds another ensemble, which differs in {differs}. It was left as it is: give another store, or "
            "make the call that it was made by."
        )


def _make(zarr: Any, path: Path, job: Job, table: MemberTable, made_of: Mapping[str, Any]) -> None:
    """Make a store whose blocks are all to be written; it has its name when it is whole."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise _not_made(path, error) from error
    try:
        members, block = len(table), made_of["block"]
        attributes = {ATTRIBUTES: dict(made_of), "statuses": [one.value for one in STATUSES]}
        group = zarr.open_group(str(folder), mode="w", attributes=attributes)
        empty = Results.empty(0, job.columns)
        for name, rows in _columns(job, table, 0, 0, empty).items():
            rest = rows.shape[1:]
            group.create_array(
                name,
                shape=(members, *rest),
                chunks=(min(block, members), *rest),
                dtype=rows.dtype,
                fill_value=INTERRUPTED if name == STATUS else np.nan if rows.dtype.kind == "f" else 0,
                dimension_names=(MEMBER, *_dimensions(name))[: rows.ndim],
            )
        blocks = -(-members // block)
        group.create_array(DONE, shape=(blocks,), chunks=(1,), dtype="u1", fill_value=0, dimension_names=(BLOCK,))
        if job.problem.t_eval is not None:
            shape = job.problem.t_eval.shape
            times = group.create_array(OUTPUT_TIME, shape=shape, dtype="f8", dimension_names=(OUTPUT_TIME,))
            times[:] = job.problem.t_eval
        folder.chmod(0o755)
        folder.rename(path)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError):
            raise _not_made(path, error) from error
        raise


def _not_made(path: Path, error: OSError) -> StatementError | RunError:
    """Return what to say of a store that could not be made: of a full disk, or of a place that cannot have it."""
    reason = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
        return RunError(f"{path} could not be made ({reason}): make room, and make the same call again.")
    return StatementError(f"{path} cannot be made ({reason}): give a folder that can be written to, such as runs.zarr.")


def _dimensions(name: str) -> tuple[str, ...]:
    """Return the names of the dimensions of a variable behind that of the members."""
    return (OCCURRENCE, ROW) if re.fullmatch(r"[ty]_event_[0-9]+", name) else (OUTPUT_TIME,)


def _columns(job: Job, table: MemberTable, begin: int, end: int, results: Results) -> dict[str, Any]:
    """Return the variables of members by name, each with a row for every member."""
    names = job.problem.model.layout.names()
    found: dict[str, Any] = {}
    for column in job.columns:
        rows, parts = results.column(column.name), stored_names(column.name, names)
        apart = column.name in (STATE, OUTPUTS)
        found |= {one: rows[..., i] for i, one in enumerate(parts)} if apart else {parts[0]: rows}
    which = np.arange(begin, end)
    for key, label in zip(table.varied.keys, table.labels, strict=True):
        found[start_name(label, names)] = table.varied.values(key, which)
    return found
