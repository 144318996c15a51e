"""Estimate the sizes and the rounding noise of a state's entries, from which absolute tolerances (floors) follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import (
    DEFAULT_FIRST,
    LEAST_FLOOR,
    MOST_SURVEYS,
    SLOPE_NOISE,
    SMALL_FLOOR,
    perturbation_factors,
)
from lagrange.equations.euler_lagrange import StateLayout
from lagrange.machine.backend import FloatArray, SingularMassMatrix, one_state
from lagrange.machine.kernel.interpreted import UNIT, rounding_noise
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState

DISPLACEMENT, WIDER = 2.0**-26, 2.0**8
"""Relative displacements of the state: the square root of the unit of rounding, and a multiple of this. If both change
a derivative equally, the derivative jumps, as at the end of a contact. The size of the jump is then used."""

NEAR_REST = 2.0**-40
"""If the whole state is zero, the fastest rate is also estimated for a small motion: this fraction of the motion that
the forces cause in the remaining time."""

RATE_ITERATIONS = 3
"""Number of iterations of the estimate of the fastest rate. Each iteration applies the linearized equations twice. The
largest factor by which an entry of the displacement then grows is the square of a rate."""

SETTLED = 8.0
"""Largest change of an entry of the state by other entries during the estimated natural period, relative to the size of
the entry. If a change is larger, the period is shortened."""

MOST_ROUNDS = 256
"""Largest number of rounds of the estimate of sizes. In each round an entry without a size gets one from a neighbour. A
link of a chain takes two rounds."""

FORCE_SAMPLES = 64
"""Number of times along a run at which forces are evaluated before a solver of another package starts."""

Slopes = Callable[[float, FloatArray], FloatArray]


def first_floors(
    slopes: Slopes, layout: StateLayout, t: float, y: FloatArray, left: float, share: float
) -> tuple[FloatArray, float]:
    """Return the least absolute tolerances (2n,) for a solver of another package, and the natural period of the motion.

    The least absolute tolerance (floor) of an entry is at least `share` times the size of the entry. `slopes` is the
    right-hand side f(t, y), and `layout` the layout of the state. `left` is the signed time from t to the end of the
    run.
    """
    force_points = [(t + left * k / FORCE_SAMPLES, y) for k in range(FORCE_SAMPLES + 1)]
    sizes, coupled, period = entry_sizes(slopes, layout, t, y, left, force_points)
    return np.maximum(np.maximum(share * sizes, SLOPE_NOISE * coupled), LEAST_FLOOR), period


def slopes_of(model: Model, parameters: FloatArray) -> Slopes:
    """Return the right-hand side of a model as a function f(t, y). It returns NaN if the mass matrix is singular."""
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
    """Return the sizes (2n,) of a state's entries, their changes (2n,) due to other entries, and a natural period.

    The changes are the changes during this period. `slopes` is the right-hand side f(t, y). `left` is the signed time
    from t to the end of the run. The forces are evaluated at `force_points`, pairs of a time and a state (2n,).
    """
    known_q, known_v = layout.split(np.abs(y))

    def own_sizes(force: FloatArray, period: float) -> FloatArray:
        # The size of a velocity is its value, or its change during the period if that is larger; a coordinate likewise.
        v = np.maximum(known_v, period * force)
        return np.concatenate([np.maximum(known_q, period * v), v])

    with np.errstate(all="ignore"):
        slope = slopes(t, y)
        response = _Response(lambda state: slopes(t, state), slope, y, layout)
        forces = np.abs([slopes(*point)[layout.v] for point in force_points])
        ahead = np.max(forces, axis=0, initial=0.0, where=np.isfinite(forces))
        # For an entry that moves, only the present force counts: near a pole forces ahead may be arbitrarily large.
        force = np.where(layout.split(y)[1] == 0, ahead, np.nan_to_num(np.abs(slope[layout.v]), posinf=0.0))
        period = abs(left)
        noise = SLOPE_NOISE * response(own_sizes(np.zeros_like(force), period))[layout.v]
        force = np.where(force > noise, force, 0.0)
        rate = max(response.rate(part * own_sizes(force, period)) for part in ((1.0,) if y.any() else (1.0, NEAR_REST)))
        period = min(period, 1 / rate) if rate > 0 else period
        size, spread = own_sizes(force, period), np.zeros(len(y), dtype=bool)
        for _ in range(MOST_ROUNDS):
            coupled = period * response(size)
            fresh = (size <= SLOPE_NOISE * coupled) & (coupled > 0)
            change = float(np.max(coupled[spread] / size[spread], initial=0.0))
            if change > SETTLED:
                period = period / float(np.sqrt(change))
                size, spread = own_sizes(force, period), np.zeros(len(y), dtype=bool)
            elif fresh.any():
                size, spread = np.where(fresh, coupled, size), spread | fresh
            else:
                break
    q, v = layout.split(coupled)
    return size, np.concatenate([np.maximum(q, period * v), v]), period


class _Response:
    """Estimates the change of the right-hand side that a displacement of the state causes, as a linear map."""

    def __init__(
        self, slopes: Callable[[FloatArray], FloatArray], slope: FloatArray, y: FloatArray, layout: StateLayout
    ) -> None:
        self._slopes, self._slope, self._y, self._layout = slopes, slope, y, layout
        self._factors, self._known, self._sizes = perturbation_factors(len(y)), y != 0, np.abs(y)

    def __call__(self, displacement: FloatArray) -> FloatArray:
        """Return the absolute changes (2n,) of the right-hand side due to a displacement (2n,) of any length."""
        far = displacement > 0
        if not far.any():
            return np.zeros_like(self._y)
        is_known = far & self._known
        shrunk = min(1.0, float((self._sizes[is_known] / displacement[is_known]).max())) if is_known.any() else 1.0
        part = DISPLACEMENT * shrunk
        near, wide = self._change(part, displacement), self._change(WIDER * part, displacement)
        sizes = np.where(16 * near > wide, wide, np.fmin(near / part, wide / (WIDER * part)))
        return np.where(np.isfinite(sizes), sizes, 0.0)

    def _change(self, part: float, displacement: FloatArray) -> FloatArray:
        moved = self._slopes(self._y + part * self._factors * displacement)
        return np.asarray(abs(moved - self._slope))

    def rate(self, displacement: FloatArray) -> float:
        """Return the fastest rate of the motion near the state, in 1/time. It is 0 if no derivative changes.

        The rate follows from repeated displacements, which begin with `displacement` (2n,). Only derivatives of
        displaced entries count, since at first the changes of other derivatives may be rounding.
        """
        displaced, fastest = displacement > 0, np.inf
        for _ in range(RATE_ITERATIONS):
            # A response is a displacement per time. It is divided by the rate, so that units of time do not matter.
            first = self(displacement)
            once = _ratio(first, displacement, displaced)
            if not once:
                # At rest: the largest sqrt(change of acceleration / displacement) of the displaced coordinates.
                position, force = self._layout.split(displacement)[0], self._layout.split(first)[1]
                both = (position > 0) & np.isfinite(force)
                once = float(np.sqrt(np.max(force[both] / position[both], initial=0.0)))
            then = self(first / once if once > 0 else first)
            twice = _ratio(then, displacement, displaced)
            fastest, displacement = min(fastest, once * twice), then / twice if twice > 0 else then
        return float(np.sqrt(fastest))


def _ratio(response: FloatArray, displacement: FloatArray, mask: NDArray[np.bool_]) -> float:
    """Return the largest ratio of `response` to `displacement`, both (2n,), over the entries in `mask`."""
    both = mask & (displacement > 0) & np.isfinite(response)
    return float((response[both] / displacement[both]).max(initial=0.0))


NOISE_MULTIPLE = 4.0
"""Floors are this multiple of the rounding noise of an entry. With 16 a chain of ten links loses a digit at 1e-12."""

TINY_NOISE = 1e-300
"""Added to the noise of an acceleration, which may be zero."""

VISIBLE = 2.0**8, 2.0**24, 2.0**40
"""Change of an acceleration by a displacement, in multiples of the acceleration's noise: the smallest, the desired, and
the largest change. A smaller change has no correct digits. A larger change may not be linear, unless a shorter
displacement gives the same derivative."""

MOST_DISPLACEMENTS = 8
"""Largest number of displacements of one entry that are tried for its derivatives, which are zero if none is suitable.
"""

NOISE_AHEAD, EULER_STEPS = 1 / 8, 2
"""Length and number of the Euler steps to a later state at which the rounding noise of accelerations is also evaluated.
The length is in units of the natural time of the motion. Terms that are zero at the start, as of a chain that hangs at
rest, have noise as soon as it moves."""


def some_rounded(layout: StateLayout, floors: FloatArray) -> bool:
    """Return True if an entry of the state may be only the rounding error of other entries.

    Its floor (least absolute tolerance) is then far below the largest floor of its kind, coordinates or velocities.
    `floors` is (2n,).
    """
    return any(bool(half.min(initial=np.inf) < SMALL_FLOOR * half.max(initial=0.0)) for half in layout.split(floors))


def noise_floors(model: Model, parameters: FloatArray, t: float, y: FloatArray, left: float) -> FloatArray:
    """Return `NOISE_MULTIPLE` times the rounding noise of each entry (2n,), or 0 if the mass matrix is singular.

    The noise of a velocity is the noise of its acceleration times the natural time of the motion, which is at most the
    remaining time `left`. The noise of a coordinate is the noise of its acceleration times half of this time squared.
    """
    layout, law = model.layout, slopes_of(model, parameters)
    with np.errstate(all="ignore"):
        noise = _noise(model, parameters, t, y)
        rate = _fastest_rate(law, layout, t, y, noise)
        time = min(abs(left), 1 / rate) if rate > 0 else abs(left)
        step, ahead = math.copysign(NOISE_AHEAD * time, left), y
        for _ in range(EULER_STEPS if rate > 0 else 0):
            ahead = ahead + step * law(t, ahead)
        noise = np.fmax(noise, _noise(model, parameters, t, ahead))
        floors = NOISE_MULTIPLE * np.concatenate([noise * time * time / 2, noise * time])
    return np.nan_to_num(floors, posinf=0.0)


def _noise(model: Model, parameters: FloatArray, t: float, y: FloatArray) -> FloatArray:
    """Return the rounding noise of accelerations (n,) at a state (2n,)."""
    return rounding_noise(model.interpreted("rhs").program, t, y, parameters)[model.layout.v]


def _fastest_rate(slopes: Slopes, layout: StateLayout, t: float, y: FloatArray, noise: FloatArray) -> float:
    """Return the largest rate of the equations linearized at a state (2n,), in 1/time.

    It is the spectral radius of the derivatives of accelerations by velocities, or the square root of that by
    coordinates if this is larger. It does not depend on the units of the entries. It is 0 if no acceleration changes
    with the state by more than `noise` (n,), the noise of the accelerations. `slopes` is the right-hand side f(t, y),
    and `layout` the layout of the state.
    """

    def accelerations(state: FloatArray) -> FloatArray:
        return slopes(t, state)[layout.v]

    force = accelerations(y)
    columns = np.array([_derivatives(accelerations, y, j, force, noise) for j in range(len(y))]).T
    stiffness, damping = (_spectral_radius(part) for part in (columns[:, layout.q], columns[:, layout.v]))
    return max(math.sqrt(stiffness), damping)


def _derivatives(
    accelerations: Callable[[FloatArray], FloatArray], y: FloatArray, j: int, force: FloatArray, noise: FloatArray
) -> FloatArray:
    """Return the derivatives (n,) of accelerations by entry j of the state y (2n,), from finite differences.

    `force` (n,) are the accelerations at y. A derivative is 0 if no displacement changes the acceleration by more than
    its rounding noise, `noise` (n,).
    """
    least, aim, most = VISIBLE
    step, before = abs(float(y[j])) * 2.0**-26 or 2.0**-26, np.full_like(force, np.inf)
    for _ in range(MOST_DISPLACEMENTS):
        moved = y.copy()
        moved[j] += step
        displaced = accelerations(moved)
        change, doubt = abs(displaced - force), noise + UNIT * abs(displaced) + TINY_NOISE
        ratio = float(np.max(change / doubt))
        derivatives = np.where(change > least * doubt, change / step, 0.0)
        linear = ratio <= most or float(abs(derivatives - before).max()) <= float(derivatives.max()) / 2
        if ratio >= least and linear:
            return derivatives
        before = derivatives
        step *= aim if ratio < 1 else aim / ratio if ratio < math.inf else 1 / aim
    return np.zeros_like(force)


def _spectral_radius(matrix: FloatArray) -> float:
    """Return the largest absolute eigenvalue of a matrix (n, n), or 0 if it has entries that are not finite."""
    if not matrix.any() or not np.isfinite(matrix).all():
        return 0.0
    return float(abs(np.linalg.eigvals(matrix)).max())


FORCE_STEPS = (0.0, 1.0, 4.0, 16.0, 64.0)
"""Later times at which forces are evaluated at the present state, because forces on a system at rest may depend on time
alone. They count from the present time, in units of the next step. In each further estimate of sizes they are
multiplied by the last number."""

DRIFT_STEPS, DRIFT_GROWTH = (1.0, 4.0), 8.0
"""Later times at which forces are evaluated on a motion with constant velocities, and the growth of these times. They
count from the present time, in units of the next step. A rejected step that hits a body at rest is one to five times as
long as the next step. In each further estimate of sizes the times are multiplied by the second number."""

REST_HALVINGS = 52
"""Number of later times at which forces are evaluated for a system at rest: the remaining time, its half, its quarter
..."""


def survey(model: Model, parameters: FloatArray, state: DriverState) -> None:
    """Raise the floors (least absolute tolerances) of a driver that returned with the outcome UNSCALED.

    With this outcome the driver requests an estimate of sizes. The new floors follow from the sizes of the entries of
    the `state`, and from their rounding noise. They are written to `state`.
    """
    reals, before = state.reals, state.count(DriverState.SURVEYED)
    t, left, share = state.t, float(reals[DriverState.END]) - state.t, float(reals[DriverState.SHARE])
    h = float(reals[DriverState.H]) or DEFAULT_FIRST * left
    reach, drift = h * FORCE_STEPS[-1] ** before, h * DRIFT_GROWTH**before
    law, layout = slopes_of(model, parameters), model.layout
    slope = law(t, state.y)
    times = [t + min(part * reach, left, key=abs) for part in FORCE_STEPS]
    if not state.y.any():
        times += [t + left * 2.0**-k for k in range(REST_HALVINGS)]
    force_points = [(when, state.y) for when in times]
    # A body at rest may be pushed by a body that reaches it during the step.
    force_points += [(t + part * drift, state.y + part * drift * slope) for part in DRIFT_STEPS]
    sizes, coupled, _ = entry_sizes(law, layout, t, state.y, left, force_points)
    unknown = state.floors <= np.maximum(LEAST_FLOOR, share * SLOPE_NOISE * np.maximum(coupled, sizes))
    floors = np.maximum(np.where(unknown, share * sizes, 0.0), SLOPE_NOISE * coupled)
    noise = noise_floors(model, parameters, t, state.y, left)
    if not state.count(DriverState.STEPS) and (noise > np.maximum(state.floors, floors)).any():
        # The first step was chosen by entries that are rounding: it is chosen again.
        reals[DriverState.H] = 0.0
    floors = np.maximum(floors, noise)
    if before == MOST_SURVEYS - 1:
        # The last attempt for a run whose steps keep decreasing: entries far below others of their kind are rounding.
        # For example, the value of a force 1 + tanh(u) is rounded to zero, but its slope is not. Then no displacement
        # shows that the effect of the force is below rounding.
        bounded = np.where(np.isfinite(state.floors), state.floors, 0.0)
        kinds = np.concatenate([np.full(len(half), half.max(initial=0.0)) for half in layout.split(bounded)])
        floors = np.maximum(floors, np.where(state.floors < SLOPE_NOISE * kinds, kinds, 0.0))
    if (floors > state.floors).any():
        # A Taylor series determines its next step before taking it. That length came from floors that were too low.
        state.taylor.limit = math.inf
    state.floors[:] = np.maximum(state.floors, floors)
    state.counts[DriverState.SURVEYED] += 1


def raise_to_noise(model: Model, parameters: FloatArray, state: DriverState) -> bool:
    """Raise the floors (least absolute tolerances) in a driver state to rounding noise.

    Floors that the user stated are not changed. Return True if a floor more than doubled. Without this, the steps of a
    chain with one moving link would become small to resolve the noise of the links at rest.
    """
    if not state.reals[DriverState.SHARE] > 0:
        return False
    left = float(state.reals[DriverState.END]) - state.t
    noise = noise_floors(model, parameters, state.t, state.y, left)
    rises = bool((noise > 2 * state.floors).any())
    state.floors[:] = np.maximum(state.floors, noise)
    # Count as surveyed: else a run without a survey before its first step would fix the floors of zero entries.
    state.counts[DriverState.SURVEYED] = max(state.count(DriverState.SURVEYED), 1)
    return rises
