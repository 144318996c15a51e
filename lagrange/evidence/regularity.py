"""Whether the mass matrix is singular by construction; tested when a system is stated, in the user's symbols."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lagrange.equations.euler_lagrange import Equations, no_inertia
from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray, Kernel
from lagrange.statement.statement import Statement
from lagrange.trajectory.inertia import motion_along

POINTS = 8
"""Random states at which the rank is tested, beside the stated one; one regular point clears a block."""

RANK = 1e-13
"""A singular value below this fraction of the largest counts as zero once rows and columns are scaled alike."""


def check_mass_matrix(
    equations: Equations, kernel: Callable[[str], Kernel], statement: Statement | None = None
) -> None:
    """Raise StatementError if the mass matrix is singular at every state and for all parameters that are tried.

    These are random ones and, of a statement, its initial state with its default parameters. The message names the
    combination of velocities that has no inertia. `kernel` gives the mass matrix, which is compiled if it is needed.
    """
    names = equations.structure.names
    coupled = [block for block in equations.structure.blocks if len(block) > 1]
    if not coupled:
        return
    matrices = _matrices(equations, kernel("mass_matrix"), statement)
    for block in coupled:
        null = _common_null_vector(matrices[np.ix_(block, block)])
        if null is not None:
            raise StatementError(_no_inertia_along([names[i] for i in block], null))


def _matrices(equations: Equations, kernel: Kernel, statement: Statement | None) -> FloatArray:
    """Return the mass matrix at the states that are tried, (n, n, states)."""
    random = np.random.default_rng(7)
    state = random.uniform(0.2, 1.2, (equations.layout.size, POINTS))
    some = random.uniform(0.5, 2.0, len(equations.parameters))
    found = [kernel(random.uniform(0.2, 1.2, POINTS), state, some)]
    if statement is not None:
        stated = np.array([statement.defaults.get(p, x) for p, x in zip(statement.parameters, some, strict=True)])
        initial = np.array(statement.initial)[:, None]
        around = initial + (1e-2 * np.abs(initial) + 1e-3) * random.uniform(-1.0, 1.0, state.shape)
        found.append(kernel(0.0, np.concatenate([initial, around], axis=1), stated))
    return np.concatenate(found, axis=2)


def _common_null_vector(matrices: FloatArray) -> FloatArray | None:
    """Return the null vector of the first matrix if every finite one is singular."""
    found = None
    for k in range(matrices.shape[2]):
        matrix = matrices[:, :, k]
        if not np.isfinite(matrix).all():
            continue
        scale = _scale(matrix)
        _, values, vectors = np.linalg.svd(matrix / np.outer(scale, scale))
        if values[-1] > RANK * values[0]:
            return None
        found = vectors[-1] / scale if found is None else found
    return found


def _scale(matrix: FloatArray) -> FloatArray:
    """Return s such that M_ij / (s_i s_j) has entries of about 1 in every row (Ruiz, RAL-TR-2001-034)."""
    scale = np.ones(len(matrix))
    for _ in range(30):
        largest = np.abs(matrix / np.outer(scale, scale)).max(axis=1)
        scale = scale * np.sqrt(np.where(largest > 0, largest, 1.0))
    return scale


def _no_inertia_along(names: list[str], null: FloatArray) -> str:
    motion = motion_along(names, null)
    if "," not in motion:
        return no_inertia(motion.partition(".dot")[0])
    return (
        f"the mass matrix d2L/dv2 is singular at every state tried: a motion with {motion} has no inertia, so "
        "these accelerations are not determined. Add the kinetic energy that is missing, or use fewer coordinates."
    )
