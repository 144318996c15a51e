"""Axes of pictures in state space: the entry and the range on each axis, and which coordinates are angles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import sympy

from lagrange.errors import StatementError, shown
from lagrange.machine.backend import FloatArray
from lagrange.mechanics.plain_form import PlainForm, vanishes
from lagrange.statement.declare import state_rows
from lagrange.statement.expression import one_of, real_array, whole_number
from lagrange.statement.parameters import label_of
from lagrange.statement.statement import Statement

MOST_VALUES = 4096
"""Largest number of values on an axis: a map with 4096 on both axes takes 17 million runs."""


@dataclass(frozen=True)
class Axis:
    """One axis of a picture: the `name` and `row` of an entry of the state, and `count` values from `low` to `high`."""

    name: str
    row: int
    low: float
    high: float
    count: int

    @property
    def values(self) -> FloatArray:
        """Equally spaced values of the axis, (count,)."""
        return np.linspace(self.low, self.high, self.count)

    @property
    def width(self) -> float:
        """The length of the axis, from its lowest to its highest value."""
        return self.high - self.low


Plane = tuple[Axis, Axis]  # Horizontal axis and vertical axis


def row_of(statement: Statement, key: Any, what: str) -> int:
    """Return the index in the state of the entry `key`: a coordinate, a velocity, or a name.

    `what` names the user's argument in messages. Raises StatementError for any other key.
    """
    rows = state_rows(statement.coordinates)
    if isinstance(key, (str, sympy.Basic)) and key in rows:
        return rows[key]
    refusal = what + " names {given}, which is not a coordinate or velocity of this system; they are {known}."
    return rows[one_of(label_of(key), statement.state_names, refusal)]


def plane_of(statement: Statement, table: Any, label: str, default_count: int) -> Plane:
    """Return the horizontal and the vertical axis from {entry: (low, high)} or {entry: (low, high, count)}.

    `default_count` replaces a missing count. `label` names the user's argument in messages. Raises StatementError
    unless there are two different entries.
    """
    if not isinstance(table, Mapping):
        raise StatementError(f"{label} is {shown(table)}: give {_example(statement)}.")
    if len(table) != 2:
        raise StatementError(
            f"{label} has {len(table)} entr{'y' if len(table) == 1 else 'ies'}, and a picture has two axes: give "
            f"{_example(statement)}."
        )
    first, second = (axis_of(statement, key, span, label, default_count) for key, span in table.items())
    if first.row == second.row:
        raise StatementError(f"{label} names {first.name} twice: give two different coordinates or velocities.")
    return first, second


def axis_of(statement: Statement, entry: Any, span: Any, argument: str, default: int) -> Axis:
    """Return the axis of an entry of the state, from a span (low, high) or (low, high, count).

    `default` replaces a missing count. `argument` names the user's argument in messages. Raises StatementError for an
    empty span.
    """
    row = row_of(statement, entry, argument)
    name = statement.state_names[row]
    label, size = f"the range of {name}", len(span) if isinstance(span, (tuple, list, np.ndarray)) else 0
    numbers = real_array(list(span), label) if size in (2, 3) else None
    if numbers is None or numbers.ndim != 1:
        raise StatementError(f"{label} is {shown(span)}: give (low, high), or (low, high, count).")
    low, high = float(numbers[0]), float(numbers[1])
    if not (np.isfinite([low, high]).all() and low < high):
        raise StatementError(f"{label} is empty: {low:g} to {high:g}. Give (low, high) with low < high.")
    several = default if size == 2 else whole_number(span[2], f"the number of values in {label}", 2, MOST_VALUES)
    return Axis(name, row, low, high, several)


def _example(statement: Statement) -> str:
    name = statement.names[0]
    return f"a dict of two entries of the state, such as {{{name!r}: (-3, 3), '{name}_dot': (-5, 5)}}"


TURN = 2.0 * math.pi  # Period of an angle, in radians


@lru_cache(maxsize=64)
def angles(statement: Statement) -> tuple[bool, ...]:
    """Return for each coordinate True if it is an angle: a change by 2 pi leaves the Lagrangian and forces unchanged.

    An angle must also occur in a sine, cosine or tangent of the Lagrangian, a force or a position. So a coordinate on
    which nothing depends, such as the coordinate of a free particle, is not an angle.
    """
    form = PlainForm(statement)
    parts = [form.lagrangian, *form.forces, *(form.read(constraint.expression) for constraint in statement.constraints)]
    positions = [form.read(entry) for point in statement.positions.values() for entry in point]
    circular = {f for part in (*parts, *positions) for f in part.atoms(sympy.sin, sympy.cos, sympy.tan)}
    turning = frozenset().union(*(f.free_symbols for f in circular))

    def is_periodic(q: sympy.Symbol) -> bool:
        return all(vanishes(form, part.xreplace({q: q + 2 * sympy.pi}) - part) for part in parts if part.has(q))

    return tuple(q in turning and is_periodic(q) for q in form.q)


def is_angle(statement: Statement, row: int) -> bool:
    """Return True if entry number `row` of the state is a coordinate that is an angle. Velocities are not angles."""
    return row < len(statement.names) and angles(statement)[row]


def wrapped(values: FloatArray, low: float) -> FloatArray:
    """Return angles shifted by full turns to between `low` and `low` + 2 pi. Values that are not finite become NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray(low + (values - low) % TURN)


def difference(a: FloatArray, b: FloatArray, is_angle: tuple[bool, ...]) -> FloatArray:
    """Return the difference a - b of states (..., 2n).

    `is_angle` has True for each coordinate that is an angle. The difference of two angles is at most half a turn.
    """
    result = a - b
    for i, whole in enumerate(is_angle):
        if whole:
            result[..., i] -= TURN * (result[..., i] / TURN).round()
    return result
