"""Outlines of bodies, to draw: points that turn with a rotation, and the edges between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from typing import Any

from lagrange.errors import StatementError, shown
from lagrange.statement.expression import as_typed, entries, one_of
from lagrange.statement.rotation import Rotation
from lagrange.statement.space import in_space

Place = tuple[float, float, float]
"""A point of a body of size one, in the axes of the body."""

PARTS = 24
"""Number of straight edges that draw a circle."""


@dataclass(frozen=True)
class Shape:
    """The outline of a body, made by `lagrange.shape`: corners in space, three expressions each, and edges.

    An edge is a pair of indices of corners.
    """

    corners: tuple[tuple[Any, ...], ...]
    edges: tuple[tuple[int, int], ...]


def shape(kind: str, rotation: Rotation | None, size: Any, at: Any = (0, 0, 0)) -> Shape:
    """Return the outline of a body, to draw: a value of `positions` in a System.

    `kind` is "box" with three sides, "ellipsoid" with three semi-axes, "disc" with a radius, about the axis z of the
    body, or "axes" with a length. A single `size` is used for all three sides or semi-axes. `rotation` turns the body
    about its centre `at`, three expressions. None leaves it along the axes of space. Raises StatementError for other
    kinds and sizes.
    """
    one_of(kind, OUTLINES, "the shape {given} is not known: give one of {known}.")
    if rotation is not None and not isinstance(rotation, Rotation):
        raise StatementError(f"the rotation of a shape is {shown(rotation)}: give a rotation R, or None.")
    sizes = _entries(size, "the size of a shape", equal=True)
    centre = in_space(_entries(at, "the place of a shape"))
    lines = OUTLINES[kind]()
    vertices = dict.fromkeys(vertex for line in lines for vertex in line)
    number = {vertex: k for k, vertex in enumerate(vertices)}
    corners = []
    for vertex in vertices:
        arm = in_space([0 if share == 0 else share * side for share, side in zip(vertex, sizes, strict=True)])
        corners.append(tuple(centre + (arm if rotation is None else rotation * arm)))
    edges = dict.fromkeys((number[a], number[b]) for line in lines for a, b in pairwise(line))
    return Shape(tuple(corners), tuple(edges))


def _entries(value: Any, what: str, *, equal: bool = False) -> list[Any]:
    """Return the three entries of `value`; if `equal`, a single value is repeated. `what` names it in messages."""
    parts = entries(value, what)
    parts = [value] * 3 if parts is None and equal else parts
    if parts is None or len(parts) != 3:
        raise StatementError(f"{what} is {shown(value)}: give three values{', or one for all' if equal else ''}.")
    return [as_typed(part, f"an entry of {what}") for part in parts]


def _box() -> list[list[Place]]:
    """Return the edges of a cube with sides of length one, as lists of points."""
    corners = [(i, j, k) for i, j, k in product((-0.5, 0.5), repeat=3)]
    return [[a, b] for a, b in combinations(corners, 2) if sum(x != y for x, y in zip(a, b, strict=True)) == 1]


def _circle(first: int, second: int) -> list[Place]:
    """Return points of a closed circle of radius one in the plane of the axes with indices `first` and `second`.

    Entries are rounded to six digits.
    """
    corners = []
    for k in range(PARTS + 1):
        angle = 2 * math.pi * (k % PARTS) / PARTS
        corner = [0.0, 0.0, 0.0]
        corner[first], corner[second] = round(math.cos(angle), 6) + 0.0, round(math.sin(angle), 6) + 0.0
        corners.append((corner[0], corner[1], corner[2]))
    return corners


def _axes(count: int) -> list[list[Place]]:
    """Return lines of length one from the centre along the first `count` axes."""
    units: Sequence[Place] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return [[(0.0, 0.0, 0.0), unit] for unit in units[:count]]


OUTLINES: dict[str, Callable[[], list[list[Place]]]] = {
    "box": _box,
    "ellipsoid": lambda: [_circle(0, 1), _circle(1, 2), _circle(2, 0)],
    "disc": lambda: [_circle(0, 1), *_axes(2)],
    "axes": lambda: _axes(3),
}
"""Lines of a body of size one by its kind. A disc has two radii, which show how it turns."""
