"""A linearization against the compiled model: A against the Jacobian of the right-hand side, B against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy

from lagrange.evidence.sample import Point
from lagrange.machine.model import Model
from lagrange.mechanics.linearization import Linearization
from lagrange.mechanics.number_check import agrees, compared
from lagrange.mechanics.plain_form import numeric
from lagrange.mechanics.point import StatedPoint
from lagrange.statement.coordinate import t

INPUT_STEP = 1e-3
"""Change of an input by which B is compared; forces are nearly always linear in inputs, and then it is exact."""

INPUT_ERROR = 1e-5
"""Error of B that the curvature of such a step may make, relative to the largest entry."""


def check(lin: Linearization, point: StatedPoint, model: Model) -> None:
    """Compare at the values of the parameters, and at random ones. Raises RunError where they differ."""
    statement = point.form.statement

    def at_point(sample: Point) -> tuple[Any, Any]:
        return _both(lin, point, model, _values(point, sample))

    if all(p in statement.defaults for p in statement.parameters if p not in point.inputs):
        defaults = {p: statement.defaults.get(p, 0.0) for p in statement.parameters}
        zero = (0.0,) * len(statement.coordinates)
        agrees("the linearization", statement, Point(zero, zero, 0.3, defaults, "the point given"), at_point)
    if not (point.decimal or lin.decimal):
        compared("the linearization", statement, at_point)


def _values(point: StatedPoint, sample: Point) -> dict[Any, Any]:
    """Return numbers for the parameters, the inputs and the time."""
    numbers = {p: sympy.Rational(x) for p, x in sample.parameters.items()} | {t: sympy.Rational(sample.t)}
    return numbers | {u: x.xreplace(numbers) for u, x in point.inputs.items()}


def _both(lin: Linearization, point: StatedPoint, model: Model, values: Any) -> tuple[Any, Any]:
    """Return the columns of A, then of B, that are compiled and that the matrices give."""
    n = len(point.q)
    state = numeric(sympy.Matrix([*point.q, *point.v]), values).ravel()
    mass, damping, stiffness, pushes = (numeric(x, values) for x in (lin.M, lin.C, lin.K, lin.input_matrix))
    places, speeds, slopes = (numeric(x, values) for x in (lin.basis, lin.velocity_basis, lin.velocity_slope))
    parts = (state, mass, damping, stiffness, pushes, places, speeds, slopes)
    if any(np.iscomplexobj(part) or not np.isfinite(part).all() for part in parts) or abs(np.linalg.det(mass)) < 1e-12:
        return [], [float("nan")]
    time = float(values[t])
    parameters = {p: float(values[p]) for p in point.form.statement.parameters}
    # Independent velocities are some of all, however the others change along the motion.
    jacobian = model.jacobian(time, state, parameters)[n:][lin.speeds]
    compiled = np.hstack([jacobian[:, :n] @ places + jacobian[:, n:] @ slopes, jacobian[:, n:] @ speeds])
    formulas = np.linalg.solve(mass, np.hstack([-stiffness, -damping]))
    scale = max(1e-300, np.abs(compiled).max())
    for k, u in enumerate(point.inputs):
        # To one side: an input that is declared positive may not be below zero.
        near, here, far = (
            model.rhs(time, state, {**parameters, u: parameters[u] + share * INPUT_STEP})[n:] for share in (1, 0, 2)
        )
        column = (4 * near - 3 * here - far) / (2 * INPUT_STEP)
        found = speeds @ np.linalg.solve(mass, pushes[:, k])
        if np.abs(found - column).max() > INPUT_ERROR * max(scale, np.abs(column).max()):
            return [*column], [*found]
    return [*compiled.ravel()], [*formulas.ravel()]
