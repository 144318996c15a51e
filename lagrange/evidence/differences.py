"""Numerical differentiation for checks: the difference steps, and the formulas of momenta, forces and equations."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import sympy

from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.statement.random_states import children, onto_constraints
from lagrange.statement.statement import Statement

Numbers = list[Any]
Row = dict[int, Any]
"""Nonzero entries of a row, by column. A sparse matrix is a list of such rows."""
Rows = Sequence[int] | None  # Indices of the equations to compute; None for all

DIFFERENCE_STEP, QUICK_DIFFERENCE_STEP = "1e-18", "1e-12"
"""Steps of the differences of `check`, in 90 digits, and of the check of a new model, in 50: relative to the argument.
The errors are about 1e-36 and 1e-24 before extrapolation.
"""


class Estimate(NamedTuple):
    """Extrapolated results, with an estimate of their errors.

    `value` are the results, `error` is a bound on the error of each, and `coarse` are the results with the longer step.
    """

    value: Numbers
    error: Numbers
    coarse: Numbers


def central(function: Callable[[Any], Sequence[Any]], step: Any) -> Numbers:
    """Return the central difference (f(step) - f(-step)) / (2 step), which approximates df/dx at 0."""
    ahead, behind = function(step), function(-step)
    return [(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)]


def extrapolated(coarse: Sequence[Any], fine: Sequence[Any]) -> Estimate:
    """Return the limit of results as the difference steps go to 0, with an error bound.

    `fine` are the results with half the steps of `coarse`. Their error is a series in even powers of the step. This
    holds for nested differences as well, and for results computed from them, such as solutions of linear systems.
    """
    value = [(4 * f - c) / 3 for f, c in zip(fine, coarse, strict=True)]
    return Estimate(value, [abs(x - f) for x, f in zip(value, fine, strict=True)], list(coarse))


LOCAL_FROM = 13
"""Smallest number of coordinates for which terms are separated. For fewer, one program is as fast."""


@dataclass(frozen=True)
class Terms:
    """Programs for L and D, each with at least the terms that contain one coordinate or velocity.

    `by_velocity` has a program for the terms of L with each velocity, and `by_place` for the terms with each
    coordinate. The last result of a program in `dissipation` is the sum of the terms of D with one velocity. `read` has
    for each velocity the entries of (q, v) in these terms of L. `touched` has for each entry of (q, v) the indices of
    the equations of motion that contain it.
    """

    by_velocity: Sequence[Precise]
    by_place: Sequence[Precise]
    dissipation: Sequence[Precise]
    read: Sequence[Collection[int]]
    touched: Sequence[Sequence[int]]


def terms_of(statement: Statement, lagrangian: Precise, loads: Precise, digits: int) -> Terms:
    """Return programs for the terms of L and D that contain each coordinate or velocity.

    `lagrangian` computes L, and the last result of `loads` is D. For few coordinates each program is one of these two.
    `digits` is the precision of the programs.
    """
    n, width = len(statement.coordinates), len(statement.state_names)
    if n < LOCAL_FROM:
        return Terms([lagrangian] * n, [lagrangian] * n, [loads] * n, [range(width)] * n, [range(n)] * width)
    terms, drag = (_terms(stated, statement) for stated in (statement.lagrangian, statement.dissipation))
    parts = _by(statement.velocities, terms), _by(statement.coordinates, terms), _by(statement.velocities, drag)
    by_velocity, by_place, dissipation = ([Precise([part], statement, digits) for part in row] for row in parts)
    touched: list[list[int]] = [[] for _ in statement.state_names]
    for i, force in enumerate(statement.forces):
        programs = (by_velocity[i], by_place[i], dissipation[i], Precise([force], statement, digits))
        # If p_i contains a coordinate, dp_i/dt contains its velocity.
        rates = {k + n for k in by_velocity[i].entries if k < n}
        for k in sorted(rates.union(*(program.entries for program in programs))):
            touched[k].append(i)
    return Terms(by_velocity, by_place, dissipation, [program.entries for program in by_velocity], touched)


def _terms(expression: Any, statement: Statement) -> list[tuple[Any, frozenset[Any]]]:
    """Return pairs (term, coordinates and velocities in the term) of an expression; c (a + b) counts as two terms."""
    moving = frozenset((*statement.coordinates, *statement.velocities))
    pairs = []
    stack = list(sympy.Add.make_args(expression))
    while stack:
        term = stack.pop()
        factors = [part for part in sympy.Mul.make_args(term) if leaves(part) & moving]
        if term.is_Mul and len(factors) == 1 and factors[0].is_Add:
            rest = term / factors[0]
            stack.extend(rest * part for part in factors[0].args)
        else:
            pairs.append((term, leaves(term) & moving))
    return pairs


def _by(variables: Sequence[Any], terms: Sequence[tuple[Any, frozenset[Any]]]) -> list[Any]:
    """Return for each variable the sum of all terms that contain it."""
    parts: dict[Any, list[Any]] = {variable: [] for variable in variables}
    for term, moving in terms:
        for variable in moving & parts.keys():
            parts[variable].append(term)
    return [sympy.Add(*parts[variable]) for variable in variables]


def leaves(expression: Any) -> frozenset[Any]:
    """Return the leaves of an expression: coordinates, velocities, symbols and numbers."""
    visited, stack = {expression}, [expression]
    while stack:
        fresh = [child for child in children(stack.pop()) if child not in visited]
        visited.update(fresh)
        stack.extend(fresh)
    return frozenset(node for node in visited if not children(node))


StateFunction = Callable[[Any, Any, Any], Any]
Nudge = Callable[[str, int], Any]


def exactly(_name: str, _index: int) -> int:
    """Return 1, the factor of a term in a computation that does not model rounding errors by random factors."""
    return 1


@dataclass(frozen=True)
class DifferenceSteps:
    """Steps of central differences: `q` and `v` for each entry of the state, and `motion` in time along the motion."""

    q: Numbers
    v: Numbers
    motion: Any

    @classmethod
    def at(
        cls, q: Sequence[Any], v: Sequence[Any], t: Any, unit: Any, *, timed: bool, sizes: Sequence[Numbers] = ()
    ) -> DifferenceSteps:
        """Return steps at a state (q, v): `unit` times the `sizes` of q and v.

        Without `sizes` the size of an entry is its magnitude, or 1 for a zero. During the time step no coordinate
        changes by more than its own step. If `timed` is true, the time step is also at most `unit` times |t|. This
        limit is not always used: for a planet in SI units the time step would be so short that differences lose all
        digits.
        """
        by_q, by_v = ([unit * x for x in part] for part in sizes or [[abs(x) or 1 for x in part] for part in (q, v)])
        times = [step / abs(rate) for step, rate in zip(by_q, v, strict=True) if rate]
        if timed or not times:
            times.append(unit * (abs(t) or 1))
        return cls(by_q, by_v, min(times))

    def times(self, scale: Any) -> DifferenceSteps:
        """Return all steps multiplied by `scale`, such as 1/2 for the extrapolation of nested differences."""
        return DifferenceSteps([scale * h for h in self.q], [scale * h for h in self.v], scale * self.motion)


@dataclass(frozen=True)
class Sources:
    """The stated L, Q and D as functions of (q, v, t), and the terms of the equations of motion by differences.

    - `for_momenta(i)`, `for_mass(i)` and `dissipation(i)` have at least the terms with velocity i; `for_forces(i)`
      has at least the terms with coordinate i. `applied` are the forces Q.
    - `read(i)` lists the entries of (q, v) that occur in terms with velocity i.
    - `touched(j)` lists the indices of the equations of motion that contain entry j of (q, v).
    - `nudge(name, index)` is a factor close to 1 for a term of a sum; it is the same at each evaluation.

    To measure rounding errors, these functions are replaced by copies in which each intermediate number has a random
    factor close to 1. L is stored three times, for p, for dL/dq and for M, because compiled code computes these
    independently: each copy has its own factors.

    Methods take q, v, t, and the steps of the differences. They return n numbers, or only the entries listed in `rows`.
    """

    lagrangian: StateFunction
    for_momenta: Callable[[int], StateFunction]
    for_forces: Callable[[int], StateFunction]
    for_mass: Callable[[int], StateFunction]
    applied: StateFunction
    dissipation: Callable[[int], StateFunction] | None
    nudge: Nudge
    read: Callable[[int], Collection[int]]
    touched: Callable[[int], Sequence[int]]

    def momenta(self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, rows: Rows = None) -> Numbers:
        """Return the momenta p = dL/dv."""
        return _gradient(lambda i, x: self.for_momenta(i)(q, x, t), v, rows, steps.v)

    def forces(self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, rows: Rows = None) -> Numbers:
        """Return the forces f = dL/dq + Q - dD/dv."""
        total = _gradient(lambda i, x: self.for_forces(i)(x, v, t), q, rows, steps.q)
        applied = self.applied(q, v, t)
        total = [a + applied[i] for a, i in zip(total, range(len(q)) if rows is None else rows, strict=True)]
        if self.dissipation is None:
            return total
        drag = self.dissipation
        slopes = _gradient(lambda i, x: drag(i)(q, x, t), v, rows, steps.v)
        return [a - b for a, b in zip(total, slopes, strict=True)]

    def mass_matrix(self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps) -> list[Row]:
        """Return the n rows of the mass matrix M = d2L/dv2, each as {column: entry}."""
        n = len(q)
        rows: list[Row] = [{} for _ in range(n)]
        for i in range(n):
            for j in sorted(k - n for k in self.read(i) if n <= k <= n + i):

                def slope(x: Any, i: int = i, j: int = j) -> Numbers:
                    function = self.for_mass(i)
                    return central(lambda y: [function(q, moved(moved(v, i, x), j, y), t)], steps.v[j])

                rows[i][j] = rows[j][i] = central(slope, steps.v[i])[0]
        return rows

    def momentum_rate(
        self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, a: Numbers, rows: Rows = None
    ) -> Numbers:
        """Return dp/dt at accelerations `a`."""
        n, point, direction = len(q), [*q, *v], [*v, *a]
        needed = range(len(point)) if rows is None else sorted({k for i in rows for k in self.read(i)})
        for k in needed:
            direction[k] *= self.nudge("velocity", k) if k < n else self.nudge("acceleration", k - n)
        t_along = self.nudge("time", 0)

        def momenta_at(s: Any) -> Numbers:
            y = list(point)
            for k in needed:
                y[k] = point[k] + s * direction[k]
            return self.momenta(y[:n], y[n:], t + s * t_along, steps, rows)

        return central(momenta_at, steps.motion)

    def residual(
        self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, a: Numbers, rows: Rows = None
    ) -> Numbers:
        """Return dp/dt - f, which is zero for the right accelerations `a`."""
        rates, loads = self.momentum_rate(q, v, t, steps, a, rows), self.forces(q, v, t, steps, rows)
        return [rate - load for rate, load in zip(rates, loads, strict=True)]

    def energy(self, v: Numbers, p: Numbers, lagrangian: Any) -> Any:
        """Return the energy v.p - L."""
        return sum((self.nudge("energy", i) * x * y for i, (x, y) in enumerate(zip(v, p, strict=True))), -lagrangian)

    def residual_slopes(
        self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, a: Numbers, columns: Sequence[int]
    ) -> list[Row]:
        """Return the derivatives of dp/dt - f by y_j, {equation: slope}, for each j in `columns`, where y = (q, v).

        Differentiating M a = h gives M da/dy_j = -d(dp/dt - f)/dy_j. So the Jacobian of the accelerations needs no
        accelerations at displaced states. The right-hand side is the residual with dL/dy_j, dQ/dy_j and dD/dy_j in
        place of L, Q and D. For a velocity v_k there is an additional term dp/dq_k, as dp/dt contains v_k dp/dq_k. The
        displacement of y_j is the innermost loop, since a program then repeats only the operations that depend on y_j.
        """
        n, drag, here = len(q), self.dissipation, (q, v, t, steps)
        touched = {j: frozenset(self.touched(j)) for j in columns}
        applied = {j: slope(lambda q, v, t: np.array(self.applied(q, v, t)), *here, {j: 1}) for j in columns}

        def row(i: int) -> Row:
            listed, read = [j for j in columns if i in touched[j]], self.read(i)

            def by_columns(function: StateFunction, entries: Collection[int]) -> StateFunction:
                return lambda q, v, t: np.array(
                    [slope(function, q, v, t, steps, {j: 1}) if j in entries else 0 for j in listed]
                )

            differentiated = replace(
                self,
                for_momenta=lambda i: by_columns(self.for_momenta(i), read),
                for_forces=lambda i: by_columns(self.for_forces(i), listed),
                applied=lambda q, v, t: {i: np.array([applied[j][i] for j in listed])},
                dissipation=None if drag is None else lambda i: by_columns(drag(i), listed),
            )
            entries = dict(zip(listed, differentiated.residual(*here, a, [i])[0], strict=True)) if listed else {}
            for k in (j - n for j in listed if j - n in read):
                change = slope(lambda q, v, t: self.momenta(q, v, t, steps, [i])[0], *here, {k: 1})
                entries[n + k] += self.nudge("velocity", k) * change
            return entries

        rows = [row(i) for i in range(n)]
        return [{i: entries[j] for i, entries in enumerate(rows) if j in entries} for j in columns]


def slope(
    function: StateFunction, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, direction: Mapping[int, Any]
) -> Any:
    """Return the derivative of a function of (q, v, t) along a direction, {index in (q, v): weight}.

    The function returns a number or an array. No entry of (q, v) changes by more than its own step.
    """
    n, sizes = len(q), (*steps.q, *steps.v)
    h = min(sizes[j] / abs(weight) for j, weight in direction.items())

    def value(s: Any) -> Any:
        y = [*q, *v]
        for j, weight in direction.items():
            y[j] = y[j] + s * weight
        return function(y[:n], y[n:], t)

    return (value(h) - value(-h)) / (2 * h)


TRUSTED = 1e-12
"""Smallest pivot, relative to its diagonal entry, for which a factorization needs no row exchanges."""


class SingularMass(OutsideDomain):
    """Raised if the mass matrix is singular at the point."""


def factorized(matrix: Sequence[Row], threshold: Any) -> Callable[[Row], Row]:
    """Return a function that solves `matrix` * x = r for any r. Rows and vectors are {index: entry}.

    Raises SingularMass if a pivot, relative to the largest entry of its row, is at most `threshold`.
    """
    n = len(matrix)
    rows = [{j: x for j, x in row.items() if x} for row in matrix]
    sizes = [max(map(abs, row.values()), default=0) for row in rows]
    exchanges, factors = [], list[list[tuple[int, Any]]]()
    for k in range(n):
        best = max((i for i in range(k, n) if k in rows[i]), key=lambda i: abs(rows[i][k]) / sizes[i], default=k)
        rows[k], rows[best], sizes[k], sizes[best] = rows[best], rows[k], sizes[best], sizes[k]
        if abs(rows[k].get(k, 0)) <= threshold * sizes[k]:
            raise SingularMass("the mass matrix is singular")
        pivot = rows[k][k]
        exchanges.append(best)
        factors.append([(i, rows[i].pop(k) / pivot) for i in range(k + 1, n) if k in rows[i]])
        for i, factor in factors[k]:
            row = rows[i]
            for j, y in rows[k].items():
                if j > k:
                    row[j] = row.get(j, 0) - factor * y
    above = [[(j, y) for j, y in row.items() if j > i] for i, row in enumerate(rows)]

    def solution(right: Row) -> Row:
        rest = dict(right)
        for k, best in enumerate(exchanges):
            if best != k:
                exchanged = [(i, rest.pop(j)) for i, j in ((k, best), (best, k)) if j in rest]
                rest.update(exchanged)
            if k in rest:
                rest.update((i, rest.get(i, 0) - factor * rest[k]) for i, factor in factors[k])
        x: Row = {}
        for i in reversed(range(n)):
            entry = rest.get(i, 0) - sum(y * x[j] for j, y in above[i] if j in x)
            if entry:
                x[i] = entry / rows[i][i]
        return x

    return solution


def solve_dense(matrix: Sequence[Numbers], right: Numbers, threshold: Any) -> Numbers:
    """Return the solution x of matrix * x = right, where rows and vectors are lists of all entries.

    Raises SingularMass if a pivot, relative to the largest entry of its row, is at most `threshold`.
    """
    rows = [dict(enumerate(row)) for row in matrix]
    x = factorized(rows, threshold)(dict(enumerate(right)))
    return [x.get(i, 0) for i in range(len(rows))]


def balance(matrix: Sequence[Row], n: int) -> Numbers:
    """Return scale factors d for A = [[M, G^T], [G, 0]], such that the products d_i A_ij d_j do not depend on units.

    The diagonal of M becomes 1, and so does the largest entry in each row of G. A coordinate without inertia gets the
    factor of the largest diagonal entry. n is the size of M.
    """
    diagonal = [abs(matrix[i].get(i, 0)) for i in range(n)]
    largest = max(diagonal) or 1
    scales = [(x or largest) ** -0.5 for x in diagonal]
    for row in matrix[n:]:
        scales.append(1 / max((abs(x * scales[j]) for j, x in row.items() if x and j < n), default=1))
    return scales


def factorization_sizes(matrix: Sequence[Row], negative: int = 0) -> list[Row]:
    """Return the magnitudes of the numbers in a factorization of a symmetric matrix, as n rows.

    For M = L D L^T they are |L| |D| |L^T|; the pivots must be positive, except for the last `negative` ones. In
    floating point the solution with these factors is exact for a matrix that differs by a few roundings of these
    numbers (N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd edition, 2002, theorem 10.3). Other
    matrices need row exchanges; for them the result is computed from the largest entries of the rows.
    """
    n = len(matrix)
    sizes = [{j: abs(x) for j, x in row.items()} for row in matrix]
    below = [{i: x for i, x in row.items() if i >= k and x} for k, row in enumerate(matrix)]
    for k, column in enumerate(below):
        pivot = column.pop(k, 0)
        if (pivot if k < n - negative else -pivot) <= TRUSTED * sizes[k].get(k, 0):
            largest = [max(map(abs, row.values()), default=0) for row in matrix]
            return [
                {j: max(abs(row.get(j, 0)), (a * b) ** 0.5) for j, b in enumerate(largest)}
                for row, a in zip(matrix, largest, strict=True)
            ]
        for i, x in column.items():
            factor = x / pivot
            for j, y in column.items():
                if j <= i:
                    term = factor * y
                    below[j][i] = below[j].get(i, 0) - term
                    sizes[i][j] = sizes[j][i] = sizes[i].get(j, 0) + abs(term)
    return sizes


def along(x: Sequence[Any], direction: Sequence[Any], s: Any) -> Numbers:
    """Return x + s direction, entry by entry."""
    return [a + s * b for a, b in zip(x, direction, strict=True)]


def _gradient(function: Callable[[int, Numbers], Any], x: Numbers, rows: Rows, steps: Numbers) -> Numbers:
    """Return d function(i, x) / dx_i for each i in `rows` (None for all); `steps` has a step for each entry of x."""

    def slope(i: int) -> Any:
        return central(lambda h: [function(i, moved(x, i, h))], steps[i])[0]

    return [slope(i) for i in (range(len(x)) if rows is None else rows)]


def moved(x: Sequence[Any], i: int, distance: Any) -> Numbers:
    """Return a copy of x with `distance` added to entry i."""
    y = list(x)
    y[i] = y[i] + distance
    return y


@dataclass(frozen=True)
class StatedConstraints:
    """The m constraint expressions as functions of (q, v, t), and their time derivatives by differences.

    `holonomic` has True for each constraint on positions. `for_gradient` is used for the gradient G, and `for_rates`
    for time derivatives. Both have the same values. To measure rounding errors, each is replaced by a copy with its own
    random factors close to 1.
    """

    for_gradient: StateFunction
    for_rates: StateFunction
    holonomic: tuple[bool, ...]
    nudge: Nudge = exactly

    @staticmethod
    def alike(values: StateFunction, holonomic: tuple[bool, ...]) -> StatedConstraints:
        """Return constraints that use the function `values` both for G and for the time derivatives."""
        return StatedConstraints(values, values, holonomic)

    def chosen(self, by_position: Sequence[Any], by_velocity: Sequence[Any]) -> Numbers:
        """Return one entry for each constraint, from `by_position` if it is holonomic, else from `by_velocity`."""
        return [
            a if is_holonomic else b
            for a, b, is_holonomic in zip(by_position, by_velocity, self.holonomic, strict=True)
        ]

    def gradient(self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps) -> list[Numbers]:
        """Return the gradient G, m rows of n numbers: dphi/dq of a holonomic constraint, else dpsi/dv."""

        def by_q(j: int) -> Numbers:
            return central(lambda h: self.for_gradient(moved(q, j, h), v, t), steps.q[j])

        def by_v(j: int) -> Numbers:
            return central(lambda h: self.for_gradient(q, moved(v, j, h), t), steps.v[j])

        unused: Numbers = [0] * len(self.holonomic)
        columns = [
            self.chosen(by_q(j) if any(self.holonomic) else unused, unused if all(self.holonomic) else by_v(j))
            for j in range(len(q))
        ]
        return [list(row) for row in zip(*columns, strict=True)]

    def velocity_level(self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps) -> Numbers:
        """Return psi, m numbers: dphi/dt of a holonomic constraint, or the expression of a constraint on velocities."""
        still: Numbers = [0] * len(q)
        moving = (
            self._rates(self.for_rates, q, v, t, steps, still) if any(self.holonomic) else [0] * len(self.holonomic)
        )
        return self.chosen(moving, self.for_rates(q, v, t))

    def acceleration_level(self, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, a: Numbers) -> Numbers:
        """Return dpsi/dt = G a + gamma, m numbers, at accelerations `a`."""

        def rates(q: Numbers, v: Numbers, t: Any) -> Numbers:
            return self._rates(self.for_rates, q, v, t, steps, a)

        unused: Numbers = [0] * len(self.holonomic)
        return self.chosen(
            self._rates(rates, q, v, t, steps, a) if any(self.holonomic) else unused,
            unused if all(self.holonomic) else rates(q, v, t),
        )

    def _rates(
        self, function: StateFunction, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, a: Numbers
    ) -> Numbers:
        """Return the time derivatives of the m values of `function` along the path q + v s + a s^2/2."""
        v_along = [x * self.nudge("held velocity", i) for i, x in enumerate(v)]
        a_along = [x * self.nudge("held acceleration", i) for i, x in enumerate(a)]
        t_along = self.nudge("held time", 0)

        def values_at(s: Any) -> Numbers:
            values: Numbers = function(
                along(along(q, v_along, s), a_along, s * s / 2), along(v, a_along, s), t + s * t_along
            )
            return values

        return central(values_at, steps.motion)


def reactions(gradient: Sequence[Numbers], multipliers: Sequence[Any]) -> list[Numbers]:
    """Return the constraint forces G_i^T lambda_i, m rows of n numbers."""
    return [[entry * x for entry in row] for row, x in zip(gradient, multipliers, strict=True)]


def bordered(mass: Sequence[Row], gradient: Sequence[Numbers]) -> list[Row]:
    """Return the rows of [[M, G^T], [G, 0]]. For the right-hand side [h, -gamma] the solution is [a, -lambda]."""
    upper = [dict(row) for row in mass]
    lower = [{i: x for i, x in enumerate(line) if x} for line in gradient]
    for j, line in enumerate(lower, len(mass)):
        for i, x in line.items():
            upper[i][j] = x
    return upper + lower


CONSTRAINT_DIGITS = 60
"""Decimal digits of constraint values. First differences with steps of 1e-20 keep two thirds of them."""


class ConstraintSurface:
    """The states (q, v) that satisfy the constraints on positions and on velocities."""

    def __init__(self, statement: Statement, digits: int = CONSTRAINT_DIGITS) -> None:
        self.tape = Precise([constraint.expression for constraint in statement.constraints], statement, digits)
        self.holonomic = tuple(constraint.holonomic for constraint in statement.constraints)
        self.number = self.tape.context.mpf
        self.step = self.number(10) ** -(digits // 3)

    def nearest(
        self, q: Sequence[Any], v: Sequence[Any], t: Any, parameters: Mapping[Any, Any]
    ) -> tuple[Numbers, Numbers]:
        """Return q and v moved along the rows of G to the constraints. Raises OutsideDomain if this fails."""
        values = {p: self.number(x) for p, x in parameters.items()}
        t = self.number(t)

        def zero(q: Sequence[Any], v: Sequence[Any], t: Any) -> Numbers:
            return self.tape(q, v, t, values)

        stated = StatedConstraints.alike(zero, self.holonomic)
        rows = [i for i, is_holonomic in enumerate(self.holonomic) if is_holonomic]

        def residuals_at(level: int, q: Numbers, v: Numbers) -> tuple[Numbers, list[Numbers]]:
            steps = DifferenceSteps.at(q, v, t, self.step, timed=self.tape.uses_time)
            slopes = stated.gradient(q, v, t, steps)
            if level:
                return stated.velocity_level(q, v, t, steps), slopes
            residuals = zero(q, v, t)
            return [residuals[i] for i in rows], [slopes[i] for i in rows]

        def solve(matrix: Sequence[Numbers], right: Numbers) -> Numbers:
            return solve_dense(matrix, right, self.step)

        moved = onto_constraints(list(map(self.number, q)), list(map(self.number, v)), residuals_at, solve, self.step)
        if moved is None:
            raise OutsideDomain("no state nearby satisfies the constraints")
        return moved
