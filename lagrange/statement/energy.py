"""Energies of common parts, so that nobody squares velocities by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy

from lagrange.errors import StatementError
from lagrange.statement.coordinate import t


def kinetic_energy(mass: Any, position: Sequence[Any] | Any) -> Any:
    """Return m |dr/dt|^2 / 2 of a point mass at `position`, a vector of any length (or one expression)."""
    return mass * sum((sympy.diff(x, t) ** 2 for x in _vector(position, "position")), sympy.S.Zero) / 2


def rotational_energy(inertia: Any, angular_velocity: Any) -> Any:
    """Return w . I w / 2.

    `inertia` is a scalar, a vector of principal moments (k,) or a matrix (k, k); `angular_velocity` a scalar
    or a vector (k,) in the same axes.
    """
    omega = sympy.Matrix(_vector(angular_velocity, "angular velocity"))
    k = omega.rows
    if isinstance(inertia, sympy.MatrixBase) and 1 not in inertia.shape:
        tensor = sympy.Matrix(inertia)
    elif isinstance(inertia, (Sequence, sympy.MatrixBase)):
        rows = list(inertia)
        if len(rows) != k:
            raise StatementError(
                f"the inertia has {len(rows)} entries and the angular velocity {k}: give as many moments as components."
            )
        tensor = sympy.Matrix(rows) if isinstance(rows[0], Sequence) else sympy.diag(*rows)
    else:
        tensor = inertia * sympy.eye(k)
    if tensor.shape != (k, k):
        raise StatementError(
            f"the inertia has shape {tensor.shape} and the angular velocity {k} components: give a ({k}, {k}) tensor."
        )
    return (omega.T * tensor * omega)[0, 0] / 2


def gravity(mass: Any, position: Sequence[Any] | Any, g: Any, up: Sequence[Any] | None = None) -> Any:
    """Return m g times the height of `position` along `up`, by default the last axis: y in the plane, z in space."""
    point = _vector(position, "position")
    direction = _vector([0] * (len(point) - 1) + [1] if up is None else up, "upward direction")
    if len(direction) != len(point):
        raise StatementError(f"up has {len(direction)} components and the position {len(point)}: give as many.")
    length = sympy.sqrt(sum(d**2 for d in direction))
    if length == 0:
        raise StatementError("up is the zero vector: give a direction such as (0, 1).")
    return mass * g * sum((d * x for d, x in zip(direction, point, strict=True)), sympy.S.Zero) / length


def spring(stiffness: Any, a: Sequence[Any] | Any, b: Sequence[Any] | Any, rest_length: Any = 0) -> Any:
    """Return k (|a - b| - rest_length)^2 / 2 of a spring between two points of the same dimension."""
    start, end = _vector(a, "first end"), _vector(b, "second end")
    if len(start) != len(end):
        raise StatementError(f"the ends of the spring have {len(start)} and {len(end)} components: give as many.")
    squared = sum(((p - q) ** 2 for p, q in zip(start, end, strict=True)), sympy.S.Zero)
    if rest_length == 0:
        return stiffness * squared / 2
    return stiffness * (sympy.sqrt(squared) - rest_length) ** 2 / 2


def _vector(value: Any, what: str) -> list[Any]:
    """Return the entries of a sequence or matrix, or of a single expression."""
    if isinstance(value, str):
        raise StatementError(f"the {what} is the text {value[:60]!r}: give SymPy expressions.")
    entries = list(value) if isinstance(value, (Sequence, sympy.MatrixBase)) else [value]
    if not entries:
        raise StatementError(f"the {what} is empty: give at least one component.")
    return [sympy.Integer(x) if isinstance(x, int) else sympy.Float(x) if isinstance(x, float) else x for x in entries]
