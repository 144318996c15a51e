"""Settings of a run: their defaults, and their descriptions for the command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

DEFAULT_T_END = 10.0
"""Time at which a run ends if neither its caller nor its scene states one."""


DEFAULT_METHOD = "taylor"
"""Name of the integrator of a run for which neither its caller nor its scene names one.

At errors of 1e-6 and below it needs the least time of the methods here (docs/benchmarks/race.md).
"""

DESCRIPTIONS = {
    "t_end": f"time at which the run ends (default: that of the scene, or {DEFAULT_T_END:g})",
    "method": f"integrator, such as dop853 or rk4 (default: that of the scene, or {DEFAULT_METHOD})",
    "rtol": "relative tolerance of an adaptive method",
    "atol": "absolute tolerance of an adaptive method; by default it follows the size of each entry",
    "step": "step of a method with equal steps",
}
"""Descriptions of the settings, by name."""


@dataclass(frozen=True)
class RunSettings:
    """Settings of a run that a scene states; arguments of the caller override them. `events` is a tuple of `Event`."""

    t_end: float = DEFAULT_T_END
    method: str | None = None
    rtol: float | None = None
    atol: float | None = None
    step: float | None = None
    events: tuple[Any, ...] = ()
