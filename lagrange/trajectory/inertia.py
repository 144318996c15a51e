"""A mass matrix that becomes singular: which motion loses its inertia, and whether that ends a run."""

from __future__ import annotations

import numpy as np

from lagrange.equations.singular import Singular, dependent_rows, few, motion_along
from lagrange.machine.backend import SingularMassMatrix
from lagrange.trajectory.constraints.approach import regularity
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


def lost_inertia(problem: Problem, t: float, y: FloatArray) -> str:
    """Return the message for a run that ends at a state (2n,) because a motion has lost its inertia, else ""."""
    model, parameters = problem.model, problem.parameter_array
    if len(model.equations.constraints):
        return _lost_rank(problem, t, y)
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
    place = few([f"{name} = {number(x)}" for name, x in zip(row_names(problem), y, strict=True)])
    return (
        f"the mass matrix d2L/dv2 degenerates there, at {place}: a motion with "
        f"{motion_along(model.layout.rates, null / units)} has {left / least:.2g} of the least inertia at the "
        "start, and its acceleration grows beyond all bounds. End the run before it, or state a Lagrangian that keeps "
        "its inertia."
    )


def _lost_rank(problem: Problem, t: float, y: FloatArray) -> str:
    """Return the message for a run that ends where constraints become dependent, or a motion without inertia, or ""."""
    here = regularity(problem.model, problem.parameter_array, (problem.t0, problem.y0), (t, y))
    return "" if here is None or not here[0] < LOST_INERTIA else rank_lost(problem, y, *here)


def rank_lost(problem: Problem, y: FloatArray, share: float, found: Singular) -> str:
    """Return the message for a run that ends at a state (2n,) where what is singular has a share of its regularity."""
    place = few([f"{name} = {number(x)}" for name, x in zip(row_names(problem), y, strict=True)])
    left = f"{share:.2g} of what it was at the start"
    if found.motion is not None:
        return (
            f"the inertia of a motion with {motion_along(problem.model.layout.rates, found.motion)}, which satisfies "
            f"the constraints, vanishes there, at {place}: it is {left}. End the run before it, or state a Lagrangian "
            "that keeps its inertia."
        )
    what = f"their least singular value is {left}"
    if len(found.rows) == 1:
        what = f"these derivatives are {share:.2g} of what they were at the start"
    return (
        f"{dependent_rows(problem.model.equations.constraints.names, found)} there, at {place}: {what}, and the "
        "accelerations grow beyond all bounds. End the run before it."
    )


def crossing(problem: Problem, dependent: Singular, y: FloatArray) -> str:
    """Return the message for a run that ends at a state (2n,) where motions cross and its errors choose one."""
    place = few([f"{name} = {number(x)}" for name, x in zip(row_names(problem), y, strict=True)])
    names = problem.model.equations.constraints.names
    return (
        f"{dependent_rows(names, dependent)} near there, and an error as small as the tolerance decides how the motion "
        f"goes on. The state is {place}. End the run before it, or pass it with equal steps, such as those of rk4."
    )


def _moves_along(problem: Problem, t: float, y: FloatArray, null: FloatArray, metric: FloatArray) -> bool:
    """Whether the acceleration at a state is mostly that of one motion, measured by the inertia at the start."""
    try:
        rate = problem.model.kernel("rhs")(t, y, problem.parameter_array)[problem.model.layout.v]
    except SingularMassMatrix:
        return True
    size = float(np.sqrt(metric @ rate**2))
    return not np.isfinite(size) or abs(float((metric * null) @ rate)) >= DOMINANT_SHARE * size
