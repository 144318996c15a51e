"""Compiled models against the textbook derivation, whose accelerations are evaluated in 40 digits."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from lagrange.equations.derivation import derive
from lagrange.system import System
from tests.textbook.systems import CASES, NAMES, Case, chain_of_masses, value

TOLERANCE = 1e-12
TARGETS = ("numpy", "llvm")
ALL = (*CASES, chain_of_masses(5))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("case", ALL, ids=[*NAMES, "chain"])
def test_compiled_model_agrees_with_the_derivation(case: Case, target: str) -> None:
    statement = case.statement()
    derivation = derive(statement)
    model = System.from_statement(statement).compile(target)
    n = len(statement.coordinates)
    for q, v, time in case.points():
        with mpmath.workdps(40):
            accelerations = [
                float(value(derivation.accelerations[c], statement, q, v, time)) for c in statement.coordinates
            ]
            momenta = [float(value(derivation.momenta[c], statement, q, v, time)) for c in statement.coordinates]
            mass = [
                [float(value(derivation.mass_matrix[i, j], statement, q, v, time)) for j in range(n)] for i in range(n)
            ]
            energy = float(value(derivation.energy, statement, q, v, time))
        scale = 1 + np.abs(accelerations).max()
        np.testing.assert_allclose(
            model.accelerations(q, v, time), accelerations, rtol=TOLERANCE, atol=TOLERANCE * scale
        )
        np.testing.assert_allclose(model.momenta(q, v, time), momenta, rtol=TOLERANCE, atol=TOLERANCE)
        np.testing.assert_allclose(model.energy(q, v, time), energy, rtol=TOLERANCE, atol=TOLERANCE * 100)
        np.testing.assert_allclose(model.mass_matrix(q, time, v=v), mass, rtol=TOLERANCE, atol=TOLERANCE)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("case", ALL, ids=[*NAMES, "chain"])
def test_batches_are_their_members_side_by_side(case: Case, target: str) -> None:
    model = System.from_statement(case.statement()).compile(target)
    points = case.points(count=5)
    q, v = (np.array([point[part] for point in points]).T for part in (0, 1))
    times = np.array([point[2] for point in points])
    batch = model.accelerations(q, v, times)
    single = np.array([model.accelerations(*point) for point in points]).T
    np.testing.assert_allclose(batch, single, rtol=TOLERANCE, atol=TOLERANCE * (1 + np.abs(single).max()))
