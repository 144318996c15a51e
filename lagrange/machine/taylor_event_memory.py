"""The memory of a Taylor run with events and switching surfaces, which the loop over steps reads and writes."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.events.constants import CROSSING
from lagrange.algorithm.step.constants import RELATIVE_PERTURBATION, perturbation_factors
from lagrange.algorithm.taylor.memory import MOST_SURFACES
from lagrange.algorithm.taylor.watching import MOST_ZEROS, PARTS, SETTINGS, SIDES, WATCH, scratch_sizes
from lagrange.machine.backend import FloatArray, Kernel
from lagrange.machine.step_event_memory import Reaction
from lagrange.program.series import SeriesProgram

TAYLOR_EVENT_ROOM = 4096
"""Least number of events that are written before the loop returns. There is always space for those of one step."""


def idle(program: SeriesProgram) -> EventMemory:
    """Return the memory of a Taylor run in which no events are found.

    With this memory the loop over steps returns before each step that may cross a switching surface.
    """
    events = len(program.watched) - program.sides
    return EventMemory(program.states, program.sides, [Reaction()] * events)


@lru_cache(maxsize=64)
def _tilts(dimension: int) -> FloatArray:
    """Return the factors (2n + 1,) near 1 by which the state and the time are multiplied to estimate rounding noise.

    The noise of an event function is estimated from its change.
    """
    return np.asarray(1 + RELATIVE_PERTURBATION * perturbation_factors(dimension + 1))


@lru_cache(maxsize=64)
def _settings(reactions: tuple[Reaction, ...]) -> NDArray[np.int64]:
    """Return the settings of all watched functions (events and surfaces) as one read-only array of integers.

    `reactions` has one entry for each function. The array has a block for each setting, such as the direction that
    counts, and a block has one entry for each function. The indices of the state's entries that resets replace follow
    after the blocks.
    """
    rows = [(r.direction, r.terminal, r.first, len(r.entries), int(r.root), int(r.smooth)) for r in reactions]
    settings = [x for block in zip(*rows, strict=True) for x in block]
    if len(settings) != len(SETTINGS) * len(reactions):
        raise AssertionError("each setting needs a block")
    return np.array([*settings, *(entry for r in reactions for entry in r.entries), 0], dtype=np.int64)


class EventMemory:
    """Memory of a Taylor run for its watched functions, and for the events found since the last call.

    Watched functions are the `surfaces` switching surfaces, then the event functions. `values` is the kernel that
    evaluates them from the state, the parameters and the sides of the surfaces. The side of a surface is the sign of
    its function, 1 or -1. `resets` is the kernel that computes the new entries of all resets from the state and the
    parameters (k,).
    """

    def __init__(
        self,
        dimension: int,
        surfaces: int,
        reactions: Sequence[Reaction],
        values: Kernel | None = None,
        resets: Kernel | None = None,
        parameters: FloatArray | None = None,
    ) -> None:
        self.count, self._dimension = surfaces + len(reactions), dimension
        self.values, self.resets, self.parameters = values, resets, np.empty(0) if parameters is None else parameters
        changing = surfaces > 0 or any(reaction.terminal or reaction.entries for reaction in reactions)
        room = max(TAYLOR_EVENT_ROOM, MOST_ZEROS * self.count)
        self.record: Any = WATCH.structure(surfaces=surfaces, changing=int(changing), room=room, changed=-np.inf)
        self.tilts = _tilts(dimension)
        self.sides = np.zeros(2 * len(SIDES) * self.count, dtype=np.int64)
        self.settings = _settings((*[Reaction(CROSSING)] * surfaces, *reactions))
        self.times = np.empty(room)
        self.states = np.empty(room * dimension + WIDEST_VECTOR)
        self.places = np.empty(room, dtype=np.int64)
        self.surfaces = surfaces
        few = surfaces <= MOST_SURFACES
        self.combinations = np.full(2**surfaces if few else 1, -1, dtype=np.int64)
        self.switch_rows, self.switch_combinations = (np.empty(room, dtype=np.int64) for _ in range(2))
        reals, wholes = scratch_sizes(self.count, dimension)
        self.scratch, self.whole_scratch = np.empty(reals + WIDEST_VECTOR), np.empty(wholes, dtype=np.int64)
        self.keep_start()

    def keep_start(self) -> None:
        """Save the present state of the memory, with which each later run with the same parameters starts."""
        self._start = bytes(self.record), self.combinations.copy()

    def restart(self) -> None:
        """Prepare another run: no events, and unknown signs of the switching surfaces."""
        record, combinations = self._start
        ctypes.memmove(ctypes.addressof(self.record), record, len(record))
        self.combinations[:] = combinations
        self.sides.fill(0)

    @property
    def nbytes(self) -> int:
        """Number of bytes of all arrays of the memory."""
        return sum(array.nbytes for array in vars(self).values() if isinstance(array, np.ndarray))

    def hold(self, sides: FloatArray, size: int) -> int:
        """Store the sides (signs, 1.0 or -1.0) of the switching surfaces, and return an index in the driver's array.

        The numbers of a series depend on the parameters and on the sides. The driver has one array for them, with a
        block of `size` numbers for each combination of sides. The result is the index at which the block of `sides`
        begins. Sides for which `combination` returns -1 use the first block.
        """
        self.record.combination = self.combination(sides)
        self.record.numbers = (1 + self.record.combination) * size
        if self.record.combination >= 0:
            self.combinations[self.record.combination] = self.record.numbers
        return int(self.record.numbers)

    def combination(self, sides: FloatArray) -> int:
        """Return the sides (s,) of switching surfaces as a binary number.

        Bit i is 1 if side i is 1.0, and 0 if it is -1.0. Return -1 if there are more than `MOST_SURFACES` surfaces,
        or if a side is 0. A side is 0 if the motion stays on the surface.
        """
        if self.surfaces == 0:
            return 0
        if len(sides) > MOST_SURFACES or not (np.abs(sides) == 1.0).all():
            return -1
        return sum(1 << i for i, side in enumerate(sides.tolist()) if side > 0)

    def sides_of(self, combination: int) -> FloatArray:
        """Return the sides (s,) of switching surfaces, each 1.0 or -1.0, for a number that `combination` returned."""
        return np.array([1.0 if combination >> i & 1 else -1.0 for i in range(self.surfaces)])

    def switched(self) -> list[tuple[int, int]]:
        """Return the crossings of switching surfaces since the last call, as pairs (row, new sides).

        The row is the index of the accepted state from which on the run has the new sides. The sides are a binary
        number, as `combination` returns it.
        """
        count, self.record.switches = self.record.switches, 0
        return list(zip(self.switch_rows[:count].tolist(), self.switch_combinations[:count].tolist(), strict=True))

    def __getattr__(self, name: str) -> NDArray[np.int64]:
        """Return the part `name` of an integer array of the memory, with one entry for each watched function.

        `PARTS` maps names to parts of the arrays `sides` and `whole_scratch`. For example, `signs` has the signs of
        the functions, and `event_counts` the numbers of their events.
        """
        array, begin = PARTS.get(name, ("", 0))
        if array not in ("sides", "whole_scratch"):
            raise AttributeError(name)
        block: NDArray[np.int64] = getattr(self, array)[begin * self.count :][: self.count]
        return block

    def zeros_now(self) -> list[tuple[int, int]]:
        """Return the watched functions that are zero at the present state, as pairs (index, direction).

        The direction is 1 or -1 for a change of sign, and 0 for a function that touches zero. The list is empty
        unless one of these zeros resets the state, crosses a switching surface, or ends the run.
        """
        return list(zip(*(part[: self.record.due].tolist() for part in (self.due, self.due_directions)), strict=True))

    @property
    def mark(self) -> tuple[int, float, float]:
        """Number of events in memory, and the times of the first and the last. They identify the batch of events."""
        count = self.record.done
        return count, float(self.times[0]), float(self.times[count - 1])

    def forget(self) -> None:
        """Discard the events in memory, after the caller has copied them."""
        self.record.done = self.record.ahead = 0

    def written(self) -> list[tuple[FloatArray, FloatArray]]:
        """Return times (k,) and states (k, 2n) of the events in memory, a pair for each watched function."""
        count, size = self.record.done, self._dimension
        times, states = self.times[:count], self.states[: count * size].reshape(count, size)
        if self.count == 1:
            return [(times.copy(), states.copy())]
        indices = self.places[:count]
        # NumPy sorts 8-bit and 16-bit integers by radix sort. Indexing rows with [order] takes ten times as long as
        # `take`.
        order = indices.astype(np.min_scalar_type(self.count)).argsort(kind="stable")
        ends = np.bincount(indices, minlength=self.count).cumsum().tolist()
        times, states = times.take(order), states.take(order, axis=0)
        return [(times[a:b], states[a:b]) for a, b in pairwise((0, *ends))]
