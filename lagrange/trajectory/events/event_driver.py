"""Advance a run with events by steps of a step program: take steps, search them for events, and return to an event.

Steps are taken first, and then searched for events. If an event on them resets the state or ends the run, the run is
set back to this event, and later steps are discarded. In long runs machine code handles all regular events. Other steps
are searched on arrays, by `StepWatch`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lagrange.algorithm.events.constants import FIRST_REVIEW, MOST_BETWEEN_REVIEWS
from lagrange.algorithm.events.loop import GO_ON, MOST_WAITING, NEEDS_REVIEW, READ_EVENTS, PendingSteps
from lagrange.machine.backend import Driver
from lagrange.machine.state import DriverState, EventSteps, Outcome
from lagrange.trajectory.events.step_watch import Cut, StepWatch
from lagrange.trajectory.trajectory import FloatArray

S = DriverState


class EventDriver:
    """Advances a run like the driver of its steps, but only up to an event that resets the state or ends the run."""

    def __init__(self, driver: Driver, watch: StepWatch) -> None:
        self._driver, self._watch = driver, watch
        self._memory, self._run = watch.shared, watch.shared.run
        self._run.ahead = FIRST_REVIEW if watch.resets else MOST_BETWEEN_REVIEWS
        self._run.fixed = int(watch.fixed)
        self._compiled: EventSteps | None = None
        self._next_left, self._left_to_arrays, self._reviewed = 1, 0, 0
        self._first = self._stale = True

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run by at most `budget` steps, and write accepted times to `times` (k,), states to `rows` (k, 2n).

        The outcome is WATCHED if the run stopped at an event that resets the state or ends the run.
        """
        run = self._run
        run.budget = run.left = budget
        self._memory.keep(state)
        try:
            while True:
                few = self._watch.ends or self._compiled is None
                run.longest = MOST_BETWEEN_REVIEWS if few else MOST_WAITING
                compiled = self._compiled is not None and not self._left_to_arrays and self._watch.regular
                outcome = (self._in_loop if compiled else self._on_arrays)(state, times, rows)
                if outcome is not None:
                    return outcome
        except KeyboardInterrupt:
            self._watch.collect()
            if self._memory.waits:
                # Discard the steps not yet searched for events.
                self._restore(state)
                run.count, run.begin, run.before = 0, 1, 0
                state.fault = None
            raise
        finally:
            self._first = False

    def _in_loop(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome | None:
        """Advance the run by machine code. Return an outcome, or None after a step that must be searched on arrays.

        Accepted times and states are written to `times` (k,) and `rows` (k, 2n), where k is the capacity.
        """
        if self._compiled is None:
            raise AssertionError("the loop has no machine code")
        if self._stale:
            self._watch.write()
        code = self._compiled(state, self._memory, times, rows)
        self._watch.read()
        self._stale = code in (NEEDS_REVIEW, Outcome.WATCHED)
        if code == READ_EVENTS:
            return None
        if code != NEEDS_REVIEW:
            return Outcome(code)
        if self._memory.reviewed > self._reviewed:
            self._next_left = 1
        self._leave_to_arrays()
        return None

    def _leave_to_arrays(self) -> None:
        """Set the number of next steps to search on arrays, not by machine code: 1 at first, then doubled each time."""
        self._left_to_arrays, self._next_left = self._next_left, min(2 * self._next_left, MOST_BETWEEN_REVIEWS)

    def _on_arrays(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome | None:
        """Take steps if all earlier ones are searched, and search some steps for events on NumPy arrays.

        Return an outcome, or None to continue. Accepted states are written to `times` (k,) and `rows` (k, 2n).
        """
        memory, run, pending = self._memory, self._run, self._pending_steps(state, times, rows)
        if not memory.waits:
            if run.starts and self._is_compiled(state.t, state.count(S.STEPS)):
                return None
            code = pending.take()
            if code != GO_ON:
                return Outcome(code)
            if self._first and self._is_compiled(memory.times[run.count + 1], memory.taken + run.count):
                return None
        if self._compiled is not None and not self._left_to_arrays and memory.waits:
            self._leave_to_arrays()
        count = run.count - run.begin + 1
        count = min(count, self._left_to_arrays) if self._compiled is not None else count
        self._left_to_arrays = max(0, self._left_to_arrays - count)
        return self._review(state, run.begin + count - 1, pending)

    def _is_compiled(self, t: float, steps: int) -> bool:
        """Return True if this call compiled the loop over steps with events. It does so if that saves time.

        This is decided only in the first call and at the start of a smooth piece of motion. In other calls the number
        of steps depends on the computing time, on which the digits of events must not depend.
        """
        if self._compiled is None:
            watch, driver = self._watch, self._driver
            self._compiled = watch.memory.compiled(
                watch.problem, driver, float(t), steps, watch.jumps, fixed=watch.fixed
            )
            return self._compiled is not None
        return False

    def _pending_steps(self, state: DriverState, times: FloatArray, rows: FloatArray) -> PendingSteps:
        """Return the steps not yet searched for events, the driver, and the arrays for accepted steps, as one object.

        The procedures of the event loop take this object. The arrays are `times` (k,) and `rows` (k, 2n).
        """
        memory, size = self._memory, len(state.y)

        def drive(*arguments: Any) -> Outcome:
            try:
                return self._driver.advance(state, arguments[4], memory.times[2:], memory.states[2:])
            except KeyboardInterrupt:
                self._restore(state)
                raise

        steps = self._run, size, memory.times, memory.states.reshape(-1), drive, state.counts
        numbers = state.floats, state.integers, memory.kept_reals, memory.kept_counts
        arguments: Any = *steps, *numbers, state.y, np.arange(size), state.y, times, rows.reshape(-1)
        return PendingSteps(*arguments)

    def _restore(self, state: DriverState) -> None:
        """Set the driver state back to the time before the steps not yet searched for events."""
        memory = self._memory
        state.reals[:], state.counts[:], state.y[:] = memory.kept_reals, memory.kept_counts, memory.states[1]

    def _review(self, state: DriverState, last: int, pending: PendingSteps) -> Outcome | None:
        """Search the steps up to number `last` for events, on arrays. Return an outcome, or None to continue.

        When all steps are searched, they are accepted. If an event resets the state or ends the run, the run is set
        back to this event. `pending` has the steps.
        """
        memory, run = self._memory, self._run
        if not memory.waits:
            return None
        shift = 1 - run.before
        rows = slice(shift, run.count + 2)
        path = memory.times[rows].copy(), memory.states[rows].copy()
        cut = self._watch.review(*path, run.begin - shift, last + 1 - shift, memory.taken - 1 + shift)
        if cut is not None:
            self._set_back(state, cut, cut.steps - 1 + shift, pending)
            return Outcome.PAUSED if cut.late else Outcome.WATCHED
        run.begin, run.starts = last + 1, 0
        self._reviewed = self._memory.reviewed
        if memory.waits:
            return None
        code = pending.accept()
        return None if code == GO_ON else Outcome(code)

    def _set_back(self, state: DriverState, cut: Cut, steps: int, pending: PendingSteps) -> None:
        """Set the driver state back to the point `cut`, where the next smooth piece of motion begins.

        `pending` has the steps not yet accepted. Its first `steps` steps are kept, and later ones are discarded.
        """
        memory, run, count = self._memory, self._run, len(state.floors)
        state.fault = None
        run.changed = self._watch.changed
        pending.go_back(steps, cut.t, cut.y, cut.length)
        sizes = np.abs(memory.states[2 : steps + 2, :count]).max(axis=0, initial=0.0)
        np.maximum(memory.kept_reals[S.FLOORS :][:count], state.reals[S.SHARE] * sizes, out=state.floors)
        run.starts, self._next_left, self._left_to_arrays = 1, 1, 0
        self._watch.whole = cut.whole
