"""Memory of a run with events by a step program (any method but Taylor series).

The loop over steps and the search for events share it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.events.loop import EVENT_RUN, MOST_WAITING, SETTINGS
from lagrange.algorithm.events.search import MOST_ZEROS, REVIEW
from lagrange.machine.state import DriverState

FloatArray = NDArray[np.float64]
WholeArray = NDArray[np.int64]

STEP_EVENT_ROOM = 2048
"""Largest number of events, and of changes of the motion, that are written before the loop returns."""


class Reaction(NamedTuple):
    """How a run reacts to zeros of one event function or switching surface.

    `direction` is the sign of the crossings that count, 0 for both, or `CROSSING` for a surface. The run ends at event
    number `terminal` of this function, or never if `terminal` is 0. A reset replaces the entries of the state with the
    indices `entries`. Their new values begin at index `first` of the results of all resets. `root` is true if the
    function is a square root in the equations of motion, and `smooth` if it has no jumps.
    """

    direction: int = 0
    terminal: int = 0
    first: int = 0
    entries: tuple[int, ...] = ()
    root: bool = False
    smooth: bool = False


class StepFunction(NamedTuple):
    """A compiled function that takes steps, of the type `TAKE_STEPS`, with the memory that it uses.

    `address` is the address of the function. Its first argument is `words`, the array of 8-byte words that holds its
    other arguments. `work` is its work array. The state is in `work` at the indices `entries`.
    """

    address: int
    words: WholeArray
    work: FloatArray
    entries: WholeArray


class Happened(NamedTuple):
    """Events found since the last call, and the rows after which the motion changes by a reset or a switch.

    Event k is a zero of the event function with index `which[k]`, at the time `when[k]` and the state
    `event_states[k]` (2n,). `rows` (m,) are indices of accepted states. After each of them a new smooth piece of the
    run begins. The step that ends there may have been shortened. Then `times` (m,) and `states` (m, 2n) have the end
    of the full step; for other steps the time is NaN.
    """

    which: WholeArray
    when: FloatArray
    event_states: FloatArray
    rows: WholeArray
    times: FloatArray
    states: FloatArray


class StepEventMemory:
    """Arrays and records that the compiled loop over steps with events works on, for states of length `size`.

    Steps that are not yet searched for events are stored from row 1 of `times` and `states` on. Row 0 is the state
    before them.
    """

    def __init__(self, size: int, reactions: Sequence[Reaction]) -> None:
        self.size, events = size, len(reactions)
        self.run: Any = EVENT_RUN.structure(count=0, begin=1, break_room=STEP_EVENT_ROOM, ahead=1, longest=1)
        self.review: Any = REVIEW.structure(room=STEP_EVENT_ROOM + MOST_ZEROS)
        self.times = np.zeros(MOST_WAITING + 4)
        self.states = np.empty((MOST_WAITING + 4 + WIDEST_VECTOR, size))
        self.sign, self.near, self.remaining, self.arrivals, self.until_end = np.zeros((5, events), dtype=np.int64)
        self.zero_sizes = np.zeros(events)
        self.direction = np.array([r.direction for r in reactions], dtype=np.int64)
        self.which = np.empty(STEP_EVENT_ROOM + MOST_ZEROS, dtype=np.int64)
        self.when, self.there = np.empty(STEP_EVENT_ROOM + MOST_ZEROS), np.empty((STEP_EVENT_ROOM + MOST_ZEROS, size))
        resets = [[r.first for r in reactions], [len(r.entries) for r in reactions], [0] * events]
        entries = [entry for r in reactions for entry in r.entries]
        self.settings = np.array([*(x for block in resets for x in block), *entries, 0], dtype=np.int64)
        self.until_end = self.settings[(SETTINGS - 1) * events : SETTINGS * events]
        self.break_rows, self.break_times = np.empty(STEP_EVENT_ROOM + 1, dtype=np.int64), np.empty(STEP_EVENT_ROOM + 1)
        self.break_states = np.empty((STEP_EVENT_ROOM + 1, size))
        self.kept_reals, self.kept_counts = np.empty(0), np.empty(0, dtype=np.int64)
        self.keep_start()

    def keep_start(self) -> None:
        """Save copies of the structures `run` and `review`, from which later runs of the same driver start.

        They hold the data of the loop over steps and of the search for events.
        """
        self._start = bytes(self.run), bytes(self.review)

    def restart(self) -> None:
        """Restore the structures `run` and `review` that `keep_start` saved, for another run by the driver.

        They then have no steps and no events.
        """
        for record, start in zip((self.run, self.review), self._start, strict=True):
            ctypes.memmove(ctypes.addressof(record), start, len(start))
        self.kept_counts.fill(0)

    @property
    def nbytes(self) -> int:
        """Number of bytes of all arrays of the memory."""
        return sum(array.nbytes for array in vars(self).values() if isinstance(array, np.ndarray))

    def keep(self, state: DriverState) -> None:
        """Allocate copies of the numbers and counts of a run, `state.reals` and `state.counts`.

        The loop over steps restores the run from the copies when a reset or a switch changes the motion.
        """
        if len(self.kept_reals) != len(state.reals):
            self.kept_reals, self.kept_counts = state.reals.copy(), state.counts.copy()

    @property
    def waits(self) -> bool:
        """True if the memory has steps that are not yet searched for events."""
        return bool(self.run.begin <= self.run.count)

    @property
    def taken(self) -> int:
        """Number of accepted steps of the run before the steps that are not yet searched for events."""
        return int(self.kept_counts[DriverState.STEPS])

    @property
    def reviewed(self) -> int:
        """Number of accepted steps of the run that are already searched for events."""
        return self.taken + int(self.run.begin) - 1

    def happened(self) -> Happened:
        """Return the events found since the last call, and the rows after which a reset or switch followed."""
        count, breaks = self.review.written, self.run.breaks
        self.review.written = self.run.breaks = self.run.proven = 0
        zeros = self.which[:count].copy(), self.when[:count].copy(), self.there[:count].copy()
        rows = self.break_rows[:breaks].copy(), self.break_times[:breaks].copy(), self.break_states[:breaks].copy()
        return Happened(*zeros, *rows)


EventSteps = Callable[[DriverState, StepEventMemory, FloatArray, FloatArray], int]
"""A function that takes steps of a run and finds the events on them. It returns a number that says why it stopped.

Arguments: the state of the run, the memory of events, and the arrays for the times (c,) and states (c, 2n) of accepted
steps. The number is an `Outcome`, or the code `LOOK` (a step is irregular) or `READ_EVENTS` (the arrays of the memory
are full) of `event_steps`.
"""
