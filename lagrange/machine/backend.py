"""Interfaces of a machine, the back end that compiles or interprets programs: kernels, series, drivers, dense output.

Compiled objects are not copied: a copy is the object itself. A pickle contains the program, compiled on first use.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.algorithm.step.memory import Layout
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.errors import RunError, StatementError
from lagrange.graph.node import Node
from lagrange.machine.state import DriverState, EventSteps, Outcome
from lagrange.procedure.form import Procedure
from lagrange.program.program import Program
from lagrange.program.series import SeriesProgram
from lagrange.program.step import StepProgram
from lagrange.program.switching import Switched

FloatArray = NDArray[np.float64]

Places = NDArray[np.int64]
"""Type of an array (K,) of indices of steps in a run."""


class MissingTargetError(StatementError):
    """Raised if the packages of a compilation target (a back end) cannot be loaded on this machine."""


class SingularMassMatrix(RunError):
    """The mass matrix has no inverse at a state. `column` is the state's index in a batch, None for a single state."""

    def __init__(self, column: int | None = None) -> None:
        super().__init__("the mass matrix is singular")
        self.column = column


class QuickCalls(NamedTuple):
    """Fast functions that evaluate a kernel at one state: `whole(t, y)` and `parts(t, q, v)`.

    They raise no errors. They return None if the time is not a float, if a state is not a plain NumPy array of doubles
    of the right shape, or if the result is not finite or does not exist. The caller then calls the `Kernel`.
    """

    whole: Callable[..., FloatArray | None]
    parts: Callable[..., FloatArray | None]


@runtime_checkable
class Kernel(Protocol):
    """A program, such as a right-hand side, as a function of numbers: compiled, printed as Python, or interpreted."""

    @property
    def program(self) -> Program:
        """The program that the kernel computes."""

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the program's result for a state (2n,), in the shape `program.shape`, or for many states (2n, batch).

        The batch is also the last axis of the result. `t` is a number, or one for each state (batch,). `parameters` has
        shape (k,). Raises SingularMassMatrix.
        """

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the program's result for many states. `inputs` has an array (size, batch) for each of its inputs.

        `t` is a number, or one for each state (batch,), and `parameters` has shape (k,). The batch is the last axis
        of the result. Raises SingularMassMatrix.
        """

    def quick(self, parameters: FloatArray) -> QuickCalls | None:
        """Return fast functions that evaluate the kernel at one state, for fixed `parameters` (k,).

        The result is None if the machine has no such functions. Raises SingularMassMatrix.
        """


class Callback(NamedTuple):
    """A kernel in the form in which procedures call it. `function` is a machine address or a Python function.

    `numbers` are the kernel's parameters, followed by all values that depend only on them.
    """

    function: Any
    numbers: FloatArray


class BoundCall(Protocol):
    """Memory for the arguments of a procedure; calling the object runs the procedure with these arguments."""

    @property
    def is_final(self) -> bool:
        """True if the present code of the procedure will not be replaced by optimized code."""

    def give(self, **arguments: Any) -> None:
        """Set arguments of the procedure by name. Arrays and records are not copied.

        The value None passes no array or no function. Names that are not parameters of the procedure are ignored.
        """

    def __call__(self) -> Any:
        """Run the procedure with the arguments set before; return None, a value or a tuple of values."""

    def count(self, steps: int) -> bool:
        """Count `steps` more steps. Return True if optimized code has now replaced the quickly compiled code."""


class LoadedProcedure(Protocol):
    """A procedure in the form in which a machine runs it: machine code or a Python function."""

    def __call__(self, *args: Any) -> Any:
        """Run the procedure with arguments in the order of its parameters; return None, a value or several values."""

    def bound(self) -> BoundCall:
        """Return an object that stores arguments of the procedure, for many calls in which few arguments change."""


class Driver(Protocol):
    """Advances a run by the steps of one method. One call of `advance` takes many steps."""

    def adopt(self, state: DriverState) -> None:
        """Make the array `state.y` a view of the driver's memory if this avoids copies.

        The old entries of y are lost then.
        """

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Try up to `budget` steps of a run from `state`, and return the reason why the steps stopped.

        If the run records its steps, their times and states are written to `times` (c,) and `rows` (c, 2n), c at least
        `budget`. On return `state` is at the end of the last accepted step, and `state.count(state.ROWS)` is the number
        of rows written. `rows` needs four spare doubles after its last row, because machines write whole vectors.
        """


class BlockPolynomial(NamedTuple):
    """A callback that writes the dense output polynomials of a block of `columns` steps, and data for its calls.

    `function` is a machine address or a Python function of the type `POLYNOMIAL` (lagrange/algorithm/dense/block.py),
    and `context` is its first argument. The coefficient of power k and state entry j for step b is written to index
    (k * 2n + j) * columns + b. If `both` is true, the callback also reads a neighbouring step of each step. `work` is
    the number of doubles of work memory. `kept` holds objects that must exist as long as `function` is used.
    """

    function: Any
    context: Any
    columns: int
    work: int
    both: bool
    kept: tuple[Any, ...]


class DensePath(Protocol):
    """The dense output of runs: a polynomial on each step, for one method, right-hand side and set of parameters.

    Methods take a run as the times (S+1,) and states (S+1, 2n) of its accepted steps. Step i leads from row i to row
    i + 1.
    """

    @property
    def degree(self) -> int:
        """Degree of the polynomials of the steps."""

    def polynomial(self) -> BlockPolynomial:
        """Return the callback that writes the polynomials of a block of steps. Raises SingularMassMatrix."""

    def coefficients(self, times: FloatArray, states: FloatArray, steps: Places) -> FloatArray:
        """Return the polynomial coefficients (degree + 1, 2n, k) of the k steps with the indices `steps`.

        The variable of each polynomial is the fraction of its step, from 0 to 1.
        """

    def at(self, times: FloatArray, states: FloatArray, requested_times: FloatArray, out: FloatArray) -> None:
        """Write the states of a run at `requested_times` (K,) to `out` (2n, K), whose rows are contiguous.

        `times` and `states` are those of the accepted steps. The requested times are sorted in the direction of the
        run. At the time of an accepted state exactly this state is written. Of two accepted states at the same time,
        the later one is written.
        """


class Series(Protocol):
    """The Taylor series of a motion on one machine: its coefficients at a state, and its steps.

    `parameters` (k + s,) are k parameters of the model, then the sides of the s switching surfaces. A side is the
    sign of a surface's function.
    """

    @property
    def program(self) -> SeriesProgram:
        """The program that states how the coefficients are computed."""

    def form(self, order: int) -> str:
        """Return words for the printed summary of a run, such as "in loops": the form of the code for an `order`."""

    def order(self, tolerance: float) -> int:
        """Return the order of the series with which a run to a relative tolerance costs least."""

    def code(self, order: int) -> SeriesCode:
        """Return the loaded code that computes the series up to an order, and takes Taylor steps."""

    def dense(self, order: int, parameters: FloatArray) -> DensePath:
        """Return the dense output of Taylor steps of an order, for one set of parameters (k + s,)."""

    @property
    def values(self) -> Kernel:
        """The kernel that evaluates the switching surfaces and event functions. It takes the series' parameters."""

    def rows(self, order: int, t: float, y: FloatArray, scale: float, parameters: FloatArray) -> FloatArray:
        """Return the scaled Taylor coefficients at a state (2n,). Row k has the coefficients of order k times scale**k.

        The result has shape (order + 1, 2n + w). The last w columns belong to the w switching surfaces and event
        functions. Raises SingularMassMatrix.
        """


class SeriesCode(Protocol):
    """Code that computes a Taylor series at one order, and the loop that takes steps with this series."""

    program: SeriesProgram

    @property
    def layout(self) -> TaylorLayout:
        """The layout in memory of the Taylor coefficients and of the work array of the loop."""

    @property
    def function(self) -> Any:
        """The function that computes the Taylor coefficients at a state: a machine address or a Python function."""

    @property
    def loop(self) -> LoadedProcedure:
        """The procedure that takes Taylor steps in a loop and calls `function` for each of them."""

    def joined(self, parameters: FloatArray, values: Kernel | None) -> tuple[FloatArray, Sequence[int]]:
        """Return one array of all numbers that are constant along a run, and the lengths of its parts.

        The parts are the parameters of the series with all values that depend only on them, constants of the code, and
        the parameters of the event functions with the values that depend only on these. `values` is the kernel of the
        event functions, or None without events. Raises SingularMassMatrix.
        """

    @property
    def is_final(self) -> bool:
        """True if the present code of the series will not be replaced by optimized code."""

    def count(self, steps: int) -> bool:
        """Count `steps` more steps. Return True if optimized code has now replaced the quickly compiled code."""

    def load(self, program: Program) -> Kernel:
        """Return the kernel of a program on the machine of the series."""


class Machine(Protocol):
    """A back end that loads programs and runs them, such as LLVM or NumPy."""

    @property
    def name(self) -> str:
        """The name of the back end, "llvm" or "numpy", as users pass it to `System.compile`."""

    def load(self, program: Program) -> Kernel:
        """Return the kernel of a program on this machine: compiled, printed as Python, or interpreted."""

    def series(self, program: SeriesProgram) -> Series:
        """Return the Taylor series that `program` states, compiled or interpreted on this machine."""

    def called(self, procedure: Procedure) -> LoadedProcedure:
        """Load a procedure and return it, ready to be called. A procedure is loaded once per process."""

    def loop(self, step: StepProgram, law: Program, *, projected: bool) -> tuple[LoadedProcedure, Layout]:
        """Return the procedure that takes steps of a method in a loop, and the layout of its work array.

        `step` states one step of the method, and `law` is the program that steps evaluate, such as the right-hand side.
        With `projected`, each new state is projected onto the constraints.
        """

    def callback(self, kernel: Any, parameters: FloatArray, *, of_steps: bool = False) -> Callback:
        """Return a kernel as a callback for procedures, with fixed `parameters` (k,). Raises SingularMassMatrix.

        `of_steps` is True if a loop over steps calls it as its right-hand side. In machine code such a callback may
        take a small state in registers. All other callbacks take arrays.
        """

    def dense(self, kind: StepPolynomial, kernel: Any, parameters: FloatArray, jacobian: Any = None) -> DensePath:
        """Return the dense output of steps: states between accepted times, by the step polynomial `kind` of a method.

        `kernel` is the right-hand side. Some kinds also need its `jacobian`. Both kernels must be of this machine.
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
        """Return a function that takes steps and finds events on them, or None if the caller has to find them.

        If the result is None, the caller takes many steps and then searches them for events. `driver` takes the steps.
        `events` evaluates the event functions, and `resets` the new values of state entries at events. `dense` is the
        dense output of the steps. `screen` is a cheaper dense output, or None. With `screen`, `dense` is used only for
        steps where `screen` cannot exclude an event.
        """

    @property
    def processor(self) -> str:
        """Name of the processor that code is compiled for; "" if the machine compiles nothing."""

    def members(self, procedure: Procedure) -> MemberRuns | None:
        """Compile a procedure that runs members of an ensemble, as the modules in lagrange/algorithm/members build it.

        Return None if the machine does not run members in parallel lanes.
        """


class MemberRuns(Protocol):
    """A compiled procedure that runs members of an ensemble in parallel lanes."""

    @property
    def lanes(self) -> int:
        """Number of members that run at the same time."""

    def __call__(self, arguments: Mapping[str, Any]) -> None:
        """Run the members of an ensemble, with the procedure's `arguments` by name.

        Array arguments are C-contiguous and have doubles or 64-bit integers. Results are written to some of them.
        Python's interpreter lock is released during the call.
        """


@runtime_checkable
class KernelProvider(Protocol):
    """An object from which a model gets its kernels: it creates them from the equations, for one machine."""

    @property
    def machine(self) -> Machine:
        """The machine for which the kernels are created."""

    def kernel(self, name: str) -> Kernel:
        """Return the kernel of a quantity of the system, such as "rhs" or "energy"."""

    def interpreted(self, name: str) -> Kernel:
        """Return the kernel of a quantity such as "rhs" without compiling it: faster for a few evaluations."""

    def function(self, name: str, nodes: tuple[Node, ...]) -> Kernel:
        """Return a kernel that evaluates nodes of the equations' graph from t, q and v. `name` is its name in code."""

    def series(self, watched: tuple[Node, ...]) -> tuple[Series, Switched]:
        """Return the Taylor series of the motion and of the `watched` nodes, and the switching surfaces.

        `watched` are event functions as nodes of the equations' graph.
        """

    @property
    def rebuild(self) -> Callable[..., Any]:
        """Function that builds a model of another statement on the same machine, for pickles and changed statements.

        Its arguments are the statement and the indices of independent constraints, or None if these are unknown.
        """


class Shared:
    """Base class of immutable objects whose copy is the object itself, because machine code cannot be copied."""

    def __copy__(self) -> Any:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return self


class UnpickledKernel(Shared):
    """A kernel restored from a pickle, which contains only its program. `load` compiles the program on first use."""

    def __init__(self, load: Callable[[Program], Kernel], program: Program) -> None:
        self._load, self.program = load, program

    def __reduce__(self) -> tuple[Any, ...]:
        return UnpickledKernel, (self._load, self.program)

    @cached_property
    def _kernel(self) -> Kernel:
        return self._load(self.program)

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the result of the program for a state (2n,) or many (2n, batch)."""
        return self._kernel(t, y, parameters)

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the result of the program for many states. `inputs` has an array (size, batch) for each input."""
        return self._kernel.columns(t, inputs, parameters)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._kernel, name)  # attributes of kernels that are not in the protocol, such as `address`


class Quick(dict[str, QuickCalls]):
    """A dict {name of a quantity of a model: its fast functions for one state, with the default parameters}.

    The functions are created on first use. If a quantity has no fast functions, its two functions return None.
    """

    def __init__(self, kernel: Callable[[str], Kernel], parameters: Callable[[], FloatArray]) -> None:
        super().__init__()
        self._kernel, self._parameters = kernel, parameters

    def __missing__(self, name: str) -> QuickCalls:
        try:
            calls = self._kernel(name).quick(self._parameters())
        except SingularMassMatrix:
            calls = None
        self[name] = QuickCalls(nothing, nothing) if calls is None else calls
        return self[name]


def one_state(kernel: Kernel, parameters: FloatArray) -> Callable[[float, FloatArray], FloatArray]:
    """Return a kernel as a function of a time and one state (2n,), by the fast functions of the kernel if it has them.

    The state must be a plain array of doubles. SingularMassMatrix may be raised here and by the returned function.
    """
    quick = kernel.quick(parameters)
    if quick is None:
        return lambda t, y: kernel(t, y, parameters)
    whole = quick.whole

    def call(t: float, y: FloatArray) -> FloatArray:
        result = whole(t, y)
        return kernel(t, y, parameters) if result is None else result

    return call


def quickly(kernel: Kernel, parameters: FloatArray, t: float, y: FloatArray) -> FloatArray | None:
    """Return the result of a kernel at time t and one state y (2n,), computed by its fast function (`QuickCalls`).

    Return None if the kernel has no such function or the result is not finite.
    """
    quick = kernel.quick(parameters)
    return None if quick is None else quick.whole(t, y)


def nothing(*_: Any) -> None:
    """Return None for any arguments, in place of a fast function, so that the caller evaluates the kernel itself."""


def may_vanish(kernel: Kernel, parameters: FloatArray) -> bool:
    """Return True if some result of a kernel may be zero at some state.

    Results that depend on the state or time may always be zero. Others are evaluated once with the parameters. If
    no result can be zero, the caller need not test the results of a large batch, which takes as long as computing
    them.
    """
    program = kernel.program
    if any(instruction.op in ("state", "time") for instruction in program.instructions):
        return True
    results = quickly(kernel, parameters, 0.0, np.zeros(program.states))
    return results is None or 0.0 in results.tolist()


FEW_ENTRIES = 64
"""Largest length of an array that `surely_finite` tests by a sum in Python. Two calls of NumPy would take 1 us."""


def surely_finite(array: FloatArray) -> bool:
    """Return True only if every entry is finite. The result may be False for a short array of huge finite entries.

    A short array is tested by the sum of its entries, which may overflow. Python adds them, because NumPy would warn of
    an overflow, and public functions give no warnings.
    """
    if array.size <= FEW_ENTRIES:
        return math.isfinite(sum(array.ravel().tolist()))
    return bool(np.isfinite(array).all())


def scalar(value: FloatArray) -> Any:
    """Return a zero-dimensional array as a float, and other arrays unchanged."""
    return float(value) if value.ndim == 0 else value
