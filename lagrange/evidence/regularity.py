"""Is the mass matrix singular by construction? Asked when a system is stated, answered in the user's symbols."""

from __future__ import annotations

import numpy as np

from lagrange.equations.euler_lagrange import Equations, no_inertia
from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.numpy import NumpyMachine
from lagrange.program.catalogue import program_of

POINTS = 8
"""Random states at which the rank is looked at; one regular point clears a block."""

RANK = 1e-11
"""A singular value below this fraction of the largest counts as zero, after scaling every row to a unit diagonal."""


def check_mass_matrix(equations: Equations) -> None:
    """Raise StatementError if the mass matrix is singular in every configuration, for any parameters.

    The message names the combination of velocities that has no inertia.
    """
    names = equations.structure.names
    coupled = [block for block in equations.structure.blocks if len(block) > 1]
    if not coupled:
        return
    matrices = _random_matrices(equations)
    for block in coupled:
        null = _common_null_vector(matrices[np.ix_(block, block)])
        if null is not None:
            raise StatementError(_no_inertia_along([names[i] for i in block], null))


def _random_matrices(equations: Equations) -> FloatArray:
    """Return the mass matrix at random states and positive parameters, (n, n, POINTS)."""
    random = np.random.default_rng(7)
    kernel = NumpyMachine().load(program_of("mass_matrix", equations))
    state = random.uniform(0.2, 1.2, (2 * len(equations.q), POINTS))
    return kernel(random.uniform(0.2, 1.2, POINTS), state, random.uniform(0.5, 2.0, len(equations.parameters)))


def _common_null_vector(matrices: FloatArray) -> FloatArray | None:
    """Return the null vector of the first matrix if every finite one is singular."""
    found = None
    for k in range(matrices.shape[2]):
        matrix = matrices[:, :, k]
        if not np.isfinite(matrix).all():
            continue
        diagonal = np.sqrt(np.abs(np.diag(matrix)))
        scale = np.where(diagonal > 0, diagonal, np.sqrt(np.abs(matrix).max()) or 1.0)
        _, values, vectors = np.linalg.svd(matrix / np.outer(scale, scale))
        if values[-1] > RANK * values[0]:
            return None
        found = vectors[-1] / scale if found is None else found
    return found


def _no_inertia_along(names: list[str], null: FloatArray) -> str:
    null = null / null[np.argmax(np.abs(null))]
    terms = [f"{name}.dot = {x:.4g}" for name, x in zip(names, null, strict=True) if abs(x) > 1e-9]
    if len(terms) == 1:
        return no_inertia(terms[0].partition(".dot")[0])
    return (
        f"the mass matrix d2L/dv2 is singular in every configuration: a motion with {', '.join(terms)} has no "
        "inertia, so "
        "these accelerations are not determined. Add the kinetic energy that is missing, or use fewer coordinates."
    )
