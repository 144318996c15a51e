"""Some members of an ensemble: where they start, what came of them, and the arrays of all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from lagrange.members.keep import STATUS, Column
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


class MemberResults(Protocol):
    """The results of all members: in memory, or in a store, where each column is read when it is asked for."""

    def column(self, name: str) -> Any:
        """Return a column, with a row for each member."""

    def row(self, name: str, member: int) -> Any:
        """Return the entry of a column for one member."""

    @property
    def messages(self) -> Mapping[int, str]:
        """Sentences of members that did not succeed, where they are known."""


@dataclass(frozen=True, eq=False)
class Results:
    """Columns by name."""

    columns: dict[str, Any]
    messages: dict[int, str] = field(default_factory=dict)

    @classmethod
    def empty(cls, members: int, columns: Sequence[Column]) -> Results:
        """Return the columns of members that were not run."""
        return cls({column.name: column.empty(members) for column in columns})

    def column(self, name: str) -> Any:
        """Return a column."""
        return self.columns[name]

    def row(self, name: str, member: int) -> Any:
        """Return the entry of a column for one member."""
        return self.columns[name][member]

    def take(self, first: int, ends: Ends) -> None:
        """Put the results of members from a number on into their places; what is cut off was not run."""
        for name in sorted(ends.columns, key=STATUS.__eq__):
            rows = ends.columns[name]
            self.columns[name][first : first + len(rows)] = rows
        self.messages.update({first + place: text for place, text in ends.messages.items()})
