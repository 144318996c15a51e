"""Named points whose kinetic energy is a term of T, with their velocities and masses: the start of a derivation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from sympy import Add, Mul, Rational, S

from lagrange.equations.terms import Monomial, MonomialSum, common_factor
from lagrange.equations.textbook_algebra import TextbookAlgebra
from lagrange.statement.statement import corners

HALF = Rational(1, 2)


@dataclass(frozen=True)
class MassPoint:
    """A named point of `positions` that has mass: its position and velocity, (2,) or (3,), and T = mass speed^2 / 2.

    The velocity is merged and collected; the position is as it was stated.
    """

    name: str
    mass: Any
    position: tuple[Any, ...]
    velocity: tuple[Any, ...]
    squared_speed: Any


def moving_points(page: TextbookAlgebra) -> tuple[MassPoint, ...]:
    """Return the points for which a term of the stated T is half a mass times the square of their velocity.

    Each term is the energy of one point at most. There are none if each component of all their velocities is a constant
    times the velocity of a coordinate: showing these explains nothing.
    """
    left = [page.algebra.merge_angles(page.read(term)) for term in Add.make_args(page.statement.kinetic)]
    points, plain = [], True
    hidden = corners(page.statement.links)
    for name, position in page.statement.positions.items():
        if name in hidden:
            continue
        rates = [page.at_constant_velocities(page.read(entry)) for entry in position]
        squares = (page.algebra.multiply(rate, rate) for rate in rates)
        squared = page.algebra.merge_angles(page.algebra.add({}, *squares))
        mass, place = next(_masses(page, squared, left), (None, 0))
        if mass is not None:
            del left[place]
            plain = plain and all(_plain(page, rate) for rate in rates)
            points.append(MassPoint(name, mass, tuple(position), tuple(map(page.show, rates)), page.show(squared)))
    return () if plain else tuple(points)


def _masses(page: TextbookAlgebra, squared: MonomialSum, terms: list[MonomialSum]) -> Iterator[tuple[Any, int]]:
    """Yield (mass, index) of the terms that are mass * squared / 2 with a constant mass."""
    if not squared:
        return
    number, monomial, rest = common_factor(squared)
    for place, term in enumerate(terms):
        other_number, other, other_rest = common_factor(term)
        for sign in (S.One, S.NegativeOne):
            if {key: sign * value for key, value in other_rest.items()} == rest:
                mass = _ratio(page, other, monomial, sign * other_number / number / HALF)
                if _is_mass(page, mass):
                    yield page.finish(mass), place


def _ratio(page: TextbookAlgebra, above: Monomial, below: Monomial, number: Any) -> Any:
    return Mul(number, page.algebra.power(above), 1 / page.algebra.power(below))


def _plain(page: TextbookAlgebra, rate: MonomialSum) -> bool:
    """Return True if a component of a velocity is zero, or a constant times the velocity of a coordinate."""
    if len(rate) > 1:
        return False
    moving = [page.algebra.factors[k] for monomial in rate for k, _ in monomial]
    return all(factor in page.v or not factor.free_symbols & page.collector.moving for factor in moving)


def _is_mass(page: TextbookAlgebra, mass: Any) -> bool:
    """Return True if an expression may be a mass: a parameter, a number, or a sum of these."""
    return all(part.is_Symbol or part.is_Number for part in Add.make_args(mass)) and not (
        mass.free_symbols & page.collector.moving
    )
