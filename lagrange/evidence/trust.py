"""The time until which a run is accurate, and the growth of errors along it."""

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

PARTS = 4
"""Into so many steps of the variational equation each step of the run is divided."""

MOST_STEPS = 50_000
"""Largest number of steps of the run: each takes some 60 us, and a matrix product for each of its parts."""

BLOCK = 2**22
"""Numbers in the matrices that are kept at once: 32 MB."""

ROUNDING = 2.0**-53


@dataclass(frozen=True)
class Sensitivity:
    """The effect at the end of errors made along the run.

    `growth` is the largest factor by which a relative error of a state grows until the end. `floor` is the change of
    the end when the most sensitive state of the run is rounded to double precision.
    """

    growth: float
    floor: float


def sensitivity(
    model: Model, run: Trajectory, parameters: Mapping[Any, float], size: FloatArray, unit: FloatArray
) -> Sensitivity:
    """Return the growth of errors along a run, by the variational equation dW/dt = J(t, y) W with RK4.

    Relative errors are relative to `size` (2n,), the magnitude of each entry of the state; the floor is in units of
    `unit` (2n,). Both are infinite if the numbers overflow. Raises RunError for a run of more than `MOST_STEPS` steps.
    """
    marks = run.t
    if len(marks) > MOST_STEPS:
        raise RunError(
            f"the run until t = {marks[-1]:g} has {len(marks) - 1} steps, and errors are followed over at most "
            f"{MOST_STEPS}: end the race earlier."
        )
    starts, lengths = marks[:-1], np.diff(marks)
    parts = np.arange(PARTS) / PARTS
    begin = (starts[:, None] + lengths[:, None] * parts).ravel()
    h = np.repeat(lengths / PARTS, PARTS)
    with np.errstate(all="ignore"):
        growth, floor, rest = 1.0, ROUNDING * float((np.abs(run.y[:, -1]) / unit).max()), np.eye(len(size))
        length = max(1, BLOCK // len(size) ** 2)
        for first in reversed(range(0, len(h), length)):
            block = slice(first, first + length)
            matrices = _transitions(model, run, parameters, begin[block], h[block])
            states = np.abs(run.dense(begin[block])).T
            for matrix, state in zip(matrices[::-1], states[::-1], strict=True):
                rest = rest @ matrix
                growth = max(growth, float(((np.abs(rest) @ size) / size).max()))
                floor = max(floor, ROUNDING * float(((np.abs(rest) @ state) / unit).max()))
    finite = np.isfinite(rest).all()
    return Sensitivity(growth if finite else np.inf, floor if finite else np.inf)


def _transitions(
    model: Model, run: Trajectory, parameters: Mapping[Any, float], begin: FloatArray, h: FloatArray
) -> FloatArray:
    """Return d y(t + h) / d y(t) for each of the steps, (N, 2n, 2n)."""

    def slope(times: FloatArray) -> FloatArray:
        return np.moveaxis(model.jacobian(times, run.dense(times), parameters), -1, 0)

    low, high = np.sort((begin[0], begin[-1] + h[-1]))
    first, middle, last = (slope(np.clip(begin + share * h, low, high)) for share in (0.0, 0.5, 1.0))
    one, width = np.eye(first.shape[1]), h[:, None, None]
    k1 = first
    k2 = middle @ (one + width / 2 * k1)
    k3 = middle @ (one + width / 2 * k2)
    k4 = last @ (one + width * k3)
    whole: FloatArray = one + width / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return whole


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
