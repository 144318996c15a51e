"""Members in chunks: handed out, run on threads or by an executor, and taken back."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, Protocol

import numpy as np

from lagrange.errors import RunError, StatementError, shown
from lagrange.members.chunk import Engine, Starts, Table
from lagrange.members.job import ChunkResult, Job, run_chunk, timed
from lagrange.statement.number import whole_number

MOST_WORKERS = 1024
"""More threads than any machine has processors: a larger number is a mistake."""


def processors() -> int:
    """Return how many processors this process may use, which a container or `taskset` may make fewer than there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_of(workers: Any) -> int:
    """Return the number of threads: as many as this process may use processors unless `workers` says it."""
    return processors() if workers is None else whole_number(workers, "workers", 1, MOST_WORKERS)


AHEAD = 2
"""Chunks that wait for each worker of an executor, so that none has to wait for the next."""

AT_ONCE, SENT = 0.1, 0.5
"""Seconds that chunks take: what a person takes for at once, and more where an executor sends them somewhere, which
costs this process some milliseconds. With a tenth of a second two workers of Dask take 1.07 times as long."""


class Runner(Protocol):
    """Runs chunks; `places` of them may be under way at once, and each takes about `chunk_seconds`."""

    chunk_seconds: float

    @property
    def places(self) -> int:
        """The number of chunks under way."""

    def submit(self, starts: Starts) -> Any:
        """Return the future of a chunk, whose result is a `ChunkResult`."""

    def stop(self) -> None:
        """Begin no more members of the chunks that are under way, where that can be said to who runs them."""

    def close(self) -> None:
        """Wait for what runs, and free the threads that were made."""


class ThreadRunner:
    """Threads of this process around one engine, whose machine code runs without the interpreter's lock."""

    chunk_seconds = AT_ONCE

    def __init__(self, engine: Engine, workers: int) -> None:
        self._engine, self._places = engine, workers
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="members")
        self._stopping = threading.Event()

    @property
    def places(self) -> int:
        """One chunk for each thread."""
        return self._places

    def submit(self, starts: Starts) -> Any:
        """Return the future of a chunk."""
        return self._pool.submit(timed, self._engine, starts, self._stopping.is_set)

    def stop(self) -> None:
        """Begin no more members."""
        self._stopping.set()

    def close(self) -> None:
        """Wait for the threads."""
        self._pool.shutdown()


class ExecutorRunner:
    """An executor of the user's, which is left open."""

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
        """Some chunks for each worker."""
        return AHEAD * max(workers_of(self._executor), 1)

    def submit(self, starts: Starts) -> Any:
        """Return the future of a chunk."""
        return self._executor.submit(run_chunk, self._job, starts, **self._options)

    def stop(self) -> None:
        """Wait for what is under way: chunks are short, and their workers may be other machines."""

    def close(self) -> None:
        """Leave the executor to its owner."""


def workers_of(executor: Any) -> int:
    """Return how many chunks an executor runs at once, as far as it says so."""
    if hasattr(executor, "ncores"):
        return sum(executor.ncores().values())
    workers = getattr(executor, "_max_workers", None)
    return workers if isinstance(workers, int) else processors()


FIRST_CHUNK, LARGEST_CHUNK = 8, 65536
"""Members of the first chunks, those of one vector, before it is known how long one takes; the most of any chunk."""

GOES_ON = "With store= the same call goes on where this one stopped."

Take = Callable[[int, ChunkResult], None]
"""What is done with the results of members from a number on."""


@dataclass
class ChunkSize:
    """How many members take as long as a chunk should, the seconds `fitting`, by what former chunks took."""

    size: int
    fitting: float

    def note(self, members: int, seconds: float, side_by_side: int) -> None:
        """Note how long some members took; with fewer than run `side_by_side` lanes would be empty."""
        fitting = int(members * self.fitting / max(seconds, 1e-9))
        self.size = min(max(fitting, side_by_side), 4 * self.size, LARGEST_CHUNK)


def run_members(table: Table, blocks: Iterable[tuple[int, int]], runner: Runner, take: Take) -> None:
    """Run members of blocks, each from a number to before another, in order.

    `take` is called in this thread with the results of each chunk, in the order in which chunks are done. Where
    anything stops it, what is under way is waited for and taken.
    """
    chunk_size = ChunkSize(FIRST_CHUNK, runner.chunk_seconds)
    chunks = _chunks(blocks, chunk_size)
    done: SimpleQueue[tuple[int, int, Any]] = SimpleQueue()
    under_way: dict[int, Any] = {}

    def collect() -> None:
        first, count, future = done.get()
        del under_way[first]
        found = _result(future)
        chunk_size.note(count, found.seconds, found.side_by_side)
        take(first, found)

    try:
        for first, count in chunks:
            future = _submitted(runner, table.starts(np.arange(first, first + count)))
            future.add_done_callback(lambda one, key=(first, count): done.put((*key, one)))
            under_way[first] = future
            while len(under_way) >= runner.places:
                collect()
        while under_way:
            collect()
    except BaseException:
        runner.stop()
        for future in under_way.values():
            future.cancel()
        with suppress(RunError):  # a disk that failed fails again
            _take_finished(under_way, take)
        raise
    finally:
        runner.close()


def _submitted(runner: Runner, starts: Starts) -> Any:
    """Return the future of a chunk. Raises RunError where the executor takes none."""
    try:
        with _working():
            future = runner.submit(starts)
    except RuntimeError as error:
        raise RunError(
            f"the executor takes no more members ({error}): give one that is open, or fewer workers. {GOES_ON}"
        ) from error
    if not callable(getattr(future, "add_done_callback", None)):
        raise StatementError(f"executor.submit(...) returned {shown(future)}: give an executor that returns futures.")
    return future


def _result(future: Any) -> ChunkResult:
    """Return what came of a chunk. Raises RunError where the executor gave up; what members raise is raised here."""
    with _working():
        found = future.result()
    if not isinstance(found, ChunkResult):
        raise RunError(f"the executor gave {shown(found)} as the results of members: it changes what it is to compute.")
    return found


@contextmanager
def _working() -> Iterator[None]:
    """Say what it means for the ensemble that an executor gives up."""
    try:
        yield
    except ImportError as error:
        raise RunError(f"a worker of the executor cannot run members: {error}. Install there what is here.") from error
    except Exception as error:
        if isinstance(error, (BrokenExecutor, CancelledError)) or type(error).__module__.startswith("distributed."):
            raise RunError(
                f"the executor gave up ({str(error) or type(error).__name__}): it was closed, or a process of it was "
                "ended or ran out of memory, or the program that made its processes does so without "
                f"`if __name__ == '__main__':`. {GOES_ON}"
            ) from error
        raise


def _take_finished(under_way: dict[int, Any], take: Take) -> None:
    """Take what is under way and comes to its end; what was cancelled or failed is left out.

    The futures are asked, not the queue: Ctrl-C may have come when an entry had just been taken out of that.
    """
    for first, future in under_way.items():
        if not future.cancelled() and future.exception() is None:
            take(first, _result(future))


def _chunks(blocks: Iterable[tuple[int, int]], chunk_size: ChunkSize) -> Iterator[tuple[int, int]]:
    """Yield the first and the number of the next members, as many as the chunk_size says when they are asked for."""
    for begin, end in blocks:
        first = begin
        while first < end:
            count = min(chunk_size.size, end - first)
            yield first, count
            first += count
