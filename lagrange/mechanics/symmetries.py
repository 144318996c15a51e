"""Point symmetries found by solving for them, each with the quantity that it conserves (Noether's theorem).

Moved along xi(q) and in time by tau, a motion keeps p . xi - tau E - F if

    xi . (dL/dq + Q - dD/dv) + (dxi/dt) . p - tau (dE/dt) = dF/dt

at every state, F being a function of q and t. With constraints xi is along them, G xi = 0, so that their forces do no
work. The unknown coefficients stand linearly: the null space of many states in doubles shows which do not vanish, and
the same equations, written as monomials, give these exactly, as functions of the parameters, and prove them.
Source: J. V. Jose, E. J. Saletan, Classical Dynamics, 1998, sections 3.2 and 3.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import sympy
from sympy import Dummy, S

from lagrange.equations.identities import canonical, is_identity
from lagrange.equations.monomials import Monomial, MonomialSum, accumulate
from lagrange.equations.stated_algebra import StatedAlgebra
from lagrange.equations.structure import Structure
from lagrange.equations.terms import TooLargeError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.generators import Field, components, fields
from lagrange.mechanics.motion_rates import MotionRates, random_rates
from lagrange.mechanics.null_space import SUPPORT, null_rows, with_rotations

MARGIN = 1.4
"""States for each unknown."""

SIMPLE = 12
"""Largest denominator of a coefficient that is taken for a fraction before it is solved for."""

LARGEST = 60_000
"""Monomials that are made for one symmetry, 1 s of them."""

WIDEST_SUPPORT = 40
"""Symmetries with more coefficients than this are not solved for exactly."""

MOST_QUADRATIC = 6
"""With more coordinates F is at most linear in them."""


@dataclass(frozen=True, eq=False)
class Symmetry:
    """xi (n of them), tau and F in the plain symbols of a statement."""

    xi: tuple[Any, ...]
    tau: Any = S.Zero
    gauge: Any = S.Zero


@dataclass(frozen=True, eq=False)
class SymmetryEquation:
    """The condition of a symmetry, with the laws of a statement as monomials."""

    stated: StatedAlgebra
    forces: Sequence[MonomialSum] = field(init=False)
    power: MonomialSum = field(init=False)

    def __post_init__(self) -> None:
        stated, algebra = self.stated, self.stated.algebra
        drag = stated.read(stated.statement.dissipation)
        applied = [
            algebra.add(stated.read(force), algebra.scale(algebra.differentiate(drag, v), S.NegativeOne))
            for force, v in zip(stated.statement.forces, stated.v, strict=True)
        ]
        slopes = [algebra.differentiate(stated.lagrangian, q) for q in stated.q]
        object.__setattr__(self, "forces", [algebra.add(*pair) for pair in zip(slopes, applied, strict=True)])
        work = [algebra.multiply(q, stated.symbol(v)) for q, v in zip(applied, stated.v, strict=True)]
        lost = algebra.scale(algebra.differentiate(stated.lagrangian, stated.time), S.NegativeOne)
        object.__setattr__(self, "power", algebra.add(lost, *work))

    def defect(self, symmetry: Symmetry) -> MonomialSum:
        """Return the rate at which p . xi - tau E - F changes beside the forces of constraints, merged."""
        stated, algebra = self.stated, self.stated.algebra
        parts: list[MonomialSum] = [{}]
        for given, force, p in zip(symmetry.xi, self.forces, stated.momenta, strict=True):
            if given != 0:
                xi = algebra.read(given)
                parts += [algebra.multiply(xi, force), algebra.multiply(self.rate(xi), p)]
        if symmetry.tau != 0:
            parts.append(algebra.multiply(algebra.read(-symmetry.tau), self.power))
        if symmetry.gauge != 0:
            parts.append(algebra.scale(self.rate(algebra.read(symmetry.gauge)), S.NegativeOne))
        return algebra.merge_angles(algebra.add(*parts))

    def rate(self, terms: MonomialSum) -> MonomialSum:
        """Return the total rate of a function of q and t."""
        stated, algebra = self.stated, self.stated.algebra
        moved = [
            algebra.multiply(algebra.differentiate(terms, q), stated.symbol(v))
            for q, v in zip(stated.q, stated.v, strict=True)
        ]
        return algebra.add(algebra.differentiate(terms, stated.time), *moved)

    def across(self, symmetry: Symmetry) -> list[MonomialSum]:
        """Return G xi, how fast each constraint would be left."""
        stated, algebra = self.stated, self.stated.algebra
        found = []
        for one in stated.statement.constraints:
            zero, symbols = stated.read(one.expression), stated.q if one.holonomic else stated.v
            parts = [
                algebra.multiply(algebra.differentiate(zero, symbol), algebra.read(xi))
                for symbol, xi in zip(symbols, symmetry.xi, strict=True)
                if xi != 0
            ]
            found.append(algebra.merge_angles(algebra.add({}, *parts)))
        return found

    def proven(self, symmetry: Symmetry) -> bool:
        """Return whether the symmetry is proven; False says that no proof was found."""
        stated = self.stated
        moved = [q for q, xi in zip(stated.q, symmetry.xi, strict=True) if xi != 0]
        moved += [stated.time] if symmetry.tau != 0 else []
        if stated.jumps(*moved):
            return False
        conditions = (self.defect(symmetry), *self.across(symmetry))
        return all(is_identity(stated.algebra, terms) for terms in conditions)

    def quantity(self, symmetry: Symmetry) -> MonomialSum:
        """Return p . xi - tau E - F."""
        stated, algebra = self.stated, self.stated.algebra
        parts = [algebra.multiply(algebra.read(xi), p) for xi, p in zip(symmetry.xi, stated.momenta, strict=True)]
        if symmetry.tau != 0:
            parts.append(algebra.multiply(algebra.read(-symmetry.tau), stated.energy))
        parts.append(algebra.read(-symmetry.gauge))
        return algebra.merge_angles(algebra.add({}, *parts))


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The terms whose coefficients are sought: fields, the shift of time, and functions F of q and t."""

    stated: StatedAlgebra
    xi: Sequence[Field]
    tau: bool
    gauges: Sequence[Any]

    @property
    def count(self) -> int:
        """The number of coefficients."""
        return len(self.xi) + self.tau + len(self.gauges)

    def columns(self, rates: MotionRates, *, held: bool) -> FloatArray:
        """Return the condition for each coefficient at every state, (states, coefficients)."""
        columns = []
        blank = [np.zeros((rates.gradient.shape[0], len(rates.t)))] if held else []
        for one in self.xi:
            value, rate = one.values(rates.q, rates.v)
            own = value * rates.forces[one.of] + rate * rates.momenta[one.of]
            across = [rates.gradient[:, one.of] * value] if held else []
            columns.append(np.vstack([own[None], *across]).ravel())
        others = [-rates.power] if self.tau else []
        others += [-self._gauge_rate(gauge, rates) for gauge in self.gauges]
        columns += [np.vstack([other[None], *blank]).ravel() for other in others]
        return np.array(columns).T

    def _gauge_rate(self, gauge: Any, rates: MotionRates) -> FloatArray:
        """Return the rate of t, q_i, t q_i, q_i q_j, or a length times sines and cosines."""
        stated = self.stated
        total = np.zeros(len(rates.t))
        values = {stated.time: (rates.t, np.ones_like(rates.t))}
        for i, q in enumerate(stated.q):
            x, v = rates.q[i], rates.v[i]
            values |= {q: (x, v), sympy.sin(q): (np.sin(x), np.cos(x) * v), sympy.cos(q): (np.cos(x), -np.sin(x) * v)}
        factors = [factor for factor, e in gauge.as_powers_dict().items() for _ in range(int(e))]
        for k in range(len(factors)):
            part = values[factors[k]][1]
            for other, factor in enumerate(factors):
                part = part if other == k else part * values[factor][0]
            total = total + part
        return total

    def leading(self, row: Mapping[int, float]) -> int:
        """Return the place of the coefficient that becomes 1: that of tau, else of the last field, else of F."""
        moved = [place for place in row if place < len(self.xi) + self.tau]
        return max(moved or row)

    def symmetry(self, coefficients: Mapping[int, Any]) -> Symmetry:
        """Return the symmetry of some coefficients by place."""
        xi: list[Any] = [S.Zero] * len(self.stated.q)
        tau = gauge = S.Zero
        for place, c in sorted(coefficients.items()):
            if place < len(self.xi):
                one = self.xi[place]
                xi[one.of] += c * one.written(self.stated.q)
            elif self.tau and place == len(self.xi):
                tau += c
            else:
                gauge += c * self.gauges[place - len(self.xi) - self.tau]
        return Symmetry(tuple(xi), tau, gauge)


def unknowns(stated: StatedAlgebra, structure: Structure) -> Unknowns:
    """Return what may be tried for a statement."""
    q, t = stated.q, stated.time
    gauges = [t, *q]
    if not structure.constraints and not structure.forced and len(q) <= MOST_QUADRATIC:
        gauges += [t * one for one in q] + [q[i] * q[j] for i in range(len(q)) for j in range(i + 1)]
        gauges += components(stated)
    return Unknowns(stated, fields(stated), structure.workless, gauges)


def point_symmetries(model: Model, equation: SymmetryEquation) -> list[Symmetry]:
    """Return a basis of the symmetries that are found among the fields tried, each proven."""
    structure = model.equations.structure
    held, sought = len(structure.constraints), unknowns(equation.stated, structure)
    rates = random_rates(model, int(MARGIN * sought.count) // (1 + held) + 20, seed=3, moving=False)
    found = []
    rows = null_rows(sought.columns(rates, held=bool(held)))
    for row in with_rotations(rows, sought.xi, model.statement.names):
        symmetry = _exact(equation, sought, row)
        if symmetry is not None and any((*symmetry.xi, symmetry.tau)):
            found.append(symmetry)
    return found


def _exact(equation: SymmetryEquation, sought: Unknowns, row: Mapping[int, float]) -> Symmetry | None:
    """Return the symmetry with the coefficients of a row, exact ones, or None where no proof is found."""
    if len(row) > WIDEST_SUPPORT:
        return None
    last = sought.leading(row)
    scaled = {place: c / row[last] for place, c in row.items()}
    for values in (partial(_simple, scaled), partial(_solved, equation, sought, scaled, last)):
        try:
            with equation.stated.algebra.at_most(LARGEST):
                coefficients = values()
                if coefficients is not None and equation.proven(symmetry := sought.symmetry(coefficients)):
                    return symmetry
        except TooLargeError:
            continue
    return None


def _simple(row: Mapping[int, float]) -> dict[int, Any] | None:
    """Return simple fractions that are the coefficients, as those of most symmetries; None if they are not."""
    found = {place: Fraction(c).limit_denominator(SIMPLE) for place, c in row.items()}
    if any(abs(float(found[place]) - c) > SUPPORT * abs(c) for place, c in row.items()):
        return None
    return {place: sympy.Rational(c.numerator, c.denominator) for place, c in found.items()}


def _solved(equation: SymmetryEquation, sought: Unknowns, row: Mapping[int, float], last: int) -> dict[int, Any] | None:
    """Return the coefficients with which the condition vanishes monomial by monomial, in terms of the parameters."""
    coefficients = {place: S.One if place == last else Dummy(f"c{place}", real=True) for place in row}
    symmetry = sought.symmetry(coefficients)
    conditions = (equation.defect(symmetry), *equation.across(symmetry))
    free = [c for c in coefficients.values() if c != 1]
    for form in (lambda terms: terms, partial(canonical, equation.stated.algebra)):
        values = _vanishing(equation.stated, [form(terms) for terms in conditions], free)
        if values is not None:
            return {place: values.get(c, c) for place, c in coefficients.items()}
    return None


def _vanishing(stated: StatedAlgebra, conditions: Sequence[MonomialSum], free: Sequence[Any]) -> dict[Any, Any] | None:
    """Return the values of some unknowns with which every sum is zero; None unless they are determined."""
    moving = frozenset((*stated.q, *stated.v, stated.time))
    algebra, equations = stated.algebra, []
    for terms in conditions:
        groups: dict[Monomial, MonomialSum] = {}
        for monomial, number in terms.items():
            varying = tuple(part for part in monomial if algebra.free(part[0]) & moving)
            constant = tuple(part for part in monomial if not algebra.free(part[0]) & moving)
            accumulate(groups.setdefault(varying, {}), constant, number)
        equations += [algebra.write(group) for group in groups.values() if group]
    if not equations or not free:
        return None if equations or free else {}
    for solution in sympy.linsolve(equations, list(free)):
        values = dict(zip(free, map(sympy.factor, solution), strict=True))
        return None if any(value.has(*free) for value in values.values()) else values
    return None
