"""The point symmetries that are tried: shifts in time, and shifts and rotations of coordinates or of a body in space.

A body in polar, cylindrical or spherical coordinates is moved along xi_i = (dr/dq_i . u) / |dr/dq_i|^2, which is the
shift or the rotation u(r) of its place, since those coordinates are orthogonal.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

from sympy import Matrix, S, cos, expand, sin

from lagrange.equations.stated_algebra import StatedAlgebra
from lagrange.mechanics.places import Place
from lagrange.mechanics.symmetries import Symmetry
from lagrange.mechanics.symmetry_names import axis_of

MOST_PAIRED = 6
"""With more coordinates only those named by axes, such as x1 and y1, are turned."""


def shifts(stated: StatedAlgebra) -> Iterator[Symmetry]:
    """Yield the shift of time, those of each coordinate, and those of several coordinates together.

    Together are moved the coordinates of one axis, such as x1 and x2, and all coordinates.
    """
    n, names = len(stated.q), stated.statement.names
    yield Symmetry((S.Zero,) * n, S.One)
    groups = [{i} for i in range(n)]
    for axis in dict.fromkeys(map(axis_of, names)):
        groups.append({i for i, name in enumerate(names) if axis_of(name) == axis})
    groups.append({*range(n)})
    for k, group in enumerate(groups):
        if group not in groups[:k]:
            yield Symmetry(tuple(S.One if i in group else S.Zero for i in range(n)))


def rotations(stated: StatedAlgebra) -> Iterator[Symmetry]:
    """Yield rotations: of all bodies with coordinates such as x1 and y1 together, and of pairs of other coordinates."""
    bodies: dict[str, dict[str, int]] = {}
    for i, name in enumerate(stated.statement.names):
        axis = axis_of(name)
        if axis in ("x", "y", "z"):
            bodies.setdefault(name[1:], {})[axis] = i
    for first, second in (("x", "y"), ("y", "z"), ("z", "x")):
        pairs = [(axes[first], axes[second]) for axes in bodies.values() if first in axes and second in axes]
        if pairs:
            yield _turned(stated.q, pairs)
    others = [i for i in range(len(stated.q)) if not any(i in axes.values() for axes in bodies.values())]
    for pair in combinations(others, 2) if len(stated.q) <= MOST_PAIRED else ():
        yield _turned(stated.q, [pair])


def body_motions(stated: StatedAlgebra, place: Place) -> Iterator[Symmetry]:
    """Yield the shifts along fixed axes, and the rotations about them, of one body in curved coordinates."""
    if place.r == tuple(stated.q):
        return
    r = Matrix([*place.r, *([S.Zero] * (3 - len(place.r)))])
    tangents = [r.diff(q) for q in stated.q]
    squares = [_reduced(tangent.dot(tangent)) for tangent in tangents]
    units = [Matrix([int(j == k) for j in range(3)]) for k in range(3)]
    moved = units[: len(place.r)] if len(place.r) == len(tangents) else []  # on a sphere no shift is possible
    turned = [unit.cross(r) for unit in units[:2]] if len(place.r) == 3 else []  # about z an angle alone is shifted
    for motion in (*moved, *turned):
        parts = [_reduced(tangent.dot(motion)) / square for tangent, square in zip(tangents, squares, strict=True)]
        yield Symmetry(tuple(parts))


def _reduced(given: Any) -> Any:
    """Return an expression with sin^2 + cos^2 = 1 used in the way that makes it shorter."""
    expanded = expand(given)
    waves = expanded.atoms(sin)
    ways = [
        {sin(wave.args[0]) ** 2: 1 - cos(wave.args[0]) ** 2 for wave in waves},
        {cos(wave.args[0]) ** 2: 1 - sin(wave.args[0]) ** 2 for wave in waves},
    ]
    return min((expanded, *(expand(expanded.xreplace(way)) for way in ways)), key=lambda form: form.count_ops())


def _turned(q: Sequence[Any], pairs: Sequence[tuple[int, int]]) -> Symmetry:
    xi: list[Any] = [S.Zero] * len(q)
    for first, second in pairs:
        xi[first], xi[second] = -q[second], q[first]
    return Symmetry(tuple(xi))
