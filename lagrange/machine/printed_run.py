"""A run by a loop over steps that is printed as Python: what the drivers of the numpy machine share."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.step.run import COUNTS, RUN

NOTHING = memoryview(array("d"))
"""The place of an array that is not used."""

Records = tuple[Any, Any]
Recorded = tuple[memoryview, memoryview]


def advance(
    state: DriverState,
    work: FloatArray,
    times: FloatArray,
    rows: FloatArray,
    steps: Callable[[Records, Recorded], int],
) -> Outcome:
    """Take steps from the state, which stands first in the work array meanwhile, and leave it where they end.

    `steps` is called with the records of the run and with the arrays that accepted steps are written to.
    """
    y = work[: len(state.y)]
    y[:] = state.y
    records = RUN.structure.from_buffer(state.floats), COUNTS.structure.from_buffer(state.integers)
    recorded = (times.data, rows.reshape(-1).data) if state.count(DriverState.RECORD) else (NOTHING, NOTHING)
    try:
        with np.errstate(all="ignore"):
            return Outcome(steps(records, recorded))
    finally:
        state.y[:] = y
