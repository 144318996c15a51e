"""The Taylor series of event functions from a state on: its accuracy, and its rounding noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lagrange.algorithm.events.constants import EPSILON, JUMP, NOISE
from lagrange.algorithm.step.constants import RELATIVE_PERTURBATION, perturbation_factors
from lagrange.algorithm.taylor import event_series
from lagrange.algorithm.taylor.constants import EVENT_SLACK
from lagrange.algorithm.taylor.defect_test import MOST_HALVINGS
from lagrange.algorithm.taylor.events_on_step import MOST_BALANCING
from lagrange.machine.backend import Series, SingularMassMatrix
from lagrange.machine.printed_run import called
from lagrange.machine.state import DriverState
from lagrange.trajectory.events.zeros_on_step import Side
from lagrange.trajectory.trajectory import FloatArray

ZERO_ROUND_OFF = 64 * 2.0**-52
"""Value of an event function, relative to the sum of its terms, below which it is zero together with another."""


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
        noise, unit = np.where(noise < math.inf, noise, 0.0), event_series.comparable_unit(t, scale)
        return cls(scale, unit, rtol, rows, watched, noise)

    def trusted(self, s: float, *, hides_growth: bool = False) -> tuple[float, int]:
        """Return the length, up to s, on which the series of all event functions are accurate, and the limiting one.

        The series of the state allow s. The series of an expression such as log(x) may end earlier. If the series
        `hides_growth`, the length is at most half of the radius of convergence that its terms show.
        """
        far, columns = reach(self.watched, s, self.rtol, self.noise), _columns(self.watched)
        if hides_growth:
            safe_step = called(event_series.safe_step.form())
            far = [min(x, safe_step(c, len(c))) for x, c in zip(far, columns, strict=True)]
        least = far.index(min(far))
        s, halvings, is_balanced = min(s, far[least]), 0, called(event_series.is_balanced.form())
        for c in columns if self.ends else ():
            # The series do not limit the step: shorten it until high powers do not hide the others by rounding.
            while halvings < MOST_BALANCING and not is_balanced(c, len(c), s):
                s, halvings = s / 2, halvings + 1
        return s, least

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

    def near(self, which: int) -> FloatArray:
        """Return the series of an event function scaled by the function `near`, (order + 1,)."""
        return near(self.watched[:, which : which + 1], self.unit, self.rtol, self.noise[which : which + 1])[:, 0]

    def leaving(self, which: int, margin: float = math.inf) -> tuple[int, int]:
        """Return the sign with which an event function leaves zero, and the order; see the function `leaving`."""
        tolerance = EVENT_SLACK * max(self.rtol, EPSILON)
        return leaving(self.watched[:, which], margin, self.unit, tolerance, float(self.noise[which]))

    def jumps(self, s: float, zero_sides: Sequence[Side]) -> list[int]:
        """Return the event functions that changed sign since the last step without a zero, as an angle at its cut."""
        largest_term = called(event_series.largest_term.form())
        pairs = zip(_columns(self.watched), zero_sides, strict=True)
        changed = [(i, c) for i, (c, side) in enumerate(pairs) if side.sign * c[0] < 0]
        return [i for i, c in changed if abs(c[0]) > JUMP * largest_term(c, len(c), s)]

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
            allowed = EVENT_SLACK * (max(self.rtol, 2.0**-52) * np.abs(terms).max(axis=0) + noise)
            return np.asarray(~(np.abs(terms.sum(axis=0) - there) <= allowed))


def reach(series: FloatArray, s: float, rtol: float, noise: FloatArray) -> list[float]:
    """Return the times, at most s, up to which the columns of a series (order + 1, k) are accurate or noise (k,).

    Most series show by their first and last two terms that they are accurate on the whole step.
    """
    tolerance, run, ends, far = EVENT_SLACK * max(rtol, EPSILON), called(event_series.reach.form()), [0, 1, -2, -1], []
    with np.errstate(all="ignore"):
        terms = np.abs(series[ends]) * (s ** _ranks(len(series) - 1)[ends])[:, None]
        is_whole = (terms[2:].max(axis=0) <= tolerance * terms[:2].max(axis=0) + noise).tolist()
    for c, doubt, whole in zip(_columns(series), noise.tolist(), is_whole, strict=True):
        far.append(s if whole else run(c, len(c), s, tolerance, doubt))
    return far


def near(series: FloatArray, unit: float, rtol: float, noise: FloatArray) -> FloatArray:
    """Return the columns of a series scaled to the unit of time, or to its range if shorter, to compare their terms."""
    with np.errstate(all="ignore"):
        return np.asarray(series * np.array(reach(series, unit, rtol, noise)) ** _ranks(len(series) - 1)[:, None])


def leaving(
    g: FloatArray, margin: float = math.inf, unit: float = 1.0, tolerance: float = 0.0, noise: float = math.inf
) -> tuple[int, int]:
    """Return the sign of a function with the series g right after a start at zero, and the order of its leading term.

    If g stays zero, the sign is 0 and the order -1. If g is not zero at its start, up to rounding and the `margin`, the
    result is its sign there and the order 0. Terms are compared at a time `unit`, or at the end of the range of g by
    its tolerance and noise.
    """
    sign, order = called(event_series.start_of_series.form())(g.tolist(), len(g), unit, tolerance, noise, margin)
    return sign, order


def _columns(series: FloatArray) -> list[list[float]]:
    """Return the columns of a series (order + 1, k) as lists, which printed Python reads fastest."""
    columns: list[list[float]] = series.T.tolist()
    return columns


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
