"""A store of results on a disk, in the format zarr, which xarray opens: written block by block, whole or not at all.

A block of members is written when all of it has been run, and noted as done behind that. The size of a block depends on
nothing but how much a member keeps, so a call that goes on where another one stopped writes the same bytes. What made
the results stands in the attributes; a store of anything else is never written to.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from lagrange.errors import StatementError
from lagrange.members.job import ChunkResult, Job
from lagrange.members.keep import OUTPUTS, STATE, STATUS, TIME
from lagrange.members.names import DONE, stored_names
from lagrange.members.origin import origin
from lagrange.members.results import Results
from lagrange.members.storage import ResultStorage
from lagrange.members.store_group import find_store, folder_of, open_store, reading, variables_of, writing
from lagrange.members.store_lock import StoreLock
from lagrange.members.table import MemberTable

BLOCK_BYTES, LARGEST_BLOCK = 2**23, 2**16
"""A block takes about 8 MB, or has 65,536 members: some thousand files for a billion numbers, each quickly written."""

MOST_BLOCKS = 10**6
"""A store has no more blocks, each of which has a file for every variable: 8 TB of results are enough for one."""


class ZarrStorage(ResultStorage):
    """Results kept in a store on a disk; blocks that are not whole yet are in memory."""

    def __init__(self, job: Job, table: MemberTable, path: Path, group: Any, block: int, lock: StoreLock) -> None:
        members, self._lock = len(table), lock
        with reading(path):
            done = np.asarray(group[DONE][:])
        left = [(k * block, min((k + 1) * block, members)) for k in np.flatnonzero(done == 0).tolist()]
        super().__init__(job, left)
        self._table, self._path, self._group, self._block = table, path, group, block
        self._open: dict[int, tuple[Results, int]] = {}

    def close(self) -> None:
        """Let other calls write to the store."""
        self._lock.close()

    @property
    def results(self) -> StoredResults:
        """The results, read when they are asked for."""
        return StoredResults(self._group, self.job, self._path, self._block)

    def take(self, first: int, done: ChunkResult) -> None:
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
        with writing(self._path):
            rows = variables_of(self.job, self._table, begin, end, results)
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

    Raises StatementError for a folder that holds something else, for too many results, and without zarr; RunError for
    a full disk, for a store that is damaged and for one that another call writes to.
    """
    path = folder_of(store)
    one = sum(column.bytes for column in job.columns)
    block = max(1, min(BLOCK_BYTES // one, LARGEST_BLOCK))
    if len(table) > MOST_BLOCKS * block:
        raise StatementError(
            f"the results of {len(table):.3g} members take {one * len(table):.3g} bytes, and a store has room for "
            f"{one * block * MOST_BLOCKS:.3g}: divide the ensemble into several, each with its store, or keep less."
        )
    find_store(path, job, table, origin(job, table, block))
    lock = StoreLock(path)
    try:
        return ZarrStorage(job, table, path, open_store(path, job, table), block, lock)
    except BaseException:
        lock.close()
        raise
