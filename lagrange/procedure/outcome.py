"""How a run, a step or a solve ends."""

from __future__ import annotations

import enum


class Outcome(enum.IntEnum):
    """Why a driver came back; BROKEN says that `DriverState.fault` knows."""

    DONE = 0
    PAUSED = 1
    NON_FINITE = 2
    SINGULAR = 3
    STEP_TOO_SMALL = 4
    WATCHED = 5
    DIVERGED = 6
    BROKEN = 7
