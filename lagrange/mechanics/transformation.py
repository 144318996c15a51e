"""Derive a system in other coordinates (`transform`), or without ignorable ones (`routhian`).

Along a run of the smaller system the ignored coordinates are computed by integration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from scipy.integrate import quad_vec

from lagrange.equations.terms import differentiable, printable
from lagrange.errors import RunError, StatementError, listing, shown
from lagrange.evidence.formula_comparison import compared
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.hamilton import half_square, inverse
from lagrange.mechanics.plain_form import (
    PlainForm,
    momentum_names,
    number,
    prescribed,
    real,
    simplest,
    time_derivative,
    vanishes,
)
from lagrange.mechanics.reduction import read_with, rewritten, with_origin
from lagrange.mechanics.roots import STARTS, numeric_roots
from lagrange.statement.coordinate import COORDINATES, acceleration_of, name_of, t, velocity_of
from lagrange.statement.declare import ORIGIN, declare
from lagrange.statement.expression import check_once, entries, expression, refusing_deep
from lagrange.statement.parameters import Survey, coordinate_name, in_own_parameters, label_of, table_of
from lagrange.statement.statement import Statement

START_RESIDUAL = 1e-9
"""Largest error of old initial velocities computed from the new ones, relative to the largest old one, or to 1"""


@dataclass(frozen=True, eq=False)
class Transformation:
    """A point transformation: the old coordinates `replaced` equal the `expressions` in the `new` coordinates.

    The expressions may also contain coordinates that are not replaced, parameters and t. `positive` are the new
    coordinates that are positive. `statement` is the statement in the old coordinates.
    """

    statement: Statement
    replaced: tuple[Any, ...]
    expressions: tuple[Any, ...]
    new: tuple[Any, ...]
    positive: tuple[Any, ...]

    @cached_property
    def coordinates(self) -> tuple[Any, ...]:
        """All coordinates of the new statement: those that stay, and the new ones at the place of the replaced ones."""
        left = [q for q in self.statement.coordinates if q not in self.replaced]
        first = min(self.statement.coordinates.index(q) for q in self.replaced)
        before = [q for q in self.statement.coordinates[:first] if q in left]
        return (*before, *self.new, *left[len(before) :])

    @cached_property
    def plain(self) -> dict[Any, Any]:
        """Mapping of coordinates of the new statement and their derivatives, as functions of time, to SymPy symbols."""
        table: dict[Any, Any] = {}
        for q in self.coordinates:
            name = name_of(q)
            table[q] = sympy.Symbol(name, positive=True) if q in self.positive else sympy.Symbol(name, real=True)
            table[velocity_of(q)] = sympy.Symbol(f"{name}_dot", real=True)
            table[acceleration_of(q)] = sympy.Symbol(f"{name}_ddot", real=True)
        return table

    def back(self, expr: Any) -> Any:
        """Return an expression with the user's functions of time in place of the symbols of `plain`."""
        return printable(expr).xreplace({symbol: leaf for leaf, symbol in self.plain.items()})

    @cached_property
    def old(self) -> tuple[Any, ...]:
        """The replaced coordinates, as expressions in the symbols of the new coordinates."""
        return tuple(differentiable(x.xreplace(self.plain)) for x in self.expressions)

    @cached_property
    def slopes(self) -> Any:
        """Derivatives of the m replaced coordinates by all n coordinates of the new statement, a matrix (m, n)."""
        return sympy.Matrix([[x.diff(self.plain[q]) for q in self.coordinates] for x in self.old])

    @cached_property
    def table(self) -> dict[Any, Any]:
        """Mapping of old coordinates and velocities to expressions in the symbols of the new statement."""
        replacements = dict(self.plain)
        for q, x in zip(self.replaced, self.old, strict=True):
            replacements[q], replacements[velocity_of(q)] = x, time_derivative(x, self.plain)
        return replacements

    def put(self, expr: Any) -> Any:
        """Return an expression of the old statement, rewritten in the new coordinates as functions of time."""
        if not expr.has(*self.replaced, *self.positive):
            return expr
        return self.back(simplest(printable(expr.xreplace(self.table))))


@refusing_deep
def transformed(
    statement: Statement,
    expressions: Mapping[Any, Any],
    positive: Any,
    parameters: Mapping[Any, Any] | None,
    initial: Mapping[Any, Any] | None,
    model: Model,
) -> Statement:
    """Return the statement in new coordinates, after a test against `model`, the compiled model in old coordinates.

    `expressions` maps old coordinates to expressions in new ones. `positive` lists new coordinates that are positive.
    `parameters` has values for parameters that only the expressions contain. `initial` is the initial state in the new
    coordinates. If it is None, the state is computed from the old initial state. Raises StatementError if the
    expressions are not a transformation.
    """
    change = _transformation(statement, expressions, positive)
    columns = [change.coordinates.index(q) for q in change.new]
    determinant = change.slopes.extract(list(range(len(change.replaced))), columns).det(method="berkowitz")
    if simplest(determinant) == 0:
        raise StatementError(
            f"{listing(map(name_of, change.replaced))} do not vary independently with "
            f"{listing(map(name_of, change.new))}: the determinant of the derivatives is zero everywhere. Give "
            "independent expressions."
        )
    stated = table_of(initial, "initial", "new coordinate or velocity to value, such as {r: 1.0}")
    start = dict(zip((*statement.coordinates, *statement.velocities), statement.initial, strict=True))
    kept = {key: x for key, x in start.items() if not key.has(*change.replaced)}
    added = table_of(parameters, "parameters", "parameter to value, such as {w: 1.0}")
    values = {p: statement.defaults.get(p) for p in statement.parameters}
    used = [p for x in change.expressions for p in sorted(x.free_symbols, key=str) if p != t]
    result = rewritten(
        statement,
        change.put,
        coordinates=change.coordinates,
        forces=_forces(change),
        parameters=values | {p: None for p in used if p not in values} | dict(added),
        initial=kept | dict(stated),
    )
    _check(change, result, model)
    if initial is None:
        result = replace(result, initial=_start(change, result))
    return result


def _start(change: Transformation, statement: Statement) -> tuple[float, ...]:
    """Return the initial state (q, v) in new coordinates, which the transformation `change` maps to the old one.

    `statement` is the statement in new coordinates. Of several such states, those are preferred in which coordinates
    other than angles are not negative, then the one with the smallest coordinates. Raises StatementError if no such
    state is found, or if parameters have no values.
    """
    old, n = change.statement, len(statement.coordinates)
    rows = [old.coordinates.index(q) for q in change.replaced]
    positions = np.array([old.initial[i] for i in rows])
    rates = np.array([old.initial[len(old.coordinates) + i] for i in rows])
    unknowns = [statement.coordinates.index(q) for q in change.new]
    example = f"initial={{{name_of(change.new[0])}: ...}}"
    parameters = {p for x in change.expressions for p in x.free_symbols if p in statement.parameters}
    if missing := [p.name for p in statement.without_values if p in parameters]:
        if any(positions) or any(rates):
            raise StatementError(
                f"the initial state in the new coordinates needs a value of {listing(missing)}: give one, or {example}."
            )
        return statement.initial
    plain = [change.plain[q] for q in statement.coordinates]
    constants = {p: sympy.Rational(x) for p, x in statement.defaults.items()} | {t: sympy.S.Zero}
    constants |= {x: sympy.Rational(value) for x, value in zip(plain, statement.initial[:n], strict=True)}
    stays = {x: value for x, value in constants.items() if x not in [plain[i] for i in unknowns]}
    expressions = (prescribed(x).xreplace(stays) for x in change.old)
    zeros = [x - sympy.Rational(old_value) for x, old_value in zip(expressions, positions.tolist(), strict=True)]
    turns = [{change.plain[q]: change.plain[q] + 2 * sympy.pi} for q in change.new]
    angles = [all(x.xreplace(turn) == x for x in change.old) for turn in turns]
    lengths = [i for i, q in enumerate(change.new) if q in change.positive]
    ends = numeric_roots(zeros, [plain[i] for i in unknowns], positions, angles)
    ends = [end for end in ends if all(end[i] > 0 for i in lengths) or not any(positions)]
    if not ends:
        old_values = ", ".join(f"{old.names[i]} = {old.initial[i]:.6g}" for i in rows)
        raise StatementError(
            f"no values of {listing(map(name_of, change.new))} were found at which {old_values}, from {STARTS} starts: "
            f"give {example} in the new coordinates."
        )
    q = np.array(statement.initial[:n])

    def preference(end: FloatArray) -> tuple[int, float]:
        """Return the sort key of a solution `end`: few negative values that are not angles, then small values."""
        negative = sum(x < -START_RESIDUAL for x, angle in zip(end, angles, strict=True) if not angle)
        return negative, round(float(np.abs(end).sum()), 9) - 1e-10 * float(end.sum() > 0)

    q[unknowns] = min(ends, key=preference)
    point = constants | {x: sympy.Float(value, 30) for x, value in zip(plain, q.tolist(), strict=True)}
    return (*map(float, q), *map(float, _start_velocities(change, statement, rates, point, example)))


def _start_velocities(
    change: Transformation, statement: Statement, rates: FloatArray, point: Mapping[Any, Any], example: str
) -> FloatArray:
    """Return the initial velocities in new coordinates, which the transformation maps to `rates`, the old velocities.

    `statement` is the statement in new coordinates. `point` has the values of the time, the parameters and the new
    coordinates. `example` is the remedy in messages. Raises StatementError if there are no such velocities, because the
    new coordinates are singular.
    """
    v = np.array(statement.initial[len(statement.coordinates) :])
    unknowns = [statement.coordinates.index(q) for q in change.new]
    still = dict.fromkeys((change.plain[velocity_of(x)] for x in statement.coordinates), sympy.S.Zero)
    drifts = np.array([real(time_derivative(x, change.plain).xreplace(still), point) for x in change.old])
    slopes = np.array([[real(x, point) for x in row] for row in change.slopes.tolist()])
    rest = rates - drifts - slopes @ v
    v[unknowns] = np.linalg.lstsq(slopes[:, unknowns], rest, rcond=None)[0]
    missed = float(np.abs(slopes[:, unknowns] @ v[unknowns] - rest).max())
    if missed > START_RESIDUAL * max(1.0, float(np.abs(rest).max())):
        where = ", ".join(f"{name_of(x)} = {float(point[change.plain[x]]):.6g}" for x in change.new)
        raise StatementError(
            f"the initial velocities have no values in the new coordinates, which are singular at {where}: give "
            f"another initial state, or {example}."
        )
    return v


def _transformation(statement: Statement, expressions: Mapping[Any, Any], positive: Any) -> Transformation:
    """Return the user's transformation. Raises StatementError if the expressions do not define one.

    `expressions` maps old coordinates to expressions in new ones. `positive` lists new coordinates that are positive.
    """
    if not isinstance(expressions, Mapping) or not expressions:
        raise StatementError(
            "transform takes a dict from coordinates to expressions in new ones, as {x: r*cos(phi), y: r*sin(phi)}, "
            f"not {shown(expressions)}."
        )
    by_name = dict(zip(statement.names, statement.coordinates, strict=True))
    table: dict[Any, Any] = {}
    names = [coordinate_name(key, statement.names) for key in expressions]
    check_once(names, "transform")
    for name, value in zip(names, expressions.values(), strict=True):
        table[by_name[name]] = expression(value, f"the expression for {name}")
    survey = Survey()
    for q, value in table.items():
        survey.add(value, f"the expression for {name_of(q)}")
    if survey.velocities:
        raise StatementError(
            f"the expressions contain {next(iter(survey.velocities))}: a point transformation has coordinates, "
            "parameters and t in it, no velocities."
        )
    old = tuple(in_own_parameters(value, statement.parameters) for value in table.values())
    stays = [q for q in statement.coordinates if q not in table]
    new = tuple(COORDINATES.of((name_of(q), q) for q in survey.coordinates if q not in stays))
    if len(new) != len(table):
        remedy = (
            "With fewer, the old coordinates satisfy a constraint: state it, and eliminate(...) a coordinate."
            if len(new) < len(table)
            else "With more, the new coordinates are not determined: give expressions for more coordinates."
        )
        raise StatementError(
            f"the expressions for {listing(map(name_of, table))} have {len(new)} new coordinates "
            f"({listing(map(name_of, new))}), and {len(table)} are replaced: a transformation needs as many. {remedy}"
        )
    return Transformation(statement, tuple(table), old, new, _positive(positive, new))


def _positive(positive: Any, new: Sequence[Any]) -> tuple[Any, ...]:
    """Return those coordinates of `new` that the user lists as `positive`. Raises StatementError for other entries."""
    listed = entries(positive, "positive")
    chosen = []
    for key in [positive] if listed is None else listed:
        match = [q for q in new if label_of(key) == name_of(q)]
        if not match:
            raise StatementError(
                f"positive contains {shown(key)}, which is not a new coordinate; they are {listing(map(name_of, new))}."
            )
        chosen += match
    return tuple(chosen)


def _forces(change: Transformation) -> dict[Any, Any]:
    """Return {coordinate: generalized force} in new coordinates; these forces do the same virtual work as the old."""
    statement = change.statement
    read = read_with(statement, change.coordinates)
    pulls = {key: force.xreplace(change.table) for key, force in read.applied.items() if force != 0}
    forces: dict[Any, Any] = {}
    for q in dict.fromkeys((*change.coordinates, *pulls)):
        if q in change.replaced and q not in change.coordinates:
            continue
        # If a new coordinate has the name of an old one, the old force acts on it only by the derivatives dq/dx.
        terms = [pulls[q]] if q in pulls and q not in change.replaced else []
        if q in change.coordinates:
            slopes = change.slopes[:, change.coordinates.index(q)]
            terms += [pulls[x] * slope for x, slope in zip(change.replaced, slopes, strict=True) if x in pulls]
        forces[q] = change.back(simplest(printable(sympy.Add(*terms))))
    return forces


def _check(change: Transformation, statement: Statement, model: Model) -> None:
    """Raise RunError if momenta and forces in the new coordinates differ from the compiled model in old ones.

    With the new coordinates x, the old ones q(x), their compiled momenta p and forces f, the new momenta are p dq/dx,
    and the new forces are f dq/dx + p dv/dx. The comparison is at random states.
    """
    old, form = change.statement, PlainForm(statement)
    same = {change.plain[key]: form.plain[key] for q in statement.coordinates for key in (q, velocity_of(q))}
    whole = [change.table[q].xreplace(same) for q in old.coordinates]
    rates = [change.table[v].xreplace(same) for v in old.velocities]
    by_place, by_rate = (sympy.Matrix(part).jacobian(list(form.q)) for part in (whole, rates))
    stated = [*form.momenta, *(form.lagrangian.diff(q) + force for q, force in zip(form.q, form.forces, strict=True))]
    above_zero = [form.plain[q] for q in change.positive]

    def values(point: Any) -> tuple[list[float], list[Any]]:
        numbers = form.at(point)
        if any(numbers[symbol] <= 0 for symbol in above_zero):
            return [], [float("nan")]
        q, v = ([real(x, numbers) for x in part] for part in (whole, rates))
        if not np.isfinite([*q, *v]).all():
            return [], [float("nan")]
        parameters = {p: x for p, x in point.parameters.items() if p in old.parameters}
        p = model.momenta(q, v, point.t, parameters)
        f = model.evaluate("forces", q, v, point.t, parameters)
        slopes, turns = (
            np.array([[real(x, numbers) for x in row] for row in part.tolist()]) for part in (by_place, by_rate)
        )
        return [*(p @ slopes), *(f @ slopes + p @ turns)], [number(x, numbers) for x in stated]

    compared("the transformation", statement, values)


@dataclass(frozen=True, eq=False)
class Routh:
    """Formulas of Routh's procedure, which removes ignorable coordinates from a system.

    `indices` are the indices of these ignored coordinates. `symbols` are their momenta, which are parameters of the
    smaller system. `form` has the formulas of the whole system.
    """

    form: PlainForm
    indices: tuple[int, ...]
    symbols: tuple[Any, ...]

    @cached_property
    def gone(self) -> dict[Any, Any]:
        """Mapping {ignored coordinate: 0}, to remove these coordinates from formulas that do not depend on them."""
        return {self.form.q[i]: sympy.S.Zero for i in self.indices}

    @cached_property
    def still(self) -> dict[Any, Any]:
        """Mapping {velocity of an ignored coordinate: 0}."""
        return {self.form.v[i]: sympy.S.Zero for i in self.indices}

    @cached_property
    def shifted(self) -> Any:
        """The column p - b for the ignored coordinates: their momenta p, less the momenta b while they are at rest."""
        rest = [self.form.momenta[i].xreplace(self.still | self.gone) for i in self.indices]
        return sympy.Matrix([p - b for p, b in zip(self.symbols, rest, strict=True)])

    @cached_property
    def inverted(self) -> tuple[Any, Any]:
        """Adjugate and determinant of the block of the mass matrix in the rows and columns of ignored coordinates."""
        adjugate, determinant = inverse(self.form, self.indices)
        return adjugate.xreplace(self.gone), determinant.xreplace(self.gone)

    @cached_property
    def rates(self) -> tuple[Any, ...]:
        """The velocities of the ignored coordinates, as expressions in their momenta and the rest of the state."""
        adjugate, determinant = self.inverted
        return tuple(simplest(x / determinant) for x in adjugate * self.shifted)

    @cached_property
    def routhian(self) -> tuple[Any, Any]:
        """Routh's function R = T - V as a pair (T, V): its terms with velocities, and the effective potential V."""
        at_rest = dict.fromkeys(self.form.v, sympy.S.Zero)
        mass = self.form.mass.extract(list(self.indices), list(self.indices)).xreplace(self.gone)
        half = half_square(mass, self.inverted, self.shifted)
        rest = self.form.lagrangian.xreplace(self.still | self.gone)
        centrifugal, potential = half.xreplace(at_rest), rest.xreplace(at_rest)
        moving = (rest - potential) - (half - centrifugal)
        return simplest(moving), centrifugal - simplest(potential)


def routh_of(statement: Statement, ignored: Sequence[Any]) -> Routh:
    """Return the formulas of Routh's procedure for the coordinates `ignored`, which are symbols or names.

    Raises StatementError if one of them is not ignorable, or if no coordinate would be left.
    """
    if not ignored:
        raise StatementError("routhian() has no arguments: give a coordinate that is ignorable.")
    form = PlainForm(statement)
    indices = tuple(dict.fromkeys(statement.names.index(coordinate_name(key, statement.names)) for key in ignored))
    if len(indices) == len(statement.names):
        raise StatementError(
            f"every coordinate of {statement.name} would be ignored: leave out one of them, which then moves."
        )
    for i in indices:
        _check_ignorable(form, i)
    if form.mass.extract(list(indices), list(indices)).has(*(form.v[i] for i in indices)):
        names = listing(statement.names[i] for i in indices)
        raise StatementError(
            f"the momenta of {names} are not linear in the velocities of {names}, so routhian() cannot solve for "
            "these: hamiltonian() may solve for all velocities together."
        )
    symbols = [
        sympy.Symbol(name, real=True) for name in momentum_names(statement, [statement.names[i] for i in indices])
    ]
    return Routh(form, indices, tuple(symbols))


def routhian(statement: Statement, ignored: Sequence[Any], model: Model) -> Statement:
    """Return the statement without the coordinates `ignored`, whose momenta become parameters.

    The result is tested against the `model` of the whole system. Raises StatementError if one is not ignorable.
    """
    routh = routh_of(statement, ignored)
    values = {symbol: routh.form.initial_momenta[i] for symbol, i in zip(routh.symbols, routh.indices, strict=True)}
    smaller = _without_ignored(routh, statement, values)
    _check_routhian(routh, model)
    if statement.reading is not None:
        read = statement.as_read
        indices = tuple(read.coordinates.index(statement.coordinates[i]) for i in routh.indices)
        in_turns = Routh(PlainForm(read), indices, routh.symbols)
        smaller = replace(smaller, reading=_without_ignored(in_turns, statement, values).reading)
    return with_origin(smaller, statement)


def _without_ignored(routh: Routh, statement: Statement, values: Mapping[Any, float | None]) -> Statement:
    """Return the statement without ignored coordinates, by the formulas `routh` of Routh's procedure.

    The formulas describe rotations by quaternions, as the statement does, or by rates about the body axes. `values`
    maps the symbols of the momenta to their initial values; a value is None if it is unknown.
    """
    form, indices = routh.form, routh.indices
    gone = [form.statement.coordinates[i] for i in indices]
    left = [q for q in statement.coordinates if q not in gone]
    rates = dict(zip((form.v[i] for i in indices), routh.rates, strict=True)) | routh.gone

    def put(expr: Any) -> Any:
        return form.written(form.read(expr).xreplace(rates))

    kinetic, potential = routh.routhian
    start = dict(zip((*statement.coordinates, *statement.velocities), statement.initial, strict=True))
    leaves = [leaf for q in gone for leaf in (q, velocity_of(q))]
    positions = {name: point for name, point in statement.positions.items() if not any(x.has(*leaves) for x in point)}
    return declare(
        kinetic=form.written(kinetic),
        potential=form.written(potential),
        coordinates=left,
        forces={q: put(force) for q, force in form.statement.applied.items() if q not in gone and force != 0},
        dissipation=form.written(form.read(form.statement.dissipation).xreplace(routh.gone)),
        constraints={constraint.name: constraint.expression for constraint in form.statement.constraints},
        redundant=statement.redundant,
        parameters={p: statement.defaults.get(p) for p in statement.parameters} | dict(values),
        initial={key: start[key] for q in left for key in (q, velocity_of(q))},
        positions=positions,
        links=[link for link in statement.links if {link.start, link.end} <= {ORIGIN, *positions}],
        name=statement.name,
    )


def _check_ignorable(form: PlainForm, i: int) -> None:
    """Raise StatementError if the momentum of the coordinate with index `i` is not constant; the message says why."""
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
    for constraint in statement.constraints:
        if constraint.expression.has(q, v):
            raise StatementError(
                f"{name} is not ignorable: the constraint {constraint.name!r} acts on it. eliminate(...) solves it for "
                "a coordinate."
            )
    for other, force in zip(statement.names, form.forces, strict=True):
        if not vanishes(form, force.diff(form.q[i])):
            raise StatementError(
                f"{name} is not ignorable: the force on {other} depends on it. Choose another coordinate."
            )


def _check_routhian(routh: Routh, model: Model) -> None:
    """Raise RunError if the formulas of Routh's procedure differ from the compiled model at random states.

    The compared formulas are the velocities of the ignored coordinates, and the forces and momenta of the others.
    """
    form = routh.form
    kinetic, potential = routh.routhian
    left = [i for i in range(len(form.q)) if i not in routh.indices]
    rates = dict(zip((form.v[i] for i in routh.indices), routh.rates, strict=True)) | routh.gone
    slopes = [(kinetic - potential).diff(form.q[i]) + form.forces[i].xreplace(rates) for i in left]
    momenta = [kinetic.diff(form.v[i]) for i in left]

    def values(point: Any) -> tuple[list[float], list[Any]]:
        p = model.momenta(point.q, point.v, point.t, point.parameters)
        forces = model.evaluate("forces", point.q, point.v, point.t, point.parameters)
        numbers = form.at(point)
        numbers |= {s: sympy.Rational(float(p[i])) for s, i in zip(routh.symbols, routh.indices, strict=True)}
        compiled = [*(point.v[i] for i in routh.indices), *(forces[i] for i in left), *(p[i] for i in left)]
        return compiled, [number(x, numbers) for x in (*routh.rates, *slopes, *momenta)]

    compared("the Routhian", form.statement, values)


MOST_PARTS = 64  # Largest number of parts into which an interval between outputs is divided for integration

INTEGRAL_TOLERANCE = 1e-12
"""Largest estimated error of an ignored coordinate that is the integral of its velocity, relative to its largest change
between two output times."""


def ignored(statement: Statement, solution: Any) -> dict[Any, FloatArray]:
    """Return ignored coordinates and their velocities at the N output times of `solution`, a run of the Routhian.

    The result maps each of them to its values (N,). The coordinates start at the initial values of `statement`, the
    whole system with these coordinates. Raises StatementError if `solution` is a run of another system.
    """
    small = getattr(getattr(solution, "model", None), "statement", None)
    missing = [] if small is None else [q for q in statement.coordinates if q not in small.coordinates]
    if small is None or not missing or any(q not in statement.coordinates for q in small.coordinates):
        raise StatementError(
            f"this is not a run of a Routhian of {statement.name}: run routhian(...) of this system, of "
            f"{listing(statement.names)}, and give that solution."
        )
    routh = routh_of(statement, missing)
    rows: dict[Any, FloatArray] = {}
    for i, rate in zip(routh.indices, routh.rates, strict=True):
        q, formula = statement.coordinates[i], routh.form.written(rate)

        def speed(times: FloatArray, formula: Any = formula) -> FloatArray:
            model: Model = solution.model
            return model.evaluate_expression(formula, times, solution.at(times), solution.parameters)

        rows[q] = statement.initial[i] + _integral(speed, solution.t, statement.names[i])
        rows[velocity_of(q)] = speed(solution.t)
    return rows


def _integral(speed: Callable[[FloatArray], FloatArray], times: FloatArray, name: str) -> FloatArray:
    """Return the integral of a velocity from the first of `times` to each of them, (N,).

    The function `speed` returns the velocity (K,) at times (K,). All intervals are divided together until the estimated
    error is below `INTEGRAL_TOLERANCE`. `name` is the coordinate in messages.
    """
    lengths = np.diff(times)
    if not len(lengths):
        return np.zeros(1)
    rule: Any = quad_vec  # its type stubs declare scalar results only
    changes, _, result = rule(
        lambda share: speed(times[:-1] + share * lengths) * lengths,
        0.0,
        1.0,
        epsabs=0.0,
        epsrel=INTEGRAL_TOLERANCE,
        norm="max",
        limit=MOST_PARTS,
        full_output=True,
    )
    if not result.success:
        raise RunError(
            f"{name} cannot be computed to {INTEGRAL_TOLERANCE:g}: its velocity varies too fast between the output "
            "times. Run with shorter steps, or with times closer together in t_eval."
        )
    return np.concatenate([[0.0], np.cumsum(changes)])
