"""Tolerances and step lengths of a driver."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lagrange.machine.state import DriverState
from lagrange.procedure.step.constants import LEAST_FLOOR
from lagrange.trajectory.trajectory import FloatArray

FLOOR_SHARE = 1e-3
"""Without an absolute tolerance, that of an entry is RTOL times this share of its largest size in the run.

It is added to RTOL times the present size. So each entry has its own scale, and the same motion in other units has the
same steps. A share of 1 would lose three digits of a comet that comes a thousand times nearer to the sun; a share of 0
would follow entries that have decayed to round-off. For sizes near 1 the default is an absolute tolerance of 1e-12.
"""

LEAST_SHARE = 2.0**-52
"""The absolute tolerance that follows the scale is at least the spacing of doubles at the largest size."""


LEAST_ATOL = 1e-300
"""Replaces an absolute tolerance of zero, so that a coordinate that is exactly zero has a finite error ratio."""


@dataclass(frozen=True)
class Tolerances:
    """Tolerances and step lengths of a driver, and notes for the user.

    These are the relative and absolute tolerance and the longest step, or the size of equal steps. With a `share` the
    absolute tolerance of an entry is at least that share of its largest size so far: it follows the scale, and `atol`
    is its first value. A driver uses `margin` times the tolerances.
    """

    rtol: float = 0.0
    atol: float = 0.0
    share: float = 0.0
    step: float = 0.0
    longest: float = math.inf
    margin: float = 1.0
    notes: tuple[str, ...] = ()

    def begin(self, t0: float, t1: float, y0: FloatArray) -> DriverState:
        """Return the state of a run from (t0, y0) towards t1."""
        h = self.step if t1 >= t0 else -self.step
        aim = self.margin
        floor = max(aim * self.atol, LEAST_FLOOR)
        state = DriverState(t0, t1, y0, aim * self.rtol, floor, h, aim * self.share)
        state.reals[DriverState.LONGEST] = self.longest
        return state
