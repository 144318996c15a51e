"""The arguments of procedures that take steps, and the records with the state of a run.

The records have the entries of `DriverState` in the same order.
"""

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
    """The counts and flags in the state of a run.

    steps         Number of accepted steps.
    rejected      Number of rejected trial steps.
    evaluations   Number of evaluations of the law, the function that steps evaluate.
    slope_known   1 if the derivative of the state at the start of the next step is known.
    rows          Number of accepted states that are written as rows.
    record        1 if accepted states are written as rows.
    after_reject  Number of rejected trials directly before this one.
    kept          0 if the data of previous steps in memory belong to another run.
    surveyed      Number of times that the run has returned as UNSCALED, for an estimate of sizes.
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
    """Return the type of the law, the function that steps evaluate: from time and state to its results.

    In registers it takes and returns single numbers and a flag of a singular matrix, otherwise arrays.
    """
    results = LAWS[layout.step.law].results * (layout.dimension // 2)
    by_number = Callee((REAL,) * (1 + layout.dimension) + (READ,), (REAL,) * results + (FLAG,))
    return by_number if layout.in_registers else FUNCTION


@dataclass(frozen=True)
class Running:
    """The arguments of a procedure that takes steps of a run.

    law                 The function that a step evaluates, such as the right-hand side.
    parameters          The parameters of the law, and numbers that depend on them alone.
    jacobian            The derivative of the law.
    constants           The parameters of the derivative.
    run, counts         The state of the run.
    floors              The absolute tolerance of each entry of the state, (dimension,).
    effort              The work for one step.
    newtons             The state of Newton's method, for each solution of implicit equations.
    starters            The same for the step that starts a two-step method.
    work                The vectors of the step and the data of its implicit equations; see `Layout`.
    projection          The function that computes corrections onto constraints; None without constraints.
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
