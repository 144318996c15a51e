"""The memory of a run by a step program with events: what the loop over steps and those who watch read and write."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.state import MOST_LANES, DriverState
from lagrange.procedure.events.event_run import EVENT_RUN, MOST_STEPS, SETTINGS
from lagrange.procedure.events.step_zeros import MOST_ZEROS, REVIEW

FloatArray = NDArray[np.float64]
WholeArray = NDArray[np.int64]

ROOM = 2048
"""So many events, and so many changes of the motion, are written before the loop comes back."""


class Reaction(NamedTuple):
    """What is to happen at the zeros of an event: those of a `direction` count, 0 for all.

    Its resets begin at the `first` among all, and are for some `entries` of the state.
    """

    direction: int = 0
    first: int = 0
    entries: tuple[int, ...] = ()


class StepFunction(NamedTuple):
    """What takes steps, for procedures that take it as `STEPS` says: its address, and the first argument.

    It works in `work`, where the entries of the state stand at some places.
    """

    address: int
    laws: WholeArray
    work: FloatArray
    entries: WholeArray


class Happened(NamedTuple):
    """What happened since it was last asked: zeros that count, by event, with times (k,) and states (k, 2n).

    And the changes of the motion: the rows behind which it is another, and the ends of the steps that were cut for
    them, times (m,), NaN where none was, and states (m, 2n).
    """

    which: WholeArray
    when: FloatArray
    there: FloatArray
    rows: WholeArray
    times: FloatArray
    states: FloatArray


class StepEventMemory:
    """What a run of states of a `size` with events knows; see `EVENT_RUN` and `REVIEW`, and `ReviewArguments`.

    The steps that wait to be reviewed are rows of `times` and `states`, from row 1 on, and row 0 is the one before.
    """

    def __init__(self, size: int, reactions: Sequence[Reaction]) -> None:
        self.size, events = size, len(reactions)
        self.run: Any = EVENT_RUN.structure(count=0, begin=1, break_room=ROOM, ahead=1, longest=1)
        self.review: Any = REVIEW.structure(room=ROOM + MOST_ZEROS)
        self.times = np.zeros(MOST_STEPS + 4)
        self.states = np.empty((MOST_STEPS + 4 + MOST_LANES, size))
        self.sign, self.near, self.remaining, self.came, self.until_end = np.zeros((5, events), dtype=np.int64)
        self.stayed = np.zeros(events)
        self.direction = np.array([one.direction for one in reactions], dtype=np.int64)
        self.which = np.empty(ROOM + MOST_ZEROS, dtype=np.int64)
        self.when, self.there = np.empty(ROOM + MOST_ZEROS), np.empty((ROOM + MOST_ZEROS, size))
        resets = [[one.first for one in reactions], [len(one.entries) for one in reactions], [0] * events]
        entries = [entry for one in reactions for entry in one.entries]
        self.settings = np.array([*(x for block in resets for x in block), *entries, 0], dtype=np.int64)
        self.until_end = self.settings[(SETTINGS - 1) * events : SETTINGS * events]
        self.break_rows, self.break_times = np.empty(ROOM + 1, dtype=np.int64), np.empty(ROOM + 1)
        self.break_states = np.empty((ROOM + 1, size))
        self.kept_reals, self.kept_counts = np.empty(0), np.empty(0, dtype=np.int64)
        self.keep_start()

    def keep_start(self) -> None:
        """Let the records as they are be those that every run begins with."""
        self._start = bytes(self.run), bytes(self.review)

    def restart(self) -> None:
        """Begin another run by the same driver: no steps were taken, and nothing has happened."""
        for record, start in zip((self.run, self.review), self._start, strict=True):
            ctypes.memmove(ctypes.addressof(record), start, len(start))
        self.kept_counts.fill(0)

    @property
    def nbytes(self) -> int:
        """How many bytes the arrays take."""
        return sum(array.nbytes for array in vars(self).values() if isinstance(array, np.ndarray))

    def keep(self, state: DriverState) -> None:
        """Make room for the numbers and counts of a run."""
        if len(self.kept_reals) != len(state.reals):
            self.kept_reals, self.kept_counts = state.reals.copy(), state.counts.copy()

    @property
    def waits(self) -> bool:
        """Whether there are steps that were not reviewed."""
        return bool(self.run.begin <= self.run.count)

    @property
    def taken(self) -> int:
        """How many steps the run had when those that wait were taken."""
        return int(self.kept_counts[DriverState.STEPS])

    @property
    def reviewed(self) -> int:
        """How many steps of the run were reviewed."""
        return self.taken + int(self.run.begin) - 1

    def happened(self) -> Happened:
        """Return what happened since the last call."""
        found, breaks = self.review.found, self.run.breaks
        self.review.found = self.run.breaks = self.run.proven = 0
        zeros = self.which[:found].copy(), self.when[:found].copy(), self.there[:found].copy()
        rows = self.break_rows[:breaks].copy(), self.break_times[:breaks].copy(), self.break_states[:breaks].copy()
        return Happened(*zeros, *rows)


class EventSteps(Protocol):
    """Takes steps of a driver and finds the events on them."""

    def __call__(self, state: DriverState, memory: StepEventMemory, times: FloatArray, rows: FloatArray) -> int:
        """Advance a run, and return an `Outcome`, `LOOK` or `READ_EVENTS`; see `event_steps`."""
