"""Positions of named points along a run."""

from __future__ import annotations

import numpy as np
from sympy.core.function import AppliedUndef

from lagrange.equations.euler_lagrange import node_of
from lagrange.machine.model import Model
from lagrange.machine.parameters import Parameters
from lagrange.statement.coordinate import t as time
from lagrange.statement.declare import ORIGIN
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray


def points_at(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> dict[str, FloatArray]:
    """Return the positions of the named points by name, each (2, K) or (3, K), for states y (2n, K) at times t (K,).

    The order is that of the statement, with the points along surfaces after the others. The origin comes last if a
    link names it. The result is empty without named points.
    """
    statement = model.statement
    if "points" not in model.prepared:
        parts = (part for point in statement.drawn.values() for part in point)
        model.prepared["points"] = tuple(node_of(part, statement, model.equations) for part in parts)
    entries = model.prepared["points"]
    values_at = model.called(model.function("points", entries), t, y, parameters) if entries else np.empty(0)
    sizes = np.cumsum([len(point) for point in statement.drawn.values()])
    points = dict(zip(statement.drawn, np.split(values_at, sizes[:-1]), strict=True)) if entries else {}
    if points and ORIGIN not in points and any(ORIGIN in (link.start, link.end) for link in statement.links):
        points[ORIGIN] = np.zeros_like(next(iter(points.values())))
    return points


def fixed_points(statement: Statement) -> dict[str, bool]:
    """Return a dict from the name of each point, and of the origin, to True if the point does not move, else False.

    Points along surfaces count as fixed: they have no paths.
    """
    fixed = {
        name: not any(part.atoms(AppliedUndef) or part.has(time) for part in parts)
        for name, parts in statement.positions.items()
    }
    return {**dict.fromkeys(statement.drawn, True), **fixed, ORIGIN: True}
