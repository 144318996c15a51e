"""Equations of motion expanded about a motion on constraints, in independent coordinates and velocities.

The residual is r(q, v, a) - G^T lambda, the velocity constraints are psi(q, v) = 0 (a holonomic one differentiated),
G = dpsi/dv and P = dpsi/dq. Changes of positions are dq = B z, with B in the null space of the gradients of the
holonomic constraints. Changes of velocities are dv = N u + L z, with G N = 0 and G L = -P B. In the rows of independent
coordinates B and N have the rows of a unit matrix, and L zeros; the rows of dv give z'. The rate of dv along the motion
is the change of the accelerations. N^T times the change of the residual is free of changes of lambda.
Source: A. L. Schwab, J. P. Meijaard, Dynamics of flexible multibody systems with non-holonomic constraints, Multibody
System Dynamics 10, 2003.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.errors import StatementError, formula
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node
from lagrange.graph.rebuild import substitute
from lagrange.mechanics.corners import edges
from lagrange.mechanics.plain_form import numeric, simplest
from lagrange.mechanics.point import StatedPoint
from lagrange.statement.coordinate import t

ROUNDING = 1e-9
"""Part of the largest entry of a row below which an entry left by elimination counts as zero."""

Rows = Sequence[Sequence[Node]]


@dataclass(frozen=True)
class Expansion:
    """M u' + C u + K z = (input matrix) u_input and z' = the rows `places` of N u + L z, SymPy matrices.

    `basis` is B, `velocity_basis` N and `velocity_slope` L. `places` are the indices of the independent coordinates,
    `speeds` those of the coordinates with independent velocities, along which the forces `left` are not balanced.
    """

    M: Any
    C: Any
    K: Any
    input_matrix: Any
    basis: Any
    velocity_basis: Any
    velocity_slope: Any
    places: tuple[int, ...]
    speeds: tuple[int, ...]
    left: tuple[Any, ...]


class AtPoint:
    """Expressions and nodes of a system at a point."""

    def __init__(self, point: StatedPoint) -> None:
        self.point, self.form, self.statement = point, point.form, point.form.statement
        self.equations = euler_lagrange(self.statement)
        self.n, graph = len(self.form.q), self.equations.graph
        self.a = [graph.symbol(f"acceleration {i}", Binding.ACCELERATION) for i in range(self.n)]
        e = self.equations
        names = dict(zip((*self.form.q, *self.form.v), (*e.q, *e.v), strict=True))
        self.here = {names[x] if x in names else e.translate(x): e.translate(value) for x, value in point.table.items()}

    def matrix(self, rows: Rows, columns: int) -> Any:
        """Return nodes as a matrix of expressions in parameters."""
        nodes = substitute([x for row in rows for x in row], self.here)
        return sympy.Matrix(len(rows), columns, [self._value(x) for x in nodes])

    def _value(self, node: Node) -> Any:
        found = self.equations.express(node)
        if self.point.decimal:
            found = sympy.Float(float(sympy.N(found, 30))) if found.is_number else sympy.N(found, 17)
        if found.has(sympy.nan, sympy.zoo, sympy.oo):
            raise StatementError(
                f"the forces or constraints of {self.statement.name}, or their derivatives, have no value at "
                f"{self.point.where}: choose another point, or coordinates that are regular at it."
            )
        return self.short(found)

    def short(self, given: Any) -> Any:
        """Return an expression in a short form, 0 where it vanishes."""
        if not given.args:
            return given
        if not self.point.decimal and self.point.is_zero(given, ()):
            return sympy.S.Zero
        return simplest(given)

    def product(self, *factors: Any) -> Any:
        """Return the product of matrices, its entries in a short form."""
        result = factors[0]
        for factor in factors[1:]:
            result = (result * factor).applyfunc(self.short)
        return result

    def slopes(self, nodes: Iterable[Node], symbols: Sequence[Node]) -> list[list[Node]]:
        """Return the derivatives of nodes by symbols, a row for each node."""
        listed = list(nodes)
        columns = [tangents(listed, {x: self.equations.graph.one}) for x in symbols]
        return [[column(node) for column in columns] for node in listed]

    def rates(self, rows: Rows) -> list[list[Node]]:
        """Return the total time derivatives of nodes in q, v and t; what rests at the point is left out."""
        e = self.equations
        motion = (*zip(e.q, e.v, strict=True), *zip(e.v, self.a, strict=True))
        moving = {x: rate for x, rate in motion if self.here[rate] is not e.graph.zero}
        along = tangents([x for row in rows for x in row], {**moving, **e.graph.rates})
        return [[along(x) for x in row] for row in rows]


class Elimination:
    """The m independent rows G of constraint gradients at a point, solved for m dependent coordinates."""

    def __init__(self, here: AtPoint, rows: Rows) -> None:
        self.here, gradient = here, here.matrix(rows, here.n)
        self.kept, self.dependent = _pivots(gradient)
        self.independent = [i for i in range(here.n) if i not in self.dependent]
        self.gradient = gradient.extract(self.kept, list(range(here.n)))

    @cached_property
    def inverse(self) -> Any:
        """The inverse of G in the dependent columns, eliminated with the shortest pivot of each column."""
        m, short = len(self.kept), self.here.short
        wide = sympy.Matrix.hstack(self.gradient.extract(list(range(m)), self.dependent), sympy.eye(m))
        for j in range(m):
            candidates = [i for i in range(j, m) if wide[i, j] != 0]
            if wide.has(sympy.Float):
                candidates = [max(candidates, key=lambda i: abs(complex(wide[i, j])) if wide[i, j].is_number else 1.0)]
            wide.row_swap(j, min(candidates, key=lambda i: (sympy.count_ops(wide[i, j]), i)))
            wide[j, :] = (wide[j, :] / wide[j, j]).applyfunc(short)
            for i in range(m):
                if i != j and wide[i, j] != 0:
                    wide[i, :] = (wide[i, :] - wide[i, j] * wide[j, :]).applyfunc(short)
        return wide[:, m:]

    def solved(self, right: Any) -> Any:
        """Return X, n rows, with G X = -`right` and zeros for independent coordinates."""
        whole = sympy.zeros(self.here.n, right.cols)
        if self.kept:
            below = self.here.product(-self.inverse, right)
            for k, i in enumerate(self.dependent):
                whole[i, :] = below[k, :]
        return whole

    @cached_property
    def null_space(self) -> Any:
        """A basis of the null space of G, with a one in the row of each independent coordinate."""
        unit = sympy.eye(self.here.n).extract(list(range(self.here.n)), self.independent)
        return unit + self.solved(self.gradient * unit)

    def balance(self, forces: Any) -> Any:
        """Return lambda with G^T lambda = `forces` in the rows of dependent coordinates."""
        return self.here.product(self.inverse.T, forces.extract(self.dependent, [0]))


def _pivots(gradient: Any) -> tuple[list[int], list[int]]:
    """Return the independent rows of a matrix, and columns in which they are regular, the leftmost such columns."""
    symbols = sorted(gradient.free_symbols, key=str)
    left = numeric(gradient, {s: sympy.Rational(13 + 7 * k, 10 + k) for k, s in enumerate(symbols)})
    rows: list[int] = []
    columns: list[int] = []
    sizes = np.abs(left).max(axis=1, initial=0.0)
    for j in range(gradient.cols):
        share = np.abs(left[:, j]) / np.where(sizes > 0, sizes, 1.0)
        share[rows] = 0.0
        if len(left) and share.max() > ROUNDING:
            pivot = int(share.argmax())
            rows.append(pivot)
            columns.append(j)
            others = np.arange(len(left)) != pivot
            left = left - np.outer(np.where(others, left[:, j] / left[pivot, j], 0.0), left[pivot])
    return sorted(rows), columns


def expansion(point: StatedPoint) -> Expansion:
    """Return the equations of small changes about a point.

    Raises StatementError for a point off the constraints, and where these are dependent or leave no motion.
    """
    statement = point.form.statement
    stated = (statement.lagrangian, statement.dissipation, *statement.forces)
    if any(edges(point.form.read(x)) for x in stated):
        _ = point.residuals  # refuses a corner that matters; at any other both sides have the same derivatives
    here = AtPoint(point)
    e, held = here.equations, here.equations.stated
    _check(here)
    speeds, mass = Elimination(here, held.gradient), here.matrix(e.mass, here.n)
    if any(x.is_number and x.atoms(sympy.Function) for x in (*mass, *speeds.gradient)):
        decimals = point.in_decimals()  # sums of numbers such as sin(1/3) grow with every elimination
        if decimals.decimal and not point.decimal:
            return expansion(decimals)
    if len(speeds.kept) < len(held) and statement.redundant == "refuse":
        raise StatementError("the constraints are dependent at this point, so that it has no linearization.")
    if not speeds.independent:
        raise StatementError("the constraints leave no motion: there is nothing to linearise.")
    kept = held.part(speeds.kept)
    holonomic = [row for row, phi in zip(kept.gradient, kept.positions, strict=True) if phi is not None]
    places = Elimination(here, holonomic)
    N, B, product = speeds.null_space, places.null_space, here.product
    reduced = product(N.T, mass, N)
    rest = here.matrix([[h] for h in e.bias], 1)
    carried = speeds.solved(here.matrix([[gamma] for gamma in kept.bias], 1))
    left = product(N.T, rest - product(mass, carried))
    accelerations = carried + product(N, _driven(here, reduced, left))
    here.here |= {a: e.translate(x) for a, x in zip(here.a, accelerations, strict=True)}
    multipliers = speeds.balance(mass * accelerations - rest) if len(kept) else ()
    residuals = _residuals(here, kept.gradient, multipliers)
    P = here.slopes(kept.velocities, e.q)
    p, g_rate, p_rate, phi_rate = (
        here.matrix(rows, here.n) for rows in (P, here.rates(kept.gradient), here.rates(P), here.rates(holonomic))
    )
    L = speeds.solved(product(p, B))
    N_rate, B_rate = speeds.solved(product(g_rate, N)), places.solved(product(phi_rate, B))
    L_rate = speeds.solved(product(g_rate, L) + product(p_rate, B) + product(p, B_rate))
    N_rows, L_rows = (x.extract(places.independent, list(range(x.cols))) for x in (N, L))
    damping, stiffness = (here.matrix(here.slopes(residuals, x), here.n) for x in (e.v, e.q))
    inputs = [e.translate(u) for u in point.inputs]
    return Expansion(
        M=reduced,
        C=product(N.T, product(mass, N_rate + product(L, N_rows)) + product(damping, N)),
        K=product(N.T, product(mass, L_rate + product(L, L_rows)) + product(damping, L) + product(stiffness, B)),
        input_matrix=product(-N.T, here.matrix(here.slopes(residuals, inputs), len(inputs))),
        basis=B,
        velocity_basis=N,
        velocity_slope=L,
        places=tuple(places.independent),
        speeds=tuple(speeds.independent),
        left=tuple(left),
    )


def _check(here: AtPoint) -> None:
    """Refuse a point that is not on the constraints, by position or velocity."""
    held = here.equations.stated
    for one, phi, psi in zip(here.statement.constraints, held.positions, held.velocities, strict=True):
        if one.expression.xreplace(here.form.plain).has(t):
            raise StatementError(f"the constraint {one.name!r} moves with time, and no point stays on it.")
        for node, subject, names in ((phi, "point is", "coordinates"), (psi, "velocities are", "velocities")):
            value = sympy.S.Zero if node is None else here.matrix([[node]], 1)[0]
            if not here.point.is_zero(value, ()):
                raise StatementError(
                    f"the {subject} not on the constraint {one.name!r}, which is {formula(value, 80)} there and not "
                    f"zero: give values of all {names} in it."
                )


def _driven(here: AtPoint, mass: Any, left: Any) -> Any:
    """Return the accelerations that forces make of independent velocities."""
    if left.is_zero_matrix:
        return left
    if mass.has(sympy.Float):
        return mass.LUsolve(left)
    determinant = here.short(mass.det(method="berkowitz"))
    if determinant == 0:
        raise StatementError(
            f"the mass matrix of {here.statement.name} is singular at this point, which is no equilibrium: its "
            "accelerations are not determined there. Choose another point."
        )
    return here.product(mass.adjugate(), left / determinant)


def _residuals(here: AtPoint, gradient: Rows, multipliers: Sequence[Any]) -> list[Node]:
    """Return M a - h - G^T lambda; accelerations that are zero are left out."""
    e = here.equations
    a = [here.here[x] if here.here[x] is e.graph.zero else x for x in here.a]
    forces = [e.translate(x) for x in multipliers]
    return [
        e.graph.sum(
            [
                *((1, m * x) for m, x in zip(row, a, strict=True)),
                (-1, h),
                *((-1, line[i] * force) for line, force in zip(gradient, forces, strict=True)),
            ]
        )
        for i, (row, h) in enumerate(zip(e.mass, e.bias, strict=True))
    ]
