"""Decide whether an equilibrium is stable, and follow eigenvalues over values of a parameter."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import sympy

from lagrange.equations.terms import differentiable
from lagrange.errors import RunError, StatementError, listing
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.expansion import StatedPoint, stated_point
from lagrange.mechanics.linearization import (
    MOST_OPERATIONS,
    POLE_DISTANCES,
    Linearization,
    has_inertia,
    has_long_formulas,
    linearized_at,
    masses_at,
)
from lagrange.mechanics.plain_form import (
    PlainForm,
    is_zero,
    multiplied_out,
    number,
    numeric,
    real,
    simplest,
    vanishes,
    vanishes_in_symbols,
)
from lagrange.mechanics.roots import CONVERGED_STEP
from lagrange.statement.coordinate import t
from lagrange.statement.expression import real_array
from lagrange.statement.parameters import parameter_name
from lagrange.statement.statement import Statement

REAL_PART = 1e-6
"""Real parts below this fraction of the largest eigenvalue count as zero. Double eigenvalues have only 8 digits."""

LARGEST_DEGREE = 100  # Largest denominator of the degree in velocities of a term of the dissipation, such as 3/2
SAME_PLACE = 1e-9
"""Largest entry of M dq for two points at the same pole, relative to the largest entry of the mass matrix M. dq is the
difference of their coordinates, as in the longitude, which has no inertia at a pole."""
DEFINITE = 1e-9  # Eigenvalues of a symmetric matrix below this fraction of its largest entry count as zero


@dataclass(frozen=True)
class Verdict:
    """Stability of an equilibrium: `stable` is True, False, or None if undecided; `reason` is a sentence."""

    stable: bool | None
    reason: str


AT_POLE = "the mass matrix is singular there: choose coordinates that are regular there."
NO_INERTIA = "the mass matrix is singular at these values of the parameters: give other values."
NO_POINT = "the point does not exist at the values of the parameters."


def matrix_values(lin: Linearization, point: StatedPoint) -> Mapping[Any, Any] | None:
    """Return {symbol: value} for the matrices M, C and K of a linearization, or None if one symbol has no value."""
    numbers = point.numbers
    symbols = [s for matrix in (lin.M, lin.C, lin.K) for x in matrix for s in sorted(x.free_symbols, key=str)]
    return numbers if all(s in numbers for s in symbols) else None


def first_order_matrix(mass: Any, damping: Any, stiffness: Any) -> Any:
    """Return the matrix A (2n, 2n) with d/dt [x, v] = A [x, v] for M dv/dt + C v + K x = 0, all in numbers.

    Raises StatementError if M is singular.
    """
    n = mass.shape[0]
    try:
        lower = np.linalg.solve(mass, np.hstack([-stiffness, -damping]))
    except np.linalg.LinAlgError:
        raise StatementError(NO_INERTIA) from None
    return np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower])


def stability_of(lin: Linearization, point: StatedPoint, *, axial: bool = False) -> Verdict:
    """Return the stability of an equilibrium.

    If all parameters have values, eigenvalues and the energy decide. Else signs that SymPy can prove decide, if the
    formulas are not too long. `axial` is true if two coordinates are not ignorable and the system is symmetric under
    rotations in their plane about the equilibrium, such as an upright top.
    """
    form, values = point.form, matrix_values(lin, point)
    gone = ignorable(form) if not form.statement.constraints else ()
    slow = lin.without_inertia
    if slow and not is_zero(lin.C.extract(slow, slow).det(method="berkowitz")):
        if values is None:
            return Verdict(
                None,
                "states of first order have no energy, so eigenvalues decide on stability: give values of all "
                "parameters.",
            )
        rates = numeric(lin.A, values)
        if np.iscomplexobj(rates) or not np.isfinite(rates).all():
            return Verdict(None, NO_POINT)
        return _verdict_of_eigenvalues(np.linalg.eigvals(rates)) or Verdict(
            None, "eigenvalues on the imaginary axis do not decide on stability."
        )
    if not has_inertia(lin):
        return Verdict(None, AT_POLE)
    constraints = form.statement.constraints
    driven = any(not constraint.holonomic for constraint in constraints) or (bool(constraints) and any(point.v))
    if values is None and driven:  # K is not the curvature of an energy
        return Verdict(None, "with these constraints eigenvalues decide on stability: give values of all parameters.")
    if values is None and has_long_formulas(lin):
        return Verdict(
            None,
            f"the matrices of its linear equations have more than {MOST_OPERATIONS} operations, too many to decide on "
            "stability in symbols: give values of all parameters.",
        )
    if values is None:
        return _symbolic_verdict(lin, form, gone, axial=axial)
    parts = [numeric(x, values) for x in (lin.M, lin.C, lin.K)]
    if any(np.iscomplexobj(part) or not np.isfinite(part).all() for part in parts):
        return Verdict(None, NO_POINT)
    if np.linalg.matrix_rank(parts[0]) < len(parts[0]):
        return Verdict(None, NO_INERTIA)
    mass, damping, stiffness = at_fixed_momenta(parts[0], parts[1], parts[2], gone, axial=axial)
    return _numeric_verdict(mass, damping, stiffness, energetic=has_energy(form) and not driven)


def each_pole_once(points: Sequence[StatedPoint]) -> list[int]:
    """Return the indices of `points` without repetitions: only the first is kept of points at one pole.

    A pole is a point at which the coordinates are singular, such as theta = 0 on a sphere. Points at one pole differ in
    a coordinate without inertia there, such as the longitude. Near the pole every coordinate has inertia.
    """
    indices, poles = list[int](), list[Any]()
    for index, point in enumerate(points):
        masses, place, known = masses_at(point)
        near = place + POLE_DISTANCES[0] * np.cos(np.arange(len(place)))
        mass, regular = (
            numeric(masses, known | dict(zip(point.form.q, q.tolist(), strict=True))) for q in (place, near)
        )
        if np.isfinite(mass).all() and np.isfinite(regular).all():
            rounding = SAME_PLACE * np.abs(mass).max()
            if any(np.abs(mass @ (place - pole)).max() <= rounding for pole in poles):
                continue
            if min(np.linalg.svd(mass)[1]) <= rounding and np.linalg.matrix_rank(regular) == len(place):
                poles.append(place)
        indices.append(index)
    return indices


def criterion(lin: Linearization, fixed: tuple[int, ...], *, axial: bool = False) -> tuple[Any, ...]:
    """Return the leading minors of the stiffness matrix K at fixed momenta of ignorable coordinates.

    If all minors are positive, the energy has a minimum. `fixed` are the indices of the ignorable coordinates. `axial`
    is true if the system is symmetric under rotations in the plane of the two others. The result is empty if M is
    singular, or the formulas are too long.
    """
    if has_long_formulas(lin) or not has_inertia(lin):
        return ()
    _, _, stiffness = at_fixed_momenta(lin.M, lin.C, lin.K, fixed, axial=axial)
    return tuple(_leading_minors(stiffness))


def _leading_minors(matrix: Any) -> Iterator[Any]:
    """Yield the leading principal minors of a SymPy matrix, smallest first. All are positive if it is definite."""
    return (simplest(matrix[:k, :k].det(method="berkowitz")) for k in range(1, matrix.rows + 1))


def _symbolic_verdict(lin: Linearization, form: PlainForm, ignorable_rows: tuple[int, ...], *, axial: bool) -> Verdict:
    """Return a verdict on stability for all values of the parameters, from signs that SymPy can prove.

    If the signs do not suffice, the verdict is None with a reason. `ignorable_rows` are the indices of the ignorable
    coordinates. `axial` is true if the system is symmetric under rotations in the plane of the two others.
    """
    minors = criterion(lin, ignorable_rows, axial=axial)
    if any(minor.is_negative for minor in minors[:-1]):
        return Verdict(
            None, "the energy has no minimum there, so eigenvalues decide on stability: give values of all parameters."
        )
    if any(minor.is_nonpositive for minor in minors[:-1]) or (minors and minors[-1].is_zero):
        return Verdict(
            None,
            "the energy has no strict minimum to second order there, so eigenvalues decide on stability: give values "
            "of all parameters.",
        )
    if minors and _is_definite(lin.M) and all(map(is_zero, lin.K - lin.K.T)):
        if minors[-1].is_negative:
            return Verdict(
                stable=False, reason="the determinant of K is negative, so that an eigenvalue is real and positive."
            )
        if all(minor.is_positive for minor in minors):
            drag = lin.C + lin.C.T
            if (drag.is_zero_matrix or _is_definite(drag)) and has_energy(form):
                return Verdict(stable=True, reason="the energy has a strict minimum there.")
            return Verdict(None, "the energy has a strict minimum there, but forces may feed energy in.")
    return Verdict(
        None, f"stability depends on the parameters: the energy has a minimum if {listing(map(str, minors))} > 0."
    )


def _is_definite(matrix: Any) -> bool:
    """Return True if SymPy can prove a symmetric matrix positive definite, by its leading minors."""
    return all(minor.is_positive for minor in _leading_minors(matrix))


def ignorable(form: PlainForm) -> tuple[int, ...]:
    """Return the indices of ignorable coordinates, whose momenta are constant.

    Neither the Lagrangian nor forces nor constraints depend on such a coordinate, and no force acts along it.
    """
    statement = form.statement
    return tuple(
        i
        for i, q in enumerate(form.q)
        if vanishes(form, form.lagrangian.diff(q))
        and vanishes(form, form.forces[i])
        and all(vanishes(form, force.diff(q)) for force in form.forces)
        and not any(constraint.expression.has(statement.coordinates[i]) for constraint in statement.constraints)
        and not any(constraint.expression.has(statement.velocities[i]) for constraint in statement.constraints)
    )


def at_fixed_momenta(
    mass: Any, damping: Any, stiffness: Any, fixed: tuple[int, ...], *, axial: bool = False
) -> tuple[Any, Any, Any]:
    """Return M, C and K for the coordinates that are not ignorable, while the momenta of the others are constant.

    `fixed` are the indices of the ignorable coordinates. With I for these and R for the others, the momentum
    M_IR v_R + M_II v_I + C_IR q_R is constant, which gives v_I. The matrices are arrays or SymPy matrices. If `axial`
    is true, the system is symmetric under rotations in the plane of two coordinates R: M is m times the unit matrix,
    and C = c J with the matrix J of a quarter turn. Then these coordinates are measured along axes that turn at the
    rate c/2m: C is zero, and K is larger by c^2/4m.
    """
    if not fixed:
        return mass, damping, stiffness
    symbolic = isinstance(mass, sympy.MatrixBase)
    left = [i for i in range(mass.shape[0]) if i not in fixed]

    def part(matrix: Any, rows: Any, columns: Any) -> Any:
        return matrix.extract(list(rows), list(columns)) if symbolic else matrix[np.ix_(rows, columns)]

    ignored_mass = part(mass, fixed, fixed)
    inverse = ignored_mass.inv() if symbolic else np.linalg.inv(ignored_mass)
    m_ri, m_ir = part(mass, left, fixed), part(mass, fixed, left)
    c_ri, c_ir = part(damping, left, fixed), part(damping, fixed, left)
    mass = part(mass, left, left) - m_ri @ inverse @ m_ir
    damping = part(damping, left, left) - m_ri @ inverse @ c_ir - c_ri @ inverse @ m_ir
    stiffness = part(stiffness, left, left) - c_ri @ inverse @ c_ir
    if axial:
        return mass, 0 * damping, stiffness - damping @ damping / (4 * mass[0, 0])
    return mass, damping, stiffness


def has_energy(form: PlainForm) -> bool:
    """Return True if it is proven that the energy cannot grow: L is independent of time, and no force adds energy.

    Forces add no energy if no term of their power Q . v is positive. The dissipation is tested by `only_brakes`.
    """
    if not vanishes(form, form.lagrangian.diff(t)) or not only_brakes(form):
        return False
    forces = [force.xreplace(form.plain) for force in form.statement.forces]
    power = multiplied_out(sympy.Add(*(force * v for force, v in zip(forces, form.v, strict=True))))
    return all(term.is_nonpositive for term in sympy.Add.make_args(power)) or all(
        vanishes(form, form.read(force)) for force in forces
    )


def only_brakes(form: PlainForm) -> bool:
    """Return True if the dissipation function D never adds energy: the power v . dD/dv that it takes is not negative.

    For D = v C v/2 with a constant C the result is true, and the caller tests that C is positive semidefinite. Any
    other D must be a sum of terms that are homogeneous in the velocities and not negative.
    """
    stated = form.statement.dissipation.xreplace(form.plain)
    slopes = [form.read(form.statement.dissipation).diff(v) for v in form.v]
    rates = [[slope.diff(v) for v in form.v] for slope in slopes]
    linear = [
        slope - sympy.Add(*(rate * v for rate, v in zip(row, form.v, strict=True)))
        for slope, row in zip(slopes, rates, strict=True)
    ]
    moving = (*form.q, *form.v, t)
    if all(vanishes(form, x) for x in (*linear, *(rate.diff(z) for row in rates for rate in row for z in moving))):
        return True
    return all(_is_drag(term, form.v) for term in sympy.Add.make_args(stated))


def _is_drag(term: Any, v: Sequence[Any]) -> bool:
    """Return True if a term of the dissipation is homogeneous in the velocities v, of positive degree, and >= 0."""
    if not term.is_nonnegative:
        return False
    smooth = differentiable(term)
    # Euler: the sum of v dD/dv is D times its degree.
    grown = sympy.Add(*(x * smooth.diff(x) for x in v))
    values = {x: sympy.Rational(13 + 4 * k, 11) for k, x in enumerate(sorted(term.free_symbols, key=str))}
    whole = real(smooth, values)
    ratio = real(grown, values) / whole if whole else math.nan
    if not math.isfinite(ratio):
        return False
    degree = Fraction(ratio).limit_denominator(LARGEST_DEGREE)
    return degree > 0 and vanishes_in_symbols(grown - sympy.Rational(degree) * smooth)


def _verdict_of_eigenvalues(values: Any) -> Verdict | None:
    """Return the verdict on stability by the real parts of eigenvalues, or None if the largest counts as zero."""
    scale = max(1e-300, float(np.abs(values).max()))
    largest = float(values.real.max())
    if largest > REAL_PART * scale:
        return Verdict(stable=False, reason=f"an eigenvalue has the positive real part {largest:.6g}.")
    if largest < -REAL_PART * scale:
        return Verdict(stable=True, reason=f"all eigenvalues have negative real parts, up to {largest:.6g}.")
    return None


def _numeric_verdict(mass: Any, damping: Any, stiffness: Any, *, energetic: bool) -> Verdict:
    """Return the verdict on stability for M, C and K in numbers, by eigenvalues, then by the minimum of the energy.

    `energetic` is true if the energy cannot grow.
    """
    n = mass.shape[0]
    if not n:
        return Verdict(None, "nothing is left to move at fixed momenta.")
    decided = _verdict_of_eigenvalues(np.linalg.eigvals(first_order_matrix(mass, damping, stiffness)))
    if decided is not None:
        return decided
    drag = (damping + damping.T) / 2
    smallest = [float(np.linalg.eigvalsh((x + x.T) / 2).min()) for x in (mass, drag, stiffness)]
    sizes = [max(1e-300, float(np.abs(x).max())) for x in (mass, damping, stiffness)]
    symmetric = float(np.abs(stiffness - stiffness.T).max()) <= DEFINITE * sizes[2]
    braked = smallest[1] >= -DEFINITE * sizes[1]
    minimum = smallest[0] > 0 and smallest[2] > DEFINITE * sizes[2]
    if energetic and symmetric and braked and minimum:
        return Verdict(stable=True, reason="the energy has a strict minimum there.")
    if smallest[2] < -DEFINITE * sizes[2]:
        return Verdict(None, "no eigenvalue has a positive real part, and the energy has no minimum there.")
    if minimum and symmetric:
        return Verdict(
            None, "eigenvalues on the imaginary axis do not decide on stability, and forces may feed energy in."
        )
    return Verdict(
        None,
        "eigenvalues on the imaginary axis do not decide on stability, and the energy has no strict minimum to second "
        "order.",
    )


FOLLOWING_STEPS = 30
"""Largest number of Newton steps from the equilibrium at the previous value of the parameter to the next one."""

MOST_VALUES = 10_000  # Largest number of values of the parameter: each takes some milliseconds


@dataclass(frozen=True, eq=False, repr=False)
class EigenvaluePath:
    """Eigenvalues (k, 2n) of the linear equations at k `values` of a parameter, and the equilibria (k, n).

    Each column follows one eigenvalue from row to row. A row is NaN if no equilibrium was found. If there are
    constraints, a row has one eigenvalue for each independent coordinate and each independent velocity.
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
        """Mask (k,), true where no eigenvalue has a positive real part.

        This is necessary for stability, but not sufficient.
        """
        return without_growth(self.eigenvalues)


def without_growth(eigenvalues: Any) -> Any:
    """Return a mask (k,), true for each row of `eigenvalues` (k, 2n) without a positive real part; false for NaN."""
    return eigenvalues.real.max(axis=1) <= REAL_PART * np.abs(eigenvalues).max(axis=1)


def eigenvalue_path(statement: Statement, parameter: Any, values: Any, at: Any, model: Model) -> EigenvaluePath:
    """Return the eigenvalues about an equilibrium at each of the `values` of a parameter.

    `at` maps coordinates and velocities to expressions for the equilibrium, or to a guess of it. Raises StatementError
    if no equilibrium is found at any value, or if the forces have a corner or a jump at the point.
    """
    by_name = {p.name: p for p in statement.parameters}
    label = parameter_name(parameter, by_name)
    chosen = real_array(values, "values")
    if chosen.ndim != 1 or not 0 < len(chosen) <= MOST_VALUES:
        raise StatementError(f"values has shape {chosen.shape}: give a list of 1 to {MOST_VALUES} values of {label}.")
    point = stated_point(statement, at)
    point.check_corners()
    n = len(statement.coordinates)
    lin = _on_constraints(point) if statement.constraints else None
    rows = np.full((len(chosen), 2 * n if lin is None else lin.K.cols + lin.K.rows), complex("nan"), dtype=complex)
    equilibria = np.full((len(chosen), n), np.nan)
    before: FloatArray | None = None
    solved_rows: list[int] = []
    for k, value in enumerate(chosen):
        numbers = model.parameter_values({label: float(value)})
        state = _equilibrium(point, model, numbers, before) if lin is None else _stated(point, numbers)
        matrix = None if state is None else _matrix(lin, model, state, numbers)
        if state is None or matrix is None:
            continue
        # Extrapolation from two earlier rows keeps the columns in order where eigenvalues cross.
        expected = rows[solved_rows[-1]] if solved_rows else None
        if len(solved_rows) == 2 and chosen[solved_rows[1]] != chosen[solved_rows[0]]:
            first, last = solved_rows
            expected = rows[last] + (value - chosen[last]) / (chosen[last] - chosen[first]) * (rows[last] - rows[first])
        rows[k] = _matched(np.linalg.eigvals(matrix), expected)
        solved_rows = [*solved_rows[-1:], k]
        before = state if point.decimal else None
        equilibria[k] = state[model.layout.q]
    if np.isnan(equilibria).all():
        raise StatementError(
            f"no equilibrium was found at any of the {len(chosen)} values of {label}: give at={{...}}, a guess "
            "for the first value or expressions in the parameters."
        )
    return EigenvaluePath(by_name[label], chosen, rows, equilibria)


def _on_constraints(point: StatedPoint) -> Linearization:
    """Return the symbolic linearization at an equilibrium of a system with constraints.

    Raises StatementError if `point` has decimals, or is not an equilibrium.
    """
    name = point.form.statement.name
    lin = None if point.decimal else linearized_at(point)
    if lin is None or lin.decimal:
        raise StatementError(
            f"{name} has constraints, and an equilibrium in decimals cannot be followed over the values: give `at` as "
            "expressions in parameters."
        )
    if not lin.equilibrium:
        raise StatementError(f"there are no eigenvalues at this point of {name}. {lin.note}")
    return lin


def _matrix(lin: Linearization | None, model: Model, state: FloatArray, parameters: Any) -> FloatArray | None:
    """Return the matrix of the first-order linear equations at values of the `parameters`, or None if not finite.

    It is computed from the symbolic linearization `lin`. If `lin` is None, it is the Jacobian of the compiled `model`
    at the `state` (2n,).
    """
    if lin is None:
        return model.jacobian(0.0, state, parameters)
    mass, damping, stiffness, basis, slope = (
        numeric(x, parameters) for x in (lin.M, lin.C, lin.K, lin.velocity_basis, lin.velocity_slope)
    )
    forces, rates = np.hstack([-stiffness, -damping]), np.hstack([slope, basis])[lin.places]
    if not (np.isfinite(mass).all() and np.isfinite(forces).all() and np.isfinite(rates).all()):
        return None
    return np.vstack([rates, np.linalg.solve(mass, forces)])


def _stated(point: StatedPoint, parameters: Any) -> FloatArray | None:
    """Return the state [q, v] (2n,) of a point at values of the parameters, or None if it is not real and finite."""
    stated = np.array([number(x, parameters) for x in (*point.q, *point.v)])
    if not np.isfinite(stated).all() or np.abs(stated.imag).max() > 1e-12:
        return None
    return stated.real.copy()


def _equilibrium(point: StatedPoint, model: Model, parameters: Any, before: FloatArray | None) -> FloatArray | None:
    """Return the state (2n,) of the equilibrium at values of the `parameters`, or None if Newton's method fails.

    Newton's method starts from `before`, the equilibrium at the previous values, or from `point` if `before` is None.
    """
    state, (q, v) = _stated(point, parameters), (model.layout.q, model.layout.v)
    if state is None:
        return None
    if before is not None:
        state[q] = before[q]
    for _ in range(FOLLOWING_STEPS):
        try:
            a = model.accelerations(state[q], state[v], 0.0, parameters)
            slopes = model.jacobian(0.0, state, parameters)[v, q]
        except RunError:
            return None
        if not (np.isfinite(a).all() and np.isfinite(slopes).all()):
            return None
        step = np.linalg.pinv(slopes, rcond=1e-10) @ a
        state[q] -= step
        if np.abs(step).max() <= CONVERGED_STEP * (1 + np.abs(state[q]).max()):
            left = np.abs(model.accelerations(state[q], state[v], 0.0, parameters)).max()
            return state if left <= 1e-6 * max(1e-300, np.abs(slopes).max()) else None
    return None


def _matched(eigenvalues: Any, before: Any) -> Any:
    """Return the eigenvalues in the order closest to the row `before`, or sorted by real part if `before` is None."""
    from scipy.optimize import linear_sum_assignment

    ordered = np.sort_complex(np.asarray(eigenvalues))
    if before is None:
        return ordered
    _, columns = linear_sum_assignment(np.abs(before[:, None] - ordered[None, :]))
    return ordered[columns]
