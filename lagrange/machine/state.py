"""The state of a run as a driver advances it, with its counts."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.procedure.blocks import whole_blocks
from lagrange.procedure.outcome import Outcome
from lagrange.procedure.step.run import COUNTS, RUN
from lagrange.procedure.taylor.memory import OUTPUTS, TAYLOR

__all__ = ["MOST_LANES", "OUTCOMES", "DriverState", "Outcome", "Outputs"]

MOST_LANES = 8
"""Most entries of the state that a machine computes at once."""

OUTCOMES = tuple(Outcome)
"""The outcomes by number."""


class Outputs:
    """The states at output times that lie in the order of a run, (k,): a driver of series writes them as it goes.

    `times` has NaN behind the last, and `states` (k + 1, 2n) a row to spare: machines write whole blocks.
    """

    def __init__(self, times: NDArray[np.float64], dimension: int) -> None:
        self.times = np.append(times, math.nan)
        self.states = np.zeros((len(self.times) + MOST_LANES, dimension))
        self.record: Any = OUTPUTS.structure()

    def write(self, end: float, direction: float, path: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        """Write the states at the times before an end, which was reached without series; see `joined` for the path."""
        rest = self.times[self.record.done : -1]
        count = int(np.count_nonzero((rest - end) * direction < 0))
        if count:
            self.states[self.record.done : self.record.done + count] = path(rest[:count]).T
            self.record.done += count

    def joined(
        self, times: NDArray[np.float64], path: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """Return the states (2n, k) at the first k times, the others by a path from times (k,) to states (2n, k)."""
        done, count = self.record.done, len(times)
        if done < count:
            self.states[done:count] = path(times[done:]).T
        return self.states[:count].T


NO_OUTPUTS = Outputs(np.empty(0), 1)
"""Those of a run that has none; what drivers write to the record is zero."""


class DriverState:
    """Where a run stands. Arrays are shared with machine code, entries in the order of the constants below.

    `reals`: T is the time, END where the run goes, START and STEP the grid of equal steps; H is the next step,
    signed, 0 if it is to be chosen, and LONGEST the bound of all steps, a size; PREVIOUS is the error norm of the step
    before, and CAUSE the `Outcome` for which the last trial was rejected. RESIDUAL is the size of the last correction
    of an implicit step against that of its unknowns.

    An entry of the state may be wrong by RTOL times its size in a step and its floor. The floors (2n,), padded to
    whole vectors of a machine, are the last `reals`. An accepted step raises a floor to SHARE times the size of its
    entry there: floors that are given stay as they are with a SHARE of 0, and those that follow the scale begin at
    `LEAST_FLOOR`.

    `counts`: STEPS accepted, REJECTED trials, EVALUATIONS of the law, and ROWS written, none unless RECORD is 1.
    AFTER_REJECT counts the rejected trials in a row behind which the run stands; SLOPE_KNOWN is 1 where the first slope
    of the next step is there already. KEPT is 0 where nothing that a driver has kept from former steps, such as a
    matrix or unknowns to extrapolate, belongs to this run. SURVEYED is how often the run came back as UNSCALED.

    `taylor` is what a run by Taylor series knows; see `TAYLOR`. Such a run writes `outputs` on the way.

    `floats` and `integers` are the same entries, to be set one by one: that takes a fifth of the time. `fault` is
    what a driver that is no machine code has to say of its failed step, and `kept` how many bytes it keeps of the run.
    """

    T, END, H, RTOL, SHARE, PREVIOUS, START, STEP, CAUSE, LONGEST, RESIDUAL = RUN.places.values()
    FLOORS = len(RUN.fields)
    STEPS, REJECTED, EVALUATIONS, SLOPE_KNOWN, ROWS, RECORD, AFTER_REJECT, KEPT, SURVEYED = COUNTS.places.values()

    def __init__(
        self,
        t: float,
        end: float,
        y: NDArray[np.float64],
        rtol: float,
        atol: float,
        step: float,
        share: float = 0.0,
    ) -> None:
        """Begin at (t, y) towards `end`; `step` is the signed step of a fixed-step method, or a first step, or 0.

        `atol` is the floor of every entry to begin with.
        """
        self.reals = np.zeros(self.FLOORS + whole_blocks(len(y), MOST_LANES))
        self.reals[self.FLOORS :] = 1.0
        self.floors = self.reals[self.FLOORS : self.FLOORS + len(y)]
        self.floors[:] = atol
        self.counts = np.zeros(len(COUNTS.fields), dtype=np.int64)
        self.y = np.array(y, dtype=float)
        floats: Any = self.reals.data
        integers: Any = self.counts.data
        self.floats, self.integers = floats, integers
        floats[self.T] = floats[self.START] = t
        floats[self.END] = end
        floats[self.H] = floats[self.STEP] = step
        floats[self.RTOL] = rtol
        floats[self.SHARE] = share
        floats[self.PREVIOUS] = 1.0
        floats[self.CAUSE] = Outcome.STEP_TOO_SMALL
        floats[self.LONGEST] = math.inf
        integers[self.RECORD] = 1
        self.taylor: Any = TAYLOR.structure(scale=1.0, next_limit=math.inf, limit=math.inf)
        self.outputs = NO_OUTPUTS
        self.fault: Any = None
        self.kept = 0

    def restart(
        self,
        first: NDArray[np.float64],
        span: tuple[float, float],
        y: NDArray[np.float64],
        step: float,
        longest: float,
    ) -> None:
        """Begin another run by the same driver, over a span from y; `first` are the `reals` with which one began."""
        reals, floats = self.reals, self.floats
        reals[:] = first
        floats[self.T], floats[self.END] = span
        floats[self.START] = span[0]
        floats[self.H] = floats[self.STEP] = step
        floats[self.LONGEST] = longest
        self.counts.fill(0)
        self.y[:] = y
        self.fault, self.kept = None, 0

    def restart_series(self) -> None:
        """Forget what a former run by series has left, where something looks at it before the driver begins."""
        taylor = self.taylor
        taylor.low, taylor.scale, taylor.next_limit, taylor.limit = 0.0, 1.0, math.inf, math.inf
        taylor.rescalings = taylor.failures = taylor.inspect = 0

    @property
    def t(self) -> float:
        """The time reached."""
        return float(self.floats[self.T])

    @property
    def cause(self) -> Outcome:
        """What made the last step fail: an error too large counts as STEP_TOO_SMALL."""
        return Outcome(int(self.reals[self.CAUSE]))

    def count(self, which: int) -> int:
        """Return one of the counts."""
        return int(self.integers[which])
