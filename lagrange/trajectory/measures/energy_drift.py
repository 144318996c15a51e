"""Drift of the energy along a run: its values, its scale, and its sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.errors import RunError
from lagrange.machine.model import Model
from lagrange.machine.parameters import Parameters
from lagrange.trajectory.trajectory import FloatArray, Trajectory

_NEAR_ZERO = 1e-3
"""Initial energy, relative to the exchanged kinetic energy, below which it is a small difference and not used as scale.
"""


@dataclass(frozen=True, repr=False)
class EnergyDrift:
    """The energy E along a run: `first` is E0 at the start, or at the first output if no start is known.

    `last` is E at the end, `absolute` is max |E - E0|, and `relative` is `absolute` / `scale`. The scale is |E0|; if E0
    is close to zero, the scale is the largest |v.p| / 2, for most systems the largest kinetic energy. `conserved` is
    True if the equations conserve the energy, and None if that is not known. The drift measures accuracy only if
    `conserved` is True. `against` describes the scale in words.
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
        """The drift divided by its scale, or the drift itself if nothing moves."""
        return self.absolute / self.scale if self.scale > 0 else self.absolute

    @property
    def unkept(self) -> str:
        """Remark for an energy that is not known to be conserved."""
        return "the system does not conserve it" if self.conserved is False else "not found to be conserved"

    def sentence(self) -> str:
        """Return a sentence with the drift, or with the first and last energy if conservation is not known."""
        if not self.conserved:
            return f"from {self.first:.6g} to {self.last:.6g} ({self.unkept})"
        return f"{self.relative:.1e} of {self.against}"


def since_start(run: Trajectory) -> tuple[FloatArray, FloatArray, bool]:
    """Return the times and states of the start and of the outputs, and True.

    If the state at the start is not stored and cannot be computed, return those of the outputs only, and False.
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

    `from_start` is True if the first state is the start of the run. `start` are the first parameters of the run. The
    energy that events add by setting parameters is subtracted. The energy `lost` (N,) at contacts is added.
    """
    parameters = run.parameters_at(t, start)
    with np.errstate(all="ignore"):  # The run reports states that are not finite.
        energy = np.asarray(model.energy(*model.layout.split(y), t, parameters)) - run.added_energy(t) + lost
        return _drift(model, energy, t, y, parameters, from_start=from_start)


def _drift(
    model: Model,
    energy: FloatArray,
    t: FloatArray,
    y: FloatArray,
    parameters: Parameters,
    *,
    from_start: bool,
) -> EnergyDrift:
    q, v = model.layout.split(y)
    momenta = np.asarray(model.momenta(q, v, t, parameters))
    exchanged = 0.5 * float(np.max(np.abs(np.sum(v * momenta, axis=0))))
    first, absolute = float(energy[0]), float(np.max(np.abs(energy - energy[0])))
    small = abs(first) < _NEAR_ZERO * exchanged
    scale, against = (
        (exchanged, "the largest |v.p|/2")
        if small
        else (
            abs(first),
            "the initial energy" if from_start else "the energy at the first output",
        )
    )
    return EnergyDrift(model.equations.structure.energy_kept, first, float(energy[-1]), absolute, scale, against)
