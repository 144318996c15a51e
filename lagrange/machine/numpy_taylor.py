"""The Taylor driver of the numpy machine: the loop over steps in plain Python, the place to read it."""

from __future__ import annotations

import math

import numpy as np

from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.driver import DriverState, Outcome
from lagrange.machine.jet import Jet
from lagrange.machine.taylor import (
    BEYOND,
    EARLIEST,
    FARTHEST,
    GUARD,
    LONGER,
    NEAR_END,
    NEAREST,
    OVERFLOWED,
    ROWS_SEEN,
    SHORTER,
    SHORTEST,
    SPACING,
    TRIES,
    VANISHED,
    ZERO,
    Cost,
    best_order,
)
from lagrange.program.series import SeriesProgram

S = DriverState


class NumpySeries:
    """A series program that is interpreted."""

    def __init__(self, program: SeriesProgram) -> None:
        self.program = program

    def form(self, order: int) -> str:
        """Return how the series is computed."""
        return "interpreted"

    def order(self, tolerance: float) -> int:
        """Return the order by cost; see `Series`. Interpreting costs as much at every order."""
        return best_order(Cost(fixed=2.0, each=1.0, pairs=0.0), tolerance)

    def driver(self, order: int, parameters: FloatArray) -> NumpyTaylorDriver:
        """Return a driver; see `Series`."""
        return NumpyTaylorDriver(self, order, parameters)

    def rows(
        self,
        order: int,
        t: float,
        y: FloatArray,
        scale: float,
        parameters: FloatArray,
        low: FloatArray | None = None,
    ) -> FloatArray:
        """Return the series at a state, of which rounding lost `low`; see `Series`."""
        with np.errstate(all="ignore"):
            found = Jet(self.program, parameters).coefficients(t, y, order, scale, low)
            n = self.program.dimension
            zero = np.zeros(order + 1)
            watched = [zero if i is None else found[:, i] for i in self.program.watched]
            rows: FloatArray = np.column_stack([found[:, : 2 * n], *watched])
            return rows


class NumpyTaylorDriver:
    """Advances a run by interpreted Taylor steps."""

    def __init__(self, series: NumpySeries, order: int, parameters: FloatArray) -> None:
        self._series, self._order, self._parameters = series, order, parameters
        self._low = np.zeros(2 * series.program.dimension)

    def use(self, parameters: FloatArray) -> None:
        """Go on with other numbers; see `TaylorDriver`."""
        self._parameters = parameters

    def restart(self, state: DriverState) -> None:
        """Forget what rounding lost; see `TaylorDriver`."""
        self._low[:] = 0.0
        state.reals[S.LOW] = 0.0

    def adopt(self, state: DriverState) -> None:
        """Leave the state where it is; see `Driver`."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`."""
        state.counts[S.ROWS] = 0
        if not state.count(S.STEPS):
            self._low[:] = 0.0
            state.reals[S.LOW] = 0.0
            state.reals[S.SCALE] = math.copysign(state.reals[S.SCALE], state.reals[S.END] - state.t)
        with np.errstate(all="ignore"):
            for _ in range(budget):
                if state.t == state.reals[S.END]:
                    break
                outcome = self._step(state, times, rows)
                if outcome is not Outcome.PAUSED:
                    return outcome
        return Outcome.DONE if state.t == state.reals[S.END] else Outcome.PAUSED

    def _step(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome:
        reals, scale = state.reals, float(state.reals[S.SCALE])
        try:
            series = self._series.rows(self._order, state.t, state.y, scale, self._parameters, self._low)
        except SingularMassMatrix:
            return Outcome.SINGULAR
        state.counts[S.EVALUATIONS] += 1
        exponent = self._exponent(state, series)
        first = not state.count(S.STEPS) and not state.count(S.TRIES)
        left = float(reals[S.END] - state.t - reals[S.LOW])
        reach = math.log2(max(min(abs(left), reals[S.LONGEST]) / abs(scale), 2.0**ZERO))
        ends = exponent > -VANISHED / self._order
        tried = state.count(S.TRIES) >= TRIES and not math.isnan(exponent)
        if not (abs(exponent) < (NEAREST if first else FARTHEST) or (ends and reach < 1.0) or tried):
            if state.count(S.TRIES) >= TRIES or abs(scale) < SHORTEST:
                return Outcome.NON_FINITE
            state.counts[S.TRIES] += 1
            change = SHORTER if not exponent >= OVERFLOWED else min(reach, LONGER) if ends else exponent
            reals[S.SCALE] = scale * 2.0 ** round(change)
            return Outcome.PAUSED
        whole = min(round(exponent), BEYOND)
        natural = 2.0 ** (exponent - round(exponent)) * 2.0**whole * abs(scale)
        size = min(natural, reals[S.LONGEST], reals[S.ONCE])
        final = size * NEAR_END >= abs(left) and not reals[S.ONCE] < abs(left)
        if min(natural, reals[S.LONGEST]) < SPACING * max(abs(state.t), EARLIEST) and not final:
            return Outcome.STEP_TOO_SMALL
        h = left if final else math.copysign(size, scale)
        reals[S.H] = h
        if reals[S.ONCE] == math.inf and (state.count(S.LOOK) or self._near(series, h / scale)):
            return Outcome.WATCHED
        if not self._advance(state, series, h / scale):
            return Outcome.NON_FINITE
        self._accept(state, h, final, times, rows)
        # A series that terminates says nothing about the next one.
        reals[S.SCALE] = scale * 2.0 ** (whole if whole <= FARTHEST else 0)
        return Outcome.PAUSED

    def _exponent(self, state: DriverState, series: FloatArray) -> float:
        """Return the binary logarithm of the step in units of the scale: both last coefficients stay in bounds."""
        entries = len(state.y)
        size = np.maximum(np.abs(state.y), np.abs(series[1, :entries]))
        tolerance = state.reals[S.RTOL] * size + state.reals[S.ATOL]
        p = self._order

        def bound(k: int) -> float:
            ratio = float(np.max(np.abs(series[k, :entries]) / tolerance))
            if not ratio < math.inf:
                return math.nan if math.isnan(ratio) else -math.inf
            return -math.log2(max(ratio, 2.0**ZERO)) / k

        digits = -math.log2(state.reals[S.RTOL])
        earlier = [max(p - less, 1) for less in range(2, ROWS_SEEN)]
        guards = [bound(k) + digits * (1 / k - 1 / p) + GUARD for k in earlier]
        found = float(np.min([bound(p - 1), bound(p), *guards]))
        if found > -VANISHED / p:
            # The upper half of all rows must keep in bounds where these are zero.
            found = float(np.min([found, *(bound(k) for k in range(p // 2 + 1, p - 1))]))
        return found

    def _near(self, series: FloatArray, s: float) -> bool:
        """Whether something that is watched may vanish on the step."""
        watched = np.abs(series[:, 2 * self._series.program.dimension :])
        powers = abs(s) ** np.arange(1.0, len(series))
        return not (watched[0] > powers @ watched[1:]).all()

    def _advance(self, state: DriverState, series: FloatArray, s: float) -> bool:
        """Add the series to the state, compensated; return whether it stayed finite, else the state stays."""
        total = np.zeros(len(state.y))
        for row in series[:0:-1, : len(state.y)]:
            total = (total + row) * s
        added = total + self._low
        y = state.y + added
        if not np.isfinite(y).all():
            return False
        back = y - state.y
        self._low = (state.y - (y - back)) + (added - back)
        state.y[:] = y
        return True

    def _accept(self, state: DriverState, h: float, final: bool, times: FloatArray, rows: FloatArray) -> None:
        reals = state.reals
        added = h + reals[S.LOW]
        t = reals[S.T] + added
        back = t - reals[S.T]
        reals[S.LOW] = 0.0 if final else (reals[S.T] - (t - back)) + (added - back)
        reals[S.T] = reals[S.END] if final else t
        reals[S.ONCE] = math.inf
        state.counts[S.TRIES] = 0
        state.counts[S.STEPS] += 1
        if state.count(S.RECORD):
            row = state.count(S.ROWS)
            times[row], rows[row] = reals[S.T], state.y
            state.counts[S.ROWS] += 1
