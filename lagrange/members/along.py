"""Expressions along a run that has all its steps: the same points, rule and search as of members side by side.

See `lagrange.procedure.members.along`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from lagrange.machine.array_source import arrays_loaded
from lagrange.machine.model import Model
from lagrange.machine.parameters import Parameters
from lagrange.members.keep import Reduction
from lagrange.procedure.members.along import NEAR_END, RISE, SIGNS, lobatto
from lagrange.procedure.members.extremum import largest_between, memory_size
from lagrange.trajectory.trajectory import FloatArray, Trajectory

STEPS_AT_ONCE = 16384
"""So many steps are looked at together."""

NONE = np.empty(0)
"""The memory of a polynomial, which the path of a run has itself."""


@cache
def _search() -> Callable[..., Any]:
    return arrays_loaded(largest_between())


@dataclass(frozen=True, eq=False)
class SampledRun:
    """A run without output times, whose accepted states are all there, with the parameters (k,) of the member."""

    model: Model
    run: Trajectory
    parameters: FloatArray

    def reduced(self, reductions: Sequence[Reduction]) -> dict[str, float]:
        """Return what is made of each expression."""
        if not reductions:
            return {}
        made = [self._reduction(one) for one in reductions]
        for steps in self._steps():
            for one in made:
                one.add(steps)
        return {one.name: result.value for one, result in zip(reductions, made, strict=True)}

    def _reduction(self, one: Reduction) -> _Mean | _Extremum:
        first = float(self._values(one.expression, self.run.t[:1], self.run.y[:, :1])[0])
        t = self.run.t
        if one.how == "mean":
            return _Mean(self, one, first, float(t[-1] - t[0]))
        return _Extremum(self, one, SIGNS[one.how] * first if first == first else -np.inf)

    def _values(
        self, expression: Any, times: FloatArray, states: FloatArray, parameters: Parameters = None
    ) -> FloatArray:
        """Return an expression at times (K,) with parameters (k, K), or those of the member."""
        values = self.run.parameters_at(times, self.parameters) if parameters is None else parameters
        return self.model.evaluate_expression(expression, times, states, values)

    def _parameters(self, low: int, high: int) -> Parameters:
        """Return the parameters at the points of some steps, (k, (high - low)*POINTS); see `_Steps`."""
        begin = self.run.parameters_at(self.run.t, self.parameters)
        if not (isinstance(begin, np.ndarray) and begin.ndim == 2):
            return begin
        points = np.repeat(begin[:, low:high, None], len(lobatto()[0]), axis=2)
        # A step to the time of an event ends with the parameters before, a reset with those behind.
        resets = low + np.flatnonzero(np.diff(self.run.t[low : high + 1]) == 0)
        points[:, resets - low, -1] = begin[:, resets + 1]
        return points.reshape(len(begin), -1)

    def _steps(self) -> Iterator[_Steps]:
        """Yield the steps in groups; a reset is one of no length."""
        t, y, points = self.run.t, self.run.y, lobatto()[0][1:-1]
        for low in range(0, len(t) - 1, STEPS_AT_ONCE):
            high = min(low + STEPS_AT_ONCE, len(t) - 1)
            begins, lengths = t[low:high], np.diff(t[low : high + 1])
            times = begins[:, None] + lengths[:, None] * points
            inner = self.run.dense(times.ravel()).reshape(len(y), *times.shape)
            times = np.concatenate([begins[:, None], times, t[low + 1 : high + 1, None]], axis=1)
            ends = y[:, low:high, None], inner, y[:, low + 1 : high + 1, None]
            yield _Steps(self, times, np.concatenate(ends, axis=2), self._parameters(low, high))


@dataclass(frozen=True, eq=False)
class _Steps:
    """Some steps of a run: times (k, POINTS), states (2n, k, POINTS), and parameters."""

    of: SampledRun
    times: FloatArray
    states: FloatArray
    parameters: Parameters

    @property
    def lengths(self) -> FloatArray:
        """How long the steps take, (k,)."""
        return np.asarray(self.times[:, -1] - self.times[:, 0])

    def values(self, expression: Any) -> FloatArray:
        """Return an expression at the points, (k, POINTS)."""
        states = self.states.reshape(len(self.states), -1)
        found = self.of._values(expression, self.times.ravel(), states, self.parameters)
        return found.reshape(self.times.shape)

    def inside(self, expression: Any, which: Any, fractions: FloatArray) -> FloatArray:
        """Return an expression at a fraction of each of some steps."""
        times = self.times[which, 0] + fractions * self.lengths[which]
        return self.of._values(expression, times, self.of.run.dense(times))


@dataclass
class _Mean:
    """The mean over time."""

    of: SampledRun
    reduction: Reduction
    first: float
    duration: float
    total: float = 0.0

    def add(self, steps: _Steps) -> None:
        values = steps.values(self.reduction.expression)
        self.total += float(np.sum(values @ lobatto()[1] * steps.lengths))

    @property
    def value(self) -> float:
        return self.total / self.duration if self.duration else self.first


@dataclass
class _Extremum:
    """The largest value of an expression times a sign."""

    of: SampledRun
    reduction: Reduction
    best: float

    @property
    def value(self) -> float:
        return float("nan") if self.best == -np.inf else SIGNS[self.reduction.how] * self.best

    def add(self, steps: _Steps) -> None:
        values = steps.values(self.reduction.expression)
        signed = values * SIGNS[self.reduction.how]
        self.best = max(self.best, float(np.max(signed, where=signed == signed, initial=-np.inf)))
        for brackets in self._brackets(steps, values, signed):
            self._search(steps, *brackets)

    def _brackets(self, steps: _Steps, values: FloatArray, f: FloatArray) -> Iterator[tuple[Any, Any, Any]]:
        """Yield steps, places (3, k) and values there (3, k) about maxima that may be above all values.

        See `lagrange.procedure.members.along.raised`.
        """
        x = np.broadcast_to(lobatto()[0], f.shape)
        a, b, c = f[:, :-2], f[:, 1:-1], f[:, 2:]
        with np.errstate(all="ignore"):
            gaps, steep = np.diff(x), np.abs(np.diff(f) / np.diff(x))
            steepest = 2.0 * np.maximum(steep[:, :-1], steep[:, 1:])
            bound = np.maximum(a + b + steepest * gaps[:, :-1], b + c + steepest * gaps[:, 1:]) / 2.0
            high = bound - self.best > RISE * abs(self.best)
            inner = high & (b >= a) & (b >= c)
        which, place = np.nonzero(inner)
        three = place + np.arange(3)[:, None]
        yield which, x[which, three], values[which, three]
        yield self._near_end(steps, values, f, np.flatnonzero(high[:, 0] & (a[:, 0] > b[:, 0])), 0)
        yield self._near_end(steps, values, f, np.flatnonzero(high[:, -1] & (c[:, -1] > b[:, -1])), f.shape[1] - 2)

    def _near_end(
        self, steps: _Steps, values: FloatArray, f: FloatArray, which: Any, first: int
    ) -> tuple[Any, Any, Any]:
        """Return those of some steps where the expression rises from the end next to the gap behind a point."""
        x, near = lobatto()[0], np.full(len(which), NEAR_END if first == 0 else 1.0 - NEAR_END)
        value = steps.inside(self.reduction.expression, which, near) if len(which) else near
        rises = value * SIGNS[self.reduction.how] >= np.maximum(f[which, first], f[which, first + 1])
        kept, ends = which[rises], np.ones(int(rises.sum()))
        places = np.array([x[first] * ends, near[rises], x[first + 1] * ends])
        return kept, places, np.array([values[kept, first], value[rises], values[kept, first + 1]])

    def _search(self, steps: _Steps, which: Any, places: FloatArray, values: FloatArray) -> None:
        """Search for the largest value about some places."""
        expression, count = self.reduction.expression, len(which)
        if not count:
            return

        def value(count: int, fractions: Any, out: Any, *_: Any) -> None:
            out[:count] = steps.inside(expression, which, fractions[:count])

        best, work = np.full(count, self.best), np.zeros(memory_size(count))
        along = 0.0, 0.0, 0.0, 0, NONE, NONE, 0
        with np.errstate(all="ignore"):
            _search()(value, count, SIGNS[self.reduction.how], *places, *values, best, *along, work)
        self.best = float(best.max())
