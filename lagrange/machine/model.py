"""The model: a compiled system, with its equations, energy, momenta and other quantities as functions of numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from itertools import islice
from types import MappingProxyType
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from lagrange.equations.derivation import Derivation
from lagrange.equations.euler_lagrange import Equations, node_of
from lagrange.equations.singular import singular_sentence
from lagrange.errors import RunError, StatementError, abridged, counted, listing, shown
from lagrange.graph.branches import square_roots
from lagrange.graph.evaluate import term_sizes
from lagrange.graph.node import Node
from lagrange.machine.backend import (
    FloatArray,
    Kernel,
    KernelProvider,
    Machine,
    Quick,
    QuickCalls,
    Series,
    SingularMassMatrix,
    may_vanish,
    nothing,
    scalar,
    surely_finite,
)
from lagrange.machine.kernel.python_kernel import PythonKernel, printed
from lagrange.machine.parameter_arrays import Parameters, ParameterValues, by_parameters
from lagrange.program.catalogue import LAW_QUANTITIES, quantities_of
from lagrange.program.switching import Switched
from lagrange.statement.expression import one_of, real_array, real_number, text, whole_number
from lagrange.statement.statement import Statement

State = tuple[FloatArray, FloatArray]
"""Type of a pair of the coordinates q and the velocities v, both (n,) for one state, or (n, batch) for many."""

FUNCTIONS_KEPT = 64
"""Largest number of kernels of user expressions, such as event functions, that a model caches."""

SERIES_KEPT = 16
"""Largest number of Taylor series with event functions that a model caches, in addition to the series without events.
Each takes some 2 MB of machine code.
"""

UNSET = 1e-2
"""Largest residual of an equation of first order, as a fraction of its terms, at which a velocity of zero is accepted.
Above it the velocity counts as missing in the state. Steps at loose tolerances cause residuals of some 1e-3.
"""

RATES = ("rhs", "accelerations", "jacobian", "multipliers")
"""Quantities that depend on the velocities of coordinates without inertia. A state in which such a velocity is zero and
contradicts its equation is refused.
"""

NO_QUANTITY = "{given} is not a quantity of a model: they are {known}."


class Model:
    """A system compiled for one machine. The kernel of each quantity is compiled at its first use.

    Coordinates and velocities are arrays (n,), or (n, batch) for many states at once; a state y is [q, v],
    (2n,) or (2n, batch). Units are those of the statement. `parameters` is a dict by symbol or name, which replaces
    some of the statement's defaults, or an array of all values (k,), or (k, batch) with one column for each state.
    Methods raise StatementError for wrong shapes and missing or unknown parameters, and RunError where the mass matrix
    is singular.
    """

    def __init__(self, statement: Statement, equations: Equations, made: KernelProvider) -> None:
        self.statement, self.equations, self.layout = statement, equations, equations.layout
        self._made, self._values = made, ParameterValues(statement)
        self._function = lru_cache(maxsize=FUNCTIONS_KEPT)(made.function)
        self._law = lru_cache(maxsize=len(LAW_QUANTITIES))(made.kernel)
        self._kernels: dict[str, Kernel] = {}
        self._series: dict[tuple[Node, ...], tuple[Series, Switched]] = {}
        self._quick_rhs: Callable[[Any, Any], FloatArray | None] = self._first_rhs
        self.prepared: dict[Any, Any] = {}
        """Cache of objects, such as drivers, that a run prepares and that later runs of the model use again."""

    def __reduce__(self) -> tuple[Any, ...]:
        return self._made.rebuild, (self.statement,)

    def __repr__(self) -> str:
        names = abridged(self.statement.names)
        return f"<Model of {self.statement.name} ({names}) on {self.machine.name}>"

    @property
    def machine(self) -> Machine:
        """The machine (back end) that runs the kernels."""
        return self._made.machine

    @property
    def target(self) -> str:
        """The name of the machine that runs the kernels, "llvm" or "numpy"."""
        return self.machine.name

    @property
    def dimension(self) -> int:
        """The number n of coordinates."""
        return len(self.statement.coordinates)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs: given functions u without values, and their rates such as u_dot.

        Inputs are the last parameters.
        """
        return tuple(symbol.name for symbol, _ in self.statement.inputs)

    @property
    def conservative(self) -> bool:
        """True if the structure of the equations shows that they conserve the energy."""
        return self.equations.structure.conservative

    def kernel(self, name: str) -> Kernel:
        """Return the kernel of the quantity `name`, a function of numbers that is compiled at its first use.

        The names are rhs, jacobian, accelerations, mass_matrix, energy, momenta, lagrangian, forces and bias (h in M
        a = h). A system with m constraints also has multipliers, constraint_forces (m, n), constraints (phi, then
        dphi/dt), constraint_gradient G (m, n), and constraint_bias (gamma in G a + gamma = 0). On the llvm target a
        kernel has an `address` to call from compiled code.
        """
        if not isinstance(name, str) or name not in self._kernels:
            one_of(name, quantities_of(self.equations), NO_QUANTITY)
            self._kernels[name] = self._made.kernel(name)
        return self._kernels[name]

    def law(self, name: str) -> Kernel:
        """Return the kernel of the quantity `name`, for the steps of methods.

        The name is one that `kernel` accepts, such as "rhs", or one of `LAW_QUANTITIES`, such as "constrained", which
        only steps evaluate. Some of the latter also take the multipliers of the constraints as inputs.
        """
        return self._law(name) if isinstance(name, str) and name in LAW_QUANTITIES else self.kernel(name)

    def interpreted(self, name: str) -> Kernel:
        """Return an uncompiled, interpreted kernel of the quantity `name`, which is faster for a few evaluations."""
        one_of(name, quantities_of(self.equations), NO_QUANTITY)
        return self._made.interpreted(name)

    def source(self, name: str) -> str:
        """Return the Python source of the quantity `name` on the numpy target, for one state and for many states.

        Names of variables are generated and literals are exact. Raises StatementError for a linear system too large
        to be printed.
        """
        return printed(self.interpreted(name).program)

    def function(self, name: str, nodes: tuple[Node, ...]) -> Kernel:
        """Return an interpreted kernel that evaluates `nodes` of the equations' graph from t, q and v.

        `name` is the name of the kernel.
        """
        nodes, name = _nodes(nodes), text(name, "name")
        if not nodes or not name.isidentifier():
            raise StatementError(
                f"function({shown(name)}, nodes) with {counted(len(nodes), 'node')}: give a name that is a Python "
                "identifier, and at least one node."
            )
        return self._function(name, nodes)

    def series(self, watched: tuple[Node, ...] = ()) -> tuple[Series, Switched]:
        """Return the Taylor series of the motion on this machine, and its switching surfaces, built at the first use.

        `watched` are nodes of the equations' graph, such as event functions. The series also computes their Taylor
        coefficients, after those of the surfaces. The last few series are cached. Event functions that differ only in a
        constant are different `watched` nodes, and have different series.
        """
        watched = _nodes(watched)
        if watched not in self._series:
            self._series[watched] = self._made.series(watched)
            others = [key for key in self._series if key]
            for key in others[:-SERIES_KEPT]:
                self._series.pop(key, None)
        return self._series[watched]

    @cached_property
    def square_roots(self) -> Mapping[Node, Node]:
        """{root: power of its radicand} for the square roots in momenta and forces, as `square_roots_in` returns."""
        return self.square_roots_in((*self.equations.momenta, *self.equations.forces))

    def square_roots_in(self, nodes: Iterable[Node]) -> Mapping[Node, Node]:
        """Return {square root of the base: power} for the fractional powers in `nodes`. Keys and values are nodes.

        A Taylor series is valid only up to a zero of the base, which its coefficients do not show: that of sqrt(x**2)
        continues as x. Therefore runs search for zeros of these roots. A root in a branch that is not taken counts as
        1. Powers of positions with exponents up to -1, as in gravity, are left out: where their base is zero, the
        forces are infinite, and steps become short.
        """
        return square_roots(self.equations.graph, _nodes(nodes))

    def accelerations(
        self, q: ArrayLike, v: ArrayLike, t: float | ArrayLike = 0.0, parameters: Parameters = None
    ) -> FloatArray:
        """Return the generalized accelerations d2q/dt2, (n,) or (n, batch)."""
        if parameters is None:
            derivative = self._quick["rhs"].parts(t, q, v)
            if derivative is not None:
                return derivative[self.layout.v]
        state = self._state(q, v)
        if state[0].ndim > 1:
            return self._run("accelerations", t, state, parameters)
        return self._run("rhs", t, state, parameters)[self.layout.v]

    def rhs(self, t: float | ArrayLike, y: ArrayLike, parameters: Parameters = None) -> FloatArray:
        """Return dy/dt = [v, a], (2n,) or (2n, batch); t is a number or (batch,).

        Velocities of coordinates without inertia follow from their equations, whatever values y has for them. If an
        equation is nonlinear in them, y must have the right values: zeros that contradict the equation raise
        StatementError, here and in `accelerations`, `jacobian` and `multipliers`.
        """
        derivative = self._quick_rhs(t, y) if parameters is None else None
        return self._run("rhs", t, self._checked_state(y), parameters) if derivative is None else derivative

    def _first_rhs(self, t: Any, y: Any) -> FloatArray | None:
        """Return dy/dt by a fast function, or None if this function does not accept the arguments.

        This method serves the first evaluation only. It stores the fast function, which later evaluations call.
        """
        self._quick_rhs = self._quick["rhs"].whole
        return self._quick_rhs(t, y)

    def _check_rates(self, t: float | ArrayLike, state: State, parameters: Parameters) -> None:
        """Raise StatementError if the velocity of a coordinate without inertia is 0 and contradicts its equation.

        It is called for systems whose equations are not linear in these velocities, so that states must contain them.
        """
        rows = list(self.equations.first_order)
        relations = self.equations.constraints.velocities[-len(rows) :]
        residuals = self._call(self.function("relations", (*relations, *term_sizes(relations))), t, state, parameters)
        off = (np.abs(residuals[: len(rows)]) > UNSET * residuals[len(rows) :]).any(axis=0)
        zero = (state[1][rows] == 0.0) & off
        if zero.any():
            name = self.statement.names[rows[int(np.argmax(zero.reshape(len(rows), -1).any(axis=1)))]]
            raise StatementError(
                f"{name} has no inertia, and its velocity in y is 0, which contradicts its equation of motion. Start "
                "from model.as_scipy().y0(initial), which computes this velocity, or evaluate "
                "model.as_scipy().fun(t, y)."
            )

    def jacobian(self, t: float | ArrayLike, y: ArrayLike, parameters: Parameters = None) -> FloatArray:
        """Return the derivative of the right-hand side dy/dt by the state y, (2n, 2n), or (2n, 2n, batch)."""
        matrix = self._quick["jacobian"].whole(t, y) if parameters is None else None
        return self._run("jacobian", t, self._checked_state(y), parameters) if matrix is None else matrix

    def mass_matrix(
        self, q: ArrayLike, t: float | ArrayLike = 0.0, parameters: Parameters = None, v: ArrayLike | None = None
    ) -> FloatArray:
        """Return M = d2L/dv2, (n, n), or (n, n, batch).

        If L is quadratic in v, M does not depend on v, which may then be None. If M depends on v, as for the
        relativistic L = -m*c*sqrt(c**2 - v**2), v must be given in the shape of q. Otherwise StatementError is raised,
        and names the velocities that M depends on.
        """
        if v is not None:
            return self._run("mass_matrix", t, self._state(q, v), parameters)
        array = self._vector(q, "q")
        if self._velocities_in_mass:
            raise StatementError(
                f"the mass matrix of this system depends on {listing(self._velocities_in_mass)}: give the velocities "
                "too, in the shape of q, as mass_matrix(q, v=v)."
            )
        return self._run("mass_matrix", t, (array, np.zeros_like(array)), parameters)

    def energy(self, q: ArrayLike, v: ArrayLike, t: float | ArrayLike = 0.0, parameters: Parameters = None) -> Any:
        """Return the energy v.p - L, a float or (batch,)."""
        return scalar(self._of_parts("energy", t, q, v, parameters))

    def momenta(
        self, q: ArrayLike, v: ArrayLike, t: float | ArrayLike = 0.0, parameters: Parameters = None
    ) -> FloatArray:
        """Return the conjugate momenta p = dL/dv, (n,) or (n, batch)."""
        return self._of_parts("momenta", t, q, v, parameters)

    def multipliers(
        self, q: ArrayLike, v: ArrayLike, t: float | ArrayLike = 0.0, parameters: Parameters = None
    ) -> FloatArray:
        """Return the multipliers lambda of the m constraints, in the order of the statement, (m,) or (m, batch).

        Constraint i exerts the generalized forces lambda_i dpsi_i/dv, where psi_i(q, v, t) = 0 is the constraint on the
        velocities. Raises StatementError for a system without constraints.
        """
        if not self.statement.constraints:
            raise StatementError(f"{self.statement.name} has no constraints, and so no multipliers.")
        return self._of_parts("multipliers", t, q, v, parameters)

    def evaluate(
        self, name: str, q: ArrayLike, v: ArrayLike, t: float | ArrayLike = 0.0, parameters: Parameters = None
    ) -> Any:
        """Return the value of the quantity `name` at a state (q, v), for any name that `kernel` accepts.

        For a batch of states, the last axis of the result has one entry for each state.
        """
        return scalar(self._of_parts(text(name, "name"), t, q, v, parameters))

    def evaluate_expression(
        self, expression: Any, t: ArrayLike, y: ArrayLike, parameters: Parameters = None
    ) -> FloatArray:
        """Return the values (batch,) of a SymPy expression along states.

        The expression may have coordinates, velocities, accelerations, multipliers, parameters and t. `y` has shape
        (2n, batch) and `t` (batch,). Raises StatementError for an expression with other symbols.
        """
        kernel = self.function("expression", (node_of(expression, self.statement, self.equations),))
        return np.asarray(self._call(kernel, t, self._checked_state(y), parameters)[0])

    def called(self, kernel: Kernel, t: float | ArrayLike, y: ArrayLike, parameters: Parameters = None) -> FloatArray:
        """Return the result of a kernel of this model at time t, for a state y (2n,) or many states (2n, batch).

        For many states the result has one more axis, the last, with one entry for each state.
        """
        if not isinstance(kernel, Kernel):
            raise StatementError(f"{shown(kernel)} is not a kernel: give model.kernel(name).")
        return self._call(kernel, t, self._checked_state(y), parameters)

    def parameter_values(self, given: Mapping[Any, Any] | None = None) -> dict[Any, float]:
        """Return {symbol: value} for every parameter: from the dict `given` if it is there, else the default.

        Keys of `given` are symbols or names. None means only defaults.
        """
        return self._values.by_symbol(given)

    def parameter_array(self, given: Parameters = None) -> FloatArray:
        """Return the values of the parameters (k,) in the order that kernels expect.

        `given` is a dict by symbol or name, or None for the defaults. An array (k,) is returned unchanged.
        """
        return self._values.array(given)

    def with_defaults(self, parameters: Mapping[Any, Any]) -> Self:
        """Return a copy of the model with other default values of parameters. It shares the compiled kernels.

        `parameters` maps symbols or names to the new values. Raises StatementError for an unknown parameter, and for a
        parameter without a value.
        """
        values = MappingProxyType(self.parameter_values(parameters))
        model = type(self)(replace(self.statement, defaults=values), self.equations, self._made)
        model._kernels = self._kernels
        return model

    def on_same_machine(self, statement: Statement, kept: Sequence[int] | None = None) -> Any:
        """Return a model of another statement, compiled for the same machine as this model.

        `kept` are the indices of the statement's independent constraints. None means that they are unknown.
        """
        if not isinstance(statement, Statement):
            raise StatementError(f"{shown(statement)} is not a statement: give the .statement of a system.")
        last = len(statement.constraints) - 1
        indices = [] if kept is None else real_array(kept, "kept").ravel().tolist()
        rows = None if kept is None else [whole_number(i, "kept", 0, last) for i in indices]
        return self._made.rebuild(statement, rows)

    def _of_parts(self, name: str, t: Any, q: Any, v: Any, parameters: Parameters) -> FloatArray:
        """Return the value of the quantity `name` at time t and the state (q, v).

        For one state as plain arrays, with the default parameters, a fast function of the kernel is used.
        """
        if parameters is None:
            value = self._quick[name].parts(t, q, v)
            if value is not None:
                return value
        return self._run(name, t, self._state(q, v), parameters)

    @cached_property
    def _quick(self) -> Quick:
        quick = Quick(self.kernel, self.parameter_array)
        # These quantities have no fast functions: the velocities in the state must be checked first.
        quick |= dict.fromkeys(RATES if self.equations.has_unsolved_rates else (), QuickCalls(nothing, nothing))
        return quick

    def _run(self, name: str, t: float | ArrayLike, state: State, parameters: Parameters) -> FloatArray:
        if self.equations.has_unsolved_rates and name in RATES:
            self._check_rates(t, state, parameters)
        return self._call(self.kernel(name), t, state, parameters)

    def _call(self, kernel: Kernel, t: float | ArrayLike, state: State, parameters: Parameters) -> FloatArray:
        q, v = state
        time = self._time(t, q)
        values = self.parameter_array(parameters)
        if values.ndim == 2:
            return by_parameters(partial(self._call, kernel), time, state, values)
        try:
            result = kernel.columns(time, state, values) if q.ndim > 1 else kernel(time, np.concatenate(state), values)
        except SingularMassMatrix as error:
            raise RunError(self.singular_message(time, np.concatenate(state), error.column, values)) from error
        looked_at = self._uncoupled and kernel.program.solved and (q.ndim == 1 or may_vanish(self._masses, values))
        if looked_at and not surely_finite(result):
            column = self.column_without_inertia(time, q, v, values)
            if column is not None:
                raise RunError(self.singular_message(time, q, column, values))
        return result

    def _time(self, t: float | ArrayLike, q: FloatArray) -> float | FloatArray:
        """Return the checked time t: a float, or an array (batch,) if the user gives one time for each state.

        Raises StatementError if the shape of an array does not fit the coordinates q, (n,) or (n, batch).
        """
        if type(t) is float and math.isfinite(t):
            return t
        if not isinstance(t, (list, tuple)) and not (isinstance(t, np.ndarray) and t.ndim):
            return real_number(t, "the time t")
        time = real_array(t, "the time t")
        if q.ndim == 1 or time.shape != q.shape[1:]:
            raise StatementError(
                f"t has shape {time.shape}, but the batch of states has shape {q.shape[1:]}: give one time, or one for "
                "each state."
            )
        return time

    @cached_property
    def _velocities_in_mass(self) -> tuple[str, ...]:
        """Names of the velocities that the mass matrix depends on, in the notation of the user's expressions."""
        rows = sorted({i.place for i in self.kernel("mass_matrix").program.instructions if i.op == "state"})
        return tuple(self.layout.names(".dot")[row] for row in rows if row >= self.layout.v.start)

    @cached_property
    def _uncoupled(self) -> list[int]:
        """Indices of the coordinates that the mass matrix couples to no other coordinate.

        Their acceleration is force divided by inertia, so it is infinite or NaN if the inertia is zero.
        """
        return [block[0] for block in self.equations.plan.blocks if len(block) == 1]

    @cached_property
    def _masses(self) -> Kernel:
        """The kernel of the inertias M[i][i] of the coordinates that the mass matrix couples to no other.

        The kernel is not compiled, because a run calls it only once.
        """
        return PythonKernel(self.function("inertia", tuple(self.equations.mass[i][i] for i in self._uncoupled)).program)

    def column_without_inertia(
        self, t: float | FloatArray, q: FloatArray, v: FloatArray, parameters: FloatArray
    ) -> int | None:
        """Return the index of the first state of a batch in which an uncoupled coordinate has zero inertia, or None.

        A coordinate is uncoupled if the mass matrix couples it to no other. For a single state, with q and v (n,), the
        index is 0. Callers use the result to explain an acceleration that is not finite. A zero inertia does not always
        cause one, since the inertia may cancel in the formula of the acceleration.
        """
        (q, v), values = self._state(q, v), self.parameter_array(parameters)
        t = self._time(t, q)
        if not self._uncoupled:
            return None
        quick = self._masses.quick(values)
        masses = None if quick is None else quick.parts(t, q, v)
        if masses is not None:
            return 0 if 0.0 in masses.tolist() else None
        zeros = (self._masses.columns(t, [part.reshape(len(part), -1) for part in (q, v)], values) == 0.0).any(axis=0)
        return int(np.argmax(zeros)) if zeros.any() else None

    def singular_message(
        self, t: float | FloatArray, q: FloatArray, column: int | None = None, parameters: Parameters = None
    ) -> str:
        """Return the error message that explains why accelerations do not exist at coordinates q, (n,) or (n, batch).

        In a batch, `column` is the index of the state whose accelerations do not exist. For a single state it is None.
        """
        q = real_array(q, "q")
        if q.ndim not in (1, 2) or not q.size:
            raise StatementError(f"q has shape {q.shape}: give (n,), or (n, batch).")
        column = 0 if column is None else whole_number(column, "column", 0, q.shape[-1] - 1)
        t = self._time(t, q)
        chosen = q if q.ndim == 1 else q[:, column]
        time = float(np.broadcast_to(t, q.shape[1:])[column]) if q.ndim > 1 else float(np.asarray(t))
        state = np.zeros(self.layout.size)
        state[: len(chosen)] = chosen[: len(state)]
        values = self.parameter_array(parameters)
        return singular_sentence(self._made, self.equations, time, state, values)

    def _state(self, q: ArrayLike, v: ArrayLike) -> State:
        coordinates = self._vector(q, "q")
        velocities = self._vector(v, "v")
        if coordinates.shape != velocities.shape:
            raise StatementError(f"q has shape {coordinates.shape} and v {velocities.shape}: give both the same shape.")
        return coordinates, velocities

    def _vector(self, value: ArrayLike, what: str) -> FloatArray:
        array = real_array(value, what)
        n = self.dimension
        if array.ndim not in (1, 2) or array.shape[0] != n:
            raise StatementError(
                f"{what} has shape {array.shape}; this system has {counted(n, 'coordinate')} "
                f"({', '.join(self.statement.names)}): give ({n},), or ({n}, batch)."
            )
        return array

    def _checked_state(self, y: ArrayLike) -> State:
        array = real_array(y, "y")
        n = self.layout.size
        if array.ndim not in (1, 2) or array.shape[0] != n:
            raise StatementError(f"y has shape {array.shape}: give [q, v] of shape ({n},), or ({n}, batch).")
        return self.layout.split(array)


MOST_NODES = 10_000_000
"""Largest number of nodes that are read from a user's list, because iteration over a user's subclass may be endless."""


def _nodes(candidates: Iterable[Any]) -> tuple[Node, ...]:
    """Return the graph nodes in `candidates` as a tuple. Raises StatementError if one is not a graph node."""
    nodes = tuple(islice(candidates, MOST_NODES)) if isinstance(candidates, (tuple, list)) else None
    if nodes is None or not all(isinstance(node, Node) for node in nodes):
        raise StatementError(
            f"{shown(candidates)} is not a tuple of nodes: give nodes of the graph of model.equations."
        )
    return nodes


@runtime_checkable
class Stated(Protocol):
    """Interface of the class `lagrange.System`, for modules that take or build a system but do not import the class."""

    statement: Statement

    @classmethod
    def from_statement(cls, statement: Statement) -> Self:
        """Return the system that a checked statement describes."""

    def compile(self, target: str = "llvm", *, check: bool = True) -> Model:
        """Return the model of the system on a target, "llvm" or "numpy". With `check` its accelerations are tested."""

    def derivation(self) -> Derivation:
        """Return the textbook derivation of the equations of motion."""


def stated(system: Any, example: str) -> Statement:
    """Return the statement of `system`, which is a system or a model.

    Raises StatementError for other objects. The error message gives an example of a system: the scene named `example`.
    """
    if not isinstance(system, (Stated, Model)):
        raise StatementError(f"{shown(system)} is not a system: give an lg.System, such as lg.scene({example!r}).")
    return system.statement
