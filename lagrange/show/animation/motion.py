"""Motion for an animation: positions, coordinates and energies at the frames and between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lagrange.errors import LagrangeError, StatementError
from lagrange.show.animation.timing import Timing
from lagrange.show.between import states_for_pictures
from lagrange.trajectory.measures.points import points_at
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

MOST_SAMPLES = 12_000
"""Most times at which a motion is evaluated, unless there are more frames: 12,000 take some 50 ms."""

MOST_DETAIL = 16
"""Most samples for each frame: a path turns by a few degrees between two of them."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A run at S = (K - 1) detail + 1 times: those of K frames, and detail - 1 between two of them.

    `states` are (2n, S), the named `points` (2, S) or (3, S), and the `energies` by name (S,): kinetic and potential
    energy if both were stated, and the conserved energy. Points and energies may be empty.
    """

    t: FloatArray
    states: FloatArray
    points: Mapping[str, FloatArray]
    energies: Mapping[str, FloatArray]
    detail: int
    scale: float = 0.0
    """Size of the terms of the energies: changes below its rounding noise are level."""

    @property
    def frames(self) -> slice:
        """Slice that selects the frames from the samples."""
        return slice(None, None, self.detail)


def motion_of(solution: Solution, timing: Timing) -> Motion:
    """Return the motion at the frames of a run and between them, from its dense output.

    Raises StatementError where a named point has no position, and for a run from a file with too few states.
    """
    frames = timing.t
    detail = 1
    while len(frames) > 1 and detail < MOST_DETAIL and 2 * detail * len(frames) <= MOST_SAMPLES:
        detail *= 2
    places = np.arange((len(frames) - 1) * detail + 1) / detail
    t = np.interp(places, np.arange(len(frames)), frames)
    t[::detail] = frames
    states = states_for_pictures(solution, t)
    points = points_at(solution.model, t, states, solution.parameters_at(t))
    for name, point in points.items():
        lost = np.flatnonzero(~np.isfinite(point).all(axis=0))
        if len(lost):
            raise StatementError(
                f"{name} has no finite position at t = {t[lost[0]]:.6g}, so that it cannot be drawn: end the run "
                "before, or state another position."
            )
    if not points and not np.isfinite(states).all():
        raise StatementError("the run has a state that is no finite number, which cannot be drawn: end the run before.")
    return Motion(
        t, states, points, _energies(solution, t, states), detail, solution.drift.scale if solution.has_energy else 0.0
    )


def _energies(solution: Solution, t: FloatArray, states: FloatArray) -> dict[str, FloatArray]:
    """Return the energies that have a value everywhere; none if the energy itself does not."""
    if not solution.has_energy:
        return {}
    model, statement, parameters = solution.model, solution.model.statement, solution.parameters_at(t)
    try:
        found = {"energy": np.asarray(model.energy(*model.layout.split(states), t, parameters))}
        if statement.potential != 0:  # a Lagrangian has no parts, and without V the kinetic energy is all of it
            parts = {"kinetic": statement.kinetic, "potential": statement.potential}
            found = {
                name: model.evaluate_expression(part, t, states, parameters) for name, part in parts.items()
            } | found
    except LagrangeError:
        return {}
    return found if all(np.isfinite(row).all() for row in found.values()) else {}
