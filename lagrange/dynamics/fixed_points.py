"""Find and classify the equilibria of one coordinate, and trace the lines on which a function of (x, v) vanishes.

The kind of an equilibrium follows from the eigenvalues of the linear equations. Lines are contours on a grid, whose
vertices are refined to rounding on their edges of the grid.

Source: S. H. Strogatz, Nonlinear Dynamics and Chaos, 2nd ed., 2015, sections 5.2 and 6.3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import RunError, StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.expansion import stated_point

AXIS_POINTS = 4001
"""Number of coordinates at which the force at rest is evaluated to find equilibria. Two zeros between neighbours may be
missed."""

EIGENVALUE_NOISE = 1e-9
"""Largest real or imaginary part of an eigenvalue that counts as rounding noise, relative to the largest eigenvalue."""

FLAT_SLOPE = 1e-6
"""Threshold of the derivative of the acceleration by the coordinate, below which an equilibrium is degenerate.

It is relative to the largest acceleration on the axis, divided by the length of the axis."""

FLAT_FORCE = 1e-10
"""Threshold of abs(acceleration) at a minimum along the axis, below which the minimum is a zero without change of sign.

It is relative to the largest acceleration on the axis."""

SADDLE, CENTRE, LINEAR_CENTRE, DEGENERATE = "saddle", "centre", "linear centre", "degenerate"


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """An equilibrium: the state (2n,), its kind, and two eigenvalues with eigenvectors, the columns of a matrix (2, 2).

    Kinds are "saddle", "centre", "stable spiral", "unstable spiral", "stable node", "unstable node", "linear centre"
    and "degenerate". A degenerate equilibrium has an eigenvalue zero, or the forces have a corner or a jump at it:
    linear equations do not decide its stability. A "linear centre" has imaginary eigenvalues in a system that does not
    conserve its energy: terms of higher order decide.
    """

    state: FloatArray
    kind: str
    eigenvalues: FloatArray
    eigenvectors: FloatArray

    @property
    def stable(self) -> bool | None:
        """True if motions that start near the equilibrium stay near, False if they do not.

        It is None if the linear equations do not decide.
        """
        if self.kind in (DEGENERATE, LINEAR_CENTRE):
            return None
        return self.kind == CENTRE or self.kind.startswith("stable")


def fixed_points(model: Model, parameters: FloatArray, low: float, high: float) -> tuple[tuple[FixedPoint, ...], str]:
    """Return the equilibria of a system with one coordinate between `low` and `high`, and a note.

    `parameters` (k,) are the values of the parameters. If the acceleration at rest has no nonzero value, or is zero at
    over half of the sampled coordinates, there are no equilibria in the result, and the note says why. Else the note is
    "".
    """
    spacing = (high - low) / (AXIS_POINTS - 1)
    x = np.linspace(
        low - spacing / 2, high + spacing / 2, AXIS_POINTS + 1
    )  # the ends are inside: they may be equilibria
    a = _at_rest(model, parameters, x)
    finite = np.isfinite(a)
    largest = float(np.abs(a[finite]).max(initial=0.0))
    if largest == 0.0 or np.count_nonzero(a[finite] == 0.0) > AXIS_POINTS // 2:
        return (), "Every place is an equilibrium, or none is: no force acts at rest."
    roots = [*_crossings(model, parameters, x, a), *_touches(model, parameters, x, a, largest)]
    distinct: list[float] = []
    for root in sorted(0.0 if abs(root) < 1e-15 * (high - low) else root for root in roots):
        if not distinct or root - distinct[-1] > spacing / 2:
            distinct.append(root)
    flat = FLAT_SLOPE * largest / (high - low)
    return tuple(fixed_point(model, parameters, np.array([root, 0.0]), flat) for root in distinct), ""


def fixed_point(model: Model, parameters: FloatArray, state: FloatArray, flat: float = 0.0) -> FixedPoint:
    """Return the equilibrium at `state` (2n,) with its kind, for the values `parameters` (k,).

    The kind is degenerate if the derivative of the acceleration by the coordinate is at most `flat` in magnitude, or if
    the forces have a corner or a jump at the state.
    """
    jacobian = model.jacobian(0.0, state, parameters)
    if not np.isfinite(jacobian).all() or not _is_linear(model, parameters, state):
        return FixedPoint(state, DEGENERATE, np.full(2, np.nan), np.full((2, 2), np.nan))
    values, vectors = np.linalg.eig(jacobian)
    kind = DEGENERATE if abs(jacobian[1, 0]) <= flat else kind_of(values, conservative=model.conservative)
    return FixedPoint(state, kind, values, vectors)


def _is_linear(model: Model, parameters: FloatArray, state: FloatArray) -> bool:
    """Return True if the forces are differentiable at a state (2n,), so that linear equations exist there.

    It is False at a corner or a jump of a force, such as dry friction at rest. `parameters` are the values of the
    parameters.
    """
    known = dict(zip(model.statement.parameters, parameters.tolist(), strict=True))
    statement = model.with_defaults(known).statement
    at = dict(zip((*statement.coordinates, *statement.velocities), state.tolist(), strict=True))
    try:
        stated_point(statement, at).check_corners()
    except StatementError:
        return False
    return True


def kind_of(values: FloatArray, *, conservative: bool) -> str:
    """Return the kind of an equilibrium, such as "saddle", from its two eigenvalues `values` (2,).

    `conservative` is True if the system conserves energy: imaginary eigenvalues then mean a centre.
    """
    size = float(np.abs(values).max())
    if size == 0.0 or not np.abs(values).min():
        return DEGENERATE
    real, imaginary = values.real / size, values.imag / size
    if np.abs(imaginary).max() <= EIGENVALUE_NOISE:
        if real.min() < 0 < real.max():
            return SADDLE
        return "stable node" if real.max() < 0 else "unstable node"
    if np.abs(real).max() <= EIGENVALUE_NOISE:
        return CENTRE if conservative else LINEAR_CENTRE
    return "stable spiral" if real.max() < 0 else "unstable spiral"


def _at_rest(model: Model, parameters: FloatArray, x: FloatArray) -> FloatArray:
    """Return the accelerations (k,) at the coordinates x (k,) with velocity zero, NaN where they have no value.

    `parameters` are the values of the parameters.
    """
    try:
        return np.asarray(model.accelerations(x[None, :], np.zeros((1, len(x))), 0.0, parameters)[0])
    except RunError:
        return np.full(len(x), np.nan)


def _crossings(model: Model, parameters: FloatArray, x: FloatArray, a: FloatArray) -> list[float]:
    """Return the coordinates where the acceleration at rest changes its sign, to rounding, by bisection.

    `a` (k,) are the accelerations at the coordinates x (k,), and `parameters` the values of the parameters.
    """
    exact = x[a == 0.0].tolist()
    at = np.nonzero(np.sign(a[:-1]) * np.sign(a[1:]) < 0)[0]
    low, high, sign = x[at], x[at + 1], a[at] > 0
    size = np.maximum(np.abs(a[at]), np.abs(a[at + 1]))
    for _ in range(80):
        middle = low + (high - low) / 2
        same = (_at_rest(model, parameters, middle) > 0) == sign
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    ends = np.array([np.abs(_at_rest(model, parameters, low)), np.abs(_at_rest(model, parameters, high))])
    best = np.where(ends[0] <= ends[1], low, high)
    # A force with a jump or a pole changes its sign without a zero.
    return [*exact, *best[ends.min(axis=0) <= 1e-6 * size].tolist()]


def _touches(model: Model, parameters: FloatArray, x: FloatArray, a: FloatArray, largest: float) -> list[float]:
    """Return the coordinates where the acceleration at rest touches zero without a change of sign.

    `a` (k,) are the accelerations at the coordinates x (k,), and `largest` is their largest magnitude. `parameters` are
    the values of the parameters. A search narrows the interval around each minimum of abs(a).
    """
    size, sign = np.abs(a), np.sign(a)
    inner = np.nonzero((size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:]) & (sign[:-2] * sign[2:] > 0))[0] + 1
    minima = []
    for k in inner.tolist():
        low, high = float(x[k - 1]), float(x[k + 1])
        for _ in range(60):
            probes = np.linspace(low, high, 9)
            least = int(np.argmin(np.abs(_at_rest(model, parameters, probes))))
            low, high = float(probes[max(0, least - 1)]), float(probes[min(8, least + 1)])
        minimum = np.array([(low + high) / 2])
        if abs(float(_at_rest(model, parameters, minimum)[0])) <= FLAT_FORCE * largest:
            minima.append(float(minimum[0]))
    return minima


HALVINGS = 70  # Number of bisections of an edge: 52 for the bits of a double, and more for a zero near x = 0
PlaneFunction = Callable[[FloatArray, FloatArray], FloatArray]  # Values (k,) at points x (k,) and y (k,)


def zero_lines(function: PlaneFunction, x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """Return the lines (j, 2) on which a function vanishes, on the grid of equally spaced x (k,) and y (m,).

    The last point of a closed line equals its first. Every vertex is a zero of the function to rounding, on an edge of
    the grid. Cells with a value that is not finite are left out, and changes of sign across a pole, too.
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
    """Return the vertices (j, 2) of a contour `line`, moved to zeros of the function, and a mask (j,), False at a pole.

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
    # The function changes its sign also at a pole, where its absolute value increases instead of decreasing.
    return best, sizes.min(axis=0) <= 1e-3 * np.maximum(np.abs(before), np.abs(after))
