"""The order in which names were declared, which is that of the states; it does not matter how SymPy sorts terms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import count
from threading import Lock
from typing import Any


class DeclaredOrder:
    """The calls that declared names, and the order that they give to the names of one statement.

    A statement reads the latest calls back to the first that, together, declare all its names. Its names are in the
    order of these calls, and earlier declarations are without effect: a program that declares its names gets the same
    order whatever other programs declared before in the same process.
    """

    def __init__(self) -> None:
        self.calls: dict[int, tuple[str, ...]] = {}
        """Names by the number of the call. Calls whose names were all declared again later are left out."""
        self._latest: dict[str, int] = {}
        self._numbers = count()
        self._lock = Lock()

    def declare(self, names: Sequence[str]) -> None:
        """Enter the names of one call."""
        with self._lock:
            number = next(self._numbers)
            earlier = {self._latest[name] for name in names if name in self._latest}
            self._latest.update(dict.fromkeys(names, number))
            self.calls[number] = tuple(names)
            for call in earlier:
                if all(self._latest[name] != call for name in self.calls[call]):
                    del self.calls[call]

    def of(self, leaves: Iterable[tuple[str, Any]]) -> list[Any]:
        """Return what is given with its names in the order of declaration, then the others as they come."""
        pairs = list(leaves)
        names = {name for name, _ in pairs}
        with self._lock:
            first = min((self._latest[name] for name in names if name in self._latest), default=0)
            calls = [call for number, call in self.calls.items() if number >= first]
        order = dict.fromkeys(name for call in calls for name in call if name in names)
        places = {name: place for place, name in enumerate(order)}
        return [leaf for _, leaf in sorted(pairs, key=lambda pair: places.get(pair[0], len(places)))]


COORDINATES, PARAMETERS = DeclaredOrder(), DeclaredOrder()
