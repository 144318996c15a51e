"""The order of a splitting, by words: one condition per word of kicks and drifts.

A product of exponentials of h times the Lie derivatives K (kick) and D (drift) agrees with exp(h (K + D)) up to h^p
when the coefficient of every word of n <= p letters is 1/n!; both are power series in two letters that do not
commute. Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, III.3 and III.5.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from math import factorial

from lagrange.errors import StatementError

WORD_TOLERANCE = 1e-13
"""Tolerance of a coefficient relative to the size of its terms."""

HIGHEST_CHECKED = 10
"""The highest order that is checked: there are 2046 words up to it."""


@lru_cache(maxsize=64)
def check_words(name: str, order: int, flows: tuple[tuple[str, float], ...]) -> None:
    """Check the order of a composition of ("kick" or "drift", part of a step). Raises StatementError if it fails."""
    if not 1 <= order <= HIGHEST_CHECKED:
        raise StatementError(f"{name} claims order {order}: orders from 1 to {HIGHEST_CHECKED} can be checked.")
    actual = coefficients(order, tuple((what[0], part) for what, part in flows))
    sizes = coefficients(order, tuple((what[0], abs(part)) for what, part in flows))
    for word, value in actual.items():
        expected = 1 / factorial(len(word))
        if not abs(value - expected) <= WORD_TOLERANCE * max(1.0, sizes[word]):
            shown = " ".join({"k": "kick", "d": "drift"}[letter] for letter in word)
            raise StatementError(
                f"{name} is not of order {order}: the coefficient of '{shown}', a condition of order {len(word)}, is "
                f"{value:.17g} instead of 1/{factorial(len(word))}."
            )


def coefficients(order: int, flows: tuple[tuple[str, float], ...]) -> dict[str, float]:
    """Return the coefficient of every word up to that length in the product of exponentials of c times a letter."""
    words = ["".join(letters) for n in range(order + 1) for letters in product("dk", repeat=n)]
    result = dict.fromkeys(words, 0.0) | {"": 1.0}
    for letter, c in flows:
        powers = [c**n / factorial(n) for n in range(order + 1)]
        result = {
            word: sum(result[word[: len(word) - n]] * powers[n] for n in range(_tail(word, letter) + 1))
            for word in words
        }
    return {word: value for word, value in result.items() if word}


def _tail(word: str, letter: str) -> int:
    """Return the number of repetitions of the letter at the end of a word."""
    return len(word) - len(word.rstrip(letter))
