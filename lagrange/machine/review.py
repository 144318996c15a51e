"""What a machine that reviews many steps at once for events is told, and gives."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class WatchedEvents(NamedTuple):
    """What a review knows of events (E,), and changes: the side of zero on which each stands, and if it is near zero.

    `direction` says which zeros count, 0 for all, and `remaining` how many of them until the motion changes, 0 or below
    for never. The motion `starts` with the first step, where an event may have `stayed` at zero to a size.
    """

    sign: NDArray[np.int64]
    near: NDArray[np.int64]
    direction: NDArray[np.int64]
    remaining: NDArray[np.int64]
    stayed: FloatArray
    starts: bool


class Reviewed(NamedTuple):
    """The `step` in front of which a review ended, and zeros on those before: event, step, time and state (k, 2n)."""

    step: int
    which: NDArray[np.int64]
    where: NDArray[np.int64]
    when: FloatArray
    there: FloatArray


class Review(Protocol):
    """Finds the zeros of events on steps whose dense output is known."""

    def __call__(
        self, times: FloatArray, states: FloatArray, begin: int, events: WatchedEvents, *, last: int, rounded: float
    ) -> Reviewed:
        """Go through steps, times (S+1,) and states (S+1, 2n), from one on up to the end or to what is irregular.

        That is a zero that changes the motion, an event that has no value or starts at zero, and one that no polynomial
        on the whole step is close to. No step follows the `last` one, -1 for none, at which steps have `rounded` the
        events by so many times their noise.
        """
