"""Compute M, C and K of a linearization in independent coordinates, for constraints, rotations and inputs.

The residual of the equations is r(q, v, a) - G^T lambda, with multipliers lambda. The constraints on velocities are
psi(q, v) = 0, where a constraint on positions is differentiated. Let G = dpsi/dv and P = dpsi/dq. Changes of positions
are dq = B z, where z are the changes of independent coordinates, and B spans the null space of the gradients of
constraints on positions. Changes of velocities are dv = N u + L z, where u are the changes of independent velocities,
G N = 0 and G L = -P B. For independent coordinates the rows of B and N are those of a unit matrix, the rows of L are
zero, and the rows of dv are z'. The rate of dv along the motion is the change of the accelerations. N^T times the
change of the residual does not contain changes of lambda. Source: A. L. Schwab, J. P. Meijaard, Dynamics of flexible
multibody systems with non-holonomic constraints, Multibody System Dynamics 10, 2003.

Rotations change by small turns x of the bodies about their own axes: dq = S x, dv = S x' + S' x, da = S x'' + 2 S' x' +
S'' x. So M, C, K of the entries of quaternions become S^T M S, S^T (2 M S' + C S) and S^T (M S'' + C S' + K S). A body
that spins steadily has constant matrices.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import sympy

from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.equations.terms import printable
from lagrange.errors import StatementError, formula, listing
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node, substitute
from lagrange.mechanics.expansion import StatedPoint
from lagrange.mechanics.plain_form import Shortener, in_fractions, numeric
from lagrange.statement.coordinate import t
from lagrange.statement.rotation import quaternion_rows
from lagrange.statement.space import body_rates, velocities_at, x, y, z

ELIMINATION_ROUNDING = 1e-9
"""Largest entry of a constraint's gradient that counts as zero in elimination, relative to the largest entry of its
row: it is a rounding error."""

Rows = Sequence[Sequence[Node]]


class SmallChanges(NamedTuple):
    """Linear equations of small changes about a point: M u' + C u + K z = (input matrix) u_input.

    z are the changes of independent coordinates, and u of independent velocities. B z are the changes of all
    coordinates, N u + L z those of all velocities, and its entries `positions` are z'. `matrices` has M, C, K, the
    input matrix, B, N and L, by their names in `Linearization`. `positions` are the indices of the independent
    coordinates, `speeds` of the coordinates with independent velocities. `unbalanced` are the forces along these
    velocities that are left at the point. `rates` are all velocities at the point, and for a body its rates about its
    own axes. `turn_matrices` are `turned` and `bent` of `TangentMotion`, then S, S', S'' of the module's description.
    """

    matrices: dict[str, Any]
    positions: list[int]
    speeds: list[int]
    unbalanced: Sequence[Any]
    rates: Sequence[Any]
    turn_matrices: tuple[Any, ...]


class AtPoint:
    """Evaluates nodes of the expression graph of a system at the point of its linearization, as SymPy expressions."""

    def __init__(self, point: StatedPoint) -> None:
        self.point, self.form, self.statement = point, point.form, point.form.statement
        e = euler_lagrange(self.statement.mapped(in_fractions))
        values = sorted(set().union(*(x.free_symbols for x in point.table.values())), key=str)
        others = {s: e.graph.symbol(f"value {s.name}", Binding.PARAMETER) for s in values if s not in e.leaves}
        self.equations = replace(e, leaves={**e.leaves, **others})
        self.n, graph = len(self.form.q), self.equations.graph
        coordinates, self.read = self.statement.coordinates, (self.statement.reading or self.statement).coordinates
        bodies = quaternion_rows(coordinates) if self.statement.rotations else ()
        self.bodies = [(each, rows) for each, rows, _ in bodies]
        self.a = [graph.symbol(f"acceleration {i}", Binding.ACCELERATION) for i in range(self.n)]
        e = self.equations
        names = dict(zip((*self.form.q, *self.form.v), (*e.q, *e.v), strict=True))
        table = {x: printable(value) for x, value in point.table.items()}
        self.here = {names[x] if x in names else e.translate(x): e.translate(value) for x, value in table.items()}
        vanishes = (lambda _: False) if point.decimal else (lambda expression: point.is_zero(expression, ()))
        self.shortener = Shortener(f"the linear equations of {self.statement.name} about this point", vanishes)

    def matrix(self, rows: Rows, columns: int) -> Any:
        """Return the values of `rows` of graph nodes at the expansion point, as a SymPy matrix in parameters.

        `columns` is the number of columns, also if there are no rows. Raises StatementError if a value is not finite.
        """
        try:
            nodes = substitute([x for row in rows for x in row], self.here)
        except StatementError:  # a pole at the point
            raise self.no_value() from None
        values = []
        for value in map(self.equations.express, nodes):
            if self.point.decimal and not value.is_Integer:
                value = sympy.Float(float(sympy.N(value, 30))) if value.is_number else sympy.N(value, 17)
            if value.has(sympy.nan, sympy.zoo, sympy.oo):
                raise self.no_value()
            values.append(self.shortener.short(value))
        return sympy.Matrix(len(rows), columns, values)

    def no_value(self) -> StatementError:
        """Return the error for a point at which a force, a constraint or one of their derivatives has no value."""
        what = "forces or constraints" if self.statement.constraints else "forces"
        return StatementError(
            f"the {what} of {self.statement.name}, or their derivatives, have no value at {self.point.where}: choose "
            "another point, or coordinates that are regular at it."
        )

    def joined(self, *products: tuple[Any, ...]) -> Any:
        """Return the sum of products of matrices, with simplified entries: for (A, B), (C, D) it is A B + C D.

        To save time, products with a zero matrix are left out, and so are factors that are unit matrices.
        """
        total = sympy.zeros(products[0][0].rows, products[0][-1].cols)
        for factors in products:
            if any(factor.is_zero_matrix for factor in factors):
                continue
            others = [factor for factor in factors if factor != sympy.eye(factor.rows)]
            product = self.shortener.product(*(others or factors[:1]))
            total = product if total.is_zero_matrix else (total + product).applyfunc(self.shortener.short)
        return total

    def turning(self, column: Sequence[Any], factor: int) -> Any:
        """Return the matrix S of dq = S x: x are small turns of bodies about their axes and changes of coordinates.

        q are all coordinates, with the entries of quaternions. `column` has the values of q, and `factor` is 1. For a
        time derivative of S, `column` has the same derivative of q, and `factor` is 0.
        """
        coordinates, matrix = self.statement.coordinates, sympy.zeros(self.n, len(self.read))
        for j, q in enumerate(self.read):
            if q in coordinates:
                matrix[coordinates.index(q), j] = factor
        for each, rows in self.bodies:
            for turn, axis in zip(each.turns, (x, y, z), strict=True):
                for i, entry in zip(rows, velocities_at([column[i] for i in rows], axis, space=False), strict=True):
                    matrix[i, self.read.index(turn)] = entry
        return matrix

    def speeds(self, q: Sequence[Any], v: Sequence[Any]) -> list[Any]:
        """Return the velocities, with the rates of a body about its axes in place of derivatives of its quaternion.

        q and v are the values of all coordinates and velocities at the point.
        """
        of_turns: dict[Any, Any] = {}
        for each, rows in self.bodies:
            rates = body_rates([q[i] for i in rows], [v[i] for i in rows])
            of_turns |= dict(zip(each.turns, map(self.shortener.short, rates), strict=True))
        speeds = of_turns | dict(zip(self.statement.coordinates, v, strict=True))
        return [speeds[coordinate] for coordinate in self.read]

    def slopes(self, nodes: Iterable[Node], symbols: Sequence[Node]) -> list[list[Node]]:
        """Return the partial derivatives of `nodes` by `symbols`, which are nodes too: a row for each of `nodes`."""
        listed = list(nodes)
        columns = [tangents(listed, {x: self.equations.graph.one}) for x in symbols]
        return [[column(node) for column in columns] for node in listed]

    def rates(self, rows: Rows) -> list[list[Node]]:
        """Return the total time derivatives of nodes in q, v and t, without terms whose rate is zero at the point.

        `rows` are lists of nodes, and so is the result.
        """
        e = self.equations
        motion = (*zip(e.q, e.v, strict=True), *zip(e.v, self.a, strict=True))
        moving = {x: rate for x, rate in motion if self.here[rate] is not e.graph.zero}
        along = tangents([x for row in rows for x in row], {**moving, **e.graph.rates})
        return [[along(x) for x in row] for row in rows]


class DependentCoordinates:
    """Choice of m dependent coordinates, which m independent constraints determine at a point.

    `gradient` is G (m, n), the gradients of these constraints, and `kept` has their indices among all constraints. The
    columns of G for the dependent coordinates are a regular matrix.
    """

    def __init__(self, shortener: Shortener, gradient: Any) -> None:
        self.shortener, self.n = shortener, gradient.cols
        self.kept, self.dependent = _pivots(gradient)
        self.independent = [i for i in range(self.n) if i not in self.dependent]
        self.gradient = gradient.extract(self.kept, list(range(self.n)))

    @cached_property
    def inverse(self) -> Any:
        """The inverse of the square matrix (m, m) of the columns of G for dependent coordinates, in symbols."""
        m = len(self.kept)
        columns = self.gradient.extract(list(range(m)), self.dependent)
        return self.shortener.solved(columns, sympy.eye(m))

    def solved(self, right: Any) -> Any:
        """Return the matrix X (n, k) with G X = -`right` (m, k) whose rows for independent coordinates are zero."""
        whole = sympy.zeros(self.n, right.cols)
        if self.kept:
            below = self.shortener.product(-self.inverse, right)
            for k, i in enumerate(self.dependent):
                whole[i, :] = below[k, :]
        return whole

    @cached_property
    def null_space(self) -> Any:
        """A basis of the null space of G, with a one in the row of each independent coordinate."""
        unit = sympy.eye(self.n).extract(list(range(self.n)), self.independent)
        return unit + self.solved(self.gradient * unit)

    def balance(self, forces: Any) -> Any:
        """Return the multipliers lambda for which G^T lambda equals `forces` (n, 1) on all dependent coordinates."""
        return self.shortener.product(self.inverse.T, forces.extract(self.dependent, [0]))


def _pivots(gradient: Any) -> tuple[list[int], list[int]]:
    """Return the row and column indices of a largest regular square part of a matrix, the leftmost columns possible."""
    symbols = sorted(gradient.free_symbols, key=str)
    left = numeric(gradient, {s: sympy.Rational(13 + 7 * k, 10 + k) for k, s in enumerate(symbols)})
    rows: list[int] = []
    columns: list[int] = []
    sizes = np.abs(left).max(axis=1, initial=0.0)
    for j in range(gradient.cols):
        share = np.abs(left[:, j]) / np.where(sizes > 0, sizes, 1.0)
        share[rows] = 0.0
        if len(left) and share.max() > ELIMINATION_ROUNDING:
            pivot = int(share.argmax())
            rows.append(pivot)
            columns.append(j)
            others = np.arange(len(left)) != pivot
            left = left - np.outer(np.where(others, left[:, j] / left[pivot, j], 0.0), left[pivot])
    return sorted(rows), columns


def small_changes(point: StatedPoint) -> SmallChanges:
    """Return the linear equations of small changes about a point, in independent coordinates.

    Raises StatementError for a point off the constraints, and if the constraints are dependent or leave no motion.
    """
    point.check_corners()
    at_point = AtPoint(point)
    e, constraints, product = at_point.equations, at_point.equations.stated, at_point.shortener.product
    _check(at_point)
    join, n = at_point.joined, at_point.n
    q, v = ([point.table[x] for x in symbols] for symbols in (point.form.q, point.form.v))
    S, S_rate = at_point.turning(q, 1), at_point.turning(v, 0)
    whole_mass = at_point.matrix(e.mass, n)
    mass = join((S.T, whole_mass, S))
    G = at_point.matrix(constraints.gradient, n)
    speeds = DependentCoordinates(at_point.shortener, join((G, S)))
    if any(x.is_number and x.atoms(sympy.Function) for x in (*mass, *speeds.gradient)):
        decimals = point.in_decimals()  # sums of numbers such as sin(1/3) grow with every elimination
        if decimals.decimal and not point.decimal:
            return small_changes(decimals)
    if len(speeds.kept) < len(constraints) and point.form.statement.redundant == "refuse":
        raise StatementError("the constraints are dependent at this point, so choose another point to linearize at.")
    if not speeds.independent:
        raise StatementError("the constraints allow no motion to linearize: leave one of the constraints out.")
    kept = constraints.part(speeds.kept)
    holonomic = [row for row, phi in zip(kept.gradient, kept.positions, strict=True) if phi is not None]
    Phi = at_point.matrix(holonomic, n)
    positions = DependentCoordinates(at_point.shortener, join((Phi, S)))
    N = speeds.null_space
    reduced = product(N.T, mass, N)
    rest = join((S.T, at_point.matrix([[h] for h in e.bias], 1)))
    constrained = speeds.solved(at_point.matrix([[gamma] for gamma in kept.bias], 1))
    unbalanced = product(N.T, rest - product(mass, constrained))
    pushed = constrained + product(N, _driven(at_point, reduced, unbalanced))
    rates = at_point.speeds(q, v)
    accelerations = join((S, pushed), (S_rate, sympy.Matrix(rates)))
    at_point.here |= {a: e.translate(x) for a, x in zip(at_point.a, accelerations, strict=True)}
    multipliers = speeds.balance(mass * pushed - rest) if len(kept) else ()
    residuals = _residuals(at_point, kept.gradient, multipliers)
    turns = (S, S_rate, at_point.turning(accelerations, 0))
    gradients = ((kept.gradient, G.extract(speeds.kept, list(range(n)))), (holonomic, Phi))
    motion = TangentMotion(at_point, speeds, positions, kept.velocities, gradients, turns)
    damping, stiffness = (at_point.matrix(at_point.slopes(residuals, x), n) for x in (e.v, e.q))
    C, K = motion.reduced(
        mass,
        join((S.T, damping, S), (S.T, 2 * whole_mass, S_rate)),
        join((S.T, stiffness, S), (S.T, damping, S_rate), (S.T, whole_mass, turns[2])),
    )
    inputs = [e.translate(u) for u in point.inputs]
    pushes = product(-N.T, join((S.T, at_point.matrix(at_point.slopes(residuals, inputs), len(inputs)))))
    matrices = {"M": reduced, "C": C, "K": K, "input_matrix": pushes}
    matrices |= {"basis": motion.B, "velocity_basis": N, "velocity_slope": motion.L}
    turn_matrices = (motion.turned, motion.bent, *turns)
    return SmallChanges(matrices, positions.independent, speeds.independent, unbalanced, rates, turn_matrices)


class TangentMotion:
    """Matrices of small motions x along the constraints: x = B z, x' = N u + L z, x'' = N u' + `turned` u + `bent` z.

    z are changes of independent coordinates, and u of independent velocities. The arguments `speeds` and `positions`
    choose the dependent velocities and the dependent coordinates. `levels` are the constraints on velocities.
    `gradients` are two pairs (nodes, values at the point): the gradients of `levels` by velocities, and the gradients
    of holonomic constraints by coordinates. `turns` are the matrix S of `AtPoint.turning` and its first two derivatives
    in time.
    """

    def __init__(
        self,
        at_point: AtPoint,
        speeds: DependentCoordinates,
        positions: DependentCoordinates,
        levels: Sequence[Node],
        gradients: Sequence[tuple[Rows, Any]],
        turns: tuple[Any, Any, Any],
    ) -> None:
        join, n, (S, S_rate, S_bend) = at_point.joined, at_point.n, turns
        slopes = at_point.slopes(levels, at_point.equations.q)
        (gradient, G), (holonomic, Phi), P_whole = *gradients, at_point.matrix(slopes, n)
        G_rate, P_rate, Phi_rate = (at_point.matrix(at_point.rates(rows), n) for rows in (gradient, slopes, holonomic))
        # Time derivatives of G, of P and of the gradients of holonomic constraints, and P itself, for changes x: small
        # turns of bodies, and changes of other coordinates.
        g_rate = join((G_rate, S), (G, S_rate))
        p_rate = join((P_rate, S), (P_whole, S_rate), (G_rate, S_rate), (G, S_bend))
        phi_rate = join((Phi_rate, S), (Phi, S_rate))
        P, product = join((P_whole, S), (G, S_rate)), speeds.shortener.product
        self.product, self.N, self.B = product, speeds.null_space, positions.null_space
        self.L = speeds.solved(product(P, self.B))
        N_rate, B_rate = speeds.solved(product(g_rate, self.N)), positions.solved(product(phi_rate, self.B))
        L_rate = speeds.solved(product(g_rate, self.L) + product(p_rate, self.B) + product(P, B_rate))
        N_rows, L_rows = (x.extract(positions.independent, list(range(x.cols))) for x in (self.N, self.L))
        self.turned, self.bent = N_rate + product(self.L, N_rows), L_rate + product(self.L, L_rows)

    def reduced(self, mass: Any, damping: Any, stiffness: Any) -> tuple[Any, Any]:
        """Return the coefficient matrices C of u and K of z in the linear equations M u' + C u + K z = 0.

        `mass`, `damping` and `stiffness` are the coefficients of x'', x' and x for all coordinates.
        """
        product, L = self.product, self.L
        C = product(mass, self.turned) + product(damping, self.N)
        K = product(mass, self.bent) + product(damping, L) + product(stiffness, self.B)
        return product(self.N.T, C), product(self.N.T, K)


def _check(at_point: AtPoint) -> None:
    """Raise StatementError for a point off the constraints, in position or velocity, and for inputs in constraints."""
    constraints = at_point.equations.stated
    for constraint, phi, psi in zip(
        at_point.statement.constraints, constraints.positions, constraints.velocities, strict=True
    ):
        if constraint.expression.xreplace(at_point.form.plain).has(t):
            raise StatementError(
                f"the constraint {constraint.name!r} depends on time: no point satisfies it at all times."
            )
        if driving := [u for u in at_point.point.inputs if constraint.expression.has(u)]:
            raise StatementError(
                f"the constraint {constraint.name!r} contains the input {driving[0]}, so B would need the rate of "
                f"{driving[0]}: leave {driving[0]} out of inputs, or make it a force."
            )
        for node, subject, names in ((phi, "point is", "coordinates"), (psi, "velocities are", "velocities")):
            value = sympy.S.Zero if node is None else at_point.matrix([[node]], 1)[0]
            if not at_point.point.is_zero(value, ()):
                raise StatementError(
                    f"the {subject} not on the constraint {constraint.name!r}, which is {formula(value, 80)} there and "
                    f"not zero: give values of all {names} in it."
                )


def _driven(at_point: AtPoint, mass: Any, unbalanced: Any) -> Any:
    """Return the accelerations a with `mass` a = `unbalanced`, the forces that are left at the point.

    Both are for independent velocities. Raises StatementError if the mass matrix is singular and forces are left.
    """
    if unbalanced.is_zero_matrix or (at_point.point.decimal and all(at_point.point.is_zero(x, ()) for x in unbalanced)):
        return sympy.zeros(*unbalanced.shape)
    determinant = mass.det(method="berkowitz")
    if mass.has(sympy.Float) and determinant != 0:
        return mass.LUsolve(unbalanced)
    determinant = at_point.shortener.short(determinant)
    if determinant == 0:
        names = [at_point.statement.names[i] for i in at_point.equations.first_order]
        if names:
            raise StatementError(
                f"this point is not an equilibrium of {at_point.statement.name}, and {listing(names)} "
                f"{'has' if len(names) == 1 else 'have'} no inertia, so the system cannot be at rest there: give an "
                "equilibrium, such as one of system.equilibria()."
            )
        raise StatementError(
            f"the mass matrix of {at_point.statement.name} is singular at this point, which is not an equilibrium: its "
            "accelerations are not determined there. Choose another point."
        )
    return at_point.shortener.product(mass.adjugate(), unbalanced / determinant)


def _residuals(at_point: AtPoint, gradient: Rows, multipliers: Sequence[Any]) -> list[Node]:
    """Return the residuals M a - h - G^T lambda of the equations of motion, one node for each coordinate.

    h are the forces less the velocity terms of dp/dt, `gradient` is G, and `multipliers` are the values of lambda.
    Terms with accelerations that are zero at the point are left out.
    """
    e = at_point.equations
    a = [at_point.here[x] if at_point.here[x] is e.graph.zero else x for x in at_point.a]
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
