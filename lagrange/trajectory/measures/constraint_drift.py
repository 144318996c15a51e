"""How far a run is from its constraints."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lagrange.machine.model import Model
from lagrange.machine.parameters import Parameters
from lagrange.trajectory.constraints.residuals import residuals_of, units_of
from lagrange.trajectory.trajectory import FloatArray

CANCELS = 0.5
"""Terms of a constraint cancel where its value is below this part of their sizes."""

SAMPLES = 9
"""States along the run at which the largest entry is looked for."""


@dataclass(frozen=True, repr=False)
class ConstraintDrift:
    """The violations (m, N) of constraints along a run, each relative to the largest size of its own terms there.

    Where nothing cancels in a constraint, as in y = 0, its scale is what its gradient makes of the largest entry.

    `positions` are those of phi, zero for constraints that are stated in velocities, and `velocities` those of dphi/dt,
    or of the constraint as stated in velocities.
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
        """The largest violations of the run; None where one is not finite."""
        return {name: value if math.isfinite(value) else None for name, value in self._largest.items()}

    def sentence(self) -> str:
        """Return the largest violations in words."""
        return (
            ", ".join(f"{value:.1e} in {name}" for name, value in self._largest.items()) + ", relative to their terms"
        )

    @property
    def _largest(self) -> dict[str, float]:
        parts = {"positions": self.positions} if self.holonomic else {}
        return {name: float(np.max(part)) for name, part in {**parts, "velocities": self.velocities}.items()}


def constraint_drift(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> ConstraintDrift | None:
    """Return the drift of states y (2n, N) at the times t (N,), or None without constraints or without states."""
    values, held = model.parameter_array(parameters), model.equations.stated
    if not len(held) or not len(t):
        return None
    with np.errstate(all="ignore"):  # a run that left the finite numbers says so itself
        size = np.abs(model.called(model.kernel("constraints"), t, y, values))
        terms = model.called(model.kernel("constraint_sizes"), t, y, values)
        alone = (size >= CANCELS * terms).all(axis=1)
        entries = _sizes_of_entries(model, t, y, values) if alone.any() else 0.0
        scale = np.maximum(terms.max(axis=1), np.where(alone, entries, 0.0))[:, None]
        relative = np.divide(size, scale, out=size.copy(), where=scale != 0)
    m = len(held)
    return ConstraintDrift(relative[:m], relative[m:], any(phi is not None for phi in held.positions))


def _sizes_of_entries(model: Model, t: FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return what the gradients of the constraints make of the sizes of the entries, (2m,), the largest of some states.

    It is the scale where nothing cancels: of y = 0 the only term is y itself.
    """
    residuals, mass = residuals_of(model), model.interpreted("mass_matrix")
    m = len(model.equations.stated)
    found = np.zeros(2 * m)
    places, velocities = np.flatnonzero(residuals.holonomic[:m]), np.arange(m, 2 * m)
    for i in dict.fromkeys(np.linspace(0, len(t) - 1, SAMPLES).astype(int).tolist()):
        given = (
            float(t[i]),
            np.ascontiguousarray(y[:, i]),
            parameters[:, i].copy() if parameters.ndim == 2 else parameters,
        )
        if not np.isfinite(given[1]).all():
            continue
        units = units_of(mass(*given))
        for rows, of in ((places, residuals.of_positions), (velocities, residuals.of_velocities)):
            sizes = of(*given, units).sizes[: len(rows)]
            found[rows] = np.maximum(found[rows], np.where(np.isfinite(sizes), sizes, 0.0))
    return found
