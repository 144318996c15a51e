"""The rate of a quantity along the compiled motion, by number: what is constant does not change, at any state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from lagrange.equations.terms import differentiable, printable
from lagrange.errors import FAULT, RunError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.mechanics.motion_rates import MotionRates, random_rates
from lagrange.statement.coordinate import acceleration_of, t, velocity_of

STATES = 6
"""Random states at which a rate is tested, fewer where it has no value at some."""

LARGEST_RATE = 1e-8
"""Relative to the largest part of the rate. The accelerations are those of doubles, good to 1e-12 as a rule."""


REST = 1e-4
"""Parts of a rate below this share of the largest of all quantities are known to fewer digits."""


@dataclass(frozen=True, eq=False)
class QuantityRates:
    """The rate of a quantity at states of a model, (K,), and the size of what it is formed from."""

    rates: MotionRates
    values: FloatArray
    sizes: FloatArray

    @property
    def finite(self) -> Any:
        """The states at which both have a value."""
        return np.isfinite(self.values) & np.isfinite(self.sizes)

    @property
    def worst(self) -> int | None:
        """The state at which it changes most; None where it changes at none."""
        share = np.where(self.finite, np.abs(self.values) - LARGEST_RATE * self.sizes, -1.0)
        worst = int(np.argmax(share)) if len(share) else 0
        return worst if len(share) and share[worst] > 0 else None

    def described(self, worst: int) -> str:
        """Return a state and its parameters as a user writes them."""
        statement, rates = self.rates.model.statement, self.rates
        state = statement.state_names
        pairs = [*zip(state, rates.y[:, worst], strict=True), ("t", rates.t[worst])]
        pairs += zip((p.name for p in statement.parameters), rates.parameters, strict=True)
        return ", ".join(f"{name} = {value:.4g}" for name, value in pairs)


def quantity_rates(model: Model, expressions: Sequence[Any], seed: int = 17) -> list[QuantityRates]:
    """Return the rates of expressions in q, v and t along the compiled motion, at random states."""
    rates = random_rates(model, STATES, seed)
    terms = [_terms(model, expression) for expression in expressions]
    if not any(terms):
        return [QuantityRates(rates, np.zeros(len(rates.t)), np.zeros(len(rates.t))) for _ in terms]
    nodes = tuple(model.equations.translate(term) for parts in terms for term in parts)
    with np.errstate(all="ignore"):
        values = model.function("rates", nodes)(rates.t, rates.y, rates.parameters)
    found, done = [], 0
    for parts in terms:
        moved = values[done : done + len(parts)]
        found.append(QuantityRates(rates, moved.sum(axis=0), np.abs(moved).sum(axis=0)))
        done += len(parts)
    # Where all parts of one rate are rounding, what the other quantities are formed from tells how large that may be.
    largest = REST * np.max([one.sizes for one in found], axis=0)
    return [QuantityRates(one.rates, one.values, np.maximum(one.sizes, largest)) for one in found]


def _terms(model: Model, expression: Any) -> list[Any]:
    """Return the terms of the rate of an expression: each slope times the rate of its symbol."""
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
    """Raise RunError where a quantity that was proven to be constant changes along the compiled motion."""
    for name, found in zip(quantities, quantity_rates(model, list(quantities.values())), strict=True):
        worst = found.worst
        if worst is not None:
            raise RunError(
                f"{name} of {model.statement.name} is proven to be conserved, but changes at the rate "
                f"{found.values[worst]:.6g} at {found.described(worst)}. {FAULT}"
            )
