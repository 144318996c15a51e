"""Equations of motion linearised about a point, and verified against the compiled model.

With constraints the equations are expanded in independent coordinates and velocities. The residual is r(q, v, a) - G^T
lambda, the velocity constraints are psi(q, v) = 0 (a holonomic one differentiated), G = dpsi/dv and P = dpsi/dq.
Changes of positions are dq = B z, with B in the null space of the gradients of the holonomic constraints. Changes of
velocities are dv = N u + L z, with G N = 0 and G L = -P B. In the rows of independent coordinates B and N have the rows
of a unit matrix, and L zeros; the rows of dv give z'. The rate of dv along the motion is the change of the
accelerations. N^T times the change of the residual is free of changes of lambda. Source: A. L. Schwab, J. P. Meijaard,
Dynamics of flexible multibody systems with non-holonomic constraints, Multibody System Dynamics 10, 2003.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import sympy

from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.equations.regularity import known_statement
from lagrange.errors import StatementError, formula, listing
from lagrange.evidence.sample import SamplePoint, agrees, compared
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node, substitute
from lagrange.machine.model import Model, Stated
from lagrange.mechanics.expansion import INPUT_REMEDY, StatedPoint, edges, stated_point, with_inputs_as_parameters
from lagrange.mechanics.plain_form import (
    Shortener,
    in_decimals,
    in_fractions,
    numeric,
    simplest,
    vanishes_in_symbols,
)
from lagrange.statement.coordinate import t
from lagrange.statement.given.function import require_values
from lagrange.statement.progress import ShownAsPage, deriving
from lagrange.statement.statement import Statement


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

    @property
    def without_inertia(self) -> list[int]:
        """Indices of the velocities without inertia: row and column of M are zero, and the row of C is not."""
        return [
            k
            for k in range(self.M.rows)
            if self.M.row(k).is_zero_matrix and self.M.col(k).is_zero_matrix and not self.C.row(k).is_zero_matrix
        ]

    @property
    def A(self) -> Any:
        """Matrix A of the first-order form d/dt [x, x'] = A [x, x'] + B u. x' are only the velocities with inertia."""
        return self._rates[:, : self._rates.cols - self.input_matrix.cols]

    @property
    def B(self) -> Any:
        """Input matrix B of the first-order form: as many rows as A, and a column for each input."""
        return self._rates[:, self._rates.cols - self.input_matrix.cols :]

    @cached_property
    def _rates(self) -> Any:
        """The matrix [A, B]: A and B side by side.

        C determines the velocities without inertia, and M the accelerations of the others. Raises StatementError if
        one of these blocks of C and M is singular.
        """
        massless = self.without_inertia
        massive = [k for k in range(self.M.rows) if k not in massless]
        forces = sympy.Matrix.hstack(-self.K, -self.C.extract(list(range(self.C.rows)), massive), self.input_matrix)
        columns = list(range(forces.cols))
        slow = self._inverse(self.C, massless, "damping matrix C") * forces.extract(massless, columns)
        left = forces.extract(massive, columns) - self.C.extract(massive, massless) * slow
        fast = self._inverse(self.M, massive, "mass matrix") * left
        velocities = sympy.zeros(self.M.rows, forces.cols)
        for row, k in enumerate(massless):
            velocities[k, :] = slow[row, :]
        for row, k in enumerate(massive):
            velocities[k, self.K.cols + row] = 1
        above = self.velocity_basis * velocities
        above[:, : self.K.cols] += self.velocity_slope
        return sympy.Matrix.vstack(above.extract(self.places, columns), fast).applyfunc(simplest)

    @property
    def decimal(self) -> bool:
        """True if the matrices contain decimals, which are valid only for the present values of the parameters."""
        return any(x.has(sympy.Float) for x in (*self.M, *self.C, *self.K))

    @property
    def places(self) -> list[int]:
        """Indices of `coordinates` among the coordinates of the system."""
        return [self.statement.coordinates.index(q) for q in self.coordinates]

    @property
    def speeds(self) -> list[int]:
        """Indices of `velocity_coordinates` among the coordinates of the system."""
        return [self.statement.coordinates.index(q) for q in self.velocity_coordinates]

    def of_moving(self) -> Linearization | None:
        """Return the equations of `velocity_coordinates` alone, or None if they depend on other coordinates."""
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

    def _inverse(self, matrix: Any, rows: list[int], name: str) -> Any:
        """Return the inverse of the block of a matrix with the indices `rows` as rows and columns.

        Raises StatementError if the block is singular; `name` is that of the matrix.
        """
        shortener = Shortener("the inverse of the " + name, vanishes_in_symbols)
        try:
            return shortener.solved(matrix.extract(rows, rows), sympy.eye(len(rows)))
        except ZeroDivisionError:
            raise StatementError(
                f"the {name} is singular at this point, so that A and B do not exist: M, C and K do. Choose "
                "coordinates that are regular there; state rates without inertia as constraints, such as e.dot - f."
            ) from None


def linearized(system: Stated, at: Any, inputs: Any) -> Linearization:
    """Return the linearization of a system about the point `at`, after comparing it with the compiled model.

    `inputs` are the parameters or given functions of time that are the inputs u.
    """
    statement, at, inputs = with_inputs_as_parameters(system.statement, at, inputs)
    system = system if statement is system.statement else system.from_statement(statement)
    require_values(statement, INPUT_REMEDY)
    with deriving(f"linear equations of {statement.name}"):
        point = stated_point(known_statement(statement), at, inputs)
        linearization = linearized_at(point)
        check(linearization, point, system.compile("numpy", check=False))
    return linearization


def linearized_at(point: StatedPoint) -> Linearization:
    """Return the linearization about a point. Raises StatementError if a force or a derivative has no value there."""
    statement, expanded = point.form.statement, expansion(point)
    matrices, positions, speeds = expanded.matrices, expanded.positions, expanded.speeds
    if any(x.has(sympy.Float) for x in (statement.lagrangian, statement.dissipation, *statement.forces)):
        matrices = {name: matrix.applyfunc(in_decimals) for name, matrix in matrices.items()}
    K = matrices["K"]
    balanced = all(point.is_zero(x, K) for x in expanded.unbalanced)
    moving = [k for k, i in enumerate(positions) if point.v[i] != 0]
    rows = [k for k, i in enumerate(speeds) if point.v[i] != 0]
    steady = all(point.is_zero(x, ()) for k in moving for x in K[:, k])
    steady = steady and all(point.is_zero(x, ()) for k in rows for x in K[k, :])
    velocities = {v: x for v, x in zip(statement.velocities, point.v, strict=True) if x != 0}
    return Linearization(
        coordinates=tuple(statement.coordinates[i] for i in positions),
        velocity_coordinates=tuple(statement.coordinates[i] for i in speeds),
        at=MappingProxyType(dict(zip(statement.coordinates, point.q, strict=True)) | velocities | dict(point.inputs)),
        **matrices,
        inputs=tuple(point.inputs),
        equilibrium=balanced and steady,
        note=_note(point, expanded.unbalanced, [statement.names[i] for i in speeds], balanced, steady),
        statement=statement,
    )


def _note(
    point: StatedPoint, unbalanced: Sequence[Any], names_of_forces: Sequence[str], balanced: bool, steady: bool
) -> str:
    """Return a sentence on the point: an equilibrium, a steady motion, or the unbalanced forces by name.

    `unbalanced` are the residual forces at the point, on the coordinates `names_of_forces`. `balanced` is true if
    they are zero, and `steady` if the linear equations remain valid along the motion.
    """
    form = point.form
    if balanced and steady:
        on_constraints = " on the constraints" if form.statement.constraints else ""
        return f"About {'a steady motion' if any(point.v) else 'an equilibrium'}{on_constraints}."
    if balanced:
        moving = listing(name for name, v in zip(form.statement.names, point.v, strict=True) if v != 0)
        return f"Away from equilibrium: {moving} moves, and the matrices hold at this instant."
    parts = [
        f"{formula(form.written(force), 80)} on {name}"
        for name, force in zip(names_of_forces, unbalanced, strict=True)
        if not point.is_zero(force, ())
    ]
    return f"Away from equilibrium: the forces left are {listing(parts)}, and the matrices hold at this instant."


INPUT_STEP = 1e-3
"""Step of an input in the numerical derivative that B is compared with: exact for forces linear in the input."""

INPUT_ERROR = 1e-5
"""Largest difference of B from that derivative, relative to the largest entry: allows for curvature over the step."""


def check(lin: Linearization, point: StatedPoint, model: Model) -> None:
    """Raise RunError if a linearization differs from the compiled model.

    They are compared at the stated values of the parameters, if all have one. They are also compared at random
    values, unless the point or the matrices contain decimals.
    """
    statement = point.form.statement

    def at_point(sample: SamplePoint) -> tuple[Any, Any]:
        numbers = {p: sympy.Rational(x) for p, x in sample.parameters.items()} | {t: sympy.Rational(sample.t)}
        return _both(lin, point, model, numbers | {u: x.xreplace(numbers) for u, x in point.inputs.items()})

    if all(p in statement.defaults for p in statement.parameters if p not in point.inputs):
        defaults = {p: statement.defaults.get(p, 0.0) for p in statement.parameters}
        zero = (0.0,) * len(statement.coordinates)
        agrees("the linearization", statement, SamplePoint(zero, zero, 0.3, defaults, "the point given"), at_point)
    if not (point.decimal or lin.decimal):
        compared("the linearization", statement, at_point)


def _both(lin: Linearization, point: StatedPoint, model: Model, values: Any) -> tuple[Any, Any]:
    """Return the rows of A for the rates of x', flattened: from the compiled model, and from the linearization.

    If a column of the input matrix B differs, both versions of that column are returned instead. If the matrices have
    no real, finite values or are singular, the second result is NaN. `values` maps the parameters and t to numbers.
    """
    state = numeric(sympy.Matrix([*point.q, *point.v]), values).ravel()
    mass, damping, stiffness, pushes = (numeric(x, values) for x in (lin.M, lin.C, lin.K, lin.input_matrix))
    basis, speeds, slopes = (numeric(x, values) for x in (lin.basis, lin.velocity_basis, lin.velocity_slope))
    parts = (state, mass, damping, stiffness, pushes, basis, speeds, slopes)
    slow = lin.without_inertia
    fast = [k for k in range(len(mass)) if k not in slow]
    inertia, resistance = mass[np.ix_(fast, fast)], damping[np.ix_(slow, slow)]
    if (
        any(np.iscomplexobj(part) or not np.isfinite(part).all() for part in parts)
        or min(abs(np.linalg.det(inertia)), abs(np.linalg.det(resistance))) < 1e-12
    ):
        return [], [float("nan")]
    time = float(values[t])
    parameters = {p: float(values[p]) for p in point.form.statement.parameters}
    # The velocities without inertia are `shares` times the deviations [x, x'].
    forces, count = np.hstack([-stiffness, -damping[:, fast]]), stiffness.shape[1]
    shares = np.linalg.solve(resistance, forces[slow])
    formulas = np.linalg.solve(inertia, forces[fast] - damping[np.ix_(fast, slow)] @ shares)
    # The independent velocities are a selection of all velocities, so their rates are rows of the full Jacobian.
    jacobian = model.jacobian(time, state, parameters)

    def slopes_of(part: slice) -> tuple[Any, Any]:
        """Return derivatives of the compiled rates `part` by independent coordinates and velocities."""
        rows = jacobian[part][lin.speeds]
        by_v = rows[:, model.layout.v]
        return rows[:, model.layout.q] @ basis + by_v @ slopes, by_v @ speeds

    by_place, by_speed = slopes_of(model.layout.v)
    compiled = np.hstack([by_place[fast], by_speed[np.ix_(fast, fast)]]) + by_speed[np.ix_(fast, slow)] @ shares
    if model.equations.settled:
        rates_by_place, rates_by_speed = slopes_of(model.layout.q)
        compiled_slow = np.hstack([rates_by_place[slow], rates_by_speed[np.ix_(slow, fast)]])
        formulas_slow = shares
    else:
        # The model has the rates of velocities without inertia.
        compiled_slow = by_speed[slow]
        formulas_slow = shares[:, :count] @ speeds[lin.places] + shares[:, count:] @ by_speed[fast]
    scale = max(1e-300, np.abs(by_speed).max(), np.abs(by_place).max())
    for k, u in enumerate(point.inputs):
        # Velocities without inertia follow the input at once.
        moves, rates = np.zeros(len(mass)), np.zeros(len(mass))
        moves[slow] = np.linalg.solve(resistance, pushes[slow, k])
        rates[fast] = np.linalg.solve(inertia, pushes[fast, k] - damping[fast] @ moves)
        rates[slow] = shares @ np.concatenate([speeds[lin.places] @ moves, rates[fast]])
        shift = np.concatenate([np.zeros(len(speeds)), speeds @ moves])
        # One-sided difference: an input declared positive must not become negative.
        near, base, far = (
            model.rhs(time, state + step * shift, {**parameters, u: parameters[u] + step})[model.layout.v]
            for step in (INPUT_STEP, 0, 2 * INPUT_STEP)
        )
        column, symbolic = (4 * near - 3 * base - far) / (2 * INPUT_STEP), speeds @ rates
        if np.abs(symbolic - column).max() > INPUT_ERROR * max(scale, np.abs(column).max()):
            return [*column], [*symbolic]
    return [*compiled.ravel(), *compiled_slow.ravel()], [*formulas.ravel(), *formulas_slow.ravel()]


ELIMINATION_ROUNDING = 1e-9
"""Part of the largest entry of a row below which an entry left by elimination counts as zero."""

Rows = Sequence[Sequence[Node]]


class Expansion(NamedTuple):
    """Linear equations of small changes about a point: M u' + C u + K z = (input matrix) u_input.

    z are the changes of independent coordinates, and u those of independent velocities; z' are the rows `positions`
    of N u + L z. `matrices` has M, C, K, the input matrix, and B, N and L of the module's description, by their names
    in `Linearization`. `positions` are the indices of the independent coordinates, `speeds` of the coordinates with
    independent velocities. `unbalanced` are the residual forces along these velocities at the point.
    """

    matrices: dict[str, Any]
    positions: list[int]
    speeds: list[int]
    unbalanced: Sequence[Any]


class AtPoint:
    """Evaluates expressions of a system, given as nodes of its expression graph, at the expansion point."""

    def __init__(self, point: StatedPoint) -> None:
        self.point, self.form, self.statement = point, point.form, point.form.statement
        e = euler_lagrange(self.statement.mapped(in_fractions))
        values = sorted(set().union(*(x.free_symbols for x in point.table.values())), key=str)
        others = {s: e.graph.symbol(f"value {s.name}", Binding.PARAMETER) for s in values if s not in e.leaves}
        self.equations = replace(e, leaves={**e.leaves, **others})
        self.n, graph = len(self.form.q), self.equations.graph
        self.a = [graph.symbol(f"acceleration {i}", Binding.ACCELERATION) for i in range(self.n)]
        e = self.equations
        names = dict(zip((*self.form.q, *self.form.v), (*e.q, *e.v), strict=True))
        self.here = {names[x] if x in names else e.translate(x): e.translate(value) for x, value in point.table.items()}
        vanishes = (lambda _: False) if point.decimal else (lambda expression: point.is_zero(expression, ()))
        self.shortener = Shortener(f"the linear equations of {self.statement.name} about this point", vanishes)

    def matrix(self, rows: Rows, columns: int) -> Any:
        """Return the values of graph nodes at the point, as a matrix of SymPy expressions in parameters.

        `rows` are its rows of nodes, and `columns` is the number of its columns.
        """
        try:
            nodes = substitute([x for row in rows for x in row], self.here)
        except StatementError:  # a pole at the point
            raise self.no_value() from None
        return sympy.Matrix(len(rows), columns, [self._value(x) for x in nodes])

    def _value(self, node: Node) -> Any:
        value = self.equations.express(node)
        if self.point.decimal and not value.is_Integer:
            value = sympy.Float(float(sympy.N(value, 30))) if value.is_number else sympy.N(value, 17)
        if value.has(sympy.nan, sympy.zoo, sympy.oo):
            raise self.no_value()
        return self.shortener.short(value)

    def no_value(self) -> StatementError:
        """Return the error for a point at which a force, a constraint or one of their derivatives has no value."""
        what = "forces or constraints" if self.statement.constraints else "forces"
        return StatementError(
            f"the {what} of {self.statement.name}, or their derivatives, have no value at {self.point.where}: choose "
            "another point, or coordinates that are regular at it."
        )

    def slopes(self, nodes: Iterable[Node], symbols: Sequence[Node]) -> list[list[Node]]:
        """Return the derivatives of nodes by symbols, one row for each node."""
        listed = list(nodes)
        columns = [tangents(listed, {x: self.equations.graph.one}) for x in symbols]
        return [[column(node) for column in columns] for node in listed]

    def rates(self, rows: Rows) -> list[list[Node]]:
        """Return the total time derivatives of nodes in q, v and t, without terms whose rate is zero at the point."""
        e = self.equations
        motion = (*zip(e.q, e.v, strict=True), *zip(e.v, self.a, strict=True))
        moving = {x: rate for x, rate in motion if self.here[rate] is not e.graph.zero}
        along = tangents([x for row in rows for x in row], {**moving, **e.graph.rates})
        return [[along(x) for x in row] for row in rows]


class DependentCoordinates:
    """Independent rows G (m, n) of constraint gradients at a point, and m dependent coordinates chosen for them.

    The columns of G for the dependent coordinates are a regular matrix.
    """

    def __init__(self, shortener: Shortener, gradient: Any) -> None:
        self.shortener, self.n = shortener, gradient.cols
        self.kept, self.dependent = _pivots(gradient)
        self.independent = [i for i in range(self.n) if i not in self.dependent]
        self.gradient = gradient.extract(self.kept, list(range(self.n)))

    @cached_property
    def inverse(self) -> Any:
        """The inverse of the columns of G for dependent coordinates, by elimination with short pivots."""
        m = len(self.kept)
        columns = self.gradient.extract(list(range(m)), self.dependent)
        return self.shortener.solved(columns, sympy.eye(m))

    def solved(self, right: Any) -> Any:
        """Return the matrix X with G X = -`right`. It has n rows, and those of independent coordinates are zero."""
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
        """Return the multipliers lambda with G^T lambda = `forces` in the rows of dependent coordinates."""
        return self.shortener.product(self.inverse.T, forces.extract(self.dependent, [0]))


def _pivots(gradient: Any) -> tuple[list[int], list[int]]:
    """Return indices of independent rows of a matrix, and of the leftmost columns in which these rows are regular."""
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


def expansion(point: StatedPoint) -> Expansion:
    """Return the equations of small changes about a point.

    Raises StatementError for a point off the constraints, and if the constraints are dependent or leave no motion.
    """
    statement = point.form.statement
    stated = (statement.lagrangian, statement.dissipation, *statement.forces)
    if any(edges(point.form.read(x)) for x in stated):
        _ = point.residuals  # refuses a corner that matters; at any other both sides have the same derivatives
    at_point = AtPoint(point)
    e, constraints, product = at_point.equations, at_point.equations.stated, at_point.shortener.product
    _check(at_point)
    speeds = DependentCoordinates(at_point.shortener, at_point.matrix(constraints.gradient, at_point.n))
    mass = at_point.matrix(e.mass, at_point.n)
    if any(x.is_number and x.atoms(sympy.Function) for x in (*mass, *speeds.gradient)):
        decimals = point.in_decimals()  # sums of numbers such as sin(1/3) grow with every elimination
        if decimals.decimal and not point.decimal:
            return expansion(decimals)
    if len(speeds.kept) < len(constraints) and statement.redundant == "refuse":
        raise StatementError("the constraints are dependent at this point, so that it has no linearization.")
    if not speeds.independent:
        raise StatementError("the constraints leave no motion: there is nothing to linearise.")
    kept = constraints.part(speeds.kept)
    holonomic = [row for row, phi in zip(kept.gradient, kept.positions, strict=True) if phi is not None]
    positions = DependentCoordinates(at_point.shortener, at_point.matrix(holonomic, at_point.n))
    N = speeds.null_space
    reduced = product(N.T, mass, N)
    rest = at_point.matrix([[h] for h in e.bias], 1)
    carried = speeds.solved(at_point.matrix([[gamma] for gamma in kept.bias], 1))
    unbalanced = product(N.T, rest - product(mass, carried))
    accelerations = carried + product(N, _driven(at_point, reduced, unbalanced))
    at_point.here |= {a: e.translate(x) for a, x in zip(at_point.a, accelerations, strict=True)}
    multipliers = speeds.balance(mass * accelerations - rest) if len(kept) else ()
    residuals = _residuals(at_point, kept.gradient, multipliers)
    P = at_point.slopes(kept.velocities, e.q)
    p, g_rate, p_rate, phi_rate = (
        at_point.matrix(rows, at_point.n)
        for rows in (P, at_point.rates(kept.gradient), at_point.rates(P), at_point.rates(holonomic))
    )
    motion = TangentMotion(speeds, positions, p, (g_rate, p_rate, phi_rate))
    damping, stiffness = (at_point.matrix(at_point.slopes(residuals, x), at_point.n) for x in (e.v, e.q))
    inputs = [e.translate(u) for u in point.inputs]
    C, K = motion.reduced(mass, damping, stiffness)
    pushes = product(-N.T, at_point.matrix(at_point.slopes(residuals, inputs), len(inputs)))
    matrices = {"M": reduced, "C": C, "K": K, "input_matrix": pushes}
    matrices |= {"basis": motion.B, "velocity_basis": N, "velocity_slope": motion.L}
    return Expansion(matrices, positions.independent, speeds.independent, unbalanced)


class TangentMotion:
    """Small motions x on the constraints: x = B z, x' = N u + L z, x'' = N u' + `turned` u + `bent` z.

    z are changes of independent coordinates, and u of independent velocities. B, N, L, `turned` and `bent` are
    matrices. They follow from gradients of the constraints: `speeds` has those by velocities, G, and chooses the
    dependent velocities. `positions` has those of holonomic constraints, and chooses the dependent coordinates. `P`
    has the derivatives of constraints on velocities by coordinates. `rates` are the time derivatives of G, of P and
    of the gradients of holonomic constraints.
    """

    def __init__(
        self, speeds: DependentCoordinates, positions: DependentCoordinates, P: Any, rates: tuple[Any, Any, Any]
    ) -> None:
        product, (g_rate, p_rate, phi_rate) = speeds.shortener.product, rates
        self.product, self.N, self.B = product, speeds.null_space, positions.null_space
        self.L = speeds.solved(product(P, self.B))
        N_rate, B_rate = speeds.solved(product(g_rate, self.N)), positions.solved(product(phi_rate, self.B))
        L_rate = speeds.solved(product(g_rate, self.L) + product(p_rate, self.B) + product(P, B_rate))
        N_rows, L_rows = (x.extract(positions.independent, list(range(x.cols))) for x in (self.N, self.L))
        self.turned, self.bent = N_rate + product(self.L, N_rows), L_rate + product(self.L, L_rows)

    def reduced(self, mass: Any, damping: Any, stiffness: Any) -> tuple[Any, Any]:
        """Return C and K for u and z, from the mass, damping and stiffness matrices of all coordinates."""
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
                f"the input {driving[0]} is in the constraint {constraint.name!r}, so that velocities follow it and B "
                "would need its rate: leave it out of inputs, or state it in forces."
            )
        for node, subject, names in ((phi, "point is", "coordinates"), (psi, "velocities are", "velocities")):
            value = sympy.S.Zero if node is None else at_point.matrix([[node]], 1)[0]
            if not at_point.point.is_zero(value, ()):
                raise StatementError(
                    f"the {subject} not on the constraint {constraint.name!r}, which is {formula(value, 80)} there and "
                    f"not zero: give values of all {names} in it."
                )


def _driven(at_point: AtPoint, mass: Any, left: Any) -> Any:
    """Return the accelerations of independent velocities that the unbalanced forces `left` cause.

    `mass` is the mass matrix of these velocities.
    """
    if left.is_zero_matrix or (at_point.point.decimal and all(at_point.point.is_zero(x, ()) for x in left)):
        return sympy.zeros(*left.shape)
    determinant = mass.det(method="berkowitz")
    if mass.has(sympy.Float) and determinant != 0:
        return mass.LUsolve(left)
    determinant = at_point.shortener.short(determinant)
    if determinant == 0:
        names = [at_point.statement.names[i] for i in at_point.equations.first_order]
        if names:
            raise StatementError(
                f"this point is not an equilibrium of {at_point.statement.name}, and {listing(names)} "
                f"{'has' if len(names) == 1 else 'have'} no inertia, so that the rest there does not last: give an "
                "equilibrium, such as one of system.equilibria()."
            )
        raise StatementError(
            f"the mass matrix of {at_point.statement.name} is singular at this point, which is not an equilibrium: its "
            "accelerations are not determined there. Choose another point."
        )
    return at_point.shortener.product(mass.adjugate(), left / determinant)


def _residuals(at_point: AtPoint, gradient: Rows, multipliers: Sequence[Any]) -> list[Node]:
    """Return the residuals M a - h - G^T lambda of the equations of motion, one node for each coordinate.

    h are the forces, `gradient` is G, and `multipliers` are lambda. Terms with accelerations that are zero are left
    out.
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
