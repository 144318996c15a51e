"""Where a body is along fixed axes, if its coordinates are Cartesian, polar, cylindrical or spherical."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

from sympy import S, cos, diff, sin

from lagrange.equations.monomials import MonomialSum
from lagrange.equations.stated_algebra import StatedAlgebra

Placing = Callable[..., tuple[Any, ...]]

PLACINGS: dict[int, tuple[Placing, ...]] = {
    2: (
        lambda x, y: (x, y),
        lambda r, a: (r * cos(a), r * sin(a)),
        lambda r, a: (r * sin(a), -r * cos(a)),
        lambda b, a: (sin(b) * cos(a), sin(b) * sin(a), cos(b)),
        lambda b, a: (cos(b) * cos(a), cos(b) * sin(a), sin(b)),
    ),
    3: (
        lambda x, y, z: (x, y, z),
        lambda r, a, z: (r * cos(a), r * sin(a), z),
        lambda r, b, a: (r * sin(b) * cos(a), r * sin(b) * sin(a), r * cos(b)),
        lambda r, b, a: (r * cos(b) * cos(a), r * cos(b) * sin(a), r * sin(b)),
    ),
}
"""Places by the number of coordinates: Cartesian, polar (from x, or hanging), on a sphere of any radius, cylindrical,
spherical; angles are counted from the pole or from the equator."""


@dataclass(frozen=True, eq=False)
class Place:
    """A body at r, with T = mass |v|^2 / 2, in plain symbols; `rest` is what else L has, linear in velocities."""

    mass: Any
    r: tuple[Any, ...]
    v: tuple[Any, ...]
    rest: MonomialSum


def place(stated: StatedAlgebra) -> Place | None:
    """Return the place of the one body of a statement, or None where no placing gives its kinetic energy."""
    mass = _mass(stated)
    for placing in PLACINGS.get(len(stated.q), ()) if mass is not None else ():
        for order in permutations(range(len(stated.q))):
            r = placing(*(stated.q[i] for i in order))
            v = tuple(_rate(stated, x) for x in r)
            rest = _rest(stated, mass, v)
            if rest is not None:
                return Place(mass, r, v, rest)
    return None


def _mass(stated: StatedAlgebra) -> Any:
    """Return an entry of the mass matrix that is constant: that of a length, or on a sphere of the polar angle."""
    moving = frozenset((*stated.q, *stated.v, stated.time))
    for i in range(len(stated.q)):
        entry = stated.mass[i][i]
        if entry and not any(stated.algebra.free(k) & moving for monomial in entry for k, _ in monomial):
            return stated.algebra.write(entry)
    return None


def _rest(stated: StatedAlgebra, mass: Any, v: Sequence[Any]) -> MonomialSum | None:
    """Return L - mass |v|^2 / 2, or None where velocities are left in it other than to the first power."""
    algebra = stated.algebra
    kinetic = algebra.scale(algebra.read(mass * sum(x**2 for x in v) / 2), S.NegativeOne)
    rest = algebra.merge_angles(algebra.add(stated.lagrangian, kinetic))
    velocities = frozenset(stated.v)
    alone = [k for v in stated.v for monomial in algebra.read(v) for k, _ in monomial]
    for monomial in rest:
        moving = [(k, power) for k, power in monomial if algebra.free(k) & velocities]
        if len(moving) > 1 or any(k not in alone or power != 1 for k, power in moving):
            return None
    return rest


def _rate(stated: StatedAlgebra, given: Any) -> Any:
    return sum((diff(given, q) * v for q, v in zip(stated.q, stated.v, strict=True)), S.Zero)
