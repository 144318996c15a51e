"""The cells of a map: members in the order from coarse to fine, so that a part of them shows the whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lagrange.dynamics.axes import Plane
from lagrange.dynamics.runs import Report
from lagrange.machine.backend import FloatArray
from lagrange.members.chunk import Ends, Engine, Starts, Table
from lagrange.members.job import ChunkResult
from lagrange.members.runners import ThreadRunner
from lagrange.members.varied import MemberNumbers
from lagrange.members.work import run_members

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


class Listed(Table, Protocol):
    """Members of which it is known how many there are."""

    def __len__(self) -> int: ...


@dataclass(frozen=True, eq=False)
class Cells:
    """The starts on a plane as members, coarse first; `base` (2n,) has the other entries, `parameters` are (p,)."""

    plane: Plane
    base: FloatArray
    parameters: FloatArray

    @cached_property
    def places(self) -> Places:
        """The places of all members."""
        return coarse_first(self.plane[1].count, self.plane[0].count)

    def __len__(self) -> int:
        return self.plane[1].count * self.plane[0].count

    def starts(self, which: MemberNumbers) -> Starts:
        """Return where some members start."""
        return Starts(states_of(self.plane, self.base, self.places[which]), self.parameters[None])


def states_of(plane: Plane, base: FloatArray, places: Places) -> FloatArray:
    """Return the states (k, 2n) of cells (k, 2), row and column."""
    states = np.repeat(base[None, :], len(places), axis=0)
    states[:, plane[0].row] = plane[0].values[places[:, 1]]
    states[:, plane[1].row] = plane[1].values[places[:, 0]]
    return states


def each_cell(
    cells: Cells,
    engine: Engine,
    workers: int,
    take: Callable[[Places, Ends], None],
    progress: Report | None = None,
) -> bool:
    """Run the members of all cells on so many threads; return whether all were run, false after Ctrl-C.

    `take` gets the places (k, 2), row and column, of some of them, and what came of each.
    """

    def keep(first: int, ends: Ends) -> None:
        take(cells.places[first : first + ends.members], ends)

    return each_member(cells, engine, workers, keep, progress)


def each_member(
    table: Listed, engine: Engine, workers: int, take: Callable[[int, Ends], None], progress: Report | None = None
) -> bool:
    """Run all members on so many threads; return whether all were run, false after Ctrl-C.

    `take` gets the number of the first of some of them, and what came of each.
    """
    done = 0

    def keep(first: int, found: ChunkResult) -> None:
        nonlocal done
        take(first, found.ends)
        done += found.ends.members
        if progress is not None:
            progress(float(done))

    try:
        run_members(table, [(0, len(table))], ThreadRunner(engine, workers), keep)
    except KeyboardInterrupt:
        return False
    return True
