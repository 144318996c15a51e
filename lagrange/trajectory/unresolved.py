"""Runs in which a coordinate is so large that doubles do not resolve what the forces change on.

A pendulum at theta = 1e16 moves by 2 or not at all: the spacing of doubles there is a third of a turn. Its steps are
taken, and mean nothing, whether energy is conserved or not.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

STANDING = 2.0**-42
"""A coordinate that ends within this part of its size from its start may be unresolved: a thousand spacings."""

ROUGH = 2.0**-8
"""Forces are unresolved if a spacing of the coordinate changes them by this fraction of their whole variation.

The variation is that over displacements up to 2**-12 of the coordinate. Smooth forces change by 2**-40 of it. At theta
= 1e14, where a spacing is a 64th, the energy of a pendulum is wrong by a tenth.
"""

NEIGHBOURS, OCTAVES = 8, 40
"""Number of neighbouring doubles, and of displacements of 1, 2, 4, ... spacings, at which forces are evaluated."""


def unresolved(problem: Problem, trajectory: Trajectory) -> str:
    """Return a sentence on a coordinate of a complete run whose spacing of doubles the forces do not bear, or "".

    Neighbours on both sides of a jump differ once only: the median of their differences is small.
    """
    if not trajectory.status.complete or not trajectory.y.size:
        return ""
    layout = problem.model.layout
    begin, end = problem.y0.tolist(), trajectory.y[:, -1].tolist()
    for i in range(layout.q.stop):
        first, last = begin[i], end[i]
        if first and abs(last - first) <= STANDING * abs(first) and math.isfinite(first):
            ends = (problem.t0, problem.y0), (float(trajectory.t[-1]), trajectory.y[:, -1])
            if all(_is_rough(problem, t, y, i) for t, y in ends):
                name = layout.coordinates[i]
                return (
                    f"{name} is {last:.4g}, where doubles are {math.ulp(last):.2g} apart, and forces change much over "
                    f"that: the run does not follow the motion. Start {name} nearer to zero, an angle within a turn."
                )
    return ""


def with_resolution(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """Return a run, as unreliable if a coordinate is too large for its forces."""
    note = unresolved(problem, trajectory)
    if not note:
        return trajectory
    return replace(trajectory, status=Status.UNRELIABLE, message=f"{trajectory.message} {note}")


def _is_rough(problem: Problem, t: float, y: FloatArray, i: int) -> bool:
    """Whether the accelerations at a state (2n,) change between neighbouring doubles of a coordinate."""
    steps = np.concatenate([np.arange(NEIGHBOURS + 1.0), 2.0 ** np.arange(OCTAVES)])
    states = np.repeat(y[:, None], len(steps), axis=1)
    states[i] += steps * np.spacing(abs(y[i])) * (-1.0 if y[i] > 0 else 1.0)
    with np.errstate(all="ignore"):
        slopes = problem.model.kernel("rhs")(t, states, problem.parameter_array)[problem.model.layout.v]
    near = np.median(np.abs(np.diff(slopes[:, : NEIGHBOURS + 1], axis=1)), axis=1)
    whole = np.abs(slopes - slopes[:, :1]).max(axis=1)
    return bool((near > ROUGH * whole).any())
