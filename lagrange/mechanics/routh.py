"""Routh's procedure: ignorable coordinates left out, their momenta constant, with an effective potential.

With p_I = M_II v_I + b the function R = L - p_I.v_I, written in p_I, is the Lagrangian of the other coordinates. Its
part without velocities is minus the effective potential V + (p_I - b) M_II^-1 (p_I - b)/2.
Source: H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed., 2002, section 8.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy

from lagrange.errors import StatementError, listing, shown
from lagrange.machine.model import Model
from lagrange.mechanics.identity import vanishes
from lagrange.mechanics.legendre import half_square, inverse
from lagrange.mechanics.number_check import compared
from lagrange.mechanics.plain_form import PlainForm, fresh_name, names_of, number, without_points
from lagrange.mechanics.rewriting import with_origin
from lagrange.mechanics.simplification import simplest
from lagrange.statement.coordinate import t, velocity_of
from lagrange.statement.declare import declare
from lagrange.statement.parameters import coordinate_name
from lagrange.statement.statement import Statement


@dataclass(frozen=True, eq=False)
class Routh:
    """The parts of Routh's procedure for the coordinates at `places`, in plain symbols."""

    form: PlainForm
    places: tuple[int, ...]

    @cached_property
    def symbols(self) -> tuple[Any, ...]:
        """The momenta of the ignored coordinates, parameters of the smaller system."""
        taken = list(names_of(self.form.statement))
        found = []
        for i in self.places:
            taken.append(fresh_name(f"p_{self.form.statement.names[i]}"[:64], taken))
            found.append(sympy.Symbol(taken[-1], real=True))
        return tuple(found)

    @cached_property
    def gone(self) -> dict[Any, Any]:
        """Zero for the ignored coordinates, which nothing depends on."""
        return {self.form.q[i]: sympy.S.Zero for i in self.places}

    @cached_property
    def still(self) -> dict[Any, Any]:
        """Zero for the velocities of the ignored coordinates."""
        return {self.form.v[i]: sympy.S.Zero for i in self.places}

    @cached_property
    def shifted(self) -> Any:
        """The column p_I - b."""
        rest = [self.form.momenta[i].xreplace(self.still | self.gone) for i in self.places]
        return sympy.Matrix([p - b for p, b in zip(self.symbols, rest, strict=True)])

    @cached_property
    def inverted(self) -> tuple[Any, Any]:
        """The adjugate and the determinant of M_II."""
        adjugate, determinant = inverse(self.form, self.places)
        return adjugate.xreplace(self.gone), determinant.xreplace(self.gone)

    @cached_property
    def rates(self) -> tuple[Any, ...]:
        """The velocities of the ignored coordinates."""
        adjugate, determinant = self.inverted
        return tuple(simplest(x / determinant) for x in adjugate * self.shifted)

    @cached_property
    def routhian(self) -> tuple[Any, Any]:
        """The part of R with velocities, and the effective potential."""
        at_rest = dict.fromkeys(self.form.v, sympy.S.Zero)
        mass = self.form.mass.extract(list(self.places), list(self.places)).xreplace(self.gone)
        half = half_square(mass, self.inverted, self.shifted)
        rest = self.form.lagrangian.xreplace(self.still | self.gone)
        centrifugal, potential = half.xreplace(at_rest), rest.xreplace(at_rest)
        moving = (rest - potential) - (half - centrifugal)
        return simplest(moving), centrifugal - simplest(potential)


def places_of(statement: Statement, wanted: Sequence[Any]) -> tuple[int, ...]:
    """Return where coordinates stand that are given as such or by name."""
    if not wanted:
        raise StatementError("routhian() names no coordinate: give one that is ignorable.")
    found = [statement.names.index(coordinate_name(one, statement.names)) for one in wanted]
    if len(dict.fromkeys(found)) == len(statement.names):
        raise StatementError(
            f"every coordinate of {statement.name} would be ignored: without one nothing is left to move."
        )
    return tuple(dict.fromkeys(found))


def routh_of(statement: Statement, wanted: Sequence[Any]) -> Routh:
    """Return the procedure for some coordinates. Raises StatementError where one of them is not ignorable."""
    places, form = places_of(statement, wanted), PlainForm(statement)
    for i in places:
        _check_ignorable(form, i)
    if form.mass.extract(list(places), list(places)).has(*(form.v[i] for i in places)):
        names = listing(statement.names[i] for i in places)
        raise StatementError(
            f"the momenta of {names} are not linear in their velocities, which are then not solved for: "
            "hamiltonian() may solve them together with the others."
        )
    return Routh(form, places)


def routhian(statement: Statement, wanted: Sequence[Any], model: Model) -> Statement:
    """Return the statement without ignorable coordinates, whose momenta are parameters; tested against the model."""
    routh = routh_of(statement, wanted)
    form, places = routh.form, routh.places
    left = [q for i, q in enumerate(statement.coordinates) if i not in places]
    rates = dict(zip((form.v[i] for i in places), routh.rates, strict=True)) | routh.gone

    def put(given: Any) -> Any:
        return form.written(form.read(given).xreplace(rates))

    kinetic, potential = routh.routhian
    start = dict(zip((*statement.coordinates, *statement.velocities), statement.initial, strict=True))
    points = without_points(statement, [statement.coordinates[i] for i in places])
    made = declare(
        kinetic=form.written(kinetic),
        potential=form.written(potential),
        coordinates=left,
        forces={
            q: put(force)
            for i, (q, force) in enumerate(zip(statement.coordinates, statement.forces, strict=True))
            if i not in places and force != 0
        },
        dissipation=form.written(form.read(statement.dissipation).xreplace(routh.gone)),
        constraints={one.name: one.expression for one in statement.constraints},
        redundant=statement.redundant,
        parameters={p: statement.defaults.get(p) for p in statement.parameters} | _momenta(routh),
        initial={key: start[key] for q in left for key in (q, velocity_of(q))},
        positions=points["positions"],
        links=points["links"],
        name=statement.name,
    )
    _check(routh, model)
    return with_origin(made, statement)


def _check_ignorable(form: PlainForm, i: int) -> None:
    """Refuse a coordinate whose momentum changes, with the rate at which it does."""
    statement, name = form.statement, form.statement.names[i]
    slope = form.lagrangian.diff(form.q[i])
    if not vanishes(form, slope):
        raise StatementError(
            f"{name} is not ignorable: dL/d{name} = {shown(str(form.written(simplest(slope))))} is not zero, so its "
            "momentum is no constant. Choose another coordinate."
        )
    if not vanishes(form, form.forces[i]):
        raise StatementError(
            f"{name} is not ignorable: the force {shown(str(form.written(simplest(form.forces[i]))))} changes its "
            "momentum, which has to be a constant. Choose another coordinate."
        )
    q, v = statement.coordinates[i], statement.velocities[i]
    for one in statement.constraints:
        if one.expression.has(q, v):
            raise StatementError(
                f"{name} is not ignorable: the constraint {one.name!r} acts on it. eliminate(...) solves it for a "
                "coordinate."
            )
    for other, force in zip(statement.names, form.forces, strict=True):
        if not vanishes(form, force.diff(form.q[i])):
            raise StatementError(
                f"{name} is not ignorable: the force on {other} depends on it. Choose another coordinate."
            )


def _momenta(routh: Routh) -> dict[Any, float | None]:
    """Return the momenta at the initial state, or None where a parameter has no value."""
    statement, form = routh.form.statement, routh.form
    if any(p not in statement.defaults for p in statement.parameters):
        return dict.fromkeys(routh.symbols)
    values = {symbol: sympy.Rational(x) for symbol, x in zip((*form.q, *form.v), statement.initial, strict=True)}
    values |= {p: sympy.Rational(x) for p, x in statement.defaults.items()} | {t: sympy.S.Zero}
    found: dict[Any, float | None] = {}
    for symbol, i in zip(routh.symbols, routh.places, strict=True):
        value = number(form.momenta[i], values)
        found[symbol] = value.real if value == value and not value.imag else None
    return found


def _check(routh: Routh, model: Model) -> None:
    """Compare the velocities of the ignored coordinates, and minus dR/dq as forces, with the compiled model."""
    form = routh.form
    kinetic, potential = routh.routhian
    left = [i for i in range(len(form.q)) if i not in routh.places]
    rates = dict(zip((form.v[i] for i in routh.places), routh.rates, strict=True)) | routh.gone
    slopes = [(kinetic - potential).diff(form.q[i]) + form.forces[i].xreplace(rates) for i in left]
    momenta = [kinetic.diff(form.v[i]) for i in left]

    def values(point: Any) -> tuple[list[float], list[Any]]:
        p = model.momenta(point.q, point.v, point.t, point.parameters)
        forces = model.evaluate("forces", point.q, point.v, point.t, point.parameters)
        numbers = form.at(point)
        numbers |= {s: sympy.Rational(float(p[i])) for s, i in zip(routh.symbols, routh.places, strict=True)}
        compiled = [*(point.v[i] for i in routh.places), *(forces[i] for i in left), *(p[i] for i in left)]
        return compiled, [number(x, numbers) for x in (*routh.rates, *slopes, *momenta)]

    compared("the Routhian", form.statement, values)
