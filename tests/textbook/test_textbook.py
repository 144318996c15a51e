"""The derivation against formulas from books, and against SymPy's own mechanics."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import mpmath
import pytest
import sympy
from sympy.physics.mechanics import LagrangesMethod

from lagrange.equations.derivation import Derivation, derive
from lagrange.statement.coordinate import t
from tests.textbook.systems import CASES, NAMES, Case, value

TOLERANCE = mpmath.mpf(10) ** -30
BOOKS = [case for case in CASES if case.book]


@pytest.fixture(autouse=True)
def digits() -> Iterator[None]:
    with mpmath.workdps(40):
        yield


@cache
def derived(case: Case) -> Derivation:
    return derive(case.statement())


def close(found: Any, expected: Any, scale: Any = 1) -> bool:
    return bool(abs(found - expected) <= TOLERANCE * (abs(expected) + scale))


@pytest.mark.parametrize("case", BOOKS, ids=[case.name for case in BOOKS])
def test_accelerations_are_those_of_the_book(case: Case) -> None:
    statement = case.statement()
    derivation = derived(case)
    assert case.book
    assert set(case.book) == set(statement.coordinates)
    for q, v, time in case.points():
        for coordinate, formula in case.book.items():
            assert close(
                value(derivation.accelerations[coordinate], statement, q, v, time),
                value(formula, statement, q, v, time),
            ), coordinate


@pytest.mark.few
@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_derivation_agrees_with_lagranges_method(case: Case) -> None:
    statement = case.statement()
    derivation = derived(case)
    n = len(statement.coordinates)
    method = LagrangesMethod(statement.lagrangian, list(statement.coordinates))
    method.form_lagranges_equations()
    real = dict(statement.plain)
    back = {symbol: expression for expression, symbol in real.items()}
    drag = [
        sympy.diff(statement.dissipation.xreplace(real), real[velocity]).xreplace(back)
        for velocity in statement.velocities
    ]
    for q, v, time in case.points(count=2):
        mass = mpmath.matrix(n, n)
        right = mpmath.matrix(n, 1)
        for i in range(n):
            for j in range(n):
                mass[i, j] = value(method.mass_matrix[i, j], statement, q, v, time)
                assert close(value(derivation.mass_matrix[i, j], statement, q, v, time), mass[i, j]), (i, j)
            right[i] = value(method.forcing[i], statement, q, v, time) + value(
                statement.forces[i] - drag[i], statement, q, v, time
            )
        expected = mpmath.lu_solve(mass, right)
        for i, coordinate in enumerate(statement.coordinates):
            found = value(derivation.accelerations[coordinate], statement, q, v, time)
            assert close(found, expected[i], 1 + max(abs(x) for x in expected)), coordinate


@pytest.mark.few
@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_solved_accelerations_satisfy_the_equations(case: Case) -> None:
    statement = case.statement()
    derivation = derived(case)
    for q, v, time in case.points():
        a = [value(derivation.accelerations[coordinate], statement, q, v, time) for coordinate in statement.coordinates]
        for equation in derivation.equations:
            left = value(equation.lhs, statement, q, v, time, a)
            assert close(left, value(equation.rhs, statement, q, v, time), 100)


@pytest.mark.few
@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_lagrangian_momenta_and_energy_keep_their_meaning(case: Case) -> None:
    statement = case.statement()
    derivation = derived(case)
    momenta = [sympy.diff(statement.lagrangian, velocity) for velocity in statement.velocities]
    energy = sum(p * v for p, v in zip(momenta, statement.velocities, strict=True)) - statement.lagrangian
    for q, v, time in case.points():
        assert close(
            value(derivation.lagrangian, statement, q, v, time), value(statement.lagrangian, statement, q, v, time)
        )
        assert close(value(derivation.energy, statement, q, v, time), value(energy, statement, q, v, time))
        for coordinate, p in zip(statement.coordinates, momenta, strict=True):
            assert close(value(derivation.momenta[coordinate], statement, q, v, time), value(p, statement, q, v, time))


def test_at_least_twelve_systems_and_nine_books_are_compared() -> None:
    assert len(CASES) >= 12
    assert len(BOOKS) >= 9
    assert any(t in case.statement().lagrangian.free_symbols for case in CASES)
