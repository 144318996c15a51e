"""The Taylor driver of the numpy machine: the loop over steps in plain Python, the place to read it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.series.constants import (
    BEYOND,
    DEFECT,
    FAILURES,
    FARTHEST,
    GROWN,
    GUARD,
    LONGER,
    NEAREST,
    NOISE,
    OVERFLOWED,
    PROBES,
    REACH,
    RETREAT,
    ROWS_SEEN,
    SHORTER,
    SHORTEST,
    START_ROWS,
    TRIES,
    VANISHED,
    ZERO,
    shown_radius,
)
from lagrange.machine.series.interpreted_jet import Jet
from lagrange.machine.series.order import Cost, best_order
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.step.constants import EARLIEST, LEAST_FLOOR, NEAR_END, SPACING, SURVEYS
from lagrange.program.series import SeriesProgram

S = DriverState


@dataclass(frozen=True, eq=False)
class _Held:
    """The state from which a step of length h was taken that is not proven, and the derivative (2n,) at its end."""

    t: float
    lost: float
    scale: float
    h: float
    y: FloatArray
    low: FloatArray
    slope: FloatArray


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
        self._held: _Held | None = None
        self._before = 0.0

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
            self._low[:], self._before = 0.0, 0.0
            state.reals[S.LOW] = 0.0
            state.reals[S.SCALE] = math.copysign(state.reals[S.SCALE], state.reals[S.END] - state.t)
        with np.errstate(all="ignore"):
            for turn in range(budget + 1):
                # The last turn does no more than prove the last step.
                if self._held is None and (turn == budget or state.t == state.reals[S.END]):
                    break
                series = self._look(state)
                if self._held is not None and not self._proven(state, series, times, rows):
                    failed = state.count(S.REJECTED)
                    if self._asks(state, failed > 1 and failed & (failed - 1) == 0):
                        return Outcome.UNSCALED
                    continue
                if turn == budget or state.t == state.reals[S.END]:
                    break
                if series is None:
                    return Outcome.SINGULAR
                fresh = state.reals[S.SHARE] > 0 and not state.count(S.SURVEYED)
                new = fresh and (not state.count(S.STEPS) or state.count(S.TRIES))
                if new and self._asks(state, self._begins_blind(state, series)):
                    return Outcome.UNSCALED
                outcome = self._step(state, series)
                if outcome is not Outcome.PAUSED:
                    return outcome
        return Outcome.DONE if state.t == state.reals[S.END] else Outcome.PAUSED

    def _asks(self, state: DriverState, wanted: bool) -> bool:
        """Whether to come back for a look at how large the entries are; see `Outcome`."""
        return wanted and state.reals[S.SHARE] > 0 and state.count(S.SURVEYED) < SURVEYS

    def _begins_blind(self, state: DriverState, series: FloatArray) -> bool:
        """Give floors that follow the scale a start where entries are zero: what the series reach in the time scale.

        Return whether there are entries of which the series begin so late that they say no more than that.
        """
        entries = len(state.y)
        reach = state.reals[S.SHARE] * np.max(np.abs(series[1 : START_ROWS + 1, :entries]), axis=0)
        zero = state.y == 0
        moving = zero & (reach > 0) & (reach < math.inf)
        state.floors[moving] = np.maximum(reach[moving], LEAST_FLOOR)
        return bool((zero & (state.floors <= LEAST_FLOOR) & (series[-2:, :entries] != 0).any(axis=0)).any())

    def _look(self, state: DriverState) -> FloatArray | None:
        """Return the series from the state, or None where the mass matrix is singular."""
        state.counts[S.EVALUATIONS] += 1
        scale = float(state.reals[S.SCALE])
        try:
            return self._series.rows(self._order, state.t, state.y, scale, self._parameters, self._low)
        except SingularMassMatrix:
            return None

    def _proven(self, state: DriverState, series: FloatArray | None, times: FloatArray, rows: FloatArray) -> bool:
        """Record the step that led here, or take it back where the equations say another derivative than it does."""
        reals, counts, held = state.reals, state.counts, self._held
        assert held is not None
        self._held = None
        if counts[S.FAILS] < FAILURES and (series is None or not self._agrees(state, series[1], held.slope, held.h)):
            state.y[:], self._low = held.y, held.low
            reals[[S.T, S.LOW, S.SCALE]] = held.t, held.lost, held.scale
            self._fail(state, abs(held.h))
            return False
        reals[S.LIMIT] = 2 * (abs(held.h) if 0 < counts[S.FAILS] < FAILURES else reals[S.LIMIT])
        counts[S.FAILS] = 0
        counts[S.STEPS] += 1
        if counts[S.RECORD]:
            row = state.count(S.ROWS)
            times[row], rows[row] = reals[S.T], state.y
            counts[S.ROWS] += 1
        return True

    def _fail(self, state: DriverState, size: float) -> None:
        """Try again with a shorter step, and let who watches look again."""
        state.reals[S.LIMIT] = RETREAT * size
        state.reals[S.ONCE] = math.inf
        state.counts[[S.FAILS, S.REJECTED]] += 1
        state.counts[S.LOOK], state.counts[S.TRIES] = 1, 0

    def _agrees(self, state: DriverState, slope: FloatArray, expected: FloatArray, h: float) -> bool:
        """Whether the derivative (2n,) at the state is what a series of length h has there, in units of the scale."""
        scale, entries = float(state.reals[S.SCALE]), len(state.y)
        size = np.maximum(np.abs(state.y), np.abs(slope[:entries]))
        tolerance = state.reals[S.RTOL] * size + state.floors
        off = float(np.max(np.abs(slope[:entries] - expected) / tolerance))
        allowed = DEFECT * self._order * abs(scale / h) + NOISE * float(np.max(np.abs(slope[:entries]) / tolerance))
        return off <= allowed

    def _probed(self, state: DriverState, series: FloatArray, h: float) -> bool:
        """Whether a series that terminates is what the equations say all along a step."""
        scale, entries = float(state.reals[S.SCALE]), len(state.y)
        for s in h / scale * np.arange(1.0, PROBES) / PROBES:
            y, slope = np.zeros(entries), np.zeros(entries)
            for row in series[:0:-1, :entries]:
                slope = slope * s + (y + row)
                y = (y + row) * s
            try:
                there = self._series.rows(1, state.t + s * scale, state.y + y, scale, self._parameters)[1]
            except SingularMassMatrix:
                return False
            if not self._agrees(state, there, slope, h):
                return False
        return True

    def _step(self, state: DriverState, series: FloatArray) -> Outcome:
        reals, scale = state.reals, float(state.reals[S.SCALE])
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
        bound = min(reals[S.LONGEST], reals[S.LIMIT])
        size = min(natural, bound, reals[S.ONCE])
        final = size * NEAR_END >= abs(left) and not min(bound, reals[S.ONCE]) < abs(left)
        if min(natural, bound) < SPACING * max(abs(state.t), EARLIEST) and not final:
            return Outcome.STEP_TOO_SMALL
        h = left if final else math.copysign(size, scale)
        reals[S.H] = h
        if (
            ends
            and abs(h) > GROWN * self._before
            and state.count(S.FAILS) < FAILURES
            and not self._probed(state, series, h)
        ):
            self._fail(state, abs(h))
            return Outcome.PAUSED
        watched = self._series.program.watched and reals[S.ONCE] == math.inf
        if watched and (state.count(S.LOOK) or self._near(series, h / scale)):
            return Outcome.WATCHED
        self._before = abs(h)
        np.maximum(state.floors, reals[S.SHARE] * np.abs(state.y), out=state.floors)
        before, low = state.y.copy(), self._low
        slope = self._advance(state, series, h / scale)
        if slope is None:
            return Outcome.NON_FINITE
        # A series that terminates says nothing about the next one.
        longer = 2.0 ** (whole if whole <= FARTHEST else 0)
        self._held = _Held(float(reals[S.T]), float(reals[S.LOW]), scale, h, before, low, slope * longer)
        self._accept(state, h, final)
        reals[S.SCALE] = scale * longer
        return Outcome.PAUSED

    def _exponent(self, state: DriverState, series: FloatArray) -> float:
        """Return the binary logarithm of the step in units of the scale: both last coefficients stay in bounds.

        It stays within the radius of convergence that the rows show; see `REACH`.
        """
        entries = len(state.y)
        size = np.maximum(np.abs(state.y), np.abs(series[1, :entries]))
        tolerance = state.reals[S.RTOL] * size + state.floors
        p = self._order

        ratios = np.max(np.abs(series[:, :entries]) / tolerance, axis=1)
        sizes = np.where(ratios < math.inf, np.log2(np.maximum(ratios, 2.0**ZERO)), ratios)

        def bound(k: int) -> float:
            return float(-sizes[k] / k)

        digits = -math.log2(state.reals[S.RTOL])
        earlier = [max(p - less, 1) for less in range(2, ROWS_SEEN)]
        guards = [bound(k) + digits * (1 / k - 1 / p) + GUARD for k in earlier]
        shown = float(shown_radius(np.where(sizes < VANISHED, -math.inf, sizes)))
        found = float(np.min([bound(p - 1), bound(p), *guards, shown + REACH]))
        if found > -VANISHED / p:
            # The upper half of all rows must keep in bounds where these are zero.
            found = float(np.min([found, *(bound(k) for k in range(p // 2 + 1, p - 1))]))
        return found

    def _near(self, series: FloatArray, s: float) -> bool:
        """Whether something that is watched may vanish on the step."""
        watched = np.abs(series[:, 2 * self._series.program.dimension :])
        powers = abs(s) ** np.arange(1.0, len(series))
        return not (watched[0] > powers @ watched[1:]).all()

    def _advance(self, state: DriverState, series: FloatArray, s: float) -> FloatArray | None:
        """Add the series to the state, compensated; return its derivative, or None if not finite: the state stays."""
        total, slope = np.zeros(len(state.y)), np.zeros(len(state.y))
        for row in series[:0:-1, : len(state.y)]:
            slope = slope * s + (total + row)
            total = (total + row) * s
        added = total + self._low
        y = state.y + added
        if not np.isfinite(y).all():
            return None
        back = y - state.y
        self._low = (state.y - (y - back)) + (added - back)
        state.y[:] = y
        return slope

    def _accept(self, state: DriverState, h: float, final: bool) -> None:
        reals = state.reals
        added = h + reals[S.LOW]
        t = reals[S.T] + added
        back = t - reals[S.T]
        reals[S.LOW] = 0.0 if final else (reals[S.T] - (t - back)) + (added - back)
        reals[S.T] = reals[S.END] if final else t
        reals[S.ONCE] = math.inf
        state.counts[S.TRIES] = 0
