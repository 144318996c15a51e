"""A store of results on a disk, in the format zarr, which xarray opens: written block by block, whole or not at all.

A block of members is written when all of it has been run, and then its checksums. A call reads what is there, and runs
the members again whose block is missing or does not match its checksums. The size of a block depends on nothing but how
much a member keeps, so a call that goes on where another one stopped writes the same bytes. The attributes say what
made the results; a store of anything else is never written to.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from lagrange.errors import StatementError
from lagrange.members.job import ChunkResult, Job
from lagrange.members.keep import OUTPUTS, STATE, TIME
from lagrange.members.names import stored_names
from lagrange.members.origin import origin
from lagrange.members.results import Results
from lagrange.members.storage import ResultStorage
from lagrange.members.store_blocks import StoreBlocks, reading
from lagrange.members.store_group import find_store, folder_of, open_store, variables_of, writing
from lagrange.members.store_lock import StoreLock
from lagrange.members.table import MemberTable

BLOCK_BYTES, LARGEST_BLOCK = 2**23, 2**16
"""A block takes about 8 MB, or has 65,536 members: some thousand files for a billion numbers, each quickly written."""

MOST_BLOCKS = 10**6
"""A store has no more blocks, each of which has a file for every variable: 8 TB of results are enough for one."""


class ZarrStorage(ResultStorage):
    """Results kept in a store on a disk; blocks that are not whole yet are in memory."""

    def __init__(self, job: Job, table: MemberTable, blocks: StoreBlocks, lock: StoreLock) -> None:
        with writing(blocks.path):
            super().__init__(job, blocks.left())
        self._table, self._blocks, self._lock = table, blocks, lock
        self._open: dict[int, tuple[Results, int]] = {}

    def close(self) -> None:
        """Let other calls write to the store."""
        self._lock.close()

    @property
    def results(self) -> StoredResults:
        """The results, read when they are asked for."""
        return StoredResults(self._blocks, self.job)

    def take(self, first: int, done: ChunkResult) -> None:
        """Keep members of a block; write it when it is whole."""
        k = first // self._blocks.size
        begin, end = self._blocks.bounds(k)
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
        """Write a block."""
        rows = variables_of(self.job, self._table, begin, end, results)
        with reading(self._blocks.path), writing(self._blocks.path):
            self._blocks.write(k, rows)


class StoredResults:
    """The results in a store; each column is read whole when it is asked for, and blocks that are not done are blank.

    A call that was stopped within a block may have written a part of it.
    """

    messages: Mapping[int, str] = MappingProxyType({})

    def __init__(self, blocks: StoreBlocks, job: Job) -> None:
        self._blocks, self._job = blocks, job

    def column(self, name: str) -> Any:
        """Return a column, with a row for each member. Raises RunError where the store cannot be read."""
        found = [self._blocks.column(part, self._blank(name)) for part in self._parts(name)]
        return np.stack(found, axis=-1) if name in (STATE, OUTPUTS) else found[0]

    def row(self, name: str, member: int) -> Any:
        """Return the entry of a column for one member. Raises RunError where the store cannot be read."""
        found = [self._blocks.row(part, member, self._blank(name)) for part in self._parts(name)]
        return np.stack(found, axis=-1) if name in (STATE, OUTPUTS) else found[0]

    def _parts(self, name: str) -> tuple[str, ...]:
        return stored_names(name, self._job.problem.model.layout.names())

    def _blank(self, name: str) -> float:
        return next(column.blank for column in self._job.columns if column.name == name)


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
    made_of = origin(job, table, block)
    find_store(path, job, table, made_of)
    lock = StoreLock(path)
    try:
        return ZarrStorage(job, table, open_store(path, job, table, made_of), lock)
    except BaseException:
        lock.close()
        raise
