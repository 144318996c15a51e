"""The time until which a run is accurate, from comparison with more accurate runs.

The comparison runs are two other methods at their tightest tolerance, and a third run from a start perturbed by a few
units in the last place. A difference from any of them is an error of the run, or grown rounding. All three must agree:
two runs may end close to each other by chance along an unstable direction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, shown
from lagrange.machine.model import Model
from lagrange.statement.number import flag, real_number
from lagrange.trajectory.integrate import integrate, span_or_end
from lagrange.trajectory.options import RunOptions
from lagrange.trajectory.trajectory import FloatArray, Trajectory

SAFETY = 10.0
"""An error may be so many times the largest difference seen. Over 200 random starts of a double pendulum at high energy
the largest true error until a horizon was a ninth of what was claimed, and a twentieth of it where rounding decides
(docs/benchmarks/hard-cases.md)."""

COMPARISON_METHODS: tuple[tuple[str, float, float], ...] = (
    ("taylor", 1.2e-16, 0.0),
    ("dop853", 2.3e-14, 0.0),
    ("taylor", 1e-15, 4.0),
)
"""Method, relative tolerance, and perturbation of the start in units of round-off."""

WITNESSES = 2
"""Number of comparison runs that must reach the horizon."""

TIMES_PER_STEP, MOST_TIMES = 4, 4000
"""Times of comparison per step of the run, including its end, and about the largest number of times."""

START_PERTURBATION = 2.0**-52


@dataclass(frozen=True, eq=False)
class TrustHorizon:
    """The time until which a run is accurate to an error: `float(horizon)` is that time.

    `times` (K,) are the times of comparison, and `bounds` (K,) bound the error until then, in units of the state or, if
    `relative`, of each entry's largest magnitude. `complete` says that the horizon is the end of the run; `witnesses`
    names the comparison runs.
    """

    time: float
    error: float
    relative: bool
    complete: bool
    times: FloatArray
    bounds: FloatArray
    witnesses: tuple[str, ...]

    def __float__(self) -> float:
        return self.time

    def __repr__(self) -> str:
        unit = "of each entry's size" if self.relative else "in units of the state"
        if self.complete:
            return f"holds to {self.error:g} {unit} until the end, t = {self.time:.6g}: below {self.bounds[-1]:.1e}"
        return f"holds to {self.error:g} {unit} until t = {self.time:.6g}, and not known to do so after that"


def trust_horizon(
    system: Any,
    span: float | Sequence[float],
    initial: Mapping[Any, Any] | None = None,
    *,
    error: float = 1e-3,
    relative: bool = False,
    method: Any = None,
    rtol: float | None = None,
    atol: float | None = None,
    step: float | None = None,
    parameters: Mapping[Any, Any] | None = None,
) -> TrustHorizon:
    """Return how long the run of a system or model is accurate to `error`, at its steps and in between.

    The run is that of `lg.integrate(model, span, initial, method=..., ...)`; a number in place of a span is its end,
    and the run begins at 0. `error` is the largest of any entry of the state, in its own units; with `relative`,
    relative to that entry's largest magnitude along the run.

    Raises StatementError for a request that has no meaning, RunError if two comparison runs cannot be made.
    """
    model = _compiled(system)
    allowed, relative = real_number(error, "error"), flag(relative, "relative")
    if allowed <= 0:
        raise StatementError(f"error = {allowed:g}: give a positive one, such as 1e-3.")
    t0, t1 = span_or_end(span)
    if t0 == t1:
        raise StatementError(f"the span from {t0:g} to {t1:g} is empty: give an end such as span={t0 + 10:g}.")
    found, values = integrate(model, (t0, t1), initial, RunOptions(method, rtol, atol, step, parameters=parameters))
    times = _comparison_times(found.t)
    states = found.dense(times)
    size = np.abs(states).max(axis=1)
    unit = np.where(size > 0, size, 1.0) if relative else np.ones(len(size))
    ends, differences, witnesses = [], [], []
    for name, comparison in _comparison_runs(
        model, found, values, np.abs(states[:, : len(times) // 10 + 2]).max(axis=1)
    ):
        reached = (times - comparison.span[1]) * np.sign(times[-1] - times[0]) <= 0
        apart = np.zeros(len(times))
        apart[reached] = (np.abs(comparison.dense(times[reached]) - states[:, reached]) / unit[:, None]).max(axis=0)
        ends.append(int(np.count_nonzero(reached)))
        differences.append(apart)
        witnesses.append(name)
    if len(ends) < WITNESSES:
        raise RunError(f"no two other methods run {model.statement.name} from there: nothing to hold the run against.")
    rounded = START_PERTURBATION * (np.abs(states) / unit[:, None]).max(axis=0)
    bounds = SAFETY * np.maximum.accumulate(np.max([*differences, rounded], axis=0))
    last = min(sorted(ends)[-WITNESSES], int(np.searchsorted(bounds, allowed, side="right"))) - 1
    whole = last == len(times) - 1 and found.status.at_end
    return TrustHorizon(
        time=float(times[max(last, 0)]),
        error=allowed,
        relative=relative,
        complete=whole,
        times=times,
        bounds=bounds,
        witnesses=tuple(witnesses),
    )


def _compiled(system: Any) -> Model:
    if isinstance(system, Model):
        return system
    make = None if isinstance(system, type) else getattr(system, "compile", None)  # lg.System itself is no system
    model = make() if callable(make) else None
    if not isinstance(model, Model):
        raise StatementError(f"{shown(system)} is no system: give an lg.System, such as lg.scene('double-pendulum').")
    return model


def _comparison_times(marks: FloatArray) -> FloatArray:
    """Return times (K,) that divide each of the steps, or fewer steps, including the first and the last time."""
    parts = np.arange(1, TIMES_PER_STEP + 1) / TIMES_PER_STEP
    inner = marks[:-1, None] + np.diff(marks)[:, None] * parts
    inner[:, -1] = marks[1:]
    every = -(-inner.size // MOST_TIMES)
    return np.concatenate([marks[:1], inner.ravel()[::-1][::every][::-1]])


def _comparison_runs(
    model: Model, found: Trajectory, values: Mapping[Any, float], size: FloatArray
) -> Iterator[tuple[str, Trajectory]]:
    """Yield the comparison runs that succeed, each with a name; `size` (2n,) is that of the first states."""
    rows = model.layout.names()
    start = found.dense(found.t[:1])[:, 0]
    moving = np.where(start == 0, size, np.abs(start))
    signs = np.where(np.arange(len(start)) % 2, -1.0, 1.0)
    for method, tolerance, off in COMPARISON_METHODS:
        moved = start + off * START_PERTURBATION * signs * moving
        try:
            comparison, _ = integrate(
                model,
                found.span,
                dict(zip(rows, moved.tolist(), strict=True)),
                RunOptions(method, tolerance, parameters=values),
            )
        except StatementError:
            continue
        yield f"{method} at {tolerance:g}" + (" from a start put off" if off else ""), comparison
