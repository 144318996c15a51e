"""Taylor series of event functions at a state: the times up to which they are accurate, and their rounding noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lagrange.algorithm.constants import RELATIVE_PERTURBATION, perturbation_factors
from lagrange.algorithm.events.constants import EPSILON, NOISE
from lagrange.algorithm.taylor import event_series
from lagrange.algorithm.taylor.memory import EVENT_SLACK
from lagrange.machine.backend import Series, SingularMassMatrix
from lagrange.machine.python_source import called
from lagrange.machine.state import DriverState
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class EventSeries:
    """Taylor coefficients of the state and of E event functions, in the time unit `scale`.

    `rows` (order + 1, 2n + E) has all coefficients, and `watched` (order + 1, E) the coefficients of the event
    functions. `noise` (E,) is the rounding error of the functions at the state. `rtol` is the relative tolerance of the
    series. `unit` is the time, in units of `scale`, at which the terms of one series are compared with each other.
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
        """Return the series at time t and state y (2n,) in the time unit `scale`, negative for a run backwards.

        `series` computes it, up to the given `order`. `values` are the further arguments of the computation: the
        parameters, then the signs of the switching surfaces. `rtol` is the relative tolerance of the series. Raises
        SingularMassMatrix.
        """
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

    def near(self, which: int) -> FloatArray:
        """Return the series (order + 1,) of event function `which`, in a unit of time that makes its terms comparable.

        The unit is the time up to which the series is accurate, but at most the field `unit`.
        """
        return near(self.watched[:, which : which + 1], self.unit, self.rtol, self.noise[which : which + 1])[:, 0]

    def leaving(self, which: int, margin: float = math.inf) -> tuple[int, int]:
        """Return the sign of event function `which` just after the state, and the order of the term that decides it.

        If the function exceeds the `margin` at the state, return its sign there and the order 0. If it stays zero,
        return the sign 0 and the order -1.
        """
        tolerance = EVENT_SLACK * max(self.rtol, EPSILON)
        return leaving(self.watched[:, which], margin, self.unit, tolerance, float(self.noise[which]))

    def falls(self, which: int, soon: float) -> bool:
        """Return True if the tangent of event function `which` at the state reaches zero within the time `soon`."""
        g, slope = self.watched[:2, which]
        return bool(g * slope < 0 and abs(g) <= abs(slope) * soon / abs(self.scale))


def reach(series: FloatArray, s: float, rtol: float, noise: FloatArray) -> list[float]:
    """Return the time, at most s, up to which the Taylor series of each of k functions is accurate.

    Each column of `series` (order + 1, k) belongs to one function. It is accurate if its truncation error is below the
    relative tolerance `rtol`, or below its rounding error `noise` (k,). For most series the first two and the last two
    terms already prove that they are accurate up to s.
    """
    tolerance, run, ends, far = EVENT_SLACK * max(rtol, EPSILON), called(event_series.reach.form()), [0, 1, -2, -1], []
    with np.errstate(all="ignore"):
        terms = np.abs(series[ends]) * (s ** _ranks(len(series) - 1)[ends])[:, None]
        is_whole = (terms[2:].max(axis=0) <= tolerance * terms[:2].max(axis=0) + noise).tolist()
    for c, doubt, whole in zip(series.T.tolist(), noise.tolist(), is_whole, strict=True):
        far.append(s if whole else run(c, len(c), s, tolerance, doubt))
    return far


def near(series: FloatArray, unit: float, rtol: float, noise: FloatArray) -> FloatArray:
    """Return the Taylor series (order + 1, k) of k functions, each in a unit of time that makes its terms comparable.

    Each column of `series` belongs to one function. The unit of time is s, the time up to which the column is accurate,
    but at most `unit`: coefficient i is multiplied by s**i. The error of an accurate column is below the relative
    tolerance `rtol`, or below its rounding error `noise` (k,).
    """
    with np.errstate(all="ignore"):
        return np.asarray(series * np.array(reach(series, unit, rtol, noise)) ** _ranks(len(series) - 1)[:, None])


def leaving(
    g: FloatArray, margin: float = math.inf, unit: float = 1.0, tolerance: float = 0.0, noise: float = math.inf
) -> tuple[int, int]:
    """Return the sign of a function just after a start at zero, and the order of the term that decides the sign.

    `g` (order + 1,) is the Taylor series of the function. If its value at the start exceeds the `margin` plus rounding,
    the result is the sign of this value and the order 0. If all terms are rounding, g stays zero: the sign is 0 and the
    order -1. Terms are compared at the time `unit`, or at the end of the accurate range of g if that is earlier. In
    this range the truncation error of g is below its relative `tolerance`, or below its rounding error `noise`.
    """
    sign, order = called(event_series.start_of_series.form())(g.tolist(), len(g), unit, tolerance, noise, margin)
    return sign, order


@lru_cache(maxsize=64)
def _ranks(order: int) -> FloatArray:
    """Return the powers of time 0, 1, ..., `order` of the terms of a series as reals, (order + 1,)."""
    return np.arange(order + 1.0)


def signed_scale(state: DriverState) -> float:
    """Return the unit of time of the driver's Taylor series: positive in a forward run, negative in a backward run."""
    left = state.reals[DriverState.END] - state.t
    scale = float(state.taylor.scale)
    return math.copysign(scale, left or scale)
