"""Numbers of a series that are constant along a run: constants in recurrences, and inverses of constant matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lagrange.algorithm.linear.symmetric import PIVOT, scale_rows
from lagrange.equations.solve_plan import SolvePlan
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.kernel.interpreted import FLOATS
from lagrange.program.series import SeriesProgram


def constants(program: SeriesProgram, parameters: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """Return the constants in the recurrences of a series, and the inverse (n, n) of each of its constant matrices.

    `parameters` (k + s,) end with the signs of the switching surfaces. The matrices are those of the linear systems
    that give accelerations and multipliers. An inverse is NaN if a parameter is NaN, for example while the sign of a
    surface is unknown. Raises SingularMassMatrix.
    """
    with np.errstate(all="ignore"):
        values = FLOATS.evaluate(program.constants, 0.0, [0.0] * program.states, list(parameters))
    table, entries = np.array(values[: len(program.numbers)], dtype=float), values[len(program.numbers) :]
    unknown, inverses = bool(np.isnan(parameters).any()), []
    for plan in (stage.plan for stage in program.stages if not stage.plan.moving):
        matrix, entries = symmetric(plan, entries), entries[len(plan.triangle) :]
        whole = np.full_like(matrix, np.nan) if unknown else np.zeros_like(matrix)
        for block in () if unknown else plan.blocks:
            whole[np.ix_(block, block)] = inverse(matrix[np.ix_(block, block)])
        inverses.append(whole)
    return table, inverses


def symmetric(plan: SolvePlan, triangle: Sequence[float]) -> FloatArray:
    """Return the symmetric matrix (n, n) of a linear system from its lower entries `triangle`.

    `plan.triangle` has the row and column of each of these entries. `triangle` may be longer: only as many entries
    are read. All other entries are zero.
    """
    full = np.zeros((plan.size, plan.size))
    for (i, j), entry in zip(plan.triangle, triangle, strict=False):
        full[i, j] = full[j, i] = entry
    return full


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a symmetric matrix (n, n), NaN if an entry is not finite.

    Raises SingularMassMatrix if the inverse of the scaled matrix has an entry above 1/`PIVOT`.
    """
    if not np.isfinite(matrix).all():
        return np.full_like(matrix, np.nan)
    diagonal = np.abs(np.diag(matrix))
    units: Any = np.empty_like(diagonal)
    if diagonal.all():
        units = 1 / np.sqrt(diagonal)
    else:  # constraints and coordinates without inertia have units of their own
        largest: Any = np.empty_like(diagonal)
        scale_rows(len(matrix), len(matrix), matrix.ravel(), units, largest)
    try:
        inverse = np.linalg.inv(matrix * units[:, None] * units)
    except np.linalg.LinAlgError as error:
        raise SingularMassMatrix from error
    if not np.isfinite(inverse).all() or np.abs(inverse).max() > 1 / PIVOT:
        raise SingularMassMatrix
    with np.errstate(all="ignore"):  # values that overflow are infinite; the run reports them
        return np.asarray(inverse * units[:, None] * units)
