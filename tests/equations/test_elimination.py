"""The order of elimination of sparse systems, and which entries their factors have."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagrange.equations.elimination import elimination_order
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.program.elimination import block_eliminations, elimination
from tests.series_systems import ladder, rods


def pattern(rng: np.random.Generator, n: int, m: int) -> np.ndarray:
    """Return which entries of [[M, G^T], [G, 0]] there are; every constraint has one."""
    mass = rng.random((n, n)) < 1.5 / n
    border = rng.random((m, n)) < 2 / n
    border[np.arange(m), rng.integers(0, n, m)] = True
    return np.block([[mass | mass.T | np.eye(n, dtype=bool), border.T], [border, np.zeros((m, m), dtype=bool)]])


@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(0, 6))
def test_a_multiplier_waits_for_its_coordinates(seed: int, n: int, m: int) -> None:
    there = pattern(np.random.default_rng(seed), n, m)
    neighbours = [np.flatnonzero(row).tolist() for row in there]
    order = elimination_order(range(n + m), neighbours, range(n, n + m))
    assert sorted(order) == list(range(n + m))
    at = {unknown: place for place, unknown in enumerate(order)}
    assert all(at[j] < at[i] for i in range(n, n + m) for j in neighbours[i])


@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(0, 6))
def test_the_places_of_the_factors_are_those_that_fill_in(seed: int, n: int, m: int) -> None:
    """L of random numbers has an entry, other than by cancellation, at these places and nowhere else."""
    rng = np.random.default_rng(seed)
    there = pattern(rng, n, m)
    a = np.where(there, rng.uniform(0.5, 1.5, there.shape), 0.0)
    a = a + a.T + np.diag([*np.full(n, 4.0 * (n + m)), *np.full(m, -4.0 * (n + m))])
    lower = np.zeros_like(a)
    for j in range(n + m):
        lower[j:, j] = a[j:, j] / a[j, j]
        a[j:, j:] -= np.outer(lower[j:, j], a[j, j:].copy())
    entries = frozenset((i, j) for i, j in zip(*np.nonzero(np.tril(there | np.eye(n + m, dtype=bool))), strict=True))
    plan = elimination(n + m, frozenset((int(i), int(j)) for i, j in entries))
    assert set(plan.places) == {(int(i), int(j)) for i, j in zip(*np.nonzero(lower), strict=True)}
    assert sorted((i, j) for j, column in enumerate(plan.columns) for i in column) == [
        (i, j) for i, j in plan.places if i != j
    ]


@pytest.mark.parametrize("system", [rods, ladder])
def test_factors_of_a_chain_grow_with_its_length_alone(system: type) -> None:
    """Ten more bodies add as many entries and operations as the ten before them."""

    def sizes(n: int) -> tuple[int, int]:
        (plan,) = block_eliminations(euler_lagrange(system(n)).plan)
        return len(plan.places), plan.operations

    (a, p), (b, q), (c, r) = (sizes(n) for n in (10, 20, 30))
    assert c - b == pytest.approx(b - a, rel=0.05) and r - q == pytest.approx(q - p, rel=0.05)
