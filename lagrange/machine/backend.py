"""The protocols of a machine: it loads programs and returns kernels, series and drivers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.algorithm.step.memory import Layout
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.errors import RunError, StatementError
from lagrange.graph.node import Node
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.step_events import EventSteps
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import StepProgram
from lagrange.program.switching import Switched

FloatArray = NDArray[np.float64]

Places = NDArray[np.int64]
"""Indices of steps, (K,)."""


class MissingTargetError(StatementError):
    """A target whose packages cannot be loaded on this machine."""


class SingularMassMatrix(RunError):
    """The mass matrix has no inverse at a state. `column` is the index of the state in a batch, None for one state."""

    def __init__(self, column: int | None = None) -> None:
        super().__init__("the mass matrix is singular")
        self.column = column


class QuickCalls(NamedTuple):
    """Functions of (t, y) and of (t, q, v) that return the result for one state, or None if `Kernel` must be called.

    Quick calls do not report errors. They return None if the time is not a float, if a state is not a plain NumPy array
    of doubles of the right shape, or if the result is not finite.
    """

    whole: Callable[..., FloatArray | None]
    parts: Callable[..., FloatArray | None]


@runtime_checkable
class Kernel(Protocol):
    """A program that a machine has loaded, ready to be called."""

    @property
    def program(self) -> Program:
        """The program."""

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the program's result for a state (2n,), shape `program.shape`, or for columns (2n, batch).

        Columns are also the last axis of the result. `t` is a number, or one for each column (batch,). `parameters` has
        shape (k,). Raises SingularMassMatrix.
        """

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the result for columns. `inputs` has one array (size, batch) for each of the program's inputs."""

    def quick(self, parameters: FloatArray) -> QuickCalls | None:
        """Return quick calls for one state with these parameters, or None. Raises SingularMassMatrix."""


class Callback(NamedTuple):
    """A kernel as a function that procedures call: its address or the Python function, and its prepared parameters."""

    function: Any
    numbers: FloatArray


class BoundCall(Protocol):
    """Memory for the arguments of a procedure, and calls with them."""

    @property
    def is_final(self) -> bool:
        """True if the code is not compiled again."""

    def give(self, **arguments: Any) -> None:
        """Set arguments by name. Arrays and records are shared, None stands for no array and no function.

        Names that the procedure does not have are ignored.
        """

    def __call__(self) -> Any:
        """Return None, a value or a tuple of values."""

    def count(self, steps: int) -> bool:
        """Count steps of code that is compiled quickly, and return True when optimized code replaces it."""


class LoadedProcedure(Protocol):
    """A procedure that a machine has loaded."""

    def __call__(self, *args: Any) -> Any:
        """Return None, a value or a tuple of values, for arguments in the order of the parameters."""

    def bound(self) -> BoundCall:
        """Return memory for the arguments of calls."""


class Driver(Protocol):
    """Advances a run by many steps, with compiled code if the machine has a compiler."""

    def adopt(self, state: DriverState) -> None:
        """Make the state's y a view of the driver's memory if that saves a copy.

        The previous entries of y are lost then.
        """

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Try up to `budget` steps; write the times and states of accepted steps to `times` (c,) and `rows` (c, 2n).

        On return `state` is at the last accepted step, and its count ROWS is the number of rows written. `rows` needs
        four spare doubles after its last row, because machines write whole vectors.
        """


class BlockPolynomial(NamedTuple):
    """A callback that writes the polynomials of a block of steps, in the layout that `POLYNOMIAL` describes.

    `function` is an address or a Python function, and `given` its first argument. A block has `columns` steps, in the
    layout that the procedure `gather` writes. If `both` is true, the neighbouring steps are passed too. `work` is the
    number of doubles of working memory. `kept` holds objects that must stay referenced while `function` is used.
    """

    function: Any
    given: Any
    columns: int
    work: int
    both: bool
    kept: tuple[Any, ...]


class DensePath(Protocol):
    """The dense output of a run, for one kind of path, right-hand side and set of parameters.

    A run is its accepted times (S+1,) and states (S+1, 2n). Step i leads from row i to row i + 1.
    """

    @property
    def degree(self) -> int:
        """The degree of the polynomials."""

    def polynomial(self) -> BlockPolynomial:
        """Return the callback that writes the polynomials of a block of steps. Raises SingularMassMatrix."""

    def coefficients(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the coefficients of steps (k,) for powers of the fraction of the step, (degree + 1, 2n, k)."""

    def at(self, times: FloatArray, states: FloatArray, wanted: FloatArray, out: FloatArray) -> None:
        """Write the states at times (K,), sorted in the direction of the run, to `out` (2n, K) with contiguous rows.

        At accepted times these are the accepted states. If two accepted steps have the same time, the later one counts.
        """


class Series(Protocol):
    """A series program ready to run. `parameters` are (k + sides,): the sides of the switching surfaces come last."""

    @property
    def program(self) -> SeriesProgram:
        """The program of the series."""

    def form(self, order: int) -> str:
        """Return one word for the status card that says how the series of an order is computed."""

    def order(self, tolerance: float) -> int:
        """Return the order that reaches a relative tolerance at the lowest cost."""

    def code(self, order: int) -> SeriesCode:
        """Return the series at an order, with the loop over its steps."""

    def dense(self, order: int, parameters: FloatArray) -> DensePath:
        """Return the dense output of steps by the series of an order."""

    @property
    def values(self) -> Kernel:
        """The kernel of the event functions and switching surfaces. It takes the parameters of the series."""

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return the scaled Taylor coefficients at a state (2n,): row k has those of order k times scale**k.

        The result has shape (order + 1, 2n + watched), with the watched functions last. Raises SingularMassMatrix.
        """


class SeriesCode(Protocol):
    """A series at one order on a machine, with the loop over its steps."""

    program: SeriesProgram

    @property
    def layout(self) -> TaylorLayout:
        """The layout of the series."""

    @property
    def function(self) -> Any:
        """The function that computes the series, as procedures call it; see `JET`."""

    @property
    def loop(self) -> LoadedProcedure:
        """The loop over steps; see `taylor_steps`."""

    def joined(self, parameters: FloatArray, values: Kernel | None) -> tuple[FloatArray, Sequence[int]]:
        """Return the prepared numbers, the constants and the numbers of the event functions in one array.

        Also return the length of each of the three parts. Raises SingularMassMatrix.
        """

    @property
    def is_final(self) -> bool:
        """True if the code of the series is not compiled again."""

    def count(self, steps: int) -> bool:
        """Count steps of code that is compiled quickly, and return True when optimized code replaces it."""

    def load(self, program: Program) -> Kernel:
        """Return the kernel of a program."""

    def callback(self, kernel: Kernel, parameters: FloatArray) -> Callback:
        """Return a kernel as a function between arrays."""


class Machine(Protocol):
    """A target that loads programs and runs them, such as LLVM or NumPy."""

    @property
    def name(self) -> str:
        """The target's name, as `System.compile` takes it."""

    def load(self, program: Program) -> Kernel:
        """Return a kernel for a program, compiled or interpreted."""

    def series(self, program: SeriesProgram) -> Series:
        """Return a series program that is ready to run."""

    def called(self, procedure: Procedure) -> LoadedProcedure:
        """Load a procedure, once per process."""

    def loop(self, step: StepProgram, states: int, *, projected: bool) -> tuple[LoadedProcedure, Layout]:
        """Load the loop over the steps of a step program for a law of `states` entries, and return its layout.

        With `projected` the states satisfy constraints.
        """

    def callback(self, kernel: Any, parameters: FloatArray, *, of_steps: bool = False) -> Callback:
        """Return a kernel as a function between arrays; `of_steps` as the loop over steps calls its law.

        Raises SingularMassMatrix.
        """

    def dense(self, kind: StepPolynomial, kernel: Any, parameters: FloatArray, jacobian: Any = None) -> DensePath:
        """Return the dense output for a kind of path.

        The kernels are this machine's; some paths need the `jacobian`.
        """

    def event_steps(
        self,
        driver: Any,
        events: Program,
        resets: Program | None,
        parameters: FloatArray,
        dense: DensePath,
        screen: DensePath | None,
    ) -> EventSteps | None:
        """Return a callable that takes steps with events and resets, or None if NumPy reviews many steps on arrays.

        `screen` is a cheaper dense output. With it, `dense` is computed only for steps that the screen cannot decide.
        """

    @property
    def processor(self) -> str:
        """Name of the processor that code is compiled for; empty without compilation."""

    def members(self, procedure: Procedure) -> MemberRuns | None:
        """Compile a procedure over members of an ensemble, such as that of `lagrange.algorithm.members.queue`.

        Returns None if the machine does not run members in parallel lanes.
        """


class MemberRuns(Protocol):
    """A procedure over members of an ensemble, which run in parallel lanes."""

    @property
    def lanes(self) -> int:
        """Number of members that run at the same time."""

    def __call__(self, given: Mapping[str, Any]) -> None:
        """Run members, with arguments by name. Arrays are C-contiguous, of doubles or 64-bit integers.

        The interpreter lock is released.
        """


@runtime_checkable
class KernelProvider(Protocol):
    """Creates the kernels of a model from its equations, on one machine."""

    @property
    def machine(self) -> Machine:
        """The machine of the kernels."""

    def kernel(self, name: str) -> Kernel:
        """Return the kernel of a quantity of the system."""

    def interpreted(self, name: str) -> Kernel:
        """Return an interpreted kernel, for a few states: compilation would take longer than the evaluations."""

    def function(self, name: str, nodes: tuple[Node, ...]) -> Kernel:
        """Return a kernel that evaluates nodes of the equations' graph from t, q and v."""

    def series(self, watched: tuple[Node, ...]) -> tuple[Series, Switched]:
        """Return the Taylor series of the motion and of the `watched` nodes, and the switching surfaces."""

    @property
    def again(self) -> Callable[..., Any]:
        """Function that makes the model of a statement on the same machine, for pickles and for changed statements.

        It also takes the indices of independent constraints, if these are known.
        """
