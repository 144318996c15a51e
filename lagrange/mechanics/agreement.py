"""Numerical tests of formulas at random states: identities, rates along the motion, compiled values."""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from lagrange.equations.terms import differentiable, printable
from lagrange.errors import FAULT, RunError, StatementError
from lagrange.evidence.sample import SAMPLE_KINDS, Point, Sampler
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.plain_form import DIGITS, PlainForm, is_zero, number
from lagrange.statement.coordinate import acceleration_of, t, velocity_of
from lagrange.statement.statement import Statement
from lagrange.trajectory.constraints.consistent import consistent_state

STATES = 3
"""Number of random states at which an expression must be zero to count as identically zero."""


def vanishes(form: PlainForm, given: Any) -> bool:
    """Return True if an expression in plain symbols is zero at every state, time and value of the parameters."""
    if given == 0:
        return True
    sampler, seen = Sampler(form.statement, seed=7), 0
    for attempt in range(MOST_DRAWS):
        values = form.at(sampler.point(SAMPLE_KINDS[(attempt + 1) % 4], attempt))
        found = number(given, values)
        terms = size_of_terms(given, values)
        if found != found or terms != terms:
            continue
        if abs(found) > 10.0 ** (10 - DIGITS) * terms:
            return False
        seen += 1
        if seen == STATES:
            return True
    return is_zero(given)


def vanishes_in_symbols(given: Any) -> bool:
    """Return True if an expression in plain symbols is zero for all real values of them; False if it has no value."""
    if given == 0:
        return True
    dice, seen = random.Random(7), 0
    symbols = sorted(given.free_symbols, key=str)
    for _ in range(MOST_DRAWS):
        values = {symbol: sympy.Rational(dice.randrange(64, 256), 128) for symbol in symbols}
        found, terms = number(given, values), size_of_terms(given, values)
        if found != found or terms != terms:
            continue
        if abs(found) > 10.0 ** (10 - DIGITS) * terms:
            return False
        seen += 1
    return seen >= STATES


def size_of_terms(given: Any, values: Mapping[Any, Any]) -> float:
    """Return the magnitude of the terms of an expression: sums are replaced by sums of magnitudes, also in factors.

    Rounding is relative to this number, not to the value: in (x - y) z the two terms of the first factor may cancel.
    """
    if given.is_Add:
        return sum(size_of_terms(term, values) for term in given.args)
    if given.is_Mul:
        return math.prod(size_of_terms(factor, values) for factor in given.args)
    if given.is_Pow and given.exp.is_Integer and given.exp.is_positive:
        return size_of_terms(given.base, values) ** int(given.exp)
    return abs(number(given, values))


POINTS = 2
"""Number of random states at which a formula is compared: a wrong one agrees with probability zero."""

MOST_DRAWS = 16
"""Largest number of random states tried, since a formula may have no value at some."""

LARGEST_ERROR = 1e-8
"""Largest difference, relative to the largest number compared. Cancellation costs some digits, a wrong term all."""


def compared(
    what: str, statement: Statement, values: Callable[[Point], tuple[Sequence[float], Sequence[complex]]]
) -> None:
    """Compare formulas with compiled numbers at random states; `values` returns (compiled, formulas) at a point.

    States at which one of them has no value are skipped. Raises RunError, with the name `what`, if they differ.
    """
    sampler, done = Sampler(statement, seed=0), 0
    for attempt in range(MOST_DRAWS):
        point = sampler.point(SAMPLE_KINDS[(attempt + 1) % 4], attempt)
        done += agrees(what, statement, point, values)
        if done == POINTS:
            return


def agrees(
    what: str,
    statement: Statement,
    point: Point,
    values: Callable[[Point], tuple[Sequence[float], Sequence[complex]]],
) -> bool:
    """Return True if compiled numbers and formulas have values at a point. Raises RunError if the values differ."""
    try:
        compiled, formulas = values(point)
    except RunError:
        return False
    if not all(map(cmath.isfinite, (*compiled, *formulas))):
        return False
    off = np.abs(np.asarray(formulas) - np.asarray(compiled))
    scale = max(1e-300, *map(abs, compiled), *map(abs, formulas))
    if off.max() > LARGEST_ERROR * scale:
        worst = int(off.argmax())
        raise RunError(
            f"{what} of {statement.name} is wrong: a formula gives {formulas[worst]:.15g} where {compiled[worst]:.15g} "
            f"is compiled, at {point.describe(statement.names)}. {FAULT}"
        )
    return True


STEP = 1e-5
"""Step of the central difference in time: its error is about 1e-10."""


CORRECTIONS = 40
"""Number of Newton steps onto the constraints: half of them for positions, half for velocities."""

ON_CONSTRAINTS = 1e-10
"""Largest violation of constraints by a state with entries of order one."""


@dataclass(frozen=True, eq=False)
class MotionRates:
    """Random states of a model, (n, K), at times (K,), all with the same random parameters (k,)."""

    model: Model
    t: FloatArray
    y: FloatArray
    parameters: FloatArray

    @property
    def q(self) -> FloatArray:
        """The coordinates, (n, K)."""
        return self.y[self.model.layout.q]

    @property
    def v(self) -> FloatArray:
        """The velocities, (n, K)."""
        return self.y[self.model.layout.v]

    @cached_property
    def momenta(self) -> FloatArray:
        """The momenta dL/dv, (n, K)."""
        return self._values("momenta")

    @cached_property
    def forces(self) -> FloatArray:
        """Right-hand sides of the momentum equations without constraint forces, dL/dq + Q - dD/dv, (n, K)."""
        return self._values("forces")

    @cached_property
    def power(self) -> FloatArray:
        """The rate of the energy without constraint forces, -dL/dt + (Q - dD/dv) . v, (K,)."""
        decisions = self.model.equations.structure.decisions
        if decisions.powerless is True:
            return np.zeros(len(self.t))
        applied = self.model.function("applied_forces", tuple(decisions.laws.extra))
        with np.errstate(all="ignore"):
            work: FloatArray = np.sum(applied(self.t, self.y, self.parameters) * self.v, axis=0)
            if decisions.timeless is True:
                return work
            lagrangian = self.model.interpreted("lagrangian")
            ahead, behind = (lagrangian(self.t + way * STEP, self.y, self.parameters) for way in (1, -1))
        return work - (ahead - behind) / (2 * STEP)

    @cached_property
    def gradient(self) -> FloatArray:
        """The gradient G of the constraints, (m, n, K)."""
        return self._values("constraint_gradient")

    def _values(self, name: str) -> FloatArray:
        with np.errstate(all="ignore"):
            return self.model.interpreted(name)(self.t, self.y, self.parameters)


def random_rates(model: Model, count: int, seed: int, *, moving: bool = True) -> MotionRates:
    """Return `count` random states that satisfy the constraints; fewer if the projection fails for some.

    If `moving` is true, the states also satisfy equations of motion without accelerations.
    """
    draw = np.random.default_rng(seed)
    statement, n = model.statement, model.dimension
    usual = np.array([statement.defaults.get(p, 1.0) or 1.0 for p in statement.parameters])
    parameters = usual / np.abs(usual) * draw.uniform(0.5, 1.6, len(usual))
    signs = draw.choice((-1.0, 1.0), (2 * n, count))
    y = draw.uniform(0.3, 1.4, (2 * n, count)) * signs
    y[:, ::3] = np.array(statement.initial)[:, None] + 0.2 * y[:, ::3]
    y[:n, 1::3] = np.abs(y[:n, 1::3])
    y[n:, 1::3] *= 0.2
    t = draw.uniform(0.2, 1.7, count)
    if moving and model.equations.first_order:
        states = [_completed(model, float(t[k]), y[:, k], parameters) for k in range(count)]
        kept = [k for k, state in enumerate(states) if state is not None]
        y, t = np.array([state for state in states if state is not None]).reshape(-1, 2 * n).T, t[kept]
    elif statement.constraints:
        y, t = _projected(model, t, y, parameters)
    return MotionRates(model, t, y, parameters)


def _completed(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray | None:
    """Return the state (2n,) with velocities that satisfy first-order equations of motion, or None if that fails."""
    try:
        return consistent_state(model, t, y, parameters)
    except (RunError, StatementError):
        return None


def _projected(model: Model, t: FloatArray, y: FloatArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return states moved onto the constraints by Newton's method, and their times; failed states are omitted."""
    n, m, y = model.dimension, len(model.statement.constraints), y.copy()
    constraints, gradient = (model.interpreted(name) for name in ("constraints", "constraint_gradient"))
    with np.errstate(all="ignore"):
        for step in range(CORRECTIONS):
            violations = constraints(t, y, parameters)
            rows = np.nan_to_num(np.moveaxis(gradient(t, y, parameters), -1, 0))
            # Positions first, since the velocity constraints depend on them.
            part = slice(0, m) if step < CORRECTIONS // 2 else slice(m, 2 * m)
            change = np.linalg.pinv(rows) @ np.nan_to_num(violations[part].T[:, :, None])
            y[:n] -= change[:, :, 0].T if part.start == 0 else 0.0
            y[n:] -= change[:, :, 0].T if part.start else 0.0
        kept = np.abs(constraints(t, y, parameters)).max(axis=0) < ON_CONSTRAINTS
    return y[:, kept], t[kept]


RATE_STATES = 6
"""Number of random states at which a rate is tested."""

LARGEST_RATE = 1e-8
"""Largest rate that counts as zero, relative to its terms. Accelerations in doubles are accurate to about 1e-12."""


REST = 1e-4
"""Terms of a rate below this fraction of the largest terms of all quantities are treated as rounding."""


@dataclass(frozen=True, eq=False)
class QuantityRates:
    """The rate of a quantity at K states of a model: `values` (K,), and `sizes` (K,), the magnitudes of its terms."""

    rates: MotionRates
    values: FloatArray
    sizes: FloatArray

    @property
    def finite(self) -> Any:
        """True at states where the rate and its size are finite, (K,)."""
        return np.isfinite(self.values) & np.isfinite(self.sizes)

    @property
    def worst(self) -> int | None:
        """Index of the state with the largest significant rate, or None if the rate is zero at all states."""
        share = np.where(self.finite, np.abs(self.values) - LARGEST_RATE * self.sizes, -1.0)
        worst = int(np.argmax(share)) if len(share) else 0
        return worst if len(share) and share[worst] > 0 else None

    def described(self, worst: int) -> str:
        """Return the text of the state with index `worst`, its time and its parameters."""
        statement, rates = self.rates.model.statement, self.rates
        state = statement.state_names
        pairs = [*zip(state, rates.y[:, worst], strict=True), ("t", rates.t[worst])]
        pairs += zip((p.name for p in statement.parameters), rates.parameters, strict=True)
        return ", ".join(f"{name} = {value:.4g}" for name, value in pairs)


def quantity_rates(model: Model, expressions: Sequence[Any], seed: int = 17) -> list[QuantityRates]:
    """Return the rates of expressions in q, v and t along the compiled motion, at random states."""
    rates = random_rates(model, RATE_STATES, seed)
    terms = [_terms(model, expression) for expression in expressions]
    if not any(terms):
        return [QuantityRates(rates, np.zeros(len(rates.t)), np.zeros(len(rates.t))) for _ in terms]
    nodes = tuple(model.equations.translate(term) for parts in terms for term in parts)
    with np.errstate(all="ignore"):
        values = model.function("rates", nodes)(rates.t, rates.y, rates.parameters)
    quantities, done = [], 0
    for parts in terms:
        block = values[done : done + len(parts)]
        quantities.append(QuantityRates(rates, block.sum(axis=0), np.abs(block).sum(axis=0)))
        done += len(parts)
    # If all terms of a rate are rounding, the terms of the other quantities give the scale of that rounding.
    largest = REST * np.max([quantity.sizes for quantity in quantities], axis=0)
    return [QuantityRates(rates, quantity.values, np.maximum(quantity.sizes, largest)) for quantity in quantities]


def _terms(model: Model, expression: Any) -> list[Any]:
    """Return the terms of the time derivative of an expression: partial derivatives times the rates of the symbols."""
    statement = model.statement
    plain = {**statement.plain, t: sympy.Dummy("t", real=True)}
    back = {symbol: leaf for leaf, symbol in plain.items()}
    given = differentiable(expression.xreplace(plain))
    parts = [(plain[t], sympy.S.One)]
    for q, v in zip(statement.coordinates, statement.velocities, strict=True):
        parts += [(plain[q], velocity_of(q)), (plain[v], acceleration_of(q))]
    slopes = [(given.diff(symbol), rate) for symbol, rate in parts]
    return [printable(slope).xreplace(back) * rate for slope, rate in slopes if slope != 0]


def check_constant(model: Model, quantities: Mapping[str, Any]) -> None:
    """Raise RunError if a quantity that is proven to be constant changes along the compiled motion."""
    for name, rates in zip(quantities, quantity_rates(model, list(quantities.values())), strict=True):
        worst = rates.worst
        if worst is not None:
            raise RunError(
                f"{name} of {model.statement.name} is proven to be conserved, but changes at the rate "
                f"{rates.values[worst]:.6g} at {rates.described(worst)}. {FAULT}"
            )
