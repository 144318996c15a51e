"""Run the members of an ensemble in chunks, on threads or by an executor, and collect their results."""

from __future__ import annotations

import hashlib
import os
import pickle
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from queue import SimpleQueue
from threading import Lock
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, counted, listing, shown
from lagrange.members.lanes import LaneEngine, lane_engine
from lagrange.members.results import INTERRUPTED, Column, Keep, Results, Starts, Stopped
from lagrange.members.singly import BY_FLOW, BY_NUMPY, Explained, FlowEngine, RunEngine
from lagrange.members.table import MemberTable
from lagrange.statement.expression import whole_number
from lagrange.trajectory.integrator import MEMORY_DIVISOR, Problem, RunOptions, machine_memory
from lagrange.trajectory.plan import Planned
from lagrange.trajectory.run import Flow

Engine = RunEngine | FlowEngine | LaneEngine
"""Type of an object that runs members of an ensemble, `side_by_side` of them at the same time. The result of a member
does not depend on the members that run with it."""

ENGINES_KEPT = 4
"""Largest number of ensembles whose compiled code a worker process keeps. The oldest code is dropped."""


@dataclass(frozen=True, eq=False)
class Job:
    """The data that all members of an ensemble share, from which each process creates the engine that runs them.

    `problem` is the initial value problem of the first member; others differ in initial state and parameters. `options`
    are those of the runs, such as the method. `keep` is the selection of results to store. `varying` is True if each
    member has its own parameters.
    """

    problem: Problem
    options: RunOptions
    keep: Keep
    varying: bool

    @property
    def columns(self) -> tuple[Column, ...]:
        """The descriptions of the result columns that are stored for the members."""
        problem = self.problem
        outputs = None if problem.t_eval is None else len(problem.t_eval)
        return self.keep.columns(problem.model.layout.size, outputs, len(problem.events), INTERRUPTED)

    def engine(self) -> Engine:
        """Return the object that runs members: in vector lanes if possible, else one by one, by a `Flow` if possible.

        A `Flow` is a compiled function that returns only the last state, which is faster than a full run.
        """
        problem, method, single = self.problem, self.options.method, self.single
        if not isinstance(method, Planned) or problem.t0 == problem.t1:
            return single
        lanes = lane_engine(single, method.plan(problem), problem, varying=self.varying)
        # Events may end a run, or change its state and parameters. A flow has no events.
        flows = single.options.events is None and BY_FLOW.issuperset(column.name for column in single.columns)
        return lanes or (FlowEngine(single, Flow(single.model, single.options)) if flows else single)

    @property
    def single(self) -> RunEngine:
        """The object that runs members one by one, each as a separate run."""
        problem = self.problem
        span = problem.t0, problem.t1
        return RunEngine(problem.model, span, self.options, problem.t_eval, self.keep, self.columns)

    def explained(self, table: MemberTable, member: int) -> Explained:
        """Run the member with index `member` again, and return the status, time and message of its end.

        Raises StatementError for an index outside the table.
        """
        chosen = whole_number(member, "member", 0, len(table) - 1)
        return self.single.explained(table.starts(np.array([chosen])))

    def packed(self) -> bytes:
        """Return the pickled job for another process. Raises StatementError for a function that cannot be pickled."""
        try:
            return pickle.dumps(replace(self, problem=replace(self.problem, progress=None)))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise StatementError(
                f"the ensemble cannot be sent to other processes: {error}. Define the functions of methods and "
                "events at the top level of a module: lambdas and nested functions cannot be pickled."
            ) from error


@dataclass(frozen=True, eq=False)
class ChunkResult:
    """The results `ends` of a chunk of members, and how they were run.

    `seconds` is the time that the chunk took. `form` says in words how its members were run, and `side_by_side` is the
    number of members that ran at the same time. If another process ran the chunk with compiled code, `processor` names
    its processor. Otherwise `processor` is "".
    """

    ends: Results
    seconds: float
    form: str
    side_by_side: int
    processor: str = ""


_ENGINES: OrderedDict[bytes, tuple[Engine, str]] = OrderedDict()
_LOCK = Lock()


def run_chunk(job: bytes, starts: Starts) -> ChunkResult:
    """Run a chunk of members in a worker process, and return their results.

    `job` is the pickled `Job` of the ensemble. The process compiles it at the first chunk. `starts` has the initial
    values of the members.
    """
    key = hashlib.sha256(job).digest()
    with _LOCK:
        if key not in _ENGINES:
            loaded: Job = pickle.loads(job)
            _ENGINES[key] = loaded.engine(), loaded.problem.model.machine.processor
            while len(_ENGINES) > ENGINES_KEPT:
                _ENGINES.popitem(last=False)
        engine, processor = _ENGINES[key]
    return replace(timed(engine, starts, lambda: False), processor=processor)


def timed(engine: Engine, starts: Starts, stopped: Stopped) -> ChunkResult:
    """Run a chunk of members by `engine` from the initial values `starts`, and return their results with the duration.

    `stopped` is called without arguments. When it returns True, no further member may begin.
    """
    began = time.perf_counter()
    ends = engine.run(starts, stopped)
    return ChunkResult(ends, time.perf_counter() - began, engine.form, engine.side_by_side)


MOST_WORKERS = 1024
"""Largest number of threads that a user may request. No machine has more processors."""


def processors() -> int:
    """Return the number of processors that this process may use. A container or `taskset` may limit this number."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_of(workers: Any) -> int:
    """Return the checked number of threads for the user's option `workers`; None means the number of processors."""
    return processors() if workers is None else whole_number(workers, "workers", 1, MOST_WORKERS)


CHUNKS_PER_WORKER = 2
"""Number of chunks submitted for each worker of an executor: one runs, and the next one waits."""

AT_ONCE, SENT = 0.1, 0.5
"""Planned duration of a chunk of members in seconds. `AT_ONCE`: on threads, where a user does not notice a delay of
0.1 s. `SENT`: by an executor, which costs this process some milliseconds for each chunk. With chunks of 0.1 s, two
workers of Dask would take 1.07 times as long."""


class ThreadRunner:
    """Runs chunks of members on `workers` threads by `engine`, whose machine code releases the interpreter lock."""

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
    """Runs chunks of members by an executor of the user, such as a ProcessPoolExecutor, which the user closes."""

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
        """Do nothing: submitted chunks finish soon, and workers on other machines cannot be told to stop."""

    def close(self) -> None:
        """Do nothing: the user closes the executor."""


Runner = ThreadRunner | ExecutorRunner
"""Type of an object that runs chunks of members: up to `places` chunks at once, each for about `chunk_seconds`."""

FIRST_CHUNK, LARGEST_CHUNK = 8, 65536
"""Number of members in each of the first chunks, until a chunk has been timed, and the largest number in any chunk."""

GOES_ON = "With store= the same call goes on where this one stopped."

Take = Callable[[int, ChunkResult], None]
"""Type of a callback that receives the results of a chunk of members. Its arguments are the index of the chunk's first
member in the ensemble, and the results."""


def run_members(table: MemberTable, blocks: Iterable[tuple[int, int]], runner: Runner, take: Take) -> None:
    """Run the members of `blocks`, pairs (first, end) with end excluded, in chunks, in order of their index.

    `table` has the initial values of all members. `runner` runs the chunks, on threads or by an executor. `take` is
    called in this thread with the results of each chunk, in the order in which chunks finish. After an error or Ctrl-C,
    the running chunks finish, and `take` gets their results, too.
    """
    size = FIRST_CHUNK
    done: SimpleQueue[tuple[int, int, Any]] = SimpleQueue()
    under_way: dict[int, Any] = {}

    def collect() -> None:
        nonlocal size
        first, count, future = done.get()
        del under_way[first]
        result = _result(future)
        # The next chunks are to take about `chunk_seconds`, and to have at least the members that run at the same time.
        fitting = int(count * runner.chunk_seconds / max(result.seconds, 1e-9))
        size = min(max(fitting, result.side_by_side), 4 * size, LARGEST_CHUNK)
        take(first, result)

    try:
        for first, end in blocks:
            while first < end:
                count = min(size, end - first)
                future = _submitted(runner, table.starts(np.arange(first, first + count)))
                future.add_done_callback(lambda finished, key=(first, count): done.put((*key, finished)))
                under_way[first] = future
                first += count
                while len(under_way) >= runner.places:
                    collect()
        while under_way:
            collect()
    except BaseException:
        runner.stop()
        for future in under_way.values():
            future.cancel()
        with suppress(RunError):  # A disk that has failed fails again.
            # Read the futures, not the queue `done`: Ctrl-C may have interrupted the reading of the queue.
            for first, future in under_way.items():
                if not future.cancelled() and future.exception() is None:
                    take(first, _result(future))
        raise
    finally:
        runner.close()


def _submitted(runner: Runner, starts: Starts) -> Any:
    """Submit the chunk of members with the initial values `starts` to `runner`, and return its future.

    Raises RunError if the executor does not accept the chunk, and StatementError if it returns no future.
    """
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
    """Wait for the `future` of a chunk of members, and return the chunk's results.

    Raises the error of a member, or RunError if the executor failed.
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
    """Context manager that replaces an executor's error by a RunError, which says how to continue the ensemble."""
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


@dataclass
class ResultCollector:
    """Callback that stores the results of each finished chunk, and reports the number of members that have results.

    `processor` names the processor for which this process compiles, or is "". `store` is called with the index of the
    first member of a chunk and the chunk's results. `before` is the number of members that had results at the start of
    the ensemble's call, and `ran` the number of members run since then. `report` is called with `before` + `ran`, or is
    None. The keys of `forms` are phrases that say how members were run. The keys of `processors` are the processors for
    which other processes compiled.
    """

    processor: str
    store: Callable[[int, Results], None]
    before: int
    ran: int = 0
    report: Callable[[float], None] | None = None
    forms: dict[str, None] = field(default_factory=dict)
    processors: dict[str, None] = field(default_factory=dict)

    def __call__(self, first: int, result: ChunkResult) -> None:
        """Store the `result` of a chunk of members. `first` is the index of its first member."""
        self.forms[result.form] = None
        if result.processor:
            self.processors[result.processor] = None
        self.store(first, result.ends)
        self.ran += result.ends.members
        if self.report is not None:
            self.report(self.before + self.ran)

    @property
    def form(self) -> str:
        """Text that says how members were run, for the printed summary of an ensemble.

        A note is added if workers without llvmlite or with another processor ran members, because the last digits of
        their results may differ from those of this machine.
        """
        notes = ["; ".join(self.forms) or "all members were stored"]
        if self.processor and any(form.endswith(BY_NUMPY) for form in self.forms):
            notes.append("a worker has no llvmlite")
        if others := [processor for processor in self.processors if processor != self.processor]:
            notes.append(f"workers compiled for {listing(others)}, not for {self.processor}")
        return "; ".join(notes) + (": the last digits may differ from those of this machine" if notes[1:] else "")


def results_in_memory(job: Job, table: MemberTable) -> Results:
    """Return blank arrays for an ensemble's results. Raises StatementError if they exceed a quarter of the memory."""
    members, columns = len(table), job.columns
    size, limit = members * sum(column.bytes for column in columns), machine_memory() / MEMORY_DIVISOR
    if size > limit:
        raise StatementError(
            f"the results of {counted(members, 'member')} take {size:.3g} bytes, more than a quarter of the memory, "
            f'{limit:.3g} bytes: give store="runs.zarr", which writes them to a folder block by block, or fewer '
            "members or output times."
        )
    return Results.empty(members, columns)
