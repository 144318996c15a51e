"""Names of what symmetries conserve: momenta of shifts, angular momenta of rotations; and the reason in words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import sympy
from sympy import Matrix, S

from lagrange.equations.identities import is_identity
from lagrange.equations.stated_algebra import StatedAlgebra
from lagrange.errors import listing
from lagrange.mechanics.places import Place
from lagrange.mechanics.symmetries import Symmetry

AXES = {"xy": ("z", 1), "yz": ("x", 1), "zx": ("y", 1), "yx": ("z", -1), "zy": ("x", -1), "xz": ("y", -1)}
"""The axis of the rotation that moves the second of two axes along the first, and its sense."""


def oriented(
    stated: StatedAlgebra, symmetry: Symmetry, place: Place | None, energy: str = "energy"
) -> tuple[Symmetry, str]:
    """Return a symmetry, or the one in the other direction, and a name of its quantity.

    The direction is the one from x to y, and back in time: its quantity is +(v.p - L). `energy` is the name of v.p - L.
    """
    found = _axis(stated, symmetry)
    if found is None and place is not None and symmetry.tau == 0:
        found = _motion(stated, symmetry, place)
    if found is None:
        found = _name(stated, symmetry, energy), -1 if symmetry.tau.is_positive else 1
    name, sense = found
    if sense > 0:
        return symmetry, name
    return Symmetry(tuple(-xi for xi in symmetry.xi), -symmetry.tau, -symmetry.gauge), name


def _motion(stated: StatedAlgebra, symmetry: Symmetry, place: Place) -> tuple[str, int] | None:
    """Return the name of a rotation about a fixed axis or of a shift along one, as the body's place shows it."""
    moved = Matrix(
        [sum((x.diff(q) * xi for q, xi in zip(stated.q, symmetry.xi, strict=True)), S.Zero) for x in place.r]
    )
    for k, axis in enumerate("xyz"):
        unit = Matrix([int(j == k) for j in range(3)])
        turned = list(unit.cross(Matrix([*place.r, *([0] * (3 - len(place.r)))])))
        for name, wanted in ((f"angular momentum {axis}", turned), (f"momentum {axis}", list(unit))):
            if any(wanted[len(place.r) :]):
                continue
            for sense in (1, -1):
                if all(_same(stated, x, sense * y) for x, y in zip(moved, wanted, strict=False)):
                    return name, sense
    return None


def _same(stated: StatedAlgebra, first: Any, second: Any) -> bool:
    return is_identity(stated.algebra, stated.algebra.read(first - second))


def untaken(name: str, taken: Sequence[str]) -> str:
    """Return the name, with a number behind it if it is taken."""
    names = [name, *(f"{name} ({k})" for k in range(2, len(taken) + 2))]
    return next(one for one in names if one not in taken)


def _name(stated: StatedAlgebra, symmetry: Symmetry, energy: str) -> str:
    """Return a name; only the conjugate momentum dL/dv itself is p_x, of a shift with F = 0."""
    names, moved = stated.statement.names, [i for i, xi in enumerate(symmetry.xi) if xi != 0]
    if symmetry.tau != 0:
        return energy
    if all(symmetry.xi[i] == 1 for i in moved):
        if len(moved) == 1:
            return f"{'p_' if symmetry.gauge == 0 else 'momentum '}{names[moved[0]]}"
        shared = dict.fromkeys(axis_of(names[i]) for i in moved)
        return (
            f"momentum {next(iter(shared))}" if len(shared) == 1 else f"momentum of {listing(names[i] for i in moved)}"
        )
    return "momentum of a symmetry"


def _axis(stated: StatedAlgebra, symmetry: Symmetry) -> tuple[str, int] | None:
    """Return the name of a rotation of pairs of coordinates, such as x1 and y1, about an axis, and the sense."""
    names = dict(zip(stated.q, stated.statement.names, strict=True))
    found: dict[tuple[str, int], None] = {}
    for q, xi in zip(stated.q, symmetry.xi, strict=True):
        if xi == 0:
            continue
        partner = next((other for other in stated.q if xi in (other, -other)), None)
        if partner is None or symmetry.tau != 0:
            return None
        # xi_y = x is the positive sense of the plane (x, y).
        first, second = axis_of(names[partner]), axis_of(names[q])
        axis, sense = AXES.get(first + second, (f"({names[partner]}, {names[q]})", 1))
        found[axis, sense * (1 if xi == partner else -1)] = None
    if len(found) != 1:
        return None
    ((axis, sense),) = found
    return f"angular momentum {axis}", sense


def axis_of(name: str) -> str:
    """Return the axis of a coordinate such as x, x1 or ys: a name without its number, or its first letter."""
    bare = re.sub(r"_?\d*$", "", name)
    return bare[0].lower() if bare[0].lower() in "xyz" else bare


def described(stated: StatedAlgebra, symmetry: Symmetry) -> str:
    """Return the motion that changes nothing, in words."""
    names = stated.statement.names
    parts = [f"delta {name} = {_text(stated, xi)}" for name, xi in zip(names, symmetry.xi, strict=True) if xi != 0]
    parts += [f"delta t = {_text(stated, symmetry.tau)}"] if symmetry.tau != 0 else []
    kept = "changes the Lagrangian by a total derivative" if symmetry.gauge != 0 else "leaves the Lagrangian as it is"
    forces = any(stated.statement.forces) or stated.statement.dissipation != 0
    works = " and the forces do no work along it" if forces and symmetry.gauge == 0 else ""
    held = " It keeps the constraints." if stated.statement.constraints else ""
    if forces and symmetry.gauge != 0:
        kept = "changes the Lagrangian, less the work of the forces, by a total derivative"
    return f"The symmetry {listing(parts)} {kept}{works}.{held}"


def _text(stated: StatedAlgebra, given: Any) -> str:
    plain = {q: sympy.Symbol(name) for q, name in zip(stated.q, stated.statement.names, strict=True)}
    return str(given.xreplace({**plain, stated.time: sympy.Symbol("t")}))
