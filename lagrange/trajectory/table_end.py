"""Runs that leave a table over a coordinate: which one, and its range."""

from __future__ import annotations

import numpy as np

from lagrange.errors import formula
from lagrange.statement.table import ranges
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray

NEAR_END = 1e-6
"""Part of the range of a table within which a run that cannot go on is at its end: adaptive steps come closer."""


def table_left(problem: Problem, t: float, y: FloatArray, step: float = 0.0) -> str:
    """Return a sentence on a table that a state (2n,) is at the end of, or one step later, or ""."""
    model, statement = problem.model, problem.model.statement
    stated = (statement.lagrangian, statement.dissipation, *statement.forces)
    found = dict.fromkeys(one for expression in stated for one in ranges(expression))
    if not found or not np.isfinite(y).all():
        return ""
    q, v = model.layout.split(y)
    states = np.stack([y, np.concatenate([q + step * v, v])], axis=1)
    nodes = tuple(model.equations.translate(variable) for variable, _, _ in found)
    values = model.function("ranges", nodes)(np.array([t, t + step]), states, problem.parameter_array)
    for (variable, low, high), row in zip(found, values, strict=True):
        margin = NEAR_END * (high - low)
        if not (low + margin < row.min() and row.max() < high - margin):
            name = formula(variable.xreplace(dict(statement.plain)), 60)
            return (
                f"{name} = {row[0]:.6g} leaves its table, which has values from {low:.6g} to {high:.6g}: nothing is "
                "extrapolated. Give a longer table, or end the run before by a terminal event."
            )
    return ""
