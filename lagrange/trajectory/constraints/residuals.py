"""Evaluate the residuals of a model's constraints at a state, each relative to the terms that cancel in it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import compress
from weakref import WeakKeyDictionary

import numpy as np

from lagrange.graph.differentiate import gradient
from lagrange.graph.evaluate import term_sizes
from lagrange.graph.node import Binding, Node
from lagrange.machine.backend import FloatArray, Kernel, one_state
from lagrange.machine.kernel.python_kernel import PythonKernel
from lagrange.machine.model import Model
from lagrange.program.switching import switch
from lagrange.statement.statement import Constraint

ON_SURFACE = 2.0**-40
"""Largest residual of a constraint that counts as zero, as a fraction of its size. States in double precision are
rarely closer to the set where the constraint holds."""

CORNER_DISTANCE = 1e-7
"""Distance before and after a possible corner of a constraint at which its gradients are compared, as a fraction of the
largest coordinate. At a corner the gradient jumps, as that of y - abs(x) at x = 0."""

CORNER = 1e-4
"""Change of a constraint's gradient, relative to its size, above which the constraint has a corner. The gradients at
`CORNER_DISTANCE` before and after the possible corner are compared. A smooth gradient changes by 1e-7 of its size."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of m constraints at a point (k,): `values` (m,), which are zero on the surface where they hold.

    `gradient` (m, k) has the derivatives of the values. `terms` (m,) are the sums of magnitudes of the terms that
    cancel in each value. `sizes` (m,) are the scales to which rounding of the values is relative. A scale is `terms`,
    or the gradient times the largest entry of the point if that is larger.
    """

    values: FloatArray
    gradient: FloatArray
    terms: FloatArray
    sizes: FloatArray

    @property
    def largest(self) -> float:
        """The largest residual relative to its size, or infinity if a residual is not finite."""
        with np.errstate(all="ignore"):
            shares = np.abs(self.values) / np.where(self.sizes > 0, self.sizes, 1.0)
        return float(shares.max(initial=0.0)) if np.isfinite(shares).all() else np.inf


class ConstraintResiduals:
    """The constraints of one model as functions of the state: phi on positions (p,), and psi on velocities (m,).

    psi has the time derivatives of phi, and the constraints that are stated in velocities. G = dpsi/dv (m, n) is the
    gradient by the velocities. The size of a constraint is the sum of the magnitudes of its terms.
    """

    def __init__(self, model: Model) -> None:
        equations = model.equations
        count = len(equations.first_order)
        constraints = equations.stated.joined(equations.constraints.last(count))
        relations = zip(constraints.names[-count:], constraints.velocities[-count:], strict=True) if count else ()
        self.stated = (
            *model.statement.constraints,
            *(Constraint(name, equations.express(relation), holonomic=False) for name, relation in relations),
        )
        self.names = constraints.names
        self.holonomic = np.array([phi is not None for phi in constraints.positions])
        positions = [phi for phi in constraints.positions if phi is not None]
        self.places = len(positions)
        moving = [any(entry.binding >= Binding.VELOCITY for entry in row) for row in equations.constraints.gradient]
        self.turning = np.flatnonzero(moving)
        """Indices of the constraints whose row of the gradient G depends on velocities, and may therefore vanish."""
        self.settled = count if equations.rates_are_solved else 0
        """Number of constraints, the last ones, that only define velocities of coordinates without inertia.

        Such a velocity may jump: the motion does not use the velocity in the state."""
        stated = (*positions, *constraints.velocities)
        entries = [entry for row in constraints.gradient for entry in row]
        # Nearly all entries of a long chain are zero, and are not evaluated. If all are zero, one entry is kept.
        self._entries = len(entries)
        self._present = [k for k, entry in enumerate(entries) if entry is not entry.graph.zero] or [0]
        self._gradient = _kernel(model, tuple(entries[k] for k in self._present))
        self._residuals = _kernel(model, (*stated, *term_sizes(stated)))
        self.mass_matrix = model.interpreted("mass_matrix")
        """Function that returns the mass matrix, by which distances of states are measured.

        It is interpreted, since it is also evaluated at states off the constraints."""
        self._layout = model.layout
        graph, q = model.equations.graph, model.equations.q
        # Only the branch of a piecewise that is taken counts. Its conditions are switching surfaces, too.
        self.switched = switch(graph, stated)
        surfaces = self.switched.stated
        slopes = tuple(slope for surface in surfaces for slope in gradient(surface, q))
        self._corners = _kernel(model, (*surfaces, *term_sizes(surfaces), *slopes)) if surfaces else None
        self._surfaces = _kernel(model, surfaces) if surfaces else None

    def are_zero(self, t: float, y: FloatArray, parameters: FloatArray) -> bool:
        """Return True if the constraints at a state are zero up to rounding, and the state is not at a corner of one.

        The tolerance is relative to the terms of each constraint.
        """
        if self._corners is not None and self.at_corner(t, y, parameters) is not None:
            return False
        results = one_state(self._residuals, parameters)(t, y)
        half = len(results) // 2
        return bool((np.abs(results[:half]) <= ON_SURFACE * results[half:]).all())

    def worst(self, t: float, y: FloatArray, parameters: FloatArray) -> tuple[str, float]:
        """Return the name of the constraint that the state y (2n,) violates most, and the violation.

        Violations are relative to the sum of the magnitudes of the constraint's terms.
        """
        values, terms = self.of_many(t, y, parameters)
        shares = np.abs(values) / np.where(terms > 0, terms, 1.0)
        row = int(np.argmax(np.where(np.isfinite(shares), shares, np.inf)))
        return self.labels[row], float(shares[row])

    @property
    def labels(self) -> list[str]:
        """The names of the p constraints phi on positions, followed by those of all m constraints psi on velocities."""
        return [*compress(self.names, self.holonomic), *self.names]

    def gradients(self, t: FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the gradients G (m, n, k) of the constraints by the velocities, at times (k,) and states (2n, k)."""
        rows = np.zeros((self._entries, len(t)))
        rows[self._present] = self._gradient(t, y, parameters)
        return rows.reshape(len(self.names), -1, len(t))

    def surfaces(self, t: FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the values (s, k) of the constraints' s switching functions at times (k,) and states (2n, k).

        They are the arguments of `abs`, `sign` and conditions in the constraints.
        """
        return np.empty((0, len(t))) if self._surfaces is None else self._surfaces(t, y, parameters)

    def of_part(self, part: int, t: float, y: FloatArray, parameters: FloatArray, units: FloatArray) -> Residuals:
        """Return the residuals of the constraints phi on positions (part 0), or of all constraints psi (part 1).

        Their gradients are by the coordinates (part 0), or by the velocities (part 1). `units` (n,) are the scales of
        displacements, the square roots of inertia.
        """
        values, terms = self.of_many(t, y, parameters)
        gradient, layout = self.gradient(t, y, parameters), self._layout
        rows, entries = (gradient, y[layout.v]) if part else (gradient[self.holonomic], y[layout.q])
        chosen = slice(self.places, None) if part else slice(0, self.places)
        # Each entry counts as equally large once it is multiplied by its scale.
        largest = np.abs(units * entries).max(initial=0.0)
        # A gradient that is not finite is refused later, in a message with the constraint's name.
        with np.errstate(all="ignore"):
            sizes = np.maximum(terms[chosen], np.abs(rows) @ (largest / units))
        return Residuals(values[chosen], rows, terms[chosen], sizes)

    def gradient(self, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the gradient G (m, n) of the constraints by the velocities, at a state (2n,)."""
        rows = np.zeros(self._entries)
        with np.errstate(all="ignore"):
            rows[self._present] = self._gradient(t, y, parameters)
        return rows.reshape(len(self.names), -1)

    def at_corner(self, t: float, y: FloatArray, parameters: FloatArray) -> int | None:
        """Return the index of the first constraint with a corner at a state, as y = abs(x) has at x = 0, or None."""
        if self._corners is None:
            return None
        corners, n = self._corners(t, y, parameters), len(y[self._layout.q])
        count = len(corners) // (n + 2)
        values, sizes, slopes = corners[:count], corners[count : 2 * count], corners[2 * count :].reshape(count, n)
        for row in np.flatnonzero(np.abs(values) <= ON_SURFACE * np.maximum(sizes, np.abs(slopes) @ np.abs(y[:n]))):
            across = slopes[row] / (np.abs(slopes[row]).max() or 1.0) * CORNER_DISTANCE * (np.abs(y[:n]).max() or 1.0)
            moved = np.append(across, np.zeros(len(y) - n))
            after, before = (self.gradient(t, y + sign * moved, parameters) for sign in (1, -1))
            jumps = np.abs(after - before).max(axis=1) > CORNER * (np.abs(after) + np.abs(before)).max(axis=1)
            if jumps.any():
                return int(np.argmax(jumps))
        return None

    def of_many(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values of the constraints, phi before psi, and the sums of magnitudes of their terms.

        Both results are (p + m, k) for k times `t` and states `y` (2n, k), or (p + m,) for one time and state (2n,).
        """
        with np.errstate(all="ignore"):
            results = self._residuals(t, y, parameters)
        half = len(results) // 2
        return results[:half], results[half:]


def units_of(metric: FloatArray) -> FloatArray:
    """Return scales (n,) of the coordinates: the square root of each one's inertia, or 1 for one without inertia.

    The inertias are on the diagonal of the mass matrix `metric` (n, n).
    """
    sizes = np.abs(np.diag(metric))
    return np.sqrt(np.where((sizes > 0) & np.isfinite(sizes), sizes, 1.0))


def _kernel(model: Model, nodes: tuple[Node, ...]) -> Kernel:
    return PythonKernel(model.function("constraints", nodes).program)


_KNOWN: WeakKeyDictionary[Model, ConstraintResiduals] = WeakKeyDictionary()


def residuals_of(model: Model) -> ConstraintResiduals:
    """Return the object that evaluates a model's constraints. It is made at the first call for this model."""
    residuals = _KNOWN.get(model)
    if residuals is None:
        residuals = _KNOWN[model] = ConstraintResiduals(model)
    return residuals
