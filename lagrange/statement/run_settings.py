"""Settings of a run that a scene may state, their defaults such as rtol, and the time limit for deriving and compiling.

All options of a run, such as atol and max_steps, are in `RunOptions`, lagrange/trajectory/integrator.py. Loops that
derive or compile, and may take long, call `check_time`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

from lagrange.errors import LagrangeError

DEFAULT_T_END = 10.0  # End time of a run if neither its caller nor its scene states one


DEFAULT_METHOD = "taylor"
"""Name of the integrator of a run if neither its caller nor its scene names one.

At errors of 1e-6 and below it needs the least time of all methods in the package (docs/benchmarks/race.md).
"""

DEFAULT_RTOL = 1e-9
"""Relative tolerance of an adaptive method if neither the caller nor the scene of a run states one.

On the double pendulum over 20 s, with both angles 30 degrees at the start, DOP853 then ends within 5e-9 of a run at
1e-13, in 0.5 ms. At 1e-6 the difference would be 1e-5; SciPy's default is 1e-3.
"""

REDUCTIONS = ("max", "min", "mean")
"""Names of functions that reduce the values of an expression along a run of an ensemble to one number."""

DESCRIPTIONS = {
    "t_end": f"time at which the run ends (default: that of the scene, or {DEFAULT_T_END:g})",
    "method": f"integrator, such as dop853 or rk4 (default: that of the scene, or {DEFAULT_METHOD})",
    "rtol": f"relative tolerance of an adaptive method (default: {DEFAULT_RTOL:g})",
    "atol": "absolute tolerance of an adaptive method; by default it follows the size of each entry",
    "step": "step of a method with fixed steps",
}
"""Descriptions of the settings of a run, by name."""


@dataclass(frozen=True)
class RunSettings:
    """Settings of a run that a scene states. Arguments of a call override them.

    `t_end` is in the unit of time of the system. None means the default of the method or run. `events` is a tuple of
    `Event`.
    """

    t_end: float = DEFAULT_T_END
    method: str | None = None
    rtol: float | None = None
    atol: float | None = None
    step: float | None = None
    events: tuple[Any, ...] = ()


COMPILE_SECONDS = 5.0
"""Least time limit of the preparation of a run, in seconds, even if `max_wall` is smaller, since compiled code serves
many runs."""

CHECKED_EVERY = 512
"""Number of nodes, rules or instructions between two checks of the clock: about 5 ms of work."""


class PreparationTooLongError(LagrangeError):
    """Error: deriving or compiling took longer than the time limit.

    `model` is the model that was to run, None before its equations are known. The class is not a RunError, since some
    callers treat a RunError as a missing value.
    """

    model: Any = None


_LIMIT: ContextVar[tuple[float, float] | None] = ContextVar("begin and time limit of a preparation", default=None)


def preparation(began: float, seconds: float | None) -> AbstractContextManager[None]:
    """Return a context manager that limits the time for deriving and compiling before a run to `seconds` after `began`.

    `began` is a time of `time.perf_counter`. The limit ends with the block or when `preparation_ends` is called. None
    sets no limit, and less than `COMPILE_SECONDS` counts as `COMPILE_SECONDS`.
    """
    return _UNLIMITED if seconds is None else _limited(began, seconds)


_UNLIMITED = nullcontext()  # Context without a limit, used again for every short run


@contextmanager
def _limited(began: float, seconds: float) -> Iterator[None]:
    token = _LIMIT.set((began, seconds))
    try:
        yield
    finally:
        _LIMIT.reset(token)


def preparation_ends() -> None:
    """Remove the time limit of `preparation` for the rest of the block, because the steps of the run begin."""
    _LIMIT.set(None)


def check_time() -> None:
    """Raise PreparationTooLongError if deriving and compiling have exceeded the time limit of `preparation`."""
    limit = _LIMIT.get()
    if limit is None:
        return
    elapsed = time.perf_counter() - limit[0]
    if elapsed > max(limit[1], COMPILE_SECONDS):
        raise PreparationTooLongError(
            f"Compiling was stopped after {elapsed:.3g} s, more than max_wall = {limit[1]:.6g} s. "
            "Raise max_wall, state a smaller system, or take a method that compiles less, such as dop853."
        )
