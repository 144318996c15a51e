"""Linearise the equations of motion about a point, and verify the matrices against the compiled model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.equations.regularity import known_statement
from lagrange.equations.terms import with_known_signs
from lagrange.errors import FAULT, RunError, StatementError, formula, listing
from lagrange.evidence.formula_comparison import agrees, compared
from lagrange.machine.model import Model, Stated
from lagrange.mechanics.expansion import INPUT_REMEDY, StatedPoint, edges, stated_point, with_inputs_as_parameters
from lagrange.mechanics.plain_form import (
    Shortener,
    in_decimals,
    is_zero,
    numeric,
    random_values,
    simplest,
    size,
    vanishes_in_symbols,
)
from lagrange.mechanics.small_changes import SmallChanges, small_changes
from lagrange.statement.coordinate import t
from lagrange.statement.display import ShownAsPage, announced
from lagrange.statement.given.function import require_values
from lagrange.statement.random_states import SamplePoint
from lagrange.statement.statement import Statement


@dataclass(frozen=True, eq=False)
class Linearization(ShownAsPage):
    """Linear equations M x'' + C x' + K x = `input_matrix` u about the point `at`, in SymPy matrices.

    x are the deviations of `coordinates`: all coordinates, or the independent ones if there are constraints. The
    deviations of all coordinates are `basis` x. x' are the deviations of the velocities of `velocity_coordinates`,
    which are fewer if there are constraints on velocities. The deviations of all velocities are `velocity_basis` x' +
    `velocity_slope` x. u are the deviations of `inputs`. `equilibrium` is true if the point is an equilibrium, or a
    steady motion with the stated velocities; `note` says so in a sentence. `statement` is the statement of the system.
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
        """Indices in x' of velocities without inertia: their row and column of M are zero, but not their row of C."""
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
        """The matrices A and B of the first-order form side by side, [A, B].

        Velocities without inertia follow from a block of C, the accelerations of the others from a block of M. Raises
        StatementError if one of these blocks is singular.
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
        """Indices that `coordinates` have among all coordinates of the system."""
        return [self.statement.coordinates.index(q) for q in self.coordinates]

    @property
    def speeds(self) -> list[int]:
        """Indices that `velocity_coordinates` have among all coordinates of the system."""
        return [self.statement.coordinates.index(q) for q in self.velocity_coordinates]

    def of_velocity_coordinates(self) -> Linearization | None:
        """Return the same equations with `velocity_coordinates` as the only coordinates, so that K is square.

        The result is None if the equations contain other coordinates.
        """
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

        Raises StatementError if the block is singular; `name` is the name of the matrix in the message.
        """
        shortener = Shortener("the inverse of the " + name, vanishes_in_symbols)
        try:
            return shortener.solved(matrix.extract(rows, rows), sympy.eye(len(rows)))
        except ZeroDivisionError:
            raise StatementError(
                f"the {name} is singular at this point, so A and B do not exist (M, C and K do). Choose coordinates "
                "that are regular there; state a rate without inertia as a constraint, such as e.dot - f."
            ) from None


def linearized(system: Stated, at: Any, inputs: Any) -> Linearization:
    """Return the linearization of a system about the point `at`, after a comparison with the compiled model.

    `at` maps coordinates and velocities to values. `inputs` lists the parameters or given functions of time that are
    the inputs u. Deviations of a rotation are small turns of the body about its axes.
    """
    statement, at, inputs = with_inputs_as_parameters(system.statement, at, inputs)
    system = system if statement is system.statement else system.from_statement(statement)
    require_values(statement, INPUT_REMEDY)
    with announced("deriving", f"linear equations of {statement.name}"):
        point = stated_point(known_statement(statement), at, inputs, turning=True)
        changes = small_changes(point)
        linearization, model = linearized_at(point, changes), system.compile("numpy", check=False)
        if not point.form.statement.rotations:
            check(linearization, point, model)
            return linearization
        check_turns(linearization, changes, point, model)
    return replace(linearization, at=MappingProxyType(dict(at or {})), statement=statement.as_read)


def linearized_at(point: StatedPoint, changes: SmallChanges | None = None) -> Linearization:
    """Return the linearization about a point. Raises StatementError if a force or a derivative has no value there.

    `changes` are the equations of small changes about the point. If None, they are derived.
    """
    statement, changes = point.form.statement, changes or small_changes(point)
    matrices, positions, speeds, rates = changes.matrices, changes.positions, changes.speeds, changes.rates
    read = statement.reading or statement
    if any(x.has(sympy.Float) for x in (statement.lagrangian, statement.dissipation, *statement.forces)):
        matrices = {name: matrix.applyfunc(in_decimals) for name, matrix in matrices.items()}
    K = matrices["K"]
    balanced = all(point.is_zero(x, K) for x in changes.unbalanced)
    if statement.rotations:
        steady = all(point.is_zero(x, ()) for x in K * sympy.Matrix([rates[i] for i in positions]))
    else:
        moved = [q for q, v in zip(point.form.q, point.v, strict=True) if v != 0]
        stated = (*point.form.residuals, *(point.form.read(each.expression) for each in statement.constraints))
        moving = [k for k, i in enumerate(positions) if rates[i] != 0]
        rows = [k for k, i in enumerate(speeds) if rates[i] != 0]
        steady = not any(part.has(*moved) for part in stated) or all(
            point.is_zero(x, ()) for x in (*K[:, moving], *K[rows, :])
        )
    velocities = {v: x for v, x in zip(statement.velocities, point.v, strict=True) if x != 0}
    linearization = Linearization(
        coordinates=tuple(read.coordinates[i] for i in positions),
        velocity_coordinates=tuple(read.coordinates[i] for i in speeds),
        at=MappingProxyType(dict(zip(statement.coordinates, point.q, strict=True)) | velocities | dict(point.inputs)),
        **matrices,
        inputs=tuple(point.inputs),
        equilibrium=balanced and steady,
        note=_note(point, changes.unbalanced, [read.names[i] for i in speeds], balanced, steady),
        statement=statement,
    )
    if linearization.equilibrium and not has_inertia(linearization) and is_false_pole(point):
        return replace(linearization, equilibrium=False, note=FALSE_POLE)
    return linearization


FALSE_POLE = "Away from equilibrium: the mass matrix is singular here, and next to this point the forces do not vanish."


MOST_OPERATIONS = 150
"""Largest number of operations in M, C and K together, up to which determinants are computed in symbols. One for 3
coordinates with 112 operations takes 0.3 s, one for 2 coordinates with 255 operations some minutes."""

SAMPLES = 4  # Number of random values of the symbols at which a mass matrix with long formulas is evaluated
POLE_DISTANCES = (1e-3, 1e-4, 1e-5)  # Distances of the points at which a force is evaluated from a pole
SAME_SQUARE = 0.9
"""Ratio of the smallest to the largest squared force near a pole, above which the force does not tend to zero there"""


def has_inertia(lin: Linearization) -> bool:
    """Return True if the mass matrix M of a linearization is regular.

    A matrix with long formulas counts as regular if its rank is full at one of `SAMPLES` random values of its symbols.
    """
    if not has_long_formulas(lin):
        return not is_zero(lin.M.det(method="berkowitz"))
    masses = (numeric(lin.M, sample) for sample in islice(random_values(lin.M.free_symbols), SAMPLES))
    return any(np.isfinite(mass).all() and np.linalg.matrix_rank(mass) == len(mass) for mass in masses)


def has_long_formulas(lin: Linearization) -> bool:
    """Return True if M, C and K are so long that their determinants in symbols would take minutes."""
    return sum(size(x) for matrix in (lin.M, lin.C, lin.K) for x in matrix) > MOST_OPERATIONS


def is_false_pole(point: StatedPoint) -> bool:
    """Return True for a pole of the coordinates, such as theta = 0 on a sphere, that is no equilibrium.

    At a pole the mass matrix M is singular, and the forces F on the coordinates may vanish although the body is pushed.
    Near an equilibrium F M^-1 F, a squared force per mass, tends to zero. The result is True only if it tends to one
    positive number from several directions. A parameter without a value gets an arbitrary one.
    """
    form = point.form
    still = {**dict.fromkeys(form.a, sympy.S.Zero), **dict(zip(form.v, point.v, strict=True))}
    forces = sympy.Matrix([with_known_signs(residual.xreplace(still)) for residual in form.residuals])
    if form.statement.constraints or any(map(edges, forces)):
        return False
    masses, place, known = masses_at(point)
    n, squares = len(place), []
    for distance in POLE_DISTANCES:
        for k in range(3):
            near = place + distance * np.cos(1 + 2 * k + (3 + k) * np.arange(n))
            values = known | dict(zip(form.q, near.tolist(), strict=True))
            force, mass = numeric(forces, values).ravel(), numeric(masses, values)
            if not all(np.isrealobj(x) and np.isfinite(x).all() for x in (near, force, mass)):
                return False
            try:
                squares.append(float(np.sum(np.linalg.solve(np.linalg.cholesky(mass), force) ** 2)))
            except np.linalg.LinAlgError:  # M is also singular near the point
                return False
    return min(squares) > SAME_SQUARE * max(squares)


def masses_at(point: StatedPoint) -> tuple[Any, Any, dict[Any, Any]]:
    """Return (mass matrix as a function of q, values of the coordinates (n,), values of the parameters) at a point.

    Velocities have their values at the point. A parameter without a value gets an arbitrary one.
    """
    form, still = point.form, dict(zip(point.form.v, point.v, strict=True))
    known = {p: sympy.Rational(15 + 4 * k, 11) for k, p in enumerate(form.statement.parameters)} | point.numbers
    masses = sympy.Matrix([[p.diff(v).xreplace(still) for v in form.v] for p in form.momenta])
    return masses, numeric(sympy.Matrix(point.q), known).ravel(), known


def _note(
    point: StatedPoint, unbalanced: Sequence[Any], names_of_forces: Sequence[str], balanced: bool, steady: bool
) -> str:
    """Return a sentence that says whether the point is an equilibrium or a steady motion, and else lists forces.

    `unbalanced` are the forces left at the point, and `names_of_forces` the names of their coordinates. `balanced` is
    true if these forces are zero, `steady` if the linear equations remain valid along the motion.
    """
    form = point.form
    if balanced and steady:
        on_constraints = " on the constraints" if form.statement.constraints else ""
        return f"About {'a steady motion' if any(point.v) else 'an equilibrium'}{on_constraints}."
    if balanced:
        moving = listing(name for name, v in zip(form.statement.names, point.v, strict=True) if v != 0)
        return f"Away from equilibrium: {moving} moves, and the matrices are valid at this instant."
    parts = [
        f"{formula(form.written(force), 80)} on {name}"
        for name, force in zip(names_of_forces, unbalanced, strict=True)
        if not point.is_zero(force, ())
    ]
    return f"Away from equilibrium: the forces left are {listing(parts)}, and the matrices are valid at this instant."


INPUT_STEP = 1e-3
"""Change of an input, from which the input matrix is verified by differences. They are exact for linear forces."""

INPUT_ERROR = 1e-5
"""Largest difference of the input matrix B from its value by finite differences, relative to the largest derivative.
Forces that are not linear in the input add to the difference."""


def check(lin: Linearization, point: StatedPoint, model: Model) -> None:
    """Raise RunError if a linearization differs from the derivatives of the compiled model at the point.

    They are compared at the stated values of the parameters, if all have one, and at random values, unless the point
    or the matrices contain decimals.
    """
    statement = point.form.statement

    def at_point(sample: SamplePoint) -> tuple[Any, Any]:
        numbers = {p: sympy.Rational(x) for p, x in sample.parameters.items()} | {t: sympy.Rational(sample.t)}
        return _both(lin, point, model, numbers | {u: x.xreplace(numbers) for u, x in point.inputs.items()})

    if not set(statement.without_values) - set(point.inputs):
        defaults = {p: statement.defaults.get(p, 0.0) for p in statement.parameters}
        zero = (0.0,) * len(statement.coordinates)
        agrees("the linearization", statement, SamplePoint(zero, zero, 0.3, defaults, "the point given"), at_point)
    if not (point.decimal or lin.decimal):
        compared("the linearization", statement, at_point)


def _both(lin: Linearization, point: StatedPoint, model: Model, values: Any) -> tuple[Any, Any]:
    """Return two lists of numbers to compare: coefficients by the compiled model, and by the linearization.

    They are the rows of A that give the rates of x', or a column of the input matrix B that differs. If a matrix is
    singular, or not real and finite, the second list is [NaN]. `values` maps the parameters and t to numbers.
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
    # The velocities without inertia are the matrix `shares` times the deviations [x, x' with inertia].
    forces, count = np.hstack([-stiffness, -damping[:, fast]]), stiffness.shape[1]
    shares = np.linalg.solve(resistance, forces[slow])
    formulas = np.linalg.solve(inertia, forces[fast] - damping[np.ix_(fast, slow)] @ shares)
    # The independent velocities are a selection of all velocities, so their rates are rows of the full Jacobian.
    jacobian = model.jacobian(time, state, parameters)

    def slopes_of(part: slice) -> tuple[Any, Any]:
        """Return derivatives of the compiled rates of q or v (`part`) by independent coordinates and velocities."""
        rows = jacobian[part][lin.speeds]
        by_v = rows[:, model.layout.v]
        return rows[:, model.layout.q] @ basis + by_v @ slopes, by_v @ speeds

    by_place, by_speed = slopes_of(model.layout.v)
    compiled = np.hstack([by_place[fast], by_speed[np.ix_(fast, fast)]]) + by_speed[np.ix_(fast, slow)] @ shares
    if model.equations.rates_are_solved:
        rates_by_place, rates_by_speed = slopes_of(model.layout.q)
        compiled_slow = np.hstack([rates_by_place[slow], rates_by_speed[np.ix_(slow, fast)]])
        formulas_slow = shares
    else:
        # This compiled model computes accelerations for velocities without inertia, too.
        compiled_slow = by_speed[slow]
        formulas_slow = shares[:, :count] @ speeds[lin.places] + shares[:, count:] @ by_speed[fast]
    scale = max(1e-300, np.abs(by_speed).max(), np.abs(by_place).max())
    for k, u in enumerate(point.inputs):
        # Velocities without inertia change with the input without delay.
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


LARGEST_DIFFERENCE = 1e-7
"""Largest error of a linearization, relative to the largest entry of the compiled Jacobian. Both have ten digits."""


def check_turns(lin: Linearization, changes: SmallChanges, point: StatedPoint, model: Model) -> None:
    """Raise RunError if a linearization in small turns of bodies differs from the compiled model, in quaternions.

    `lin` was made from `changes`. The comparison is at the parameters' values, and left out if one has no value.
    """
    statement = point.form.statement
    if set(statement.without_values) - set(point.inputs):
        return
    numbers = {p: sympy.Float(x, 30) for p, x in statement.defaults.items()} | {t: sympy.S.Zero}
    numbers |= {u: x.xreplace(numbers) for u, x in point.inputs.items()}
    matrices = (lin.M, lin.C, lin.K, lin.basis, lin.velocity_basis, lin.velocity_slope)
    mass, damping, stiffness, basis, speeds, slopes = (numeric(matrix, numbers) for matrix in matrices)
    turned, bent, turn, turn_rate, turn_bend = (numeric(matrix, numbers) for matrix in changes.turn_matrices)
    state = numeric(sympy.Matrix([*point.q, *point.v]), numbers).ravel()
    jacobian = model.jacobian(0.0, state, {p: float(numbers[p]) for p in statement.parameters})
    # Changes of the small turns, their rates and accelerations, by independent changes of positions and velocities.
    still = np.zeros((len(basis), speeds.shape[1]))
    turns, rates = np.hstack([basis, still]), np.hstack([slopes, speeds])
    accelerations = np.hstack([bent, turned]) - speeds @ np.linalg.solve(mass, np.hstack([stiffness, damping]))
    expected = turn @ accelerations + 2 * turn_rate @ rates + turn_bend @ turns
    compiled = jacobian[model.layout.v] @ np.vstack([turn @ turns, turn @ rates + turn_rate @ turns])
    if not np.abs(compiled - expected).max() <= LARGEST_DIFFERENCE * max(np.abs(compiled).max(), 1e-300):
        raise RunError(f"the linear equations of {statement.name} differ from its compiled model. {FAULT}")
