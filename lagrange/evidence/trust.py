"""How long the digits of a run hold, found by holding it against twins that do better.

The twins are two other methods at their tightest, and a third run from a start that is put off by a few units in the
last place: what the run has in common with none of them is its error, or what rounding has grown to. All three must
agree with it: two runs that end near each other by chance are likely along an unstable direction, four are not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.errors import RunError, StatementError, shown
from lagrange.machine.model import Model
from lagrange.statement.number import flag, real_number
from lagrange.trajectory.integrate import integrate
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
"""Method, relative tolerance and how many units of round-off the start is put off by."""

WITNESSES = 2
"""So many twins must have come as far as the horizon."""

TIMES_PER_STEP, MOST_TIMES = 4, 4000
"""Looks into every step of the run, its end included, and about how many there are at most."""

START_PERTURBATION = 2.0**-52


@dataclass(frozen=True, eq=False)
class TrustHorizon:
    """The time until which a run holds to an error: `float(horizon)` is that time.

    `times` (K,) are those at which the run was held against its twins, and `bounds` (K,) what its error was below until
    then, in units of the state or, if `relative`, of each entry's largest magnitude. `complete` says that the run holds
    to its end, `witnesses` which twins there were.
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
    span: Sequence[float],
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
    """Return how long the run of a system or model holds to `error`, at its steps and in between.

    The run is that of `lg.integrate(model, span, initial, method=..., ...)`. `error` is the largest of any entry of the
    state, in its own units; with `relative`, in parts of that entry's largest magnitude along the run. Raises
    StatementError for a request that cannot be meant, RunError where no two twins can be run.
    """
    model = _compiled(system)
    allowed, relative = real_number(error, "error"), flag(relative, "relative")
    if allowed <= 0:
        raise StatementError(f"error = {allowed:g}: give a positive one, such as 1e-3.")
    found, values = integrate(model, span, initial, RunOptions(method, rtol, atol, step, parameters=parameters))
    times = _comparison_times(found.t)
    states = found.dense(times)
    size = np.abs(states).max(axis=1)
    unit = np.where(size > 0, size, 1.0) if relative else np.ones(len(size))
    ends, differences, witnesses = [], [], []
    for name, twin in _comparison_runs(model, found, values, np.abs(states[:, : len(times) // 10 + 2]).max(axis=1)):
        reached = (times - twin.span[1]) * np.sign(times[-1] - times[0]) <= 0
        apart = np.zeros(len(times))
        apart[reached] = (np.abs(twin.dense(times[reached]) - states[:, reached]) / unit[:, None]).max(axis=0)
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
    make = getattr(system, "compile", None)
    model = make() if callable(make) else None
    if not isinstance(model, Model):
        raise StatementError(f"{shown(system)} is no system: give an lg.System, such as lg.scene('double-pendulum').")
    return model


def _comparison_times(marks: FloatArray) -> FloatArray:
    """Return times (K,) that divide each of the steps, or fewer of them, the first and the last among them."""
    parts = np.arange(1, TIMES_PER_STEP + 1) / TIMES_PER_STEP
    inner = marks[:-1, None] + np.diff(marks)[:, None] * parts
    inner[:, -1] = marks[1:]
    every = -(-inner.size // MOST_TIMES)
    return np.concatenate([marks[:1], inner.ravel()[::-1][::every][::-1]])


def _comparison_runs(
    model: Model, found: Trajectory, values: Mapping[Any, float], size: FloatArray
) -> Iterator[tuple[str, Trajectory]]:
    """Yield the twins that run at all, each with a name; `size` (2n,) is that of the states soon after the start."""
    rows = model.layout.names()
    start = found.dense(found.t[:1])[:, 0]
    moving = np.where(start == 0, size, np.abs(start))
    signs = np.where(np.arange(len(start)) % 2, -1.0, 1.0)
    for method, tolerance, off in COMPARISON_METHODS:
        moved = start + off * START_PERTURBATION * signs * moving
        try:
            twin, _ = integrate(
                model,
                found.span,
                dict(zip(rows, moved.tolist(), strict=True)),
                RunOptions(method, tolerance, parameters=values),
            )
        except StatementError:
            continue
        yield f"{method} at {tolerance:g}" + (" from a start put off" if off else ""), twin
