"""Where chunks of members run: on threads of this process, or by an executor that the user has.

An executor is a `concurrent.futures.Executor`, or a client of `dask.distributed`: it takes a function and its arguments
and returns a future that calls back. Retries and queues are its own.
"""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

from lagrange.errors import StatementError, shown
from lagrange.members.chunk import Engine, Starts
from lagrange.members.job import Job, run_chunk, timed
from lagrange.members.processors import processors

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
