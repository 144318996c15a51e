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
from lagrange.machine.model import Model
from lagrange.procedure.step.constants import (
    LEAST_FLOOR,
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

FORCE_SAMPLES = 64
"""Times along a run at which forces are evaluated before a solver of another package starts."""

Slopes = Callable[[float, FloatArray], FloatArray]


def first_floors(
    slopes: Slopes, layout: StateLayout, t: float, y: FloatArray, left: float, share: float
) -> tuple[FloatArray, float]:
    """Return floors (2n,) for a solver that cannot ask for them, a share of the sizes, and the period."""
    force_points = [(t + left * k / FORCE_SAMPLES, y) for k in range(FORCE_SAMPLES + 1)]
    sizes, coupled, period = entry_sizes(slopes, layout, t, y, left, force_points)
    return np.maximum(np.maximum(share * sizes, SLOPE_NOISE * coupled), LEAST_FLOOR), period


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
