"""The reference solution of a method comparison: states with an error bound, far more accurate than any method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

from lagrange.errors import RunError, StatementError, shown
from lagrange.evidence.precise_run import precise_run
from lagrange.statement.number import real_array, real_number
from lagrange.trajectory.flow import Flow
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.options import RunOptions
from lagrange.trajectory.trajectory import FloatArray

DIGITS = 22
"""Decimal digits of the reference: its errors are 1e-6 of those of doubles, since both grow by the same factor."""

LEAST_DIGITS, GREATEST_DIGITS = 18, 200

APART = 4
"""Number of digits by which the second run, which gives the error bound, has fewer than the reference.

Fewer digits change its intervals, the points on them and the steps of its differences.
"""

LONGEST = 180.0
"""Time limit of each run in multiple precision, in seconds."""

TIGHTEST = 1e-13
"""Tolerance of the second run that a reference by a method is compared with."""


@dataclass(frozen=True, eq=False)
class ReferenceSolution:
    """The reference states at each of the `times`, 2n numbers each, and a bound on their errors.

    `uncertainty` is in the norm of `error`; `about` is a phrase on the origin of the states.
    """

    times: tuple[float, ...]
    states: tuple[tuple[Any, ...], ...]
    uncertainty: float
    about: str

    def error(self, y: FloatArray, unit: FloatArray) -> float:
        """Return the largest difference from states y (2n, K), each entry in units of `unit` (2n,)."""
        if not np.isfinite(y).all():
            return np.inf
        return max(_distance(column, state, unit) for column, state in zip(y.T.tolist(), self.states, strict=True))


def reference_solution(
    problem: Problem, times: Sequence[float], given: Any, digits: int | None, unit: FloatArray, growth: float
) -> ReferenceSolution:
    """Return the reference solution at `times`.

    `given` is None for an independent run in multiple precision, an array (2n,) or (2n, K), or a method as name or
    instance. `digits` applies to multiple precision only. `growth` is the factor by which errors grow along the run.
    Raises StatementError for an unusable reference, and RunError if it cannot be computed.
    """
    if given is None:
        return _independent(problem, times, digits, unit, growth)
    if isinstance(given, (str, type)) or callable(getattr(given, "integrate", None)):
        return _by_method(problem, times, given, unit)
    states = real_array(given, "reference")
    states = states[:, None] if states.ndim == 1 else states
    if states.shape != (len(problem.y0), len(times)) or not np.isfinite(states).all():
        raise StatementError(
            f"reference has shape {np.shape(given)}: give the state at the end, ({len(problem.y0)},), or the states at "
            f"the {len(times)} times of the race, one column each, all of them finite; or a method."
        )
    bound = float((np.abs(np.spacing(states)) / 2 / unit[:, None]).max())
    return ReferenceSolution(tuple(times), tuple(map(tuple, states.T.tolist())), bound, "the states given as reference")


def _independent(
    problem: Problem, times: Sequence[float], digits: int | None, unit: FloatArray, growth: float
) -> ReferenceSolution:
    chosen = DIGITS if digits is None else digits
    if not growth < 10.0 ** (chosen - APART):
        raise RunError(
            f"a relative error grows by {growth:.0e} until t = {problem.t1:g}, so that {chosen} digits say nothing "
            "about the end, nor does any method in double precision. End the race earlier, or give more digits=."
        )
    model, start = problem.model, problem.y0.tolist()

    def run(precision: int) -> tuple[tuple[Any, ...], ...]:
        computed = precise_run(model, problem.parameters, problem.t0, start, times, digits=precision, max_wall=LONGEST)
        # Numbers of another context do not pickle; conversion keeps every digit.
        return tuple(tuple(map(mpmath.mp.convert, state)) for state in computed)

    try:
        rough, states = run(chosen - APART), run(chosen)
    except RunError as error:
        raise RunError(f"{error} Give the race another reference=, such as a method.") from error
    bound = max(_distance(a, b, unit) for a, b in zip(rough, states, strict=True))
    about = f"an independent run of {chosen} digits, from differences of the stated energies"
    return ReferenceSolution(tuple(times), states, bound, about)


def _by_method(problem: Problem, times: Sequence[float], given: Any, unit: FloatArray) -> ReferenceSolution:
    """Return the run of a method; its uncertainty is the difference from a second method at its tightest tolerance."""
    method = find(given)
    tightened = isinstance(given, str) and method.claims.adaptive
    other = "dopri5" if method.name == "dop853" else "dop853"
    first = _states(problem, times, given, TIGHTEST if tightened else None)
    second = _states(problem, times, other, TIGHTEST)
    bound = max(_distance(a, b, unit) for a, b in zip(first, second, strict=True))
    return ReferenceSolution(
        tuple(times), first, bound, f"a run of {method.name}, held against {other} at its tightest"
    )


def _states(problem: Problem, times: Sequence[float], method: Any, tolerance: float | None) -> tuple[Any, ...]:
    """Return the states at the times. Each is the end of a run from the previous time, so none is interpolated."""
    flow = Flow(problem.model, RunOptions(method, tolerance))
    y, now, found = problem.y0, problem.t0, []
    for then in times:
        y = flow(y, now, then, problem.parameters)
        now = then
        found.append(tuple(y.tolist()))
    return tuple(found)


def _distance(y: Sequence[Any], other: Sequence[Any], unit: FloatArray) -> float:
    """Return the largest difference of two states, each entry in units of `unit`."""
    # The subtraction is done in mpmath if one operand is its number; doubles would round small differences to zero.
    return max(abs(float(b - a)) / float(scale) for a, b, scale in zip(y, other, unit, strict=True))


def digits_of(given: Any) -> int:
    """Return a checked number of digits. Raises StatementError if it is not a whole number in the allowed range."""
    number = real_number(given, "digits")
    if number != int(number) or not LEAST_DIGITS <= number <= GREATEST_DIGITS:
        raise StatementError(
            f"digits = {shown(given)}: give a whole number from {LEAST_DIGITS} to {GREATEST_DIGITS}; doubles have 16."
        )
    return int(number)
