"""Outcomes of a run, of a step, or of a solve."""

from __future__ import annotations

import enum


class Outcome(enum.IntEnum):
    """Reason for which a run, a step, or the solution of a step's equations ended.

    After BROKEN, `DriverState.fault` has the error. UNPROJECTED: the new state was too far from the constraints
    to be projected onto them. UNSCALED asks the caller to estimate the sizes of the state's entries: steps
    become shorter because the absolute tolerances of some entries, of unknown size or at rounding level, are
    too low. The run can then be continued.
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
    UNPROJECTED = 9
