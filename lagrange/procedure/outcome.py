"""How a run, a step or a solve ends."""

from __future__ import annotations

import enum


class Outcome(enum.IntEnum):
    """Why a driver came back; BROKEN says that `DriverState.fault` knows.

    UNSCALED asks for a look at how large the entries of the state are: steps shrink, and floors that are too low, of
    entries of which nothing is known or which are round-off, would shrink them to nothing. The run goes on as it is.
    """

    DONE = 0
    PAUSED = 1
    NON_FINITE = 2
    SINGULAR = 3
    STEP_TOO_SMALL = 4
    WATCHED = 5
    DIVERGED = 6
    BROKEN = 7
    UNSCALED = 8
