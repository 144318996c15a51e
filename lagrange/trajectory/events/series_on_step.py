"""The Taylor series of event functions from a state on: its accuracy, and its rounding noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lagrange.algorithm.events.constants import NOISE
from lagrange.algorithm.step.constants import RELATIVE_PERTURBATION, perturbation_factors
from lagrange.algorithm.taylor.constants import RADIUS_FRACTION, ROW_DISTANCE
from lagrange.algorithm.taylor.defect_test import MOST_HALVINGS
from lagrange.machine.backend import Series, SingularMassMatrix
from lagrange.machine.state import DriverState
from lagrange.trajectory.events.zeros_on_step import Side
from lagrange.trajectory.trajectory import FloatArray

SLACK = 64.0
"""Allowed last terms of an event function's series, in tolerances of the state's: it is a sum of products."""

JUMP = 1e-4
"""Value of an event function, relative to its largest term, above which it is not zero."""

ZERO_ROUND_OFF = 64 * 2.0**-52
"""Value of an event function, relative to the sum of its terms, below which it is zero together with another."""

BALANCE = 256.0
"""Largest ratio of the quadratic and higher terms to the others at the end of a step without a limit on its length.

The roots lose two digits to it, and a run of any length takes a few steps more.
"""


@dataclass(frozen=True, eq=False)
class EventSeries:
    """Series at a state in the time unit `scale`: `rows` (order + 1, 2n + E) of the state and the event functions.

    `watched` (order + 1, E) are those of the event functions, and `noise` (E,) their rounding. `rtol` is the tolerance
    of the series, and `unit` a time at which the terms of the event functions are compared.
    """

    scale: float
    unit: float
    rtol: float
    rows: FloatArray
    watched: FloatArray
    noise: FloatArray

    @classmethod
    def at(
        cls, series: Series, order: int, t: float, y: FloatArray, scale: float, values: FloatArray, rtol: float
    ) -> EventSeries:
        """Return the series at a state (2n,); `scale` has the sign of the run. Raises SingularMassMatrix."""
        size = len(y)
        rows = series.rows(order, t, y, scale, values)
        watched = rows[:, size:]
        tilt = 1 + RELATIVE_PERTURBATION * perturbation_factors(size + 1)
        try:
            moved = series.rows(order, t * tilt[size], y * tilt[:size], scale, values)[0, size:]
        except SingularMassMatrix:
            moved = watched[0]
        with np.errstate(all="ignore"):
            noise = np.abs(moved - watched[0]) * (NOISE / RELATIVE_PERTURBATION)
        return cls(scale, unit(t, scale), rtol, rows, watched, np.where(noise < math.inf, noise, 0.0))

    def trusted(self, s: float, *, hides_growth: bool = False) -> tuple[float, int]:
        """Return the length, up to s, on which the series of all event functions are accurate, and the limiting one.

        The series of the state allow s. The series of an expression such as log(x) may end earlier. If the series
        `hides_growth`, the length is at most half of the radius of convergence that its terms show.
        """
        far = reach(self.watched, s, self.rtol, self.noise)
        if hides_growth:
            with np.errstate(all="ignore"):
                far = np.minimum(far, 2.0 ** (shown_radius(np.log2(np.abs(self.watched))) + RADIUS_FRACTION))
        least = int(np.argmin(far))
        s = min(s, float(far[least]))
        return (self._balanced(s) if self.ends else s), least

    def verified(
        self, s: float, limiting: int, series: Series, t: float, y: FloatArray, values: FloatArray
    ) -> tuple[float, int]:
        """Shorten a step from (t, y) until the series of event functions agree with their values at its end.

        This is for high powers: at x = 0 the series of x**40 is zero up to order 39, and does not show its growth.
        """
        order = len(self.rows) - 1
        for _ in range(MOST_HALVINGS):
            end, moved = t + s * self.scale, state_at(y, self.rows, s)
            try:
                there = series.rows(order, end, moved, self.scale, values)[0, len(y) :]
                wrong = self.disagrees(there, s, self.noise)
                if wrong.any():
                    noise = EventSeries.at(series, order, end, moved, self.scale, values, self.rtol).noise
                    wrong = self.disagrees(there, s, self.noise + noise)
            except SingularMassMatrix:
                break
            if not wrong.any():
                break
            s, limiting = s / 2, int(np.argmax(wrong))
        return s, limiting

    def _balanced(self, s: float) -> float:
        """Shorten a step without a limit on its length until the high powers do not hide the others by rounding."""
        sizes, ranks = np.abs(self.watched), _ranks(len(self.watched) - 1)
        for _ in range(200):
            terms = sizes * (s**ranks)[:, None]
            low, high = terms[:2].max(axis=0), terms[2:].max(axis=0)
            if not ((low > 0) & (high > BALANCE * low)).any():
                break
            s /= 2
        return s

    @cached_property
    def near(self) -> FloatArray:
        """The series of event functions in a unit of time that makes their terms comparable, by the function `near`."""
        return near(self.watched, self.unit, self.rtol, self.noise)

    def jumps(self, s: float, zero_sides: Sequence[Side]) -> list[int]:
        """Return the event functions that changed sign since the last step without a zero, as an angle at its cut."""
        largest = (np.abs(self.watched) * (s ** _ranks(len(self.watched) - 1))[:, None]).max(axis=0)
        here = self.watched[0]
        changed = np.array([side.sign for side in zero_sides]) * here < 0
        return np.flatnonzero(changed & (np.abs(here) > JUMP * largest)).tolist()

    def is_zero_at(self, which: int, s: float) -> bool:
        """Return True if event function `which` is zero at time s on the step, up to its noise and rounding."""
        terms = self.watched[:, which] * s ** _ranks(len(self.watched) - 1)
        return bool(abs(terms.sum()) <= self.noise[which] + ZERO_ROUND_OFF * np.abs(terms).sum())

    def falls(self, which: int, soon: float) -> bool:
        """Return True if event function `which` reaches zero within the time `soon`, by its first derivative."""
        g, slope = self.watched[:2, which]
        return bool(g * slope < 0 and abs(g) <= abs(slope) * soon / abs(self.scale))

    @property
    def ends(self) -> bool:
        """True if the series of the state terminate, so that they do not limit the length of a step."""
        return not self.rows[-2:, : self.rows.shape[1] - len(self.noise)].any()

    def disagrees(self, there: FloatArray, s: float, noise: FloatArray) -> FloatArray:
        """Return a mask (E,) of event functions whose series misses their values `there` (E,) at time s."""
        with np.errstate(all="ignore"):
            terms = self.watched * (s ** _ranks(len(self.watched) - 1))[:, None]
            allowed = SLACK * (max(self.rtol, 2.0**-52) * np.abs(terms).max(axis=0) + noise)
            return np.asarray(~(np.abs(terms.sum(axis=0) - there) <= allowed))


def reach(series: FloatArray, s: float, rtol: float, noise: FloatArray | float = 0.0) -> FloatArray:
    """Return the times (k,), at most s, up to which the columns of a series (order + 1, k) are accurate or noise."""
    order = len(series) - 1
    sizes, ranks, tolerance = np.abs(series), _ranks(order)[:, None], SLACK * max(rtol, 2.0**-52)
    far: FloatArray = np.full(series.shape[1], s)
    for _ in range(60):
        with np.errstate(all="ignore"):
            terms = sizes * far**ranks
            ratios = terms[-2:].max(axis=0) / (tolerance * terms[: order // 2 + 1].max(axis=0) + noise)
            # A zero series has no limit. Where a term overflows, the step is much too long.
            ratios = np.where(sizes[-2:].any(axis=0), np.where(ratios >= 0, ratios, math.inf), 0.0)
            if not (ratios > 1).any():
                break
            far = np.where(ratios > 1, far * np.clip(ratios ** (-1 / order), 0.05, 0.9), far)
    return far


def near(series: FloatArray, unit: float, rtol: float, noise: FloatArray | float = 0.0) -> FloatArray:
    """Return the columns of a series scaled to the unit of time, or to its range if shorter, to compare their terms."""
    with np.errstate(all="ignore"):
        return np.asarray(series * reach(series, unit, rtol, noise) ** _ranks(len(series) - 1)[:, None])


def unit(t: float, scale: float) -> float:
    """Return the time, in units of the scale, at which a velocity is compared with an acceleration.

    The scale of a polynomial motion has no meaning. Times below some spacings of floating-point times cannot be
    distinguished, and the threshold of `leaving` has to stay below that.
    """
    return max(min(1.0, abs(t / scale) / 64), 2.0**-40) if t else 1.0


@lru_cache(maxsize=64)
def _ranks(order: int) -> FloatArray:
    """Return 0, 1, ... up to the order."""
    return np.arange(order + 1.0)


def signed_scale(state: DriverState) -> float:
    """Return the scale of time with the sign of the run's direction."""
    left = state.reals[DriverState.END] - state.t
    scale = float(state.taylor.scale)
    return math.copysign(scale, left or scale)


def state_at(y: FloatArray, rows: FloatArray, s: float) -> FloatArray:
    """Return the state (2n,) at a time on the step, in units of the scale."""
    total = np.zeros(len(y))
    for row in rows[:0:-1, : len(y)]:
        total = (total + row) * s
    return y + total


def shown_radius(sizes: FloatArray) -> FloatArray:
    """Return the binary logarithm of the radius of convergence that the last rows show, infinity if they are zero.

    `sizes` are the binary logarithms of the coefficients, rows first, minus infinity for zero.
    """
    last = len(sizes) - 1
    found = []
    for late in (last - 1, last):
        early = max(late - ROW_DISTANCE, 1)
        fall = sizes[early] - sizes[late]
        found.append(np.where(np.isfinite(fall), fall / (late - early), math.inf))
    return np.asarray(np.maximum(*found))
