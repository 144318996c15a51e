"""The arguments of procedures that take steps, and the state of a run, in the order of the entries of `DriverState`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.projection import CORRECTIONS
from lagrange.algorithm.step.memory import Effort, Layout, Newton, work_array
from lagrange.procedure.form import FLAG, READ, REAL, Array, Callee
from lagrange.procedure.front.plain import Bundle, Stated
from lagrange.procedure.front.vocabulary import In, Out, form_of, record
from lagrange.program.step import LAWS

FUNCTION = Callee((REAL, READ, READ, Array()), (FLAG,))
"""A function between arrays: from a time, a state and prepared numbers to its results. It returns True if it is
undefined; a law is undefined if a matrix is singular.
"""


@record
class Run:
    """The real numbers in the state of a run; `Counts` has its counts and flags.

    t         Time of the state.
    end       Time at which the run ends.
    h         Length of the next step, signed; 0 if it has to be chosen.
    rtol      Relative tolerance of an entry of the state, in a step.
    share     Fraction of its size to which an accepted step raises the floor of an entry; 0 for floors that the user
              states.
    previous  Error norm of the previous step, for step control.
    start     First time of the grid of equal steps.
    step      Length of equal steps, signed.
    cause     The `Outcome` for which the last trial was rejected.
    longest   Largest length of all steps, without sign.
    residual  Size of the last correction of an implicit step, relative to its unknowns.
    """

    t: float
    end: float
    h: float
    rtol: float
    share: float
    previous: float
    start: float
    step: float
    cause: float
    longest: float
    residual: float


@record
class Counts:
    """The counts and flags of a run.

    steps         Number of accepted steps.
    rejected      Number of rejected trial steps.
    evaluations   Number of evaluations of the law.
    slope_known   1 if the first slope of the next step is known.
    rows          Number of rows that are written.
    record        1 if accepted states are written as rows.
    after_reject  Number of rejected trials directly before this one.
    kept          0 if the data that a driver has stored belong to another run.
    surveyed      Number of times that the run has returned as UNSCALED.
    """

    steps: int
    rejected: int
    evaluations: int
    slope_known: int
    rows: int
    record: int
    after_reject: int
    kept: int
    surveyed: int


RUN, COUNTS = form_of(Run), form_of(Counts)
"""Record types of `Run` and `Counts`, by which machine code lays them out in memory."""


def law_type(layout: Layout) -> Callee:
    """Return the type of the law. In registers it takes and returns numbers, and the flag of a singular matrix."""
    results = LAWS[layout.step.law].results * (layout.dimension // 2)
    by_number = Callee((REAL,) * (1 + layout.dimension) + (READ,), (REAL,) * results + (FLAG,))
    return by_number if layout.in_registers else FUNCTION


@dataclass(frozen=True)
class Running:
    """The arguments of a procedure that takes steps of a run.

    jacobian            The derivative of the law.
    constants           The parameters of the derivative.
    floors              The absolute tolerance of each entry of the state, (dimension,).
    newtons             The records of the solves of the step.
    starters            The records of the solves of the starter.
    work                The vectors of the step and the data of its solves; see `Layout`.
    projection          The corrections of constraints; None without constraints.
    projection_numbers  The parameters of the projection.
    """

    law: Callable[..., Any]
    parameters: In
    jacobian: Callable[..., Any]
    constants: In
    run: Run
    counts: Counts
    floors: Out
    effort: Effort
    newtons: tuple[Newton, ...]
    starters: tuple[Newton, ...]
    work: Out
    projection: Any
    projection_numbers: Any


def running(layout: Layout) -> Bundle:
    """Return the type of a `Running` parameter of a procedure."""
    newton = form_of(Newton)
    starters = len(layout.starting.solves) if layout.step.starter is not None else 0
    types: dict[str, Stated] = {
        "law": law_type(layout),
        "jacobian": FUNCTION,
        "floors": Array(size=layout.dimension, room=layout.block),
        "newtons": (newton,) * len(layout.solves),
        "starters": (newton,) * starters,
        "work": work_array(layout),
        "projection": CORRECTIONS if layout.projected else None,
        "projection_numbers": READ if layout.projected else None,
    }
    return Bundle(Running, types)
