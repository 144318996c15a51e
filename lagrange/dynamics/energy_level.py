"""States of a given energy: one velocity follows from the other entries, where that energy is possible."""

from __future__ import annotations

import numpy as np

from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t as time_symbol
from lagrange.statement.event import Event

ENERGY_CORRECTIONS = 30
"""Steps of Newton's method after the roots of a quadratic energy. One removes rounding errors; the others are for
energies that are not quadratic in the velocity, such as that of a relativistic particle."""

PROBES = (1.0, 1e-3, 1e-6)
"""Velocities at which the coefficients of a quadratic energy are computed. The first one is used at which the energy
has a value."""

ENERGY_ERROR = 1e-10
"""Largest accepted error of the energy, relative to its size and that of its terms."""


def margin(model: Model, parameters: FloatArray, states: FloatArray, row: int, energy: float) -> FloatArray:
    """Return a function of states (2n, k), positive where some velocity of the row gives the energy, (k,).

    For an energy a v^2 + b v + c it is the discriminant b^2 - 4 a (c - energy).
    """
    a, b, c = _quadratic(model, parameters, states, row)
    return np.asarray(b * b - 4 * a * (c - energy))


def _quadratic(
    model: Model, parameters: FloatArray, states: FloatArray, row: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a, b and c of the energy a v^2 + b v + c at states (2n, k), NaN where the energy has no value."""
    middle = _energy(model, parameters, states, row, 0.0)
    a = b = np.full_like(middle, np.nan)
    for probe in PROBES:
        below, above = (_energy(model, parameters, states, row, v) for v in (-probe, probe))
        with np.errstate(invalid="ignore"):
            a, b = ((above + below) / 2 - middle) / probe**2, (above - below) / 2 / probe
        if np.isfinite(a).all():
            break
    return a, b, middle


def _energy(model: Model, parameters: FloatArray, states: FloatArray, row: int, v: float | FloatArray) -> FloatArray:
    given = states.copy()
    given[row] = v
    q, rates = model.layout.split(given)
    return np.asarray(model.energy(q, rates, 0.0, parameters))


def on_level(
    model: Model, parameters: FloatArray, starts: FloatArray, row: int, energy: float, event: Event | None
) -> FloatArray:
    """Return starts (m, 2n) in which the velocity of a row is replaced, so that all have the energy.

    Of the two solutions it is the one that crosses the event in its direction, else the larger one. Raises
    StatementError for a start whose other entries already have more energy.
    """
    states = np.ascontiguousarray(starts.T)
    a, b, c = _quadratic(model, parameters, states, row)
    square = np.asarray(b * b - 4 * a * (c - energy))
    scale = b * b + np.abs(4 * a * (np.abs(c) + abs(energy)))
    square = np.where(np.abs(square) <= 1e-15 * scale, 0.0, square)
    outside = ~((a != 0) & (square >= 0))
    if outside.any():
        raise StatementError(_out_of_reach(model, starts, row, energy, int(np.argmax(outside)), c))
    roots = [(-b + side * np.sqrt(square)) / (2 * a) for side in (1.0, -1.0)]
    found = [_corrected(model, parameters, states, row, energy, root) for root in roots]
    larger = np.where((found[0][row] >= found[1][row]), found[0], found[1])
    smaller = np.where((found[0][row] >= found[1][row]), found[1], found[0])
    if event is None or not event.direction:
        return np.ascontiguousarray(larger.T)
    rates = [_rate(model, parameters, event, one) * event.direction for one in (larger, smaller)]
    return np.ascontiguousarray(np.where((rates[0] > 0) | (rates[1] <= 0), larger, smaller).T)


def _corrected(
    model: Model, parameters: FloatArray, states: FloatArray, row: int, energy: float, root: FloatArray
) -> FloatArray:
    """Return states (2n, m) with a velocity near `root` of the energy."""
    v = root
    for _ in range(ENERGY_CORRECTIONS):
        step = 1e-6 * np.abs(v) + 1e-9
        left = _energy(model, parameters, states, row, v) - energy
        with np.errstate(all="ignore"):
            ahead, behind = (_energy(model, parameters, states, row, v + side * step) for side in (1.0, -1.0))
            moved = v - left * 2 * step / (ahead - behind)
            # At smaller velocities the energy may have a value again.
            v = np.where(np.isfinite(left), np.where(np.isfinite(moved) & (left != 0), moved, v), v / 2)
    left = np.abs(_energy(model, parameters, states, row, v) - energy)
    size = abs(energy) + np.abs(_energy(model, parameters, states, row, 0.0))
    if not (left <= ENERGY_ERROR * size).all():
        name, place = model.statement.state_names[row], int(np.argmax(~(left <= ENERGY_ERROR * size)))
        raise StatementError(
            f"no {name} was found with which start {place} has the energy {energy:g}: give {name} in starts, and leave "
            "energy and solve_for out."
        )
    found = states.copy()
    found[row] = v
    return found


def _rate(model: Model, parameters: FloatArray, event: Event, states: FloatArray) -> FloatArray:
    return model.evaluate_expression(event.expression.diff(time_symbol), np.zeros(states.shape[1]), states, parameters)


def _out_of_reach(model: Model, starts: FloatArray, row: int, energy: float, place: int, rest: FloatArray) -> str:
    names = model.statement.state_names
    others = ", ".join(
        f"{name} = {x:g}" for k, (name, x) in enumerate(zip(names, starts[place], strict=True)) if k != row
    )
    return (
        f"start {place} with {others} has the energy {rest[place]:g} without {names[row]}, and energy = {energy:g} "
        f"leaves no {names[row]} for it: give a start nearer to rest, or a larger energy."
    )
