"""Equilibria: where the forces vanish at rest, or in a steady motion of ignorable coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.errors import FAULT, RunError, StatementError, listing, shown
from lagrange.mechanics.expansion import StatedPoint, stated_point, with_lengths
from lagrange.mechanics.linearization import linearized_at
from lagrange.mechanics.plain_form import PlainForm, in_fractions, number, simplest, size_of_terms
from lagrange.mechanics.roots import STARTS, numeric_roots, solved
from lagrange.mechanics.stability import Verdict, criterion, ignorable, stability_of
from lagrange.statement.coordinate import t
from lagrange.statement.progress import ShownAsPage
from lagrange.statement.statement import Statement

FORCE_LEFT = 1e-15
"""Largest residual force at a symbolic equilibrium, relative to its terms, evaluated with 30 digits."""

FORCE_LEFT_BY_SEARCH = 1e-6  # Largest residual force at an equilibrium in decimals, relative to its terms

COORDINATE_ROUNDING = 1e-15
"""Relative rounding error of a coordinate in decimals: for pi as a double, sin(pi) = 1.2e-16 is only rounding."""

MOST_PLACES = 64  # Largest number of numerical equilibria in a list: each takes about 0.2 s to analyse


@dataclass(frozen=True, eq=False)
class Equilibrium(ShownAsPage):
    """An equilibrium at rest, or a steady motion with `velocities` of ignorable coordinates.

    `coordinates` maps each coordinate to an expression in parameters; an arbitrary coordinate is mapped to itself.
    `energy` is v.p - L at the equilibrium. `condition` is the condition on the parameters under which it exists.
    `exists` is the truth of the condition at the values of the parameters, or None if a value is missing. `stable` is
    True, False, or None if undecided, and `reason` says why. `criterion` has the leading minors of the stiffness matrix
    at fixed momenta of ignorable coordinates: if all are positive, the energy has a minimum. `exact` is false if the
    equilibrium was found numerically. `statement` is the statement of the system.
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
        """The point as an argument for `linearize` and `modes`; arbitrary coordinates are zero in it."""
        return {q: x for q, x in self.coordinates.items() if x != q} | dict(self.velocities)


def equilibria(statement: Statement, rates: Any) -> list[Equilibrium]:
    """Return the equilibria of a statement at rest, or at steady `rates` of ignorable coordinates.

    Those known to exist at the values of the parameters come first; both groups are sorted by energy. Raises
    StatementError if none is found.
    """
    problem = _Problem(statement, rates)
    branches = solved(problem.equations, (*problem.unknowns, *problem.multipliers))
    if branches is None:
        solutions = problem.searched()
        if len(solutions) > MOST_PLACES:
            raise StatementError(problem.too_many(len(solutions)))
        records = [problem.record(values, exact=False) for values in solutions]
    else:
        records = [problem.record(values, exact=True) for values in branches]
    if not records:
        raise StatementError(problem.none_found(symbolic=branches is not None))
    return sorted(records, key=problem.order)


class _Problem:
    """The equations of equilibrium of a statement, in plain symbols."""

    def __init__(self, statement: Statement, rates: Any) -> None:
        self.statement = statement = with_lengths(statement)
        self.form = form = PlainForm(statement)
        self.free = ignorable(form)
        self.speeds = self.steady(rates)
        nonholonomic = [constraint.name for constraint in statement.constraints if not constraint.holonomic]
        if nonholonomic:
            raise StatementError(
                f"{statement.name} has constraints on velocities ({listing(nonholonomic)}), so its equilibria form a "
                "continuous region and cannot be listed: linearize(at=...).equilibrium says whether a point is one."
            )
        at_rest = {**dict.fromkeys((*form.a, *form.v), sympy.S.Zero), **self.speeds}
        forces = [simplest(r.subs(at_rest, simultaneous=True)) for r in form.residuals]
        self.zeros = [form.read(constraint.expression) for constraint in statement.constraints]
        if any(x.has(t) for x in (*forces, *self.zeros)):
            raise StatementError(
                f"the forces of {statement.name} depend on time, so no point is an equilibrium at all times: "
                "transform(...) may give moving coordinates in which the forces do not depend on time."
            )
        fixed = [i for i in range(len(form.q)) if i not in self.free]
        self.unknowns = tuple(form.q[i] for i in fixed)
        self.rows = tuple(fixed)
        self.multipliers = tuple(sympy.Dummy(constraint.name, real=True) for constraint in statement.constraints)
        self.gradient = [[zero.diff(form.q[i]) for i in range(len(form.q))] for zero in self.zeros]
        pushed = [
            forces[i] - sympy.Add(*(m * row[i] for m, row in zip(self.multipliers, self.gradient, strict=True)))
            for i in fixed
        ]
        self.equations = [in_fractions(equation) for equation in (*pushed, *self.zeros)]

    def steady(self, rates: Any) -> dict[Any, Any]:
        """Return the user's steady velocities by symbol. Raises StatementError for invalid `rates`."""
        if rates is None:
            return {}
        if not isinstance(rates, Mapping):
            raise StatementError(f"rates is {shown(rates)}: give a dict from ignorable coordinates to velocities.")
        statement, form = self.statement, self.form
        point = stated_point(statement, rates)
        named = [i for i, q in enumerate(statement.coordinates) if q in rates or statement.names[i] in rates]
        if len(named) < len(rates):
            raise StatementError(
                f"rates has velocities as keys: give coordinates as keys, such as {{{statement.names[-1]}: 1.0}}."
            )
        for i in named:
            if i not in self.free:
                steady = listing(statement.names[k] for k in self.free)
                raise StatementError(
                    f"rates gives {statement.names[i]} a steady velocity, but energies, forces or constraints depend "
                    f"on {statement.names[i]}, so the velocity would change: "
                    + (f"give rates of {steady}." if self.free else "call equilibria() without rates.")
                )
        return {form.v[i]: in_fractions(point.q[i]) for i in named}

    def searched(self) -> list[dict[Any, Any]]:
        """Return numerical equilibria, {symbol: value} each. Raises StatementError if parameters lack values."""
        statement = self.statement
        missing = [p.name for p in statement.parameters if p not in statement.defaults]
        if missing:
            raise StatementError(
                f"the equilibria of {statement.name} are not found in symbols, and for a search by number "
                f"{listing(missing)} {'has' if len(missing) == 1 else 'have'} no value: state "
                f"{statement.name} with parameters={{'{missing[0]}': 1.0}}."
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
        """Return True if L, the forces and the constraints have period 2 pi in a coordinate."""
        turn = {symbol: symbol + 2 * sympy.pi}
        return all(x.xreplace(turn) == x for x in (self.form.lagrangian, *self.form.forces, *self.zeros))

    def none_found(self, *, symbolic: bool) -> str:
        """Return the error message for no equilibrium. It says whether the search was `symbolic` or numerical."""
        statement = self.statement
        named = listing(statement.names[i] for i in self.rows)
        if symbolic:
            contacts = listing(repr(each.name) for each in statement.contacts)
            remedy = f" Contact forces are left out: state the closed ones of {contacts} as constraints."
            return (
                f"{statement.name} has no equilibrium: the forces on {named} at rest, solved in symbols, vanish "
                "nowhere for general values of the parameters." + (remedy if contacts != "none" else "")
            )
        return (
            f"no equilibrium of {statement.name} was found: the forces on {named} are not solved in symbols, and "
            f"Newton's method from {STARTS} starts, the initial state among them, found none at the values of the "
            "parameters. Give an initial state near one, or other values."
        )

    def too_many(self, count: int) -> str:
        """Return the error message for `count` equilibria, which probably form a curve or a surface."""
        return (
            f"{self.statement.name} has too many equilibria to list: {STARTS} starts of Newton's method ended at "
            f"{count} different places, as they do where equilibria fill a curve or a surface. linearize(...) tells of "
            "one place whether it is an equilibrium, modes(...) whether that is stable."
        )

    def record(self, values: Mapping[Any, Any], *, exact: bool) -> Equilibrium:
        """Return the `Equilibrium` for one solution {symbol: value}; `exact` is true for a symbolic solution."""
        statement, form = self.statement, self.form
        coordinates = {
            q: self.principal(symbol, values[symbol]) if symbol in values else symbol
            for q, symbol in zip(statement.coordinates, form.q, strict=True)
        }
        speeds = {v: self.speeds[x] for v, x in zip(statement.velocities, form.v, strict=True) if x in self.speeds}
        zero = sympy.S.Zero
        q = tuple(zero if x.free_symbols & set(form.q) == {x} else x for x in coordinates.values())
        q = tuple(x.xreplace(dict.fromkeys(form.q, zero)) for x in q)
        point = StatedPoint(form, q, tuple(self.speeds.get(v, zero) for v in form.v), {})
        condition = _condition([*values.values()])
        numbers = point.numbers if len(point.numbers) == len(statement.parameters) else None
        exists = True if condition == sympy.true else None
        if numbers is not None:
            exists = all(x == x and abs(x.imag) < 1e-12 for x in (number(x, numbers) for x in q))
            if exact:
                self.check(values, numbers, exists=exists)
        decided, minors = Verdict(stable=None, reason="it does not exist at the values of the parameters."), ()
        if exists is not False:
            try:
                lin = linearized_at(point)
                decided = stability_of(lin, point)
                minors = criterion(lin, self.free if not statement.constraints else ())
            except StatementError as refusal:
                decided = Verdict(stable=None, reason=str(refusal))
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
        """Return the value of an angle reduced to (-pi, pi] if the value is known; return any other value unchanged."""
        if not self.is_angle(symbol):
            return value
        angle = number(value, {p: sympy.Rational(x) for p, x in self.statement.defaults.items()})
        if angle != angle or angle.imag:
            return value
        return simplest(value - 2 * sympy.pi * math.ceil(round(angle.real / (2 * math.pi), 12) - 0.5))

    def check(self, values: Mapping[Any, Any], known: Mapping[Any, Any], *, exists: bool) -> None:
        """Evaluate the forces at a solution `values`, with numbers `known` for the parameters.

        Raises RunError if a force exceeds its rounding error, which is a fault of this library. Nothing is tested
        unless the equilibrium `exists` for these numbers.
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
        """Return the sort key of an equilibrium: existing ones come first, then by energy if it has a value."""
        values = {p: sympy.Rational(x) for p, x in self.statement.defaults.items()}
        energy = number(self.form.read(equilibrium.energy), values)
        return (not equilibrium.exists, round(energy.real, 9) if energy == energy else 0.0)


def _condition(values: Sequence[Any]) -> Any:
    """Return the condition under which values are real: |x| <= 1 in asin(x) and acos(x), x >= 0 under even roots."""
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
