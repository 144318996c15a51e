"""The numbers that series read on all machines: constants, and the inverses of constant matrices."""

from __future__ import annotations

import numpy as np

from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.kernel.arithmetic import FLOATS
from lagrange.procedure.linear.ldl import PIVOT
from lagrange.program.series import SeriesProgram


def constants(program: SeriesProgram, parameters: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """Return the table of constants, and the inverse (n, n) of the matrix of each stage that has a constant one.

    An inverse is NaN where a parameter is, such as a side that is still to be found. Raises SingularMassMatrix.
    """
    with np.errstate(all="ignore"):
        values = FLOATS.evaluate(program.constants, 0.0, [0.0] * (2 * program.dimension), list(parameters))
    table, rest = np.array(values[: len(program.numbers)], dtype=float), values[len(program.numbers) :]
    unknown, found = bool(np.isnan(parameters).any()), []
    for plan in (stage.plan for stage in program.stages if not stage.plan.moving):
        whole = np.zeros((plan.size, plan.size))
        for block in plan.blocks:
            count = len(block) * (len(block) + 1) // 2
            if not unknown:
                whole[np.ix_(block, block)] = inverse(symmetric(len(block), rest[:count]))
            rest = rest[count:]
        found.append(np.full_like(whole, np.nan) if unknown else whole)
    return table, found


def symmetric(n: int, triangle: list[float]) -> FloatArray:
    """Return a symmetric matrix (n, n) from its lower triangle by rows."""
    full = np.zeros((n, n))
    full[np.tril_indices(n)] = triangle
    return full + np.tril(full, -1).T


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a symmetric matrix (n, n), NaN if an entry is not finite.

    Raises SingularMassMatrix by the criterion of `PIVOT`.
    """
    if not np.isfinite(matrix).all():
        return np.full_like(matrix, np.nan)
    diagonal = np.abs(np.diag(matrix))
    units = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 1.0)
    try:
        found = np.linalg.inv(matrix * units[:, None] * units)
    except np.linalg.LinAlgError as error:
        raise SingularMassMatrix from error
    if not np.isfinite(found).all() or np.abs(found).max() > 1 / PIVOT:
        raise SingularMassMatrix
    with np.errstate(all="ignore"):  # what overflows is infinite, and the run says so
        return np.asarray(found * units[:, None] * units)
