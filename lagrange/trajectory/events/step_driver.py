"""The driver of a step program with events: it takes steps, reviews them, and takes back those after a change.

Steps wait in memory until they are reviewed: in machine code in long runs, unless an event needs special treatment,
and otherwise on arrays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lagrange.algorithm.events.constants import AHEAD, CLOSE, FIRST_LOOK, LONGEST_LOOK
from lagrange.algorithm.events.event_run import LOOK, MOST_STEPS, READ_EVENTS
from lagrange.machine.backend import Driver
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.step_events import EventSteps, StepEventMemory
from lagrange.trajectory.trajectory import FloatArray

S = DriverState


@dataclass(frozen=True, eq=False)
class Cut:
    """The point to which a run is set back: `steps` steps are kept, the last one up to time t and state y (2n,).

    `length` is the length of the step that contains it or follows it. `whole` is the end of a step that is cut inside,
    or None. A `late` cut is not a change of the motion: the wall time of the run was used up.
    """

    steps: int
    t: float
    y: FloatArray
    length: float
    whole: tuple[float, FloatArray] | None = None
    late: bool = False


class Reviewer(Protocol):
    """Finds the events on accepted steps."""

    @property
    def shared(self) -> StepEventMemory:
        """The memory that the run and its events share with machine code."""

    @property
    def resets(self) -> bool:
        """True if an event resets the state."""

    @property
    def ends(self) -> bool:
        """True if an event may reset the state or end the run, so that steps after it are discarded."""

    @property
    def changed(self) -> float:
        """The time of the start or of the last reset."""

    @property
    def regular(self) -> bool:
        """True if no event function is known to be zero at the present state."""

    def compiled(self, driver: Driver, t: float, steps: int) -> EventSteps | None:
        """Return the compiled loop that takes and reviews steps, or None if `steps` steps up to t are too few."""

    def review(self, times: FloatArray, states: FloatArray, begin: int, end: int, taken: int) -> Cut | None:
        """Review some steps, times (S+1,) and states (S+1, 2n), on arrays; return the first change or None."""

    def write(self) -> None:
        """Write the present sides and counts for machine code."""

    def read(self) -> None:
        """Read events, resets and sides from machine code."""

    def collect(self) -> None:
        """Read only the events and resets that machine code has written."""

    def set_back(self, cut: Cut) -> None:
        """Record that the run was set back to a cut."""


class EventDriver:
    """Advances a run like the driver of its steps, but only up to the next change of the motion."""

    def __init__(self, driver: Driver, watch: Reviewer, *, fixed: bool) -> None:
        self._driver, self._watch, self._fixed = driver, watch, fixed
        self._memory, self._run = watch.shared, watch.shared.run
        self._run.ahead = FIRST_LOOK if watch.resets else LONGEST_LOOK
        self._run.fixed = int(fixed)
        self._compiled: EventSteps | None = None
        self._next_left, self._left_to_arrays, self._reviewed = 1, 0, 0
        self._first = self._stale = True

    def adopt(self, state: DriverState) -> None:
        """Do nothing: the state stays in its own memory."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run as `Driver.advance` does; the outcome is WATCHED if the state is at a change of the motion."""
        run = self._run
        run.budget = run.left = budget
        self._memory.keep(state)
        try:
            while True:
                compiled = self._compiled is not None and not self._left_to_arrays and self._watch.regular
                outcome = (self._in_loop if compiled else self._on_arrays)(state, times, rows)
                if outcome is not None:
                    return outcome
        except KeyboardInterrupt:
            self._watch.collect()
            self._forget(state)
            raise
        finally:
            self._first = False

    def _in_loop(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome | None:
        """Advance the run by machine code; return None if it returned a step for a review on arrays."""
        if self._compiled is None:
            raise AssertionError("there is machine code")
        run = self._run
        run.longest = LONGEST_LOOK if self._watch.ends else MOST_STEPS
        if self._stale:
            self._watch.write()
        code = self._compiled(state, self._memory, times, rows)
        self._watch.read()
        self._stale = code in (LOOK, Outcome.WATCHED)
        if code == READ_EVENTS:
            return None
        if code != LOOK:
            return Outcome(code)
        if self._memory.reviewed > self._reviewed:
            self._next_left = 1
        self._leave_to_arrays()
        return None

    def _leave_to_arrays(self) -> None:
        """Choose the number of next steps to review on arrays: one, and twice as many at each repetition."""
        self._left_to_arrays, self._next_left = self._next_left, min(2 * self._next_left, LONGEST_LOOK)

    def _on_arrays(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome | None:
        """Take steps if none waits, and review some on arrays; return an outcome, or None if the run continues."""
        memory, run = self._memory, self._run
        if not memory.waits:
            if run.starts and self._is_compiled(state.t, state.count(S.STEPS)):
                return None
            outcome = self._take(state)
            if outcome is not None:
                return outcome
            if self._first and self._is_compiled(memory.times[run.count + 1], memory.taken + run.count):
                return None
        if self._compiled is not None and not self._left_to_arrays and memory.waits:
            self._leave_to_arrays()
        count = run.count - run.begin + 1
        count = min(count, self._left_to_arrays) if self._compiled is not None else count
        self._left_to_arrays = max(0, self._left_to_arrays - count)
        return self._look(state, run.begin + count - 1, times, rows)

    def _is_compiled(self, t: float, steps: int) -> bool:
        """Return True if the loop has just been compiled.

        This is decided only in the first call and at the start of a motion. The number of steps in other calls depends
        on measured times, and the digits of events must not depend on them.
        """
        if self._compiled is None:
            self._compiled = self._watch.compiled(self._driver, float(t), steps)
            return self._compiled is not None
        return False

    def _take(self, state: DriverState) -> Outcome | None:
        """Take the next steps as `event_steps` does; return an outcome if no step can be taken, else None."""
        memory, run, reals, counts = self._memory, self._run, state.reals, state.counts
        if state.t == reals[S.END]:
            return Outcome.DONE
        first = bool(run.both and not run.before)
        if run.left <= 0 or (first and run.left < 2 and run.left < run.budget):
            return Outcome.PAUSED
        memory.kept_reals[:], memory.kept_counts[:] = reals, counts
        memory.times[1], memory.states[1] = reals[S.T], state.y
        run.rows = int(counts[S.ROWS])
        counts[S.ROWS] = 0
        tries = min(run.ahead, run.left, MOST_STEPS)
        tries = max(tries, min(2, run.left)) if first else tries
        try:
            outcome = self._drive(state, tries)
            while first and run.left < run.budget - 1 and counts[S.ROWS] < 2 and outcome is Outcome.PAUSED:
                outcome = self._drive(state, 1)
        except KeyboardInterrupt:
            counts[:], reals[:], state.y[:] = memory.kept_counts, memory.kept_reals, memory.states[1]
            raise
        run.count, run.begin, run.outcome = int(counts[S.ROWS]), 1, int(outcome)
        counts[S.ROWS] = run.rows
        if not run.count:
            run.ahead = min(2 * run.ahead, self._longest)
        return None if run.count or outcome is Outcome.PAUSED else outcome

    @property
    def _longest(self) -> int:
        return LONGEST_LOOK if self._watch.ends or self._compiled is None else MOST_STEPS

    def _drive(self, state: DriverState, tries: int) -> Outcome:
        self._run.left -= tries
        return self._driver.advance(state, tries, self._memory.times[2:], self._memory.states[2:])

    def _forget(self, state: DriverState) -> None:
        """Take back the steps that have not been reviewed."""
        memory, run = self._memory, self._run
        if memory.waits:
            state.reals[:], state.counts[:], state.y[:] = memory.kept_reals, memory.kept_counts, memory.states[1]
            run.count, run.begin, run.before = 0, 1, 0
            state.fault = None

    def _look(self, state: DriverState, last: int, times: FloatArray, rows: FloatArray) -> Outcome | None:
        """Review steps up to number `last` on arrays; accept them once none is left, or set the run back."""
        memory, run = self._memory, self._run
        if not memory.waits:
            return None
        shift = 1 - run.before
        here = slice(shift, run.count + 2)
        path = memory.times[here].copy(), memory.states[here].copy()
        cut = self._watch.review(*path, run.begin - shift, last + 1 - shift, memory.taken - 1 + shift)
        if cut is not None:
            self._set_back(state, cut, cut.steps - 1 + shift, times, rows)
            return Outcome.PAUSED if cut.late else Outcome.WATCHED
        run.begin, run.starts = last + 1, 0
        self._reviewed = self._memory.reviewed
        return None if memory.waits else self._accept(state, times, rows)

    def _accept(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome | None:
        """Write the reviewed steps as rows, and continue as `event_steps` does; return an outcome or None."""
        memory, run = self._memory, self._run
        self._write_rows(state, run.count, times, rows)
        run.since, run.ahead = run.since + run.count, min(2 * run.ahead, self._longest)
        memory.times[0], memory.states[0] = memory.times[run.count], memory.states[run.count]
        run.before, run.begin, run.count = 1, 1, 0
        return None if run.outcome == Outcome.PAUSED else Outcome(run.outcome)

    def _write_rows(self, state: DriverState, kept: int, times: FloatArray, rows: FloatArray) -> None:
        """Write the first `kept` steps as rows of the run."""
        begun = self._run.rows
        times[begun : begun + kept] = self._memory.times[2 : kept + 2]
        rows[begun : begun + kept] = self._memory.states[2 : kept + 2]
        state.counts[S.ROWS] = begun + kept

    def _set_back(self, state: DriverState, cut: Cut, kept: int, times: FloatArray, rows: FloatArray) -> None:
        """Set the state to a cut after `kept` steps; the next step begins a new smooth piece."""
        memory, run, reals = self._memory, self._run, state.reals
        state.fault = None
        if kept:
            memory.times[kept + 1], memory.states[kept + 1] = cut.t, cut.y
        self._write_rows(state, kept, times, rows)
        floors, share = memory.kept_reals[S.FLOORS :], reals[S.SHARE]
        count = len(state.floors)
        sizes = np.abs(memory.states[2 : kept + 2, :count]).max(axis=0, initial=0.0)
        np.maximum(floors[:count], share * sizes, out=state.floors)
        taken = memory.taken + kept
        state.counts[S.STEPS] = taken
        state.counts[[S.SLOPE_KNOWN, S.AFTER_REJECT, S.KEPT]] = 0
        state.y[:] = cut.y
        reals[S.T], reals[S.PREVIOUS] = cut.t, 1.0
        if self._fixed:
            reals[S.START] = cut.t - taken * reals[S.STEP]
        else:
            interval = max(AHEAD * abs(cut.t - self._watch.changed), CLOSE * abs(cut.t))
            reals[S.H] = math.copysign(min(abs(cut.length), interval), cut.length)
        since = run.since + kept
        run.ahead, run.since = max(1, min(since, LONGEST_LOOK)), 0
        run.count, run.begin, run.before, run.starts = 0, 1, 0, 1
        self._next_left, self._left_to_arrays = 1, 0
        self._watch.set_back(cut)
