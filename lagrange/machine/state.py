"""State of a run while a driver advances it: time, coordinates, step size, tolerances, counts, and events."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import WIDEST_VECTOR, Outcome, whole_blocks
from lagrange.algorithm.events.loop import EVENT_RUN, MOST_WAITING, SETTINGS
from lagrange.algorithm.events.search import MOST_ZEROS, REVIEW
from lagrange.algorithm.step.memory import COUNTS, RUN
from lagrange.algorithm.taylor.memory import OUTPUTS, TAYLOR

__all__ = ["OUTCOMES", "DriverState", "Outcome", "Outputs"]

OUTCOMES = tuple(Outcome)
"""The members of `Outcome` in the order of their numbers. Compiled loops return such numbers."""


class Outputs:
    """The output times of a run, in the direction of the run, and the states (K, 2n) at these times.

    Drivers by Taylor series write the states during the run. `times` ends with a NaN after the last output time.
    `states` has `WIDEST_VECTOR` more rows than there are output times, since machines write whole vectors.
    `record.done` is the number of states written so far.
    """

    def __init__(self, times: NDArray[np.float64], dimension: int) -> None:
        self.times = np.append(times, math.nan)
        self.states = np.zeros((len(self.times) + WIDEST_VECTOR, dimension))
        self.record: Any = OUTPUTS.structure()

    def write(self, end: float, direction: float, path: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        """Write the states at those output times before `end` that are not written yet.

        It is called for a part of the run without Taylor steps. `direction` is 1.0 or -1.0, the sign of the run's
        steps. `path` maps times (k,) to states (2n, k) on this part.
        """
        times = self.times[self.record.done : -1]
        count = int(np.count_nonzero((times - end) * direction < 0))
        if count:
            self.states[self.record.done : self.record.done + count] = path(times[:count]).T
            self.record.done += count

    def joined(
        self, times: NDArray[np.float64], path: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """Return the states (2n, k) at the first k output times, which the caller passes as `times` (k,).

        States not written yet are computed by `path`, which maps times (m,) to states (2n, m).
        """
        done, count = self.record.done, len(times)
        if done < count:
            self.states[done:count] = path(times[done:]).T
        return self.states[:count].T


NO_OUTPUTS = Outputs(np.empty(0), 1)
"""The outputs of a run without output times. All such runs share them, because nothing is written to them."""


class DriverState:
    """State of a run while a driver advances it. Its arrays are shared with machine code.

    `reals` has the fields of `Run`, at the indices T to RESIDUAL, then the floors (2n,), padded to whole vectors of a
    machine. `counts` has the fields of `Counts`, at the indices STEPS to SURVEYED. Both records are in
    lagrange/algorithm/step/memory.py. The tolerance of an entry of the state is RTOL times its size in the step, plus
    its floor. An accepted step raises a floor to at least SHARE times the size of the entry. Floors stated by the user
    have a SHARE of 0 and are constant. Floors that follow the size of the state begin at `LEAST_FLOOR`.

    `taylor` is the record of a run by Taylor series, of the type `TAYLOR`. Such a run writes the states at output
    times to `outputs`.

    `floats` and `integers` are memory views of `reals` and `counts`, through which one entry is set five times
    faster. Drivers written in Python set `fault`, the error of a failed step, and `kept`, the number of bytes that the
    driver stores of the run.
    """

    T, END, H, RTOL, SHARE, PREVIOUS, START, STEP, CAUSE, LONGEST, RESIDUAL = RUN.places.values()
    FLOORS = len(RUN.fields)
    STEPS, REJECTED, EVALUATIONS, SLOPE_KNOWN, ROWS, RECORD, AFTER_REJECT, KEPT, SURVEYED = COUNTS.places.values()

    def __init__(
        self, t: float, end: float, y: NDArray[np.float64], rtol: float, atol: float, step: float, share: float = 0.0
    ) -> None:
        """Begin a run at time `t` and state `y` (2n,) towards the time `end`.

        `rtol` is the relative tolerance, and `atol` the first floor (least absolute tolerance) of every entry. Accepted
        steps raise a floor to at least `share` times the size of its entry. `step` is signed: the size of all steps of
        a fixed-step method, or of the first step of another method. 0 means that the first step is still to be chosen.
        """
        self.reals = np.zeros(self.FLOORS + whole_blocks(len(y), WIDEST_VECTOR))
        self.reals[self.FLOORS :] = 1.0
        self.floors = self.reals[self.FLOORS : self.FLOORS + len(y)]
        self.floors[:] = atol
        self.counts = np.zeros(len(COUNTS.fields), dtype=np.int64)
        self.y = np.array(y, dtype=float)
        floats: Any = self.reals.data
        integers: Any = self.counts.data
        self.floats, self.integers = floats, integers
        floats[self.T] = floats[self.START] = t
        floats[self.END] = end
        floats[self.H] = floats[self.STEP] = step
        floats[self.RTOL] = rtol
        floats[self.SHARE] = share
        floats[self.PREVIOUS] = 1.0
        floats[self.CAUSE] = Outcome.STEP_TOO_SMALL
        floats[self.LONGEST] = math.inf
        integers[self.RECORD] = 1
        self.taylor: Any = TAYLOR.structure(scale=1.0, next_limit=math.inf, limit=math.inf)
        self.outputs = NO_OUTPUTS
        self.fault: Any = None
        self.kept = 0

    def records(self) -> dict[str, Any]:
        """Return the arguments `run`, `counts` and `floors` of procedures that advance the run, by name.

        `run` is a structure with the fields of `Run`, and `counts` one with the fields of `Counts`. `floors` (2n,) are
        the least absolute tolerances. All three share memory with this object.
        """
        run, counts = RUN.structure.from_buffer(self.floats), COUNTS.structure.from_buffer(self.integers)
        return {"run": run, "counts": counts, "floors": self.floors}

    def restart(
        self, first: NDArray[np.float64], span: tuple[float, float], y: NDArray[np.float64], step: float, longest: float
    ) -> None:
        """Begin another run with the same driver, over `span` (start, end) from the state y (2n,).

        `first` is a copy of `reals` at the start of an earlier run. `step` is the signed first step, and `longest` is
        the largest size of a step.
        """
        reals, floats = self.reals, self.floats
        reals[:] = first
        floats[self.T], floats[self.END] = span
        floats[self.START] = span[0]
        floats[self.H] = floats[self.STEP] = step
        floats[self.LONGEST] = longest
        self.counts.fill(0)
        self.y[:] = y
        self.fault, self.kept = None, 0

    def restart_series(self) -> None:
        """Set the data of Taylor steps, `taylor`, to their values at the start of a run."""
        taylor = self.taylor
        taylor.low, taylor.scale, taylor.next_limit, taylor.limit = 0.0, 1.0, math.inf, math.inf
        taylor.rescalings = taylor.failures = taylor.inspect = 0

    @property
    def t(self) -> float:
        """The time that the run has reached."""
        return float(self.floats[self.T])

    @property
    def cause(self) -> Outcome:
        """The reason why a trial step was last rejected. An error above the tolerance counts as STEP_TOO_SMALL."""
        return Outcome(int(self.reals[self.CAUSE]))

    def count(self, which: int) -> int:
        """Return a count of the run. `which` is its index, such as `DriverState.STEPS` for accepted steps."""
        return int(self.integers[which])


FloatArray = NDArray[np.float64]
WholeArray = NDArray[np.int64]

STEP_EVENT_ROOM = 2048
"""Largest number of events, and also of resets and switches, in a `StepEventMemory`. The loop returns if it is full."""


class Reaction(NamedTuple):
    """Reaction of a run to the zeros of one event function or switching surface.

    `direction` is the sign of the crossings that are events, 0 for both, or `CROSSING` for a surface. The run ends at
    event number `terminal` of this function, or never if `terminal` is 0. A reset replaces the state entries with the
    indices `entries`. Their new values begin at index `first` of the array with the results of all resets. `root` is
    True if the function is a square root in the equations of motion, and `smooth` if it has no jumps.
    """

    direction: int = 0
    terminal: int = 0
    first: int = 0
    entries: tuple[int, ...] = ()
    root: bool = False
    smooth: bool = False


class StepFunction(NamedTuple):
    """A compiled function that takes steps of a run, with its memory. Another compiled loop calls it by its address.

    `address` is the address of the function, which has the type `TAKE_STEPS`. Its first argument is `words`, an array
    of 8-byte words with the arguments of the loop over steps. `work` is the loop's work array, which has the state
    (2n,) at the indices `entries`.
    """

    address: int
    words: WholeArray
    work: FloatArray
    entries: WholeArray


class NewEvents(NamedTuple):
    """Events found since the last call, and accepted states at which a reset or a switch begins a new smooth piece.

    Event k is a zero of the event function with index `which[k]`, at the time `when[k]` and the state
    `event_states[k]` (2n,). `rows` (m,) are the indices of the accepted states at which a smooth piece begins. The step
    to such a state may have been shortened. Then `times` (m,) and `states` (m, 2n) have the end of the full step. For
    other steps the time is NaN.
    """

    which: WholeArray
    when: FloatArray
    event_states: FloatArray
    rows: WholeArray
    times: FloatArray
    states: FloatArray


class StepEventMemory:
    """Memory of the compiled loop that takes steps and finds events, for states of length `size`.

    `reactions` has one entry for each event function. Rows of `times` and `states` from row 1 on are the ends of steps
    that are not yet searched for events. Row 0 is the state before them.
    """

    def __init__(self, size: int, reactions: Sequence[Reaction]) -> None:
        self.size, events = size, len(reactions)
        self.run: Any = EVENT_RUN.structure(count=0, begin=1, break_room=STEP_EVENT_ROOM, ahead=1, longest=1)
        self.review: Any = REVIEW.structure(room=STEP_EVENT_ROOM + MOST_ZEROS)
        self.times = np.zeros(MOST_WAITING + 4)
        self.states = np.empty((MOST_WAITING + 4 + WIDEST_VECTOR, size))
        self.sign, self.near, self.remaining, self.arrivals = np.zeros((4, events), dtype=np.int64)
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
        """Save the present records `run` (of the loop) and `review` (of the search), with which later runs start."""
        self._start = bytes(self.run), bytes(self.review)

    def restart(self) -> None:
        """Prepare the memory for another run: restore the records `run` and `review` that `keep_start` saved."""
        for record, start in zip((self.run, self.review), self._start, strict=True):
            ctypes.memmove(ctypes.addressof(record), start, len(start))
        self.kept_counts.fill(0)

    @property
    def nbytes(self) -> int:
        """Number of bytes of all arrays of the memory."""
        return sum(array.nbytes for array in vars(self).values() if isinstance(array, np.ndarray))

    def keep(self, state: DriverState) -> None:
        """Allocate arrays in which the loop saves `state.reals` and `state.counts`, and fill them with present values.

        The loop restores the run from these arrays when a reset or a switch makes it go back to an earlier time.
        """
        if len(self.kept_reals) != len(state.reals):
            self.kept_reals, self.kept_counts = state.reals.copy(), state.counts.copy()

    @property
    def waits(self) -> bool:
        """True if the memory has steps that are not yet searched for events."""
        return bool(self.run.begin <= self.run.count)

    @property
    def taken(self) -> int:
        """Number of accepted steps of the run before the steps in this memory."""
        return int(self.kept_counts[DriverState.STEPS])

    @property
    def reviewed(self) -> int:
        """Number of accepted steps of the run that are already searched for events."""
        return self.taken + int(self.run.begin) - 1

    def new_events(self) -> NewEvents:
        """Return the events found since the last call, and the accepted states at which a reset or switch followed."""
        count, breaks = self.review.written, self.run.breaks
        self.review.written = self.run.breaks = self.run.proven = 0
        zeros = self.which[:count].copy(), self.when[:count].copy(), self.there[:count].copy()
        rows = self.break_rows[:breaks].copy(), self.break_times[:breaks].copy(), self.break_states[:breaks].copy()
        return NewEvents(*zeros, *rows)


EventSteps = Callable[[DriverState, StepEventMemory, FloatArray, FloatArray], int]
"""Type of a function that takes steps of a run and finds the events on them. It returns the reason to stop as a number.
Arguments: the state of the run, the memory of events, and arrays to which the times (c,) and states (c, 2n) of accepted
steps are written. The result is an `Outcome`, `NEEDS_REVIEW` (zeros on a step cannot be resolved, so the caller must
search it) or `READ_EVENTS` (the arrays of the memory are full).
"""
