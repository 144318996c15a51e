"""Vectors, matrices and quaternions in space: products, rotation matrices, angular velocities, moments of inertia.

`check_triangle` refuses moments of inertia that no body has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Sized
from contextlib import suppress
from typing import Any

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray
from sympy.matrices.exceptions import ShapeError

from lagrange.errors import StatementError, UnknownKey, shown
from lagrange.statement.expression import TEXTS, NonScalar, as_typed, entries, real_number


class SpaceMatrix(sympy.ImmutableMatrix):
    """Vector or matrix in space. In its operations a tuple, list or array of three entries counts as a vector."""

    def __getitem__(self, index: Any) -> Any:
        try:
            return super().__getitem__(index)
        except IndexError:
            kind, use = ("vector", "the entries") if 1 in self.shape else ("3 by 3 matrix", "rows and columns")
            raise UnknownKey(f"a {kind} in space has no entry {shown(index)}: {use} are 0, 1 and 2.") from None

    def __add__(self, other: Any) -> Any:
        return self._combined(super().__add__, other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self._combined(super().__sub__, other)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        return self._combined(super().__mul__, other)

    def __pow__(self, exponent: Any) -> Any:
        if self.rows != self.cols:
            raise StatementError("a vector has no powers: its square is a.dot(a), such as R.body.dot(R.body).")
        return super().__pow__(exponent)

    def _combined(self, operation: Callable[[Any], Any], other: Any) -> Any:
        """Return the result of a matrix operation with `other`. Raises StatementError for shapes that do not fit."""
        second = in_space(other)
        try:
            result = operation(second)
            if result is NotImplemented and not isinstance(second, NonScalar):
                raise StatementError(
                    f"a vector or matrix and {shown(other)} have no sum: give three entries (x, y, z)."
                )
            return result
        except ShapeError:
            raise StatementError(
                f"a vector or matrix of shape {self.shape} does not fit one of shape {second.shape}: a.dot(b) and "
                "a.cross(b) are the products of vectors in space, and a matrix is left of the vector."
            ) from None
        except StatementError:  # `other` is a rotation, which refuses the operation
            raise
        except ValueError:  # SymPy raises SympifyError, or ValueError for NaN
            raise StatementError(
                f"{shown(other)} is neither a number nor a vector: give an expression, or three entries (x, y, z)."
            ) from None


def in_space(value: Any) -> Any:
    """Return a tuple, list or array of three entries as a vector, and any other value unchanged.

    Raises StatementError for other numbers of entries.
    """
    if not isinstance(value, (tuple, list, np.ndarray)):
        return value
    parts = entries(value, "a vector in space")
    if parts is None or len(parts) != 3:
        raise StatementError(f"a vector in space is {shown(value)}: give three entries, (x, y, z).")
    return SpaceMatrix([as_typed(part, "an entry of the vector") for part in parts])


x, y, z = (SpaceMatrix([int(i == k) for i in range(3)]) for k in range(3))  # Unit vectors along the axes

Quaternion = tuple[Any, Any, Any, Any]


class Turn(tuple[float, float, float, float]):
    """Quaternion of length one, scalar first. The product a*b rotates by b and then by a."""

    def __mul__(self, other: Any) -> Any:
        return Turn(product(self, other)) if isinstance(other, Turn) else super().__mul__(other)


def product(a: Sequence[Any], b: Sequence[Any]) -> Quaternion:
    """Return the product of two quaternions, each with the scalar first."""
    (a0, a1, a2, a3), (b0, b1, b2, b3) = a, b
    return (
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 + a2 * b0 + a3 * b1 - a1 * b3,
        a0 * b3 + a3 * b0 + a1 * b2 - a2 * b1,
    )


def conjugate(q: Sequence[Any]) -> Quaternion:
    """Return the conjugate of a quaternion, which is the inverse rotation."""
    return q[0], -q[1], -q[2], -q[3]


def length_excess(q: Sequence[Any]) -> Any:
    """Return |q|**2 - 1 for a quaternion, scalar first, as an expression with small rounding errors.

    |q|**2 itself would be rounded before 1 is subtracted, with the same error at many steps of a run.
    """
    w, i, j, k = q
    return (w - 1) * (w + 1) + i**2 + j**2 + k**2


def matrix_of(q: Sequence[Any]) -> list[list[Any]]:
    """Return the rotation matrix, as three rows, of a quaternion q of any length other than zero, scalar first."""
    w, i, j, k = q
    square = w**2 + i**2 + j**2 + k**2
    return [
        [(w**2 + i**2 - j**2 - k**2) / square, 2 * (i * j - w * k) / square, 2 * (i * k + w * j) / square],
        [2 * (i * j + w * k) / square, (w**2 - i**2 + j**2 - k**2) / square, 2 * (j * k - w * i) / square],
        [2 * (i * k - w * j) / square, 2 * (j * k + w * i) / square, (w**2 - i**2 - j**2 + k**2) / square],
    ]


def body_rates(q: Sequence[Any], velocities: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return the angular velocity about the axes of the body, three numbers or expressions.

    `q` is a quaternion of any length, scalar first, and `velocities` are the time derivatives of its four entries.
    """
    twice = 2 / sum(entry**2 for entry in q)
    _, i, j, k = product(conjugate(q), velocities)
    return twice * i, twice * j, twice * k


def space_rates(q: Sequence[Any], velocities: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return the angular velocity about the axes of space, from a quaternion and the derivatives of its entries."""
    twice = 2 / sum(entry**2 for entry in q)
    _, i, j, k = product(velocities, conjugate(q))
    return twice * i, twice * j, twice * k


def velocities_at(q: Sequence[Any], rates: Sequence[Any], *, space: bool) -> Quaternion:
    """Return the time derivatives of the four entries of a quaternion `q`, from three angular velocities `rates`.

    If `space` is true, the rates are about the axes of space, else about those of the body.
    """
    w, i, j, k = product((0, *rates), q) if space else product(q, (0, *rates))
    return w / 2, i / 2, j / 2, k / 2


def cross_matrix(vector: Sequence[Any]) -> Any:
    """Return the matrix (3, 3) whose product with a vector x is the cross product of `vector` with x."""
    a, b, c = vector
    return sympy.Matrix([[0, -c, b], [c, 0, -a], [-b, a, 0]])


LARGEST_DEVIATION = 1e-9
"""Largest deviation of a user's value from a rotation: of M^T M from the unit matrix, or of a quaternion's length from
one."""


def turn(axis: ArrayLike, angle: float) -> Turn:
    """Return the initial value of a rotation by `angle`, in radians, about `axis`, a vector of any length.

    The result is a quaternion of length one, scalar first. The product a*b of two results rotates by b and then by a.
    Raises StatementError for an axis that is zero or not a vector of three numbers.
    """
    parts = () if isinstance(axis, TEXTS) else entries(axis, "the axis") or [axis]
    along = np.array([real_number(part, "an entry of the axis") for part in parts])
    if along.shape != (3,) or not along.any():
        raise StatementError(f"the axis of a turn is {shown(axis)}: give three numbers that are not all zero, or lg.x.")
    half = real_number(angle, "the angle of a turn") / 2
    # A power of two scales without rounding; the squares of very long and very short axes overflow or underflow.
    along = np.ldexp(along, -np.frexp(np.abs(along).max())[1])
    i, j, k = (float(part) for part in np.sin(half) * along / np.linalg.norm(along))
    return Turn((float(np.cos(half)), i, j, k))


def quaternion_of(value: Any, what: str) -> Quaternion:
    """Return the quaternion of a user's value of a rotation, which is a quaternion or a rotation matrix.

    `what` names the value in messages, such as "the start of R". Raises StatementError, with the deviation, for a value
    that is not a rotation.
    """
    numbers = np.zeros(0)
    # SymPy raises any of these for an object that is not a number.
    with suppress(TypeError, ValueError, OverflowError, IndexError, RecursionError):
        # A SymPy matrix has 9 entries. A longer sequence, such as range(10**9), might not fit into memory as an array.
        if not isinstance(value, Sized) or len(value) <= 9:
            numbers = np.array(value, dtype=object).astype(float)
    if numbers.shape not in ((4,), (3, 3)) or not np.isfinite(numbers).all():
        raise StatementError(
            f"{what} is {shown(value)}: give lagrange.turn(axis, angle), a quaternion of four numbers, "
            "scalar first, or a matrix of 3 by 3 numbers."
        )
    if numbers.shape == (4,):
        size = float(np.linalg.norm(numbers))
        if abs(size - 1) > LARGEST_DEVIATION:
            raise StatementError(of_length(what, size))
        return tuple((numbers / size).tolist())
    if (off := float(np.abs(numbers.T @ numbers - np.eye(3)).max())) > LARGEST_DEVIATION:
        raise StatementError(
            f"{what} is not a rotation: its matrix times its transpose differs from the unit matrix by "
            f"{off:.3g}. Give all digits, lagrange.turn(axis, angle), or the nearest rotation: u @ vh, with u, _, vh = "
            "numpy.linalg.svd(matrix)."
        )
    if np.linalg.det(numbers) < 0:
        raise StatementError(f"{what} is a reflection, with determinant -1: change the sign of one axis.")
    from scipy.spatial.transform import Rotation as Matrix

    i, j, k, w = Matrix.from_matrix(numbers).as_quat().tolist()
    return w, i, j, k


def of_length(what: str, size: float) -> str:
    """Return the message for a quaternion `what`, such as "the start of R", of the length `size` instead of one."""
    return (
        f"{what} is a quaternion of length {size:.9g}: divide each of its four entries by this length. In Python, "
        "lagrange.turn(axis, angle) is a quaternion of length 1."
    )


def check_triangle(inertias: NDArray[np.float64], name: str) -> None:
    """Raise StatementError if one of the inertia matrices (m, 3, 3) is impossible for a body.

    No principal moment is negative, or larger than the sum of the two others. `name` is the rotation in the message.
    """
    moments = np.linalg.eigvalsh(inertias)
    low, high = -LARGEST_DEVIATION * moments[:, 2], moments[:, :2].sum(axis=1) * (1 + LARGEST_DEVIATION)
    wrong = np.flatnonzero((moments[:, 0] < low) | (moments[:, 2] > high))
    if wrong.size:
        least, middle, most = moments[wrong[0]]
        law = "a moment below zero" if least < low[wrong[0]] else "a moment above the sum of the other two"
        raise StatementError(
            f"the moments of inertia of {name} are {least:.6g}, {middle:.6g} and {most:.6g}: no body has {law}."
        )
