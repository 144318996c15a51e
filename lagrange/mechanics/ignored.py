"""Ignored coordinates rebuilt along a run of the Routhian: their velocities integrated over the path of the run."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from lagrange.errors import RunError, StatementError, listing
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.routh import routh_of
from lagrange.statement.coordinate import velocity_of
from lagrange.statement.statement import Statement

NODES = 8
"""Nodes of Gauss's rule in each part of an interval between outputs; it is exact to degree 15."""

MOST_PARTS = 64
"""Parts of an interval at most; with eight nodes each, those of a step of Taylor series need two or four."""

TOLERANCE = 1e-12
"""Difference of two rules, relative to the angle gone through, at which the finer one is taken."""


class Run(Protocol):
    """What is read of a solution."""

    @property
    def t(self) -> FloatArray:
        """The output times, (N,)."""

    @property
    def model(self) -> Model:
        """The model that ran."""

    @property
    def parameters(self) -> Any:
        """The values of its parameters."""

    def at(self, t: Any) -> FloatArray:
        """Return the states at times of the run, (2n, K)."""


def ignored(statement: Statement, solution: Run) -> dict[Any, FloatArray]:
    """Return ignored coordinates and their velocities at the output times of a run of the Routhian, (N,) each.

    They start at the initial values of the statement. Raises StatementError for a run of another system.
    """
    small = getattr(getattr(solution, "model", None), "statement", None)
    missing = [] if small is None else [q for q in statement.coordinates if q not in small.coordinates]
    if small is None or not missing or any(q not in statement.coordinates for q in small.coordinates):
        raise StatementError(
            f"this is no run of a Routhian of {statement.name}: run routhian(...) of this system, of "
            f"{listing(statement.names)}, and give that solution."
        )
    routh = routh_of(statement, missing)
    found: dict[Any, FloatArray] = {}
    for i, rate in zip(routh.places, routh.rates, strict=True):
        q = statement.coordinates[i]
        speed = _Speed(solution, routh.form.written(rate))
        found[q] = statement.initial[i] + _integral(speed, solution.t, statement.names[i])
        found[velocity_of(q)] = speed(solution.t)
    return found


class _Speed:
    """The velocity of an ignored coordinate at times of a run."""

    def __init__(self, solution: Run, rate: Any) -> None:
        self.solution, self.rate = solution, rate

    def __call__(self, times: FloatArray) -> FloatArray:
        run = self.solution
        return run.model.evaluate_expression(self.rate, times, run.at(times), run.parameters)


def _integral(speed: _Speed, times: FloatArray, name: str) -> FloatArray:
    """Return the integral of a velocity from the first time to each, with parts halved until two rules agree."""
    parts, before = 1, _sums(speed, times, 1)
    while parts < MOST_PARTS:
        parts *= 2
        after = _sums(speed, times, parts)
        scale = float(np.abs(np.diff(after)).sum()) + np.finfo(float).tiny
        if float(np.abs(after - before).max(initial=0.0)) <= TOLERANCE * scale:
            return after
        before = after
    raise RunError(
        f"{name} is not rebuilt to {TOLERANCE:g}: its velocity varies too fast between the output times. Run with "
        "shorter steps, or with t_eval closer together."
    )


def _sums(speed: _Speed, times: FloatArray, parts: int) -> FloatArray:
    """Return the integral with so many parts in each interval."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    inside = ((np.arange(parts)[:, None] + (nodes + 1.0) / 2.0) / parts).ravel()
    lengths = np.diff(times)
    at = times[:-1, None] + lengths[:, None] * inside
    values = speed(at.ravel()).reshape(at.shape)
    pieces = values @ np.tile(weights / (2.0 * parts), parts) * lengths
    return np.concatenate([[0.0], np.cumsum(pieces)])
