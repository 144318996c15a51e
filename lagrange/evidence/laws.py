"""The laws of motion by numerical differentiation of a Lagrangian, written as the definitions read.

With L, the forces Q and the dissipation D as functions of (q, v, t) [1, chapters 1 and 2]:

    p = dL/dv    f = dL/dq + Q - dD/dv    M = d2L/dv2    energy = v.p - L    h = f - (dp/dq v + dp/dt)    M a = h

[1] H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd edition, 2002.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.evidence.central_differences import Numbers, central, central_mixed
from lagrange.evidence.precise import OutsideDomain

StateFunction = Callable[[Sequence[Any], Sequence[Any], Any], Any]
Nudge = Callable[[str, int], Any]


def exactly(_name: str, _index: int) -> int:
    """Return 1, the factor without a perturbation."""
    return 1


@dataclass(frozen=True)
class DifferenceSteps:
    """Step lengths of the differences: one per coordinate and velocity, and one along the motion."""

    q: Numbers
    v: Numbers
    motion: Any

    def times(self, scale: Any) -> DifferenceSteps:
        """Return all steps multiplied by `scale`, so that differences of differences extrapolate together."""
        return DifferenceSteps([scale * h for h in self.q], [scale * h for h in self.v], scale * self.motion)


@dataclass(frozen=True)
class Sources:
    """L, Q and D as functions of (q, v, t).

    L for p_i and D have the terms with the velocity i at least, L for (dL/dq)_i those with the coordinate i. `read`
    tells which entries of (q, v) stand in terms with the velocity i. `touched` tells in which rows of the equations
    of motion an entry of (q, v) stands. L is stored three times, for p, for dL/dq and for M: the perturbed copies
    that measure rounding must be independent where a program computes independently, because parts of dL/dq and of
    dp/dt can cancel in h. `nudge` gives the factors, close to 1, of the terms of the sums formed here, by name and
    index. It is the same for the same term, because differencing would magnify changes.
    """

    lagrangian: StateFunction
    for_momenta: Callable[[int], StateFunction]
    for_forces: Callable[[int], StateFunction]
    for_mass: Callable[[int], StateFunction]
    forces: StateFunction
    dissipation: Callable[[int], StateFunction] | None
    nudge: Nudge
    read: Callable[[int], Iterable[int]]
    touched: Callable[[int], Sequence[int]]


TRUSTED = 1e-12
"""A pivot below this fraction of its diagonal entry calls for row exchanges."""


class Singular(OutsideDomain):
    """The mass matrix has no inverse at the point asked for."""


def momenta(
    source: Sources, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, rows: Sequence[int] | None = None
) -> Numbers:
    """Return p = dL/dv, n numbers, or those of some rows."""
    rows = range(len(q)) if rows is None else rows
    return _gradient(lambda i, x: source.for_momenta(i)(q, x, t), v, rows, steps.v)


def forces(
    source: Sources, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps, rows: Sequence[int] | None = None
) -> Numbers:
    """Return f = dL/dq + Q - dD/dv, n numbers, or those of some rows."""
    rows = range(len(q)) if rows is None else rows
    total = _gradient(lambda i, x: source.for_forces(i)(x, v, t), q, rows, steps.q)
    applied = source.forces(q, v, t)
    total = [a + applied[i] for a, i in zip(total, rows, strict=True)]
    if source.dissipation is None:
        return total
    drag = source.dissipation
    slopes = _gradient(lambda i, x: drag(i)(q, x, t), v, rows, steps.v)
    return [a - b for a, b in zip(total, slopes, strict=True)]


def mass_matrix(source: Sources, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps) -> list[Numbers]:
    """Return M = d2L/dv2, n rows of n numbers."""
    n = len(q)
    rows: list[Numbers] = [[0] * n for _ in range(n)]
    for i in range(n):
        for j in sorted(k - n for k in source.read(i) if n <= k <= n + i):

            def at(x: Any, y: Any, i: int = i, j: int = j) -> Numbers:
                return [source.for_mass(i)(q, moved(moved(v, i, x), j, y), t)]

            rows[i][j] = rows[j][i] = central_mixed(at, steps.v[i], steps.v[j])[0]
    return rows


def momentum_rate(
    source: Sources,
    q: Numbers,
    v: Numbers,
    a: Numbers,
    t: Any,
    steps: DifferenceSteps,
    rows: Sequence[int] | None = None,
) -> Numbers:
    """Return dp/dt along the motion with velocities v and accelerations a, n numbers, or those of some rows."""
    n, here, direction = len(q), [*q, *v], [*v, *a]
    needed = range(2 * n) if rows is None else sorted({k for i in rows for k in source.read(i)})
    for k in needed:
        direction[k] *= source.nudge("velocity", k) if k < n else source.nudge("acceleration", k - n)
    t_along = source.nudge("time", 0)

    def momenta_at(s: Any) -> Numbers:
        y = list(here)
        for k in needed:
            y[k] = here[k] + s * direction[k]
        return momenta(source, y[:n], y[n:], t + s * t_along, steps, rows)

    return central(momenta_at, steps.motion)


def residual(
    source: Sources,
    q: Numbers,
    v: Numbers,
    a: Numbers,
    t: Any,
    steps: DifferenceSteps,
    rows: Sequence[int] | None = None,
) -> Numbers:
    """Return dp/dt - f, which vanishes when a is the acceleration, or some of its rows."""
    rate = momentum_rate(source, q, v, a, t, steps, rows)
    return [b - f for b, f in zip(rate, forces(source, q, v, t, steps, rows), strict=True)]


def energy(source: Sources, v: Numbers, p: Numbers, lagrangian: Any) -> Any:
    """Return v.p - L."""
    return sum((source.nudge("energy", i) * x * y for i, (x, y) in enumerate(zip(v, p, strict=True))), -lagrangian)


def residual_slopes(
    at: Callable[[Numbers, Numbers, int], Numbers],
    q: Numbers,
    v: Numbers,
    steps: DifferenceSteps,
    columns: Sequence[int],
) -> list[Numbers]:
    """Return the slopes of a residual, a function of q and v at fixed accelerations, by y_j for each j in `columns`.

    The residual takes j as well, and may leave out what does not depend on y_j.

    y = (q, v). Differencing M a = h says M da/dy_j = -d(dp/dt - f)/dy_j: the Jacobian of the accelerations without
    solving for them at every displaced state, at a fraction of the evaluations.
    """
    n = len(q)
    slopes = []
    for j in columns:

        def beside(x: Any, j: int = j) -> Numbers:
            return at(moved(q, j, x), v, j) if j < n else at(q, moved(v, j - n, x), j)

        slopes.append(central(beside, steps.q[j] if j < n else steps.v[j - n]))
    return slopes


def solve(matrix: Sequence[Numbers], right: Sequence[Numbers], threshold: Any) -> list[Numbers]:
    """Return the solutions of matrix x = r for each r in `right`, by elimination with partial pivoting.

    Raises Singular when a pivot is at most `threshold` times the largest entry of its row.
    """
    n = len(matrix)
    # Zeros are left out: of a net of masses most entries are.
    rows = [{j: x for j, x in enumerate((*row, *(r[i] for r in right))) if x} for i, row in enumerate(matrix)]
    sizes = [max(map(abs, row)) for row in matrix]
    for k in range(n):
        best = max((i for i in range(k, n) if k in rows[i]), key=lambda i: abs(rows[i][k]) / sizes[i], default=k)
        rows[k], rows[best], sizes[k], sizes[best] = rows[best], rows[k], sizes[best], sizes[k]
        if abs(rows[k].get(k, 0)) <= threshold * sizes[k]:
            raise Singular("the mass matrix is singular")
        pivot = rows[k][k]
        for i in range(k + 1, n):
            if k in rows[i]:
                factor, row = rows[i].pop(k) / pivot, rows[i]
                for j, y in rows[k].items():
                    if j > k:
                        row[j] = row.get(j, 0) - factor * y
    above = [[(j, y) for j, y in row.items() if i < j < n] for i, row in enumerate(rows)]
    solutions = []
    for column in range(n, n + len(right)):
        x: Numbers = [0] * n
        for i in reversed(range(n)):
            x[i] = (rows[i].get(column, 0) - sum(y * x[j] for j, y in above[i])) / rows[i][i]
        solutions.append(x)
    return solutions


def factorization_sizes(matrix: Sequence[Numbers], negative: int = 0) -> list[Numbers]:
    """Return the sizes of the numbers in a factorization of a symmetric matrix, n rows of n.

    For M = L D L^T with positive pivots, but for the last `negative` ones, that is |L| |D| |L^T|: solving with the
    factors in floating point is exact for a matrix within a few roundings of these numbers (N. J. Higham, Accuracy and
    Stability of Numerical Algorithms, 2nd edition, 2002, theorem 10.3). Other matrices need row exchanges; then the
    largest entries of the rows are used.
    """
    n = len(matrix)
    sizes = [[abs(x) for x in row] for row in matrix]
    rest = [list(row) for row in matrix]
    for k in range(n):
        pivot = rest[k][k]
        if (pivot if k < n - negative else -pivot) <= TRUSTED * sizes[k][k]:
            largest = [max(map(abs, row)) for row in matrix]
            return [
                [max(abs(x), (a * b) ** 0.5) for x, b in zip(row, largest, strict=True)]
                for row, a in zip(matrix, largest, strict=True)
            ]
        for i in range(k + 1, n):
            factor = rest[i][k] / pivot
            if not factor:
                continue
            for j in range(k + 1, i + 1):
                term = factor * rest[j][k]
                rest[i][j] -= term
                sizes[i][j] += abs(term)
                sizes[j][i] = sizes[i][j]
    return sizes


def along(x: Sequence[Any], direction: Sequence[Any], s: Any) -> Numbers:
    """Return x + s direction."""
    return [a + s * b for a, b in zip(x, direction, strict=True)]


def _gradient(function: Callable[[int, Numbers], Any], x: Numbers, rows: Sequence[int], steps: Numbers) -> Numbers:
    def along_axis(i: int) -> Callable[[Any], Numbers]:
        return lambda h: [function(i, moved(x, i, h))]

    return [central(along_axis(i), steps[i])[0] for i in rows]


def moved(x: Sequence[Any], i: int, distance: Any) -> Numbers:
    """Return x with one entry moved."""
    y = list(x)
    y[i] = y[i] + distance
    return y
