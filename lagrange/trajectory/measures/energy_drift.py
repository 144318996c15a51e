"""Drift of the energy, and violations of constraints, along a run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.errors import RunError
from lagrange.machine.model import Model
from lagrange.machine.parameters import Parameters
from lagrange.trajectory.constraints.residuals import residuals_of, units_of
from lagrange.trajectory.trajectory import FloatArray, Trajectory

_NEAR_ZERO = 1e-3
"""Initial energy, relative to the exchanged kinetic energy, below which it is a small difference and not used as scale.
"""


@dataclass(frozen=True, repr=False)
class EnergyDrift:
    """The energy E along a run: `first` is E0 at the start, or at the first output if no start is known.

    `last` is E at the end, `absolute` is max |E - E0|, and `relative` is `absolute` / `scale`. The scale is |E0|. If
    E0 is close to zero, the scale is the largest |v.p| / 2, for most systems the largest kinetic energy. `against`
    names the scale in words. `conserved` is True if the equations conserve the energy, and None if that is not known.
    The drift measures accuracy only if `conserved` is True.
    """

    conserved: bool | None
    first: float
    last: float
    absolute: float
    scale: float
    against: str

    def __repr__(self) -> str:
        return f"<EnergyDrift: {self.sentence()}>"

    @property
    def relative(self) -> float:
        """The largest change of the energy divided by its scale, or the change itself if the scale is zero."""
        return self.absolute / self.scale if self.scale > 0 else self.absolute

    @property
    def unkept(self) -> str:
        """Remark in words that the system does not conserve the energy, or is not known to conserve it."""
        return "the system does not conserve it" if self.conserved is False else "not found to be conserved"

    def sentence(self) -> str:
        """Return a sentence with the relative drift of the energy.

        For an energy that is not known to be conserved it has the first and the last energy instead.
        """
        if not self.conserved:
            return f"from {self.first:.6g} to {self.last:.6g} ({self.unkept})"
        return f"{self.relative:.1e} of {self.against}"


def since_start(run: Trajectory) -> tuple[FloatArray, FloatArray, bool]:
    """Return the times (N,) and states (2n, N) of the run's outputs, and True if they begin with the start.

    The start is put before the outputs if they do not contain it. If its state is not stored and cannot be computed,
    the outputs alone and False are returned.
    """
    first, t, y = run.span[0], run.t, run.y
    if not len(t) or t[0] == first:
        return t, y, True
    try:
        start = run.dense(np.array([first]))
    except RunError:
        return t, y, False
    return np.append(first, t), np.column_stack([start, y]), True


def energy_drift(
    model: Model,
    t: FloatArray,
    y: FloatArray,
    from_start: bool,
    start: Mapping[Any, float],
    run: Trajectory,
    lost: FloatArray,
) -> EnergyDrift:
    """Return the drift of the energy of states y (2n, N) at times t (N,).

    `from_start` is True if the first state is the start of the `run`. `start` has the parameters at the start. Energy
    that events add by setting parameters is subtracted. The energy `lost` (N,) up to each time at contacts is added.
    """
    parameters, (q, v) = run.parameters_at(t, start), model.layout.split(y)
    with np.errstate(all="ignore"):  # The run reports states that are not finite.
        energy = np.asarray(model.energy(q, v, t, parameters)) - run.added_energy(t) + lost
        momenta = np.asarray(model.momenta(q, v, t, parameters))
        exchanged = 0.5 * float(np.max(np.abs(np.sum(v * momenta, axis=0))))
        first, absolute = float(energy[0]), float(np.max(np.abs(energy - energy[0])))
    scale, against = abs(first), "the initial energy" if from_start else "the energy at the first output"
    if abs(first) < _NEAR_ZERO * exchanged:
        scale, against = exchanged, "the largest |v.p|/2"
    kept = False if model.statement.surfaces_move else model.equations.structure.energy_kept
    return EnergyDrift(kept, first, float(energy[-1]), absolute, scale, against)


CANCELS = 0.5
"""Value of a constraint, relative to the sizes of its terms, below which its terms cancel."""

DRIFT_SAMPLES = 9
"""Number of states along the run from which the largest entries are taken."""


@dataclass(frozen=True, repr=False)
class ConstraintDrift:
    """The violations (m, N) of the constraints along a run, each relative to the scale of its constraint.

    The scale is the largest size of the constraint's terms along the run. If no terms cancel, as in y = 0, it is the
    gradient times the sizes of the entries of the state. `positions` are the violations of phi, and zero for
    constraints stated in velocities. `velocities` are the violations of dphi/dt, or of the constraint that is stated
    in velocities.
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
        """The largest violations of the run in "positions" and "velocities"; None if one is not finite."""
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

    Return None without constraints or without states.
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

    First come the scales of the m constraints phi on positions, then those of their rates dphi/dt. A scale is the
    gradient times the sizes of the state's entries, the largest over some sample states. `t` (N,) and `y` (2n, N) are
    those of the run.
    """
    residuals, mass = residuals_of(model), model.interpreted("mass_matrix")
    m = len(model.equations.stated)
    largest = np.zeros(2 * m)
    positions, velocities = np.flatnonzero(residuals.holonomic[:m]), np.arange(m, 2 * m)
    for i in dict.fromkeys(np.linspace(0, len(t) - 1, DRIFT_SAMPLES).astype(int).tolist()):
        point = (
            float(t[i]),
            np.ascontiguousarray(y[:, i]),
            parameters[:, i].copy() if parameters.ndim == 2 else parameters,
        )
        if not np.isfinite(point[1]).all():
            continue
        units = units_of(mass(*point))
        for part, rows in enumerate((positions, velocities)):
            sizes = residuals.of_part(part, *point, units).sizes[: len(rows)]
            largest[rows] = np.maximum(largest[rows], np.where(np.isfinite(sizes), sizes, 0.0))
    return largest
