"""The driver of the numpy machine: the same loop over steps as the compiled ones, in plain Python.

It runs an explicit step function on arrays as it was written, so it is the place to read what the compiled drivers do.
An implicit step is run by the procedures that they run.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray, Kernel, SingularMassMatrix
from lagrange.machine.state import EARLIEST, NEAR_END, SPACING, DriverState, Outcome
from lagrange.machine.steps.control_constants import (
    AFTER_BROKEN,
    AFTER_DIVERGED,
    DAMPING,
    FAR,
    FLAT,
    GUESS,
    INTEGRAL,
    LEAP,
    LEAST_NORM,
    LEAST_PREVIOUS,
    SHARE,
    SHRUNK,
    SLIVER,
    SLOWLY,
    SMALL,
)
from lagrange.machine.steps.interpreted_step import InterpretedStep
from lagrange.procedure.step.memory import Kept
from lagrange.program.step import Control, StepProgram

S = DriverState


class NumpyDriver:
    """Advances a run by calling the step function on arrays, or its procedures where it solves; see `Driver`."""

    def __init__(
        self, step: StepProgram, kernel: Kernel, parameters: FloatArray, jacobian: Kernel | None = None
    ) -> None:
        self._step = step
        self._by_procedures = bool(step.solves) or step.starter is not None
        self._kernel = kernel
        self._jacobian = jacobian
        self._parameters = parameters
        self._slope: FloatArray | None = None

    def adopt(self, state: DriverState) -> None:
        """Leave the state where it is; see `Driver`."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run; see `Driver`."""
        if not state.count(S.SLOPE_KNOWN):
            self._slope = None
        if self._by_procedures and not state.count(S.KEPT):
            state.counts[S.KEPT] = 1
            self._begin()
        take = self._fixed if self._step.control is None else self._adaptive
        with np.errstate(all="ignore"):
            for _ in range(budget):
                if state.t == state.reals[S.END]:
                    break
                outcome = take(state, times, rows)
                if outcome is not Outcome.PAUSED:
                    return outcome
        return Outcome.DONE if state.t == state.reals[S.END] else Outcome.PAUSED

    def kept(self) -> tuple[Kept, ...]:
        """Return what each solve of the steps keeps, and behind them each of the starter, once steps were taken."""
        starting = () if self._starter is self._usual else self._starter.kept()
        return (*self._usual.kept(), *starting)

    def _fixed(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome:
        end, h = state.reals[S.END], state.reals[S.STEP]
        after = state.reals[S.START] + (state.count(S.STEPS) + 1) * h
        if (end - (after + SLIVER * h)) * np.sign(h) <= 0:
            after, h = end, end - state.t
        try:
            outcome, y, _ = self._attempt(state, h)
        except SingularMassMatrix:
            return Outcome.SINGULAR
        if outcome is not Outcome.DONE:
            return outcome
        if not np.isfinite(y).all():
            return Outcome.NON_FINITE
        self._accept(state, after, y, times, rows)
        return Outcome.PAUSED

    def _adaptive(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome:
        control: Any = self._step.control
        reals = state.reals
        if reals[S.H] == 0:
            reals[S.H] = self._first_step(state, control)
        t, end, h = state.t, reals[S.END], np.copysign(min(abs(reals[S.H]), reals[S.LONGEST]), reals[S.H])
        least = SPACING * max(abs(t), EARLIEST)
        final = abs(h) * NEAR_END >= abs(end - t)
        if not abs(h) >= least and (not final or state.count(S.AFTER_REJECT)):
            return Outcome.STEP_TOO_SMALL
        after = end if final else t + h
        # Far from time zero a step is as long as times allow; elsewhere it keeps its length, and a matrix made for it.
        length = after - t if final or abs(h) < FAR * abs(t) else h
        try:
            outcome, y, errors = self._attempt(state, length)
        except SingularMassMatrix:
            outcome = Outcome.SINGULAR
        if outcome is not Outcome.DONE:
            part = AFTER_DIVERGED if outcome is Outcome.DIVERGED else AFTER_BROKEN
            return self._reject(state, outcome, part * length)
        if not all(np.isfinite(vector).all() for vector in (y, *errors)):
            return self._reject(state, Outcome.NON_FINITE, AFTER_BROKEN * length)
        norm = self._norm(state, control, y, errors)
        factor = control.safety * max(norm, LEAST_NORM) ** -(1 / control.exponent - INTEGRAL * control.memory)
        if not norm <= 1.0:
            return self._reject(state, Outcome.STEP_TOO_SMALL, length * min(max(factor, control.least), SHRUNK))
        factor *= reals[S.PREVIOUS] ** control.memory
        reals[S.PREVIOUS] = max(norm, LEAST_PREVIOUS)
        most = 1.0 if state.count(S.AFTER_REJECT) else control.most
        factor = max(min(factor, most), control.least)
        reals[S.H] = length * (1.0 if 1.0 <= factor < control.hold else factor)
        state.counts[S.AFTER_REJECT] = 0
        self._accept(state, after, y, times, rows)
        return Outcome.PAUSED

    def _attempt(self, state: DriverState, h: float) -> tuple[Outcome, FloatArray, list[FloatArray]]:
        """Return how a step ends, the state after it and the error vectors, and keep the first slope for another try.

        Raises SingularMassMatrix.
        """
        if self._by_procedures:
            return self._solved(state, h)
        calls: list[FloatArray] = []
        step, n = self._step, len(state.y) // 2

        def f(t: float, y: FloatArray) -> FloatArray:
            if not calls and self._slope is not None and step.starts_with_slope:
                calls.append(self._slope)
                return self._slope
            state.counts[S.EVALUATIONS] += 1
            whole = np.concatenate([y, np.zeros(n)]) if step.partitioned else y
            slope = self._kernel(t, whole, self._parameters)
            calls.append(slope[n:] if step.partitioned else slope)
            return calls[-1]

        if step.partitioned:
            q, v = step.function(f, state.t, state.y[:n], state.y[n:], h)
            result: tuple[FloatArray, list[FloatArray]] = (np.concatenate([q, v]), [])
        elif step.control is None:
            result = (step.function(f, state.t, state.y, h), [])
        else:
            y, *errors = step.function(f, state.t, state.y, h)
            result = (y, errors)
        self._slope = calls[0] if step.starts_with_slope else None
        state.counts[S.SLOPE_KNOWN] = self._slope is not None
        self._last = calls[-1]
        return Outcome.DONE, *result

    def _begin(self) -> None:
        """Forget what was kept from the steps of another run."""

        def evaluate(kernel: Any) -> Any:
            return lambda t, y: kernel(t, y, self._parameters)

        law, jacobian = evaluate(self._kernel), evaluate(self._jacobian)
        dimension, starter = self._kernel.program.states, self._step.starter
        self._usual = InterpretedStep(self._step, dimension, law, jacobian)
        self._starter = self._usual if starter is None else InterpretedStep(starter, dimension, law, jacobian)
        self._before: list[FloatArray] = []

    def _solved(self, state: DriverState, h: float) -> tuple[Outcome, FloatArray, list[FloatArray]]:
        """Take an implicit step, with the starter where the state one step back is not known."""
        states = [state.y.copy()]
        usual = self._step.starter is None or (bool(self._before) and h == state.reals[S.STEP])
        taken = self._usual if usual else self._starter
        slope_known = bool(state.count(S.SLOPE_KNOWN))
        found = taken.take(state, [*states, *self._before] if usual else states, h, slope_known=slope_known)
        state.counts[S.SLOPE_KNOWN] = self._step.starts_with_slope
        self._tried = states if h == state.reals[S.STEP] else []
        return found

    def _accept(self, state: DriverState, t: float, y: FloatArray, times: FloatArray, rows: FloatArray) -> None:
        state.reals[S.T] = t
        state.y[:] = y
        state.counts[S.STEPS] += 1
        self._slope = self._last if self._step.ends_with_slope else None
        if self._by_procedures:
            self._usual.accept()
            self._before = [] if self._step.starter is None else self._tried
        state.counts[S.SLOPE_KNOWN] = self._step.ends_with_slope
        if state.count(S.RECORD):
            row = state.count(S.ROWS)
            times[row] = t
            rows[row] = y
            state.counts[S.ROWS] += 1

    def _reject(self, state: DriverState, cause: Outcome, h: float) -> Outcome:
        state.reals[S.CAUSE] = cause
        state.reals[S.H] = h
        state.counts[S.AFTER_REJECT] = 1
        state.counts[S.REJECTED] += 1
        return Outcome.PAUSED

    def _norm(self, state: DriverState, control: Control, y: FloatArray, errors: list[FloatArray]) -> float:
        scale = state.reals[S.ATOL] + state.reals[S.RTOL] * np.maximum(abs(state.y), abs(y))
        sums = [float(((error / scale) ** 2).sum()) for error in errors]
        if not control.damped:
            return float(np.sqrt(sums[0] / len(y)))
        mixed = sums[0] + DAMPING * sums[1]
        return sums[0] / float(np.sqrt(mixed * len(y))) if mixed > 0 else 0.0

    def _first_step(self, state: DriverState, control: Control) -> float:
        """Return a first step from two slopes (Hairer, Norsett, Wanner, Solving ODE I, II.4), with its sign."""
        t, y, span = state.t, state.y, state.reals[S.END] - state.t
        scale = state.reals[S.ATOL] + state.reals[S.RTOL] * abs(y)

        def size(vector: FloatArray) -> float:
            return float(np.sqrt(np.mean((vector / scale) ** 2)))

        state.counts[S.EVALUATIONS] += 2
        try:
            slope = self._kernel(t, y, self._parameters)
            d0, d1 = size(y), size(slope)
            ratio = 0.0 if d0 < SMALL or d1 < SMALL else SHARE * d0 / d1
            # A slope infinitely large against its tolerance, as where y = 0 and atol is next to 0, says nothing.
            h0 = min(ratio if ratio > 0 else GUESS, abs(span))
            signed = float(np.copysign(h0, span))
            d2 = size(self._kernel(t + signed, y + signed * slope, self._parameters) - slope) / h0
        except SingularMassMatrix:
            return float(np.copysign(min(GUESS, abs(span)), span))
        largest = max(d1, d2)
        h1 = max(GUESS, SLOWLY * h0) if largest <= FLAT else (SHARE / largest) ** (1 / control.exponent)
        chosen = min(LEAP * h0, h1, abs(span))
        return float(np.copysign(chosen if chosen > 0 else h0, span))
