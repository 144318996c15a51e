"""Violations of constraints along a run."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lagrange.machine.model import Model
from lagrange.machine.parameters import Parameters
from lagrange.trajectory.constraints.residuals import residuals_of, units_of
from lagrange.trajectory.trajectory import FloatArray

CANCELS = 0.5
"""Value of a constraint, relative to the sizes of its terms, below which its terms cancel."""

DRIFT_SAMPLES = 9
"""Number of states along the run from which the largest entries are taken."""


@dataclass(frozen=True, repr=False)
class ConstraintDrift:
    """The violations (m, N) of constraints along a run, each relative to the largest size of the constraint's terms.

    If no terms cancel, as in y = 0, the scale is the gradient times the sizes of the entries of the state. `positions`
    are the violations of phi, and zero for constraints stated in velocities. `velocities` are the violations of
    dphi/dt, or of the constraint that is stated in velocities.
    """

    positions: FloatArray
    velocities: FloatArray
    holonomic: bool

    def __repr__(self) -> str:
        return f"<ConstraintDrift: {self.sentence()}>"

    @property
    def error(self) -> FloatArray:
        """The largest violation at each time, (N,)."""
        largest: FloatArray = np.max(np.concatenate([self.positions, self.velocities]), axis=0)
        return largest

    @property
    def card(self) -> dict[str, float | None]:
        """The largest violations of the run, by kind; None for a value that is not finite."""
        return {name: value if math.isfinite(value) else None for name, value in self._largest.items()}

    def sentence(self) -> str:
        """Return a sentence with the largest violations."""
        return (
            ", ".join(f"{value:.1e} in {name}" for name, value in self._largest.items()) + ", relative to their terms"
        )

    @property
    def _largest(self) -> dict[str, float]:
        parts = {"positions": self.positions} if self.holonomic else {}
        return {name: float(np.max(part)) for name, part in {**parts, "velocities": self.velocities}.items()}


def constraint_drift(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> ConstraintDrift | None:
    """Return the drift of states y (2n, N) at the times t (N,), or None without constraints or without states."""
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
    """Return the scales (2m,) of constraints without cancelling terms, such as y = 0, whose only term is y itself.

    A scale is the gradient of the constraint times the sizes of the entries, the largest over sample states.
    """
    residuals, mass = residuals_of(model), model.interpreted("mass_matrix")
    m = len(model.equations.stated)
    largest = np.zeros(2 * m)
    places, velocities = np.flatnonzero(residuals.holonomic[:m]), np.arange(m, 2 * m)
    for i in dict.fromkeys(np.linspace(0, len(t) - 1, DRIFT_SAMPLES).astype(int).tolist()):
        point = (
            float(t[i]),
            np.ascontiguousarray(y[:, i]),
            parameters[:, i].copy() if parameters.ndim == 2 else parameters,
        )
        if not np.isfinite(point[1]).all():
            continue
        units = units_of(mass(*point))
        for rows, of in ((places, residuals.of_positions), (velocities, residuals.of_velocities)):
            sizes = of(*point, units).sizes[: len(rows)]
            largest[rows] = np.maximum(largest[rows], np.where(np.isfinite(sizes), sizes, 0.0))
    return largest
