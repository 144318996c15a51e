"""Random mechanisms: three coordinates, random energies, up to two constraints, and a state that satisfies them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, Phase, assume, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from sympy import cos, sin

from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.statement.coordinate import coordinates, t
from lagrange.statement.declare import declare
from tests.covering import examples

Vector = NDArray[np.float64]

PLACES = coordinates("x y z")
RATES = tuple(q.dot for q in PLACES)
x, y, z = PLACES

rationals = st.integers(-8, 8).filter(bool).map(lambda i: sp.Rational(i, 4))
"""Numbers that doubles hold exactly, as coefficients of series are doubles."""

seeds = st.integers(0, 2**32 - 1)


def functions_of(*leaves: Any) -> st.SearchStrategy[Any]:
    """Return random polynomial-trigonometric expressions of the leaves, a few terms each."""
    wave = st.builds(lambda c, a, b: sin(c * a + b), rationals, st.sampled_from(leaves), rationals)
    power = st.sampled_from([*leaves, *(leaf**2 for leaf in leaves)])
    term = st.builds(
        lambda c, a, b: c * a * b, rationals, st.one_of(power, wave), st.one_of(wave, st.just(sp.Integer(1)))
    )
    return st.lists(term, min_size=1, max_size=3).map(lambda terms: sp.Add(*terms))


def kinetic_energies(*leaves: Any, rates: Sequence[Any] = RATES) -> st.SearchStrategy[Any]:
    """Return quadratic forms in some velocities, positive everywhere."""
    many = st.tuples(*(functions_of(*leaves) for _ in rates))
    return many.map(lambda g: sum(v**2 for v in rates) / 2 + sum(f * v for f, v in zip(g, rates, strict=True)) ** 2 / 8)


def potentials(*leaves: Any) -> st.SearchStrategy[Any]:
    """Return potentials that keep the system near the origin."""
    return functions_of(*leaves).map(lambda f: f / 4 + sum(leaf**2 + leaf**4 for leaf in leaves))


some = settings(
    max_examples=examples(12),
    phases=(Phase.explicit, Phase.reuse, Phase.generate),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
)
"""A smaller mechanism that fails as well is no easier to read, and each costs a second to compile."""


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A system in x, y and z, its constraints by name, and a state (q, v) that satisfies them at a time."""

    energies: Mapping[str, Any]
    constraints: Mapping[str, Any]
    q: Vector
    v: Vector
    time: float = 0.3

    @property
    def state(self) -> Vector:
        """The state (q, v)."""
        return np.concatenate([self.q, self.v])

    def compile(self, target: str = "numpy", **changed: Any) -> Model:
        """Return the compiled model, with some parts of the statement replaced."""
        stated = {"coordinates": list(PLACES), "constraints": self.constraints, **self.energies}
        return model_of(declare(**stated | changed), machine(target))

    @cached_property
    def model(self) -> Model:
        """The compiled model."""
        return self.compile()

    def at(self, expression: Any) -> float:
        """Return the value of an expression at the state, by SymPy."""
        result = sp.sympify(expression)
        for leaves, values in ((RATES, self.v), (PLACES, self.q), ((t,), (self.time,))):  # t stands inside x(t)
            result = result.xreplace(dict(zip(leaves, map(sp.Float, values), strict=True)))
        return float(result)

    @cached_property
    def gradient(self) -> Vector:
        """The rows of G, by SymPy."""
        rows = [[self.at(item) for item in row] for row in map(gradient_of, self.constraints.values())]
        return np.array(rows).reshape(-1, len(PLACES))

    def accelerations(self, model: Model | None = None) -> Vector:
        """Return the accelerations of this or another model at the state."""
        result: Vector = (model or self.model).accelerations(self.q, self.v, self.time)
        return result

    def multipliers(self, model: Model | None = None) -> Vector:
        """Return the multipliers of this or another model at the state, none without constraints."""
        return multipliers(model or self.model, self.q, self.v, self.time)


def multipliers(model: Model, q: Vector, v: Vector, time: float) -> Vector:
    """Return the multipliers of a model, an empty array without constraints."""
    return model.multipliers(q, v, time) if model.statement.constraints else np.zeros(0)


def has_velocities(constraint: Any) -> bool:
    """Return True if a constraint contains velocities."""
    return bool(constraint.atoms(sp.Derivative))


@cache
def gradient_of(constraint: Any) -> tuple[Any, ...]:
    """Return the coefficients of the velocities in a constraint, or in its rate of change."""
    return tuple(sp.diff(rate_of(constraint), v) for v in RATES)


@cache
def rate_of(constraint: Any) -> Any:
    """Return the expression in velocities that a constraint keeps at zero: its rate, or the constraint itself."""
    return constraint if has_velocities(constraint) else sp.diff(constraint, t).doit()


def holonomic(*leaves: Any) -> st.SearchStrategy[Any]:
    """Return functions of the coordinates whose gradient is rarely zero."""
    linear = st.tuples(rationals, rationals, rationals)
    return st.builds(
        lambda c, f: sum(a * q for a, q in zip(c, PLACES, strict=True)) + f / 4, linear, functions_of(*leaves)
    )


def rolling(*leaves: Any) -> st.SearchStrategy[Any]:
    """Return expressions that are linear in the velocities and almost never integrable."""
    many = st.tuples(*(st.tuples(rationals, functions_of(*leaves)) for _ in PLACES))
    return many.map(lambda rows: sum((c + f / 4) * v for (c, f), v in zip(rows, RATES, strict=True)))


def kinds(leaves: tuple[Any, ...], least: int = 0) -> st.SearchStrategy[list[Any]]:
    """Return `least` to two constraints, each on coordinates or on velocities."""
    return st.lists(st.one_of(holonomic(*leaves), rolling(*leaves)), min_size=least, max_size=2)


def put(energies: Mapping[str, Any], constraints: list[Any], seed: int, time: float = 0.3) -> Mechanism:
    """Return a mechanism at a random state. Its constraints are shifted, and the velocities projected, to hold there.

    Samples with nearly dependent constraints are rejected, because they amplify round-off.
    """
    random = np.random.default_rng(seed)
    q, v = random.uniform(-0.9, 0.9, 3), random.uniform(-0.9, 0.9, 3)
    there = Mechanism(energies, {}, q, v, time)
    names = [f"c{i}" for i in range(len(constraints))]
    shifted = [item if has_velocities(item) else item - there.at(item) for item in constraints]
    held = Mechanism(energies, dict(zip(names, shifted, strict=True)), q, v, time)
    G = held.gradient
    assume(np.linalg.svd(G, compute_uv=False).min(initial=1.0) > 0.3)
    off = np.array([held.at(rate_of(item)) for item in shifted])
    return Mechanism(energies, held.constraints, q, v - np.linalg.pinv(G) @ off, time)


def mechanisms(
    constraints: st.SearchStrategy[list[Any]] | None = None, forces: bool = False
) -> st.SearchStrategy[Mechanism]:
    """Return random mechanisms, with constraints and energies that do not depend on time, and maybe with forces."""
    energies: dict[str, Any] = {"kinetic": kinetic_energies(*PLACES), "potential": potentials(*PLACES)}
    if forces:
        energies["forces"] = st.builds(lambda P, Q: {x: P, z: Q}, functions_of(x, y, *RATES), functions_of(z, x.dot))
    return st.builds(put, st.fixed_dictionaries(energies), kinds(PLACES) if constraints is None else constraints, seeds)


def moving() -> st.SearchStrategy[Mechanism]:
    """Return random mechanisms whose constraints depend on time."""

    def swung(constraints: list[Any], f: Any, w: Any) -> list[Any]:
        return [item + f * cos(w * t) / 4 for item in constraints]

    energies = st.fixed_dictionaries({"kinetic": kinetic_energies(*PLACES), "potential": potentials(*PLACES)})
    return st.builds(put, energies, st.builds(swung, kinds(PLACES), functions_of(*PLACES), rationals), seeds)


def slope(f: Any) -> float:
    """Return f'(0) by differences; the error is about 1e-11 of f."""
    h = 1e-3
    rows = [(f(d) - f(-d)) / (2 * d) for d in (h, h / 2, h / 4)]
    rows = [(4 * second - first) / 3 for first, second in pairwise(rows)]
    return float((16 * rows[1] - rows[0]) / 15)


def close(expected: Any, tolerance: float = 1e-9) -> Any:
    """Return an object that equals arrays up to a tolerance, relative to the largest entry or 1."""
    whole = np.asarray(expected, dtype=float)
    return pytest.approx(whole, rel=0, abs=tolerance * max(1.0, float(np.abs(whole).max(initial=0.0))))
