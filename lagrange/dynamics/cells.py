"""The cells of a map: a run for each, on several threads, coarse first, so that a part of them shows the whole."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.dynamics.axes import Plane
from lagrange.dynamics.runs import Report
from lagrange.machine.backend import FloatArray
from lagrange.members.processors import processors
from lagrange.statement.number import whole_number

CELLS_PER_TASK = 64
"""Cells that a thread takes at once: some ten milliseconds of runs, for 50 us of handing them out."""

MOST_WORKERS = 256

NOT_COMPUTED, NONE = -2, -1
"""What stands in a map of labels where nothing was computed, and where there is no label."""


Places = NDArray[np.int_]
"""Places of cells, (k, 2): row and column."""


def coarse_first(rows: int, columns: int) -> Places:
    """Return the places (rows*columns, 2) of all cells: every 2^k-th in both directions, then those between."""
    step = 1 << (max(rows, columns) - 1).bit_length()
    taken = np.zeros((rows, columns), dtype=bool)
    order = []
    while step >= 1:
        grid = np.zeros((rows, columns), dtype=bool)
        grid[::step, ::step] = True
        order.append(np.argwhere(grid & ~taken))
        taken |= grid
        step //= 2
    return np.concatenate(order)


def states_of(plane: Plane, base: FloatArray, places: Places) -> FloatArray:
    """Return the states (k, 2n) of cells (k, 2), row and column."""
    states = np.repeat(base[None, :], len(places), axis=0)
    states[:, plane[0].row] = plane[0].values[places[:, 1]]
    states[:, plane[1].row] = plane[1].values[places[:, 0]]
    return states


def workers_of(given: Any) -> int:
    """Return the number of threads: as many as this process may use processors unless it is given."""
    return processors() if given is None else whole_number(given, "workers", 1, MOST_WORKERS)


def each_cell(
    plane: Plane,
    base: FloatArray,
    work: Callable[[Places, FloatArray, Callable[[], bool]], int],
    workers: int,
    progress: Report | None = None,
) -> bool:
    """Call `work(places, states, stopped)` for all cells, some at a time; return whether all were done.

    It gets places (k, 2), row and column, and states (k, 2n), and returns how many of them it has done: all unless
    `stopped()` became true, as it does after Ctrl-C.
    """
    places = coarse_first(plane[1].count, plane[0].count)
    states, stopping, done = states_of(plane, base, places), threading.Event(), 0

    def task(first: int) -> int:
        here = slice(first, first + CELLS_PER_TASK)
        return 0 if stopping.is_set() else work(places[here], states[here], stopping.is_set)

    with ThreadPoolExecutor(workers) as pool:
        try:
            for finished in _tasks(pool, task, range(0, len(places), CELLS_PER_TASK), workers):
                done += finished.result()
                if progress is not None:
                    progress(float(done))
        except KeyboardInterrupt:
            return False
        finally:
            stopping.set()
    return True


def _tasks(pool: ThreadPoolExecutor, task: Callable[[int], int], firsts: range, workers: int) -> Iterator[Future[int]]:
    """Yield tasks as they are finished; no more are handed out than the threads need to go on."""
    running: set[Future[int]] = set()
    waiting = iter(firsts)
    for first in waiting:
        running.add(pool.submit(task, first))
        if len(running) < 2 * workers:
            continue
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        yield from finished
    while running:
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        yield from finished
