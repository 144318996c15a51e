"""The failure of a step of a solver of another package."""

from __future__ import annotations

from dataclasses import dataclass

from lagrange.trajectory.trajectory import FloatArray, Status


@dataclass(frozen=True, eq=False)
class Fault:
    """The reason why a run ends, the state (2n,) for the message, and the state's derivative if it is not finite."""

    status: Status
    t: float
    y: FloatArray
    slope: FloatArray | None = None
    detail: str = ""
