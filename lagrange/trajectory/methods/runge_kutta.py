"""Explicit Runge-Kutta methods by tableau: fixed steps, or adaptive steps if the tableau has an error estimate."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache, partial
from itertools import chain
from typing import Any

import numpy as np

from lagrange.errors import StatementError, shown
from lagrange.program.step import StepProgram, trace
from lagrange.program.step_size_control import Control
from lagrange.statement.expression import entries, one_of, text, whole_number
from lagrange.trajectory.dense_output import StepPath, hermite_path, stages_polynomial, step_path
from lagrange.trajectory.integrator import Claims, Problem, built_in, method_repr
from lagrange.trajectory.methods.tolerances import adaptive_settings, check_options, fixed_settings
from lagrange.trajectory.plan import StepPlan
from lagrange.trajectory.run_loop import drive_by
from lagrange.trajectory.tableaux import explicit as tableaux
from lagrange.trajectory.tableaux.butcher import HIGHEST_CHECKED, ButcherTableau, Coefficients, ErrorEstimate, moved
from lagrange.trajectory.trajectory import FloatArray

FRACTION = re.compile(r"\s*[+-]?[0-9]{0,99}(\.[0-9]{0,99})?(/[0-9]{1,99}|[eE][+-]?[0-9]{1,3})?\s*")
"""Pattern of an entry of a tableau as text, such as 2/3, -1 or 0.25."""


@dataclass(frozen=True)
class RungeKutta:
    """The integrator by an explicit Runge-Kutta method with a tableau.

    `step` is the size of fixed steps, for a tableau without an error estimate. `rtol` and `atol` are the tolerances for
    a tableau with an error estimate. If an option is None, the option of the run counts, or a default. `law` is the
    function that the step evaluates: "rhs", or "local" for a step in local coordinates of rotations, which keeps
    quaternions at length one.
    """

    tableau: ButcherTableau
    step: float | None = None
    rtol: float | None = None
    atol: float | None = None
    law: str = "rhs"

    def __repr__(self) -> str:
        return method_repr(self, step=self.step, rtol=self.rtol, atol=self.atol)

    def __post_init__(self) -> None:
        if not isinstance(self.tableau, ButcherTableau):
            raise StatementError(f"{shown(self.tableau)} is not a tableau: make one with lg.methods.tableau().")
        one_of(self.law, ("rhs", "local"), "the law of a method is not {given}: give one of {known}.")
        check_options(self.step, self.rtol, self.atol)

    @property
    def name(self) -> str:
        """The name of the method, which is the name of its tableau."""
        return self.tableau.name

    @cached_property
    def claims(self) -> Claims:
        """The claimed properties of the method: order, step control, and the order of the dense output."""
        dense = self.tableau.dense.order if self.tableau.dense else 0
        return Claims(order=self.tableau.order, adaptive=self.tableau.error is not None, dense=dense)

    @property
    def program(self) -> StepProgram:
        """The program that computes one step of the method."""
        return runge_kutta_step(self.tableau, self.law)

    def plan(self, problem: Problem) -> StepPlan:
        """Return the plan of a run: the step program, the tolerances or step size, and the dense output."""
        chosen = adaptive_settings if self.claims.adaptive else fixed_settings
        tolerances = chosen(self.name, problem, self.step, self.rtol, self.atol)
        return StepPlan(self.program, tolerances, self._path)

    integrate = drive_by

    def _path(self, problem: Problem, times: FloatArray, states: FloatArray) -> StepPath:
        dense, order = self.tableau.dense, self.tableau.order
        if dense is None or dense.order < order - 1 or self.law == "local":
            return hermite_path(order)(problem, times, states)
        kind = stages_polynomial(self.tableau)
        return step_path(problem.model, problem.parameter_array, kind, times, states, self.tableau)


@lru_cache(maxsize=64)
def runge_kutta_step(tableau: ButcherTableau, law: str = "rhs") -> StepProgram:
    """Return the step program of a tableau. `law` is "rhs", or "local" for local coordinates of rotations."""
    estimate, control = tableau.error, None
    if estimate is not None:
        control = Control(estimate.control, damped=bool(estimate.damping), memory=estimate.memory)
    if law == "local":
        return trace(tableau.name, partial(local_step, tableau), law=law, control=control)
    if control is None:
        return trace(tableau.name, lambda f, t, y, h: moved(tableau, f, t, y, h)[0])
    return trace(tableau.name, partial(moved, tableau), control=control)


def local_step(tableau: ButcherTableau, g: Callable[..., Any], t: Any, q: Any, v: Any, h: Any) -> tuple[Any, ...]:
    """Return q and v after a step of the tableau in local coordinates about its start, then their error estimates.

    q and v are vectors of n entries at time t, and h is the step size. g(t, Q, V, q) is a function of a local state Q,
    V about the coordinates q at the start of the step. It returns four vectors: dQ/dt and dV/dt, then the coordinates
    and velocities that the local state represents.
    """

    def slope(at: Any, state: Any) -> Any:
        return np.array(g(at, *state, q)[:2], dtype=object)

    end, *errors = moved(tableau, slope, t, np.array([q, v], dtype=object), h)
    return *g(t + h, *end, q)[2:], *chain(*errors)


@built_in("euler")
def Euler(step: float | None = None) -> RungeKutta:
    """Return the explicit Euler method, order 1."""
    return RungeKutta(tableaux.EULER, step=step)


@built_in("heun")
def Heun(step: float | None = None) -> RungeKutta:
    """Return Heun's method, the explicit trapezoidal rule, order 2."""
    return RungeKutta(tableaux.HEUN, step=step)


@built_in("midpoint")
def Midpoint(step: float | None = None) -> RungeKutta:
    """Return the explicit midpoint rule, order 2."""
    return RungeKutta(tableaux.MIDPOINT, step=step)


@built_in("rk4")
def RK4(step: float | None = None) -> RungeKutta:
    """Return the classical Runge-Kutta method, order 4."""
    return RungeKutta(tableaux.RK4, step=step)


@built_in("munthe-kaas4")
def MuntheKaas4(step: float | None = None) -> RungeKutta:
    """Return Munthe-Kaas's method on the group of rotations, order 4: rk4 in local coordinates."""
    return RungeKutta(replace(tableaux.RK4, name="munthe-kaas4"), step=step, law="local")


@built_in("bs3")
def BS3(rtol: float | None = None, atol: float | None = None) -> RungeKutta:
    """Return the adaptive method of Bogacki and Shampine, order 3(2)."""
    return RungeKutta(tableaux.BS3, rtol=rtol, atol=atol)


@built_in("dopri5")
def Dopri5(rtol: float | None = None, atol: float | None = None) -> RungeKutta:
    """Return the adaptive method of Dormand and Prince, order 5(4)."""
    return RungeKutta(tableaux.dopri5(), rtol=rtol, atol=atol)


@built_in("tsit5")
def Tsit5(rtol: float | None = None, atol: float | None = None) -> RungeKutta:
    """Return Tsitouras's adaptive method, order 5(4)."""
    return RungeKutta(tableaux.tsit5(), rtol=rtol, atol=atol)


@built_in("verner9")
def Verner9(rtol: float | None = None, atol: float | None = None) -> RungeKutta:
    """Return Verner's most efficient adaptive method of order 9(8)."""
    return RungeKutta(tableaux.verner9(), rtol=rtol, atol=atol)


@built_in("dop853")
def DOP853(rtol: float | None = None, atol: float | None = None) -> RungeKutta:
    """Return Hairer's adaptive method of order 8 with estimates of order 5 and 3."""
    return RungeKutta(tableaux.dop853(), rtol=rtol, atol=atol)


def tableau(
    A: Any,
    b: Any,
    *,
    order: int,
    name: str = "tableau",
    c: Any = (),
    embedded: Any = None,
    embedded_order: int | None = None,
    source: str = "",
) -> ButcherTableau:
    """Return the tableau of an explicit method, checked against the order that it claims. Its dense output is cubic.

    `A` is a strictly lower triangular matrix (s, s) or its rows, `b` has s weights, and `c` are the abscissae, by
    default the row sums of A. An entry is a number, a Fraction or text such as "2/3". `embedded` are the weights of a
    second solution, of `embedded_order` or by default one less than `order`: the method then controls its steps by the
    difference. Raises StatementError with the condition that fails.
    """
    listed = entries(A, f"the matrix A of the tableau {shown(text(name, 'name'))}")
    if listed is None:
        raise StatementError(f"the tableau {shown(name)} has A = {shown(A)}: give its rows, each a list.")
    lines = [_entries(name, line) for line in listed]
    if embedded_order is not None:
        embedded_order = whole_number(embedded_order, "embedded_order", 1, HIGHEST_CHECKED)
    if any(entry for i, line in enumerate(lines) for entry in line[i:]):
        raise StatementError(f"the tableau {shown(name)} is not explicit: A must be zero on and above its diagonal.")
    weights = _entries(name, b)
    error = None
    if embedded is not None:
        embedded_weights = _entries(name, embedded)
        if len(embedded_weights) != len(weights):
            raise StatementError(
                f"the tableau {shown(name)} has {len(weights)} weights in b and {len(embedded_weights)} in embedded."
            )
        difference = tuple(x - y for x, y in zip(weights, embedded_weights, strict=True))
        if not any(difference):
            raise StatementError(
                f"the tableau {shown(name)} has embedded equal to b: their difference estimates no error."
            )
        error = ErrorEstimate(difference, order=embedded_order or max(order - 1, 1))
    rows = tuple(line[:i] for i, line in enumerate(lines))
    method = ButcherTableau(name=name, order=order, A=rows, b=weights, c=_entries(name, c), error=error, source=source)
    return method.hermite()


def _entries(name: str, line: Any) -> Coefficients:
    listed = entries(line, f"a row of the tableau {shown(name)}")
    try:
        row = tuple(x if isinstance(x, float) else _fraction(x) for x in ([line] if listed is None else listed))
        for entry in row:
            float(entry)  # A fraction may be outside of the range of doubles.
        return row
    except (TypeError, ValueError, ArithmeticError) as error:
        raise StatementError(
            f"the tableau {shown(name)} has an entry that is not a number ({error}): give numbers, or text such as "
            "'2/3', each row a list."
        ) from error


def _fraction(entry: Any) -> Fraction:
    """Return a number or short text as an exact fraction. Long texts, such as 1e1000000000, are refused."""
    if isinstance(entry, bool) or (isinstance(entry, str) and not FRACTION.fullmatch(entry)):
        raise ValueError(shown(entry))
    return Fraction(entry)


def explicit_method(A: Any, b: Any, *, name: str, order: int, step: float | None = None) -> RungeKutta:
    """Return a fixed-step method from a tableau.

    `A` is a strictly lower triangular matrix (s, s) or its rows, and `b` has s weights. The tableau is checked against
    the `order`; `step` is the step size. Raises StatementError with the condition that fails.
    """
    return RungeKutta(tableau(A, b, name=name, order=order), step=step)
