"""Runs of members in chunks: sizes of chunks, threads or an executor that run them, collection of their results."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, counted, listing, shown
from lagrange.members.chunk import MemberResults, Results, Starts
from lagrange.members.job import ChunkResult, Engine, Job, run_chunk, timed
from lagrange.members.singly import BY_NUMPY
from lagrange.members.table import MemberTable
from lagrange.statement.expression import whole_number
from lagrange.trajectory.integrator import MEMORY_DIVISOR, machine_memory

MOST_WORKERS = 1024
"""Largest accepted number of threads. No machine has more processors."""


def processors() -> int:
    """Return the number of processors that this process may use; a container or `taskset` may limit it."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_of(workers: Any) -> int:
    """Return the user's number of `workers`, checked, or the number of processors if it is None."""
    return processors() if workers is None else whole_number(workers, "workers", 1, MOST_WORKERS)


CHUNKS_PER_WORKER = 2
"""Number of chunks submitted for each worker of an executor: one runs, and the next one waits."""

AT_ONCE, SENT = 0.1, 0.5
"""Duration of a chunk in seconds, on threads and by an executor. On threads 0.1 s is not noticed as a delay. An
executor needs some milliseconds of this process for each chunk: with 0.1 s two workers of Dask take 1.07 times as long.
"""


class ThreadRunner:
    """Runs chunks of members on threads. The machine code of the engine releases the interpreter lock."""

    chunk_seconds = AT_ONCE

    def __init__(self, engine: Engine, workers: int) -> None:
        self._engine, self.places = engine, workers
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="members")
        self._stopping = threading.Event()

    def submit(self, starts: Starts) -> Any:
        """Submit a chunk of members with the initial values `starts`, and return its future."""
        return self._pool.submit(timed, self._engine, starts, self._stopping.is_set)

    def stop(self) -> None:
        """Tell the threads to begin no further members."""
        self._stopping.set()

    def close(self) -> None:
        """Wait until all threads have finished."""
        self._pool.shutdown()


class ExecutorRunner:
    """Runs chunks of members by an executor of the user. The executor stays open, because the user closes it."""

    chunk_seconds = SENT

    def __init__(self, executor: Any, job: Job) -> None:
        if isinstance(executor, type) or not callable(getattr(executor, "submit", None)):
            raise StatementError(
                f"executor is {shown(executor)}: give a concurrent.futures executor, such as ProcessPoolExecutor(), or "
                "a dask.distributed.Client."
            )
        self._executor, self._job = executor, job.packed()
        self._options = {"pure": False} if hasattr(executor, "scheduler_info") else {}

    @property
    def places(self) -> int:
        """The number of chunks that are submitted at the same time: `CHUNKS_PER_WORKER` for each worker.

        If the executor does not report its workers, it is taken to have one for each processor.
        """
        executor, workers = self._executor, getattr(self._executor, "_max_workers", None)
        if hasattr(executor, "ncores"):
            workers = sum(executor.ncores().values())
        return CHUNKS_PER_WORKER * max(workers if isinstance(workers, int) else processors(), 1)

    def submit(self, starts: Starts) -> Any:
        """Submit a chunk of members with the initial values `starts`, and return its future."""
        return self._executor.submit(run_chunk, self._job, starts, **self._options)

    def stop(self) -> None:
        """Do nothing: submitted chunks finish soon, and workers on other machines cannot be asked."""

    def close(self) -> None:
        """Do nothing: the user closes the executor."""


Runner = ThreadRunner | ExecutorRunner
"""Object that runs chunks: up to `places` of them at once, each for about `chunk_seconds`."""


FIRST_CHUNK, LARGEST_CHUNK = 8, 65536
"""Number of members in the first chunks (one vector), before their duration is known; largest number in a chunk."""

GOES_ON = "With store= the same call goes on where this one stopped."

Take = Callable[[int, ChunkResult], None]
"""Callback for the results of a chunk: number of its first member, and the results."""


@dataclass
class ChunkSize:
    """The number of members in the next chunk, adapted so that a chunk takes about `fitting` seconds."""

    size: int
    fitting: float

    def note(self, members: int, seconds: float, side_by_side: int) -> None:
        """Adapt the size of the next chunk to the seconds that a chunk of `members` members took.

        The size is at least `side_by_side`, the number of members that run at the same time.
        """
        fitting = int(members * self.fitting / max(seconds, 1e-9))
        self.size = min(max(fitting, side_by_side), 4 * self.size, LARGEST_CHUNK)


def run_members(table: MemberTable, blocks: Iterable[tuple[int, int]], runner: Runner, take: Take) -> None:
    """Run the members of `blocks`, pairs (first, end) with end excluded, in chunks, in order of their index.

    `runner` runs the chunks, on threads or by an executor. `take` is called in this thread with the results of each
    chunk, in the order in which chunks finish. After an error or Ctrl-C, running chunks are awaited and their results
    are taken, too.
    """
    chunk_size = ChunkSize(FIRST_CHUNK, runner.chunk_seconds)
    chunks = _chunks(blocks, chunk_size)
    done: SimpleQueue[tuple[int, int, Any]] = SimpleQueue()
    under_way: dict[int, Any] = {}

    def collect() -> None:
        first, count, future = done.get()
        del under_way[first]
        result = _result(future)
        chunk_size.note(count, result.seconds, result.side_by_side)
        take(first, result)

    try:
        for first, count in chunks:
            future = _submitted(runner, table.starts(np.arange(first, first + count)))
            future.add_done_callback(lambda finished, key=(first, count): done.put((*key, finished)))
            under_way[first] = future
            while len(under_way) >= runner.places:
                collect()
        while under_way:
            collect()
    except BaseException:
        runner.stop()
        for future in under_way.values():
            future.cancel()
        with suppress(RunError):  # A disk that has failed fails again.
            # The futures are read, not the queue of finished chunks: Ctrl-C may have interrupted its reading.
            for first, future in under_way.items():
                if not future.cancelled() and future.exception() is None:
                    take(first, _result(future))
        raise
    finally:
        runner.close()


def _submitted(runner: Runner, starts: Starts) -> Any:
    """Submit a chunk of members and return its future. Raises RunError if the executor does not accept it."""
    try:
        with _working():
            future = runner.submit(starts)
    except RuntimeError as error:
        raise RunError(
            f"the executor takes no more members ({error}): give an executor that is open, or fewer workers. {GOES_ON}"
        ) from error
    if not callable(getattr(future, "add_done_callback", None)):
        raise StatementError(f"executor.submit(...) returned {shown(future)}: give an executor that returns futures.")
    return future


def _result(future: Any) -> ChunkResult:
    """Return the results of a chunk from its future, once it is finished.

    Raises RunError if the executor failed, or the error that a member raised.
    """
    with _working():
        result = future.result()
    if not isinstance(result, ChunkResult):
        raise RunError(
            f"the executor returned {shown(result)} in place of the results of members: give an executor that returns "
            "results unchanged, such as concurrent.futures.ProcessPoolExecutor()."
        )
    return result


@contextmanager
def _working() -> Iterator[None]:
    """Context that replaces the error of a failed executor by a RunError, which says how to continue the ensemble."""
    try:
        yield
    except ImportError as error:
        raise RunError(
            f"a worker of the executor cannot run members: {error}. Install the packages of this process on the "
            "workers."
        ) from error
    except Exception as error:
        if isinstance(error, (BrokenExecutor, CancelledError)) or type(error).__module__.startswith("distributed."):
            raise RunError(
                f"the executor failed ({str(error) or type(error).__name__}): it was closed, or a process of it was "
                "ended or ran out of memory, or the main program starts processes outside of "
                f"`if __name__ == '__main__':`. {GOES_ON}"
            ) from error
        raise


def _chunks(blocks: Iterable[tuple[int, int]], chunk_size: ChunkSize) -> Iterator[tuple[int, int]]:
    """Yield chunks of the `blocks` of members: the index of the first member, and the number of members.

    The number is the value of `chunk_size` when the chunk is yielded, or less at the end of a block.
    """
    for begin, end in blocks:
        first = begin
        while first < end:
            count = min(chunk_size.size, end - first)
            yield first, count
            first += count


class ResultCollector:
    """Stores the results of chunks as they are finished, and reports the number of members that have results.

    `members` is the number of all members. `before` is the number of those that had results at the start of the call,
    and `ran` the number of those that were run since then. `report` is called with the sum of the two numbers, or is
    None.
    """

    report: Callable[[float], None] | None = None

    def __init__(self, job: Job, results: MemberResults, members: int) -> None:
        self._job, self._results = job, results
        self.before = members - sum(end - begin for begin, end in results.left)
        self._forms: dict[str, None] = {}
        self._processors: dict[str, None] = {}
        self.ran = 0

    def __call__(self, first: int, result: ChunkResult) -> None:
        """Store the `result` of a chunk of members. `first` is the index of its first member."""
        self._forms[result.form] = None
        if result.processor:
            self._processors[result.processor] = None
        self._results.take(first, result.ends)
        self.ran += result.ends.members
        if self.report is not None:
            self.report(self.before + self.ran)

    @property
    def form(self) -> str:
        """Text on how members were run, with a note if their last digits may differ from those of this machine."""
        notes = ["; ".join(self._forms) or "all members were stored"]
        machine = self._job.problem.model.machine
        if machine.processor and any(form.endswith(BY_NUMPY) for form in self._forms):
            notes.append("a worker has no llvmlite")
        if others := [processor for processor in self._processors if processor != machine.processor]:
            notes.append(f"workers compiled for {listing(others)}, not for {machine.processor}")
        return "; ".join(notes) + (": the last digits may differ from those of this machine" if notes[1:] else "")


def results_in_memory(job: Job, table: MemberTable) -> Results:
    """Return arrays for the results of an ensemble. Raises StatementError if they need a quarter of the memory."""
    members, columns = len(table), job.columns
    size, limit = members * sum(column.bytes for column in columns), machine_memory() / MEMORY_DIVISOR
    if size > limit:
        raise StatementError(
            f"the results of {counted(members, 'member')} take {size:.3g} bytes, more than a quarter of the memory, "
            f'{limit:.3g} bytes: give store="runs.zarr", which writes them to a folder block by block, or fewer '
            "members or output times."
        )
    return Results.empty(members, columns)
