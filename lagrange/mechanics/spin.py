"""Linear equations of systems with rotations, in small turns of the bodies about their own axes.

With the residual r of the equations of a derivation, M = dr/da, C = dr/dv and K = dr/dx. Small turns x change the rates
w of a body by x' + w x x, and its accelerations by x'' + w x x' + w' x x. With the matrices W and W' of these products,
M x'' + (M W + C) x' + (M W' + C W + K) x = 0. A body that spins steadily has constant matrices.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.errors import FAULT, RunError, StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model, Stated
from lagrange.mechanics.expansion import stated_values, with_inputs_as_parameters
from lagrange.mechanics.linearization import Linearization
from lagrange.mechanics.linearization import linearized as in_coordinates
from lagrange.mechanics.plain_form import numeric, simplest
from lagrange.statement.coordinate import acceleration_of, t, velocity_of
from lagrange.statement.given.function import require_values
from lagrange.statement.rotation import Rotation, rotation_of
from lagrange.statement.space import body_rates, cross_matrix, matrix_of, velocities_at, x, y, z

LARGEST_DIFFERENCE = 1e-7
"""Largest difference from the Jacobian of the compiled model, relative to its largest entry: both have ten digits."""


def linearized(system: Stated, at: Any, inputs: Any) -> Linearization:
    """Return the linearization of a system, compared with its compiled model; see `lagrange.System.linearize`.

    A system with rotations has it in small turns, unless constraints hold it at rest. Raises StatementError for a
    singular mass matrix.
    """
    if system.statement.reading is None or system.statement.constraints:
        return in_coordinates(system, at, inputs)
    statement, at, inputs = with_inputs_as_parameters(system.statement, at, inputs)
    system = system if statement is system.statement else system.from_statement(statement)
    require_values(statement)
    made = _InTurns(system, at, inputs)
    found = made.linearization()
    made.compare(found, system.compile("numpy", check=False))
    return found


class _InTurns:
    """The equations of a derivation at a point, and their derivatives there."""

    def __init__(self, system: Stated, at: Any, inputs: Any) -> None:
        self.statement, self.read = system.statement, system.statement.as_read
        self.values, self.inputs = stated_values(self.statement, at, inputs)
        self.at = dict(at or {})
        self.n = len(self.read.coordinates)
        self.velocities = tuple(map(velocity_of, self.read.coordinates))
        self.second = tuple(map(acceleration_of, self.read.coordinates))
        self.here = {leaf: self.values.get(leaf, sympy.S.Zero) for leaf in (*self.read.coordinates, *self.velocities)}
        self.here |= {u: self.values.get(u, sympy.S.Zero) for u in self.inputs}
        for _, each in self.bodies():
            q, v = self.quaternion(each)
            self.here |= dict(zip(map(velocity_of, each.turns), body_rates(q, v), strict=True))
            self.here |= dict(zip(each.matrix, chain(*matrix_of(q)), strict=True))
        leaves = (*self.here, *self.second)
        self.symbols = {leaf: sympy.Dummy() for leaf in leaves}
        laws = system.derivation().equations
        self.laws = [(law.lhs - law.rhs).xreplace(self.symbols) for law in laws]
        still = dict.fromkeys(self.second, sympy.S.Zero)
        self.mass = self.slopes(self.second, still)
        self.rest = sympy.Matrix([self.value(law, still) for law in self.laws])

    def bodies(self) -> Iterator[tuple[int, Rotation]]:
        """Yield each rotation with the index of its first turn among the coordinates."""
        first = self.n - 3 * len(self.statement.rotations)
        return zip(range(first, self.n, 3), map(rotation_of, self.statement.rotations), strict=True)

    def quaternion(self, each: Rotation) -> tuple[list[Any], list[Any]]:
        """Return the entries of a quaternion and their velocities at the point."""
        return [self.values[q] for q in each.quaternion], [self.values[velocity_of(q)] for q in each.quaternion]

    def value(self, expression: Any, more: Mapping[Any, Any]) -> Any:
        """Return an expression in `symbols` at the point, with values of more leaves."""
        table = {self.symbols[leaf]: value for leaf, value in (*self.here.items(), *more.items())}
        return simplest(expression.xreplace(table))

    def slopes(self, leaves: Sequence[Any], more: Mapping[Any, Any]) -> Any:
        """Return the derivatives of the residuals by some leaves at the point, (n, number of leaves)."""
        rows = [[self.value(law.diff(self.symbols[leaf]), more) for leaf in leaves] for law in self.laws]
        return sympy.Matrix(self.n, len(leaves), list(chain(*rows)))

    @cached_property
    def accelerations(self) -> Any:
        """The accelerations at the point, (n, 1)."""
        if self.rest.is_zero_matrix:
            return self.rest
        determinant = simplest(self.mass.det(method="berkowitz"))
        if determinant == 0:
            raise StatementError("the mass matrix is singular at this point: choose another one.")
        return (-self.mass.adjugate() * self.rest / determinant).applyfunc(simplest)

    def swirl(self, column: Any) -> Any:
        """Return the matrix W (n, n) with W x = w x x for each body. `column` has w in the rows of the turns."""
        made = sympy.zeros(self.n, self.n)
        for first, _ in self.bodies():
            made[first : first + 3, first : first + 3] = cross_matrix(column[first : first + 3])
        return made

    def stiffness(self, more: Mapping[Any, Any]) -> Any:
        """Return the derivatives of the residuals by coordinates and along turns, (n, n)."""
        made = self.slopes(self.read.coordinates, more)
        for first, each in self.bodies():
            by_entry, place = self.slopes(list(each.matrix), more), each.matrix.applyfunc(self.here.__getitem__)
            for k, unit in enumerate((x, y, z)):
                made[:, first + k] = by_entry * (place * cross_matrix(unit)).reshape(9, 1)
        return made

    def linearization(self) -> Linearization:
        """Return the linearization: the matrices M, C and K in small turns."""
        more = dict(zip(self.second, self.accelerations, strict=True))
        speeds = sympy.Matrix([self.here[v] for v in self.velocities])
        drag, slope = self.slopes(self.velocities, more), self.stiffness(more)
        balanced = bool(self.accelerations.is_zero_matrix)
        steady = balanced and bool((slope * speeds).applyfunc(simplest).is_zero_matrix)
        swirl, change, eye = self.swirl(speeds), self.swirl(self.accelerations), sympy.eye(self.n)
        kind = "an equilibrium" if speeds.is_zero_matrix else "a steady motion"
        return Linearization(
            coordinates=self.read.coordinates,
            velocity_coordinates=self.read.coordinates,
            at=MappingProxyType(self.at),
            M=self.mass,
            C=(self.mass * swirl + drag).applyfunc(simplest),
            K=(self.mass * change + drag * swirl + slope).applyfunc(simplest),
            inputs=tuple(self.inputs),
            input_matrix=-self.slopes(self.inputs, more),
            basis=eye,
            velocity_basis=eye,
            velocity_slope=sympy.zeros(self.n, self.n),
            equilibrium=steady,
            note=f"About {kind}." if steady else "Away from equilibrium: the matrices hold at this instant.",
            statement=self.read,
        )

    def compare(self, found: Linearization, model: Model) -> None:
        """Raise RunError if the compiled model has other accelerations near the point, at the parameters' values."""
        statement = self.statement
        if any(p not in statement.defaults for p in statement.parameters if p not in self.inputs):
            return
        numbers = {p: sympy.Float(x, 30) for p, x in statement.defaults.items()} | {t: sympy.S.Zero}
        numbers |= {u: self.values.get(u, sympy.S.Zero).xreplace(numbers) for u in self.inputs}
        leaves = (*statement.coordinates, *statement.velocities)
        y = numeric(sympy.Matrix([self.values[leaf] for leaf in leaves]), numbers).ravel()
        mass, drag, slope = (numeric(x, numbers) for x in (found.M, found.C, found.K))
        jacobian = model.jacobian(0.0, y, {p: float(numbers[p]) for p in statement.parameters})
        places, rates, accelerations = self._changes(y, numeric(self.accelerations, numbers).ravel())
        free = np.linalg.solve(mass, -np.hstack([slope, drag]))
        expected = accelerations[:, : 2 * self.n] + accelerations[:, 2 * self.n :] @ free
        compiled = jacobian[model.layout.v] @ np.vstack([places, rates])
        if not np.abs(compiled - expected).max() <= LARGEST_DIFFERENCE * max(np.abs(compiled).max(), 1e-300):
            raise RunError(f"the linear equations of {statement.name} differ from its compiled model. {FAULT}")

    def _changes(self, y: FloatArray, pushed: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the changes of the statement's coordinates, velocities and accelerations.

        The first two are matrices of the changes (x, x'), the last of (x, x', x''). `y` is the state, `pushed` has the
        accelerations in turns.
        """
        n, whole = self.n, len(self.statement.coordinates)
        made = np.zeros((3, whole, 3 * n))
        for i, q in enumerate(self.read.coordinates):
            if q in self.statement.coordinates:
                made[[0, 1, 2], self.statement.coordinates.index(q), [i, n + i, 2 * n + i]] = 1.0
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
                places = (first + k, n + first + k, 2 * n + first + k)
                for column, (turn, rate, acceleration) in zip(places, cases, strict=True):
                    dq = _velocities(q, turn)
                    dv = _velocities(dq, w) + _velocities(q, rate)
                    da = _velocities(dv, w) + _velocities(moving, rate)
                    da += _velocities(dq, push) + _velocities(q, acceleration)
                    made[:, rows, column] = dq, dv, da
        return made[0, :, : 2 * n], made[1, :, : 2 * n], made[2]


def _velocities(q: Any, rates: Any) -> FloatArray:
    """Return the time derivatives of a quaternion that turns with rates about the axes of the body, (4,)."""
    return np.array(velocities_at(q, rates, space=False))
