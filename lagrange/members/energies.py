"""Energies of members at the start and at the end of their runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.model import Model
from lagrange.members.chunk import Starts
from lagrange.trajectory.conservation import NOTABLE_CHANGE, SMALL_CHANGE
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class Energies:
    """States (m, 2n) before and after, and what was observed of them: the energy, and the momenta behind it."""

    before: FloatArray
    after: FloatArray
    first: FloatArray
    last: FloatArray

    def kinetic(self, y: FloatArray, observed: FloatArray) -> FloatArray:
        """Return |v.p| / 2."""
        with np.errstate(all="ignore"):
            return np.asarray(np.abs(np.sum(y[:, y.shape[1] // 2 :] * observed[:, 1:], axis=1)) / 2)

    @property
    def drift(self) -> FloatArray:
        """How far the energies moved; see `relative_drift`."""
        kinetic = self.kinetic(self.before, self.first), self.kinetic(self.after, self.last)
        return relative_drift(self.first[:, 0], self.last[:, 0], *kinetic)

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Which members changed their energy so much that a run alone has to say whether it follows the motion.

        These are the first tests of `lagrange.trajectory.conservation`.
        """
        with np.errstate(all="ignore"):
            change = np.abs(self.last[:, 0] - self.first[:, 0])
            kinetic = np.maximum(self.kinetic(self.before, self.first), self.kinetic(self.after, self.last))
            small = change <= NOTABLE_CHANGE * np.abs(self.first[:, 0])
            return np.asarray(~(small | (change <= SMALL_CHANGE * kinetic)))


def relative_drift(first: FloatArray, last: FloatArray, kinetic: FloatArray, after: FloatArray) -> FloatArray:
    """Return by how much energies (m,) went from their first values, relative to the largest of these and the others.

    `kinetic` (m,) are the kinetic energies at the start, `after` (m,) those at the end.
    """
    scale = np.maximum(np.maximum(np.abs(first), kinetic), after)
    with np.errstate(all="ignore"):
        found = np.where(scale > 0, (last - first) / scale, last - first)
    # The sign of a NaN depends on its place in the array.
    return np.asarray(np.where(np.isnan(found), np.nan, found))


def energies_of(
    model: Model,
    starts: Starts,
    after: FloatArray,
    span: tuple[float, float],
    last_parameters: FloatArray | None = None,
) -> Energies:
    """Return the energies of members that went from their starts to states (m, 2n).

    `last_parameters` (m, k) are those at the end, where events set some.
    """
    first = _observed(model, starts.states, span[0], starts.parameters)
    last = _observed(model, after, span[1], starts.parameters if last_parameters is None else last_parameters)
    return Energies(starts.states, after, first, last)


def _observed(model: Model, y: FloatArray, t: float, parameters: FloatArray) -> FloatArray:
    """Return the energy and the momenta of states (m, 2n) at a time, (m, 1 + n)."""
    if len(parameters) > 1:
        return np.concatenate([_observed(model, y[i : i + 1], t, parameters[i : i + 1]) for i in range(len(y))])
    q, v = model.layout.split(y.T)
    times = np.full(len(y), t)
    return np.vstack([model.energy(q, v, times, parameters[0]), model.momenta(q, v, times, parameters[0])]).T
