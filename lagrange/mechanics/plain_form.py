"""The laws of a statement in plain real symbols, which SymPy differentiates and simplifies as it does numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from lagrange.equations.terms import differentiable, printable
from lagrange.evidence.sample import Point
from lagrange.mechanics.simplification import simplest
from lagrange.statement.coordinate import acceleration_of, t, velocity_of
from lagrange.statement.motion import motion_of
from lagrange.statement.statement import Statement

IMAGINARY = 1e-20
"""Imaginary part that is rounding, relative to the real one."""

DIGITS = 30
"""Digits of an evaluated formula: it is compared with doubles, and its own rounding must not count."""


@dataclass(frozen=True, eq=False)
class PlainForm:
    """Energies, momenta and equations in symbols q, v, a of a statement.

    The residual of coordinate i is dp_i/dt - dL/dq_i + dD/dv_i - Q_i, without the forces of constraints.
    """

    statement: Statement

    @cached_property
    def plain(self) -> Mapping[Any, Any]:
        """Replacement of coordinates, velocities and accelerations by their symbols."""
        return self.statement.plain

    @cached_property
    def q(self) -> tuple[Any, ...]:
        """The coordinates' symbols, n of them."""
        return tuple(self.plain[q] for q in self.statement.coordinates)

    @cached_property
    def v(self) -> tuple[Any, ...]:
        """The velocities' symbols, n of them."""
        return tuple(self.plain[v] for v in self.statement.velocities)

    @cached_property
    def a(self) -> tuple[Any, ...]:
        """The accelerations' symbols, n of them."""
        return tuple(self.plain[acceleration_of(q)] for q in self.statement.coordinates)

    @cached_property
    def lagrangian(self) -> Any:
        """L."""
        return self.read(self.statement.lagrangian)

    @cached_property
    def forces(self) -> tuple[Any, ...]:
        """Q - dD/dv, n of them."""
        dissipation = self.read(self.statement.dissipation)
        return tuple(
            self.read(force) - dissipation.diff(v) for force, v in zip(self.statement.forces, self.v, strict=True)
        )

    @cached_property
    def momenta(self) -> tuple[Any, ...]:
        """dL/dv, n of them."""
        return tuple(self.lagrangian.diff(v) for v in self.v)

    @cached_property
    def mass(self) -> Any:
        """d2L/dv2, (n, n)."""
        return sympy.Matrix([[simplest(p.diff(v)) for v in self.v] for p in self.momenta])

    @cached_property
    def residuals(self) -> tuple[Any, ...]:
        """The left sides of the equations of motion with everything on the left, n of them."""
        return tuple(
            self.rate(p) - self.lagrangian.diff(q) - force
            for p, q, force in zip(self.momenta, self.q, self.forces, strict=True)
        )

    def rate(self, given: Any) -> Any:
        """Return the total time derivative of an expression in q, v and t."""
        symbols = (*zip(self.q, self.v, strict=True), *zip(self.v, self.a, strict=True))
        return sympy.Add(given.diff(t), *(given.diff(x) * rate for x, rate in symbols))

    def read(self, given: Any) -> Any:
        """Return a stated expression in plain symbols, in a form that differentiates."""
        return differentiable(given.xreplace(self.plain))

    def written(self, given: Any) -> Any:
        """Return an expression in plain symbols as a user writes it."""
        return printable(given).xreplace(self.stated)

    @cached_property
    def stated(self) -> Mapping[Any, Any]:
        """Replacement of the symbols by coordinates, velocities and accelerations."""
        return {symbol: leaf for leaf, symbol in self.plain.items()}

    def at(self, point: Point) -> dict[Any, Any]:
        """Return the numbers of a point by symbol, exact ones."""
        numbers = [*zip(self.q, point.q, strict=True), *zip(self.v, point.v, strict=True)]
        numbers += [*point.parameters.items(), (t, point.t)]
        return {symbol: sympy.Rational(x) for symbol, x in numbers}


def number(given: Any, values: Mapping[Any, Any]) -> complex:
    """Return the value of an expression in plain symbols, NaN where it has none, as with an open function."""
    known = prescribed(printable(given))
    if known.has(AppliedUndef):
        return complex("nan")
    # A given function may have another symbol of the name. An expression that is one symbol becomes what stands for it.
    by_name = {symbol.name: sympy.Rational(x) if isinstance(x, float) else x for symbol, x in values.items()}
    found = known.xreplace({s: by_name[s.name] for s in known.free_symbols if s.name in by_name}).evalf(DIGITS)
    return complex(found) if found.is_number and found.is_finite else complex("nan")


def prescribed(given: Any) -> Any:
    """Return an expression with the values of its given functions of time, and of their derivatives."""
    if not given.has(AppliedUndef):
        return given
    table: dict[Any, Any] = {}
    for node in sorted(given.atoms(AppliedUndef, sympy.Derivative), key=str):
        function = node.expr if node.is_Derivative else node
        motion = motion_of(function)
        if motion is not None and motion.values is not None:
            table[node] = motion.derivative(len(node.variables) if node.is_Derivative else 0)
    return given.xreplace(table)


def real(given: Any, values: Mapping[Any, Any]) -> float:
    """Return the value of an expression in plain symbols, NaN where it has no real one."""
    found = number(given, values)
    return found.real if abs(found.imag) <= IMAGINARY * abs(found.real) else float("nan")


def numeric(matrix: Any, values: Any) -> Any:
    """Return a SymPy matrix as an array of doubles, complex where it is."""
    found = np.array([number(x, values) for x in matrix], dtype=complex).reshape(matrix.shape)
    return found.real if not found.imag.any() else found


def fresh_name(name: str, taken: Iterable[str]) -> str:
    """Return a name that is not taken yet: the one wanted, or with underscores behind it."""
    known = tuple(taken)
    while name in known:
        name += "_"
    return name


def names_of(statement: Statement) -> tuple[str, ...]:
    """Return every name that a statement uses for a coordinate or a parameter."""
    return (*statement.names, *(p.name for p in statement.parameters))


def without_points(statement: Statement, gone: Iterable[Any]) -> dict[str, Any]:
    """Return positions and links of a statement without the points that some coordinates place."""
    leaves = [leaf for q in gone for leaf in (q, velocity_of(q))]
    points = {name: point for name, point in statement.positions.items() if not any(x.has(*leaves) for x in point)}
    kept = ("origin", *points)
    links = tuple(link for link in statement.links if link.start in kept and link.end in kept)
    return {"positions": points, "links": links}
