"""Estimates of the size of an entry of a state, if neither its value nor its derivative determines it.

An entry that is zero, and stays zero for many derivatives, has no size of its own: for example the far end of a chain
that is plucked at the other end. An entry that is round-off of cancelling terms has none to follow. Their sizes are
estimated from the entries that they are coupled to: the state is displaced by a small fraction of all sizes, and the
change of the derivative of an entry, over the natural period of the motion, is a size.

Entries and time may have any units. Only an entry with itself, or two rates, are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lagrange.equations.state_layout import StateLayout
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.calls import one_state
from lagrange.machine.kernel.rounding_noise import rounding_noise
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.procedure.step.constants import (
    DEFAULT_FIRST,
    LEAST_FLOOR,
    MOST_SURVEYS,
    SLOPE_NOISE,
    perturbation_factors,
)
from lagrange.trajectory.trajectory import FloatArray

DISPLACEMENT, WIDER = 2.0**-26, 2.0**8
"""Relative displacements of the state: the square root of the unit of round-off, and a multiple of it.

If both change a derivative equally it jumps, as where a contact ends; then the size of the jump is used.
"""

NEAR_REST = 2.0**-40
"""If the whole state is zero, sizes of this fraction of what forces reach in the remaining time are tried too."""

RATE_ITERATIONS = 3
"""Iterations of the estimate of the fastest rate.

Each applies the response twice: the largest factor by which an entry grows is the square of a rate.
"""

SETTLED = 8.0
"""The period is shortened if the size of a coupled entry would change by more than this factor in it."""

MOST_ROUNDS = 256
"""Most rounds in which sizes spread along a chain, two rounds per link."""

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

FORCE_SAMPLES = 64
"""Times along a run at which forces are evaluated before a solver of another package starts."""

NOISE_MULTIPLE = 4.0
"""Floors are this multiple of the rounding noise of an entry. With 16 a chain of ten links loses a digit at 1e-12."""

FIRST_LOOK, SLOW = 4096, 16.0
"""Tries of a run after which its floors are compared with rounding noise, and after each doubling of them.

They are compared only if the run would need more than `SLOW` times as many tries in all: noise costs 1 to 5 ms.
"""

Slopes = Callable[[float, FloatArray], FloatArray]


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
    if before:
        found = np.maximum(found, noise_floors(model, parameters, t, state.y, left))
    if before == MOST_SURVEYS - 1:
        found = np.maximum(found, _floors_of_others(layout, state.floors))
    state.floors[:] = np.maximum(state.floors, found)
    state.counts[DriverState.SURVEYED] += 1


def tries_to_next_look(tries: int) -> int:
    """Return the number of tries until floors are compared with rounding noise: at 4096, 8192, 16384 and so on."""
    look = FIRST_LOOK
    while look <= tries:
        look *= 2
    return look - tries


def raise_to_noise(model: Model, parameters: FloatArray, state: DriverState) -> bool:
    """Raise floors that are below rounding noise, and return whether one rose by more than a factor of two.

    Without it the steps of a chain at rest but for one link shrink to resolve the noise of the other links.
    """
    if not state.reals[DriverState.SHARE] > 0:
        return False
    left = float(state.reals[DriverState.END]) - state.t
    found = noise_floors(model, parameters, state.t, state.y, left)
    rises = bool((found > 2 * state.floors).any())
    state.floors[:] = np.maximum(state.floors, found)
    return rises


def noise_floors(model: Model, parameters: FloatArray, t: float, y: FloatArray, left: float) -> FloatArray:
    """Return a multiple of the rounding noise of each entry (2n,), 0 where it is not known.

    The noise of a velocity is that of its acceleration over the natural period of the motion; that of a coordinate is
    half of the same over the period once more. It is not known for systems with constraints, nor where the mass matrix
    is singular.
    """
    if model.equations.constraints:
        return np.zeros_like(y)
    layout = model.layout
    with np.errstate(all="ignore"):
        _, _, period = entry_sizes(slopes_of(model, parameters), layout, t, y, left, [(t, y)])
        noise = rounding_noise(model.interpreted("rhs").program, t, y, parameters)[layout.v]
        floors = NOISE_MULTIPLE * np.concatenate([noise * period * period / 2, noise * period])
    return np.nan_to_num(floors, posinf=0.0)


def _floors_of_others(layout: StateLayout, floors: FloatArray) -> FloatArray:
    """Return floors (2n,) for entries that are round-off of others of their kind, 0 for the rest.

    It is the last attempt for a run whose steps keep shrinking. For example 1 + tanh(u) is rounded to zero and its
    slope is not: no displacement shows that the effect of such a force is below its round-off.
    """
    kinds = np.concatenate([np.full(len(half), half.max(initial=0.0)) for half in layout.split(floors)])
    return np.where(floors < SLOPE_NOISE * kinds, kinds, 0.0)


def first_floors(
    slopes: Slopes, layout: StateLayout, t: float, y: FloatArray, left: float, share: float
) -> tuple[FloatArray, float]:
    """Return floors (2n,) for a solver that cannot ask for them, a share of the sizes, and the period."""
    force_points = [(t + left * k / FORCE_SAMPLES, y) for k in range(FORCE_SAMPLES + 1)]
    sizes, coupled, period = entry_sizes(slopes, layout, t, y, left, force_points)
    return np.maximum(np.maximum(share * sizes, SLOPE_NOISE * coupled), LEAST_FLOOR), period


def _within(step: float, left: float) -> float:
    """Return a step, bounded by the remaining time."""
    return step if abs(step) < abs(left) else left


def slopes_of(model: Model, parameters: FloatArray) -> Slopes:
    """Return the right-hand side, NaN where the mass matrix is singular."""
    try:
        law = one_state(model.kernel("rhs"), parameters)
    except SingularMassMatrix:
        return lambda t, y: np.full_like(y, np.nan)

    def slopes(t: float, y: FloatArray) -> FloatArray:
        try:
            return law(t, y)
        except SingularMassMatrix:
            return np.full_like(y, np.nan)

    return slopes


def entry_sizes(
    slopes: Slopes,
    layout: StateLayout,
    t: float,
    y: FloatArray,
    left: float,
    force_points: Sequence[tuple[float, FloatArray]],
) -> tuple[FloatArray, FloatArray, float]:
    """Return the sizes (2n,) of entries, their sizes by coupling over the natural period, and that period.

    `left` is the remaining time of the run, signed; `force_points` are times and states (2n,) at which forces are
    evaluated.
    """
    with np.errstate(all="ignore"):
        slope = slopes(t, y)
        response = _Response(lambda state: slopes(t, state), slope, y, layout)
        own = partial(_own_sizes, layout, y)
        forces = np.abs([slopes(*point)[layout.v] for point in force_points])
        ahead = np.max(forces, axis=0, initial=0.0, where=np.isfinite(forces))
        # An entry that moves has its size from its position: a force ahead may be that of a pole.
        force = np.where(layout.split(y)[1] == 0, ahead, np.nan_to_num(np.abs(slope[layout.v]), posinf=0.0))
        period = abs(left)
        noise = SLOPE_NOISE * response(own(np.zeros_like(force), period))[layout.v]
        force = np.where(force > noise, force, 0.0)
        rate = max(response.rate(part * own(force, period)) for part in ((1.0,) if y.any() else (1.0, NEAR_REST)))
        period = min(period, 1 / rate) if rate > 0 else period
        size, spread = own(force, period), np.zeros(len(y), dtype=bool)
        for _ in range(MOST_ROUNDS):
            coupled = period * response(size)
            fresh = (size <= SLOPE_NOISE * coupled) & (coupled > 0)
            change = float(np.max(coupled[spread] / size[spread], initial=0.0))
            if change > SETTLED:
                period = period / float(np.sqrt(change))
                size, spread = own(force, period), np.zeros(len(y), dtype=bool)
            elif fresh.any():
                size, spread = np.where(fresh, coupled, size), spread | fresh
            else:
                break
    q, v = layout.split(coupled)
    return size, np.concatenate([np.maximum(q, period * v), v]), period


def _own_sizes(layout: StateLayout, y: FloatArray, force: FloatArray, period: float) -> FloatArray:
    """Return the sizes (2n,) of entries by themselves: their values, and their changes in a period."""
    q, v = layout.split(np.abs(y))
    v = np.maximum(v, period * force)
    return np.concatenate([np.maximum(q, period * v), v])


class _Response:
    """The change of slopes under a displacement of the state, as a linear map."""

    def __init__(
        self, slopes: Callable[[FloatArray], FloatArray], slope: FloatArray, y: FloatArray, layout: StateLayout
    ) -> None:
        self._slopes, self._slope, self._y, self._layout = slopes, slope, y, layout
        self._factors, self._known, self._sizes = perturbation_factors(len(y)), y != 0, np.abs(y)

    def __call__(self, displacement: FloatArray) -> FloatArray:
        """Return the sizes of the changes (2n,) for a displacement (2n,), whatever its length."""
        far = displacement > 0
        if not far.any():
            return np.zeros_like(self._y)
        known = far & self._known
        shrunk = min(1.0, float((self._sizes[known] / displacement[known]).max())) if known.any() else 1.0
        part = DISPLACEMENT * shrunk
        near, wide = self._change(part, displacement), self._change(WIDER * part, displacement)
        found = np.where(16 * near > wide, wide, np.fmin(near / part, wide / (WIDER * part)))
        return np.where(np.isfinite(found), found, 0.0)

    def _change(self, part: float, displacement: FloatArray) -> FloatArray:
        moved = self._slopes(self._y + part * self._factors * displacement)
        return np.asarray(abs(moved - self._slope))

    def rate(self, displacement: FloatArray) -> float:
        """Return the fastest rate of the motion near the state, 0 if nothing responds to a displacement (2n,).

        Only entries with a displacement of their own count: the response of others is round-off at first.
        """
        known, found = displacement > 0, np.inf
        for _ in range(RATE_ITERATIONS):
            # A response is a displacement per time, which in slow units of time would be round-off.
            first = self(displacement)
            once = _ratio(first, displacement, known) or self._from_rest(first, displacement)
            then = self(first / once if once > 0 else first)
            twice = _ratio(then, displacement, known)
            found, displacement = min(found, once * twice), then / twice if twice > 0 else then
        return float(np.sqrt(found))

    def _from_rest(self, response: FloatArray, displacement: FloatArray) -> float:
        """Return the rate by which accelerations respond to a displacement of coordinates alone."""
        place, force = self._layout.split(displacement)[0], self._layout.split(response)[1]
        both = (place > 0) & np.isfinite(force)
        return float(np.sqrt(np.max(force[both] / place[both], initial=0.0)))


def _ratio(response: FloatArray, displacement: FloatArray, known: NDArray[np.bool_]) -> float:
    """Return the largest ratio of response to displacement, where the displacement is known."""
    both = known & (displacement > 0) & np.isfinite(response)
    return float((response[both] / displacement[both]).max(initial=0.0))
