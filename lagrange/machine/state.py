"""The record that a driver advances: where a run stands, and what it counts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.procedure.outcome import Outcome

__all__ = ["EARLIEST", "NEAR_END", "OUTCOMES", "SPACING", "DriverState", "Outcome"]

NEAR_END = 1.01
"""A step within one percent of the end goes to the end, so that no sliver is left over."""

SPACING, EARLIEST = 16 * 2.0**-52, 1e-290
"""A step shorter than the first part of the time is lost in the round-off of the time; a time nearer to zero counts as
the second, for at zero nothing is lost."""


OUTCOMES = tuple(Outcome)
"""The outcomes by number."""


class DriverState:
    """Where a run stands. Arrays are shared with machine code, entries in the order of the constants below.

    `reals`: T is the time, END where the run goes, START and STEP the grid of equal steps; H is the next step,
    signed, 0 if it is to be chosen, LONGEST the bound of all steps and ONCE of the next alone, sizes; PREVIOUS is
    the error norm of the step before, and CAUSE the `Outcome` for which the last trial was rejected. RESIDUAL is
    the size of the last correction of an implicit step against that of its unknowns. Of a series, LOW is what
    rounding took from the time, SCALE the unit of time, signed, and LIMIT the longest step after FAILS steps in a
    row that were not what the equations say at their end.

    `counts`: STEPS accepted, REJECTED trials, EVALUATIONS of the law, and ROWS written, none unless RECORD is 1.
    AFTER_REJECT is 1 behind a rejected trial, SLOPE_KNOWN where the first slope of the next step is there already,
    LOOK where the next step is to be looked at whatever it shows; TRIES is how often the series of a step was
    computed anew in another unit of time. KEPT is 0 where nothing that a driver has kept from former steps, such as
    a matrix or unknowns to extrapolate, belongs to this run.

    `floats` and `integers` are the same entries, to be set one by one: that takes a fifth of the time. `fault` is
    what a driver that is no machine code has to say of its failed step, and `kept` how many bytes it keeps of the run.
    """

    T, END, H, RTOL, ATOL, PREVIOUS, START, STEP, CAUSE, LONGEST, LOW, SCALE, ONCE, RESIDUAL, LIMIT = range(15)
    STEPS, REJECTED, EVALUATIONS, SLOPE_KNOWN, ROWS, RECORD, AFTER_REJECT, TRIES, LOOK, KEPT, FAILS = range(11)

    def __init__(self, t: float, end: float, y: NDArray[np.float64], rtol: float, atol: float, step: float) -> None:
        """Begin at (t, y) towards `end`; `step` is the signed step of a fixed-step method, or a first step, or 0."""
        self.reals = np.zeros(self.LIMIT + 1)
        self.counts = np.zeros(self.FAILS + 1, dtype=np.int64)
        self.y = np.array(y, dtype=float)
        floats: Any = self.reals.data
        integers: Any = self.counts.data
        self.floats, self.integers = floats, integers
        floats[self.T] = floats[self.START] = t
        floats[self.END] = end
        floats[self.H] = floats[self.STEP] = step
        floats[self.RTOL] = rtol
        floats[self.ATOL] = atol
        floats[self.PREVIOUS] = floats[self.SCALE] = 1.0
        floats[self.CAUSE] = Outcome.STEP_TOO_SMALL
        floats[self.LONGEST] = floats[self.ONCE] = floats[self.LIMIT] = math.inf
        integers[self.RECORD] = 1
        self.fault: Any = None
        self.kept = 0
        self.addresses = (self.reals.ctypes.data, self.counts.ctypes.data)

    @property
    def t(self) -> float:
        """The time reached."""
        return float(self.reals[self.T])

    @property
    def cause(self) -> Outcome:
        """What made the last step fail: an error too large counts as STEP_TOO_SMALL."""
        return Outcome(int(self.reals[self.CAUSE]))

    def count(self, which: int) -> int:
        """Return one of the counts."""
        return int(self.counts[which])
