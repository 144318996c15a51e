"""Where the parts of a state stand, and what its entries are called."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any


@dataclass(frozen=True)
class StateLayout:
    """The state y = [q, v]: where coordinates and velocities stand in it, and the names of both.

    `coordinates` are the names of q, `rates` those of what v is the derivative of: the same where dq/dt is v.
    """

    coordinates: tuple[str, ...]
    rates: tuple[str, ...]

    @property
    def size(self) -> int:
        """The number of entries."""
        return len(self.coordinates) + len(self.rates)

    @cached_property
    def q(self) -> slice:
        """The rows of the coordinates."""
        return slice(0, len(self.coordinates))

    @cached_property
    def v(self) -> slice:
        """The rows of the velocities."""
        return slice(len(self.coordinates), self.size)

    def split(self, y: Any) -> tuple[Any, Any]:
        """Return the coordinates and the velocities of a state, or of the columns of many."""
        return y[self.q], y[self.v]

    def names(self, ending: str = "_dot") -> tuple[str, ...]:
        """Return what to call each entry: theta, then theta_dot."""
        return (*self.coordinates, *(f"{name}{ending}" for name in self.rates))
