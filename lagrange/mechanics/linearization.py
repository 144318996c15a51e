"""Equations of motion linearised about a point, and verified against the compiled model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.equations.regularity import known_statement
from lagrange.errors import StatementError, formula, listing
from lagrange.evidence.agreement import agrees, compared
from lagrange.evidence.sample import Point
from lagrange.machine.model import Model, Stated
from lagrange.mechanics.constrained_expansion import expansion
from lagrange.mechanics.plain_form import PlainForm, numeric, simplest
from lagrange.mechanics.point import StatedPoint, stated_point, with_inputs_as_parameters
from lagrange.statement.coordinate import t
from lagrange.statement.given import require_values
from lagrange.statement.notebook_page import ShownAsPage
from lagrange.statement.statement import Statement

INFINITE = (sympy.nan, sympy.zoo, sympy.oo, sympy.AccumBounds)
"""SymPy's results for an expression without a finite value."""


@dataclass(frozen=True, eq=False)
class Linearization(ShownAsPage):
    """Linear equations M x'' + C x' + K x = (input matrix) u about a point, in SymPy matrices.

    x are the deviations of `coordinates`: all coordinates, or the independent ones if there are constraints. The
    deviations of all coordinates are `basis` x. x' are the deviations of the velocities of `velocity_coordinates`,
    which are fewer if there are constraints on velocities. The deviations of all velocities are `velocity_basis` x' +
    `velocity_slope` x. `equilibrium` is true if the point is an equilibrium, or a steady motion with the stated
    velocities; `note` is the same as a sentence. `statement` is the statement of the system.
    """

    coordinates: tuple[Any, ...]
    velocity_coordinates: tuple[Any, ...]
    at: Mapping[Any, Any]
    M: Any
    C: Any
    K: Any
    inputs: tuple[Any, ...]
    input_matrix: Any
    basis: Any
    velocity_basis: Any
    velocity_slope: Any
    equilibrium: bool
    note: str
    statement: Statement

    def __repr__(self) -> str:
        return f"<Linearization: {self.note} M = {self.M.tolist()}, C = {self.C.tolist()}, K = {self.K.tolist()}>"

    def __reduce__(self) -> tuple[Any, ...]:
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return _again, ({**values, "at": dict(self.at)},)

    @cached_property
    def A(self) -> Any:
        """Matrix A of the first-order form d/dt [x, x'] = A [x, x'] + B u."""
        rates = self._inverse * sympy.Matrix.hstack(-self.K, -self.C)
        above = sympy.Matrix.hstack(self.velocity_slope, self.velocity_basis).extract(
            self.places, list(range(rates.cols))
        )
        return sympy.Matrix.vstack(above, rates).applyfunc(simplest)

    @property
    def decimal(self) -> bool:
        """True if the matrices contain decimals. They then hold only for the present values of the parameters."""
        return any(x.has(sympy.Float) for x in (*self.M, *self.C, *self.K))

    @property
    def places(self) -> list[int]:
        """The indices of `coordinates` among those of the system."""
        return [self.statement.coordinates.index(q) for q in self.coordinates]

    @property
    def speeds(self) -> list[int]:
        """The indices of `velocity_coordinates` among the coordinates of the system."""
        return [self.statement.coordinates.index(q) for q in self.velocity_coordinates]

    def of_moving(self) -> Linearization | None:
        """Return the equations in `velocity_coordinates` alone, or None if they depend on other coordinates."""
        kept = [k for k, q in enumerate(self.coordinates) if q in self.velocity_coordinates]
        others = [k for k in range(self.K.cols) if k not in kept]
        rows = list(range(self.K.rows))
        if not self.K.extract(rows, others).is_zero_matrix:
            return None
        everywhere = list(range(self.basis.rows))
        return replace(
            self,
            coordinates=self.velocity_coordinates,
            K=self.K.extract(rows, kept),
            basis=self.basis.extract(everywhere, kept),
            velocity_slope=self.velocity_slope.extract(everywhere, kept),
        )

    @cached_property
    def B(self) -> Any:
        """Input matrix B of the first-order form, (2n, number of inputs)."""
        below = (self._inverse * self.input_matrix).applyfunc(simplest)
        return sympy.Matrix.vstack(sympy.zeros(self.K.cols, below.cols), below)

    @cached_property
    def _inverse(self) -> Any:
        """Inverse of M. Raises StatementError if M is singular at the point."""
        determinant = simplest(self.M.det(method="berkowitz"))
        if determinant == 0:
            raise StatementError(
                "the mass matrix is singular at this point, so that A and B do not exist: M, C and K do. Choose "
                "coordinates that are regular there."
            )
        return (self.M.adjugate() / determinant).applyfunc(simplest)


def _again(values: dict[str, Any]) -> Linearization:
    return Linearization(**{**values, "at": MappingProxyType(values["at"])})


def linearized(system: Stated, at: Any, inputs: Any) -> Linearization:
    """Return the linearization of a system, compared with its compiled model; see `lagrange.System.linearize`."""
    statement, at, inputs = with_inputs_as_parameters(system.statement, at, inputs)
    system = system if statement is system.statement else system.from_statement(statement)
    require_values(statement)
    point = stated_point(known_statement(statement), at, inputs)
    linearization = linearized_at(point)
    check(linearization, point, system.compile("numpy", check=False))
    return linearization


def linearized_at(point: StatedPoint) -> Linearization:
    """Return the linearization about a point. Raises StatementError if the forces or their slopes have no value there.

    `Analysis.linearize` describes the arguments.
    """
    if point.form.statement.constraints:
        return _constrained(point)
    form = point.form
    rest = [simplest(r.xreplace(dict.fromkeys(form.a, sympy.S.Zero)).xreplace(point.table)) for r in point.residuals]
    mass = _matrix(form.a, point)
    still = dict.fromkeys(form.a, sympy.S.Zero)
    damping, stiffness = (_matrix(symbols, point, still) for symbols in (form.v, form.q))
    if any(x.has(*INFINITE) for x in (*rest, *mass, *damping, *stiffness)):
        raise StatementError(
            f"the forces of {form.statement.name}, or their derivatives, have no value at {point.where}: choose "
            "another point, or coordinates that are regular at it."
        )
    balanced = all(point.is_zero(r, stiffness) for r in rest)
    here = still
    if not balanced:
        here = dict(zip(form.a, _accelerations(form, mass, rest), strict=True))
        damping, stiffness = (_matrix(symbols, point, here) for symbols in (form.v, form.q))
    steady = all(
        speed == 0 or all(point.is_zero(x, ()) for x in (*stiffness[:, i], *stiffness[i, :]))
        for i, speed in enumerate(point.v)
    )
    eye = sympy.eye(len(form.q))
    return Linearization(
        coordinates=form.statement.coordinates,
        velocity_coordinates=form.statement.coordinates,
        at=_at(point),
        M=mass,
        C=damping,
        K=stiffness,
        inputs=tuple(point.inputs),
        input_matrix=-_matrix(tuple(point.inputs), point, here),
        basis=eye,
        velocity_basis=eye,
        velocity_slope=sympy.zeros(*eye.shape),
        equilibrium=balanced and steady,
        note=_note(point, [-r for r in rest], form.statement.names, balanced, steady),
        statement=point.form.statement,
    )


def _matrix(symbols: Sequence[Any], point: StatedPoint, here: Mapping[Any, Any] | None = None) -> Any:
    """Return the Jacobian of the residuals with respect to `symbols` at the point, where `here` replaces symbols."""
    table = point.table
    rows = [[simplest(r.diff(x).xreplace(dict(here or {})).xreplace(table)) for x in symbols] for r in point.residuals]
    return sympy.Matrix(len(rows), len(symbols), [x for row in rows for x in row])


def _accelerations(form: PlainForm, mass: Any, rest: Sequence[Any]) -> tuple[Any, ...]:
    """Return the accelerations -M^-1 `rest` at a point that is not an equilibrium."""
    determinant = simplest(mass.det(method="berkowitz"))
    if determinant == 0:
        raise StatementError(
            f"the mass matrix of {form.statement.name} is singular at this point, which is no equilibrium: its "
            "accelerations are not determined there. Choose another point."
        )
    return tuple(simplest(-x / determinant) for x in mass.adjugate() * sympy.Matrix(rest))


def _at(point: StatedPoint) -> Mapping[Any, Any]:
    """Return the point in the user's symbols: coordinates, non-zero velocities, and inputs."""
    statement = point.form.statement
    places = dict(zip(statement.coordinates, point.q, strict=True))
    speeds = {v: x for v, x in zip(statement.velocities, point.v, strict=True) if x != 0}
    return MappingProxyType(places | speeds | dict(point.inputs))


def _constrained(point: StatedPoint) -> Linearization:
    """Return the linearization in independent coordinates, about a point on the constraints."""
    statement, parts = point.form.statement, expansion(point)
    balanced = all(point.is_zero(x, parts.K) for x in parts.left)
    moving = [k for k, i in enumerate(parts.places) if point.v[i] != 0]
    rows = [k for k, i in enumerate(parts.speeds) if point.v[i] != 0]
    steady = all(point.is_zero(x, ()) for k in moving for x in parts.K[:, k])
    steady = steady and all(point.is_zero(x, ()) for k in rows for x in parts.K[k, :])
    return Linearization(
        coordinates=tuple(statement.coordinates[i] for i in parts.places),
        velocity_coordinates=tuple(statement.coordinates[i] for i in parts.speeds),
        at=_at(point),
        M=parts.M,
        C=parts.C,
        K=parts.K,
        inputs=tuple(point.inputs),
        input_matrix=parts.input_matrix,
        basis=parts.basis,
        velocity_basis=parts.velocity_basis,
        velocity_slope=parts.velocity_slope,
        equilibrium=balanced and steady,
        note=_note(point, parts.left, [statement.names[i] for i in parts.speeds], balanced, steady),
        statement=statement,
    )


def _note(point: StatedPoint, left: Sequence[Any], names: Sequence[str], balanced: bool, steady: bool) -> str:
    """Return a sentence on the point; `left` are the unbalanced forces along the coordinates `names`."""
    form = point.form
    if balanced and steady:
        on_constraints = " on the constraints" if form.statement.constraints else ""
        return f"About {'a steady motion' if any(point.v) else 'an equilibrium'}{on_constraints}."
    if balanced:
        moving = listing(name for name, v in zip(form.statement.names, point.v, strict=True) if v != 0)
        return f"Away from equilibrium: {moving} moves, and the matrices hold at this instant."
    parts = [
        f"{formula(form.written(force), 80)} on {name}"
        for name, force in zip(names, left, strict=True)
        if not point.is_zero(force, ())
    ]
    return f"Away from equilibrium: the forces left are {listing(parts)}, and the matrices hold at this instant."


INPUT_STEP = 1e-3
"""Step of an input in the numerical derivative that B is compared with: exact for forces linear in the input."""

INPUT_ERROR = 1e-5
"""Largest difference of B from that derivative, relative to the largest entry: allows for curvature over the step."""


def check(lin: Linearization, point: StatedPoint, model: Model) -> None:
    """Compare a linearization with the compiled model, at the parameter values and at random ones.

    Raises RunError if they differ.
    """
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
    """Return exact numbers for the parameters, the inputs and the time of a sample."""
    numbers = {p: sympy.Rational(x) for p, x in sample.parameters.items()} | {t: sympy.Rational(sample.t)}
    return numbers | {u: x.xreplace(numbers) for u, x in point.inputs.items()}


def _both(lin: Linearization, point: StatedPoint, model: Model, values: Any) -> tuple[Any, Any]:
    """Return the lower half of A from the compiled model and from the matrices, flattened.

    If a column of B differs, return both versions of that column instead. NaN if the matrices have no values.
    """
    n = len(point.q)
    state = numeric(sympy.Matrix([*point.q, *point.v]), values).ravel()
    mass, damping, stiffness, pushes = (numeric(x, values) for x in (lin.M, lin.C, lin.K, lin.input_matrix))
    places, speeds, slopes = (numeric(x, values) for x in (lin.basis, lin.velocity_basis, lin.velocity_slope))
    parts = (state, mass, damping, stiffness, pushes, places, speeds, slopes)
    if any(np.iscomplexobj(part) or not np.isfinite(part).all() for part in parts) or abs(np.linalg.det(mass)) < 1e-12:
        return [], [float("nan")]
    time = float(values[t])
    parameters = {p: float(values[p]) for p in point.form.statement.parameters}
    # The independent velocities are a selection of all velocities, so their rates are rows of the full Jacobian.
    jacobian = model.jacobian(time, state, parameters)[n:][lin.speeds]
    compiled = np.hstack([jacobian[:, :n] @ places + jacobian[:, n:] @ slopes, jacobian[:, n:] @ speeds])
    formulas = np.linalg.solve(mass, np.hstack([-stiffness, -damping]))
    scale = max(1e-300, np.abs(compiled).max())
    for k, u in enumerate(point.inputs):
        # One-sided difference: an input declared positive must not become negative.
        near, here, far = (
            model.rhs(time, state, {**parameters, u: parameters[u] + share * INPUT_STEP})[n:] for share in (1, 0, 2)
        )
        column = (4 * near - 3 * here - far) / (2 * INPUT_STEP)
        symbolic = speeds @ np.linalg.solve(mass, pushes[:, k])
        if np.abs(symbolic - column).max() > INPUT_ERROR * max(scale, np.abs(column).max()):
            return [*column], [*symbolic]
    return [*compiled.ravel()], [*formulas.ravel()]
