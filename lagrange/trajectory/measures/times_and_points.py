"""Sampling of a run: states at any times, times at a rate or between the steps, and positions of named points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sympy.core.function import AppliedUndef

from lagrange.equations.euler_lagrange import node_of
from lagrange.errors import StatementError, shown
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import Parameters
from lagrange.statement.coordinate import t as time
from lagrange.statement.declare import ORIGIN
from lagrange.statement.expression import positive_number, real_array
from lagrange.statement.statement import Statement, corners
from lagrange.trajectory.trajectory import FloatArray, Trajectory

_CLIPPED = 1e-12
"""Largest fraction of the span by which a time may exceed an end due to rounding. It is then set to that end."""

MOST_LINES = 10_000_000
"""Largest number of lines of output that `Solution.to_csv(rate=...)` writes. Such a file has some gigabytes."""


def states_at(run: Trajectory, t: ArrayLike, width: int) -> FloatArray:
    """Return the states of a run at one time, (2n,), or at K times in any order, (2n, K).

    `width` is 2n. Raises StatementError for a time that the run did not reach: nothing is extrapolated.
    """
    times = reached_times(run, t, width)
    with np.errstate(all="ignore"):
        states = run.dense(np.atleast_1d(times))
    return states if times.ndim else states[:, 0]


def reached_times(run: Trajectory, t: ArrayLike, width: int = 1) -> FloatArray:
    """Return the user's time or times t as a checked array: () for one time, (K,) for K times.

    `width` is how many numbers the caller computes for each time. It serves the message if memory does not suffice.
    Raises StatementError for a time that the run did not reach.
    """
    times = real_array(t, "t", width=width)
    if times.ndim > 1 or not np.isfinite(times).all():
        raise StatementError(f"{shown(t)} is not a time: give a finite number or a list of them.")
    low, high = sorted(run.span)
    slack = _CLIPPED * (high - low)
    if times.size and not (low - slack <= times.min() and times.max() <= high + slack):
        outside = float(times.min() if times.min() < low - slack else times.max())
        raise StatementError(f"t = {outside:.15g} is outside the run, which went from {low:.6g} to {high:.6g}.")
    return np.asarray(np.clip(times.astype(float), low, high))


def times_at(run: Trajectory, rate: Any) -> FloatArray:
    """Return equally spaced times from the first to the last output of a run, `rate` of them per unit of time.

    Raises StatementError for a rate that is not positive or gives too many times.
    """
    rate = positive_number(rate, "rate", "give a positive number of lines per unit of time, such as 100")
    if not len(run.t):
        return run.t
    first, last = float(run.t[0]), float(run.t[-1])
    steps = abs(last - first) * rate
    if steps > MOST_LINES:
        raise StatementError(
            f"rate = {rate:g} gives {steps:.3g} lines from t = {first:g} to {last:g}, more than the limit of "
            f"{MOST_LINES:.0e}: give a lower rate."
        )
    forward = 1.0 if last >= first else -1.0
    times: FloatArray = first + forward * np.arange(math.floor(steps * (1 + _CLIPPED)) + 1) / rate
    return np.clip(times, min(first, last), max(first, last))


def divided(t: FloatArray, parts: int) -> FloatArray:
    """Return the times `t`, and between them further times that divide each interval into `parts` equal parts.

    Example: [0, 1, 3] with 2 parts gives [0, 0.5, 1, 2, 3].
    """
    if len(t) < 2 or parts < 2:
        return t
    inner = t[:-1, None] + np.arange(parts) / parts * np.diff(t)[:, None]
    return np.append(inner.ravel(), t[-1])


def points_at(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> dict[str, FloatArray]:
    """Return the positions of the named points by name, each (2, K) or (3, K), for states y (2n, K) at times t (K,).

    The points have the order of the statement, but points along surfaces come after the others. The origin comes last
    if a link names it. The result is empty without named points.
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


def moving_points(statement: Statement) -> list[str]:
    """Return the names of the points that pictures show with a path: neither fixed nor corners of shapes."""
    hidden = corners(statement.links)
    moving = {
        name: any(part.atoms(AppliedUndef) or part.has(time) for part in parts)
        for name, parts in statement.positions.items()
    }
    return [name for name, moves in moving.items() if moves and name not in hidden]
