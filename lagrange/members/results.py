"""What came of all members, as arrays that chunks are put into."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from lagrange.members.chunk import Ends
from lagrange.members.keep import STATUS, Column


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
