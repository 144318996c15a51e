"""Constraints that are dependent at a state: there alone, or at all states around it that satisfy them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from lagrange.equations.first_order import RELATION
from lagrange.errors import StatementError, listing
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.singular import Singular, dependent_rows, least_regular
from lagrange.statement.statement import REFUSE
from lagrange.trajectory.constraints.projection import Projection
from lagrange.trajectory.constraints.residuals import residuals_of, units_of

AROUND = 1e-2
"""How far around a state others are tried, relative to the largest coordinate: rows that are dependent at one
configuration alone are then independent by about as much."""

SAMPLES = 4
"""States tried around one."""

DEPENDENT = 1e-8
"""Rows are dependent on the surface where their least singular value is below this part of the largest: a state is on
the surface up to 1e-12, and off it rows that are dependent on it differ by as much."""

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


def independent_rows(model: Model, t: float, states: FloatArray, parameters: FloatArray) -> tuple[int, ...] | None:
    """Return the most constraints that are independent at a state that satisfies all, sought from some (2n, k).

    None if no such state is found.
    """
    projection, best = Projection(model, t, parameters), None
    count = len(model.statement.constraints)
    for state in states.T:
        reached = projection.reached(state)
        if reached is not None:
            rows = _pivots(residuals_of(model).gradient(t, reached, parameters)[:count])
            best = rows if best is None or len(rows) > len(best) else best
    return best


def _pivots(rows: FloatArray) -> tuple[int, ...]:
    """Return rows that span all, each the longest beside those before, in units of its own length."""
    sizes = np.sqrt((rows**2).sum(axis=1))
    left, chosen = rows / np.where(sizes > 0, sizes, 1.0)[:, None], []
    for _ in range(len(rows)):
        lengths = np.sqrt((left**2).sum(axis=1))
        # The first of the longest, so that rounding does not choose.
        row = int(np.argmax(lengths > (1 - DEPENDENT) * lengths.max()))
        if lengths[row] <= DEPENDENT:
            break
        chosen.append(row)
        along = left[row] / lengths[row]
        left = left - np.outer(left @ along, along)
    return tuple(sorted(chosen))


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


def contradictory(model: Model, t: float, states: FloatArray, parameters: FloatArray) -> bool:
    """Return whether no state that satisfies the constraints is found from any of some states, (2n, k)."""
    projection = Projection(model, t, parameters)
    return all(projection.reached(state) is None for state in states.T)


def dependent_everywhere(names: tuple[str, ...], singular: Singular, *, allowed: bool = False) -> str:
    """Return the refusal of constraints that are dependent wherever they hold, those that are `allowed` to be too."""
    if any(names[i].startswith(RELATION) for i, _ in singular.rows):
        return (
            f"{dependent_rows(names, singular)} at every state tried. Add the kinetic energy that is missing, or use "
            "fewer coordinates."
        )
    involved = [repr(names[i]) for i, _ in singular.rows]
    if len(involved) == 1:
        return (
            f"{dependent_rows(names, singular)} wherever it holds: state it without the square, or leave it out if it "
            "holds always."
        )
    remedy = "state the system with redundant='allow', and they share their forces."
    if allowed:
        remedy = (
            "state the system with these parameters: which constraints are redundant is found with those it states."
        )
    return (
        f"{dependent_rows(names, singular)} here: where {listing(involved[:-1])} "
        f"{'holds' if len(involved) == 2 else 'hold'}, {involved[-1]} restricts no further. Drop one of them, or "
        f"{remedy}"
    )


def contradiction(names: tuple[str, ...], singular: Singular) -> str:
    """Return the refusal of dependent constraints that no state satisfies."""
    return (
        f"{dependent_rows(names, singular)} and contradict one another: no state was found that satisfies them "
        "together. Drop one of them, or correct it."
    )
