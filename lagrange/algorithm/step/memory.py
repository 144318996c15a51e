"""Memory of a step of any method but Taylor series: its vectors in one array, and the state of a run.

A machine that computes on blocks of numbers pads each vector to whole blocks. On other machines a block is one number.
The law of a step is the function that it evaluates, such as the right-hand side. A solve is one solution of implicit
equations by Newton's method; its data are in the same array.

The records with the state of a run have the entries of `DriverState` in the same order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.constants import whole_blocks
from lagrange.algorithm.linear.gauss_jordan import row_stride
from lagrange.algorithm.projection import CORRECTIONS
from lagrange.procedure.form import FLAG, READ, REAL, Array, Callee
from lagrange.procedure.front.decorators import Bundle, Stated
from lagrange.procedure.front.vocabulary import In, Out, form_of, record
from lagrange.program.step import LAWS, Damp, Solve, StepProgram

ORDERS = (1, 3, 6, 12)
"""Numbers of past steps from which the unknowns of fixed steps may be extrapolated. The number whose guess had the
least error is used: 12 for steps that are short compared with the motion, few for long steps and for unknowns at
rounding level.
"""

HISTORY = ORDERS[-1]
"""Number of past steps whose unknowns are stored."""


@record
class Effort:
    """Record of the work for one step.

    evaluations  Number of evaluations of the law, the function that the step evaluates.
    residual     Size of the last correction in Newton's method, relative to the unknowns.
    """

    evaluations: int
    residual: float


@record
class Newton:
    """State of Newton's method for one system of implicit equations, kept from step to step.

    matrix_step     Length of the steps for which its matrix was built; 0 if the next step builds a new one.
    differentiated  1 if the stored derivative of the law is valid for the next matrix.
    rate            Contraction rate of the corrections.
    noise           Size of corrections at rounding level, in units of the estimated rounding.
    age             Number of steps since the matrix was built.
    solved          1 if the unknowns of the trial step are computed.
    tried_step      Length of the trial step.
    old_step        Length of the previous step.
    known           Number of previous steps from which the unknowns can be extrapolated.
    order           Number of these steps from which the next guess is extrapolated, one of `ORDERS`.
    """

    matrix_step: float
    differentiated: int
    rate: float
    noise: float
    age: int
    solved: int
    tried_step: float
    old_step: float
    known: int
    order: int


EFFORT, NEWTON = form_of(Effort), form_of(Newton)
"""Record types of `Effort` and `Newton`, by which machine code lays them out in memory."""


def work_array(layout: Layout) -> Array:
    """Return the type of a step's work array: its vectors and the data of its implicit equations."""
    return Array(size=layout.size, room=layout.block)


class Layout:
    """Memory layout of a step: offsets of its vectors and of the data of its implicit equations.

    `block` numbers are computed at once. A step is `alone` if it is not the starting step of a two-step method.
    Arguments and results of the law (the function that the step evaluates) are single numbers if `in_registers`,
    else arrays. With `projected` the new state is moved onto the constraints before it is accepted.
    """

    def __init__(
        self,
        step: StepProgram,
        dimension: int,
        *,
        block: int,
        in_registers: bool = False,
        alone: bool = True,
        projected: bool = False,
    ) -> None:
        self.step, self.dimension, self.block, self.in_registers = step, dimension, block, in_registers
        self.projected = projected
        self.procedure_name = "" if alone else "starter"
        self.length = dimension // 2 if step.states == 2 else dimension
        law = LAWS[step.law]
        self.rows, self.columns = law.results * self.length, law.arguments * self.length
        """The shape of the derivative of the law: by results, and by arguments."""
        self.width = whole_blocks(self.length, block)
        self.keeps_history = bool(step.solves) or step.starter is not None
        """True if steps use data of previous steps: data of a solve, or the state one step before."""
        self.keeps_entries = in_registers and alone and not self.keeps_history
        """True if the state is also passed as single numbers, which LLVM keeps in registers."""
        self.vectors = step.vectors
        self.new = self.vectors
        self.errors = self.new + step.states
        self.argument = (self.errors + len(step.errors)) * self.width
        self.result = self.argument + max(2 * dimension, self.columns) + 2 * block
        self.flags = whole_blocks(self.result + max(2 * dimension, self.rows) + 2 * block, block)
        """Offset of two flags of two-step methods. The first is true if the state one step before is known, the second
        if the trial step provides it.
        """
        self.effort = self.flags + 2
        end = whole_blocks(self.effort + len(EFFORT.fields), block)
        self.solves: list[SolveLayout] = []
        for i, solve in enumerate(step.solves):
            damped = [damp for damp in step.damps if damp.of == i]
            self.solves.append(SolveLayout(self, end, i, solve, damped))
            end = self.solves[-1].end
        self.lost = end
        """Offset of the rounding errors of the state vectors before the trial step; those after it follow."""
        self.end = end + (2 * step.states * self.width if step.exact else 0)
        """Offset of the vectors of the step that starts a two-step method, if there is one."""
        self.starting: Layout = self
        self.size = self.end
        if step.starter is not None:
            self.starting = Layout(
                step.starter, dimension, block=block, in_registers=in_registers, alone=False, projected=projected
            )
            self.size += self.starting.size

    def place(self, vector: int) -> int:
        """Return the offset of a vector of the step in the work array, by the number of the vector."""
        return vector * self.width


class SolveLayout:
    """Offsets in the work array of the data for one solution of implicit equations, from `start` on.

    First come the values of Newton's method, then vectors of unknowns, then matrices. A vector of unknowns
    consists of all unknown vectors, one after the other, each padded to `width`. The matrices are stored by
    columns: the negative inverse of the Newton matrix, one matrix for each damping action, and the derivative
    of the law. Space for a matrix to be inverted follows, with its rows `stride` apart.
    """

    def __init__(self, layout: Layout, start: int, index: int, solve: Solve, damped: list[Damp]) -> None:
        self.index, self.solve, self.damped = index, solve, damped
        self.procedure_name = str(index)
        self.adaptive = layout.step.control is not None
        block, length = layout.block, layout.length
        self.block, self.length, self.width = block, length, layout.width
        self.unknowns = solve.count * length
        self.all = solve.count * self.width
        self.stride = row_stride(self.unknowns)
        self.first = layout.place(solve.first)
        self.flags = start
        self.residual = start + whole_blocks(len(NEWTON.fields), block)
        self.weights = self.residual + self.all
        self.history = self.weights + self.all
        self.sizes = self.history + (1 if self.adaptive else HISTORY) * self.all
        self.places = self.sizes + self.all
        self.inverse = self.places + LAWS[layout.step.law].arguments * self.width
        self.dampers = self.inverse + self.unknowns * self.all
        self.derivative = self.dampers + len(damped) * length * self.width
        entries = layout.rows * layout.columns
        self.matrix = whole_blocks(self.derivative + entries, block)
        self.pivots = self.matrix + max(self.unknowns * self.stride, whole_blocks(entries, block))
        self.end = self.pivots + 3 * row_stride(max(self.unknowns, layout.dimension))

    def damper(self, damp: Damp) -> int:
        """Return the offset of the matrix of the damping action `damp`."""
        return self.dampers + self.damped.index(damp) * self.length * self.width


FUNCTION = Callee((REAL, READ, READ, Array()), (FLAG,))
"""Type of a function between arrays: from a time, a state and prepared numbers to its results. It returns True if it is
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
    start     First time of the grid of fixed steps.
    step      Length of fixed steps, signed.
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
    """Return the type of the law, the function that a step evaluates: from a time and a state to its results.

    If the layout keeps arguments in registers, the law takes and returns single numbers, and a flag of a
    singular matrix. Otherwise it takes and writes arrays.
    """
    results = LAWS[layout.step.law].results * (layout.dimension // 2)
    by_number = Callee((REAL,) * (1 + layout.dimension) + (READ,), (REAL,) * results + (FLAG,))
    return by_number if layout.in_registers else FUNCTION


@dataclass(frozen=True)
class Running:
    """The arguments of a procedure that takes steps of a run.

    law                 The function that a step evaluates, such as the right-hand side.
    parameters          The parameters of the law, and numbers that depend only on them.
    jacobian            The derivative of the law.
    constants           The parameters of the derivative.
    run, counts         The state of the run.
    floors              The absolute tolerance of each entry of the state, (dimension,).
    effort              The work for one step.
    newtons             The state of Newton's method, for each solution of implicit equations.
    starters            The state of Newton's method for the step that starts a two-step method.
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
    """Return the type of a procedure's parameter of class `Running`, for a `layout`."""
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
