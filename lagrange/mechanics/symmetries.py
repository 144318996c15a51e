"""Propose point symmetries of a system, test them, and give their conserved quantities with names."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from typing import Any

import sympy
from sympy import Matrix, S, cos, diff, expand, sin

from lagrange.equations.terms import MonomialSum, printable
from lagrange.equations.textbook_algebra import StatedAlgebra, canonical, is_identity
from lagrange.errors import listing
from lagrange.mechanics.plain_form import vanishes_in_symbols
from lagrange.statement.coordinate import rotation_name
from lagrange.statement.rotation import Rotation, rotation_of
from lagrange.statement.space import product

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
"""Functions from coordinates to the position vector of a body, by number of coordinates. The coordinates are Cartesian,
polar (with the angle from the axis x, or from the downward axis), cylindrical, spherical, or two angles on a sphere,
whose radius counts as 1. The angle b is counted from the pole or from the equator."""


@dataclass(frozen=True, eq=False)
class BodyPosition:
    """Position `r` and velocity `v` of a single body, as vectors of expressions in its coordinates and velocities.

    The kinetic energy is T = `mass` |v|^2 / 2. `rest` is L - T, which is at most linear in velocities.
    """

    mass: Any
    r: tuple[Any, ...]
    v: tuple[Any, ...]
    rest: MonomialSum


def place(stated: StatedAlgebra) -> BodyPosition | None:
    """Return the position of the only body of a statement, or None if its kinetic energy is not mass |v|^2 / 2.

    The coordinates are identified by trying those of `PLACINGS`, such as polar and spherical ones.
    """
    mass = _mass(stated)
    for placing in PLACINGS.get(len(stated.q), ()) if mass is not None else ():
        for order in permutations(range(len(stated.q))):
            r = placing(*(stated.q[i] for i in order))
            v = tuple(sum((diff(x, q) * v for q, v in zip(stated.q, stated.v, strict=True)), S.Zero) for x in r)
            rest = _rest(stated, mass, v)
            if rest is not None:
                return BodyPosition(mass, r, v, rest)
    return None


def _mass(stated: StatedAlgebra) -> Any:
    """Return the mass of a single body, the first constant entry of a diagonal mass matrix; None for other matrices."""
    coupled = (stated.mass[i][j] for i, j in combinations(range(len(stated.q)), 2))
    if any(map(stated.algebra.merge_angles, coupled)):
        return None
    moving = frozenset((*stated.q, *stated.v, stated.time))
    for i in range(len(stated.q)):
        entry = stated.mass[i][i]
        if entry and not any(stated.algebra.free(k) & moving for monomial in entry for k, _ in monomial):
            return stated.algebra.write(entry)
    return None


def _rest(stated: StatedAlgebra, mass: Any, v: Sequence[Any]) -> MonomialSum | None:
    """Return L - mass |v|^2 / 2, or None if it has terms of higher order in the velocities than the first.

    `v` is the vector of the velocity of the body, in the coordinates and velocities of the statement.
    """
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


AXES = {"xy": ("z", 1), "yz": ("x", 1), "zx": ("y", 1), "yx": ("z", -1), "zy": ("x", -1), "xz": ("y", -1)}
"""Axis of the rotation from one axis towards another, and its sense, 1 or -1: x towards y turns about +z."""


def oriented(
    stated: StatedAlgebra, symmetry: Symmetry, position: BodyPosition | None, energy: str = "energy"
) -> tuple[Symmetry, str]:
    """Return a symmetry with the usual sign, and the name of its conserved quantity.

    Rotations turn x towards y. Shifts in time go backwards, so that the quantity is +(v.p - L); its name is `energy`.
    `position` is the position of the body if the system is a single one, else None.
    """
    axis = _axis(stated, symmetry)
    if axis is None and position is not None and symmetry.tau == 0:
        axis = _motion(stated, symmetry, position)
    if axis is None:
        axis = _name(stated, symmetry, energy), -1 if symmetry.tau.is_positive else 1
    name, sense = axis
    if sense > 0:
        return symmetry, name
    return Symmetry(tuple(-xi for xi in symmetry.xi), -symmetry.tau, -symmetry.gauge), name


def _motion(stated: StatedAlgebra, symmetry: Symmetry, body: BodyPosition) -> tuple[str, int] | None:
    """Return (name of the conserved quantity, sign) if a symmetry rotates a body about an axis or shifts it along one.

    The sign is 1 if the rotation or the shift is in the positive direction of the axis, and -1 if it is not. The result
    is None for other symmetries.
    """
    moved = Matrix([sum((x.diff(q) * xi for q, xi in zip(stated.q, symmetry.xi, strict=True)), S.Zero) for x in body.r])
    for k, axis in enumerate("xyz"):
        unit = Matrix([int(j == k) for j in range(3)])
        turned = list(unit.cross(Matrix([*body.r, *([0] * (3 - len(body.r)))])))
        for name, displacement in ((f"angular momentum {axis}", turned), (f"momentum {axis}", list(unit))):
            if any(displacement[len(body.r) :]):
                continue
            for sense in (1, -1):
                differences = (x - sense * y for x, y in zip(moved, displacement, strict=False))
                if all(is_identity(stated.algebra, stated.algebra.read(x)) for x in differences):
                    return name, sense
    return None


def _name(stated: StatedAlgebra, symmetry: Symmetry, energy: str) -> str:
    """Return a name for the conserved quantity of a symmetry that is no rotation; `energy` is that of a shift in time.

    A shift of the coordinate x has "p_x" if the quantity is the momentum dL/dv itself, and "momentum x" if a gauge
    function is added. A shift of several coordinates has a name such as "momentum x" or "momentum of a and b".
    """
    names, moved = stated.statement.names, [i for i, xi in enumerate(symmetry.xi) if xi != 0]
    if symmetry.tau != 0:
        return energy
    if all(symmetry.xi[i] == 1 for i in moved):
        if len(moved) == 1:
            return f"{'p_' if symmetry.gauge == 0 else 'momentum '}{names[moved[0]]}"
        shared = dict.fromkeys(axis_of(names[i]) for i in moved)
        return f"momentum {next(iter(shared)) if len(shared) == 1 else f'of {listing(names[i] for i in moved)}'}"
    return "momentum of a symmetry"


def _axis(stated: StatedAlgebra, symmetry: Symmetry) -> tuple[str, int] | None:
    """Return (name of the conserved quantity, sign) if a symmetry rotates pairs of coordinates such as (x1, y1).

    The sign is 1 if x turns towards y, and -1 if y turns towards x. The result is None for other symmetries.
    """
    names = dict(zip(stated.q, stated.statement.names, strict=True))
    axes: dict[tuple[str, int], None] = {}
    for q, xi in zip(stated.q, symmetry.xi, strict=True):
        if xi == 0:
            continue
        partner = next((other for other in stated.q if xi in (other, -other)), None)
        if partner is None or symmetry.tau != 0:
            return None
        # A symmetry with xi_y = x turns x towards y, which is the positive sense.
        first, second = axis_of(names[partner]), axis_of(names[q])
        axis, sense = AXES.get(first + second, (f"({names[partner]}, {names[q]})", 1))
        axes[axis, sense * (1 if xi == partner else -1)] = None
    if len(axes) != 1:
        return None
    ((axis, sense),) = axes
    return f"angular momentum {axis}", sense


def axis_of(name: str) -> str:
    """Return the axis in the name of a coordinate: x for x, x1 or xs; for others, the name without its number."""
    bare = re.sub(r"_?\d*$", "", name)
    return bare[0].lower() if bare[0].lower() in "xyz" else bare


def described(stated: StatedAlgebra, symmetry: Symmetry) -> str:
    """Return a sentence that states the symmetry and how the Lagrangian behaves under it."""
    names = stated.statement.names
    parts = [f"delta {name} = {_text(stated, xi)}" for name, xi in zip(names, symmetry.xi, strict=True) if xi != 0]
    parts += [f"delta t = {_text(stated, symmetry.tau)}"] if symmetry.tau != 0 else []
    kept = "changes the Lagrangian by a total derivative" if symmetry.gauge != 0 else "leaves the Lagrangian as it is"
    forces = any(stated.statement.forces) or stated.statement.dissipation != 0
    works = " and the forces do no work along it" if forces and symmetry.gauge == 0 else ""
    addition = " It keeps the constraints." if stated.statement.constraints else ""
    if forces and symmetry.gauge != 0:
        kept = "changes the Lagrangian, less the work of the forces, by a total derivative"
    return f"The symmetry {listing(parts)} {kept}{works}.{addition}"


def _text(stated: StatedAlgebra, expression: Any) -> str:
    plain = {q: sympy.Symbol(name) for q, name in zip(stated.q, stated.statement.names, strict=True)}
    return str(expression.xreplace({**plain, stated.time: sympy.Symbol("t")}))


LONGEST_GAUGE = 400
"""Largest number of operations in a formula that SymPy integrates to find a gauge function; ten are typical."""


@dataclass(frozen=True, eq=False)
class Symmetry:
    """An infinitesimal symmetry: the changes `xi` of the n coordinates, and the change `tau` of the time.

    `gauge` is its gauge function F(q, t): the symmetry changes the Lagrangian by dF/dt. All are SymPy expressions in
    symbols for coordinates, parameters and t.
    """

    xi: tuple[Any, ...]
    tau: Any = S.Zero
    gauge: Any = S.Zero


class SymmetryEquation:
    """Condition that a symmetry of a statement satisfies: it tests candidates and finds their gauge functions.

    `forces` are dL/dq + Q - dD/dv, one sum of monomials for each coordinate.
    """

    def __init__(self, stated: StatedAlgebra) -> None:
        self.stated = stated
        slopes = [stated.algebra.differentiate(stated.lagrangian, q) for q in stated.q]
        self.forces = [stated.algebra.add(*pair) for pair in zip(slopes, stated.applied, strict=True)]

    def defect(self, symmetry: Symmetry) -> MonomialSum:
        """Return the defect of a candidate: the time derivative of p . xi - tau E - F along the motion.

        It is zero for a symmetry. p are the momenta, E the energy and F the gauge function. Constraint forces are left
        out.
        """
        stated, algebra = self.stated, self.stated.algebra
        parts: list[MonomialSum] = [{}]
        for shift, force, p in zip(symmetry.xi, self.forces, stated.momenta, strict=True):
            if shift != 0:
                xi = algebra.read(shift)
                parts += [algebra.multiply(xi, force), algebra.multiply(stated.at_constant_velocities(xi), p)]
        if symmetry.tau != 0:
            parts.append(algebra.multiply(algebra.read(-symmetry.tau), stated.power))
        if symmetry.gauge != 0:
            parts.append(algebra.scale(stated.at_constant_velocities(algebra.read(symmetry.gauge)), S.NegativeOne))
        return algebra.merge_angles(algebra.add(*parts))

    def completed(self, symmetry: Symmetry) -> Symmetry | None:
        """Return a candidate with the gauge function F(q, t) that makes it a symmetry, or None if no F is found.

        F is added if the time derivative of p . xi - tau E is not zero but dF/dt; p are the momenta, E the energy.
        """
        defect = self.defect(symmetry)
        if not self._differs(defect):
            return symmetry
        gauge = self._gauge(defect)
        return None if gauge == 0 else replace(symmetry, gauge=gauge)

    def _differs(self, terms: MonomialSum) -> bool:
        """Return True if a sum of monomials is not zero at random values of its symbols."""
        return not vanishes_in_symbols(printable(self.stated.algebra.write(terms)))

    def _gauge(self, defect: MonomialSum) -> Any:
        """Return a function F(q, t) whose time derivative is the `defect` of a candidate, or zero if none is found.

        The defect shows the partial derivatives of F, which are integrated one after another.
        """
        stated, algebra = self.stated, self.stated.algebra
        gauge, left = S.Zero, defect
        slopes = [algebra.merge_angles(algebra.differentiate(defect, v)) for v in stated.v]
        if not self._may_be_time_derivative(defect, slopes):
            return S.Zero
        for q, v in (*zip(stated.q, stated.v, strict=True), (stated.time, None)):
            slope = left if v is None else algebra.differentiate(left, v)
            slope = algebra.merge_angles(slope)
            if not slope or any(algebra.free(k) & frozenset(stated.v) for monomial in slope for k, _ in monomial):
                continue
            integrand = algebra.write(slope)
            if integrand.count_ops() > LONGEST_GAUGE:
                continue
            part = sympy.integrate(integrand, q)
            if part.has(sympy.Integral):
                continue
            gauge += part
            rate = stated.at_constant_velocities(algebra.read(part))
            left = algebra.merge_angles(algebra.add(left, algebra.scale(rate, S.NegativeOne)))
        return gauge if not canonical(algebra, left) else S.Zero

    def _may_be_time_derivative(self, defect: MonomialSum, slopes: Sequence[MonomialSum]) -> bool:
        """Return False if the `defect` of a candidate cannot be the time derivative v . dF/dq + dF/dt of an F(q, t).

        `slopes` are the derivatives of the defect by the velocities. If F exists, they are dF/dq, so that they contain
        no velocities, and their derivatives by t are those of the other terms, dF/dt, by q.
        """
        stated, algebra = self.stated, self.stated.algebra
        if any(algebra.free(k) & frozenset(stated.v) for terms in slopes for monomial in terms for k, _ in monomial):
            return False
        moved = [algebra.multiply(slope, algebra.read(v)) for slope, v in zip(slopes, stated.v, strict=True)]
        rest = algebra.add(defect, algebra.scale(algebra.add({}, *moved), S.NegativeOne))
        for q, slope in zip(stated.q, slopes, strict=True):
            mixed = algebra.scale(algebra.differentiate(slope, stated.time), S.NegativeOne)
            if self._differs(algebra.merge_angles(algebra.add(algebra.differentiate(rest, q), mixed))):
                return False
        return True

    def across(self, symmetry: Symmetry) -> list[MonomialSum]:
        """Return the change of each constraint under a symmetry, G xi; it is zero if the constraint stays valid.

        G are the derivatives of the constraints by coordinates, or by velocities for those on velocities.
        """
        stated, algebra = self.stated, self.stated.algebra
        rates = []
        for constraint in stated.statement.constraints:
            zero, symbols = stated.read(constraint.expression), stated.q if constraint.holonomic else stated.v
            parts = [
                algebra.multiply(algebra.differentiate(zero, symbol), algebra.read(xi))
                for symbol, xi in zip(symbols, symmetry.xi, strict=True)
                if xi != 0
            ]
            rates.append(algebra.merge_angles(algebra.add({}, *parts)))
        return rates

    def proven(self, symmetry: Symmetry) -> bool:
        """Return True if it is proven that a candidate is a symmetry. False means only that no proof was found."""
        stated = self.stated
        moved = [q for q, xi in zip(stated.q, symmetry.xi, strict=True) if xi != 0]
        moved += [stated.time] if symmetry.tau != 0 else []
        if stated.jumps(*moved):
            return False
        conditions = (self.defect(symmetry), *self.across(symmetry))
        return all(is_identity(stated.algebra, terms) for terms in conditions)

    def quantity(self, symmetry: Symmetry) -> MonomialSum:
        """Return the conserved quantity p . xi - tau E - F, with momenta p, energy E and gauge function F."""
        stated, algebra = self.stated, self.stated.algebra
        parts = [algebra.multiply(algebra.read(xi), p) for xi, p in zip(symmetry.xi, stated.momenta, strict=True)]
        if symmetry.tau != 0:
            parts.append(algebra.multiply(algebra.read(-symmetry.tau), stated.energy))
        parts.append(algebra.read(-symmetry.gauge))
        return algebra.merge_angles(algebra.add({}, *parts))


MOST_PAIRED = 6
"""Largest number of coordinates of a system for which rotations are tried in all pairs of coordinates that are not
named by axes. Names such as x1 and y1 are those of axes."""


def shifts(stated: StatedAlgebra) -> Iterator[Symmetry]:
    """Yield shifts that may be symmetries: of time, of single coordinates, of groups, and of all coordinates.

    A group has the coordinates along one axis, such as x1 and x2.
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
    """Yield rotations that may be symmetries.

    One turns all bodies together, in the pairs (x1, y1), (x2, y2) and so on. Coordinates that are not named by axes are
    rotated in one pair at a time.
    """
    bodies: dict[str, dict[str, int]] = {}
    turning = [rotation_name(q) is not None for q in stated.statement.coordinates]
    for i, name in enumerate(stated.statement.names):
        axis = axis_of(name)
        if axis in ("x", "y", "z") and not turning[i]:
            bodies.setdefault(name[1:], {})[axis] = i
    for first, second in (("x", "y"), ("y", "z"), ("z", "x")):
        pairs = [(axes[first], axes[second]) for axes in bodies.values() if first in axes and second in axes]
        if pairs:
            yield _turned(stated.q, pairs)
    used = {i for axes in bodies.values() for i in axes.values()}
    others = [i for i in range(len(stated.q)) if i not in used and not turning[i]]
    for pair in combinations(others, 2) if len(stated.q) <= MOST_PAIRED else ():
        yield _turned(stated.q, [pair])


def body_motions(stated: StatedAlgebra, position: BodyPosition) -> Iterator[Symmetry]:
    """Yield shifts of a single body along fixed axes, and rotations about them, that may be symmetries.

    `position` is the position of the body. Nothing is yielded if its coordinates are Cartesian.
    """
    if position.r == tuple(stated.q):
        return
    r = Matrix([*position.r, *([S.Zero] * (3 - len(position.r)))])
    tangents = [r.diff(q) for q in stated.q]
    squares = [_reduced(tangent.dot(tangent)) for tangent in tangents]
    units = [Matrix([int(j == k) for j in range(3)]) for k in range(3)]
    moved = units[: len(position.r)] if len(position.r) == len(tangents) else []  # no shift stays on a sphere
    turned = [unit.cross(r) for unit in units[:2]] if len(position.r) == 3 else []  # turns about z shift an angle
    for motion in (*moved, *turned):
        parts = [_reduced(tangent.dot(motion)) / square for tangent, square in zip(tangents, squares, strict=True)]
        yield Symmetry(tuple(parts))


def body_turns(stated: StatedAlgebra) -> Iterator[tuple[Rotation, bool, int, Symmetry]]:
    """Yield rotations of each rigid body about its own axes and about axes of space, which may be symmetries.

    Each is (rotation, True if the axis is fixed in the body, index of the axis, symmetry).
    """
    by_coordinate = dict(zip(stated.statement.coordinates, stated.q, strict=True))
    for each in map(rotation_of, stated.statement.rotations):
        q = [by_coordinate[entry] for entry in each.quaternion]
        for axis in range(3):
            unit = (S.Zero, *(sympy.Integer(axis == k) for k in range(3)))
            for of_body, moved in ((False, product(unit, q)), (True, product(q, unit))):
                xi = dict(zip(q, moved, strict=True))
                yield each, of_body, axis, Symmetry(tuple(xi.get(x, S.Zero) / 2 for x in stated.q))


def _reduced(expression: Any) -> Any:
    """Return an expression in the shortest form that expansion and sin^2 + cos^2 = 1 give."""
    expanded = expand(expression)
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
