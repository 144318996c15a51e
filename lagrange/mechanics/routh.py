"""Routh's procedure: ignorable coordinates left out, and rebuilt along a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import sympy
from scipy.integrate import quad_vec

from lagrange.errors import RunError, StatementError, listing, shown
from lagrange.evidence.agreement import compared
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.hamilton import half_square, inverse
from lagrange.mechanics.plain_form import PlainForm, fresh_name, names_of, number, simplest, vanishes, without_points
from lagrange.mechanics.reduction import with_origin
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
        """Replacement of the ignored coordinates by zero: nothing depends on them."""
        return {self.form.q[i]: sympy.S.Zero for i in self.places}

    @cached_property
    def still(self) -> dict[Any, Any]:
        """Replacement of the velocities of the ignored coordinates by zero."""
        return {self.form.v[i]: sympy.S.Zero for i in self.places}

    @cached_property
    def shifted(self) -> Any:
        """The column p_I - b: momenta of the ignored coordinates, less their values at zero ignored velocities."""
        rest = [self.form.momenta[i].xreplace(self.still | self.gone) for i in self.places]
        return sympy.Matrix([p - b for p, b in zip(self.symbols, rest, strict=True)])

    @cached_property
    def inverted(self) -> tuple[Any, Any]:
        """Adjugate and determinant of M_II, the mass matrix of the ignored coordinates."""
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
    """Return the indices of coordinates, each of which is a coordinate or its name."""
    if not wanted:
        raise StatementError("routhian() names no coordinate: give one that is ignorable.")
    found = [statement.names.index(coordinate_name(one, statement.names)) for one in wanted]
    if len(dict.fromkeys(found)) == len(statement.names):
        raise StatementError(
            f"every coordinate of {statement.name} would be ignored: without one nothing is left to move."
        )
    return tuple(dict.fromkeys(found))


def routh_of(statement: Statement, wanted: Sequence[Any]) -> Routh:
    """Return Routh's procedure for some coordinates. Raises StatementError if one of them is not ignorable."""
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
    """Raise StatementError, with the rate of the momentum, if the momentum of a coordinate is not constant."""
    statement, name = form.statement, form.statement.names[i]
    slope = form.lagrangian.diff(form.q[i])
    if not vanishes(form, slope):
        raise StatementError(
            f"{name} is not ignorable: dL/d{name} = {shown(str(form.written(simplest(slope))))} is not zero, so its "
            "momentum is not a constant. Choose another coordinate."
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


MOST_PARTS = 64
"""Largest number of parts of an interval between outputs."""

TOLERANCE = 1e-12
"""Largest estimated error of an integral, relative to the largest change between two output times."""


def ignored(statement: Statement, solution: Any) -> dict[Any, FloatArray]:
    """Return ignored coordinates and their velocities at the output times of a `Solution` of the Routhian, (N,) each.

    They start at the initial values of the statement. Raises StatementError for a run of another system.
    """
    small = getattr(getattr(solution, "model", None), "statement", None)
    missing = [] if small is None else [q for q in statement.coordinates if q not in small.coordinates]
    if small is None or not missing or any(q not in statement.coordinates for q in small.coordinates):
        raise StatementError(
            f"this is not a run of a Routhian of {statement.name}: run routhian(...) of this system, of "
            f"{listing(statement.names)}, and give that solution."
        )
    routh = routh_of(statement, missing)
    found: dict[Any, FloatArray] = {}
    for i, rate in zip(routh.places, routh.rates, strict=True):
        q = statement.coordinates[i]
        speed = partial(_speed, solution, routh.form.written(rate))
        found[q] = statement.initial[i] + _integral(speed, solution.t, statement.names[i])
        found[velocity_of(q)] = speed(solution.t)
    return found


def _speed(solution: Any, rate: Any, times: FloatArray) -> FloatArray:
    """Return the velocity of an ignored coordinate at times (K,) of a run."""
    model: Model = solution.model
    return model.evaluate_expression(rate, times, solution.at(times), solution.parameters)


def _integral(speed: Callable[[FloatArray], FloatArray], times: FloatArray, name: str) -> FloatArray:
    """Return the integral of a velocity from the first time to each, (N,); all intervals are halved together."""
    lengths = np.diff(times)
    if not len(lengths):
        return np.zeros(1)
    rule: Any = quad_vec  # its types know numbers alone, not arrays
    changes, _, found = rule(
        lambda share: speed(times[:-1] + share * lengths) * lengths,
        0.0,
        1.0,
        epsabs=0.0,
        epsrel=TOLERANCE,
        norm="max",
        limit=MOST_PARTS,
        full_output=True,
    )
    if not found.success:
        raise RunError(
            f"{name} is not rebuilt to {TOLERANCE:g}: its velocity varies too fast between the output times. Run with "
            "shorter steps, or with t_eval closer together."
        )
    return np.concatenate([[0.0], np.cumsum(changes)])
