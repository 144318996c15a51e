"""Eigenvalues of the linear equations about an equilibrium that is followed while a parameter changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from lagrange.errors import RunError, StatementError, listing, shown
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.linearization import Linearization, linearized_at
from lagrange.mechanics.plain_form import number, numeric
from lagrange.mechanics.point import StatedPoint, stated_point
from lagrange.statement.number import real_array
from lagrange.statement.parameters import label_of
from lagrange.statement.statement import Statement

STEPS = 30
"""Steps of Newton's method from the equilibrium at the value before."""

MOST_VALUES = 10_000
"""Largest number of values of the parameter: each takes some milliseconds."""

CLOSE = 1e-9
"""Its last step, relative to the coordinates and to 1."""


@dataclass(frozen=True, eq=False, repr=False)
class EigenvaluePath:
    """Eigenvalues, (k, 2n), at values (k,) of a parameter, and the equilibria that they belong to, (k, n).

    Each column is one eigenvalue, followed from row to row. Where there is no equilibrium a row is NaN. With
    constraints a row has one for each independent coordinate and each independent velocity.
    """

    parameter: Any
    values: FloatArray
    eigenvalues: Any
    equilibria: FloatArray

    def __repr__(self) -> str:
        count, stable = len(self.values), int(np.count_nonzero(self.stable))
        return (
            f"<EigenvaluePath: {self.eigenvalues.shape[1]} eigenvalues at {count} values of {self.parameter} from "
            f"{self.values[0]:.6g} to {self.values[-1]:.6g}; no growth at {stable} of them>"
        )

    @property
    def stable(self) -> Any:
        """Whether no eigenvalue has a positive real part, (k,): that is necessary for stability and not sufficient."""
        size = np.abs(self.eigenvalues).max(axis=1)
        return self.eigenvalues.real.max(axis=1) <= 1e-6 * size


def eigenvalue_path(statement: Statement, parameter: Any, values: Any, at: Any, model: Model) -> EigenvaluePath:
    """Return the eigenvalues along values of a parameter; see `Analysis.eigenvalues`."""
    by_name = {p.name: p for p in statement.parameters}
    label = label_of(parameter)
    if label not in by_name:
        raise StatementError(f"{shown(label)} is no parameter of this system; its parameters are {listing(by_name)}.")
    chosen = real_array(values, "values")
    if chosen.ndim != 1 or not 0 < len(chosen) <= MOST_VALUES:
        raise StatementError(
            f"values has shape {chosen.shape}: give a list of values of {label}, at least 1 and at most {MOST_VALUES}."
        )
    point = stated_point(statement, at)
    n = len(statement.coordinates)
    lin = _on_constraints(point) if statement.constraints else None
    rows = np.full((len(chosen), 2 * n if lin is None else lin.K.cols + lin.K.rows), complex("nan"), dtype=complex)
    places = np.full((len(chosen), n), np.nan)
    before: FloatArray | None = None
    known: list[int] = []
    for k, value in enumerate(chosen):
        given = model.parameter_values({label: float(value)})
        state = _stated(point, given) if lin is not None else _equilibrium(point, model, given, before)
        matrix = None if state is None else _matrix(lin, model, state, given)
        if state is None or matrix is None:
            continue
        rows[k] = _matched(np.linalg.eigvals(matrix), _expected(known, rows, chosen, value))
        known = [*known[-1:], k]
        before = state if point.decimal else None
        places[k] = state[:n]
    if np.isnan(places).all():
        raise StatementError(
            f"no equilibrium was found at any of the {len(chosen)} values of {label}: give one at the first value, as "
            "at={...}, or an expression in the parameters."
        )
    return EigenvaluePath(by_name[label], chosen, rows, places)


def _on_constraints(point: StatedPoint) -> Linearization:
    """Return the linear equations of a system with constraints, in symbols."""
    name = point.form.statement.name
    lin = None if point.decimal else linearized_at(point)
    if lin is None or lin.decimal:
        raise StatementError(
            f"{name} has constraints, and its equilibrium in decimals is not followed: give `at` as expressions in "
            "parameters."
        )
    if not lin.equilibrium:
        raise StatementError(f"there are no eigenvalues at this point of {name}. {lin.note}")
    return lin


def _matrix(lin: Linearization | None, model: Model, state: FloatArray, given: Any) -> FloatArray | None:
    """Return the first-order matrix at values of the parameters, None where it does not exist."""
    if lin is None:
        return model.jacobian(0.0, state, given)
    exact = {p: sympy.Rational(x) for p, x in given.items()}
    mass, damping, stiffness, basis, slope = (
        numeric(x, exact) for x in (lin.M, lin.C, lin.K, lin.velocity_basis, lin.velocity_slope)
    )
    forces, rates = np.hstack([-stiffness, -damping]), np.hstack([slope, basis])[lin.places]
    if not (np.isfinite(mass).all() and np.isfinite(forces).all() and np.isfinite(rates).all()):
        return None
    return np.vstack([rates, np.linalg.solve(mass, forces)])


def _stated(point: StatedPoint, given: Any) -> FloatArray | None:
    """Return the state (2n,) of the point at values of the parameters, or None where it has none."""
    exact = {p: sympy.Rational(x) for p, x in given.items()}
    stated = np.array([number(x, exact) for x in (*point.q, *point.v)])
    if not np.isfinite(stated).all() or np.abs(stated.imag).max() > 1e-12:
        return None
    return stated.real.copy()


def _equilibrium(point: StatedPoint, model: Model, given: Any, before: FloatArray | None) -> FloatArray | None:
    """Return the state (2n,) of the equilibrium at values of the parameters, or None."""
    state, n = _stated(point, given), len(point.q)
    if state is None:
        return None
    if before is not None:
        state[:n] = before[:n]
    for _ in range(STEPS):
        try:
            a = model.accelerations(state[:n], state[n:], 0.0, given)
            slopes = model.jacobian(0.0, state, given)[n:, :n]
        except RunError:
            return None
        if not (np.isfinite(a).all() and np.isfinite(slopes).all()):
            return None
        step = np.linalg.pinv(slopes, rcond=1e-10) @ a
        state[:n] -= step
        if np.abs(step).max() <= CLOSE * (1 + np.abs(state[:n]).max()):
            left = np.abs(model.accelerations(state[:n], state[n:], 0.0, given)).max()
            return state if left <= 1e-6 * max(1e-300, np.abs(slopes).max()) else None
    return None


def _expected(known: Sequence[int], rows: Any, values: FloatArray, value: float) -> Any:
    """Return the eigenvalues that a line through the last two known rows leads to, so that crossings are passed.

    None where no row is known.
    """
    if not known:
        return None
    last = rows[known[-1]]
    if len(known) == 1 or values[known[-1]] == values[known[-2]]:
        return last
    share = (value - values[known[-1]]) / (values[known[-1]] - values[known[-2]])
    return last + share * (last - rows[known[-2]])


def _matched(found: Any, before: Any) -> Any:
    """Return eigenvalues in the order in which they continue those before."""
    from scipy.optimize import linear_sum_assignment

    ordered = np.sort_complex(np.asarray(found))
    if before is None:
        return ordered
    _, columns = linear_sum_assignment(np.abs(before[:, None] - ordered[None, :]))
    return ordered[columns]
