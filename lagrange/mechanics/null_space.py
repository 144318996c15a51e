"""Sparse bases of null spaces in doubles: the combinations of columns that vanish at every state."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from lagrange.machine.backend import FloatArray
from lagrange.mechanics.generators import Field

NULL = 1e-8
"""What is left of a column of size 1 that depends on others: rounding and differences in time leave 1e-13 to 1e-10."""

ROUND_OFF = 1e-13
"""What terms that cancel leave, of the largest number at a state."""

SUPPORT = 1e-6
"""Coefficients below this part of the largest are zero."""


def null_rows(matrix: FloatArray) -> list[dict[int, float]]:
    """Return a sparse basis of the null space: each row has 1 in a late column in which the others have 0.

    Elimination by rows, with the largest pivot of each column, is as exact as is needed here, and for 400 columns as
    fast as one of its multiplications.
    """
    matrix = matrix[np.isfinite(matrix).all(axis=1)]
    sizes = np.abs(matrix).max(axis=1, initial=0.0)
    matrix = matrix[sizes > 0] / sizes[sizes > 0, None]
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale <= ROUND_OFF * len(matrix)] = np.inf  # a column of rounding is zero
    left = matrix / scale
    scale[np.isinf(scale)] = 1.0
    pivots: list[int] = []
    for column in range(left.shape[1]):
        done = len(pivots)
        size = np.abs(left[done:, column])
        if not len(size):
            return []  # too few states: nothing follows from them
        pivot = done + int(np.argmax(size))
        if size.max() <= NULL:
            continue
        left[[done, pivot]] = left[[pivot, done]]
        left[done] /= left[done, column]
        weights = left[:, column].copy()
        weights[done] = 0.0
        left -= weights[:, None] * left[done]
        pivots.append(column)
    free = [column for column in range(left.shape[1]) if column not in pivots]
    return [_null_row(left, pivots, column, scale) for column in free]


def _null_row(left: FloatArray, pivots: list[int], column: int, scale: FloatArray) -> dict[int, float]:
    """Return the null vector that belongs to a column without a pivot."""
    row = np.zeros(len(scale))
    row[pivots] = -left[: len(pivots), column]
    row[column] = 1.0
    row /= scale
    return _sparse(row / row[column])


def _sparse(row: FloatArray) -> dict[int, float]:
    return {int(k): float(row[k]) for k in np.flatnonzero(np.abs(row) > SUPPORT * np.abs(row).max())}


def with_rotations(
    rows: Sequence[Mapping[int, float]], xi: Sequence[Field], names: Sequence[str]
) -> list[Mapping[int, float]]:
    """Return a basis of the same space with the rotations of all bodies together in it, where they are in the space.

    Of several bodies the angular momenta of all, and of their centre, are conserved, and so is any sum of them.
    """
    basis = list(rows)
    for wanted in _rotations(xi, names) if basis else ():
        places = sorted({place for row in (*basis, wanted) for place in row})
        matrix = np.array([[row.get(place, 0.0) for row in basis] for place in places])
        target = np.array([wanted.get(place, 0.0) for place in places])
        shares, *_ = np.linalg.lstsq(matrix, target, rcond=None)
        if np.abs(matrix @ shares - target).max() <= SUPPORT:
            basis[int(np.argmax(np.abs(shares)))] = wanted
    return basis


def _rotations(xi: Sequence[Field], names: Sequence[str]) -> list[dict[int, float]]:
    """Return the rotations in which x1, y1, x2, y2 and so on turn together, as coefficients of fields by place."""
    at = {field: place for place, field in enumerate(xi)}
    bodies: dict[str, dict[str, int]] = {}
    for i, name in enumerate(names):
        split = re.fullmatch(r"([xyz])(.+)", name)
        if split:
            bodies.setdefault(split[2], {})[split[1]] = i
    found = []
    for first, second in (("x", "y"), ("y", "z"), ("z", "x")):
        pairs = [(axes[first], axes[second]) for axes in bodies.values() if first in axes and second in axes]
        fields = [(Field(j, ((i, "q"),)), 1.0) for i, j in pairs] + [(Field(i, ((j, "q"),)), -1.0) for i, j in pairs]
        if len(pairs) > 1 and all(field in at for field, _ in fields):
            found.append({at[field]: c for field, c in fields})
    return found
