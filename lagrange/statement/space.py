"""Vectors and matrices in space, and quaternions: their product, the matrix of one, and angular velocities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy

from lagrange.errors import StatementError, shown
from lagrange.statement.expression import as_typed, entries


class SpaceMatrix(sympy.ImmutableMatrix):
    """A vector or a matrix in space. A tuple, a list or an array of three entries counts as a vector beside it."""

    def __add__(self, other: Any) -> Any:
        return super().__add__(in_space(other))

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return super().__sub__(in_space(other))

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        return super().__mul__(in_space(other))


def in_space(value: Any) -> Any:
    """Return a tuple, list or array as a vector, and any other value unchanged."""
    if not isinstance(value, (tuple, list, np.ndarray)):
        return value
    parts = entries(value, "a vector in space")
    if parts is None or len(parts) != 3:
        raise StatementError(f"a vector in space is {shown(value)}: give three entries.")
    return SpaceMatrix([as_typed(part, "an entry of the vector") for part in parts])


x, y, z = (SpaceMatrix([int(i == k) for i in range(3)]) for k in range(3))
"""Unit vectors along the axes."""

Quaternion = tuple[Any, Any, Any, Any]


def product(a: Sequence[Any], b: Sequence[Any]) -> Quaternion:
    """Return the product of two quaternions."""
    (a0, a1, a2, a3), (b0, b1, b2, b3) = a, b
    return (
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 + a2 * b0 + a3 * b1 - a1 * b3,
        a0 * b3 + a3 * b0 + a1 * b2 - a2 * b1,
    )


def conjugate(q: Sequence[Any]) -> Quaternion:
    """Return the conjugate of a quaternion: the inverse rotation."""
    return q[0], -q[1], -q[2], -q[3]


def matrix_of(q: Sequence[Any]) -> list[list[Any]]:
    """Return the rotation matrix of a quaternion of any length, three rows."""
    w, i, j, k = q
    square = w**2 + i**2 + j**2 + k**2
    return [
        [(w**2 + i**2 - j**2 - k**2) / square, 2 * (i * j - w * k) / square, 2 * (i * k + w * j) / square],
        [2 * (i * j + w * k) / square, (w**2 - i**2 + j**2 - k**2) / square, 2 * (j * k - w * i) / square],
        [2 * (i * k - w * j) / square, 2 * (j * k + w * i) / square, (w**2 - i**2 - j**2 + k**2) / square],
    ]


def body_rates(q: Sequence[Any], velocities: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return the angular velocity about the axes of the body, three numbers or expressions.

    `q` is a quaternion of any length and `velocities` are its time derivatives, four each.
    """
    twice = 2 / sum(entry**2 for entry in q)
    _, i, j, k = product(conjugate(q), velocities)
    return twice * i, twice * j, twice * k


def space_rates(q: Sequence[Any], velocities: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return the angular velocity about the axes of space; see `body_rates`."""
    twice = 2 / sum(entry**2 for entry in q)
    _, i, j, k = product(velocities, conjugate(q))
    return twice * i, twice * j, twice * k


def velocities_at(q: Sequence[Any], rates: Sequence[Any], *, space: bool) -> Quaternion:
    """Return the time derivatives of a quaternion that turns with rates about the axes of the body, or of space."""
    w, i, j, k = product((0, *rates), q) if space else product(q, (0, *rates))
    return w / 2, i / 2, j / 2, k / 2


def cross_matrix(vector: Sequence[Any]) -> Any:
    """Return the matrix of the vector products with a vector of three entries, (3, 3)."""
    a, b, c = vector
    return sympy.Matrix([[0, -c, b], [c, 0, -a], [-b, a, 0]])
