"""A chunk of members of an ensemble: their initial values and results, and the arrays of all results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from lagrange.members.kept_results import STATUS, Column
from lagrange.trajectory.trajectory import FloatArray, Status

STATUSES = tuple(Status)
"""Statuses by code, the index in this tuple."""

SUCCESS, INTERRUPTED = STATUSES.index(Status.SUCCESS), STATUSES.index(Status.INTERRUPTED)
"""Codes of two statuses. A member that was not run because the ensemble was interrupted is INTERRUPTED."""


@dataclass(frozen=True, eq=False)
class Starts:
    """Initial values of m members: states (m, 2n) and parameters (m, k), or (1, k) if all members share them."""

    states: FloatArray
    parameters: FloatArray

    def __len__(self) -> int:
        return len(self.states)

    def of(self, which: Any) -> Starts:
        """Return the initial values of the members `which`, a slice or indices."""
        shared = len(self.parameters) == 1
        return Starts(self.states[which], self.parameters if shared else self.parameters[which])


@dataclass(frozen=True, eq=False)
class Ends:
    """The results of m members: `columns` by name, each with m rows. `kept_results` defines the columns.

    `messages` maps the index of each member that did not succeed, counted in this chunk, to the message of its run.
    """

    columns: Mapping[str, Any]
    messages: dict[int, str] = field(default_factory=dict)

    @property
    def members(self) -> int:
        """The number m of members."""
        return len(next(iter(self.columns.values())))


Stopped = Callable[[], bool]
"""Callback that returns True if no further member may begin."""


@runtime_checkable
class MemberResults(Protocol):
    """Protocol of the results of all members of an ensemble, in memory, or in a store that is read at each access."""

    def column(self, name: str) -> Any:
        """Return the results `name` of all members, an array with a row for each member."""

    def row(self, name: str, member: int) -> Any:
        """Return the result `name` of one member, given by its index."""

    @property
    def messages(self) -> Mapping[int, str]:
        """The known messages of runs that did not succeed, by the index of the member."""

    @property
    def left(self) -> Sequence[tuple[int, int]]:
        """The blocks of members, as pairs (first, end), that had no results when the call began."""

    def take(self, first: int, ends: Ends) -> None:
        """Store the results `ends` of a chunk of members. `first` is the index of its first member."""

    def close(self) -> None:
        """Finish storing results, after the last chunk or an error."""


@dataclass(frozen=True, eq=False)
class Results:
    """The results of all members of an ensemble in memory: arrays by column name, and messages by member index."""

    columns: dict[str, Any]
    messages: dict[int, str] = field(default_factory=dict)

    @classmethod
    def empty(cls, members: int, columns: Sequence[Column]) -> Results:
        """Return results in which no member has a result yet: every row has the blank value of its column."""
        return cls({column.name: column.empty(members) for column in columns})

    def column(self, name: str) -> Any:
        """Return the results `name` of all members, an array with a row for each member."""
        return self.columns[name]

    def row(self, name: str, member: int) -> Any:
        """Return the result `name` of one member, given by its index."""
        return self.columns[name][member]

    @property
    def left(self) -> Sequence[tuple[int, int]]:
        """The bounds (first, end) of all members as one block, since no member has results at the start."""
        return [(0, len(next(iter(self.columns.values()))))]

    def close(self) -> None:
        """Do nothing: arrays need no closing."""

    def take(self, first: int, ends: Ends) -> None:
        """Copy the results `ends` of a chunk of members to the rows from `first` on."""
        for name in sorted(ends.columns, key=STATUS.__eq__):
            rows = ends.columns[name]
            self.columns[name][first : first + len(rows)] = rows
        self.messages.update({first + row: text for row, text in ends.messages.items()})
