"""Which like values belong together: those that the same rules read in the same place, and those made of such.

The coordinates of a distance are an example: the squares of all x stand side by side, and behind them those of all y in
the same order, so that their sums read vectors as they stand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lagrange.program.series import SeriesProgram

Members = Sequence[int]

MOST_VECTORS = 1.1
"""A group is divided if that takes at most so many times as many vectors, whose last lanes are empty."""


class Alignment:
    """Divides groups of like values into parts, where that takes few more vectors; `vectors` counts those of a part."""

    def __init__(self, program: SeriesProgram, groups: Sequence[Members], vectors: Callable[[int], int]) -> None:
        self.program, self.vectors = program, vectors
        self.part: dict[int, tuple[int, ...]] = {}
        """The number of each value's group, and that of its part."""
        self.reader: dict[int, int] = {}
        """The first rule that reads a value of a part that is divided by what reads it."""
        for number, members in enumerate(groups):
            self.part |= dict.fromkeys(members, (number,))
        readers: dict[int, list[tuple[int, int]]] = {}
        for i in self.part:
            for place, arg in enumerate(program.rules[i].args):
                readers.setdefault(arg, []).append((i, place))
        for members in reversed(groups):
            roles = {i: self.role(readers.get(i, [])) for i in members}
            if self.divide(members, roles):
                self.reader |= {i: min(readers[i])[0] for i in members if i in readers}
        for members in groups:
            if len(dict.fromkeys(self.part[i] for i in members)) == 1:
                self.divide(members, {i: self.made_of(i) for i in members})

    def role(self, readers: Sequence[tuple[int, int]]) -> Any:
        """Return which parts read a value, and where."""
        return tuple(sorted(dict.fromkeys((self.part[i], place) for i, place in readers)))

    def made_of(self, i: int) -> Any:
        """Return of which parts a value is made."""
        return tuple(sorted(self.part.get(arg, ()) for arg in self.program.rules[i].args))

    def divide(self, members: Members, keys: Mapping[int, Any]) -> bool:
        """Divide a group by keys, unless that takes too many vectors; return whether it was divided."""
        found: dict[Any, list[int]] = {}
        for i in members:
            found.setdefault(keys[i], []).append(i)
        apart, together = sum(self.vectors(len(part)) for part in found.values()), self.vectors(len(members))
        if len(found) == 1 or apart > together * MOST_VECTORS:
            return False
        for number, part in enumerate(found.values()):
            for i in part:
                self.part[i] = (*self.part[i], number)
        return True

    def parts(self, members: Members) -> list[list[int]]:
        """Return the parts of a group."""
        found: dict[tuple[int, ...], list[int]] = {}
        for i in members:
            found.setdefault(self.part.get(i, ()), []).append(i)
        return list(found.values())
