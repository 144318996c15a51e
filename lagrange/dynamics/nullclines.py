"""Zero lines of a function on a plane: marching squares, each crossing of an edge refined to rounding.

Source: W. E. Lorensen, H. E. Cline, Marching cubes, Computer Graphics 21, 1987, in two dimensions.
"""

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

Edge = tuple[int, int, int]
"""Row and column of a grid point, and 0 for the edge to its right, 1 for the edge above it."""


def zero_lines(function: PlaneFunction, x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """Return the lines (k, 2) on which a function vanishes, on the grid of x (k,) and y (m,).

    The last point of a closed line is its first. Every vertex is a zero of the function to rounding, on an edge of the
    grid. Cells with a value that is not finite are left out, and so are changes of sign across a pole.
    """
    columns, rows = np.meshgrid(x, y)
    values = np.asarray(function(columns.ravel(), rows.ravel()), dtype=float).reshape(columns.shape)
    above = values > 0
    finite = np.isfinite(values)
    crossings: dict[Edge, FloatArray] = {}
    for kind, (first, last) in enumerate((((0, 0), (0, 1)), ((0, 0), (1, 0)))):
        _refine(function, (x, y), (above, finite, values), kind, last[0] - first[0], crossings)
    return _joined(_segments(above, values, crossings), crossings)


def _refine(
    function: PlaneFunction,
    axes: tuple[FloatArray, FloatArray],
    known: tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[Any]],
    kind: int,
    upwards: int,
    crossings: dict[Edge, FloatArray],
) -> None:
    """Bisect all edges of one direction on which the sign changes, at once."""
    (x, y), (above, finite, values) = axes, known
    near = (slice(0, len(y) - upwards), slice(0, len(x) - (1 - upwards)))
    far = (slice(upwards, None), slice(1 - upwards, None))
    rows, columns = np.nonzero((above[near] != above[far]) & finite[near] & finite[far])
    low = np.column_stack([x[columns], y[rows]])
    high = np.column_stack([x[columns + 1 - upwards], y[rows + upwards]])
    sign = above[rows, columns]
    size = np.maximum(np.abs(values[near][rows, columns]), np.abs(values[far][rows, columns]))
    for _ in range(HALVINGS):
        middle = low + (high - low) / 2
        same = (function(middle[:, 0], middle[:, 1]) > 0) == sign
        low, high = np.where(same[:, None], middle, low), np.where(same[:, None], high, middle)
    ends = np.abs([function(low[:, 0], low[:, 1]), function(high[:, 0], high[:, 1])])
    best = np.where((ends[0] <= ends[1])[:, None], low, high)
    # Across a pole the values increase towards the change of sign.
    true = ends.min(axis=0) <= 1e-3 * size
    for row, column, point, kept in zip(rows.tolist(), columns.tolist(), best, true.tolist(), strict=True):
        if kept:
            crossings[row, column, kind] = point


def _segments(
    above: NDArray[np.bool_], values: FloatArray, crossings: dict[Edge, FloatArray]
) -> list[tuple[Edge, Edge]]:
    """Return the pairs of edges that a line joins inside a cell."""
    cells: dict[tuple[int, int], None] = {}
    for row, column, kind in crossings:
        other = (row - 1, column) if kind == 0 else (row, column - 1)
        cells |= {(row, column): None, other: None}
    found = []
    for row, column in cells:
        if not (0 <= row < len(above) - 1 and 0 <= column < above.shape[1] - 1):
            continue
        # Around the cell: below, right, above, left.
        ring = ((row, column, 0), (row, column + 1, 1), (row + 1, column, 0), (row, column, 1))
        crossed = [edge for edge in ring if edge in crossings]
        if len(crossed) == 2:
            found.append((crossed[0], crossed[1]))
        elif len(crossed) == 4:
            corner = above[row, column]
            middle = values[row : row + 2, column : column + 2].mean() > 0
            pairs = ((0, 1), (2, 3)) if middle == corner else ((0, 3), (1, 2))
            found += [(ring[i], ring[j]) for i, j in pairs]
    return found


def _joined(segments: list[tuple[Edge, Edge]], crossings: dict[Edge, FloatArray]) -> tuple[FloatArray, ...]:
    """Return the lines formed by segments: open ones from end to end, then closed ones."""
    beside: dict[Edge, list[Edge]] = {}
    for a, b in segments:
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    ends = [edge for edge, others in beside.items() if len(others) == 1]
    lines = []
    for begin in (*ends, *beside):
        if not beside.get(begin):
            continue
        chain, edge = [begin], begin
        while beside[edge]:
            following = beside[edge].pop()
            beside[following].remove(edge)
            chain.append(following)
            edge = following
        lines.append(np.array([crossings[one] for one in chain]))
    return tuple(lines)
