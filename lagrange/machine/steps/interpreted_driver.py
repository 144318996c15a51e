"""The driver of the numpy machine: the same loop over steps as the compiled ones, in plain Python.

Equal steps, and each trial of a step, are the procedures that the compiled drivers run. How steps follow the error is
stated here, as the place to read what the compiled drivers do.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.backend import FloatArray, Kernel, SingularMassMatrix
from lagrange.machine.state import EARLIEST, LEAST_FLOOR, NEAR_END, SPACING, STUCK, SURVEYS, DriverState, Outcome
from lagrange.machine.steps.control_constants import (
    AFTER_BROKEN,
    AFTER_DIVERGED,
    ALONE,
    CANCELLED,
    DAMPING,
    FAR,
    FIRST_SHARE,
    FIRST_TRIAL,
    FLAT,
    INTEGRAL,
    LEAST_FIRST,
    LEAST_NORM,
    LEAST_PREVIOUS,
    NOISE,
    RESOLVED,
    SHRUNK,
    TILT,
    tilts,
)
from lagrange.machine.steps.interpreted_step import InterpretedStep
from lagrange.procedure.step.memory import Kept
from lagrange.program.step import Control, StepProgram

S = DriverState


class NumpyDriver:
    """Advances a run by the procedures of its step; see `Driver`."""

    def __init__(
        self, step: StepProgram, kernel: Kernel, parameters: FloatArray, jacobian: Kernel | None = None
    ) -> None:
        self._step, self._kernel, self._parameters = step, kernel, parameters

        def with_parameters(function: Kernel) -> Any:
            return lambda t, y: function(t, y, parameters)

        derivative = None if jacobian is None else with_parameters(jacobian)
        self._taken = InterpretedStep(step, kernel.program.states, with_parameters(kernel), derivative)

    def adopt(self, state: DriverState) -> None:
        """Leave the state where it is; see `Driver`."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`."""
        with np.errstate(all="ignore"):
            if self._step.control is None:
                return self._taken.run(state, budget, times, rows)
            self._taken.begin(state)
            for _ in range(budget):
                if state.t == state.reals[S.END]:
                    break
                outcome = self._adaptive(state, times, rows)
                if outcome is not Outcome.PAUSED:
                    return outcome
        return Outcome.DONE if state.t == state.reals[S.END] else Outcome.PAUSED

    def kept(self) -> tuple[Kept, ...]:
        """Return what each solve of the steps keeps, and behind them each of the starter, once steps were taken."""
        return self._taken.kept()

    def _adaptive(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome:
        control: Any = self._step.control
        reals = state.reals
        if reals[S.H] == 0:
            first = self._first_step(state, control)
            if first is None:
                return Outcome.UNSCALED
            reals[S.H] = first
        t, end, h = state.t, reals[S.END], np.copysign(min(abs(reals[S.H]), reals[S.LONGEST]), reals[S.H])
        least = SPACING * max(abs(t), EARLIEST)
        final = abs(h) * NEAR_END >= abs(end - t)
        if not abs(h) >= least and (not final or state.count(S.AFTER_REJECT)):
            return Outcome.STEP_TOO_SMALL
        after = end if final else t + h
        # Far from time zero a step is as long as times allow; elsewhere it keeps its length, and a matrix made for it.
        length = after - t if final or abs(h) < FAR * abs(t) else h
        outcome, y, errors = self._taken.attempt(state, length)
        if outcome is not Outcome.DONE:
            part = AFTER_DIVERGED if outcome is Outcome.DIVERGED else AFTER_BROKEN
            return self._reject(state, outcome, part * length)
        if not all(np.isfinite(vector).all() for vector in (y, *errors)):
            return self._reject(state, Outcome.NON_FINITE, AFTER_BROKEN * length)
        norm = self._norm(state, control, y, errors)
        factor = control.safety * max(norm, LEAST_NORM) ** -(1 / control.exponent - INTEGRAL * control.memory)
        if not norm <= 1.0:
            return self._reject(state, Outcome.STEP_TOO_SMALL, length * min(max(factor, control.least), SHRUNK), y)
        factor *= reals[S.PREVIOUS] ** control.memory
        reals[S.PREVIOUS] = max(norm, LEAST_PREVIOUS)
        most = 1.0 if state.count(S.AFTER_REJECT) else control.most
        factor = max(min(factor, most), control.least)
        reals[S.H] = length * (1.0 if 1.0 <= factor < control.hold else factor)
        state.counts[S.AFTER_REJECT] = 0
        self._taken.accept(state, after, times, rows)
        np.maximum(state.floors, reals[S.SHARE] * abs(y), out=state.floors)
        return Outcome.PAUSED

    def _reject(self, state: DriverState, cause: Outcome, h: float, moved: FloatArray | None = None) -> Outcome:
        """Try again with a step of h; ask how large entries are if it is not the first try, or one has no size yet.

        Where the trial `moved` the state, an entry that it left at zero does not count.
        """
        state.reals[S.CAUSE] = cause
        state.reals[S.H] = h
        state.counts[S.AFTER_REJECT] += 1
        state.counts[S.REJECTED] += 1
        blank = state.floors <= LEAST_FLOOR
        asked = state.count(S.AFTER_REJECT) == STUCK or (blank if moved is None else blank & (moved != 0)).any()
        if asked and state.reals[S.SHARE] > 0 and state.count(S.SURVEYED) < SURVEYS:
            return Outcome.UNSCALED
        return Outcome.PAUSED

    def _norm(self, state: DriverState, control: Control, y: FloatArray, errors: list[FloatArray]) -> float:
        scale = state.floors + state.reals[S.RTOL] * np.maximum(abs(state.y), abs(y))
        sums = [float(((error / scale) ** 2).sum()) for error in errors]
        if not control.damped:
            return float(np.sqrt(sums[0] / len(y)))
        mixed = sums[0] + DAMPING * sums[1]
        return sums[0] / float(np.sqrt(mixed * len(y))) if mixed > 0 else 0.0

    def _first_step(self, state: DriverState, control: Control) -> float | None:
        """Return a first step with its sign, from how slopes change over a short one; None to ask for sizes of entries.

        The jerk over the velocity is the square of a rate, whatever the units of entries and of time are and wherever
        coordinates begin; without either, the acceleration over the coordinate is, or over the velocity. What is small
        against its tolerance counts as what its floor is the tolerance of. A floor that is to follow the scale begins,
        where an entry is zero, with what the step reaches. An acceleration that may be round-off of what cancels, as at
        an equilibrium, is none to go by: what it owes to the coordinate is.
        """
        t, y, reals, n = state.t, state.y, state.reals, len(state.y) // 2
        span = abs(reals[S.END] - t)
        sign = float(np.sign(reals[S.END] - t))
        known = y != 0
        at, moves = known[:n], known[n:]
        far, speed = np.split(abs(y) + state.floors / reals[S.RTOL], 2)
        state.counts[S.EVALUATIONS] += 3
        try:
            slope = self._kernel(t, y, self._parameters)
            force = abs(slope[n:])
            rate = float(np.max(np.where(at, np.sqrt(force / far), np.where(moves, force / speed, 0.0))))
            trial = min(FIRST_SHARE / rate if rate > 0 else FIRST_TRIAL * span, span)
            later = self._kernel(t + sign * trial, y + sign * trial * slope, self._parameters)
            tilted = self._kernel(t, y * (1 + TILT * tilts(len(y))), self._parameters)
        except SingularMassMatrix:
            return float(sign * FLAT * span)
        jerk = np.where(moves, abs(later - slope)[n:] / trial / speed, 0.0)
        by_place, by_speed = (
            np.where(one, part, np.inf) for one, part in ((at, force / far), (moves, (force / speed) ** 2))
        )
        other = np.minimum(by_place, by_speed)
        squares = np.where(jerk > 0, jerk, np.where(at | moves, other, 0.0))
        owed = abs(tilted - slope)[n:] / TILT
        doubtful = abs(slope[n:]) < CANCELLED * owed
        if reals[S.SHARE] > 0 and not state.count(S.SURVEYED) and self._follows(squares, doubtful, slope):
            return None
        paired = np.where(doubtful & at, owed / far, 0.0)
        change = float(np.sqrt(max(np.max(squares), np.max(paired))))
        rate = change if 0 < change < np.inf else rate
        aim = float((FIRST_SHARE * reals[S.RTOL]) ** (1 / control.exponent))
        h = min(max(aim / rate if rate > 0 else FLAT * span, RESOLVED * SPACING * abs(t)), span)
        if reals[S.SHARE] > 0:
            ahead = abs(slope + (later - slope) * (h / trial))
            reach = h * np.where((ahead < np.inf) & (slope == 0), ahead, abs(slope))
            np.maximum(state.floors, max(reals[S.SHARE], LEAST_FIRST) * reach, out=state.floors, where=~known)
            period = 1 / rate if rate > 0 else 0.0
            noise = np.where(doubtful, period * NOISE * owed, 0.0)
            np.maximum(state.floors, np.concatenate([period * noise, noise]), out=state.floors)
        return float(sign * h)

    def _follows(self, squares: FloatArray, doubtful: NDArray[np.bool_], slope: FloatArray) -> bool:
        """Whether nothing moves yet, or a first step follows accelerations that may be round-off of what cancels."""
        others = float(squares[~doubtful].max(initial=0.0))
        return bool(squares[doubtful].max(initial=0.0) > ALONE * others or not slope.any())
