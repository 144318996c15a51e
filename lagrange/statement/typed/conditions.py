"""Conditions of typed cases: comparisons joined by "and", "or" and "not". Tell whether cases cover all states."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
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
    """A condition, with its `text` in the notation of scene files.

    It holds if all comparisons of one of the `alternatives` hold.
    """

    text: str
    alternatives: tuple[tuple[Comparison, ...], ...]

    def __len__(self) -> int:
        """Return the number of comparisons."""
        return sum(map(len, self.alternatives))

    def either(self, other: Condition) -> Condition:
        """Return the condition that this one or the `other` one holds."""
        return Condition(f"{self.text} or {other.text}", self.alternatives + other.alternatives)

    def both(self, other: Condition) -> Condition:
        """Return the condition that this one and the `other` one hold."""
        texts = (f"({text})" if " or " in text else text for text in (self.text, other.text))
        pairs = product(self.alternatives, other.alternatives)
        return Condition(" and ".join(texts), tuple(first + second for first, second in pairs))

    def opposite(self) -> Condition:
        """Return the condition that this one does not hold."""
        opposites = [[Comparison(a, _OPPOSITE[sign], b) for a, sign, b in each] for each in self.alternatives]
        return Condition(f"not ({self.text})", tuple(product(*opposites)))


def compared(parts: Sequence[str], signs: Sequence[str]) -> Condition:
    """Return the condition of a chain such as 0 < x < 1. `signs` are the signs between its `parts`."""
    text = " ".join((parts[0], *(f"{sign} {part}" for sign, part in zip(signs, parts[1:], strict=True))))
    return Condition(text, (tuple(map(Comparison, parts, signs, parts[1:])),))


def cover(conditions: Iterable[Condition]) -> bool:
    """Return True if one of the conditions holds everywhere, except where two compared expressions are equal."""
    left = Condition("", ((),))
    for condition in conditions:
        both = left.both(condition.opposite())
        left = replace(both, alternatives=tuple(each for each in both.alternatives if not _contradict(each)))
        if len(left.alternatives) > MOST_ALTERNATIVES:
            return False
    return not left.alternatives


def _contradict(comparisons: tuple[Comparison, ...]) -> bool:
    """Return True if two of the comparisons hold together at most where the two sides of both are equal."""
    pairs = permutations(starmap(_rising, comparisons), 2)
    return any(first.left == second.right and first.right == second.left for first, second in pairs)


def _rising(left: str, sign: str, right: str) -> Comparison:
    """Return the same comparison with the sign < or <=."""
    return Comparison(right, _TURNED[sign], left) if sign in _TURNED else Comparison(left, sign, right)
