"""The state of a run: the entries of `DriverState`, in its order, as records of the procedures."""

from __future__ import annotations

from lagrange.procedure.form import REAL, WHOLE, Record

RUN = Record.of(
    "Run",
    t=REAL,
    end=REAL,
    h=REAL,
    rtol=REAL,
    share=REAL,
    previous=REAL,
    start=REAL,
    step=REAL,
    cause=REAL,
    longest=REAL,
    residual=REAL,
)
"""The real numbers of a run."""

COUNTS = Record.of(
    "Counts",
    steps=WHOLE,
    rejected=WHOLE,
    evaluations=WHOLE,
    slope_known=WHOLE,
    rows=WHOLE,
    record=WHOLE,
    after_reject=WHOLE,
    kept=WHOLE,
    surveyed=WHOLE,
)
"""The counts and flags of a run."""
