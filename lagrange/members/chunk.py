"""Some members of an ensemble: where they start, and what came of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from lagrange.members.varied import MemberNumbers
from lagrange.trajectory.trajectory import FloatArray, Status

STATUSES = tuple(Status)
"""The statuses by their codes."""

SUCCESS, INTERRUPTED = STATUSES.index(Status.SUCCESS), STATUSES.index(Status.INTERRUPTED)
"""Codes. A member that was not run, since the ensemble was interrupted before, is INTERRUPTED."""


@dataclass(frozen=True, eq=False)
class Starts:
    """Members that begin somewhere: states (m, 2n) and parameters (m, k), or (1, k) where all have the same."""

    states: FloatArray
    parameters: FloatArray

    def __len__(self) -> int:
        return len(self.states)

    def of(self, which: Any) -> Starts:
        """Return some of the members."""
        shared = len(self.parameters) == 1
        return Starts(self.states[which], self.parameters if shared else self.parameters[which])


@dataclass(frozen=True, eq=False)
class Ends:
    """What came of m members: columns by name, each with m rows; see `lagrange.members.keep`.

    `messages` has sentences of members that did not succeed.
    """

    columns: Mapping[str, Any]
    messages: dict[int, str] = field(default_factory=dict)

    @property
    def members(self) -> int:
        """The number of members."""
        return len(next(iter(self.columns.values())))


class Table(Protocol):
    """Members by their numbers, from 0 on."""

    def __len__(self) -> int:
        """Return how many there are."""

    def starts(self, which: MemberNumbers) -> Starts:
        """Return where some members start."""


Stopped = Callable[[], bool]
"""Whether the members that have not begun are to be left out."""


class Engine(Protocol):
    """Runs members; what a member gives depends on nothing but where it starts."""

    @property
    def form(self) -> str:
        """How members are run, in a few words."""

    @property
    def side_by_side(self) -> int:
        """How many members take as long as one."""

    def run(self, starts: Starts, stopped: Stopped) -> Ends:
        """Run members to their ends; where `stopped()` becomes true those that were run come back, the first ones."""
