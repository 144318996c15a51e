"""Constraints that are dependent at a state: there alone, or at all states around it that satisfy them."""

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
"""How far around a state others are tried, relative to the largest coordinate: rows that are dependent at one
configuration alone are then independent by about as much."""

SAMPLES = 4
"""States tried around one."""

CLEARLY = 1e-4
"""Rows whose least singular value is above this part of the largest are independent beyond doubt: rounding of a start
that was typed, 1e-6 of it, leaves dependent rows that are as much apart."""

VANISHING = 1e-3
"""A row that shrinks to this part of itself over so short a way vanishes: of a square 1e-6 / AROUND are left."""


def dependence_around(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> Singular | None:
    """Return the rows that are dependent at a state and at all states on the constraints around it, or None."""
    projection, first = Projection(model, t, parameters), None
    units = units_of(projection.metric(y))
    random, (q, v) = np.random.default_rng(11), model.layout.split(y)
    size = AROUND * (np.abs(units * q).max(initial=0.0) or 1.0) / units
    tried = [y, *(np.concatenate([q + size * random.uniform(-1.0, 1.0, len(q)), v]) for _ in range(SAMPLES))]
    for state in tried:
        reached = projection.reached(state)
        if reached is None:
            continue
        # A state on the surface is compared with one beside it.
        off = tried[1] if state is y else state
        found = _vanishing(model, t, off, reached, parameters) or _rows(model, t, reached, parameters)
        if found is None:
            return None
        first = found if first is None else first
    return first


_INDEPENDENT: WeakKeyDictionary[Model, bytes] = WeakKeyDictionary()
"""The parameters with which the constraints of a model were last found independent at a state that satisfies them.

With the same parameters they are not dependent wherever they hold; with others they may be.
"""


def check_independent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> None:
    """Raise StatementError if constraints are dependent at a start, and all around it.

    There rounding may leave them derivatives that look independent, and multipliers of 1e16. One start is looked at
    for each change of the parameters.
    """
    if model.statement.redundant != REFUSE or _INDEPENDENT.get(model) == parameters.tobytes():
        return
    if not _clearly_independent(model, t, y, parameters):
        refuse_dependent(model, t, y, parameters)
    _INDEPENDENT[model] = parameters.tobytes()


def _clearly_independent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> bool:
    """Return whether the rows of G are independent at a state, and not much smaller than beside it.

    It takes 0.02 ms for a four-bar linkage, where `dependence_around` takes 0.8 ms, and leaves doubtful states to it.
    """
    q = model.layout.split(y)[0]
    beside = y.copy()
    beside[model.layout.q] += AROUND * (np.abs(q).max(initial=0.0) or 1.0) * np.cos(np.arange(len(q)))
    rows = residuals_of(model).gradient(t, y, parameters)
    around = residuals_of(model).gradient(t, beside, parameters)
    if not (np.isfinite(rows).all() and np.isfinite(around).all()):
        return False
    sizes = np.abs(rows).max(axis=1)
    if not (sizes > VANISHING * np.abs(around).max(axis=1)).all():
        return False
    values = np.linalg.svd(rows / sizes[:, None], compute_uv=False)
    return len(rows) <= rows.shape[1] and bool(values[-1] > CLEARLY * values[0])


def refuse_dependent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> None:
    """Raise StatementError if constraints are dependent at a state without accelerations, and all around it."""
    found = dependence_around(model, t, y, parameters)
    if found is not None:
        allowed = model.statement.redundant != REFUSE
        raise StatementError(dependent_everywhere(residuals_of(model).names, found, allowed=allowed))


def _rows(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> Singular | None:
    """Return the dependent rows of G at a state, or None if they are independent."""
    gradient = residuals_of(model).gradient(t, y, parameters)
    # Independent of the masses: only the rows count.
    found = least_regular(np.eye(gradient.shape[1]), gradient)
    return found if found is not None and found.rows and found.regularity <= DEPENDENT else None


def _vanishing(model: Model, t: float, off: FloatArray, on: FloatArray, parameters: FloatArray) -> Singular | None:
    """Return a row that is much smaller on the surface than off it, as that of a square is, or None."""
    before, here = (np.abs(residuals_of(model).gradient(t, y, parameters)).max(axis=1) for y in (off, on))
    which = np.flatnonzero(here < VANISHING * before)
    return Singular(0.0, rows=((int(which[0]), 1.0),)) if len(which) else None
