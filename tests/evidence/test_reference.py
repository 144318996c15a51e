from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mpmath
import pytest
import sympy as sp

from lagrange.evidence import laws
from lagrange.evidence.precise import OutsideDomain
from lagrange.evidence.reference import Reference
from lagrange.evidence.sample import SAMPLE_KINDS, SamplePoint, Sampler
from lagrange.statement.coordinate import coordinate, t
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement
from tests.evidence import statements
from tests.evidence.stand_in import StandIn

x, y = coordinate("x"), coordinate("y")
MP = mpmath.MPContext()
MP.dps = 60


def columns_of(statement: Statement) -> list[int]:
    return list(range(2 * len(statement.coordinates)))


@pytest.mark.few
@pytest.mark.parametrize("make", statements.ALL, ids=lambda make: make.__name__)
def test_every_quantity_agrees_with_symbolic_differentiation(make: Callable[[], Statement]) -> None:
    statement = make()
    reference, symbolic = Reference(statement), StandIn(statement)
    sampler = Sampler(statement, seed=3)
    point = next(p for p in (sampler.point(SAMPLE_KINDS[1], i) for i in range(99)) if inside(reference, p))
    entries = reference.at(point, columns_of(statement))
    n = len(statement.coordinates)
    replace = {**dict(zip(symbolic.q, point.q, strict=True)), **dict(zip(symbolic.v, point.v, strict=True))}
    replace |= {t: point.t, **point.parameters}
    exact = {symbol: sp.Rational(number) for symbol, number in replace.items()}
    for name, part in entries.items():
        wanted = symbolic.expressions[name]
        if name == "jacobian":
            wanted = [wanted[i * 2 * n + j] for j in range(2 * n) for i in range(2 * n)]
        for expression, value, error, size in zip(wanted, part.value, part.error, part.size, strict=True):
            expected = MP.mpf(str(sp.N(expression.xreplace(exact), 60)))
            assert abs(value - expected) <= error + 1e-19 * size, (name, expression)
            assert error <= 1e-19 * size
            assert size <= 1e-10 or abs(value - expected) <= 1e-30 * size, (name, expression)


def inside(reference: Reference, point: SamplePoint) -> bool:
    try:
        reference.inspect(point)
    except OutsideDomain:
        return False
    return True


def test_the_mass_of_a_velocity_that_is_zero_keeps_its_digits() -> None:
    mass = sp.Symbol("m")
    statement = declare(kinetic=mass * (x.dot**2 + y.dot**2) / 2, potential=0, parameters={mass: 1.7})
    point = SamplePoint((0.3, 0.7), (0.9, 0.0), 0.0, {mass: 1.7}, "")
    entries = Reference(statement).at(point, ())["mass_matrix"].value
    assert abs(entries[3] - MP.mpf(1.7)) < 1e-28  # steps of 1e-30 leave 30 of 90 digits


@pytest.mark.parametrize("make", [statements.pendulum, statements.kepler, statements.driven_oscillator])
def test_sizes_are_those_of_the_terms(make: Callable[[], Statement]) -> None:
    """Between the value and a modest multiple of it at a point where nothing cancels badly."""
    statement = make()
    point = Sampler(statement, seed=1).point(SAMPLE_KINDS[1])
    for name, part in Reference(statement).at(point, columns_of(statement)).items():
        largest = max(map(abs, part.value))
        for value, size in zip(part.value, part.size, strict=True):
            assert abs(value) <= size <= 60 * largest, name


def test_cancellation_makes_the_size_larger_than_the_value() -> None:
    statement = declare(kinetic=x.dot**2 / 2, potential=x - sp.sin(x), name="nearly flat")
    point = SamplePoint((1e-5,), (0.3,), 0.0, {}, "")
    force = Reference(statement).at(point, [])["forces"]
    assert abs(force.value[0]) < 1e-10
    assert 0.2 < force.size[0] < 3


def test_terms_that_cancel_in_a_slope_alone_count() -> None:
    """The slope 2 u/(1 + u**2)**2 of u**2/(1 + u**2) is a difference of two terms of 2/u at large u.

    A factor on u**2 or on 1 + u**2 that is the same at all places changes the slope as little as the value.
    """
    statement = declare(kinetic=x.dot**2 / 2, potential=(1000 * x) ** 2 / (1 + (1000 * x) ** 2), name="saturated")
    force = Reference(statement).at(SamplePoint((1.0,), (0.3,), 0.0, {}, ""), [])["forces"]
    assert abs(force.value[0]) < 3e-6
    assert 0.5 < force.size[0] < 10


def test_a_bias_that_cancels_identically_has_the_size_of_its_parts() -> None:
    """A total time derivative in L changes nothing, but costs digits; compiled code may leave some 1e-13."""
    statement = declare(lagrangian=x.dot**2 / 2 + 1000 * sp.cos(x) * x.dot, name="gauge")
    bias = Reference(statement).at(SamplePoint((0.5,), (0.8,), 0.0, {}, ""), [])["bias"]
    assert abs(bias.value[0]) < 1e-30
    assert 50 < bias.size[0] < 2000


def test_a_kink_under_the_stencil_is_no_point_to_use() -> None:
    statement = declare(kinetic=x.dot**2 / 2, potential=sp.Abs(x), name="kink")
    with pytest.raises(OutsideDomain, match="no derivative"):
        Reference(statement).at(SamplePoint((0.0,), (1.0,), 0.0, {}, ""), [0])


def test_numbers_that_doubles_cannot_hold_are_outside() -> None:
    statement = declare(kinetic=x.dot**2 / 2, potential=sp.exp(x**2), name="steep")
    reference = Reference(statement)
    with pytest.raises(OutsideDomain, match="range of double"):
        reference.at(SamplePoint((30.0,), (1.0,), 0.0, {}, ""), [0])
    assert reference.at(SamplePoint((3.0,), (1.0,), 0.0, {}, ""), [0])


def sparse(numbers: Sequence[float]) -> laws.Row:
    return {i: MP.mpf(x) for i, x in enumerate(numbers) if x}


def test_solve_needs_pivoting_and_gets_it() -> None:
    matrix = [sparse(row) for row in ([0, 2, 1], [2, 0, 3], [1, 3, 1])]
    rights = [sparse((1, 2, 3)), sparse((0, 1, 0))]
    for right, solution in zip(rights, laws.solve(matrix, rights, 1e-12), strict=True):
        for i, row in enumerate(matrix):
            assert abs(sum(a * solution[j] for j, a in row.items()) - right.get(i, 0)) < 1e-50


def test_factorization_sizes_bound_the_factors() -> None:
    sizes = laws.factorization_sizes([sparse(row) for row in ([4, -2, 0], [-2, 1.5, 1], [0, 1, 5])])
    # L = [[1], [-1/2, 1], [0, 2, 1]], D = (4, 1/2, 3)
    assert sizes == [{0: 4, 1: 2}, {0: 2, 1: 2.5, 2: 1}, {1: 1, 2: 7}]


def test_sizes_without_a_factorization_fall_back_on_the_rows() -> None:
    assert laws.factorization_sizes([sparse((0, 4)), sparse((4, 0))]) == [{0: 4, 1: 4}, {0: 4, 1: 4}]


def steps(make: Callable[[], Statement], point: SamplePoint) -> Any:
    return Reference(make())._steps(point)


def test_velocities_that_are_rounding_leave_the_inertia_its_digits() -> None:
    """A projection leaves 1e-37 beside 8: a step of 1e-55 would change the energy in none of its 90 digits."""
    statement = declare(kinetic=x.dot**2 / 2 + y.dot**2 / 2, potential=x**2 / 2, initial={x.dot: 8.0, y.dot: 6e-37})
    point = SamplePoint((0.0, 0.0), (8.0, 6e-37), 0.0, {}, "")
    values = Reference(statement).at(point, [])["mass_matrix"].value
    # The energy of 32 is rounded at 1e-90, and the second difference divided by the square of 8e-38.
    assert list(map(float, values)) == pytest.approx([1, 0, 0, 1], rel=1e-13, abs=1e-13)
