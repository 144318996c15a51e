"""The order of elimination of sparse systems, and which entries their factors have."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.equations.solve_plan import elimination_order
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


def shuffled_ladder(loops: int, seed: int) -> tuple[list[list[int]], frozenset[int]]:
    """Return the neighbours in the system of a ladder of point masses, in a random order, and its multipliers."""
    count = 4 * loops + 3
    name = np.random.default_rng(seed).permutation(count).tolist()
    neighbours: list[list[int]] = [[] for _ in range(count)]

    def couple(a: int, b: int) -> None:
        neighbours[name[a]].append(name[b])
        if a != b:
            neighbours[name[b]].append(name[a])

    coordinates = range(2 * loops + 2)
    for a in coordinates:
        couple(a, a)
        couple(2 * loops + 2 + a // 2, a)
    for i in range(loops):
        for a in range(2 * i, 2 * i + 4):
            couple(3 * loops + 3 + i, a)
    return neighbours, frozenset(name[2 * loops + 2 :])


def test_the_order_of_the_statement_does_not_matter() -> None:
    """Operations, the band and the longest chain of operations agree between orders, up to ties."""
    for loops in (10, 40):
        operations, heights = [], []
        for seed in range(6):
            neighbours, multipliers = shuffled_ladder(loops, seed)
            order = elimination_order(range(len(neighbours)), neighbours, multipliers)
            at = {unknown: place for place, unknown in enumerate(order)}
            there = frozenset((max(at[i], at[j]), min(at[i], at[j])) for i, row in enumerate(neighbours) for j in row)
            plan = elimination(len(order), there, tuple(sorted(at[i] for i in multipliers)))
            height = [0] * plan.order
            for i, row in enumerate(plan.rows):
                height[i] = max((height[k] + 1 for k in row), default=0)
            operations.append(plan.operations)
            heights.append(max(height))
            assert plan.band <= 8
        assert max(operations) <= 1.15 * min(operations)
        assert max(operations) <= 36 * loops and max(heights) <= 8 * np.log2(loops)
