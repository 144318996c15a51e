"""Random symmetric matrices of several kinds, from a random generator and the number of rows."""

from collections.abc import Callable
from typing import Any

import numpy as np

Matrix = Callable[[np.random.Generator, int], Any]


def positive(rng: np.random.Generator, n: int) -> Any:
    a = rng.normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


def negative(rng: np.random.Generator, n: int) -> Any:
    return -positive(rng, n)


def indefinite(rng: np.random.Generator, n: int) -> Any:
    a = rng.normal(size=(n, n))
    return a + a.T


def hollow(rng: np.random.Generator, n: int) -> Any:
    """Return a matrix with a zero diagonal, which needs exchanges of rows."""
    a = indefinite(rng, n)
    if n > 1:
        np.fill_diagonal(a, 0.0)
    return a if n != 2 or abs(a[0, 1]) > 0.1 else a + 1.0 - np.eye(2)


def permuted(rng: np.random.Generator, n: int) -> Any:
    """Return a matrix with ones on its antidiagonal."""
    return np.fliplr(np.eye(n))


def scaled(rng: np.random.Generator, n: int) -> Any:
    """Return a matrix whose rows have units that differ by sixteen orders of magnitude."""
    scale = 10.0 ** np.linspace(-8, 8, n)
    return positive(rng, n) * np.outer(scale, scale)


def dependent(rng: np.random.Generator, n: int) -> Any:
    """Return a singular matrix whose last row equals the first."""
    a = positive(rng, n)
    a[-1] = a[0]
    a[:, -1] = a[:, 0]
    a[-1, -1] = a[0, 0]
    return a if n > 1 else np.zeros((1, 1))


def empty_row(rng: np.random.Generator, n: int) -> Any:
    a = positive(rng, n)
    a[n // 2] = a[:, n // 2] = 0.0
    return a


def zero(rng: np.random.Generator, n: int) -> Any:
    return np.zeros((n, n))


def rank_one(rng: np.random.Generator, n: int) -> Any:
    return 3.0 * np.ones((n, n)) if n > 1 else np.zeros((1, 1))


REGULAR: tuple[Matrix, ...] = (positive, indefinite, hollow, permuted, scaled, negative)
SINGULAR: tuple[Matrix, ...] = (dependent, empty_row, zero, rank_one)
