"""Conditions of typed cases: comparisons joined by "and", "or" and "not", and values that are taken under them.

The notation of scene files has no such words: there a value under a condition is written as values under comparisons.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import permutations, product, starmap
from typing import NamedTuple

MOST_ALTERNATIVES = 64  # Most ways to leave all cases that are followed

_OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}
_TURNED = {">": "<", ">=": "<="}


class Comparison(NamedTuple):
    """A comparison of two expressions in the notation of scene files. `sign` is one of <, <=, > and >=."""

    left: str
    sign: str
    right: str


@dataclass(frozen=True)
class Condition:
    """A condition: it holds if all comparisons of one of the `alternatives` hold."""

    alternatives: tuple[tuple[Comparison, ...], ...]

    def __len__(self) -> int:
        """Return the number of comparisons."""
        return sum(map(len, self.alternatives))

    def either(self, other: Condition) -> Condition:
        """Return the condition that this one or the `other` one holds."""
        return Condition(self.alternatives + other.alternatives)

    def both(self, other: Condition) -> Condition:
        """Return the condition that this one and the `other` one hold."""
        pairs = product(self.alternatives, other.alternatives)
        return Condition(tuple(first + second for first, second in pairs))

    def opposite(self) -> Condition:
        """Return the condition that this one does not hold."""
        opposites = [[Comparison(a, _OPPOSITE[sign], b) for a, sign, b in each] for each in self.alternatives]
        return Condition(tuple(product(*opposites)))

    def chosen(self, value: str, rest: str) -> str:
        """Return the text, as in scene files, for `value` where the condition holds, and `rest` elsewhere."""
        for alternative in reversed(self.alternatives):
            inside = value
            for k, comparison in enumerate(_chained(alternative)):
                inside = f"({inside})" if k else inside
                inside = f"{inside} if {comparison} else {rest}"
            rest = inside
        return rest


def cover(conditions: Iterable[Condition]) -> bool:
    """Return True if one of the conditions holds everywhere, except where two compared expressions are equal."""
    left = Condition(((),))
    for condition in conditions:
        both = left.both(condition.opposite())
        left = Condition(tuple(each for each in both.alternatives if not _contradict(each)))
        if len(left.alternatives) > MOST_ALTERNATIVES:
            return False
    return not left.alternatives


def _contradict(comparisons: tuple[Comparison, ...]) -> bool:
    """Return True if two of the comparisons hold together at most where the two sides of both are equal."""
    pairs = permutations(starmap(_rising, comparisons), 2)
    return any(first.left == second.right and first.right == second.left for first, second in pairs)


def _chained(comparisons: tuple[Comparison, ...]) -> Iterator[str]:
    """Yield the texts of comparisons that hold together; two of the same expression become one: 0 < x < d."""
    left = list(comparisons)
    while left:
        first = left.pop(0)
        for other in left:
            low, high = starmap(_rising, (first, other))
            low, high = (low, high) if low.right == high.left else (high, low)
            if low.right == high.left and not low.right[0].isdigit():
                left.remove(other)
                yield f"{' '.join(low)} {high.sign} {high.right}"
                break
        else:
            yield " ".join(first)


def _rising(left: str, sign: str, right: str) -> Comparison:
    """Return the same comparison with the sign < or <=."""
    return Comparison(right, _TURNED[sign], left) if sign in _TURNED else Comparison(left, sign, right)
