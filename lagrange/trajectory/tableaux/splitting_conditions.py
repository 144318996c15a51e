"""Order conditions of a splitting: one condition for each word, a sequence of the letters K (kick) and D (drift).

A step is a product of exponentials of h times the Lie derivatives K and D. It is a power series in two letters that do
not commute, and so is the exact flow exp(h (K + D)). They agree up to h^p if the coefficient of every word of n <= p
letters is 1/n!. Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, III.3, III.5.
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
    """Raise StatementError if a composition of `flows`, ("kick" or "drift", step fraction), is not of the `order`."""
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
    """Return the coefficients of all words of at most `order` letters in a product of exponentials.

    `flows` has the factors exp(c * letter) as pairs (letter, c), with the letters "k" and "d".
    """
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
