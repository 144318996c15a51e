"""Where the stated positions are along a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lagrange.machine.model import Model
from lagrange.statement.declare import ORIGIN
from lagrange.trajectory.trajectory import FloatArray


def points_at(model: Model, t: FloatArray, y: FloatArray, parameters: Mapping[Any, float]) -> dict[str, FloatArray]:
    """Return each named point, (2, K) or (3, K), at K times and states y (2n, K); the origin too where a link names it.

    The order is that of the statement, the origin last; empty if no position was stated.
    """
    statement = model.statement
    points: dict[str, FloatArray] = {}
    for name, parts in statement.positions.items():
        points[name] = np.array([model.evaluate_expression(part, t, y, parameters) for part in parts])
    if points and ORIGIN not in points and any(ORIGIN in (link.start, link.end) for link in statement.links):
        points[ORIGIN] = np.zeros_like(next(iter(points.values())))
    return points
