"""A mass matrix that becomes singular: which motion loses its inertia, and whether that ends a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lagrange.machine.backend import SingularMassMatrix
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import number, row_names
from lagrange.trajectory.trajectory import FloatArray

LOST_INERTIA = 2.0**-20
"""A motion has lost its inertia if that is below this fraction of the smallest inertia at the start.

Where accelerations grow without bound because of it, steps become too small at 1e-8 to 1e-11 (eight systems, four
methods).
"""

DOMINANT_SHARE = 0.5
"""The loss of inertia ends the run if the motion without inertia is at least this share of the accelerations.

In a fall to the centre of polar coordinates its share is zero.
"""

MOST_NAMED = 8
"""Most entries of a state, or velocities, that a message names."""


def lost_inertia(problem: Problem, t: float, y: FloatArray) -> str:
    """Return the message for a run that ends at a state (2n,) because a motion has lost its inertia, else ""."""
    model, parameters = problem.model, problem.parameter_array
    kernel = model.kernel("mass_matrix")
    before, here = kernel(problem.t0, problem.y0, parameters), kernel(t, y, parameters)
    sizes = np.abs(np.diag(before))
    units = np.sqrt(np.where(sizes > 0, sizes, 1.0))
    if not (np.isfinite(before).all() and np.isfinite(here).all()):
        return ""
    least = float(np.abs(np.linalg.eigvalsh(before / np.outer(units, units))).min())
    values, vectors = np.linalg.eigh(here / np.outer(units, units))
    which = int(np.argmin(np.abs(values)))
    left, null = float(abs(values[which])), vectors[:, which]
    if not left < LOST_INERTIA * least or not _moves_along(problem, t, y, null / units, units**2):
        return ""
    place = _few([f"{name} = {number(x)}" for name, x in zip(row_names(problem), y, strict=True)])
    return (
        f"the mass matrix d2L/dv2 degenerates there, at {place}: a motion with "
        f"{motion_along(model.layout.rates, null / units)} has {left / least:.2g} of the least inertia at the "
        "start, and its acceleration grows beyond all bounds. End the run before it, or state a Lagrangian that keeps "
        "its inertia."
    )


def _moves_along(problem: Problem, t: float, y: FloatArray, null: FloatArray, metric: FloatArray) -> bool:
    """Whether the acceleration at a state is mostly that of one motion, measured by the inertia at the start."""
    try:
        rate = problem.model.kernel("rhs")(t, y, problem.parameter_array)[problem.model.layout.v]
    except SingularMassMatrix:
        return True
    size = float(np.sqrt(metric @ rate**2))
    return not np.isfinite(size) or abs(float((metric * null) @ rate)) >= DOMINANT_SHARE * size


def motion_along(names: Sequence[str], null: FloatArray) -> str:
    """Return a combination of velocities as text, such as ``x.dot = 1, y.dot = -0.5``."""
    size = np.abs(null)
    # The first of the largest entries is exactly 1.
    null = null / null[np.argmax(size > 0.999 * size.max())]
    return _few([f"{name}.dot = {x:.4g}" for name, x in zip(names, null, strict=True) if abs(x) > 1e-9])


def _few(parts: list[str]) -> str:
    return ", ".join(parts if len(parts) <= MOST_NAMED else [*parts[: MOST_NAMED - 1], "and so on"])
