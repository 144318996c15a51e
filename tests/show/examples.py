"""Solutions with known motions: a model on the numpy machine, with an exact trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np
from sympy import Float

from lagrange.compiler import model_of
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.statement.coordinate import coordinate, coordinates, parameters
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status, Trajectory

x = coordinate("x")
m, k = parameters("m k")


def solved(statement: Any, t: Any, path: Any, status: Status = Status.SUCCESS, message: str = "done") -> Solution:
    """Return the solution of a statement whose state at times (K,) is path(times), (2n, K)."""
    model = model_of(statement, NumpyMachine())
    span = (float(t[0]), float(t[-1])) if len(t) else (0.0, 0.0)
    trajectory = Trajectory(t, path(t), status, message, "exact", len(t) - 1, 3, 44, 0.0123, span, path)
    return Solution(trajectory, model, model.parameter_values())


def oscillator(times: Any = None, status: Status = Status.SUCCESS, message: str = "done", **more: Any) -> Solution:
    """Return the solution x = cos(2 t) with m = 1 and k = 4, by default over [0, 5]."""
    statement = declare(
        kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1, k: 4}, name="oscillator", **more
    )
    t = np.linspace(0.0, 5.0, 51) if times is None else np.asarray(times, dtype=float)
    return solved(statement, t, lambda t: np.array([np.cos(2 * t), -2 * np.sin(2 * t)]), status, message)


def moving(*parts: Any, **more: Any) -> Solution:
    """Return a solution over [0, 2] with a point p whose coordinates are functions of a = t and b = t^2, or numbers."""
    a, b = coordinates("a b")
    place = [part(a, b) if callable(part) else Float(part) for part in parts]
    statement = declare(kinetic=a.dot**2 + b.dot**2, positions={"p": place}, name="s", **more)
    return solved(statement, np.linspace(0, 2, 9), lambda t: np.array([t, t**2, np.ones_like(t), 2 * t]))


def free(count: int, **more: Any) -> Solution:
    """Return `count` free particles on lines, x1 to xn, at speeds 1 to n."""
    lines = [coordinate(f"x{i + 1}") for i in range(count)]
    statement = declare(kinetic=sum(q.dot**2 for q in lines) / 2, coordinates=lines, name="free", **more)
    speeds = np.arange(1.0, count + 1.0)
    return solved(
        statement,
        np.linspace(0.0, 1.0, 5),
        lambda t: np.concatenate([np.outer(speeds, t), np.repeat(speeds[:, None], len(t), axis=1)]),
    )
