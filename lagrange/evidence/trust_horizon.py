"""Estimate how long a run is accurate and how errors grow along it; compute reference solutions with error bounds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

from lagrange.errors import RunError, StatementError
from lagrange.evidence.precise_run import precise_run
from lagrange.machine.model import Model, Stated
from lagrange.statement.expression import flag, positive_number, real_array
from lagrange.trajectory.integrator import Problem, RunOptions
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.run import Flow, compiled, span_or_end, trajectory_of
from lagrange.trajectory.trajectory import FloatArray, Trajectory

DEFAULT_DIGITS = 22
"""Decimal digits of the reference. Its errors are 1e-6 times those of doubles, and grow along a run like those."""

LEAST_DIGITS, GREATEST_DIGITS = (
    18,
    200,
)  # Allowed precision of the reference, which must exceed the 16 digits of doubles

APART = 4
"""Number of digits by which the second run is less precise than the reference run.

The difference of both runs is the error bound. With fewer digits, the intervals, their points and the difference steps
differ, too.
"""

REFERENCE_SECONDS = 180.0
"""Time limit of each run in multiple precision, in seconds."""

TIGHTEST = 1e-13
"""Relative tolerance of the second run, with which the reference run of a method is compared."""


@dataclass(frozen=True, eq=False)
class ReferenceSolution:
    """Reference states at each of the `times`, 2n numbers each, and a bound on their errors.

    `uncertainty` is the bound, in the units of the method `error`. `about` is a phrase on the origin of the states.
    """

    times: tuple[float, ...]
    states: tuple[tuple[Any, ...], ...]
    uncertainty: float
    about: str

    def error(self, y: FloatArray, unit: FloatArray) -> float:
        """Return the largest difference of states y (2n, K) from the reference, in units of `unit` (2n,) per entry."""
        if not np.isfinite(y).all():
            return np.inf
        return max(_distance(column, state, unit) for column, state in zip(y.T.tolist(), self.states, strict=True))


def reference_solution(
    problem: Problem, times: Sequence[float], reference: Any, digits: int | None, unit: FloatArray, growth: float
) -> ReferenceSolution:
    """Return the reference solution of a problem at `times`.

    `reference` is None for an independent run in multiple precision, with `digits` decimal digits. Else it is an array
    of states (2n,) or (2n, K), or a method as name or instance. `unit` (2n,) has the unit of errors of each entry.
    `growth` is the factor by which errors grow along the run. Raises StatementError for an unusable `reference`, and
    RunError if the solution cannot be computed.
    """
    if reference is None:
        return _independent(problem, times, digits, unit, growth)
    if isinstance(reference, (str, type)) or callable(getattr(reference, "integrate", None)):
        # The uncertainty is the largest difference from a run by another method at a tight tolerance.
        method = find(reference)
        tightened = isinstance(reference, str) and method.claims.adaptive
        other = "dopri5" if method.name == "dop853" else "dop853"
        first = _states(problem, times, reference, TIGHTEST if tightened else None)
        second = _states(problem, times, other, TIGHTEST)
        bound = max(_distance(a, b, unit) for a, b in zip(first, second, strict=True))
        about = f"a run of {method.name}, compared with {other} at its smallest tolerance"
        return ReferenceSolution(tuple(times), first, bound, about)
    states = real_array(reference, "reference")
    states = states[:, None] if states.ndim == 1 else states
    if states.shape != (len(problem.y0), len(times)) or not np.isfinite(states).all():
        raise StatementError(
            f"reference has shape {np.shape(reference)}: give finite states of shape ({len(problem.y0)}, "
            f"{len(times)}), one column for each time of the race, or a method."
        )
    bound = float((np.abs(np.spacing(states)) / 2 / unit[:, None]).max())
    return ReferenceSolution(tuple(times), tuple(map(tuple, states.T.tolist())), bound, "the states given as reference")


def _independent(
    problem: Problem, times: Sequence[float], digits: int | None, unit: FloatArray, growth: float
) -> ReferenceSolution:
    chosen = DEFAULT_DIGITS if digits is None else digits
    if not growth < 10.0 ** (chosen - APART):
        raise RunError(
            f"a relative error grows {growth:.0e} times until t = {problem.t1:g}, so a reference of {chosen} digits, "
            "or a run in double precision, has no correct digit there. End the race earlier, or give more digits=."
        )
    model, start = problem.model, problem.y0.tolist()

    def run(precision: int) -> tuple[tuple[Any, ...], ...]:
        computed = precise_run(
            model, problem.parameters, problem.t0, start, times, digits=precision, max_wall=REFERENCE_SECONDS
        )
        # Numbers of another context do not pickle; conversion keeps every digit.
        return tuple(tuple(map(mpmath.mp.convert, state)) for state in computed)

    try:
        rough, states = run(chosen - APART), run(chosen)
    except RunError as error:
        raise RunError(f"{error} Give the race another reference=, such as a method.") from error
    bound = max(_distance(a, b, unit) for a, b in zip(rough, states, strict=True))
    about = f"an independent run of {chosen} digits, from differences of the stated energies"
    return ReferenceSolution(tuple(times), states, bound, about)


def _states(problem: Problem, times: Sequence[float], method: Any, tolerance: float | None) -> tuple[Any, ...]:
    """Return the states at the times, each computed by a run from the previous time."""
    flow = Flow(problem.model, RunOptions(method, tolerance))
    y, now, states = problem.y0, problem.t0, []
    for then in times:
        y = flow(y, now, then, problem.parameters)
        now = then
        states.append(tuple(y.tolist()))
    return tuple(states)


def _distance(y: Sequence[Any], other: Sequence[Any], unit: FloatArray) -> float:
    """Return the largest difference of two states, each entry in units of `unit`."""
    # The subtraction is done in mpmath if one operand is its number; doubles would round small differences to zero.
    return max(abs(float(b - a)) / float(scale) for a, b, scale in zip(y, other, unit, strict=True))


PARTS = 4
"""Number of steps of the variational equation in each step of the run."""

SENSITIVITY_STEPS = 50_000
"""Largest number of steps for which the growth of errors is computed. Each takes about 60 us."""

ENTRIES_AT_ONCE = 2**22
"""Largest number of matrix entries in memory at once: 32 MB."""

UNIT_ROUNDING = 2.0**-53


@dataclass(frozen=True)
class Sensitivity:
    """The effect of errors along a run on its final state.

    `growth` is the largest factor by which a relative error of a state grows until the end. `floor` is the change of
    the final state if the most sensitive state of the run is rounded to double precision: no method is more accurate.
    """

    growth: float
    floor: float


def sensitivity(
    model: Model, run: Trajectory, parameters: Mapping[Any, float], size: FloatArray, unit: FloatArray
) -> Sensitivity:
    """Return the growth of errors along a run, by the variational equation dW/dt = J(t, y) W, solved with RK4.

    Relative errors are relative to `size` (2n,), the magnitude of each entry of the state; `Sensitivity.floor` is in
    units of `unit` (2n,). Both results are infinite if the numbers overflow. Raises RunError for a run of more than
    `SENSITIVITY_STEPS` steps.
    """
    marks = run.t
    if len(marks) > SENSITIVITY_STEPS:
        raise RunError(
            f"the run until t = {marks[-1]:g} has {len(marks) - 1} steps, and errors are followed over at most "
            f"{SENSITIVITY_STEPS}: end the race earlier."
        )
    starts, lengths = marks[:-1], np.diff(marks)
    parts = np.arange(PARTS) / PARTS
    begin = (starts[:, None] + lengths[:, None] * parts).ravel()
    h = np.repeat(lengths / PARTS, PARTS)
    low, high, identity = min(marks[0], marks[-1]), max(marks[0], marks[-1]), np.eye(len(size))

    def slope(times: FloatArray) -> FloatArray:
        within = np.clip(times, low, high)
        return np.moveaxis(model.jacobian(within, run.dense(within), parameters), -1, 0)

    with np.errstate(all="ignore"):
        growth, floor, rest = 1.0, UNIT_ROUNDING * float((np.abs(run.y[:, -1]) / unit).max()), np.eye(len(size))
        length = max(1, ENTRIES_AT_ONCE // len(size) ** 2)
        for first in reversed(range(0, len(h), length)):
            block = slice(first, first + length)
            k1, middle, last = (slope(begin[block] + share * h[block]) for share in (0.0, 0.5, 1.0))
            width = h[block, None, None]
            k2 = middle @ (identity + width / 2 * k1)
            k3 = middle @ (identity + width / 2 * k2)
            k4 = last @ (identity + width * k3)
            matrices = identity + width / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            states = np.abs(run.dense(begin[block])).T
            for matrix, state in zip(matrices[::-1], states[::-1], strict=True):
                rest = rest @ matrix
                growth = max(growth, float(((np.abs(rest) @ size) / size).max()))
                floor = max(floor, UNIT_ROUNDING * float(((np.abs(rest) @ state) / unit).max()))
    finite = np.isfinite(rest).all()
    return Sensitivity(growth if finite else np.inf, floor if finite else np.inf)


SAFETY = 10.0
"""Ratio of the error bound to the largest difference between the runs.

For 200 random starts of a double pendulum at high energy, the largest true error until a horizon was 1/9 of the bound.
It was 1/20 of the bound where rounding dominates (docs/benchmarks/hard-cases.md).
"""

COMPARISON_METHODS: tuple[tuple[str, float, float], ...] = (
    ("taylor", 1.2e-16, 0.0),
    ("dop853", 2.3e-14, 0.0),
    ("taylor", 1e-15, 4.0),
)
"""Comparison runs: method, relative tolerance, and perturbation of the initial state in units of rounding."""

WITNESSES = 2
"""Least number of comparison runs that must reach the horizon."""

TIMES_PER_STEP, MOST_TIMES = 4, 4000
"""Number of comparison times in each step, including its end; approximate limit on the number of all times."""

START_PERTURBATION = 2.0**-52


@dataclass(frozen=True, eq=False)
class TrustHorizon:
    """The time until which a run is accurate to an error: `float(horizon)` is that time.

    `times` (K,) are the times at which runs are compared. `bounds` (K,) are bounds of the error up to each time. Errors
    are in units of the state or, if `relative` is true, of each entry's largest magnitude. `complete` is true if the
    run is accurate until its end. `witnesses` has the names of the runs with which it is compared.
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
    system: Stated | Model,
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
    """Return the time until which the run of a system or model is accurate to `error`, at its steps and in between.

    The run is that of `lg.integrate(model, span, initial, method=..., ...)`. If `span` is a number, it is the end, and
    the run begins at 0. `error` is the largest accepted error of any entry of the state, in the units of this entry. If
    `relative` is true, it is relative to the entry's largest magnitude along the run.

    Raises StatementError for invalid arguments, and RunError if fewer than two comparison runs succeed.
    """
    model = compiled(system, "double-pendulum")
    model.statement.check_without_contacts("the horizon of trust")
    allowed = positive_number(error, "error", "give a positive one, such as 1e-3")
    relative = flag(relative, "relative")
    t0, t1 = span_or_end(span)
    if t0 == t1:
        raise StatementError(f"the span from {t0:g} to {t1:g} is empty: give an end such as span={t0 + 10:g}.")
    run, values = trajectory_of(model, (t0, t1), initial, RunOptions(method, rtol, atol, step, parameters=parameters))
    times = _comparison_times(run.t)
    states = run.dense(times)
    size = np.abs(states).max(axis=1)
    unit = np.where(size > 0, size, 1.0) if relative else np.ones(len(size))
    ends, differences, witnesses = [], [], []
    for name, comparison in _comparison_runs(model, run, values, np.abs(states[:, : len(times) // 10 + 2]).max(axis=1)):
        reached = (times - comparison.span[1]) * np.sign(times[-1] - times[0]) <= 0
        difference = np.zeros(len(times))
        distances = np.abs(comparison.dense(times[reached]) - states[:, reached]) / unit[:, None]
        difference[reached] = distances.max(axis=0)
        ends.append(int(np.count_nonzero(reached)))
        differences.append(difference)
        witnesses.append(name)
    if len(ends) < WITNESSES:
        raise RunError(
            f"the accuracy of this run of {model.statement.name} is not known: fewer than {WITNESSES} runs by other "
            "methods succeed from its initial state. Choose another initial state, or another span."
        )
    rounded = START_PERTURBATION * (np.abs(states) / unit[:, None]).max(axis=0)
    bounds = SAFETY * np.maximum.accumulate(np.max([*differences, rounded], axis=0))
    last = min(sorted(ends)[-WITNESSES], int(np.searchsorted(bounds, allowed, side="right"))) - 1
    return TrustHorizon(
        time=float(times[max(last, 0)]),
        error=allowed,
        relative=relative,
        complete=last == len(times) - 1 and run.status.at_end,
        times=times,
        bounds=bounds,
        witnesses=tuple(witnesses),
    )


def _comparison_times(marks: FloatArray) -> FloatArray:
    """Return the times at which runs are compared: the times of steps, `marks`, and further times within each step.

    There are `TIMES_PER_STEP` in each step. If there are more than about `MOST_TIMES` in all, some are left out.
    """
    parts = np.arange(1, TIMES_PER_STEP + 1) / TIMES_PER_STEP
    inner = marks[:-1, None] + np.diff(marks)[:, None] * parts
    inner[:, -1] = marks[1:]
    every = -(-inner.size // MOST_TIMES)
    return np.concatenate([marks[:1], inner.ravel()[::-1][::every][::-1]])


def _comparison_runs(
    model: Model, run: Trajectory, values: Mapping[Any, float], size: FloatArray
) -> Iterator[tuple[str, Trajectory]]:
    """Yield (name, run) for each comparison run that succeeds; one of them has a perturbed initial state.

    `values` are the values of the parameters. `size` (2n,) scales the perturbation of entries that start at 0.
    """
    rows = model.layout.names()
    start = run.dense(run.t[:1])[:, 0]
    moving = np.where(start == 0, size, np.abs(start))
    signs = np.where(np.arange(len(start)) % 2, -1.0, 1.0)
    for method, tolerance, off in COMPARISON_METHODS:
        moved = start + off * START_PERTURBATION * signs * moving
        try:
            comparison, _ = trajectory_of(
                model,
                run.span,
                dict(zip(rows, moved.tolist(), strict=True)),
                RunOptions(method, tolerance, parameters=values),
            )
        except StatementError:
            continue
        yield f"{method} at {tolerance:g}" + (" from a perturbed start" if off else ""), comparison
