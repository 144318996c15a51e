"""Constraints that are dependent at a state, either there only, or at all nearby states that satisfy them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from lagrange.equations.singular import DEPENDENT, Singular, dependent_everywhere, least_regular
from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.statement import REFUSE
from lagrange.trajectory.constraints.projection import Projection
from lagrange.trajectory.constraints.residuals import residuals_of, units_of

AROUND = 1e-2
"""Distance of the sample states from a state, relative to the largest coordinate. Rows that are dependent at a single
configuration are independent by about this much at the samples."""

NEARBY_SAMPLES = 4
"""Number of sample states around a state."""

CLEARLY = 1e-4
"""Constraint gradients are certainly independent if their least singular value exceeds this fraction of the largest. A
start that the user types is rounded to 1e-6, and then dependent rows differ by as much.
"""

VANISHING_RATIO = 1e-3
"""A constraint gradient vanishes if its size decreases to this fraction between the samples. The gradient of a squared
constraint decreases to 1e-6 / AROUND.
"""


def dependence_around(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> Singular | None:
    """Return the constraints that are dependent at a state (2n,) and at all nearby states that satisfy them, or None.

    Dependent constraints have linearly dependent rows of the gradient G.
    """
    projection, first = Projection(model, t, parameters), None
    units = units_of(projection.metric(y))
    random, (q, v) = np.random.default_rng(11), model.layout.split(y)
    size = AROUND * (np.abs(units * q).max(initial=0.0) or 1.0) / units
    tried = [y, *(np.concatenate([q + size * random.uniform(-1.0, 1.0, len(q)), v]) for _ in range(NEARBY_SAMPLES))]
    for state in tried:
        reached = projection.reached(state)
        if reached is None:
            continue
        # A state on the constraint surface is compared with a nearby state off it.
        off = tried[1] if state is y else state
        dependent = _vanishing(model, t, off, reached, parameters) or _rows(model, t, reached, parameters)
        if dependent is None:
            return None
        first = dependent if first is None else first
    return first


_INDEPENDENT: WeakKeyDictionary[Model, bytes] = WeakKeyDictionary()
"""For each model the parameters for which its constraints were last found independent, at a state that satisfies them.
With the same parameters they are not dependent everywhere on the surface. With other parameters they may be.
"""


def check_independent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> None:
    """Raise StatementError if constraints are dependent at a start and everywhere around it.

    Without this test, rounding may make their derivatives look independent, with multipliers of 1e16. Only the first
    start for each set of parameters is tested.
    """
    if model.statement.redundant != REFUSE or _INDEPENDENT.get(model) == parameters.tobytes():
        return
    if not _clearly_independent(model, t, y, parameters):
        refuse_dependent(model, t, y, parameters)
    _INDEPENDENT[model] = parameters.tobytes()


def _clearly_independent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> bool:
    """Return True if the rows of the gradient G are independent at a state, and not much smaller than at one nearby.

    This quick test takes 0.02 ms for a four-bar linkage. If it fails, `dependence_around` decides, in 0.8 ms.
    """
    q = model.layout.split(y)[0]
    beside = y.copy()
    beside[model.layout.q] += AROUND * (np.abs(q).max(initial=0.0) or 1.0) * np.cos(np.arange(len(q)))
    rows = residuals_of(model).gradient(t, y, parameters)
    around = residuals_of(model).gradient(t, beside, parameters)
    if not (np.isfinite(rows).all() and np.isfinite(around).all()):
        return False
    sizes = np.abs(rows).max(axis=1)
    if not (sizes > VANISHING_RATIO * np.abs(around).max(axis=1)).all():
        return False
    values = np.linalg.svd(rows / sizes[:, None], compute_uv=False)
    return len(rows) <= rows.shape[1] and bool(values[-1] > CLEARLY * values[0])


def refuse_dependent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> None:
    """Raise StatementError if constraints are dependent everywhere around a state that has no accelerations."""
    dependent = dependence_around(model, t, y, parameters)
    if dependent is not None:
        allowed = model.statement.redundant != REFUSE
        raise StatementError(dependent_everywhere(residuals_of(model).names, dependent, allowed=allowed))


def _rows(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> Singular | None:
    """Return the constraints whose rows of G are dependent at a state (2n,), or None if all are independent."""
    gradient = residuals_of(model).gradient(t, y, parameters)
    # Masses do not matter here, so the metric is the identity.
    dependent = least_regular(np.eye(gradient.shape[1]), gradient)
    return dependent if dependent is not None and dependent.rows and dependent.regularity <= DEPENDENT else None


def _vanishing(model: Model, t: float, off: FloatArray, on: FloatArray, parameters: FloatArray) -> Singular | None:
    """Return a constraint whose gradient is much smaller at `on`, a state on the constraints, than at `off`, or None.

    This happens for a squared constraint, such as x**2 = 0.
    """
    off_sizes, on_sizes = (np.abs(residuals_of(model).gradient(t, y, parameters)).max(axis=1) for y in (off, on))
    which = np.flatnonzero(on_sizes < VANISHING_RATIO * off_sizes)
    return Singular(0.0, rows=((int(which[0]), 1.0),)) if len(which) else None
