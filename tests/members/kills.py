"""Programs and workers that are killed while an ensemble is run into a store: what is there in the end.

python -m tests.members.kills program 3
python -m tests.members.kills dask 3
python -m tests.members.kills processes 3
"""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import lagrange as lg
from lagrange.errors import RunError
from lagrange.members import store, table, work
from tests.members.store_files import files

BLOCK, LARGEST = 256, 64
"""Members of a block of the store, and at most of a chunk: so a run of some seconds has many of both."""

GRID = {"x": (-0.9, 0.9, 96), "y": (-0.6, 0.6, 64)}
"""Some of these members leave, and end early."""
END = 12.0

BLOCKS = 24
"""Blocks of the whole store."""

WARMING = 1
"""Trials without a kill, in which workers start."""

LATER = 3
"""A program that is called again is killed at one of `LATER` times the blocks that are left: most calls are through."""

MOST_CALLS = 200
"""A trial that is not done after so many calls goes round in a circle."""


@dataclass
class Figures:
    """What came of some trials: kills that met a call under way, calls, and what must not be."""

    trials: int = 0
    kills: int = 0
    calls: int = 0
    gave_up: int = 0
    chunks: int = 0
    chunks_of_stored_blocks: int = 0
    blocks_lost: int = 0
    stores_that_differ: int = 0
    begun: float = field(default_factory=time.monotonic)

    @property
    def sound(self) -> bool:
        """Whether each trial ended with the right bytes, and nothing that was stored was computed again."""
        return not (self.chunks_of_stored_blocks or self.blocks_lost or self.stores_that_differ)


def small_pieces() -> None:
    """Divide an ensemble into many blocks and chunks."""
    store.LARGEST_BLOCK, work.LARGEST_CHUNK = BLOCK, LARGEST


def run(path: Path, **options: Any) -> lg.Ensemble:
    """Run the ensemble into a store."""
    return lg.ensemble(MODEL, END, lg.grid(GRID), keep=("end", "counts"), store=path, **options)


STARTS = "starts"

MODEL = lg.scene("henon-heiles").compile()


def stored(folder: Path) -> set[int]:
    """Return the blocks that a store has: the flag of each has a file of its own."""
    return {int(one.name) for one in (folder / "checksum" / "c").glob("*") if (one / "0").exists()}


def noted(log: Path) -> Callable[..., Any]:
    """Return `MemberTable.starts` that notes the first member of each chunk; the first call is no chunk."""
    starts = table.MemberTable.starts
    chunks = [False]

    def noting(members: Any, which: Any) -> Any:
        if chunks[0]:
            with log.open("a") as file:
                file.write(f"{which[0]}\n")
        chunks[0] = True
        return starts(members, which)

    return noting


def watch(starts: Callable[..., Any]) -> None:
    """Have the starts of members made by a function."""
    setattr(table.MemberTable, STARTS, starts)


def judge(figures: Figures, path: Path, log: Path, before: set[int], whole: dict[str, bytes] | None) -> None:
    """Count what a call computed again, and what it lost; at the end, `whole` is what the store has to be."""
    computed = [int(line) // BLOCK for line in log.read_text().split()] if log.exists() else []
    figures.calls += 1
    figures.chunks += len(computed)
    figures.chunks_of_stored_blocks += sum(block in before for block in computed)
    figures.blocks_lost += len(before - stored(path))
    if whole is not None:
        figures.stores_that_differ += files(path) != whole


def forked(path: Path, log: Path) -> int:
    """Run the ensemble in a copy of this process, and return its number: it has compiled nothing less than this one."""
    child = os.fork()
    if child == 0:
        try:
            watch(noted(log))
            run(path, workers=2)
        finally:
            os._exit(0)
    return child


def kill_at(child: int, path: Path, count: int) -> None:
    """Kill a process when a store has `count` blocks, or when it is through."""
    while len(stored(path)) < count and os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        time.sleep(1e-3)
    os.kill(child, signal.SIGKILL)  # one that is through waits to be asked how it ended


def programs(trials: int, seed: int, folder: Path) -> Figures:
    """Kill a program at a random number of blocks, and call it again, until it is through."""
    lg.ensemble(MODEL, END, {"x": [0.1]})  # compiled once, before the copies
    figures, generator = Figures(), random.Random(seed)
    os.waitpid(forked(folder / "whole.zarr", folder / "whole.log"), 0)
    whole = files(folder / "whole.zarr")
    assert len(stored(folder / "whole.zarr")) == BLOCKS, "the run to compare with is not whole"
    for trial in range(trials):
        path = folder / f"{trial}.zarr"
        figures.trials += 1
        for call in range(MOST_CALLS):
            log, before = folder / f"{trial}-{call}.log", stored(path)
            child = forked(path, log)
            left = BLOCKS - len(before)
            kill_at(child, path, len(before) + generator.randrange(left * LATER + 1 if call else left))
            _, how = os.waitpid(child, 0)
            through = not os.WIFSIGNALED(how)
            figures.kills += not through
            judge(figures, path, log, before, whole if through else None)
            if through:
                break
        else:
            figures.stores_that_differ += 1
    return figures


def killer(pids: Callable[[], list[int]], path: Path, generator: random.Random, killed: list[int]) -> threading.Event:
    """Kill one of some processes, from a thread, when a store has a random number of blocks.

    Return the event that calls it off.
    """
    off, count = threading.Event(), generator.randrange(BLOCKS)

    def kill() -> None:
        while len(stored(path)) < count:
            if off.wait(1e-3):
                return
        if found := pids():
            with suppress(ProcessLookupError):
                os.kill(pid := generator.choice(found), signal.SIGKILL)
                killed.append(pid)

    threading.Thread(target=kill, daemon=True).start()
    return off


def trials_of(
    trials: int, seed: int, folder: Path, executors: Iterator[Any], pids: Callable[[Any], list[int]]
) -> Figures:
    """Kill a worker of each executor at a random number of blocks, and call again where that is told."""
    figures, generator = Figures(), random.Random(seed)
    run(folder / "whole.zarr", workers=2)
    whole, starts = files(folder / "whole.zarr"), table.MemberTable.starts
    for trial in range(-WARMING, trials):
        path, killed, before = folder / f"{trial}.zarr", list[int](), set[int]()
        for call in range(MOST_CALLS):
            executor, log, off = next(executors), folder / f"{trial}-{call}.log", threading.Event()
            if trial >= 0 and not call:
                off = killer(partial(pids, executor), path, generator, killed)
            watch(noted(log))
            try:
                run(path, executor=executor)
                through = True
            except RunError:
                through = False
                figures.gave_up += 1
            finally:
                watch(starts)
                off.set()
            if trial >= 0:
                judge(figures, path, log, before, whole if through else None)
            before = stored(path)
            if through:
                break
        figures.trials, figures.kills = max(trial + 1, 0), figures.kills + len(killed)
    return figures


def processes(trials: int, seed: int, folder: Path) -> Figures:
    """Kill a worker of a `ProcessPoolExecutor`, which then gives up."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["lagrange.show.ensemble", "tests.members.kills"])

    def pools() -> Iterator[Any]:
        while True:
            with ProcessPoolExecutor(2, mp_context=context) as pool:
                yield pool

    return trials_of(trials, seed, folder, pools(), lambda pool: list(pool._processes or ()))


def dask(trials: int, seed: int, folder: Path) -> Figures:
    """Kill a worker of a local cluster of Dask, whose nanny starts another one.

    Each call has a cluster of its own: a nanny whose worker is killed while it starts gives up, and a client without
    workers waits for more.
    """
    distributed: Any = import_module("distributed")

    def clients() -> Iterator[Any]:
        while True:
            made = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
            with made as cluster, distributed.Client(cluster) as client:
                client.wait_for_workers(2)
                yield client

    def pids(client: Any) -> list[int]:
        return [nanny.pid for nanny in client.cluster.workers.values() if nanny.pid]

    return trials_of(trials, seed, folder, clients(), pids)


KINDS = {"program": programs, "dask": dask, "processes": processes}


def main() -> None:
    """Run so many trials of a kind, and write the figures as JSON."""
    kind, trials = sys.argv[1], int(sys.argv[2])
    small_pieces()
    with tempfile.TemporaryDirectory() as folder:
        figures = KINDS[kind](trials, int(sys.argv[3]) if len(sys.argv) > 3 else 1, Path(folder))
    seconds = time.monotonic() - figures.begun
    sys.stdout.write(json.dumps({**asdict(figures), "sound": figures.sound, "seconds": seconds}) + "\n")


if __name__ == "__main__":
    main()
