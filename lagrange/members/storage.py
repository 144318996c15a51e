"""Storage of the results of an ensemble in memory. `lagrange.members.store` stores them on disk."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

from lagrange.errors import StatementError, counted, listing
from lagrange.members.chunk import MemberResults, Results
from lagrange.members.job import ChunkResult, Job
from lagrange.members.singly import BY_NUMPY
from lagrange.members.table import MemberTable
from lagrange.trajectory.pace import MEMORY_DIVISOR, machine_memory

Report = Callable[[float], None] | None


class ResultStorage(ABC):
    """Storage of the results of an ensemble, in memory or on disk, as its chunks are finished.

    `left` are the bounds (first, end) of blocks of members still to be run, and `ran` is the number of members that
    were run.
    """

    def __init__(self, job: Job, left: list[tuple[int, int]]) -> None:
        self.job, self.left = job, left
        self.forms: dict[str, None] = {}
        self.processors: dict[str, None] = {}
        self.ran = 0

    results: MemberResults
    """The results of all members."""

    @abstractmethod
    def take(self, first: int, done: ChunkResult) -> None:
        """Store the results of a chunk of members. `first` is the index of its first member."""

    @abstractmethod
    def close(self) -> None:
        """Finish the storage of results, after the last chunk or an error."""

    @property
    def members_left(self) -> int:
        """The number of members that are still to be run."""
        return sum(end - begin for begin, end in self.left)

    @property
    def form(self) -> str:
        """Text on how members were run, with a note if their last digits may differ from those of this machine."""
        notes = ["; ".join(self.forms) or "all members were stored"]
        machine = self.job.problem.model.machine
        if machine.processor and any(form.endswith(BY_NUMPY) for form in self.forms):
            notes.append("a worker has no llvmlite")
        if others := [processor for processor in self.processors if processor != machine.processor]:
            notes.append(f"workers compiled for {listing(others)}, not for {machine.processor}")
        return "; ".join(notes) + (": the last digits may differ from those of this machine" if notes[1:] else "")

    def reporting(self, report: Report, before: int) -> Callable[[int, ChunkResult], None]:
        """Return a callback that stores the results of a chunk of members and reports the number of finished members.

        Its arguments are the index of the chunk's first member and the results. It passes the number to `report`.
        `before` is the number of members that were finished before this call.
        """

        def keep(first: int, done: ChunkResult) -> None:
            self.forms[done.form] = None
            if done.processor:
                self.processors[done.processor] = None
            self.take(first, done)
            self.ran += done.ends.members
            if report is not None:
                report(before + self.ran)

        return keep


class ArrayStorage(ResultStorage):
    """Storage of the results of an ensemble in arrays in memory."""

    def __init__(self, job: Job, results: Results, members: int) -> None:
        super().__init__(job, [(0, members)])
        self.results: Results = results

    def close(self) -> None:
        """Do nothing: arrays need no closing."""

    def take(self, first: int, done: ChunkResult) -> None:
        """Copy the results of a chunk of members into the arrays. `first` is the index of its first member."""
        self.results.take(first, done.ends)


def kept_in_memory(job: Job, table: MemberTable) -> ArrayStorage:
    """Return the storage in memory for the results of an ensemble.

    Raises StatementError if the results need more than a quarter of the memory.
    """
    members, columns = len(table), job.columns
    size, limit = members * sum(column.bytes for column in columns), machine_memory() / MEMORY_DIVISOR
    if size > limit:
        raise StatementError(
            f"the results of {counted(members, 'member')} take {size:.3g} bytes, more than a quarter of the memory, "
            f'{limit:.3g} bytes: give store="runs.zarr", which writes them to a folder block by block, or fewer '
            "members or output times."
        )
    return ArrayStorage(job, Results.empty(members, columns), members)
