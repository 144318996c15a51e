"""Zero lines of a function on a plane: contours on a grid, each vertex refined to rounding on its edge of the grid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.backend import FloatArray

HALVINGS = 70
"""Bisections of an edge: 52 bits of a double, and more for a crossing near zero."""

PlaneFunction = Callable[[FloatArray, FloatArray], FloatArray]
"""Values (k,) at points x (k,) and y (k,)."""


def zero_lines(function: PlaneFunction, x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """Return the lines (k, 2) on which a function vanishes, on the grid of equally spaced x (k,) and y (m,).

    The last point of a closed line is its first. Every vertex is a zero of the function to rounding, on an edge of the
    grid. Cells with a value that is not finite are left out. Changes of sign across a pole are left out, too.
    """
    from contourpy import contour_generator  # installed with Matplotlib

    columns, rows = np.meshgrid(x, y)
    values = np.asarray(function(columns.ravel(), rows.ravel()), dtype=float).reshape(columns.shape)
    contours: Any = contour_generator(x, y, np.ma.masked_invalid(values)).lines(0.0)
    lines = []
    for line in contours:
        points, true = _refined(function, x, y, line)
        parts = np.split(np.arange(len(points)), np.flatnonzero(np.diff(true)) + 1)
        lines += [points[part] for part in parts if true[part[0]] and len(part) > 1]
    return tuple(lines)


def _refined(
    function: PlaneFunction, x: FloatArray, y: FloatArray, line: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the vertices (k, 2) of a contour line, moved to zeros of the function, and k flags, False at a pole.

    Each vertex is on an edge of the grid x, y, where the zero is found by bisection.
    """
    grid_positions = (line - [x[0], y[0]]) / [x[1] - x[0], y[1] - y[0]]
    nearest = grid_positions.round()
    off = np.abs(grid_positions - nearest)
    along = off == off.max(axis=1, keepdims=True)  # the direction of the edge of each vertex
    ends = (np.where(along, end(grid_positions), nearest).astype(int) for end in (np.floor, np.ceil))
    low, high = (np.column_stack([x[column], y[row]]) for column, row in (vertices.T for vertices in ends))
    before, after = function(*low.T), function(*high.T)
    sign = before > 0
    for _ in range(HALVINGS):
        middle = low + (high - low) / 2
        same = (function(*middle.T) > 0) == sign
        low, high = np.where(same[:, None], middle, low), np.where(same[:, None], high, middle)
    sizes = np.abs([function(*low.T), function(*high.T)])
    best = np.where((sizes[0] <= sizes[1])[:, None], low, high)
    # Across a pole the values increase towards the change of sign.
    return best, sizes.min(axis=0) <= 1e-3 * np.maximum(np.abs(before), np.abs(after))
