"""What went wrong on a step of a solver that says so itself."""

from __future__ import annotations

from dataclasses import dataclass

from lagrange.trajectory.trajectory import FloatArray, Status


@dataclass(frozen=True, eq=False)
class Fault:
    """Why a run ends, and the state (2n,) to speak of, with its derivative where that is what went wrong."""

    status: Status
    t: float
    y: FloatArray
    slope: FloatArray | None = None
    detail: str = ""
