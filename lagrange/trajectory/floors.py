"""The floors of the tolerances, raised between two calls of a driver: at its request, or because a run is slow."""

from __future__ import annotations

import math

import numpy as np

from lagrange.equations.state_layout import StateLayout
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.procedure.step.constants import DEFAULT_FIRST, LEAST_FLOOR, MOST_SURVEYS, SLOPE_NOISE
from lagrange.trajectory.noise import noise_floors
from lagrange.trajectory.sizes import entry_sizes, slopes_of
from lagrange.trajectory.trajectory import FloatArray

FORCE_STEPS = (0.0, 1.0, 4.0, 16.0, 64.0)
"""Steps ahead at which forces are evaluated: a system at rest may have only forces that depend on time.

From one survey of a run to the next these times are multiplied by the last number.
"""

DRIFT_STEPS, DRIFT_GROWTH = (1.0, 4.0), 8.0
"""Steps ahead at which forces are evaluated on the free motion of the state.

A rejected step that met something at rest was one to five times as long as the next. From one survey to the next these
times are multiplied by the second number.
"""

REST_HALVINGS = 52
"""At rest, forces are also evaluated at the remaining time, its half, its quarter and so on."""


def survey(model: Model, parameters: FloatArray, state: DriverState) -> None:
    """Raise the floors of a run that returned as UNSCALED; see `Outcome`."""
    reals, before = state.reals, state.count(DriverState.SURVEYED)
    t, left, share = state.t, float(reals[DriverState.END]) - state.t, float(reals[DriverState.SHARE])
    h = float(reals[DriverState.H]) or DEFAULT_FIRST * left
    reach, drift = h * FORCE_STEPS[-1] ** before, h * DRIFT_GROWTH**before
    law, layout = slopes_of(model, parameters), model.layout
    slope = law(t, state.y)
    times = [t + _within(part * reach, left) for part in FORCE_STEPS]
    if not state.y.any():
        times += [t + left * 2.0**-k for k in range(REST_HALVINGS)]
    force_points = [(when, state.y) for when in times]
    # An entry at rest may be pushed by one that reaches it in the step.
    force_points += [(t + part * drift, state.y + part * drift * slope) for part in DRIFT_STEPS]
    sizes, coupled, _ = entry_sizes(law, layout, t, state.y, left, force_points)
    unknown = state.floors <= np.maximum(LEAST_FLOOR, share * SLOPE_NOISE * np.maximum(coupled, sizes))
    found = np.maximum(np.where(unknown, share * sizes, 0.0), SLOPE_NOISE * coupled)
    noise = noise_floors(model, parameters, t, state.y, left)
    if not state.count(DriverState.STEPS) and (noise > np.maximum(state.floors, found)).any():
        # The first step was chosen by entries that are rounding: it is chosen anew.
        reals[DriverState.H] = 0.0
    found = np.maximum(found, noise)
    if before == MOST_SURVEYS - 1:
        found = np.maximum(found, _floors_of_others(layout, state.floors))
    if (found > state.floors).any():
        # A series knows the length of its next step: that of a rejected one came of floors that were too low.
        state.taylor.limit = math.inf
    state.floors[:] = np.maximum(state.floors, found)
    state.counts[DriverState.SURVEYED] += 1


def raise_to_noise(model: Model, parameters: FloatArray, state: DriverState) -> bool:
    """Raise floors that are below rounding noise, and return whether one rose by more than a factor of two.

    Without it the steps of a chain with one moving link shrink to resolve the noise of the other links.
    """
    if not state.reals[DriverState.SHARE] > 0:
        return False
    left = float(state.reals[DriverState.END]) - state.t
    found = noise_floors(model, parameters, state.t, state.y, left)
    rises = bool((found > 2 * state.floors).any())
    state.floors[:] = np.maximum(state.floors, found)
    return rises


def _floors_of_others(layout: StateLayout, floors: FloatArray) -> FloatArray:
    """Return floors (2n,) for entries that are round-off of others of their kind, 0 for the rest.

    It is the last attempt for a run whose steps keep shrinking. For example 1 + tanh(u) is rounded to zero and its
    slope is not: no displacement shows that the effect of such a force is below its round-off.
    """
    kinds = np.concatenate([np.full(len(half), half.max(initial=0.0)) for half in layout.split(floors)])
    return np.where(floors < SLOPE_NOISE * kinds, kinds, 0.0)


def _within(step: float, left: float) -> float:
    """Return a step, bounded by the remaining time."""
    return step if abs(step) < abs(left) else left
