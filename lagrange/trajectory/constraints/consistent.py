"""`System.consistent`, the start of a run moved onto its constraints, and a warning for violations at its end."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from lagrange.errors import StatementError, listing, shown
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import ordered
from lagrange.statement.coordinate import name_of, velocity_of
from lagrange.statement.declare import initial_state, state_rows
from lagrange.statement.expression import entries, real_number
from lagrange.statement.rotation import Rotation, quaternion_rows
from lagrange.statement.space import SpaceMatrix
from lagrange.trajectory.constraints.projection import NEAREST_CORRECTIONS, Projection
from lagrange.trajectory.constraints.residuals import ON_SURFACE, residuals_of, units_of

LARGEST_VIOLATION = 1e-2
"""Largest violation of a constraint at the end of a reliable run, as a fraction of the constraint's terms. At default
tolerances the violation grows to 1e-9 to 1e-5 over a run. A step over a corner, or a reset, leaves a violation of 1e-1.
"""


@dataclass(frozen=True, eq=False)
class Consistent:
    """A state on the constraints, returned by `System.consistent`.

    `initial` has a value for every coordinate and velocity, as `run` takes it. `changes` maps every coordinate and
    velocity to its change from the requested state. `moved` is the size of the largest change, and `entry` the
    coordinate or velocity with this change, None without changes.
    """

    initial: Mapping[Any, float]
    moved: float
    entry: Any
    changes: Mapping[Any, float]

    def __repr__(self) -> str:
        values = ", ".join(f"{_label(symbol)} = {value:.6g}" for symbol, value in self.initial.items())
        how = "nothing moved" if self.entry is None else f"moved by at most {self.moved:.3g}, in {_label(self.entry)}"
        return f"<Consistent: {values}; {how}>"


def _label(symbol: Any) -> str:
    return f"{name_of(symbol.expr)}.dot" if symbol.is_Derivative else name_of(symbol)


def consistent(
    model: Model, initial: Mapping[Any, Any] | None, hold: Any, parameters: Mapping[Any, Any] | None, t: float
) -> Consistent:
    """Implement `System.consistent`: return the state on the constraints that is nearest to `initial`.

    The coordinates and velocities in the list `hold` keep their values. Coordinates move by the least amount, measured
    by the kinetic energy; then velocities do. Raises StatementError if no such state is found.
    """
    statement = model.statement
    time = real_number(t, "the time t")
    start = np.array(initial_state({} if initial is None else initial, statement.coordinates, statement.initial))
    values = ordered(model.parameter_values(parameters), statement.parameters)
    held, projected = _rows(hold, statement.coordinates), start
    if len(model.equations.constraints):
        projected = Projection(model, time, values, held).of(start)
    symbols, changes = (*statement.coordinates, *statement.velocities), projected - start
    row = int(np.argmax(np.abs(changes)))
    return Consistent(
        MappingProxyType(dict(zip(symbols, projected.tolist(), strict=True))),
        float(abs(changes[row])),
        symbols[row] if changes[row] else None,
        MappingProxyType(dict(zip(symbols, changes.tolist(), strict=True))),
    )


def _rows(hold: Any, coordinates: tuple[Any, ...]) -> list[int]:
    """Return the indices in the state (2n,) of the coordinates and velocities in the list `hold`."""
    rows, listed = state_rows(coordinates), entries(hold, "hold")
    names = [label for label in rows if isinstance(label, str)]
    if listed is None:
        raise StatementError(f"hold is {shown(hold)}: give a list of coordinates and velocities, such as [x, y.dot].")
    listed = [entry for key in listed for entry in _held(key, coordinates)]
    for key in listed:
        if not isinstance(key, Hashable) or key not in rows:
            raise StatementError(
                f"hold contains {shown(key)}, which is not a coordinate or velocity of this system: they are "
                f"{listing(names)}."
            )
    return [rows[key] for key in listed]


def _held(key: Any, coordinates: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the coordinates and velocities that determine an entry `key` of the user's list `hold`.

    `key` may be a rotation R, which its quaternion determines, or its rates R.body or R.space, which also depend on the
    velocities of the quaternion. For another key the result is (key,).
    """
    for each, _, _ in quaternion_rows(coordinates):
        if isinstance(key, Rotation) and key == each:
            return each.quaternion
        if isinstance(key, SpaceMatrix) and key in (each.body, each.space):
            return (*each.quaternion, *map(velocity_of, each.quaternion))
    return (key,)


def consistent_start(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return the state y (2n,) if it satisfies the constraints, or its projection if it misses them by rounding.

    Velocities of coordinates without inertia are computed if they are zero. For a state that misses the constraints by
    more than rounding, raises StatementError, which names the constraints.
    """
    if not len(model.equations.constraints) or residuals_of(model).are_zero(t, y, parameters):
        return y
    projection = Projection(model, t, parameters)
    y = projection.completed(y)
    projection.check(y)
    return projection.of(y) if projection.is_off(y) else y


def complete_start(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return the initial state y (2n,) of an exported system, moved onto the constraints if that is necessary.

    It is necessary if some coordinates have no inertia. Their equations are of first order, so their velocities follow
    from other entries. Such a velocity is computed if it is zero. For all other systems y is returned unchanged.
    """
    return consistent_start(model, t, y, parameters) if model.equations.first_order else y


def with_rates(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return the k states y (2n, k) with computed velocities of coordinates without inertia.

    The states are returned unchanged if the equations of motion do not use these velocities. The system must have no
    other constraints. Columns in which such velocities do not exist are NaN. Raises RunError if an equation determines
    no velocity.
    """
    if not model.equations.has_unsolved_rates:
        return y
    y, corrections, size = y.copy(), model.law("projection"), model.layout.size
    for _ in range(NEAREST_CORRECTIONS):
        corrected = model.called(corrections, t, y, parameters)
        off = corrected[size] > ON_SURFACE
        if not off.any():
            break
        y[:, off] += corrected[:size, off]
    y[:, ~(corrected[size] <= ON_SURFACE)] = np.nan
    return y


def violation(
    model: Model, t: float, y: FloatArray, parameters: FloatArray, duration: float, fastest: FloatArray
) -> str:
    """Return a warning if the last state y (2n,) of a run violates the constraints, else "".

    `duration` is the duration of the run, and `fastest` (n,) are its largest speeds.
    """
    residuals = residuals_of(model)
    corner = residuals.at_corner(t, y, parameters)
    if corner is not None:
        return (
            f"The run ends on a corner of the constraint {residuals.names[corner]!r}, where velocities jump in a way "
            "that is not stated: end it before by an event, or write the constraint smoothly."
        )
    name, share = residuals.worst(t, y, parameters)
    # All terms may be rounding errors, for example if a pendulum hangs straight down and spins.
    at = Projection(model, t, parameters)
    if share <= LARGEST_VIOLATION or at.share(y) <= LARGEST_VIOLATION:
        return ""
    units, q = units_of(at.metric(y)), y[model.layout.q]
    positions, rates = (residuals.of_part(part, t, y, parameters, units) for part in (0, 1))
    # At a turning point, as of a pendulum, velocities are errors of the run, and so are all terms that contain them.
    at_turn = np.abs(rates.values) <= LARGEST_VIOLATION * (np.abs(rates.gradient) @ fastest)
    if positions.largest <= LARGEST_VIOLATION and at_turn.all():
        return ""
    # Velocities of a structure that cannot move are rounding errors: in `duration` no coordinate moves noticeably.
    sizes = np.abs(rates.gradient) @ (np.abs(units * q).max(initial=0.0) / units)
    if positions.largest <= ON_SURFACE and (np.abs(rates.values) * duration <= ON_SURFACE * sizes).all():
        return ""
    return (
        f"The state at the end violates the constraint {name!r} by {share:.2g} of its terms: the run does not follow "
        "the motion. Look for a corner of the constraint, or take smaller steps or tolerances."
    )


def moved_sentence(model: Model, before: FloatArray, after: FloatArray) -> str:
    """Return a note if the initial state `before` (2n,) was moved onto the constraints, to `after`, else ""."""
    entered = np.array(model.equations.following, dtype=int)
    changes = np.abs(after - before)
    changes[entered[before[entered] == 0.0]] = 0.0
    row = int(np.argmax(changes))
    if not changes[row]:
        return ""
    return (
        f" The initial state was moved onto the constraints, by at most {changes[row]:.2g}, in "
        f"{model.layout.names('.dot')[row]}."
    )
