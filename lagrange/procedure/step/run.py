"""Where a run stands: the entries of `DriverState`, in its order, as records that procedures read and write."""

from __future__ import annotations

from lagrange.procedure.form import REAL, WHOLE, Record

RUN = Record(
    "Run",
    tuple(
        (name, REAL)
        for name in ("t", "end", "h", "rtol", "share", "previous", "start", "step", "cause", "longest", "residual")
    ),
)
"""The real numbers of a run."""

COUNTS = Record(
    "Counts",
    tuple(
        (name, WHOLE)
        for name in (
            *("steps", "rejected", "evaluations", "slope_known", "rows", "record", "after_reject"),
            *("kept", "surveyed"),
        )
    ),
)
"""What a run counts, and its flags."""
