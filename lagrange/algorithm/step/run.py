"""The state of a run: the entries of `DriverState`, in its order, as records of the procedures."""

from __future__ import annotations

from lagrange.procedure.front.vocabulary import form_of, record


@record
class Run:
    """The real numbers of a run."""

    t: float
    """Time of the state."""

    end: float
    """Time at which the run ends."""

    h: float
    """Length of the next step, signed; 0 if it is to be chosen."""

    rtol: float
    """Relative tolerance of an entry of the state in a step."""

    share: float
    """Share of its size to which an accepted step raises the floor of an entry; 0 if floors are stated."""

    previous: float
    """Error norm of the step before."""

    start: float
    """First time of the grid of equal steps."""

    step: float
    """Length of equal steps, signed."""

    cause: float
    """The `Outcome` for which the last trial was rejected."""

    longest: float
    """Bound on the length of all steps, a size."""

    residual: float
    """Size of the last correction of an implicit step relative to its unknowns."""


@record
class Counts:
    """The counts and flags of a run."""

    steps: int
    """Accepted steps."""

    rejected: int
    """Rejected trials."""

    evaluations: int
    """Evaluations of the law."""

    slope_known: int
    """1 if the first slope of the next step is known."""

    rows: int
    """Rows that are written."""

    record: int
    """1 if accepted states are written as rows."""

    after_reject: int
    """Rejected trials in a row before this one."""

    kept: int
    """0 if nothing that a driver has kept from former steps belongs to this run."""

    surveyed: int
    """Number of times that the run has returned as UNSCALED."""


RUN, COUNTS = form_of(Run), form_of(Counts)
"""The records in memory."""
