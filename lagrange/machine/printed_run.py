"""Procedures printed as Python: functions to call, and the loop over steps that the drivers share."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.machine.backend import FloatArray
from lagrange.machine.python_source import loaded
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.form import Procedure

EMPTY = memoryview(array("d"))
"""Placeholder for an array that is not used."""

Records = tuple[Any, Any]
Recorded = tuple[memoryview, memoryview]


def advance(
    state: DriverState,
    work: FloatArray,
    times: FloatArray,
    rows: FloatArray,
    steps: Callable[[Records, Recorded], int],
) -> Outcome:
    """Take steps from the state, and set it to their end.

    During the steps the state is the first part of `work`. `steps` is called with the records of the run and with the
    arrays for accepted times and states.
    """
    y = work[: len(state.y)]
    y[:] = state.y
    records = RUN.structure.from_buffer(state.floats), COUNTS.structure.from_buffer(state.integers)
    recorded = (times.data, rows.reshape(-1).data) if state.count(DriverState.RECORD) else (EMPTY, EMPTY)
    try:
        with np.errstate(all="ignore"):
            return Outcome(steps(records, recorded))
    finally:
        state.y[:] = y


@cache
def called(procedure: Procedure) -> Callable[..., Any]:
    """Return a procedure, printed as Python, as a function of numbers and NumPy's arrays."""
    made = loaded(procedure)

    def run(*args: Any) -> Any:
        return made(*[arg.data if isinstance(arg, np.ndarray) else arg for arg in args])

    return run
