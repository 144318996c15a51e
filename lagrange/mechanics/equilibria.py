"""Find the equilibria of a system at rest, or in a steady motion of ignorable coordinates.

Steady rotations of a body are found in three angles, with the rotation matrix R = R1(precession) R2(tilt) R3(spin). The
first axis is fixed in space. The precession, and for a symmetric body the spin, are ignorable. The angles are singular
at two tilts, which are examined in other angles. Source: L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., section 35.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.equations.terms import printable, with_known_signs
from lagrange.errors import FAULT, RunError, StatementError, formula, listing
from lagrange.mechanics.expansion import StatedPoint, edges, on_side, stated_point, with_lengths
from lagrange.mechanics.linearization import is_false_pole, linearized_at
from lagrange.mechanics.plain_form import PlainForm, in_fractions, number, simplest, size_of_terms
from lagrange.mechanics.reduction import rewritten
from lagrange.mechanics.roots import STARTS, numeric_roots, solved
from lagrange.mechanics.stability import (
    AT_POLE,
    NO_INERTIA,
    Verdict,
    criterion,
    each_pole_once,
    ignorable,
    stability_of,
)
from lagrange.statement.coordinate import coordinate_of, rotation_name, t, velocity_of
from lagrange.statement.display import ShownAsPage
from lagrange.statement.expression import check_once, expression
from lagrange.statement.parameters import label_of, table_of
from lagrange.statement.rotation import AXES, Rotation, rotation_of, split_rates
from lagrange.statement.space import cross_matrix, matrix_of, product, quaternion_of
from lagrange.statement.statement import Statement

FORCE_LEFT = 1e-15  # Largest residual force at a symbolic equilibrium, relative to its terms, evaluated with 30 digits

FORCE_LEFT_BY_SEARCH = 1e-6  # Largest residual force at an equilibrium in decimals, relative to its terms

COORDINATE_ROUNDING = 1e-15
"""Relative rounding error of a coordinate in decimals. For pi as a double, sin(pi) = 1.2e-16 is only rounding."""

MOST_PLACES = 64  # Largest number of numerical equilibria in a list: each takes about 0.2 s to analyse


@dataclass(frozen=True, eq=False)
class Equilibrium(ShownAsPage):
    """An equilibrium at rest, or a steady motion with `velocities` of ignorable coordinates.

    `coordinates` maps each coordinate to an expression in parameters; an arbitrary coordinate is mapped to itself.
    `energy` is v.p - L at the equilibrium. `condition` is the condition on the parameters for its existence. `exists`
    is the truth of the condition at the values of the parameters, or None if a value is missing. `stable` is True,
    False, or None if undecided, and `reason` says why. `criterion` has the leading minors of the stiffness matrix at
    fixed momenta of ignorable coordinates. If all are positive, the energy has a minimum. It is empty if the formulas
    are too long. `exact` is false if the equilibrium was found numerically. `statement` states the system.
    """

    coordinates: Mapping[Any, Any]
    velocities: Mapping[Any, Any]
    stable: bool | None
    reason: str
    energy: Any
    condition: Any
    exists: bool | None
    criterion: tuple[Any, ...]
    exact: bool
    statement: Statement

    def __repr__(self) -> str:
        word = {True: "stable", False: "unstable", None: "stability undecided"}[self.stable]
        point = ", ".join(f"{q} = {x}" for q, x in {**self.coordinates, **self.velocities}.items())
        where = "" if self.condition == sympy.true else f", where {self.condition}"
        return f"<Equilibrium: {point}; {word}{where}>"

    @property
    def at(self) -> dict[Any, Any]:
        """The equilibrium as an argument `at` of `linearize` and `modes`, in which arbitrary coordinates are zero."""
        return {q: x for q, x in self.coordinates.items() if x != q} | dict(self.velocities)


def equilibria(statement: Statement, rates: Any) -> list[Equilibrium]:
    """Return the equilibria of a statement at rest, or at steady velocities of ignorable coordinates or of a rotation.

    `rates` maps these to velocities, or is None. Equilibria that exist at the values of the parameters come first; both
    groups are sorted by energy. Raises StatementError if none is found.
    """
    if statement.rotations and isinstance(rates, Mapping):
        others, turning = split_rates(rates, statement.coordinates, "rates")
        attitudes = [others.pop(key) for key in list(others) if isinstance(key, Rotation)]
        if turning or attitudes:
            return _steady_rotations(statement, others, turning, attitudes)
    form = PlainForm(with_lengths(statement))
    problem = _Problem(form, ignorable(form), rates)
    solutions, exact = problem.solutions()
    # Of several solutions at one pole the first is kept, which has an arbitrary longitude if any of them does.
    solutions.sort(key=len)
    solutions = [solutions[k] for k in each_pole_once([problem.point(values) for values in solutions])]
    if len(solutions) > MOST_PLACES:
        raise StatementError(problem.too_many(len(solutions)))
    records = [problem.record(values, exact=exact) for values in solutions]
    # With dry friction, `reason` names the friction also at a pole, so that every record is tested.
    balanced = [
        record
        for record in records
        if not (record.reason in (AT_POLE, NO_INERTIA) or problem.friction)
        or not is_false_pole(stated_point(form.statement, record.at))
    ]
    if not balanced:
        raise StatementError(problem.none_found(symbolic=exact, poles=bool(records)))
    return sorted(balanced, key=problem.order)


class _Problem:
    """The equations of equilibrium of the system `form`, and their solutions.

    `free` are the indices of ignorable coordinates. `rates` maps some of these to steady velocities, or is None.
    """

    def __init__(self, form: PlainForm, free: tuple[int, ...], rates: Any) -> None:
        self.form, self.free, self.statement = form, free, form.statement
        statement = self.statement
        self.speeds = self.steady(rates)
        nonholonomic = [constraint.name for constraint in statement.constraints if not constraint.holonomic]
        if nonholonomic:
            raise StatementError(
                f"{statement.name} has constraints on velocities ({listing(nonholonomic)}), so its equilibria form a "
                "continuous region and cannot be listed: linearize(at=...).equilibrium says whether a point is one."
            )
        self.at_rest = {**dict.fromkeys((*form.a, *form.v), sympy.S.Zero), **self.speeds}
        forces = [simplest(with_known_signs(r.subs(self.at_rest, simultaneous=True))) for r in form.residuals]
        self.zeros = [form.read(constraint.expression) for constraint in statement.constraints]
        if any(x.has(t) for x in (*forces, *self.zeros)):
            raise StatementError(
                f"the forces of {statement.name} depend on time, so no point is an equilibrium at all times: "
                "transform(...) may give moving coordinates in which the forces do not depend on time."
            )
        self.rows = tuple(i for i in range(len(form.q)) if i not in self.free)
        self.unknowns = tuple(form.q[i] for i in self.rows)
        self.multipliers = tuple(sympy.Dummy(constraint.name, real=True) for constraint in statement.constraints)
        self.gradient = [[zero.diff(form.q[i]) for i in range(len(form.q))] for zero in self.zeros]
        pushed = [
            forces[i] - sympy.Add(*(m * row[i] for m, row in zip(self.multipliers, self.gradient, strict=True)))
            for i in self.rows
        ]
        self.equations = [in_fractions(equation) for equation in (*pushed, *self.zeros)]

    @cached_property
    def friction(self) -> str:
        """Sentence that names the forces with a jump at rest, such as dry friction; "" without such forces."""
        form, at_rest = self.form, self.at_rest
        jumps = {
            edge: None
            for residual in form.residuals
            for edge in edges(residual)
            if edge.has(*form.v)
            and simplest(edge.xreplace(at_rest)) == 0
            and simplest((on_side(residual, edge, 1) - on_side(residual, edge, -1)).xreplace(at_rest)) != 0
        }
        if not jumps:
            return ""
        zeros = listing(formula(printable(edge), 60) for edge in jumps)
        return (
            f"the forces jump where {zeros} {'is' if len(jumps) == 1 else 'are'} zero, as dry friction does: they may "
            "keep the system at rest at further places, which are not listed."
        )

    def steady(self, rates: Any) -> dict[Any, Any]:
        """Return the user's steady velocities `rates` as {symbol: value}. Raises StatementError for invalid ones."""
        rates = table_of(rates, "rates", "ignorable coordinate to velocity")
        statement, form = self.statement, self.form
        coordinates = {v: q for q, v in zip(statement.coordinates, statement.velocities, strict=True)}
        coordinates |= {f"{name}_dot": q for q, name in zip(statement.coordinates, statement.names, strict=True)}
        keys = [coordinates.get(key, key) for key in rates]
        check_once([label_of(key) for key in keys], "rates")
        rates = dict(zip(keys, rates.values(), strict=True))
        point = stated_point(statement, rates, table="rates")
        named = [i for i, q in enumerate(statement.coordinates) if q in rates or statement.names[i] in rates]
        for i in named:
            if i not in self.free:
                name, steady = statement.names[i], listing(statement.names[k] for k in self.free)
                raise StatementError(
                    f"the argument rates has a steady velocity of {name}, but energies or constraints depend on "
                    f"{name}, or a force acts along it, so its momentum may change: linearize({{{name}.dot: w}}) tells "
                    "whether the rate w is steady" + (f", or give rates of {steady}." if self.free else ".")
                )
        return {form.v[i]: in_fractions(point.q[i]) for i in named}

    def solutions(self) -> tuple[list[dict[Any, Any]], bool]:
        """Return (solutions, exact): a list of {symbol: value}, and False if they were found by numerical search."""
        symbolic = solved(self.equations, (*self.unknowns, *self.multipliers))
        return (self.searched(), False) if symbolic is None else (symbolic, True)

    def point(self, values: Mapping[Any, Any]) -> StatedPoint:
        """Return the point of a solution {symbol: value}; arbitrary coordinates are zero."""
        q, arbitrary = self.form.q, dict.fromkeys(self.form.q, sympy.S.Zero)
        places = tuple(self.principal(x, values[x]).xreplace(arbitrary) if x in values else sympy.S.Zero for x in q)
        return StatedPoint(self.form, places, tuple(self.speeds.get(v, sympy.S.Zero) for v in self.form.v), {})

    def searched(self) -> list[dict[Any, Any]]:
        """Return equilibria {symbol: number} by Newton's method. Raises StatementError if parameters lack values."""
        statement = self.statement
        statement.require_parameters(
            f"the equilibria of {statement.name} are not found in symbols, and for a search by number"
        )
        values = {p: sympy.Rational(x) for p, x in statement.defaults.items()}
        ends = numeric_roots(
            [equation.xreplace(values) for equation in self.equations],
            (*self.unknowns, *self.multipliers),
            np.array(statement.initial)[list(self.rows)],
            [self.is_angle(q) for q in self.unknowns],
            helpers=len(self.multipliers),
        )
        return [dict(zip(self.unknowns, map(sympy.Float, end), strict=True)) for end in ends]

    def is_angle(self, symbol: Any) -> bool:
        """Return True if L, the forces and the constraints have period 2 pi in the coordinate `symbol`."""
        turn = {symbol: symbol + 2 * sympy.pi}
        return all(x.xreplace(turn) == x for x in (self.form.lagrangian, *self.form.forces, *self.zeros))

    def none_found(self, *, symbolic: bool, poles: bool = False) -> str:
        """Return the error message if there is no equilibrium; `symbolic` is true if equations were solved in symbols.

        `poles` is true if forces on coordinates vanish only where these are singular, and the system moves from there.
        """
        statement = self.statement
        named = listing(dict.fromkeys(rotation_name(statement.coordinates[i]) or statement.names[i] for i in self.rows))
        if poles:
            return (
                f"{statement.name} has no equilibrium: the forces on {named} at rest vanish only where the mass matrix "
                "is singular, and the system is not in balance there."
            )
        friction = f" But {self.friction}" if self.friction else ""
        if symbolic:
            contacts = listing(repr(each.name) for each in statement.contacts)
            remedy = f" Contact forces are left out: state the closed ones of {contacts} as constraints."
            return (
                f"{statement.name} has no equilibrium: the forces on {named} at rest, solved in symbols, vanish "
                "nowhere for general values of the parameters."
                + friction
                + (remedy if contacts != "none" else self.steady_motion())
            )
        return (
            f"no equilibrium of {statement.name} was found: the forces on {named} are not solved in symbols, and "
            f"Newton's method from {STARTS} starts, the initial state among them, found none at the values of the "
            f"parameters. Give an initial state near one, or other values.{friction}"
        )

    def steady_motion(self) -> str:
        """Return a sentence on a motion at constant speeds, such as of a motor under a torque and a drag, or "".

        Such speeds are possible for coordinates on which no force depends.
        """
        form, names = self.form, self.statement.names
        drifting = [i for i in self.rows if not any(r.has(form.q[i]) for r in form.residuals)]
        still = dict.fromkeys((*form.a, *(v for i, v in enumerate(form.v) if i not in drifting)), sympy.S.Zero)
        forces = [in_fractions(form.residuals[i].xreplace({**still, **self.speeds})) for i in self.rows]
        unknowns = {form.v[i] if i in drifting else form.q[i]: names[i] + ".dot" * (i in drifting) for i in self.rows}
        for values in (solved(forces, [*unknowns]) if drifting and not self.zeros else None) or ():
            at = ", ".join(f"{unknowns[symbol]}: {formula(form.written(x), 60)}" for symbol, x in values.items())
            return f" linearize({{{at}}}) is about a steady motion."
        return ""

    def too_many(self, count: int) -> str:
        """Return the error message for `count` equilibria, which probably form a curve or a surface."""
        turned = dict.fromkeys(map(rotation_name, self.statement.coordinates))
        return (
            f"{self.statement.name} has too many equilibria to list: {STARTS} starts of Newton's method ended at "
            f"{count} different places, as they do where equilibria fill a curve or a surface. linearize(...) says "
            "whether a point is an equilibrium, and modes(...) whether it is stable."
            + "".join(f" Call equilibria({{{name}.space[2]: 0}})." for name in turned if name)
        )

    def record(self, values: Mapping[Any, Any], *, exact: bool, axial: bool = False) -> Equilibrium:
        """Return the `Equilibrium` for one solution {symbol: value}; `exact` is true for a symbolic solution.

        `axial` is true if the system is symmetric under rotations in the plane of its two non-ignorable coordinates.
        """
        statement, form = self.statement, self.form
        coordinates = {
            q: self.principal(symbol, values[symbol]) if symbol in values else symbol
            for q, symbol in zip(statement.coordinates, form.q, strict=True)
        }
        speeds = {v: self.speeds[x] for v, x in zip(statement.velocities, form.v, strict=True) if x in self.speeds}
        point = self.point(values)
        condition = _condition([*values.values()])
        numbers = point.numbers if len(point.numbers) == len(statement.parameters) else None
        exists = True if condition == sympy.true else None
        if numbers is not None:
            exists = all(x == x and abs(x.imag) < 1e-12 for x in (number(x, numbers) for x in point.q))
            if exact:
                self.check(values, numbers, exists=exists)
        decided, minors = Verdict(stable=None, reason="it does not exist at the values of the parameters."), ()
        if exists is not False:
            try:
                lin = linearized_at(point)
                decided = stability_of(lin, point, axial=axial)
                minors = criterion(lin, self.free if not statement.constraints else (), axial=axial)
            except StatementError as refusal:
                unexamined = f"{self.friction} Their effect on stability is not examined."
                decided = Verdict(stable=None, reason=unexamined if self.friction else str(refusal))
        work = sympy.Add(*(p * v for p, v in zip(form.momenta, form.v, strict=True)))
        return Equilibrium(
            coordinates=MappingProxyType({key: form.written(x) for key, x in coordinates.items()}),
            velocities=MappingProxyType(speeds),
            stable=decided.stable,
            reason=decided.reason,
            energy=form.written(simplest((work - form.lagrangian).xreplace(point.table))),
            condition=condition,
            exists=exists,
            criterion=minors,
            exact=exact,
            statement=self.statement,
        )

    def principal(self, symbol: Any, value: Any) -> Any:
        """Return the value of the coordinate `symbol`, reduced to (-pi, pi] if it is an angle with a known value."""
        if not self.is_angle(symbol):
            return value
        angle = number(value, self.statement.defaults)
        if angle != angle or angle.imag:
            return value
        return simplest(value - 2 * sympy.pi * math.ceil(round(angle.real / (2 * math.pi), 12) - 0.5))

    def check(self, values: Mapping[Any, Any], known: Mapping[Any, Any], *, exists: bool) -> None:
        """Evaluate the forces at the solution `values`, with the numbers `known` for the parameters.

        Raises RunError if a force exceeds its rounding error, which is a fault of this library. Tests nothing if
        `exists` is false: then the solution is not real for these numbers.
        """
        if not exists or not all(m in values for m in self.multipliers):
            return  # the search has already tested numerical solutions
        free = {q: sympy.Rational(3, 10) for q in self.unknowns}
        decimals = {x: value for x, value in values.items() if value.has(sympy.Float)}
        limit = FORCE_LEFT_BY_SEARCH if decimals else FORCE_LEFT

        def size(expression: Any) -> float:
            return size_of_terms(expression.xreplace(dict(values)).xreplace(free), known)

        for equation in self.equations:
            whole = sympy.expand(equation)
            left = abs(number(whole.xreplace(dict(values)).xreplace(free), known))
            rounding = sum(
                COORDINATE_ROUNDING * abs(number(x, known)) * size(whole.diff(q)) for q, x in decimals.items()
            )
            if left > limit * size(whole) + rounding:
                raise RunError(
                    f"an equilibrium of {self.statement.name} is wrong: a force of {left:.3g} is left. {FAULT}"
                )

    def order(self, equilibrium: Equilibrium) -> tuple[Any, ...]:
        """Return the sort key of an equilibrium: first those that exist at the parameters' values, by their energy."""
        energy = number(self.form.read(equilibrium.energy), self.statement.defaults)
        return (not equilibrium.exists, round(energy.real, 9) if energy == energy else 0.0)


class _Angles:
    """A statement with three `angles` in place of its rotation: precession, tilt and spin.

    The precession is about the axis `upright` of space, the spin about the axis `last` of the body. As functions of the
    angles, `matrix` is the rotation matrix, `body` its rates about the axes of the body, and `quaternion` its
    quaternion. `symbols` are SymPy symbols of the angles, `free` the angles that are ignorable. `is_free` is true for a
    body without torques. `form` has the formulas in angles, and `ignorable` are the indices of ignorable coordinates.
    """

    def __init__(self, statement: Statement, upright: int, last: int) -> None:
        (self.rotation,) = map(rotation_of, statement.rotations)
        self.original, self.upright, self.last, read = statement, upright, last, statement.reading or statement
        axes = (upright, (last + 1) % 3 if last == upright else 3 - last - upright, last)
        self.angles = [coordinate_of(f"{self.rotation.name}_{name}") for name in ("precession", "tilt", "spin")]
        matrix, rates = sympy.eye(3), sympy.zeros(3, 1)
        quaternion: Sequence[Any] = (1, 0, 0, 0)
        for angle, axis in zip(self.angles, axes, strict=True):
            unit = sympy.Matrix([int(k == axis) for k in range(3)])
            cross = cross_matrix(unit)
            turned = sympy.eye(3) + sympy.sin(angle) * cross + (1 - sympy.cos(angle)) * cross**2
            matrix, rates = matrix * turned, turned.T * rates + velocity_of(angle) * unit
            quaternion = product(quaternion, (sympy.cos(angle / 2), *(sympy.sin(angle / 2) * unit)))
        self.matrix, self.body, self.quaternion = matrix, rates, quaternion
        table = dict(zip(self.rotation.matrix, matrix, strict=True)) | dict(zip(self.rotation.body, rates, strict=True))
        table |= dict(zip(self.rotation.space, matrix * rates, strict=True))
        forces = {q: in_fractions(x.xreplace(table)) for q, x in zip(read.coordinates, read.forces, strict=True)}
        torques = [forces.pop(turn) for turn in self.rotation.turns]
        for angle in self.angles:
            forces[angle] = sum(x * rate.diff(velocity_of(angle)) for x, rate in zip(torques, rates, strict=True))
        start = dict(zip(read.coordinates, read.initial, strict=False))  # `initial` continues with velocities
        empty = MappingProxyType[str, Any]({})
        statement = rewritten(
            replace(read, rotations=(), positions=empty, surfaces=empty, links=(), contacts=(), simultaneous=""),
            lambda stated: in_fractions(stated.xreplace(table)),
            coordinates=tuple(forces),
            forces=forces,
            initial={q: value for q, value in start.items() if q in forces},
        )
        self.is_free = not any(
            (*forces.values(), read.dissipation, read.lagrangian.has(*self.rotation.matrix, *self.rotation.space))
        )
        self.form = PlainForm(statement)
        self.ignorable = ignorable(self.form)
        self.symbols = [self.form.plain[angle] for angle in self.angles]
        self.free = [angle for angle in self.angles if statement.coordinates.index(angle) in self.ignorable]

    def in_quaternion(self, equilibrium: Equilibrium) -> Equilibrium:
        """Return an equilibrium with a quaternion in place of the three angles, and with rates about the body axes."""
        arbitrary = {q: sympy.S.Zero for q, x in equilibrium.coordinates.items() if q == x and q in self.angles}
        values = {q: x.xreplace(arbitrary) for q, x in equilibrium.coordinates.items()}
        values |= {velocity_of(q): equilibrium.velocities.get(velocity_of(q), sympy.S.Zero) for q in values}
        entries = [simplest(x.xreplace(values)) for x in self.quaternion]
        rates = [simplest(x.xreplace(values)) for x in self.body]
        coordinates = dict(zip(self.rotation.quaternion, entries, strict=True)) | values
        velocities = {rate: x for rate, x in zip(self.rotation.body, rates, strict=True) if x != 0}
        moving = {velocity_of(angle) for angle in self.angles}
        velocities |= {v: x for v, x in equilibrium.velocities.items() if v not in moving}
        return replace(
            equilibrium,
            coordinates=MappingProxyType({q: coordinates[q] for q in self.original.coordinates}),
            velocities=MappingProxyType(velocities),
            statement=self.original,
        )

    def key(self, values: Mapping[Any, Any], known: Mapping[Any, Any]) -> tuple[str, ...]:
        """Return a key of a solution, equal if only ignorable angles differ; `known` are the parameters' values."""
        plain = dict(zip(self.angles, self.symbols, strict=True))
        row = self.matrix.row(self.upright).xreplace(plain)
        entries = [row[self.last]] if self.angles[2] in self.free else [*row]
        entries = [x.xreplace(dict(values)) for x in (*entries, *(x for x in values if x not in self.symbols))]
        rounded = [np.round(number(x, known), 9) + 0.0 for x in entries]
        return tuple(str(simplest(x) if y != y else y) for x, y in zip(entries, rounded, strict=True))


def _steady_rotations(
    statement: Statement, others: Mapping[Any, Any], turning: Mapping[Any, Sequence[Any]], attitudes: Sequence[Any]
) -> list[Equilibrium]:
    """Return the steady rotations of a body about an axis of space, or its precessions if its attitude is stated.

    `turning` maps `R.body` or `R.space` to three rates; a rate is None if the user stated none. `attitudes` has the
    user's value of the rotation R, or is empty. `others` maps other coordinates to constant velocities. Raises
    StatementError for other combinations.
    """
    if len(statement.rotations) > 1 or statement.reading is None:
        raise StatementError(
            f"steady rotations are found for one rotation alone: {statement.name} has {listing(statement.rotations)}, "
            "or an entry of a quaternion in an expression. linearize(at=...) tells whether a motion is steady."
        )
    rotation = rotation_of(statement.rotations[0])
    rates = [(vector, k, x) for vector, row in turning.items() for k, x in enumerate(row) if x is not None]
    rates = [rate for rate in rates if rate[2] != 0] or rates[:1]
    name = rotation.name
    if len(rates) != 1 or bool(attitudes) != (rates[0][0] == rotation.body):
        raise StatementError(
            f"the argument rates has no steady motion of {name}: give {{{name}.space[2]: w}} for turns about the axis "
            f"z of space, or {{{name}: attitude, {name}.body[2]: w}} for the precessions of a body that is symmetric "
            "about its axis z. linearize(at=...) tells whether a motion is steady."
        )
    ((_, axis, rate),) = rates
    if attitudes:
        attitude = matrix_of(quaternion_of(attitudes[0], f"the attitude of {name}"))
        return _precessions(statement, axis, rate, others, attitude)
    return _turns(statement, axis, rate, others)


def _turns(statement: Statement, axis: int, rate: Any, others: Mapping[Any, Any]) -> list[Equilibrium]:
    """Return the motions in which a body turns steadily at `rate` about the axis of space with index `axis`.

    The unknowns are angles of the body. The last angle turns the body about its axis of symmetry, if it has one. These
    angles are singular at two tilts, the poles, where a factor such as sin(tilt) is zero. For the poles the equations
    are solved again in other angles. `others` maps other ignorable coordinates to their constant velocities.
    """
    chart, third = cache(lambda last: _Angles(statement, axis, last)), (axis + 2) % 3
    if chart(axis).angles[0] not in chart(axis).free:
        raise StatementError(
            f"{chart(axis).rotation.name} cannot turn steadily about the axis {AXES[axis]} of space: forces or drags "
            "act about this axis, or energies or constraints change with the angle about it."
        )
    last = next((k for k in (axis, third, (axis + 1) % 3) if chart(k).angles[2] in chart(k).free), third)
    main = chart(last)
    if last == axis:
        polar, factor = chart(third), sympy.sin
        poles = [(sympy.S.Zero, sympy.S.Zero), (sympy.pi, sympy.S.Zero)]
    else:
        polar, factor = chart(axis), sympy.cos
        poles = [(sign * sympy.pi / 2, sympy.S.Zero if last == third else sympy.pi / 2) for sign in (1, -1)]
    symmetric = main.angles[2] in main.free
    problem, polar_problem = (
        _Problem(angles.form, angles.ignorable, {**others, angles.angles[0]: rate}) for angles in (main, polar)
    )
    _, tilt, spin = main.symbols
    solutions, exact = problem.solutions()
    known = statement.defaults
    regular = {}
    for x in solutions:
        # At a pole the factor is zero up to rounding.
        if tilt in x and not abs(number(factor(x[tilt]), known)) < 1e-9 and simplest(factor(x[tilt])) != 0:
            regular[main.key(x, known)] = x
    if len(regular) > MOST_PLACES:
        raise StatementError(problem.too_many(len(regular)))
    records = [(main, problem.record(values, exact=exact)) for values in regular.values()]
    for pole in poles:
        at_pole = dict(zip((tilt, spin), pole, strict=True))
        unknowns = [x for x in (*polar_problem.unknowns, *polar_problem.multipliers) if x not in at_pole]
        for values in solved([equation.xreplace(at_pole) for equation in polar_problem.equations], unknowns) or ():
            records.append((polar, polar_problem.record({**at_pole, **values}, exact=True, axial=symmetric)))
    if not records:
        raise StatementError(problem.none_found(symbolic=exact))
    turns = []
    for angles, record in records:
        # The angular momentum of a free body is constant in space, and the energy at this momentum bounds its motion.
        free = main.is_free and len(problem.unknowns) == len(record.criterion) == 2
        if free and record.stable is None and number(record.criterion[1], known).real > 0:
            reason = "the energy is the largest, or the least, of all attitudes with this angular momentum."
            record = replace(record, stable=True, reason=reason)
        turns.append(angles.in_quaternion(record))
    return sorted(turns, key=problem.order)


def _precessions(
    statement: Statement, axis: int, rate: Any, others: Mapping[Any, Any], attitude: Sequence[Sequence[Any]]
) -> list[Equilibrium]:
    """Return the precessions of a body that turns at `rate` about its `axis` of symmetry (index 0, 1 or 2).

    The tilt is that of the rotation matrix `attitude`. `others` maps other coordinates to constant velocities. The body
    precesses about the first axis z, y or x of space about which the system is symmetric, at rates for which the
    torque on the tilt is zero.
    """
    for upright in (2, 1, 0):
        angles = _Angles(statement, upright, axis)
        precession, tilt, spin = angles.angles
        if precession in angles.free and spin in angles.free:
            break
    else:
        raise StatementError(
            f"{angles.rotation.name} has no steady precession: forces or drags act about its axis {AXES[axis]} and the "
            "axes of space, or energies or constraints change with the angles about them."
        )
    problem = _Problem(angles.form, angles.ignorable, others)
    form, known, unknown = problem.form, dict(statement.defaults), sympy.Dummy("w", real=True)
    if problem.unknowns != (form.plain[tilt],):
        raise StatementError(
            f"precessions of {statement.name} are found only if all coordinates besides {angles.rotation.name} are "
            f"ignorable: forces or constraints depend on {listing(map(str, problem.unknowns))}."
        )
    cosine = angles.matrix[upright, axis]  # cosine of the angle between both axes: cos or sin of the tilt
    entry = min(max(attitude[upright][axis] * (1 if axis == upright else cosine.subs(tilt, sympy.pi / 2)), -1), 1)
    if abs(entry) > 1 - 1e-15:
        raise StatementError(
            f"axis {AXES[axis]} of {angles.rotation.name} lies along axis {AXES[upright]} of space at this attitude: "
            "precession and spin are one rotation. Give an attitude with a tilt, or the rate of this rotation, as in "
            f"equilibria({{{angles.rotation.name}.space[{upright}]: ...}})."
        )
    entry = 0.0 if abs(entry) < 1e-15 else entry  # exactly 0 for a horizontal axis
    stated_tilt = sympy.acos(entry) if axis == upright else sympy.asin(entry)
    spin_rate = expression(rate, "the rate") - unknown * cosine.subs(tilt, stated_tilt)
    still = dict.fromkeys((*form.a, *form.v, *angles.symbols), sympy.S.Zero)
    speeds = {form.plain[velocity_of(precession)]: unknown, form.plain[velocity_of(spin)]: spin_rate}
    (row,) = problem.rows
    force = form.residuals[row].xreplace({**still, **problem.speeds, **speeds, form.plain[tilt]: stated_tilt})
    force = sympy.expand(force.xreplace(known))
    if not force.is_polynomial(unknown) or force.free_symbols != {unknown}:
        raise StatementError(
            f"the precessions of {statement.name} are the roots of a polynomial with numbers as coefficients, which "
            f"{formula(force, 80)} is not: give values of all parameters."
        )
    # Roots of fractions are isolated: at a nearly horizontal axis one rate is very much larger than the other.
    roots = [root.evalf(30) for root, _ in sympy.Poly(in_fractions(force), unknown).real_roots(multiple=False)]
    if not roots:
        raise StatementError(
            f"{statement.name} has no steady precession at this attitude: {angles.rotation.name} spins too slowly."
        )
    precessions = []
    for root in roots:
        rates = {v: sympy.Float(x.xreplace({unknown: root}).xreplace(known), 17) for v, x in speeds.items()}
        problem.speeds |= {v: in_fractions(x) for v, x in rates.items()}
        known_tilt = {form.plain[tilt]: sympy.Float(float(stated_tilt))}
        precessions.append(angles.in_quaternion(problem.record(known_tilt, exact=False)))
    return sorted(precessions, key=problem.order)


def _condition(values: Sequence[Any]) -> Any:
    """Return the condition under which `values` are real: |x| <= 1 in asin(x) and acos(x), x >= 0 in even roots."""
    parts = []
    for value in values:
        for f in sorted(value.atoms(sympy.asin, sympy.acos), key=str):
            argument = f.args[0]
            if not argument.is_number:
                parts.append(sympy.Le(argument if argument.is_nonnegative else sympy.Abs(argument), 1))
        for power in sorted(value.atoms(sympy.Pow), key=str):
            if power.exp.is_Rational and power.exp.q % 2 == 0 and not power.base.is_nonnegative:
                parts.append(sympy.Ge(power.base, 0))
    return sympy.And(*parts)
