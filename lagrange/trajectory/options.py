"""The options of a run beside its model, its span and its initial state, as one record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from lagrange.errors import StatementError
from lagrange.statement.number import real_number, whole_number

MAX_STEPS = 10_000_000
"""Most trial steps of a run, accepted or not; the states of a double pendulum then take 0.4 GB."""


@dataclass(frozen=True, eq=False)
class RunOptions:
    """The options of `lagrange.integrate` as given; None leaves the choice to the method or the scene."""

    method: Any = None
    rtol: float | None = None
    atol: float | None = None
    step: float | None = None
    t_eval: ArrayLike | None = None
    events: Any = None
    max_steps: int | None = None
    max_wall: float | None = None
    max_memory: float | None = None
    parameters: Mapping[Any, Any] | None = None

    @property
    def step_limit(self) -> int:
        """The most trial steps. Raises StatementError if it is not a whole number of at least 1."""
        return MAX_STEPS if self.max_steps is None else whole_number(self.max_steps, "max_steps", 1)

    @property
    def wall_limit(self) -> float | None:
        """The most seconds of the run. Raises StatementError if it is not a positive number."""
        return _positive(self.max_wall, "max_wall", "seconds")

    @property
    def memory_limit(self) -> float | None:
        """The most bytes that the run may keep. Raises StatementError if it is not a positive number."""
        return _positive(self.max_memory, "max_memory", "bytes")


DEFAULT_OPTIONS = RunOptions()
"""No option is given."""


def _positive(limit: float | None, name: str, unit: str) -> float | None:
    if limit is None:
        return None
    number = real_number(limit, name)
    if number <= 0:
        raise StatementError(f"{name} = {limit}: give a positive number of {unit}.")
    return number
