"""A model with methods that export it to other libraries: SciPy, Numba, JAX, CasADi and SymPy."""

from __future__ import annotations

from typing import Any

from lagrange.machine import model as compiled
from lagrange.machine.parameters import Parameters, with_zero_inputs
from lagrange.recipes.libraries import JaxFunction, NumbaFunction, casadi_function, jax_function, numba_function
from lagrange.recipes.scipy import ScipyProblem, input_functions
from lagrange.recipes.sympy import SympyForm, sympy_form
from lagrange.statement.event import declare_events


class Model(compiled.Model):
    """A system compiled for one machine. Kernels are compiled when they are first used.

    Coordinates and velocities are arrays (n,), or (n, batch) for many states at once. A state y is [q, v], (2n,) or
    (2n, batch). Units are those of the statement. `parameters` is a dict by symbol or name; the others have the
    statement's defaults. Every method raises StatementError for wrong shapes and for a missing or unknown parameter,
    and RunError where the mass matrix is singular. The methods as_... return a quantity or the equations for other
    libraries.
    """

    def as_scipy(self, parameters: Parameters = None, events: Any = None, *, inputs: Any = None) -> ScipyProblem:
        """Return `fun(t, y)`, `jac(t, y)` and event functions for scipy.integrate.

        `solve_ivp(**problem.arguments((0, 10), {theta: 2}, method="Radau"))` takes all of them. `events` are those of a
        run, without resets. `parameters` are fixed. `inputs` are functions of time, such as {u: lambda t: np.sin(t)},
        one for each name in `model.inputs`. Raises StatementError for invalid arguments; the functions raise
        RunError where the mass matrix is singular.
        """
        declared = declare_events(events, self.statement, constant="as_scipy")
        functions = input_functions(self, inputs)
        values = self.parameter_array(with_zero_inputs(self.statement, parameters)).copy()
        return ScipyProblem(self, values, declared, functions)

    def as_numba(self, quantity: str = "rhs") -> NumbaFunction:
        """Return a quantity for Numba's compiled functions: `prepare(p)`, `rhs(t, y, prepared)` and `fill`.

        They call the machine code of this model. Raises StatementError without Numba, and on the numpy target.
        """
        return numba_function(self, quantity)

    def as_jax(self, quantity: str = "rhs") -> JaxFunction:
        """Return a quantity as a function of (t, y, p) that jax.jit, jax.grad and jax.vmap take, in double precision.

        y has shape (2n,), p is `parameter_array()`, whose last entries are the inputs. The result is NaN throughout
        where a mass matrix is singular. `.checked(t, y, p)` returns the result, and True if a mass matrix is singular.
        `.source` is the code. Raises StatementError without JAX, and where JAX computes in single precision.
        """
        return jax_function(self, quantity)

    def as_casadi(self, quantity: str = "rhs", symbols: str = "SX", *, status: bool = False) -> Any:
        """Return a quantity as a casadi.Function of (t, y, p), made of "SX" or "MX" symbols.

        y has 2n entries, p is `parameter_array()`, whose last entries are the inputs. The result is NaN throughout
        where a mass matrix is singular. With `status` there is a second result, 1 where a mass matrix is singular and 0
        elsewhere. Raises StatementError without CasADi.
        """
        return casadi_function(self, quantity, symbols, status=status)

    def as_sympy(self, quantity: str = "rhs") -> SympyForm:
        """Return a quantity in plain SymPy symbols, with its common subexpressions, for SymPy's code printers.

        Linear systems are eliminated in the order of the coordinates: where a pivot is zero, the formulas divide by
        zero.
        """
        return sympy_form(self, quantity)
