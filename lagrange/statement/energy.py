"""Energies of point masses, rotating bodies, springs and gravity; outlines of bodies; check for missing inertia."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from typing import Any

import sympy
from sympy.core.function import AppliedUndef
from sympy.functions.elementary.trigonometric import InverseTrigonometricFunction

from lagrange.errors import StatementError, formula, listing, shown
from lagrange.statement.coordinate import name_of, t
from lagrange.statement.expression import (
    as_typed,
    entries,
    expression,
    in_full,
    is_shorthand,
    one_of,
    refusing_deep,
    vector,
)
from lagrange.statement.given.motion import motion_of
from lagrange.statement.rotation import Rotation
from lagrange.statement.space import in_space
from lagrange.statement.statement import Statement


def without_velocity(statement: Statement, *, alone: bool) -> Any | None:
    """Return the first coordinate whose acceleration no equation can determine, or None.

    `alone` is true if the user stated the Lagrangian L alone, without T and V.

    A coordinate is determined if its velocity is in an energy, or if it is in a constraint. It is also determined if
    its own equation 0 = dL/dq + Q - dD/dv contains a velocity. Example: with D = e.dot**2/2 the equation of e is e.dot
    = Q. Example: with L = p*q.dot - H the equation of p contains q.dot. A kinetic energy that is not zero and has no
    velocity is taken for a mistake. Then a velocity in Q or D does not suffice.
    """
    kinetic, coordinates, rates = statement.kinetic, statement.coordinates, statement.velocities
    moving = (kinetic.atoms(sympy.Derivative) | statement.potential.atoms(sympy.Derivative)).intersection(rates)
    mistaken = kinetic != 0 and not (kinetic.has(*coordinates) if alone else moving)
    for q, rate, force in zip(coordinates, rates, statement.forces, strict=True):
        if rate in moving or any(constraint.expression.has(q) for constraint in statement.constraints):
            continue
        contains_rate = force.has(*rates) or statement.dissipation.diff(rate).has(*rates)
        if contains_rate and not mistaken:
            continue
        if not statement.lagrangian.has(q) or not statement.lagrangian.diff(q).has(*rates):
            return q
    return None


def first_order_remedy(rate: str) -> str:
    """Return the sentence of a message on how to state a first-order variable by its `rate`, such as "x.dot"."""
    return (
        f"If it is a state of first order, such as a current, give its rate as the force on it and {rate}**2/2 as "
        f"dissipation, or the constraint {rate} - (its rate)."
    )


@refusing_deep
def kinetic_energy(mass: Any, position: Sequence[Any] | Any) -> Any:
    """Return m |dr/dt|^2 / 2 of a point mass at `position`, a vector (k,) of any length or one expression.

    The energy has the units of the mass and the position. Raises StatementError for a position that contains a
    velocity, and for other types, such as a text.
    """
    point = vector(position, "the position")
    rates = [rate for entry in point for rate in sorted(in_full(entry).atoms(sympy.Derivative), key=str)]
    for rate in rates:
        if rate.expr.args == (t,) and motion_of(rate.expr) is None:
            name, kind = name_of(rate.expr), "a rate" if rate.derivative_count == 1 else "an acceleration"
            raise StatementError(
                f"the position contains {_dotted(rate)}, {kind}: give the place in {name}, or write the energy "
                f"yourself, such as m*{name}.dot**2/2. {TAKEN}"
            )
    return expression(mass, "the mass") * sum((sympy.diff(x, t) ** 2 for x in point), sympy.S.Zero) / 2


@refusing_deep
def rotational_energy(inertia: Any, angular_velocity: Any) -> Any:
    """Return w . I w / 2, the kinetic energy of a rotation with inertia I and angular velocity w.

    `inertia` is a scalar, a vector of principal moments (k,) or a matrix (k, k). `angular_velocity` is a scalar or a
    vector (k,) in the same axes. Give rates such as theta.dot here, whereas `kinetic_energy` takes a position. Raises
    StatementError for a component that is an angle, a number such as sin(theta), or an acceleration, and for shapes
    that do not fit together. Goldstein, Poole, Safko, Classical Mechanics, 3rd ed., section 5.3.
    """
    rates = vector(angular_velocity, "the angular velocity")
    moving = any(in_full(rate).has(AppliedUndef) for rate in rates)
    for i, rate in enumerate(map(in_full, rates)):
        what = "the angular velocity" if len(rates) == 1 else f"component {i} of the angular velocity"
        for term in sympy.Add.make_args(sympy.expand_mul(rates[i])):
            factors = (factor.as_base_exp() for factor in sympy.Mul.make_args(term))
            powers = {base: power for base, power in factors if _is_rate(base)}
            if sum(powers.values()) > 1:
                example = f"such as {_plain(min(powers, key=str))}, whose square is in the energy"
                raise _no_rate(f"{what} has the term", term, "a product of rates", example, rates[i])
        if not moving and rate.has(t):
            raise _no_rate(f"{what} is", rate, "an angle or its function", "such as w for the angle w*t", rate)
        _check_rate(rate, what)
    omega = sympy.Matrix(rates)
    return (omega.T * _tensor(inertia, omega.rows) * omega)[0, 0] / 2


def _is_rate(factor: Any) -> bool:
    """Return True for a velocity such as x.dot, and for a rate about an axis such as R.body[2]."""
    return isinstance(factor, sympy.Derivative) or (is_shorthand(factor) and in_full(factor).has(sympy.Derivative))


TAKEN = "kinetic_energy takes a place, and rotational_energy a rate."
"""Last sentence of a message on an argument of `kinetic_energy` that belongs to `rotational_energy`, or the reverse."""


def _dotted(rate: Any) -> str:
    """Return a time derivative of a coordinate as the user writes it, such as x.dot or x.ddot."""
    return f"{name_of(rate.expr)}.{'d' * rate.derivative_count}ot"


def _no_rate(begin: str, term: Any, kind: str, example: str, stated: Any) -> StatementError:
    """Return the error for a `term` of an angular velocity that is not a rate.

    The message is `begin`, the term, its `kind` (such as "an angle") and an `example` of a rate. It also has the typed
    angular velocity `stated`, if the term results from multiplying out.
    """
    written = term == stated or term in sympy.Add.make_args(stated)
    inside = "" if written else f" in {formula(_plain(stated), 80)}"
    shown_term = formula(_plain(term), 60)
    return StatementError(f"{begin} {shown_term}{inside}, {kind}: give its rate, {example}. {TAKEN}")


def _plain(term: Any) -> Any:
    """Return a term with the symbols x and x.dot in place of functions of time and their derivatives, for a message."""
    plain = {rate: sympy.Symbol(_dotted(rate)) for rate in term.atoms(sympy.Derivative)}
    return term.xreplace(plain | {q: sympy.Symbol(name_of(q)) for q in term.atoms(AppliedUndef)})


def _check_rate(rate: Any, what: str) -> None:
    """Raise StatementError if `rate`, a component of an angular velocity, or one of its terms is not a rate.

    An angle, a number and an acceleration are not rates. An angle has coordinates and no velocities. In a sum with a
    velocity, an angle times a parameter may be a rate, as in phi.dot + Omega*theta for a small tilt. A coordinate
    divided by parameters, such as x/r, is an angle. `what` names the component in messages.
    """
    alone = not rate.has(sympy.Derivative)
    for term in sympy.Add.make_args(sympy.expand_mul(rate)):
        bare = _without_functions(term)
        angles = [q for q in bare.atoms(AppliedUndef) if motion_of(q) is None]
        inside = [q for q in term.atoms(AppliedUndef) if motion_of(q) is None]
        begin, part = (f"{what} is", rate) if alone else (f"{what} has the term", term)
        for high in term.atoms(sympy.Derivative):
            if high.derivative_count > 1 and motion_of(high.expr) is None:
                raise _no_rate(f"{what} contains", high, "an acceleration", f"such as {name_of(high.expr)}.dot", high)
        if not inside or term.has(sympy.Derivative):
            continue
        example = f"such as {min(map(name_of, angles or inside))}.dot"
        factor = term.subs(dict.fromkeys(angles, 1))
        if angles and (alone or _is_ratio(factor) or sympy.fraction(factor)[0].is_number):
            raise _no_rate(begin, part, "an angle", example, rate)
        if not angles and ((bare.is_Integer and abs(bare) == 1) or (bare.free_symbols and _is_ratio(bare))):
            raise _no_rate(begin, part, "a number without a rate", example, rate)


def _without_functions(term: Any) -> Any:
    """Return a term with functions such as sin replaced by 1, to see whether a parameter in it is a rate.

    Omega*sin(theta) becomes Omega, which is the rate. An inverse function is an angle, and stays with its argument, as
    in atan(y/x), or asin(sin(theta)), which is theta within one turn.
    """
    angles = {angle: sympy.Dummy() for angle in term.atoms(InverseTrigonometricFunction)}
    plain = term.xreplace(angles).replace(
        lambda node: isinstance(node, sympy.Function) and not isinstance(node, AppliedUndef), lambda node: sympy.S.One
    )
    return plain.xreplace({dummy: angle for angle, dummy in angles.items()})


def _is_ratio(factor: Any) -> bool:
    """Return True for a number or a ratio of parameters such as R/r, which stays when all are doubled."""
    doubled = factor.xreplace({symbol: 2 * symbol for symbol in factor.free_symbols})
    return bool(sympy.cancel(doubled - factor) == 0)


def _tensor(inertia: Any, k: int) -> Any:
    """Return the inertia tensor (k, k) from `inertia`: a scalar, k principal moments, or k rows of k entries.

    Raises StatementError for other numbers of entries, a negative moment, and rows that are not a symmetric matrix.
    """
    listed = entries(inertia, "the inertia")
    if listed is None:
        return _checked_tensor(expression(inertia, "the inertia") * sympy.eye(k))
    rows = [entries(row, f"row {i} of the inertia") for i, row in enumerate(listed)]
    lengths = [1 if row is None else len(row) for row in rows]
    if any(row is not None for row in rows) and (len(rows), *set(lengths)) != (k, k):
        shape = (len(rows), lengths[0])
        what = f"has shape {shape}" if len(set(lengths)) == 1 else f"has rows of {listing(map(str, lengths))} entries"
        raise StatementError(f"the inertia {what} and the angular velocity {k} components: give a ({k}, {k}) tensor.")
    if len(listed) != k:
        raise StatementError(
            f"the inertia has {len(listed)} entries and the angular velocity {k}: give as many moments as components."
        )
    if rows[0] is None:
        return _checked_tensor(sympy.diag(*vector(listed, "the inertia")))
    return _checked_tensor(sympy.Matrix([vector(row, f"row {i} of the inertia") for i, row in enumerate(rows)]))


def _checked_tensor(tensor: Any) -> Any:
    """Return an inertia tensor (k, k). Raises StatementError if it is not symmetric, or has a negative moment."""
    for (i, j), entry in sympy.Matrix.todok(tensor).items():
        if sympy.expand(entry - tensor[j, i]) != 0:
            raise StatementError(
                f"the inertia is not symmetric: entry ({i}, {j}) is {formula(entry, 60)}, and entry ({j}, {i}) is "
                f"{formula(tensor[j, i], 60)}. Both are the same product of inertia."
            )
    moments = [f"the moment {formula(entry, 60)}" for entry in tensor.diagonal() if entry.is_negative]
    if not moments and tensor.is_positive_semidefinite is False and not tensor.free_symbols:
        moments = ["a principal moment"]
    if moments:
        raise StatementError(
            f"the inertia has {moments[0]} below zero, which no body has: for a hole subtract its rotational energy."
        )
    return tensor


@refusing_deep
def gravity(mass: Any, position: Sequence[Any] | Any, g: Any, up: Sequence[Any] | None = None) -> Any:
    """Return the potential energy of gravity: m g times the height of `position` (k,) along the direction `up` (k,).

    By default `up` is the last axis, which is y in a plane and z in space. `up` is scaled to unit length. Raises
    StatementError for an `up` that is zero, or has another number of entries than `position`.
    """
    point = vector(position, "the position")
    direction = vector([0] * (len(point) - 1) + [1] if up is None else up, "the upward direction")
    if len(direction) != len(point):
        raise StatementError(
            f"up has {len(direction)} components and the position {len(point)}: give both the same number of "
            "components."
        )
    length = sympy.sqrt(sum(d**2 for d in direction))
    if length == 0:
        raise StatementError("up is the zero vector: give a direction such as (0, 1).")
    weight = expression(mass, "the mass") * expression(g, "g")
    return weight * sum((d * x for d, x in zip(direction, point, strict=True)), sympy.S.Zero) / length


@refusing_deep
def spring(stiffness: Any, a: Sequence[Any] | Any, b: Sequence[Any] | Any | None = None, rest_length: Any = 0) -> Any:
    """Return the potential energy of a spring between two points: stiffness (|a - b| - rest_length)^2 / 2.

    Points are vectors (k,) or single expressions. Without `b` the spring ends at the origin. Raises StatementError for
    ends of different dimensions.
    """
    start = vector(a, "the first end")
    end = [sympy.S.Zero] * len(start) if b is None else vector(b, "the second end")
    k, rest = expression(stiffness, "the stiffness"), expression(rest_length, "the rest length")
    if len(start) != len(end):
        raise StatementError(
            f"the ends of the spring have {len(start)} and {len(end)} components: give both the same number of "
            "components."
        )
    squared = sum(((p - q) ** 2 for p, q in zip(start, end, strict=True)), sympy.S.Zero)
    if rest == 0:
        return k * squared / 2
    return k * (sympy.sqrt(squared) - rest) ** 2 / 2


Place = tuple[float, float, float]  # Point of a body of size one, in the axes of the body
PARTS = 24  # Number of straight lines that draw a circle


@dataclass(frozen=True)
class Shape:
    """Outline of a body: `corners` in space, three expressions each, and `edges`, pairs of indices of corners."""

    corners: tuple[tuple[Any, ...], ...]
    edges: tuple[tuple[int, int], ...]


def shape(kind: str, rotation: Rotation | None, size: Any, at: Any = (0, 0, 0)) -> Shape:
    """Return the outline of a body, to draw: a value of `positions` in a System.

    `kind` is one of "box", "ellipsoid", "disc", which lies across the axis z of the body, and "axes". `size` has the
    three sides of the box, the three semi-axes of the ellipsoid, the radius of the disc or the length of the axes. A
    single value is used for all three. `rotation` turns the body about its centre `at`, three expressions. None leaves
    it along the axes of space. Raises StatementError for other kinds and sizes.
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
    """Return the three entries of `value`, or if `equal`, a single value three times. `what` names it in messages."""
    parts = entries(value, what)
    parts = [value] * 3 if parts is None and equal else parts
    if parts is None or len(parts) != 3:
        raise StatementError(f"{what} is {shown(value)}: give three values{', or one for all' if equal else ''}.")
    return [as_typed(part, f"an entry of {what}") for part in parts]


def _box() -> list[list[Place]]:
    """Return the edges of a cube with sides of length one, centred at zero. Each edge is a list of two points."""
    corners = [(i, j, k) for i, j, k in product((-0.5, 0.5), repeat=3)]
    return [[a, b] for a, b in combinations(corners, 2) if sum(x != y for x, y in zip(a, b, strict=True)) == 1]


def _circle(first: int, second: int) -> list[Place]:
    """Return points of a closed circle of radius one in the plane of the axes with indices `first` and `second`.

    Coordinates are rounded to six digits.
    """
    corners = []
    for k in range(PARTS + 1):
        angle = 2 * math.pi * (k % PARTS) / PARTS
        corner = [0.0, 0.0, 0.0]
        corner[first], corner[second] = round(math.cos(angle), 6) + 0.0, round(math.sin(angle), 6) + 0.0
        corners.append((corner[0], corner[1], corner[2]))
    return corners


def _axes(count: int) -> list[list[Place]]:
    """Return lines of length one from the centre along the first `count` axes. Each line is a list of two points."""
    units: Sequence[Place] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return [[(0.0, 0.0, 0.0), unit] for unit in units[:count]]


OUTLINES: dict[str, Callable[[], list[list[Place]]]] = {
    "box": _box,
    "ellipsoid": lambda: [_circle(0, 1), _circle(1, 2), _circle(2, 0)],
    "disc": lambda: [_circle(0, 1), *_axes(2)],
    "axes": lambda: _axes(3),
}
"""Functions that return the lines of a body of size one, by its kind. A disc has two radii, which show how it turns."""
