"""Linear equations of systems with rotations, in small turns of the bodies about their own axes.

With the residual r of the equations of a derivation, M = dr/da, C = dr/dv and K = dr/dx. Small turns x change the rates
w of a body by x' + w x x, and its accelerations by x'' + w x x' + w' x x, with cross products. With the matrices W and
W' of these products, M x'' + (M W + C) x' + (M W' + C W + K) x = 0. A body that spins steadily has constant matrices.
Constraints psi = 0 on rates have the gradient G by rates, and G x' + (dpsi/dx + G W) x = 0; `linearization` describes
how they are solved.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.errors import FAULT, RunError, StatementError, formula
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model, Stated
from lagrange.mechanics.expansion import BALANCED_FORCE, INPUT_REMEDY, stated_values, with_inputs_as_parameters
from lagrange.mechanics.linearization import DependentCoordinates, Linearization, TangentMotion
from lagrange.mechanics.linearization import linearized as in_coordinates
from lagrange.mechanics.plain_form import Shortener, number, numeric, simplest, vanishes_in_symbols
from lagrange.statement.coordinate import acceleration_of, multiplier, t, velocity_of
from lagrange.statement.given.function import require_values
from lagrange.statement.rotation import Rotation, rotation_of
from lagrange.statement.space import body_rates, cross_matrix, matrix_of, velocities_at, x, y, z

LARGEST_DIFFERENCE = 1e-7
"""Largest difference from the Jacobian of the compiled model, relative to its largest entry: both have ten digits."""


def linearized(system: Stated, at: Any, inputs: Any) -> Linearization:
    """Return the linearization of a system about the point `at`, after comparing it with the compiled model.

    Rotations appear as small turns. Raises StatementError for a singular mass matrix, and for a point off the
    constraints.
    """
    if system.statement.reading is None:
        return in_coordinates(system, at, inputs)
    statement, at, inputs = with_inputs_as_parameters(system.statement, at, inputs)
    system = system if statement is system.statement else system.from_statement(statement)
    require_values(statement, INPUT_REMEDY)
    in_turns = _InTurns(system, at, inputs)
    linearization = in_turns.linearization()
    in_turns.compare(linearization, system.compile("numpy", check=False))
    return linearization


class _InTurns:
    """Equations of motion in small turns of bodies about their own axes, and their derivatives at a point.

    In the expressions, `symbols` replace the leaves: coordinates, rates, entries of rotations, accelerations,
    multipliers and inputs.
    """

    def __init__(self, system: Stated, at: Any, inputs: Any) -> None:
        self.statement, self.read = system.statement, system.statement.as_read
        self.values, self.inputs = stated_values(self.statement, at, inputs)
        self.at = dict(at or {})
        self.n = len(self.read.coordinates)
        self.velocities = tuple(map(velocity_of, self.read.coordinates))
        self.second = tuple(map(acceleration_of, self.read.coordinates))
        self.forces = tuple(multiplier(each.name) for each in self.read.constraints)
        self.shortener = Shortener(
            f"the linear equations of {self.statement.name} about this point", vanishes_in_symbols
        )
        self.here = {leaf: self.values.get(leaf, sympy.S.Zero) for leaf in (*self.read.coordinates, *self.velocities)}
        self.here |= {u: self.values.get(u, sympy.S.Zero) for u in self.inputs}
        for _, each in self.bodies():
            q, v = self.quaternion(each)
            self.here |= dict(zip(map(velocity_of, each.turns), body_rates(q, v), strict=True))
            self.here |= dict(zip(each.matrix, chain(*matrix_of(q)), strict=True))
        leaves = (*self.here, *self.second, *self.forces)
        self.symbols = {leaf: sympy.Dummy() for leaf in leaves}
        laws = system.derivation().equations[: self.n]
        self.laws = [(law.lhs - law.rhs).xreplace(self.symbols) for law in laws]
        self.still = dict.fromkeys((*self.second, *self.forces), sympy.S.Zero)
        self.mass = self.slopes(self.second, self.still)
        self.rest = sympy.Matrix([self.value(law, self.still) for law in self.laws])
        self.constrain()

    def bodies(self) -> Iterator[tuple[int, Rotation]]:
        """Yield (index of its first turn among the coordinates, rotation) for each rotation."""
        first = self.n - 3 * len(self.statement.rotations)
        return zip(range(first, self.n, 3), map(rotation_of, self.statement.rotations), strict=True)

    def quaternion(self, each: Rotation) -> tuple[list[Any], list[Any]]:
        """Return the entries of the quaternion of a rotation, and their velocities, at the point."""
        return [self.values[q] for q in each.quaternion], [self.values[velocity_of(q)] for q in each.quaternion]

    def value(self, expression: Any, more: Mapping[Any, Any]) -> Any:
        """Return the value of an expression in `symbols` at the point.

        `more` has the accelerations and multipliers.
        """
        table = {self.symbols[leaf]: value for leaf, value in (*self.here.items(), *more.items())}
        return simplest(expression.xreplace(table))

    @property
    def decimal(self) -> bool:
        """True if the point contains decimals, so that it is valid only for the present values of the parameters."""
        return any(value.has(sympy.Float) for value in self.values.values())

    def is_zero(self, *expressions: Any) -> bool:
        """Return True if expressions in parameters are zero. At a point in decimals the limit is 1e-8, numerically."""
        values = dict.fromkeys(self.statement.parameters, 1.0) | dict(self.statement.defaults)
        return all(
            abs(number(each, values)) <= BALANCED_FORCE if self.decimal else self.shortener.short(each) == 0
            for each in expressions
        )

    def slopes(self, leaves: Sequence[Any], more_values: Mapping[Any, Any]) -> Any:
        """Return the derivatives of the residuals by `leaves` at the point, a matrix with a row for each residual.

        `more_values` has the accelerations and multipliers at the point.
        """
        rows = [[self.value(law.diff(self.symbols[leaf]), more_values) for leaf in leaves] for law in self.laws]
        return sympy.Matrix(self.n, len(leaves), list(chain(*rows)))

    def changes(self, expression: Any) -> list[Any]:
        """Return n derivatives of an expression in `symbols`: by coordinates, and for rotations along small turns."""
        derivatives = [expression.diff(self.symbols[q]) for q in self.read.coordinates]
        for first, each in self.bodies():
            rotation = each.matrix.applyfunc(self.symbols.__getitem__)
            by_entry = [expression.diff(entry) for entry in rotation]
            for k, unit in enumerate((x, y, z)):
                derivatives[first + k] = sympy.Add(
                    *(slope * moved for slope, moved in zip(by_entry, rotation * cross_matrix(unit), strict=True))
                )
        return derivatives

    def rates(self, matrix: Any, accelerations: Any) -> Any:
        """Return the time derivative, along the motion, of a `matrix` in `symbols` at the point."""
        ahead = sympy.Dummy()
        rates = dict(zip(self.read.coordinates, (self.here[v] for v in self.velocities), strict=True))
        rates |= dict(zip(self.velocities, accelerations, strict=True))
        for _, each in self.bodies():
            rotation = each.matrix.applyfunc(self.here.__getitem__)
            speeds = [self.here[velocity_of(turn)] for turn in each.turns]
            rates |= dict(zip(each.matrix, rotation * cross_matrix(speeds), strict=True))
        moved = {self.symbols[leaf]: value + ahead * rates.get(leaf, 0) for leaf, value in self.here.items()}
        return matrix.applyfunc(
            lambda entry: self.shortener.short(entry.xreplace(moved).diff(ahead).xreplace({ahead: sympy.S.Zero}))
        )

    def constrain(self) -> None:
        """Set the gradients of the constraints, and choose independent coordinates and velocities.

        Raises StatementError for a point off the constraints.
        """
        constraints = [(c, c.expression.xreplace(self.symbols)) for c in self.read.constraints]
        holonomic, speeds = [phi for c, phi in constraints if c.holonomic], [self.symbols[v] for v in self.velocities]
        self.levels = [
            sympy.Add(*(slope * v for slope, v in zip(self.changes(phi), speeds, strict=True))) if c.holonomic else phi
            for c, phi in constraints
        ]
        for (c, phi), psi in zip(constraints, self.levels, strict=True):
            if phi.has(t):
                raise StatementError(f"the constraint {c.name!r} depends on time: no point satisfies it at all times.")
            pairs = ((phi, "point is", "coordinates"), (psi, "velocities are", "velocities"))
            for level, subject, names in pairs if c.holonomic else pairs[1:]:
                if not self.is_zero(value := self.value(level, self.still)):
                    raise StatementError(
                        f"the {subject} not on the constraint {c.name!r}, which is {formula(value, 80)} there and not "
                        f"zero: give values of all {names} in it."
                    )
        self.G = sympy.Matrix(len(constraints), self.n, [psi.diff(v) for psi in self.levels for v in speeds])
        self.P = sympy.Matrix(len(constraints), self.n, list(chain(*map(self.changes, self.levels))))
        self.P += self.G * self.swirl(speeds)
        self.Phi = sympy.Matrix(len(holonomic), self.n, list(chain(*map(self.changes, holonomic))))
        self.speeds, self.positions = (
            DependentCoordinates(self.shortener, self.at_point(gradient, self.still)) for gradient in (self.G, self.Phi)
        )
        if not self.speeds.independent:
            raise StatementError("the constraints leave no motion: there is nothing to linearise.")
        if len(self.speeds.kept) < len(constraints) and self.statement.redundant == "refuse":
            raise StatementError("the constraints are dependent at this point, so that it has no linearization.")

    def at_point(self, matrix: Any, more: Mapping[Any, Any]) -> Any:
        """Return the value of a matrix of expressions at the point.

        `more` has the accelerations and multipliers.
        """
        return matrix.applyfunc(lambda entry: self.shortener.short(self.value(entry, more)))

    @cached_property
    def accelerations(self) -> Any:
        """The accelerations at the point, (n, 1)."""
        N, product = self.speeds.null_space, self.shortener.product
        levels = sympy.Matrix(len(self.speeds.kept), 1, [self.levels[i] for i in self.speeds.kept])
        carried = self.speeds.solved(self.rates(levels, [0] * self.n))
        mass, left = product(N.T, self.mass, N), product(N.T, self.rest + self.mass * carried)
        if left.is_zero_matrix:
            return carried
        determinant = simplest(mass.det(method="berkowitz"))
        if determinant == 0:
            raise StatementError("the mass matrix is singular at this point: choose another one.")
        return carried - product(N, product(mass.adjugate(), left) / determinant)

    @cached_property
    def motion(self) -> dict[Any, Any]:
        """Accelerations and multipliers at the point, by symbol. Multipliers of redundant constraints are zero."""
        values = dict.fromkeys(self.forces, sympy.S.Zero) | dict(zip(self.second, self.accelerations, strict=True))
        if self.speeds.kept:
            sizes = self.speeds.balance(self.mass * self.accelerations + self.rest)
            values |= {self.forces[i]: size for i, size in zip(self.speeds.kept, sizes, strict=True)}
        return values

    @cached_property
    def tangent(self) -> TangentMotion:
        """The small motions about the point that the constraints allow."""
        everywhere = list(range(self.n))
        G, P = (each.extract(self.speeds.kept, everywhere) for each in (self.G, self.P))
        Phi = self.Phi.extract(self.positions.kept, everywhere)
        g_rate, p_rate, phi_rate = (self.rates(each, self.accelerations) for each in (G, P, Phi))
        return TangentMotion(self.speeds, self.positions, self.at_point(P, self.still), (g_rate, p_rate, phi_rate))

    def swirl(self, rates_column: Any) -> Any:
        """Return the matrix W (n, n) whose product with small turns is the cross product with the rates of each body.

        The rates of a body are the rows of its turns in `rates_column`.
        """
        matrix = sympy.zeros(self.n, self.n)
        for first, _ in self.bodies():
            matrix[first : first + 3, first : first + 3] = cross_matrix(rates_column[first : first + 3])
        return matrix

    def stiffness(self, motion_values: Mapping[Any, Any]) -> Any:
        """Return the derivatives of the residuals by coordinates and along turns at the point, (n, n)."""
        rows = [[self.value(change, motion_values) for change in self.changes(law)] for law in self.laws]
        return sympy.Matrix(self.n, self.n, list(chain(*rows)))

    def linearization(self) -> Linearization:
        """Return the linearization: the matrices M, C and K in small turns."""
        more, tangent = self.motion, self.tangent
        speeds = sympy.Matrix([self.here[v] for v in self.velocities])
        drag, slope = self.slopes(self.velocities, more), self.stiffness(more)
        swirl, change = self.swirl(speeds), self.swirl(self.accelerations)
        C, K = tangent.reduced(self.mass, self.mass * swirl + drag, self.mass * change + drag * swirl + slope)
        moving = speeds.extract(self.positions.independent, [0])
        steady = self.is_zero(*self.accelerations, *(K * moving))
        kind = "an equilibrium" if speeds.is_zero_matrix else "a steady motion"
        on_constraints = " on the constraints" if self.forces else ""
        return Linearization(
            coordinates=tuple(self.read.coordinates[i] for i in self.positions.independent),
            velocity_coordinates=tuple(self.read.coordinates[i] for i in self.speeds.independent),
            at=MappingProxyType(self.at),
            M=self.shortener.product(tangent.N.T, self.mass, tangent.N),
            C=C,
            K=K,
            inputs=tuple(self.inputs),
            input_matrix=self.shortener.product(-tangent.N.T, self.slopes(self.inputs, more)),
            basis=tangent.B,
            velocity_basis=tangent.N,
            velocity_slope=tangent.L,
            equilibrium=steady,
            note=f"About {kind}{on_constraints}."
            if steady
            else "Away from equilibrium: the matrices hold at this instant.",
            statement=self.read,
        )

    def compare(self, linearization: Linearization, model: Model) -> None:
        """Raise RunError if accelerations near the point differ from the compiled ones, at the stated parameters."""
        statement = self.statement
        if any(p not in statement.defaults for p in statement.parameters if p not in self.inputs):
            return
        numbers = {p: sympy.Float(x, 30) for p, x in statement.defaults.items()} | {t: sympy.S.Zero}
        numbers |= {u: self.values.get(u, sympy.S.Zero).xreplace(numbers) for u in self.inputs}
        leaves = (*statement.coordinates, *statement.velocities)
        y = numeric(sympy.Matrix([self.values[leaf] for leaf in leaves]), numbers).ravel()
        mass, drag, slope = (numeric(x, numbers) for x in (linearization.M, linearization.C, linearization.K))
        jacobian = model.jacobian(0.0, y, {p: float(numbers[p]) for p in statement.parameters})
        positions, rates, accelerations = self._changes(y, numeric(self.accelerations, numbers).ravel())
        tangent = self.tangent
        B, N, L, turned, bent = (
            numeric(each, numbers) for each in (tangent.B, tangent.N, tangent.L, tangent.turned, tangent.bent)
        )
        near = np.block([[B, np.zeros((self.n, N.shape[1]))], [L, N]])
        second = np.hstack([bent, turned]) + N @ np.linalg.solve(mass, -np.hstack([slope, drag]))
        expected = accelerations[:, : 2 * self.n] @ near + accelerations[:, 2 * self.n :] @ second
        compiled = jacobian[model.layout.v] @ np.vstack([positions, rates]) @ near
        if not np.abs(compiled - expected).max() <= LARGEST_DIFFERENCE * max(np.abs(compiled).max(), 1e-300):
            raise RunError(f"the linear equations of {statement.name} differ from its compiled model. {FAULT}")

    def _changes(self, y: FloatArray, pushed: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the changes of coordinates, velocities and accelerations by small turns x, as three matrices.

        The first two multiply (x, x'), the last one (x, x', x''). `y` is the state in the coordinates of the
        statement. `pushed` are the accelerations in small turns at it.
        """
        n, whole = self.n, len(self.statement.coordinates)
        changes = np.zeros((3, whole, 3 * n))
        for i, q in enumerate(self.read.coordinates):
            if q in self.statement.coordinates:
                changes[[0, 1, 2], self.statement.coordinates.index(q), [i, n + i, 2 * n + i]] = 1.0
        for first, each in self.bodies():
            rows = [self.statement.coordinates.index(q) for q in each.quaternion]
            q, moving = y[rows], y[[whole + row for row in rows]]
            w, push = np.array(body_rates(q.tolist(), moving.tolist())), pushed[first : first + 3]
            for k, unit in enumerate(np.eye(3)):
                zero = np.zeros(3)
                cases = (
                    (unit, np.cross(w, unit), np.cross(push, unit)),
                    (zero, unit, np.cross(w, unit)),
                    (zero, zero, unit),
                )
                columns = (first + k, n + first + k, 2 * n + first + k)
                for column, (turn, rate, acceleration) in zip(columns, cases, strict=True):
                    dq = _velocities(q, turn)
                    dv = _velocities(dq, w) + _velocities(q, rate)
                    da = _velocities(dv, w) + _velocities(moving, rate)
                    da += _velocities(dq, push) + _velocities(q, acceleration)
                    changes[:, rows, column] = dq, dv, da
        return changes[0, :, : 2 * n], changes[1, :, : 2 * n], changes[2]


def _velocities(q: Any, rates: Any) -> FloatArray:
    """Return the time derivatives (4,) of a quaternion `q` from its rates about the axes of the body."""
    return np.array(velocities_at(q, rates, space=False))
