"""Options of a run as given, and the tolerances of a driver; `methods/tolerances.py` has the defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from lagrange.errors import StatementError
from lagrange.machine.state import DriverState
from lagrange.procedure.step.constants import LEAST_FLOOR
from lagrange.statement.number import real_number, whole_number
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


MAX_STEPS = 10_000_000
"""Most trial steps of a run, accepted or not; the states of a double pendulum then take 0.4 GB."""


@dataclass(frozen=True, eq=False)
class RunOptions:
    """The options of `lagrange.integrate` as given; None leaves the choice to the method or the scene."""

    method: Any = None
    rtol: float | None = None
    atol: float | None = None
    step: float | None = None
    t_eval: ArrayLike | None = None
    events: Any = None
    max_steps: int | None = None
    max_wall: float | None = None
    max_memory: float | None = None
    parameters: Mapping[Any, Any] | None = None

    @property
    def step_limit(self) -> int:
        """The most trial steps. Raises StatementError if it is not a whole number of at least 1."""
        return MAX_STEPS if self.max_steps is None else whole_number(self.max_steps, "max_steps", 1)

    @property
    def wall_limit(self) -> float | None:
        """The most seconds of the run. Raises StatementError if it is not a positive number."""
        return _positive(self.max_wall, "max_wall", "seconds")

    @property
    def memory_limit(self) -> float | None:
        """The most bytes that the run may keep. Raises StatementError if it is not a positive number."""
        return _positive(self.max_memory, "max_memory", "bytes")


DEFAULT_OPTIONS = RunOptions()
"""Options without any choice of the user."""


def _positive(limit: float | None, name: str, unit: str) -> float | None:
    if limit is None:
        return None
    number = real_number(limit, name)
    if number <= 0:
        raise StatementError(f"{name} = {limit}: give a positive number of {unit}.")
    return number
