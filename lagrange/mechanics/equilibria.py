"""Equilibria: where the forces vanish at rest, or in a steady motion of ignorable coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.errors import FAULT, RunError, StatementError, listing, shown
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.expansion import StatedPoint, stated_point, with_lengths
from lagrange.mechanics.linearization import Linearization, linearized_at
from lagrange.mechanics.plain_form import PlainForm, in_fractions, number, simplest, size_of_terms
from lagrange.mechanics.stability import Verdict, criterion, ignorable, stability_of
from lagrange.mechanics.symbolic_roots import solved
from lagrange.statement.coordinate import t
from lagrange.statement.notebook_page import ShownAsPage
from lagrange.statement.statement import Statement

STARTS = 256
"""Number of starting points of the search. The initial state is one of them."""

STEPS = 60
"""Largest number of Newton steps from each start; near an equilibrium five suffice."""

CLOSE = 1e-9
"""Largest last Newton step of a converged start, relative to 1 plus the largest coordinate."""

SAME = 1e-6
"""Largest distance, in the same measure, between two end points that count as the same equilibrium."""

FLAT = 1e-6
"""Ratio of the least to the largest singular value of the slopes below which an end point is flat, as for y^3 at 0."""

SAME_FLAT = 1e-3
"""As `SAME`, for two flat end points: a force like y^3 determines y to about 1e-4 only.

The end point with the smallest force is kept.
"""

WITHIN = 1e-3
"""Largest ratio of force to slope at an equilibrium, relative to 1 plus the largest coordinate.

It rejects end points far out, where a force is small but never zero.
"""

DIFFERENCE = 1e-6
"""Step of central differences, relative to 1 plus the coordinate: Newton's method then gains nine digits per step."""

SMALL_FORCE = 1e-8
"""Largest residual force at an equilibrium, relative to the typical forces at the starts."""


@dataclass(frozen=True, eq=False)
class Search:
    """Numerical search for coordinates at which all forces vanish and the constraints hold.

    `unknowns` are the indices of the k unknown coordinates; `angles` is true for those with period 2 pi. `forces` are
    the residuals of the equations of motion at rest, `gradient` the rows of G, and `zeros` the constraints, all as
    expressions of the model's system. `state` (2n,) has the fixed coordinates and the steady velocities.
    """

    model: Model
    parameters: FloatArray
    state: FloatArray
    unknowns: tuple[int, ...]
    angles: tuple[bool, ...]
    forces: tuple[Any, ...]
    gradient: tuple[tuple[Any, ...], ...]
    zeros: tuple[Any, ...]

    def found(self) -> list[FloatArray]:
        """Return the unknowns at distinct equilibria, (k,) each, sorted by their values."""
        ends: list[FloatArray] = []
        with np.errstate(all="ignore"):
            q, good = self._newton(self._starts())
            left, slopes = np.abs(self._residuals(q)).max(axis=0), self._slopes(q)
            near = left < WITHIN * np.abs(slopes).max(axis=(1, 2)) * (1 + np.abs(q).max(axis=0))
        flat: list[bool] = []
        for i in sorted(np.flatnonzero(good & near), key=lambda i: float(left[i])):
            here, sizes = self._wrapped(q[:, i]), np.linalg.svd(slopes[i], compute_uv=False)
            level = bool(sizes[-1] <= FLAT * sizes[0])
            same = (
                self._same(here, end, SAME_FLAT if level and flat_end else SAME)
                for end, flat_end in zip(ends, flat, strict=True)
            )
            if not any(same):
                ends.append(here)
                flat.append(level)
        return sorted(ends, key=lambda end: [round(float(x), 6) for x in end])

    def _same(self, end: FloatArray, other: FloatArray, close: float) -> bool:
        return bool(np.abs(self._wrapped(end - other)).max() <= close * (1 + np.abs(other).max()))

    def _wrapped(self, q: FloatArray) -> FloatArray:
        """Return coordinates with angles reduced to (-pi, pi] and values below 1e-12 set to zero."""
        turns = np.ceil(q / (2 * math.pi) - 0.5 - 1e-9)
        wrapped = np.where(self.angles, q - 2 * math.pi * turns, q)
        return np.where(np.abs(wrapped) < 1e-12, 0.0, wrapped)

    @cached_property
    def _scale(self) -> FloatArray:
        size = max(1.0, float(np.abs(self.state[list(self.unknowns)]).max()))
        return np.where(self.angles, 1.0, size)

    def _starts(self) -> FloatArray:
        """Return the starts (k, STARTS): the initial state, zero, and random points of several magnitudes."""
        draw = np.random.default_rng(0)
        k = len(self.unknowns)
        sizes = self._scale[:, None] * 10.0 ** draw.uniform(-1.0, 1.0, STARTS)
        turns = draw.uniform(-math.pi, math.pi, (k, STARTS))
        starts = np.where(np.array(self.angles)[:, None], turns, sizes * draw.normal(size=(k, STARTS)))
        starts[:, 0] = self.state[list(self.unknowns)]
        starts[:, 1] = 0.0
        return starts

    def _residuals(self, q: FloatArray) -> FloatArray:
        """Return the residuals for columns q (k, N): the forces tangent to the constraints, then the constraints."""
        columns = q.shape[1]
        y = np.repeat(self.state[:, None], columns, axis=1)
        y[list(self.unknowns)] = q
        t = np.zeros(columns)

        def rows(expressions: Sequence[Any]) -> FloatArray:
            return np.array([self.model.evaluate_expression(e, t, y, self.parameters) for e in expressions])

        forces = rows(self.forces)
        if not self.zeros:
            return forces
        gradient = np.array([rows(row) for row in self.gradient])
        sound = np.isfinite(gradient).all(axis=(0, 1)) & np.isfinite(forces).all(axis=0)
        left = np.full_like(forces, np.nan)
        g, f = np.moveaxis(gradient[:, :, sound], 2, 0), forces[:, sound].T[:, :, None]
        left[:, sound] = (f - np.linalg.pinv(g) @ (g @ f))[:, :, 0].T
        return np.vstack([left, rows(self.zeros)])

    def _slopes(self, q: FloatArray) -> FloatArray:
        """Return the Jacobians of the residuals for columns q (k, N), (N, residuals, k)."""
        slopes = []
        for i in range(len(q)):
            step = np.zeros_like(q)
            step[i] = DIFFERENCE * (1 + np.abs(q[i]))
            slopes.append((self._residuals(q + step) - self._residuals(q - step)) / (2 * step[i]))
        return np.moveaxis(np.array(slopes), (0, 1, 2), (2, 1, 0))

    def _newton(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the end points of Newton's method from q (k, N), and True for each that converged, (N,)."""
        good = np.zeros(q.shape[1], dtype=bool)
        first = self._residuals(q)
        sizes = np.array([np.median(np.abs(row[np.isfinite(row)])) if np.isfinite(row).any() else 1.0 for row in first])
        for _ in range(STEPS):
            r, slopes = self._residuals(q), self._slopes(q)
            sound = np.isfinite(r).all(axis=0) & np.isfinite(slopes).all(axis=(1, 2))
            step = np.zeros_like(q)
            if sound.any():
                step[:, sound] = (np.linalg.pinv(slopes[sound], rcond=1e-10) @ r.T[sound][:, :, None])[:, :, 0].T
            small = np.abs(r).max(axis=0) <= SMALL_FORCE * max(float(sizes.max()), 1e-300)
            done = np.abs(step).max(axis=0) <= CLOSE * (1 + np.abs(q).max(axis=0))
            good = sound & small & done
            if good.all():
                break
            largest = np.abs(step / self._scale[:, None]).max(axis=0)
            q = q - step * np.minimum(1.0, 1.0 / np.maximum(largest, 1e-300))
        return q, good


FORCE_LEFT = 1e-15
"""Largest residual force at a symbolic equilibrium, relative to its terms, evaluated with 30 digits."""

FORCE_LEFT_BY_SEARCH = 1e-6
"""Largest residual force at an equilibrium in decimals, relative to its terms."""

ROUNDING = 1e-15
"""Relative rounding error of a coordinate in decimals: for pi as a double, sin(pi) = 1.2e-16 is only rounding."""

MOST_PLACES = 64
"""Largest number of numerical equilibria in a list: each takes about 0.2 s to analyse."""


@dataclass(frozen=True, eq=False)
class Equilibrium(ShownAsPage):
    """An equilibrium at rest, or a steady motion with `velocities` of ignorable coordinates.

    `coordinates` maps each coordinate to an expression in parameters; an arbitrary coordinate is mapped to itself.
    `energy` is v.p - L at the equilibrium. `condition` is the condition on the parameters under which it exists.
    `exists` is its truth at the values of the parameters, or None if a value is missing. `stable` is True, False, or
    None if undecided, and `reason` says why. `criterion` has the leading minors of the stiffness, at fixed momenta of
    ignorable coordinates: if all are positive, the energy has a minimum. `exact` is false if the equilibrium was found
    numerically. `statement` is the statement of the system.
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
        place = ", ".join(f"{q} = {x}" for q, x in {**self.coordinates, **self.velocities}.items())
        where = "" if self.condition == sympy.true else f", where {self.condition}"
        return f"<Equilibrium: {place}; {word}{where}>"

    def __reduce__(self) -> tuple[Any, ...]:
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return _again, ({**values, "coordinates": dict(self.coordinates), "velocities": dict(self.velocities)},)

    @property
    def at(self) -> dict[Any, Any]:
        """The point as an argument for `linearize` and `modes`; arbitrary coordinates are zero in it."""
        return {q: x for q, x in self.coordinates.items() if x != q} | dict(self.velocities)


def _again(values: dict[str, Any]) -> Equilibrium:
    views = {name: MappingProxyType(values[name]) for name in ("coordinates", "velocities")}
    return Equilibrium(**(values | views))


def equilibria(statement: Statement, rates: Any, model: Model) -> list[Equilibrium]:
    """Return the equilibria: symbolic if the equations can be solved, else numerical, sorted by energy.

    `rates` maps ignorable coordinates to steady velocities, or is None. Raises StatementError if there are none.
    """
    problem = _Problem(statement, rates)
    branches = solved(problem.equations, (*problem.unknowns, *problem.multipliers))
    if branches is None:
        places = problem.searched(model)
        if len(places) > MOST_PLACES:
            raise StatementError(problem.too_many(len(places)))
        records = [problem.record(values, exact=False) for values in places]
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
                f"{statement.name} has constraints on velocities ({listing(nonholonomic)}), and where it "
                "stays at rest is a whole region: linearize(...) tells of one place whether it is an equilibrium."
            )
        at_rest = {**dict.fromkeys((*form.a, *form.v), sympy.S.Zero), **self.speeds}
        forces = [simplest(r.subs(at_rest, simultaneous=True)) for r in form.residuals]
        self.zeros = [form.read(constraint.expression) for constraint in statement.constraints]
        if any(x.has(t) for x in (*forces, *self.zeros)):
            raise StatementError(
                f"the forces of {statement.name} depend on time, and no place stays an equilibrium: transform(...) may "
                "state it in moving coordinates in which they do not."
            )
        places = [i for i in range(len(form.q)) if i not in self.free]
        self.unknowns = tuple(form.q[i] for i in places)
        self.rows = tuple(places)
        self.multipliers = tuple(sympy.Dummy(constraint.name, real=True) for constraint in statement.constraints)
        self.gradient = [[zero.diff(form.q[i]) for i in range(len(form.q))] for zero in self.zeros]
        self.forces = forces
        pushed = [
            forces[i] - sympy.Add(*(m * row[i] for m, row in zip(self.multipliers, self.gradient, strict=True)))
            for i in places
        ]
        self.equations = [in_fractions(equation) for equation in (*pushed, *self.zeros)]

    def steady(self, rates: Any) -> dict[Any, Any]:
        """Return the user's steady velocities {velocity symbol: value}. Raises StatementError for bad `rates`."""
        if rates is None:
            return {}
        if not isinstance(rates, Mapping):
            raise StatementError(f"rates is {shown(rates)}: give a dict from ignorable coordinates to velocities.")
        statement, form = self.statement, self.form
        point = stated_point(statement, rates)
        named = [i for i, q in enumerate(statement.coordinates) if q in rates or statement.names[i] in rates]
        if len(named) < len(rates):
            raise StatementError(f"rates names velocities: give coordinates, such as {{{statement.names[-1]}: 1.0}}.")
        for i in named:
            if i not in self.free:
                raise StatementError(
                    f"{statement.names[i]} is not ignorable, and cannot have a steady velocity: those that are, are "
                    f"{listing(statement.names[k] for k in self.free)}."
                )
        return {form.v[i]: in_fractions(point.q[i]) for i in named}

    def searched(self, model: Model) -> list[dict[Any, Any]]:
        """Return equilibria found numerically, {symbol: value} each. Raises StatementError for missing parameters."""
        statement, form = self.statement, self.form
        missing = [p.name for p in statement.parameters if p not in statement.defaults]
        if missing:
            raise StatementError(
                f"the equilibria of {statement.name} are not found in symbols, and for a search by number "
                f"{listing(missing)} {'has' if len(missing) == 1 else 'have'} no value: give "
                f"parameters={{'{missing[0]}': 1.0}}."
            )
        values = {p: sympy.Rational(x) for p, x in statement.defaults.items()}
        state = np.zeros(model.layout.size)
        state[list(self.rows)] = np.array(statement.initial)[list(self.rows)]
        for i, v in enumerate(form.v, model.layout.v.start):
            state[i] = number(self.speeds.get(v, sympy.S.Zero), values).real
        search = Search(
            model=model,
            parameters=model.parameter_array(),
            state=state,
            unknowns=self.rows,
            angles=tuple(self.is_angle(q) for q in self.unknowns),
            forces=tuple(form.written(self.forces[i]) for i in self.rows),
            gradient=tuple(tuple(form.written(row[i]) for i in self.rows) for row in self.gradient),
            zeros=tuple(map(form.written, self.zeros)),
        )
        return [dict(zip(self.unknowns, map(sympy.Float, end), strict=True)) for end in search.found()]

    def is_angle(self, symbol: Any) -> bool:
        """Return True if L, the forces and the constraints have period 2 pi in a coordinate."""
        turn = {symbol: symbol + 2 * sympy.pi}
        return all(x.xreplace(turn) == x for x in (self.form.lagrangian, *self.form.forces, *self.zeros))

    def none_found(self, *, symbolic: bool) -> str:
        """Return the error message for no equilibrium; it says how the search was done."""
        statement = self.statement
        named = listing(statement.names[i] for i in self.rows)
        if symbolic:
            return (
                f"{statement.name} has no equilibrium: the forces on {named} at rest, solved in symbols, vanish "
                "nowhere for general values of the parameters."
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
        places = {
            q: self.principal(symbol, values[symbol]) if symbol in values else symbol
            for q, symbol in zip(statement.coordinates, form.q, strict=True)
        }
        speeds = {v: self.speeds[x] for v, x in zip(statement.velocities, form.v, strict=True) if x in self.speeds}
        zero = sympy.S.Zero
        q = tuple(zero if x.free_symbols & set(form.q) == {x} else x for x in places.values())
        q = tuple(x.xreplace(dict.fromkeys(form.q, zero)) for x in q)
        point = StatedPoint(form, q, tuple(self.speeds.get(v, zero) for v in form.v), {})
        condition = _condition([*values.values()])
        known = point.numbers if len(point.numbers) == len(statement.parameters) else None
        exists = True if condition == sympy.true else None
        if known is not None:
            exists = all(x == x and abs(x.imag) < 1e-12 for x in (number(x, known) for x in q))
            if exact:
                self.check(values, known, exists=exists)
        decided, minors = Verdict(stable=None, reason="it does not exist at the values of the parameters."), ()
        if exists is not False:
            decided, minors = self.decided(point)
        return Equilibrium(
            coordinates=MappingProxyType({key: form.written(x) for key, x in places.items()}),
            velocities=MappingProxyType(speeds),
            stable=decided.stable,
            reason=decided.reason,
            energy=self.energy(point),
            condition=condition,
            exists=exists,
            criterion=minors,
            exact=exact,
            statement=self.statement,
        )

    def decided(self, point: StatedPoint) -> tuple[Verdict, tuple[Any, ...]]:
        """Return the verdict and the criterion. If the linearization fails, the verdict's reason is its message."""
        try:
            lin = linearized_at(point)
        except StatementError as refusal:
            return Verdict(stable=None, reason=str(refusal)), ()
        return stability_of(lin, point), self.minors(lin)

    def minors(self, lin: Linearization) -> tuple[Any, ...]:
        """Return the stability criterion: leading minors of the stiffness at fixed momenta."""
        return criterion(lin, self.free if not self.statement.constraints else ())

    def principal(self, symbol: Any, value: Any) -> Any:
        """Return an angle with a known value reduced to (-pi, pi]; return any other value unchanged."""
        if not self.is_angle(symbol):
            return value
        angle = number(value, {p: sympy.Rational(x) for p, x in self.statement.defaults.items()})
        if angle != angle or angle.imag:
            return value
        return simplest(value - 2 * sympy.pi * math.ceil(round(angle.real / (2 * math.pi), 12) - 0.5))

    def check(self, values: Mapping[Any, Any], known: Mapping[Any, Any], *, exists: bool) -> None:
        """Evaluate the forces at a solution. Raises RunError if one exceeds its rounding, a fault of this library."""
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
            rounding = sum(ROUNDING * abs(number(x, known)) * size(whole.diff(q)) for q, x in decimals.items())
            if left > limit * size(whole) + rounding:
                raise RunError(
                    f"an equilibrium of {self.statement.name} is wrong: a force of {left:.3g} is left. {FAULT}"
                )

    def energy(self, point: StatedPoint) -> Any:
        """Return v.p - L at a point."""
        form = self.form
        work = sympy.Add(*(p * v for p, v in zip(form.momenta, form.v, strict=True)))
        return form.written(simplest((work - form.lagrangian).xreplace(point.table)))

    def order(self, equilibrium: Equilibrium) -> tuple[Any, ...]:
        """Return the sort key: existing equilibria first, then by energy if it has a value."""
        values = {p: sympy.Rational(x) for p, x in self.statement.defaults.items()}
        energy = number(self.form.read(equilibrium.energy), values)
        return (not equilibrium.exists, round(energy.real, 9) if energy == energy else 0.0)


def _condition(values: Sequence[Any]) -> Any:
    """Return the condition for real values: |x| <= 1 in asin(x) and acos(x), and x >= 0 under even roots."""
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
