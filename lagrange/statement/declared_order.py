"""The order in which names were declared, which is that of the states; it does not matter how SymPy sorts terms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from threading import Lock
from typing import Any


class DeclaredOrder:
    """An order of names, each at the place of its first declaration.

    What one call declares together is in the order of that call, whatever was declared before: its names share the
    places that they have, and new ones stand beside them. So another program that declares some of the same names
    again, in the same order, changes nothing.
    """

    def __init__(self) -> None:
        self.names: list[str] = []
        """The names in their order; the list is never changed, but replaced."""
        self._lock = Lock()

    def declare(self, names: Sequence[str]) -> None:
        """Enter the names of one call."""
        names = list(dict.fromkeys(names))
        with self._lock:
            known = iter(sorted(self.names.index(name) for name in names if name in self.names))
            old = [name for name in names if name in self.names]
            ordered = list(self.names)
            for name, place in zip(old, known, strict=True):
                ordered[place] = name
            for k, name in enumerate(names):
                if name not in ordered:
                    ordered.insert(_place(ordered, names[:k], names[k + 1 :]), name)
            self.names = ordered

    def of(self, leaves: Iterable[tuple[str, Any]]) -> list[Any]:
        """Return what is given with its names in the order of declaration, then the others as they come."""
        places = {name: place for place, name in enumerate(self.names)}
        return [leaf for _, leaf in sorted(leaves, key=lambda pair: places.get(pair[0], len(places)))]


def _place(ordered: Sequence[str], before: Sequence[str], behind: Sequence[str]) -> int:
    """Return where a new name goes: behind the one before it in its call, else before one behind it, else last."""
    if before:
        return ordered.index(before[-1]) + 1
    return next((ordered.index(name) for name in behind if name in ordered), len(ordered))


COORDINATES, PARAMETERS = DeclaredOrder(), DeclaredOrder()
