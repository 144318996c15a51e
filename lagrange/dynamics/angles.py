"""Angles: coordinates in which the motion is periodic with 2 pi, so that pictures are wrapped."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import sympy

from lagrange.machine.backend import FloatArray
from lagrange.mechanics.plain_form import PlainForm, vanishes
from lagrange.statement.statement import Statement

TURN = 2.0 * math.pi
"""Period of an angle, in radians."""


@lru_cache(maxsize=64)
def angles(statement: Statement) -> tuple[bool, ...]:
    """Return for each coordinate whether it is an angle: a change by 2 pi leaves the Lagrangian and forces the same.

    An angle also occurs in a sine, cosine or tangent there or in a position. So a coordinate on which nothing depends,
    such as that of a free particle, is not an angle.
    """
    form = PlainForm(statement)
    parts = [form.lagrangian, *form.forces, *(form.read(constraint.expression) for constraint in statement.constraints)]
    positions = [form.read(entry) for point in statement.positions.values() for entry in point]
    circular = {f for part in (*parts, *positions) for f in part.atoms(sympy.sin, sympy.cos, sympy.tan)}
    turning = frozenset().union(*(f.free_symbols for f in circular))
    return tuple(q in turning and _is_periodic(form, q, parts) for q in form.q)


def _is_periodic(form: PlainForm, q: sympy.Symbol, parts: list[sympy.Expr]) -> bool:
    return all(vanishes(form, part.xreplace({q: q + 2 * sympy.pi}) - part) for part in parts if part.has(q))


def is_angle(statement: Statement, row: int) -> bool:
    """Return True if the entry of the state in a row is an angle; False for velocities."""
    return row < len(statement.names) and angles(statement)[row]


def wrapped(values: FloatArray, low: float) -> FloatArray:
    """Return angles shifted by multiples of 2 pi into the turn that begins at `low`; not finite values become NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray(low + (values - low) % TURN)


def difference(a: FloatArray, b: FloatArray, periodic: tuple[bool, ...]) -> FloatArray:
    """Return a - b of states (..., 2n), reduced to the nearest turn for angles."""
    found = a - b
    for i, whole in enumerate(periodic):
        if whole:
            found[..., i] -= TURN * (found[..., i] / TURN).round()
    return found
