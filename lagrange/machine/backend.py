"""The protocols of a machine: it loads programs and returns kernels, series and drivers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import RunError
from lagrange.graph.node import Node
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.step_events import EventSteps
from lagrange.procedure.dense.block import StepPolynomial
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import StepProgram
from lagrange.program.switching import Switched

FloatArray = NDArray[np.float64]

Places = NDArray[np.int64]
"""Numbers of steps, (K,)."""


class SingularMassMatrix(RunError):
    """The mass matrix has no inverse at the given state; `column` says which of a batch."""

    def __init__(self, column: int | None = None) -> None:
        super().__init__("the mass matrix is singular")
        self.column = column


class QuickCalls(NamedTuple):
    """Functions of (t, y) and of (t, q, v) that return the result for one state, or None if `Kernel` must be called.

    They are quick because they leave error reports to `Kernel`. They return None for a time that is no float and for a
    state that is no plain NumPy array of doubles of the right shape. A result is finite.
    """

    whole: Callable[..., FloatArray | None]
    parts: Callable[..., FloatArray | None]


@runtime_checkable
class Kernel(Protocol):
    """A program ready to run."""

    @property
    def program(self) -> Program:
        """The program."""

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the program's result for a state (2n,), shape `program.shape`, or for columns (2n, batch).

        Columns are the last axis of the result as well; `t` is a number, or one per column (batch,).
        `parameters` has shape (k,). Raises SingularMassMatrix.
        """

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the result for columns of each of the program's inputs, (size, batch), without joining them."""

    def quick(self, parameters: FloatArray) -> QuickCalls | None:
        """Return quick calls for one state with these parameters, or None. Raises SingularMassMatrix."""


class Driver(Protocol):
    """Advances a run by many steps, without Python code for each step if the machine can."""

    def adopt(self, state: DriverState) -> None:
        """Let the state's y use the driver's memory if that saves a copy; its entries are lost."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Try up to `budget` steps and record each accepted one in `times` (c,) and `rows` (c, 2n) from the first on.

        `state` is left at the last accepted step; it says how many rows were written. `rows` has four doubles to
        spare behind its last row, for machines that write whole vectors.
        """


class TaylorDriver(Driver, Protocol):
    """A driver of Taylor steps, whose parameters may change during a run."""

    def watch(self, memory: Any) -> None:
        """Deal with what is watched by an `EventMemory` from now on, as far as it is enabled there."""

    def use(self, parameters: FloatArray) -> None:
        """Continue with other parameters or sides, (k + sides,)."""

    def restart(self, state: DriverState) -> None:
        """Reset the compensation: the state has jumped."""


class BlockPolynomial(NamedTuple):
    """What writes the polynomials of a block of steps, for procedures that take it as `POLYNOMIAL` says.

    `function` is an address or a function of Python, and `given` its first argument. A block has `columns` steps, which
    the procedure `gather` writes, with those beside them if `both`. It works in so many doubles as `work` says. `kept`
    must stay referenced while it is used.
    """

    function: Any
    given: Any
    columns: int
    work: int
    both: bool
    kept: tuple[Any, ...]


class DensePath(Protocol):
    """The polynomials of a run's steps, for one kind of path, right-hand side and set of parameters.

    A run is given by its accepted times (S+1,) and states (S+1, 2n), and step i leads from row i to the next.
    """

    @property
    def degree(self) -> int:
        """The degree of the polynomials."""

    def polynomial(self) -> BlockPolynomial:
        """Return what writes the polynomials of a block of steps. Raises SingularMassMatrix."""

    def coefficients(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the polynomials of some steps (k,) in the fraction of the step, by powers, (degree + 1, 2n, k)."""

    def at(self, times: FloatArray, states: FloatArray, wanted: FloatArray, out: FloatArray) -> None:
        """Write the states at times (K,) that lie in the order of the run to `out` (2n, K), its rows without gaps.

        At accepted times they are the accepted states, those of the later step where two are at one time.
        """


class Series(Protocol):
    """A series program ready to run. `parameters` are (k + sides,): the sides of the switching surfaces come last."""

    @property
    def program(self) -> SeriesProgram:
        """What it computes."""

    def form(self, order: int) -> str:
        """Return in a word how the series of an order is computed, for the status card."""

    def order(self, tolerance: float) -> int:
        """Return the order that reaches a relative tolerance at the least cost."""

    def driver(self, order: int, parameters: FloatArray) -> TaylorDriver:
        """Return a driver of Taylor steps. Raises SingularMassMatrix if a constant mass matrix has no inverse."""

    def dense(self, order: int, parameters: FloatArray) -> DensePath:
        """Return the dense output of steps by the series of an order."""

    @property
    def values(self) -> Kernel:
        """What is watched as a function of the state; its parameters are those of the series."""

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return the series at a state (2n,): row k has the coefficients of order k times scale**k.

        The result has shape (order + 1, 2n + watched). Raises SingularMassMatrix.
        """


class Machine(Protocol):
    """A target that runs programs."""

    @property
    def name(self) -> str:
        """The target's name, as `System.compile` takes it."""

    def load(self, program: Program) -> Kernel:
        """Make a kernel of a program."""

    def series(self, program: SeriesProgram) -> Series:
        """Make a series program ready to run."""

    def driver(
        self, step: StepProgram, kernel: Any, parameters: FloatArray, jacobian: Any = None, projection: Any = None
    ) -> Driver:
        """Make a driver that advances a run by a step program whose law the kernel evaluates; it is this machine's.

        `jacobian` is the kernel of the law's derivative, for a step that solves, and `projection` that of the
        corrections of a state, for a system with constraints.
        """

    def called(self, procedure: Procedure) -> Callable[..., Any]:
        """Return a procedure as a function of numbers and arrays: it returns nothing, a value or a tuple of values."""

    def dense(self, kind: StepPolynomial, kernel: Any, parameters: FloatArray, jacobian: Any = None) -> DensePath:
        """Make the dense output of a kind of path; the kernels are this machine's, that of the derivative if wanted."""

    def event_steps(
        self,
        driver: Any,
        events: Program,
        resets: Program | None,
        parameters: FloatArray,
        dense: DensePath,
        screen: DensePath | None,
    ) -> EventSteps | None:
        """Return what takes the steps of a driver with events and resets; None where NumPy is to do it on arrays.

        The dense output is computed on steps on which a cheaper `screen` leaves doubts, or on all without one.
        """

    @property
    def processor(self) -> str:
        """The processor that code is compiled for, in a few words; empty where none is."""

    def members(self, procedure: Procedure) -> MemberRuns | None:
        """Compile a procedure over members of an ensemble; see `lagrange.procedure.members.queue`.

        Returns None where members are not run side by side.
        """


class MemberRuns(Protocol):
    """A procedure over members of an ensemble, several at once."""

    @property
    def lanes(self) -> int:
        """How many members run side by side."""

    def __call__(self, given: Mapping[str, Any]) -> None:
        """Run members; arrays are C-contiguous, of doubles or 64-bit whole numbers. Other threads run meanwhile."""


@runtime_checkable
class KernelProvider(Protocol):
    """Makes the kernels of a model, on a machine, from its equations."""

    @property
    def machine(self) -> Machine:
        """The machine of the kernels."""

    def kernel(self, name: str) -> Kernel:
        """Return the kernel of a quantity of the system."""

    def interpreted(self, name: str) -> Kernel:
        """Return such a kernel for a few states, for which compilation would take longer."""

    def function(self, name: str, nodes: tuple[Node, ...]) -> Kernel:
        """Return nodes of the equations' graph as a function of t, q and v."""

    def series(self, watched: tuple[Node, ...]) -> tuple[Series, Switched]:
        """Return the Taylor series of the motion with what is watched, and its switching surfaces."""

    @property
    def again(self) -> Callable[..., Any]:
        """The function that makes the model of a statement on the same machine, for pickles and for other statements.

        It also takes the indices of independent constraints, where these are known.
        """
