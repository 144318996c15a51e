"""The driver of a step program with events: its steps are looked at behind it, and taken back beyond a change."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lagrange.machine.backend import Driver
from lagrange.machine.state import DriverState, Outcome
from lagrange.trajectory.trajectory import FloatArray

S = DriverState

LONGEST_LOOK = 256
"""Steps between two looks on arrays, at most: enough to hide what a look costs, few enough for small arrays."""

UNBOUNDED = 2**62
"""Steps between two looks where none is taken in vain, and a look costs little: as many as memory and time allow."""

FIRST_LOOK = 4
"""Steps up to the first look where an event resets the state: what is taken beyond it is taken in vain."""

AHEAD = 2.0
"""After a reset an adaptive method starts with this part of the time since the last: flights come in like lengths."""

CLOSE = 256 * 2.0**-52
"""But with no less than this part of the time: below, it is for the events to say that time stands still."""


@dataclass(frozen=True, eq=False)
class Cut:
    """Where a burst is set back to: so many of its steps are kept, the last of them up to a time and a state.

    `length` is that of the step in which it is, or before which; `whole` is the end of a step that is cut within.
    """

    steps: int
    t: float
    y: FloatArray
    length: float
    whole: tuple[float, FloatArray] | None = None


class Reviewer(Protocol):
    """What looks at accepted steps."""

    @property
    def resets(self) -> bool:
        """Whether the motion goes on otherwise behind an event."""

    @property
    def longest(self) -> int:
        """How many steps may be taken between two looks."""

    @property
    def changed(self) -> float:
        """When the motion began, or changed last."""

    def review(self, times: FloatArray, states: FloatArray, taken: int) -> Cut | None:
        """Look at steps, times (S+1,) and states (S+1, 2n); return the first change of the motion."""

    def set_back(self, cut: Cut) -> None:
        """Note that the run was set back."""


class EventDriver:
    """Advances a run as the driver of its steps does, up to the next change of the motion."""

    def __init__(self, driver: Driver, watch: Reviewer, *, fixed: bool) -> None:
        self._driver, self._watch, self._fixed = driver, watch, fixed
        self._ahead = FIRST_LOOK if watch.resets else LONGEST_LOOK
        self._since = 0

    def adopt(self, state: DriverState) -> None:
        """Leave the state where it is; see `Driver`."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`. WATCHED says that the state stands at a change of the motion."""
        outcome, left = Outcome.PAUSED, budget
        while outcome is Outcome.PAUSED and left > 0:
            if state.t == state.reals[S.END]:
                return Outcome.DONE
            tries = min(self._ahead, left)
            left -= tries
            reals, counts, y = state.reals.copy(), state.counts.copy(), state.y.copy()
            try:
                outcome = self._driver.advance(state, tries, times, rows)
                begun, taken = int(counts[S.ROWS]), int(counts[S.STEPS])
                cut = self._review(state, begun, taken, (float(reals[S.T]), y), times, rows)
            except KeyboardInterrupt:
                # What has not been looked at has not happened.
                state.reals[:], state.counts[:], state.y[:] = reals, counts, y
                state.fault = None
                raise
            if cut is not None:
                _lower(state, reals[S.FLOORS :], rows[begun : state.count(S.ROWS)])
                return Outcome.WATCHED
            longest = self._watch.longest
            self._ahead = longest if longest == UNBOUNDED else min(2 * self._ahead, longest)
        return outcome

    def _review(
        self,
        state: DriverState,
        begun: int,
        taken: int,
        start: tuple[float, FloatArray],
        times: FloatArray,
        rows: FloatArray,
    ) -> Cut | None:
        """Look at the steps since a start; set the state back to the first change of the motion, if there is one."""
        t, y = start
        count = state.count(S.ROWS) - begun
        if not count:
            return None
        here = slice(begun, begun + count)
        cut = self._watch.review(np.concatenate([[t], times[here]]), np.concatenate([y[None], rows[here]]), taken)
        self._since += count if cut is None else cut.steps
        if cut is not None:
            self._set_back(state, cut, begun, taken, times, rows)
            self._ahead, self._since = max(1, min(self._since, LONGEST_LOOK)), 0
        return cut

    def _set_back(
        self, state: DriverState, cut: Cut, begun: int, taken: int, times: FloatArray, rows: FloatArray
    ) -> None:
        """Let the state stand at a cut, and the next step begin a motion of its own."""
        reals = state.reals
        state.fault = None
        if cut.steps:
            times[begun + cut.steps - 1], rows[begun + cut.steps - 1] = cut.t, cut.y
        state.counts[S.ROWS], state.counts[S.STEPS] = begun + cut.steps, taken + cut.steps
        state.counts[[S.SLOPE_KNOWN, S.AFTER_REJECT, S.KEPT]] = 0
        state.y[:] = cut.y
        reals[S.T], reals[S.PREVIOUS] = cut.t, 1.0
        if self._fixed:
            reals[S.START] = cut.t - (taken + cut.steps) * reals[S.STEP]
        else:
            flight = max(AHEAD * abs(cut.t - self._watch.changed), CLOSE * abs(cut.t))
            reals[S.H] = math.copysign(min(abs(cut.length), flight), cut.length)
        self._watch.set_back(cut)


def _lower(state: DriverState, floors: FloatArray, rows: FloatArray) -> None:
    """Let the floors be those from before some steps, raised by the rows (k, 2n) that are left of these."""
    count = len(state.floors)
    sizes = np.abs(rows[:, :count]).max(axis=0, initial=0.0)
    np.maximum(floors[:count], state.reals[S.SHARE] * sizes, out=state.floors)
