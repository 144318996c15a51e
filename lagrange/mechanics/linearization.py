"""Equations of motion linearised about a point: M d2x + C dx + K x = B u for small changes x.

With the residual r(q, v, a, t) of the equations of motion M = dr/da, C = dr/dv and K = dr/dq. With constraints the
changes are x = N z, N a basis of the null space of G, and -lambda dG/dq adds to K; see Schwab and Meijaard.
Source: A. L. Schwab, J. P. Meijaard, Dynamics of flexible multibody systems with non-holonomic constraints, Multibody
System Dynamics 10, 2003; L. Meirovitch, Methods of Analytical Dynamics, 1970, section 6.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import sympy

from lagrange.errors import StatementError, formula, listing
from lagrange.mechanics.plain_form import PlainForm
from lagrange.mechanics.point import StatedPoint
from lagrange.mechanics.simplification import simplest
from lagrange.statement.coordinate import t
from lagrange.statement.notebook_page import ShownAsPage
from lagrange.statement.statement import Statement

INFINITE = (sympy.nan, sympy.zoo, sympy.oo, sympy.AccumBounds)
"""What stands where an expression has no value."""


@dataclass(frozen=True, eq=False)
class Linearization(ShownAsPage):
    """M x'' + C x' + K x = (input matrix) u about a point, SymPy matrices.

    x are changes of `coordinates`: all of the system, or with constraints those that are independent, and the changes
    of all are `basis` times x. With constraints on velocities, x' stands for independent velocities, `velocity_basis`
    times which are all, and K acts on changes of positions. `equilibrium` says whether the point stays where it is, or
    moves steadily with the velocities given; `note` says so in a sentence. `statement` is that of the system.
    """

    coordinates: tuple[Any, ...]
    at: Mapping[Any, Any]
    M: Any
    C: Any
    K: Any
    inputs: tuple[Any, ...]
    input_matrix: Any
    basis: Any
    velocity_basis: Any
    equilibrium: bool
    note: str
    statement: Statement

    def __repr__(self) -> str:
        return f"<Linearization: {self.note} M = {self.M.tolist()}, C = {self.C.tolist()}, K = {self.K.tolist()}>"

    def __reduce__(self) -> tuple[Any, ...]:
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return _again, ({**values, "at": dict(self.at)},)

    @cached_property
    def A(self) -> Any:
        """The matrix of d/dt [x, x'] = A [x, x'] + B u."""
        rates = self._inverse * sympy.Matrix.hstack(-self.K, -self.C)
        k, n = self.K.cols, self.C.cols
        follow = sympy.eye(k)
        if k != n:
            left = (self.basis.T * self.basis).inv() * self.basis.T
            follow = left * self.velocity_basis
        above = sympy.Matrix.hstack(sympy.zeros(k, k), follow)
        return sympy.Matrix.vstack(above, rates).applyfunc(simplest)

    @cached_property
    def B(self) -> Any:
        """The matrix of the inputs, (2n, inputs)."""
        below = (self._inverse * self.input_matrix).applyfunc(simplest)
        return sympy.Matrix.vstack(sympy.zeros(self.K.cols, below.cols), below)

    @cached_property
    def _inverse(self) -> Any:
        """M^-1. Raises StatementError where a motion has no inertia at the point."""
        determinant = simplest(self.M.det(method="berkowitz"))
        if determinant == 0:
            raise StatementError(
                "the mass matrix is singular at this point, so that A and B do not exist: M, C and K do. Choose "
                "coordinates that are regular there."
            )
        return (self.M.adjugate() / determinant).applyfunc(simplest)


def _again(values: dict[str, Any]) -> Linearization:
    return Linearization(**{**values, "at": MappingProxyType(values["at"])})


def linearized_at(point: StatedPoint) -> Linearization:
    """Return the linearization about a point; see `Analysis.linearize`."""
    if point.form.statement.constraints:
        return _Held(point).linearization()
    form = point.form
    rest = [simplest(r.xreplace(dict.fromkeys(form.a, sympy.S.Zero)).xreplace(point.table)) for r in point.residuals]
    mass = _matrix(form.a, point)
    still = dict.fromkeys(form.a, sympy.S.Zero)
    damping, stiffness = (_matrix(symbols, point, still) for symbols in (form.v, form.q))
    if any(x.has(*INFINITE) for x in (*rest, *mass, *damping, *stiffness)):
        raise StatementError(
            f"the forces of {form.statement.name}, or their derivatives, have no value at {point.where}: choose "
            "another point, or coordinates that are regular at it."
        )
    balanced = all(point.is_zero(r, stiffness) for r in rest)
    here = still
    if not balanced:
        here = dict(zip(form.a, _accelerations(form, mass, rest), strict=True))
        damping, stiffness = (_matrix(symbols, point, here) for symbols in (form.v, form.q))
    steady = all(
        speed == 0 or all(point.is_zero(x, ()) for x in (*stiffness[:, i], *stiffness[i, :]))
        for i, speed in enumerate(point.v)
    )
    eye = sympy.eye(len(form.q))
    return Linearization(
        coordinates=form.statement.coordinates,
        at=_at(point),
        M=mass,
        C=damping,
        K=stiffness,
        inputs=tuple(point.inputs),
        input_matrix=-_matrix(tuple(point.inputs), point, here),
        basis=eye,
        velocity_basis=eye,
        equilibrium=balanced and steady,
        note=_note(point, rest, balanced, steady),
        statement=point.form.statement,
    )


def _matrix(symbols: Sequence[Any], point: StatedPoint, here: Mapping[Any, Any] | None = None) -> Any:
    """Return the derivatives of the residuals by some symbols, at the point."""
    table = point.table
    rows = [[simplest(r.diff(x).xreplace(dict(here or {})).xreplace(table)) for x in symbols] for r in point.residuals]
    return sympy.Matrix(len(rows), len(symbols), [x for row in rows for x in row])


def _accelerations(form: PlainForm, mass: Any, rest: Sequence[Any]) -> tuple[Any, ...]:
    """Return the accelerations at a point that is no equilibrium."""
    determinant = simplest(mass.det(method="berkowitz"))
    if determinant == 0:
        raise StatementError(
            f"the mass matrix of {form.statement.name} is singular at this point, which is no equilibrium: its "
            "accelerations are not determined there. Choose another point."
        )
    return tuple(simplest(-x / determinant) for x in mass.adjugate() * sympy.Matrix(rest))


def _at(point: StatedPoint) -> Mapping[Any, Any]:
    """Return the point in the user's symbols: coordinates, and velocities that are not zero."""
    statement = point.form.statement
    places = dict(zip(statement.coordinates, point.q, strict=True))
    speeds = {v: x for v, x in zip(statement.velocities, point.v, strict=True) if x != 0}
    return MappingProxyType(places | speeds | dict(point.inputs))


def _note(point: StatedPoint, rest: Sequence[Any], balanced: bool, steady: bool) -> str:
    form = point.form
    if balanced and steady:
        return "About a steady motion." if any(point.v) else "About an equilibrium."
    if balanced:
        names = listing(name for name, v in zip(form.statement.names, point.v, strict=True) if v != 0)
        return f"Away from equilibrium: {names} moves, and the matrices hold at this instant."
    parts = [
        f"{formula(form.written(-r), 80)} on {name}"
        for name, r in zip(form.statement.names, rest, strict=True)
        if not point.is_zero(r, ())
    ]
    return f"Away from equilibrium: the forces left are {listing(parts)}, and the matrices hold at this instant."


MOST_TOLD = 3
"""Forces that a message lists: each takes up to 60 letters."""


class _Held:
    """The linearization of a system with constraints about an equilibrium at rest."""

    def __init__(self, point: StatedPoint) -> None:
        self.point, self.form, self.statement = point, point.form, point.form.statement
        self.zeros = [self.form.read(one.expression) for one in self.statement.constraints]
        self.holonomic = [one.holonomic for one in self.statement.constraints]
        self.check()

    def put(self, given: Any) -> Any:
        """Return an expression at the point, at rest."""
        return simplest(given.xreplace(dict.fromkeys(self.form.a, sympy.S.Zero)).xreplace(self.point.table))

    def check(self) -> None:
        """Refuse a point that moves, or is not on the constraints."""
        if any(self.point.v):
            raise StatementError(
                f"{self.statement.name} has constraints and is linearised at rest only: leave the velocities out, or "
                "eliminate(...) the constraints first."
            )
        for one, zero in zip(self.statement.constraints, self.zeros, strict=True):
            if zero.has(t):
                raise StatementError(f"the constraint {one.name!r} moves with time, and no point stays on it.")
            here = self.put(zero)
            if not self.point.is_zero(here, ()):
                raise StatementError(
                    f"the point is not on the constraint {one.name!r}, which is {formula(here, 80)} there and not "
                    "zero: give values of all coordinates in it."
                )

    @cached_property
    def gradient(self) -> list[list[Any]]:
        """The rows of G as functions, of constraints that are independent at the point."""
        rows = [
            [zero.diff(x) for x in (self.form.q if holonomic else self.form.v)]
            for zero, holonomic in zip(self.zeros, self.holonomic, strict=True)
        ]
        here = sympy.Matrix([[self.put(x) for x in row] for row in rows])
        _, pivots = here.T.rref(simplify=True)
        if len(pivots) < len(rows) and self.statement.redundant == "refuse":
            raise StatementError("the constraints are dependent at this point, so that it has no linearization.")
        self.kept = list(pivots)
        return [rows[i] for i in pivots]

    def _told(self, left: Any) -> str:
        """Return the forces that are not zero, by coordinate."""
        names = zip(self.statement.names, left, strict=True)
        told = [f"{str(self.form.written(-x))[:60]} on {name}" for name, x in names if not self.point.is_zero(x, left)]
        return listing([*told[:MOST_TOLD], "others"] if len(told) > MOST_TOLD else told)

    def linearization(self) -> Linearization:
        """Return the equations in independent coordinates."""
        form, gradient = self.form, self.gradient
        here = sympy.Matrix([[self.put(x) for x in row] for row in gradient])
        rest = sympy.Matrix([self.put(r) for r in self.point.residuals])
        multipliers = ((here * here.T).inv() * here * rest).applyfunc(simplest)
        left = (rest - here.T * multipliers).applyfunc(simplest)
        if not all(self.point.is_zero(x, rest) for x in left):
            raise StatementError(
                f"{self.statement.name} has constraints and is linearised about equilibria only: at this point the "
                f"forces left along the constraints are {self._told(left)}. Give an equilibrium."
            )
        pushes = [
            r - sympy.Add(*(multipliers[k] * row[i] for k, row in enumerate(gradient)))
            for i, r in enumerate(self.point.residuals)
        ]

        def slopes(symbols: Sequence[Any]) -> Any:
            entries = [[self.put(r.diff(x)) for x in symbols] for r in pushes]
            return sympy.Matrix(len(pushes), len(symbols), [x for row in entries for x in row])

        whole = _null_space(here)
        places = [k for k, i in enumerate(self.kept) if self.holonomic[i]]
        basis = whole if len(places) == here.rows else _null_space(here.extract(places, list(range(here.cols))))
        made = {
            "M": whole.T * slopes(form.a) * whole,
            "C": whole.T * slopes(form.v) * whole,
            "K": whole.T * slopes(form.q) * basis,
            "input_matrix": -whole.T * slopes(tuple(self.point.inputs)),
        }
        return Linearization(
            coordinates=tuple(self.statement.coordinates[i] for i in _independent(basis)),
            at=_at(self.point),
            inputs=tuple(self.point.inputs),
            basis=basis,
            velocity_basis=whole,
            equilibrium=True,
            note="About an equilibrium on the constraints.",
            statement=self.statement,
            **{name: matrix.applyfunc(simplest) for name, matrix in made.items()},
        )


def _null_space(gradient: Any) -> Any:
    """Return a basis of the directions that constraints allow, with a one for each independent coordinate."""
    if not gradient.rows:
        return sympy.eye(gradient.cols)
    columns = gradient.nullspace(simplify=True)
    if not columns:
        raise StatementError("the constraints leave no motion: there is nothing to linearise.")
    return sympy.Matrix.hstack(*columns).applyfunc(simplest)


def _independent(basis: Any) -> list[int]:
    """Return the rows of a basis in which one column is one and the others are zero."""
    units = [[int(i == j) for j in range(basis.cols)] for i in range(basis.cols)]
    rows = basis.tolist()
    return [next(k for k, row in enumerate(rows) if row == unit) for unit in units]
