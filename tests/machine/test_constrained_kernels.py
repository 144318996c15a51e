"""Kernels of systems with constraints against dense linear algebra, on every machine, with and without pivoting."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.algorithm.series.packing import pack
from lagrange.compiler import machine, model_of
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.errors import RunError
from lagrange.machine.llvm import procedures
from lagrange.machine.model import Model
from lagrange.machine.series.interpreted_driver import NumpySeries
from lagrange.machine.series.llvm_driver import CompiledJet
from lagrange.program.taylor import series_program
from lagrange.statement.statement import Statement
from tests.models import m, stated
from tests.series_systems import HELD, ladder, rods

CASES: dict[str, Callable[[], Statement]] = {**HELD, "12 rods": lambda: rods(12)}
"""24 coordinates and 12 multipliers are written out by LLVM, and interpreted on the numpy target."""


@cache
def model(name: str, target: str) -> Model:
    return model_of(CASES[name](), machine(target))


def motion(model: Model, q: Any, v: Any) -> tuple[Any, Any]:
    """Return the accelerations and multipliers by dense linear algebra, from M, h and the nodes of G and gamma."""
    held = model.equations.constraints
    m, n = len(held), model.dimension
    y = np.concatenate([q, v])
    nodes = (*(entry for row in held.gradient for entry in row), *held.bias)
    found = model.function("rows", nodes)(0.25, y, model.parameter_array())
    gradient, gamma = found[: m * n].reshape(m, n), found[m * n :]
    mass, bias = model.mass_matrix(q, 0.25, v=v), model.evaluate("bias", q, v, 0.25)
    whole = np.block([[mass, -gradient.T], [gradient, np.zeros((m, m))]])
    solution = np.linalg.solve(whole, np.concatenate([bias, -gamma]))
    return solution[:n], solution[n:]


def states(model: Model, count: int) -> tuple[Any, Any]:
    """Return coordinates and velocities near the initial ones, (n, count) each; they need not obey the constraints."""
    rng = np.random.default_rng(5)
    y = np.array(model.statement.initial)[:, None] + rng.uniform(-0.1, 0.1, (model.layout.size, count))
    return y[model.layout.q], y[model.layout.v]


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("name", CASES)
def test_accelerations_and_multipliers_are_those_of_the_whole_system(name: str, target: str) -> None:
    held = model(name, target)
    q, v = states(held, 6)
    many = held.accelerations(q, v, 0.25), held.multipliers(q, v, 0.25)
    for k in range(6):
        a, multipliers = motion(held, q[:, k], v[:, k])
        # Both solve to some hundred rounding errors: the systems are well conditioned.
        for found, expected in ((held.accelerations(q[:, k], v[:, k], 0.25), a), (many[0][:, k], a)):
            assert found == pytest.approx(expected, rel=1e-11, abs=1e-12 * np.abs(a).max())
        for found in (held.multipliers(q[:, k], v[:, k], 0.25), many[1][:, k]):
            assert found == pytest.approx(multipliers, rel=1e-11, abs=1e-12 * np.abs(multipliers).max())


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("name", CASES)
def test_the_jacobian_is_that_of_differences(name: str, target: str) -> None:
    held = model(name, target)
    y = np.concatenate([part[:, 0] for part in states(held, 1)])
    exact, h = held.jacobian(0.25, y), 1e-5
    for j in range(0, len(y), max(1, len(y) // 8)):
        step = h * np.eye(len(y))[j]
        differences = (held.rhs(0.25, y + step) - held.rhs(0.25, y - step)) / (2 * h)
        # Truncation h^2 and rounding 1e-16 / h of central differences.
        assert exact[:, j] == pytest.approx(differences, rel=1e-7, abs=1e-7 * np.abs(exact).max())


@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_near_a_configuration_where_constraints_depend_on_one_another_pivots_are_taken_by_size(target: str) -> None:
    """All bars of a ladder in one line but for 1e-4: elimination in the given order would lose eight digits."""
    held = model_of(ladder(3), machine(target))
    angle = np.pi / 2 - 1e-4
    q = np.ravel([(i + np.sin(angle), np.cos(angle)) for i in range(4)])
    v = np.ravel([(np.cos(angle), -np.sin(angle)) for _ in range(4)])
    found, (expected, _) = held.accelerations(q, v, 0.25), motion(held, q, v)
    assert found == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
    straight = np.ravel([(i + 1.0, 0.0) for i in range(4)])
    with pytest.raises(RunError):
        held.accelerations(straight, np.zeros(8), 0.25)


@pytest.mark.parametrize(("loops", "largest"), [(5, 8), pytest.param(60, 50_000, marks=pytest.mark.slow)])
def test_a_large_system_that_is_singular_takes_its_memory_from_the_heap(
    loops: int, largest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The matrix of 60 loops, 243 unknowns, takes half a megabyte: with its factors too much for a thread's stack."""
    monkeypatch.setattr(procedures, "LARGEST_ON_STACK", largest)
    held = model_of(ladder(loops), machine("llvm"))
    straight = np.ravel([(i + 1.0, 0.0) for i in range(loops + 1)])
    with pytest.raises(RunError):
        held.accelerations(straight, np.zeros(2 * loops + 2), 0.25)
    bent = np.ravel([(i + 0.28, 0.96) for i in range(loops + 1)])
    assert np.isfinite(held.accelerations(bent, np.zeros(2 * loops + 2), 0.25)).all()


@pytest.mark.parametrize("order", [6, 0])
def test_a_dense_system_beyond_what_is_written_out_has_its_inverse(order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lagrange.program.elimination.MOST_OPERATIONS", 0)
    statement = rods(3)
    program = series_program(euler_lagrange(statement))[0]
    given = np.array([statement.defaults[p] for p in statement.parameters])
    expected = NumpySeries(program).rows(6, 0.25, np.array(statement.initial), 0.5, given)
    found = CompiledJet(pack(program, 8), order).rows(6, 0.25, np.array(statement.initial), 0.5, given)
    assert found == pytest.approx(expected, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("light", [1e-6, 1e-9, 1e-12, 1e-15, 1e-17])
def test_a_light_body_tied_to_a_heavy_one_has_its_acceleration(light: float, target: str) -> None:
    """Both have F / (m + M). Pivots in their order would give the light one the difference of two equal forces."""
    a, b = lg.coordinates("a b")
    tied = stated(
        kinetic=m * a.dot**2 / 2 + b.dot**2 / 2, potential=-a, constraints={"tie": a - b}, parameters={m: light}
    )
    held, zero = model_of(tied, machine(target)), np.zeros(2)
    exact = 1 / (1 + light)
    assert held.accelerations(zero, zero) == pytest.approx([exact, exact], rel=1e-11)
    many = held.accelerations(np.zeros((2, 9)), np.zeros((2, 9)))
    assert many == pytest.approx(np.full((2, 9), exact), rel=1e-11)
