"""The derivation of textbook systems, and of random ones, against SymPy's own mechanics."""

from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from sympy.physics.mechanics import LagrangesMethod

from lagrange.equations.derivation import Derivation, derive
from lagrange.statement.coordinate import coordinate, t, velocity_of
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement
from lagrange.system import System
from tests.covering import Share
from tests.textbook.systems import CASES, case, points, value

TOLERANCE = mpmath.mpf(10) ** -30


@pytest.fixture(autouse=True)
def digits() -> Iterator[None]:
    with mpmath.workdps(40):
        yield


@cache
def derived(name: str) -> Derivation:
    return derive(case(name))


def close(result: Any, expected: Any, scale: Any = 1) -> bool:
    return bool(abs(result - expected) <= TOLERANCE * (abs(expected) + scale))


def by_sympy(statement: Statement) -> Callable[..., tuple[Any, Any]]:
    """Return a function (q, v, t) -> mass matrix and accelerations, as SymPy's LagrangesMethod derives them."""
    n, real = len(statement.coordinates), dict(statement.plain)
    method = LagrangesMethod(statement.lagrangian, list(statement.coordinates))
    method.form_lagranges_equations()
    back = {symbol: expression for expression, symbol in real.items()}
    drag = [
        sympy.diff(statement.dissipation.xreplace(real), real[velocity]).xreplace(back)
        for velocity in statement.velocities
    ]

    def at(q: Any, v: Any, time: Any) -> tuple[Any, Any]:
        mass, right = mpmath.matrix(n, n), mpmath.matrix(n, 1)
        for i, j in np.ndindex(n, n):
            mass[i, j] = value(method.mass_matrix[i, j], statement, q, v, time)
        for i in range(n):
            parts = (method.forcing[i], statement.forces[i] - drag[i])
            right[i] = sum(value(part, statement, q, v, time) for part in parts)
        return mass, mpmath.lu_solve(mass, right)

    return at


@pytest.mark.few(1)
@pytest.mark.parametrize("name", CASES)
def test_derivation_agrees_with_lagranges_method(name: str) -> None:
    statement, derivation = case(name), derived(name)
    n = len(statement.coordinates)
    expected_at = by_sympy(statement)
    for q, v, time in points(name, count=2):
        mass, expected = expected_at(q, v, time)
        for i, j in np.ndindex(n, n):
            assert close(value(derivation.mass_matrix[i, j], statement, q, v, time), mass[i, j]), (i, j)
        for i, axis in enumerate(statement.coordinates):
            result = value(derivation.accelerations[axis], statement, q, v, time)
            assert close(result, expected[i], 1 + max(abs(x) for x in expected)), axis


@pytest.mark.few(2)
@pytest.mark.parametrize("name", CASES)
def test_lagrangian_momenta_and_energy_keep_their_meaning(name: str) -> None:
    statement, derivation = case(name), derived(name)
    momenta = [sympy.diff(statement.lagrangian, velocity) for velocity in statement.velocities]
    energy = sum(p * v for p, v in zip(momenta, statement.velocities, strict=True)) - statement.lagrangian
    for q, v, time in points(name):
        assert close(
            value(derivation.lagrangian, statement, q, v, time), value(statement.lagrangian, statement, q, v, time)
        )
        assert close(value(derivation.energy, statement, q, v, time), value(energy, statement, q, v, time))
        for axis, p in zip(statement.coordinates, momenta, strict=True):
            assert close(value(derivation.momenta[axis], statement, q, v, time), value(p, statement, q, v, time))


# --- random ---------------------------------------------------------------------------------------------------
# Random polynomial-trigonometric Lagrangians, derived and compiled, against SymPy's LagrangesMethod.

Draw = Callable[[st.SearchStrategy[Any]], Any]
TARGETS = ("numpy", "llvm")
SMALL = st.integers(-3, 3)


def terms(draw: Draw, qs: list[Any], most: int) -> Any:
    """Draw a sum of products of powers, sines and cosines of the coordinates and of time."""
    total = sympy.Integer(draw(SMALL))
    for _ in range(draw(st.integers(0, most))):
        term = sympy.Rational(draw(SMALL), draw(st.integers(1, 3)))
        for _ in range(draw(st.integers(1, 2))):
            argument = draw(st.sampled_from([*qs, qs[0] - qs[-1] / 2, qs[0] + qs[-1], t]))
            kind = draw(st.sampled_from(["power", "sin", "cos"]))
            term *= argument ** draw(st.integers(1, 3)) if kind == "power" else getattr(sympy, kind)(argument)
        total += term
    return total


@st.composite
def statements(draw: Draw, n: int) -> Statement:
    """Draw L = |W(q, t) v|^2 / 2 + |v|^2 / 2 + b(q, t) . v - V(q, t), whose mass matrix is positive definite."""
    qs = [coordinate(f"q{i}") for i in range(n)]
    vs = [velocity_of(q) for q in qs]
    rows = [sum(terms(draw, qs, 1) * v for v in vs) for _ in range(draw(st.integers(1, 2)))]
    quadratic = sum(row**2 for row in rows) / 2 + sum(v**2 for v in vs) / 2
    return declare(lagrangian=quadratic + sum(terms(draw, qs, 1) * v for v in vs) - terms(draw, qs, 3), coordinates=qs)


def compare(statement: Statement, numbers: list[Fraction]) -> None:
    n = len(statement.coordinates)
    point = [mpmath.mpf(x.numerator) / x.denominator for x in numbers]
    q, v, time = point[:n], point[n : 2 * n], point[-1]
    derivation = derive(statement)
    _, expected = by_sympy(statement)(q, v, time)
    scale = 1 + max(abs(x) for x in expected)
    for i, q_i in enumerate(statement.coordinates):
        assert (
            abs(value(derivation.accelerations[q_i], statement, q, v, time) - expected[i])
            < mpmath.mpf(10) ** -25 * scale
        )
    position, velocity = (np.array([float(x) for x in part]) for part in (q, v))
    for target in TARGETS:
        model = System.from_statement(statement).compile(target, check=False)
        result = model.accelerations(position, velocity, float(time))
        assert np.abs(result - [float(x) for x in expected]).max() <= 1e-12 * float(scale), target


def numbers(count: int) -> st.SearchStrategy[list[Fraction]]:
    return st.lists(st.fractions(-2, 2, max_denominator=64), min_size=count, max_size=count)


@pytest.mark.parametrize(
    ("n", "examples"), [(1, 15), *(pytest.param(*row, marks=pytest.mark.slow) for row in ((2, 10), (3, 5)))]
)
def test_random_lagrangians_agree_with_lagranges_method(n: int, examples: int, share: Share) -> None:
    # An example costs a tenth of a second and more: shrinking one would take minutes.
    @settings(max_examples=share(examples), phases=[Phase.explicit, Phase.reuse, Phase.generate])
    @given(statements(n), numbers(2 * n + 1))
    def agree(statement: Statement, point: list[Fraction]) -> None:
        with mpmath.workdps(50):
            compare(statement, point)

    agree()
