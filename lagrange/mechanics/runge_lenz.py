"""The Runge-Lenz vector of a body that is drawn to a fixed point with a force k/r^2.

A = p x L - mass k r/|r| is conserved for L = mass |v|^2 / 2 + k/|r|, whatever the coordinates.
Source: H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed., 2002, section 3.9.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sympy import Matrix, S, sqrt

from lagrange.equations.monomials import MonomialSum
from lagrange.equations.stated_algebra import StatedAlgebra
from lagrange.equations.terms import differentiable
from lagrange.mechanics.places import Place


def runge_lenz(stated: StatedAlgebra, place: Place) -> Iterator[tuple[str, MonomialSum]]:
    """Yield the components of the vector by name; none where the body is not drawn by such a force alone."""
    statement = stated.statement
    if statement.constraints or any(statement.forces) or statement.dissipation != 0 or not place.rest:
        return
    for distance in _distances(stated, place):
        strength = _strength(stated, place, distance)
        if strength is not None:
            yield from _components(stated, place, strength, distance)
            return


def _strength(stated: StatedAlgebra, place: Place, distance: Any) -> Any:
    """Return k of L = mass |v|^2 / 2 + k/|r|, or None where L is something else."""
    algebra, moving = stated.algebra, frozenset((*stated.q, *stated.v, stated.time))
    found = algebra.merge_angles(algebra.multiply(place.rest, algebra.read(distance)))
    if any(algebra.free(k) & moving for monomial in found for k, _ in monomial):
        return None
    return algebra.write(found)


def _distances(stated: StatedAlgebra, place: Place) -> list[Any]:
    """Return |r| as it may have been written: a coordinate alone, where it is one, or a root."""
    square = stated.algebra.merge_angles(stated.algebra.read(sum((x**2 for x in place.r), S.Zero)))
    if not any(stated.algebra.free(k) & frozenset(stated.q) for monomial in square for k, _ in monomial):
        return []
    root = sqrt(stated.algebra.write(square))
    alone = [q for q in stated.q if square == stated.algebra.read(q**2)]
    return [*alone, root, differentiable(root)]


def _components(stated: StatedAlgebra, place: Place, strength: Any, distance: Any) -> Iterator[tuple[str, MonomialSum]]:
    """Yield p x L - mass k r/|r|, where p x L is mass^2 times r v^2 - v (r . v)."""
    r, v = Matrix(place.r), Matrix(place.v)
    square, along = v.dot(v), r.dot(v)
    for k, axis in enumerate("xyz"[: len(place.r)]):
        whole = place.mass**2 * (r[k] * square - v[k] * along) - place.mass * strength * r[k] / distance
        yield f"Runge-Lenz vector {axis}", stated.algebra.merge_angles(stated.algebra.read(whole))
