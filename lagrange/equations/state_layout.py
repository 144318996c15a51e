"""Layout of a state: the slices of its parts and the names of its entries."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any


@dataclass(frozen=True)
class StateLayout:
    """Layout of the state y = [q, v].

    `coordinates` are the names of q. `rates` are the names of the quantities whose derivatives are v: the same names if
    dq/dt is v.
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
        """Return the name of each entry: theta of a coordinate, theta_dot of a velocity; `ending` is the suffix."""
        return (*self.coordinates, *(f"{name}{ending}" for name in self.rates))
