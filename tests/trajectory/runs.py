"""Runs for the tests of this folder, and methods with equal steps."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from lagrange.machine.model import Model
from lagrange.trajectory.integrator import Problem, RunOptions
from lagrange.trajectory.methods.explicit import DOP853, RungeKutta
from lagrange.trajectory.methods.implicit import ImplicitMethod
from lagrange.trajectory.methods.registry import BUILT_IN, find
from lagrange.trajectory.methods.splitting import Splitting
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.plan import Plan, Planned
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Trajectory

NAMES = tuple(BUILT_IN)
FIXED = tuple(name for name in NAMES if not find(name).claims.adaptive)
ADAPTIVE = tuple(name for name in NAMES if find(name).claims.adaptive)
IMPLICIT = tuple(name for name in NAMES if isinstance(find(name), ImplicitMethod))
"""The methods that solve for their slopes."""
STEPPED = tuple(name for name in NAMES if not isinstance(find(name), Taylor | ImplicitMethod))
"""The methods that are explicit step programs: a series has no tableau, no fixed order, and no equal steps."""
OUTSIDE = (
    *(f"scipy-{name}" for name in ("rk23", "rk45", "dop853", "radau", "bdf", "lsoda")),
    *(["cvode"] if find_spec("sksundae") else []),
)
"""Solvers of other packages, as far as they are here."""
SPLITTINGS = tuple(name for name in NAMES if isinstance(find(name), Splitting))
EQUAL = tuple(name for name in IMPLICIT if name in FIXED)
"""Implicit methods with equal steps; of those below, the ones that solve for momenta and for slopes."""
CONTROLLED = tuple(name for name in IMPLICIT if name in ADAPTIVE)


def implicit(name: str) -> ImplicitMethod:
    """Return the implicit method with a name."""
    result = find(name)
    assert isinstance(result, ImplicitMethod)
    return result


CONSTRAINED = tuple(name for name in IMPLICIT if implicit(name).law == "constrained")
"""The methods whose unknowns are multipliers as well."""
MOMENTA = tuple(name for name in EQUAL if implicit(name).law in ("momentum", "constrained"))
SLOPES = tuple(name for name in EQUAL if name not in MOMENTA)
UNCONSTRAINED = tuple(name for name in MOMENTA if name not in CONSTRAINED)
"""The methods of momenta that leave out the forces of constraints."""


def run(model: Model, end: float, method: Any, start: float = 0.0, initial: Any = None, **options: Any) -> Trajectory:
    """Return the trajectory from `start` to `end`."""
    progress = options.pop("progress", None)
    return trajectory_of(model, (start, end), initial, RunOptions(method, **options), progress=progress)[0]


def same(a: Trajectory, b: Trajectory) -> bool:
    """Return True if two runs are equal to the last bit, except for the time that they took."""
    said = [
        (item.status, item.message, item.steps, item.rejected, item.evaluations, item.span, item.form)
        for item in (a, b)
    ]
    return said[0] == said[1] and np.array_equal(a.t, b.t) and np.array_equal(a.y, b.y)


def stepped(name: str, step: float) -> Any:
    """Return a method with equal steps; an adaptive method loses its step control."""
    method = find(name)
    if isinstance(method, RungeKutta):
        return RungeKutta(replace(method.tableau, error=None), step=step)
    splitting: Any = method
    return replace(splitting, step=step)


def exact(model: Model, end: float, start: float = 0.0, initial: Any = None, **options: Any) -> Trajectory:
    """Return a run by DOP853 with errors near round-off."""
    return run(model, end, DOP853(rtol=3e-14, atol=1e-16), start, initial, **options)


def planned(name: str, problem: Problem) -> Plan:
    """Return the plan that a method prepares for a run."""
    method = find(name)
    assert isinstance(method, Planned)
    return method.plan(problem)
