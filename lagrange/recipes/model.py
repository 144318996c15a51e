"""A model with methods that export it to other libraries: SciPy, Numba, JAX, CasADi and SymPy."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.errors import StatementError
from lagrange.export.target import load
from lagrange.machine import model as compiled
from lagrange.machine.backend import FloatArray
from lagrange.machine.parameter_arrays import Parameters, with_zero_inputs
from lagrange.machine.python_source import defined
from lagrange.recipes.scipy import ScipyProblem, input_functions
from lagrange.recipes.sympy import SympyForm, sympy_form
from lagrange.statement.event import declare_events
from lagrange.statement.expression import flag, one_of


def missing(method: str, command: str, error: ImportError) -> StatementError:
    """Return the error for a missing package that a method of the model needs; `command` installs the package."""
    package = command.rsplit(maxsplit=1)[-1]
    return StatementError(f"model.{method}() needs {package}, which cannot be imported ({error}): {command}")


def entries(model: compiled.Model) -> list[str]:
    """Return two lines of ASCII text with the names of the entries of y and of p, for comments in generated code."""
    state, parameters = model.layout.names(), [symbol.name for symbol in model.statement.parameters]
    return [f"{letter} = [{ascii(', '.join(names))[1:-1]}]" for letter, names in (("y", state), ("p", parameters))]


SYMBOLS = ("SX", "MX")  # Kinds of symbols in CasADi: scalars, and matrices


@dataclass(frozen=True, eq=False)
class JaxFunction:
    """A quantity as a function of time t, state y (2n,) and parameters p, for jax.jit, jax.grad and jax.vmap.

    `checked(t, y, p)` returns the quantity, and True if a mass matrix is singular. `source` is the code that defines
    both functions.
    """

    function: Callable[[Any, Any, Any], Any]
    checked: Callable[[Any, Any, Any], Any]
    source: str

    def __repr__(self) -> str:
        return "<JaxFunction of (t, y, p)>"

    def __call__(self, t: Any, y: Any, p: Any) -> Any:
        """Return the quantity at time t, state y and parameters p; all entries are NaN if a mass matrix is singular."""
        return self.function(t, y, p)


_PREPARE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
_FILL = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)

_KEPT: dict[int, Any] = {}
"""Compiled kernels by address, which are never freed: Numba's functions have the address, and may outlive the model."""


@dataclass(frozen=True, eq=False)
class NumbaFunction:
    """A quantity as functions that Numba's compiled functions can call; arrays are contiguous and of doubles.

    `prepare(p)` takes the parameters (k,) and returns the array `prepared` of all values that depend on parameters
    alone. Its last entry is nonzero if a matrix of such values is singular. `function(t, y, prepared)` returns the
    quantity as a new array, with NaN in all entries if a mass matrix is singular. `fill(t, y, prepared, out)` writes
    the quantity to `out` and returns True if a mass matrix is singular. It allocates no memory.
    """

    prepare: Callable[[FloatArray], FloatArray]
    function: Callable[[float, FloatArray, FloatArray], FloatArray]
    fill: Callable[[float, FloatArray, FloatArray, FloatArray], bool]

    def __repr__(self) -> str:
        return "<NumbaFunction: prepare(p), function(t, y, prepared) and fill(t, y, prepared, out)>"


class Model(compiled.Model):
    """A system compiled for one machine. Kernels are compiled when they are first used.

    Coordinates and velocities are arrays (n,), or (n, batch) for many states at once. A state y is [q, v], (2n,) or
    (2n, batch). Units are as in the statement. `parameters` is a dict by symbol or name; parameters without an entry
    have the statement's defaults. Every method raises StatementError for wrong shapes and for a missing or unknown
    parameter, and RunError where the mass matrix is singular. The methods as_... return a quantity or the equations for
    other libraries.
    """

    def as_scipy(self, parameters: Parameters = None, events: Any = None, *, inputs: Any = None) -> ScipyProblem:
        """Return `fun(t, y)`, `jac(t, y)` and event functions for scipy.integrate.

        `solve_ivp(**problem.arguments((0, 10), {theta: 2}, method="Radau"))` takes all of them. `events` are as for a
        run, but without resets. `parameters` are fixed. `inputs` are functions of time, such as {u: lambda t:
        np.sin(t)}, one for each name in `model.inputs`. Raises StatementError for invalid arguments; the functions
        raise RunError where the mass matrix is singular.
        """
        self.statement.check_without_contacts("as_scipy()")
        declared = declare_events(events, self.statement, constant="as_scipy")
        functions = input_functions(self, inputs)
        values = self.parameter_array(with_zero_inputs(self.statement, parameters)).copy()
        return ScipyProblem(self, values, declared, functions)

    def as_numba(self, quantity: str = "rhs") -> NumbaFunction:
        """Return a quantity as functions for Numba: `prepare(p)`, `function(t, y, prepared)`, `fill(..., out)`.

        They call the machine code of this model. Raises StatementError without Numba, and on the numpy target.
        """
        self.statement.check_without_contacts("as_numba()")
        kernel: Any = self.kernel(quantity)
        address = kernel.address
        try:
            import numba
        except ImportError as error:
            raise missing("as_numba", "pip install numba", error) from error
        _KEPT[address] = kernel
        prepare_code, fill_code = _PREPARE(kernel.prepare_address), _FILL(address)
        program, size = kernel.program, kernel.prepared_size
        states, count, shape, k = program.states, math.prod(program.shape), program.shape, program.parameters

        def prepare(p: Any) -> Any:
            if p.size != k:
                raise ValueError("p has a wrong number of entries: give one value for each parameter of the model")
            prepared = np.zeros(size + 1)
            prepared[:k] = p
            prepared[size] = prepare_code(prepared.ctypes)
            return prepared

        def fill(t: Any, y: Any, prepared: Any, out: Any) -> Any:
            if y.size != states or prepared.size != size + 1 or out.size != count:
                raise ValueError(
                    "y, prepared or out has a wrong number of entries: give arrays of the sizes of the model"
                )
            singular = fill_code(t, y.ctypes, prepared.ctypes, out.ctypes) != 0
            return singular or prepared[size] != 0.0

        vector, result = numba.float64[::1], numba.types.Array(numba.float64, len(shape), "C")
        made_fill = numba.njit(numba.boolean(numba.float64, vector, vector, result))(fill)

        def function(t: Any, y: Any, prepared: Any) -> Any:
            out = np.empty(shape)
            if made_fill(t, y, prepared, out):
                out[...] = np.nan
            return out

        compiled = numba.njit(result(numba.float64, vector, vector))(function)
        return NumbaFunction(numba.njit(vector(vector))(prepare), compiled, made_fill)

    def as_jax(self, quantity: str = "rhs") -> JaxFunction:
        """Return a quantity as a function of (t, y, p) for jax.jit, jax.grad and jax.vmap, in double precision.

        y has shape (2n,), p is `parameter_array()`, whose last entries are the inputs. All entries of the result are
        NaN if a mass matrix is singular. `.checked(t, y, p)` returns the result, and True if a mass matrix is singular.
        `.source` is the code. Raises StatementError without JAX, and where JAX computes in single precision.
        """
        self.statement.check_without_contacts("as_jax()")
        program = self.interpreted(quantity).program
        try:
            import jax
        except ImportError as error:
            raise missing("as_jax", "pip install jax", error) from error
        if not jax.config.jax_enable_x64:
            raise StatementError(
                "JAX computes in single precision, which has 7 digits: call jax.config.update('jax_enable_x64', True) "
                "before arrays are created, then model.as_jax()."
            )
        text = load("jax").LIBRARY.source(program, quantity, entries(self))
        function: Any = defined(text, quantity, {})
        return JaxFunction(function, function.__globals__[f"{quantity}_checked"], text)

    def as_casadi(self, quantity: str = "rhs", symbols: str = "SX", *, status: bool = False) -> Any:
        """Return a quantity as a casadi.Function of (t, y, p), made of "SX" or "MX" symbols.

        y has 2n entries, p is `parameter_array()`, whose last entries are the inputs. All entries of the result are NaN
        if a mass matrix is singular. If `status` is true, there is a second result, 1 if a mass matrix is singular and
        else 0. Raises StatementError without CasADi.
        """
        self.statement.check_without_contacts("as_casadi()")
        program = self.interpreted(quantity).program
        one_of(symbols, SYMBOLS, "{given} is not a kind of CasADi's symbols: they are {known}.")
        try:
            import casadi
        except ImportError as error:
            raise missing("as_casadi", "pip install casadi", error) from error
        name = f"{quantity}_checked" if flag(status, "status") else quantity
        text = load("casadi").LIBRARY.source(program, quantity, entries(self))
        return defined(text, name, {})(getattr(casadi, symbols))

    def as_sympy(self, quantity: str = "rhs") -> SympyForm:
        """Return a quantity as SymPy expressions, with its common subexpressions, for SymPy's code printers.

        Linear systems are solved by elimination in the order of the coordinates. The formulas divide by zero at states
        with a pivot of zero.
        """
        self.statement.check_without_contacts("as_sympy()")
        return sympy_form(self, quantity)
