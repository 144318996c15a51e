"""Constraints along a run: violations; multipliers; forces, as generalized forces and as vectors on named points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, listing
from lagrange.graph.differentiate import tangents
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import Parameters, some_of
from lagrange.statement.expression import ByName, one_of
from lagrange.statement.statement import corners
from lagrange.trajectory.constraints.residuals import residuals_of, units_of
from lagrange.trajectory.trajectory import FloatArray

MOST_RELATED_POINTS = 3
"""Largest number of named points among which the points of one constraint are searched together. A distance relates two
points, an angle three."""

POINT_SAMPLES = 9
"""Number of equally spaced states of a run that decide on which points a constraint acts."""

ROW_RESIDUAL = 1e-9
"""Largest relative residual that counts as zero in the test whether forces on points give a constraint's row of G.

Relative singular values up to this number also count as zero. The number is far above the rounding of doubles, and far
below the residual of a row that no such forces give.
"""


@dataclass(frozen=True, eq=False)
class ConstraintForces:
    """Multipliers and forces of constraints at the states y (2n, N) at times t (N,)."""

    model: Model
    t: FloatArray
    y: FloatArray
    parameters: Parameters

    @property
    def names(self) -> list[str]:
        """The names of the constraints."""
        return [constraint.name for constraint in self.model.statement.constraints]

    @cached_property
    def multipliers(self) -> ByName[FloatArray]:
        """The multipliers (N,) by name of the constraint; empty if the system has no constraints.

        They are NaN at states that do not determine the multipliers.
        """
        if not self.names:
            return ByName("constraint")
        rows = self._from(0, len(self.t))
        return ByName("constraint", zip(self.names, rows, strict=True))

    def _from(self, begin: int, end: int) -> FloatArray:
        """Return the multipliers (m, k) of all constraints at the states from index `begin` to before `end`.

        They are NaN at states that do not determine them, such as the last state of a run that ended at a singular
        configuration. Such states are found by bisection.
        """
        try:
            which = slice(begin, end)
            q, v = self.model.layout.split(self.y[:, which])
            return self.model.multipliers(q, v, self.t[which], some_of(self.parameters, which))
        except RunError:
            middle = (begin + end) // 2
            if end - begin == 1:
                return np.full((len(self.names), 1), np.nan)
            return np.concatenate([self._from(begin, middle), self._from(middle, end)], axis=1)

    def generalized(self, name: str) -> FloatArray:
        """Return the generalized force of one constraint along the run, (n, N): its row of G times its multiplier."""
        return self._gradient(name) * self.multipliers[name]

    def on_point(self, name: str, point: str) -> FloatArray:
        """Return the force of one constraint on a named point along the run, (2, N) or (3, N).

        It is the force that `Solution.constraint_force` returns. `name` is the name of the constraint, and `point` the
        name of the point.
        """
        rows = self._gradient(name)
        points = self._points
        if not points:
            raise StatementError(
                f"{self.model.statement.name} has no named points: state positions={{'bob': (x, y)}}, or take the "
                "generalized forces, constraint_force(name)."
            )
        one_of(point, points, "{given} is not a named point of this system; they are {known}.")
        chosen = self._acted_on(name, rows)
        if point not in chosen:
            return np.zeros((len(points[point]), len(self.t)))
        slopes = np.concatenate([self._slopes[label] for label in chosen])
        begin = sum(len(points[label]) for label in chosen[: chosen.index(point)])
        forces = np.empty((len(slopes), len(self.t)))
        for k in range(len(self.t)):
            forces[:, k] = np.linalg.lstsq(slopes[:, :, k].T, rows[:, k], rcond=None)[0]
        return forces[begin : begin + len(points[point])] * self.multipliers[name]

    def _gradient(self, name: str) -> FloatArray:
        """Return the gradient of one constraint, its row of G, at all states: (n, N)."""
        if not self.names:
            raise StatementError(f"{self.model.statement.name} has no constraints, and so no constraint forces.")
        one_of(name, self.names, "{given} is not a constraint of this system; they are {known}.")
        q, v = self.model.layout.split(self.y)
        rows = np.asarray(self.model.evaluate("constraint_gradient", q, v, self.t, self.parameters))
        gradient: FloatArray = rows[self.names.index(name)]
        return gradient

    @cached_property
    def _points(self) -> dict[str, tuple[Any, ...]]:
        """The positions of the named points on which forces act, as expressions: all except corners of shapes."""
        statement = self.model.statement
        hidden = corners(statement.links)
        return {name: point for name, point in statement.positions.items() if name not in hidden}

    @cached_property
    def _slopes(self) -> dict[str, FloatArray]:
        """The derivatives dr/dq of the position r of each named point by name, (2, n, N) or (3, n, N)."""
        equations = self.model.equations
        slopes: dict[str, FloatArray] = {}
        for label, point in self._points.items():
            nodes = [equations.translate(entry) for entry in point]
            columns = [tangents(nodes, {symbol: equations.graph.one}) for symbol in equations.q]
            kernel = self.model.function("slopes", tuple(column(node) for node in nodes for column in columns))
            values = self.model.called(kernel, self.t, self.y, self.parameters)
            slopes[label] = values.reshape(len(nodes), len(columns), len(self.t))
        return slopes

    def _acted_on(self, name: str, rows: FloatArray) -> tuple[str, ...]:
        """Return the names of the points on which the constraint `name` acts.

        `rows` (n, N) is the constraint's row of the gradient G at N states. The constraint must be a function phi of
        the positions r of these points alone. The force on each point is then lambda dphi/dr. The smallest such set of
        points is taken. Raises StatementError if there is no such set, or if there are several of the same size.
        """
        samples = np.unique(np.linspace(0, len(self.t) - 1, POINT_SAMPLES).astype(int)) if len(self.t) else np.arange(0)
        moving = [label for label, slopes in self._slopes.items() if np.abs(slopes[:, :, samples]).max(initial=0.0) > 0]
        for count in range(1, MOST_RELATED_POINTS + 1):
            candidates = [
                chosen
                for chosen in combinations(moving, count)
                if all(
                    _has_one_solution(np.concatenate([self._slopes[label][:, :, k] for label in chosen]), rows[:, k])
                    for k in samples.tolist()
                )
            ]
            if len(candidates) == 1:
                return candidates[0]
            if candidates:
                sets = [" with ".join(chosen) for chosen in candidates]
                raise StatementError(
                    f"the force of {name} on points is not determined: each of {listing(sets)} could carry it alone. "
                    "Name fewer points, or take the generalized forces, constraint_force(name)."
                )
        raise StatementError(
            f"the force of {name} on points is not determined: the constraint does not relate the named points alone "
            f"({listing(self._slopes)}). Name the points that it acts on, each free to move in every direction if "
            "there were no constraints, or take the generalized forces, constraint_force(name)."
        )


def _has_one_solution(slopes: FloatArray, row: FloatArray) -> bool:
    """Return True if row = slopes^T F has exactly one solution F (k,), the forces on some points per unit multiplier.

    `slopes` (k, n) are the derivatives of the k entries of the points' positions by the coordinates. `row` (n,) is the
    constraint's row of the gradient G. Both are values at one state.
    """
    if len(slopes) > slopes.shape[1] or not (np.isfinite(slopes).all() and np.isfinite(row).all()):
        return False
    force, _, rank, _ = np.linalg.lstsq(slopes.T, row, rcond=ROW_RESIDUAL)
    left = np.abs(slopes.T @ force - row).max()
    return int(rank) == len(slopes) and bool(left <= ROW_RESIDUAL * np.abs(row).max())


CANCELS = 0.5
"""Largest value of a constraint, as a fraction of the sum of magnitudes of its terms, at which its terms cancel. In a
constraint such as y = 0 they do not."""

DRIFT_SAMPLES = 9
"""Number of states along the run at which the scale of a constraint without cancelling terms, such as y = 0, is
computed. Its violations are relative to the largest of these scales."""


@dataclass(frozen=True, repr=False)
class ConstraintDrift:
    """The violations (m, N) of the constraints along a run, each relative to the scale of its constraint.

    The scale is the largest size of the constraint's terms along the run. If no terms cancel, as in y = 0, it is the
    gradient times the largest entry of the state. `positions` are the violations of constraints phi that are stated in
    coordinates, and zero for others. `velocities` are the violations of dphi/dt, or of constraints that are stated in
    velocities. `holonomic` is True if at least one constraint is stated in coordinates.
    """

    positions: FloatArray
    velocities: FloatArray
    holonomic: bool

    def __repr__(self) -> str:
        return f"<ConstraintDrift: {self.sentence()}>"

    @property
    def error(self) -> FloatArray:
        """The largest relative violation of any constraint at each time, (N,)."""
        largest: FloatArray = np.max(np.concatenate([self.positions, self.velocities]), axis=0)
        return largest

    @property
    def card(self) -> dict[str, float | None]:
        """The largest relative violations in the run, with the keys "positions" and "velocities", for its status card.

        A value that is not finite is None. Without constraints on coordinates there is no key "positions".
        """
        return {name: value if math.isfinite(value) else None for name, value in self._largest.items()}

    def sentence(self) -> str:
        """Return a sentence with the largest violations of the constraints in the run."""
        return (
            ", ".join(f"{value:.1e} in {name}" for name, value in self._largest.items()) + ", relative to their terms"
        )

    @property
    def _largest(self) -> dict[str, float]:
        parts = {"positions": self.positions} if self.holonomic else {}
        return {name: float(np.max(part)) for name, part in {**parts, "velocities": self.velocities}.items()}


def constraint_drift(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> ConstraintDrift | None:
    """Return the violations of the constraints in states y (2n, N) at times t (N,).

    The result is None without constraints or without states.
    """
    values, constraints = model.parameter_array(parameters), model.equations.stated
    if not len(constraints) or not len(t):
        return None
    with np.errstate(all="ignore"):  # The run reports states that are not finite.
        size = np.abs(model.called(model.kernel("constraints"), t, y, values))
        terms = model.called(model.kernel("constraint_sizes"), t, y, values)
        alone = (size >= CANCELS * terms).all(axis=1)
        entries = _sizes_of_entries(model, t, y, values) if alone.any() else 0.0
        scale = np.maximum(terms.max(axis=1), np.where(alone, entries, 0.0))[:, None]
        relative = np.divide(size, scale, out=size.copy(), where=scale != 0)
    m = len(constraints)
    return ConstraintDrift(relative[:m], relative[m:], any(phi is not None for phi in constraints.positions))


def _sizes_of_entries(model: Model, t: FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return the scales (2m,) for violations of constraints whose terms do not cancel, such as y = 0.

    First come the scales of the m constraints in positions, zero for constraints stated in velocities, then those in
    velocities. A scale is the gradient times the largest entry of the state, at the sample state where this is largest.
    `t` (N,) and `y` (2n, N) are the times and states of the run.
    """
    residuals, mass = residuals_of(model), model.interpreted("mass_matrix")
    m = len(model.equations.stated)
    largest = np.zeros(2 * m)
    positions, velocities = np.flatnonzero(residuals.holonomic[:m]), np.arange(m, 2 * m)
    for i in dict.fromkeys(np.linspace(0, len(t) - 1, DRIFT_SAMPLES).astype(int).tolist()):
        values = parameters[:, i].copy() if parameters.ndim == 2 else parameters
        point = float(t[i]), np.ascontiguousarray(y[:, i]), values
        if not np.isfinite(point[1]).all():
            continue
        units = units_of(mass(*point))
        for part, rows in enumerate((positions, velocities)):
            sizes = residuals.of_part(part, *point, units).sizes[: len(rows)]
            largest[rows] = np.maximum(largest[rows], np.where(np.isfinite(sizes), sizes, 0.0))
    return largest
