"""Forces of contacts obey their laws, and both ways to find them agree."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.algorithm.linear.complementarity import lemke
from lagrange.trajectory.contact import complementarity
from lagrange.trajectory.contact.complementarity import OPEN, SLIDING, STICKING, Friction, solutions


def rows_of(contacts: Sequence[Friction]) -> Iterator[tuple[int, slice]]:
    """Yield for each contact the index of its normal row, and the slice of its friction rows."""
    row = 0
    for contact in contacts:
        yield row, slice(row + 1, row + 1 + contact.components)
        row += 1 + contact.components


def problem(seed: int, plane: bool = False) -> tuple[np.ndarray, np.ndarray, list[Friction]]:
    """Return a random problem of one to three contacts whose directions are independent."""
    random = np.random.default_rng(seed)
    contacts = []
    for _ in range(random.integers(1, 4)):
        components, mu = int(random.choice([0, 2 if plane else 1])), random.uniform(0.05, 0.4)
        way = random.normal(size=components)
        slides = components and random.random() < 0.4
        contacts.append(Friction(components, mu, mu, way / np.linalg.norm(way) if slides else None))
    rows = sum(1 + contact.components for contact in contacts)
    directions = random.normal(size=(rows, rows + 2))
    return directions @ directions.T, random.normal(size=rows), contacts


@pytest.mark.parametrize("plane", [False, True])
def test_forces_push_rates_separate_and_friction_is_in_its_cone(plane: bool) -> None:
    met: set[str] = set()
    for seed in range(150):
        matrix, bias, contacts = problem(seed, plane)
        for result in solutions(matrix, bias, contacts):
            met.update(result.states)
            assert result.rates == pytest.approx(matrix @ result.forces + bias, abs=1e-9)
            for (normal, along), contact, state in zip(rows_of(contacts), contacts, result.states, strict=True):
                push, friction, rate = result.forces[normal], result.forces[along], result.rates[along]
                assert push >= -1e-9 and result.rates[normal] >= -1e-9
                assert push * result.rates[normal] == pytest.approx(0, abs=1e-9)
                assert np.linalg.norm(friction) <= contact.static * push + 1e-9
                if state == SLIDING:
                    way = contact.way if contact.way is not None else rate / np.linalg.norm(rate)
                    assert friction == pytest.approx(-contact.kinetic * push * way, abs=1e-9)
                if state == STICKING:
                    assert rate == pytest.approx(np.zeros(contact.components), abs=1e-9)
    assert met >= {OPEN, SLIDING, STICKING}


@pytest.mark.parametrize("plane", [False, True])
def test_surfaces_that_do_not_slide_yet_have_one_motion(plane: bool) -> None:
    """With independent directions and little friction; turns of many directions at once overshot in a plane."""
    for seed in range(60):
        matrix, bias, contacts = problem(seed, plane)
        assert len(solutions(matrix, bias, [replace(contact, way=None) for contact in contacts])) == 1


def test_a_slip_that_nearly_stops_in_a_plane_has_a_direction() -> None:
    """Near the edge of the cone a whole turn of the direction overshoots 53 times."""
    matrix, bias = 0.6346490729175164 * np.eye(3), np.array([-13.482417610366966, -1.949435005702, -0.667553147002])
    (result,) = solutions(matrix, bias, [Friction(2, 0.15, 0.15)])
    assert result.states == (SLIDING,)
    assert result.rates[1:] / np.linalg.norm(result.rates[1:]) == pytest.approx(bias[1:] / np.linalg.norm(bias[1:]))


def test_pivoting_finds_what_trying_all_states_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = {}
    for seed in range(100):
        tried[seed] = solutions(*problem(seed))
    monkeypatch.setattr(complementarity, "MOST_CASES", 0)
    for seed, known in tried.items():
        if len(known) == 1:
            (result,) = solutions(*problem(seed))
            assert result.forces == pytest.approx(known[0].forces, abs=1e-8)
            assert result.states == known[0].states


def test_contacts_that_depend_on_each_other_share_their_forces() -> None:
    one = np.array([[1.0, 0.5], [1.0, -0.5], [1.0, 0.0]])
    (result,) = solutions(one @ one.T, np.full(3, -1.0), [Friction()] * 3)
    assert result.forces == pytest.approx(np.full(3, 1 / 3))
    assert result.rates == pytest.approx(np.zeros(3), abs=1e-15)


def test_static_friction_holds_what_kinetic_friction_would_let_slide() -> None:
    """The first contact holds with 0.2 of its normal force; sliding at 0.16 would be a second solution.

    There the other contact, which opens, has no force, or one of a corner that would slide as well.
    """
    apart = np.diag([0.8, 2.4, 0.5, 1.5]), np.array([-0.186, -0.11, 0.0, 0.514])
    (result,) = solutions(*apart, [Friction(1, 0.3, 0.16), Friction(1, 0.1, 0.08)])
    assert result.states == (STICKING, OPEN)
    corners = np.array([[2.94, -1.24, -1.08, -1.24], [-1.24, 1.7, 1.24, 1.7], [-1.08, 1.24, 2.94, 1.24]])
    matrix = np.vstack([corners, [-1.24, 1.7, 1.24, 1.7]])
    (result,) = solutions(matrix, np.array([-4.02, -0.55, 0.0, -0.55]), [Friction(1, 1.2, 0.64)] * 2)
    assert result.states == (STICKING, OPEN)


def test_a_problem_without_a_solution_has_none() -> None:
    """Sliding presses the bodies together more than its friction lets go: A is negative."""
    matrix, bias = np.array([[1.0, 2.0], [2.0, 5.0]]), np.array([-1.0, 0.0])
    assert solutions(matrix, bias, [Friction(1, 0.8, 0.8, np.ones(1))]) == []
    assert pivoted(lemke, np.array([[-1.0]]), np.array([-1.0])) is None


def pivoted(procedure: Callable[..., Any], matrix: np.ndarray, right: np.ndarray) -> np.ndarray | None:
    """Return the solution z (n,) that `lemke`, as plain Python or compiled, finds for M and q; None for no solution."""
    n, solution = len(right), np.empty(len(right))
    memory = np.empty(n * (2 * n + 2)), np.empty(n, dtype=np.int64)
    return solution if procedure(n, matrix.ravel(), right, *memory, solution) else None


def test_lemke_solves_random_problems() -> None:
    """Plain Python and machine code find the same bits, and w z = 0."""
    random, x = np.random.default_rng(3), lg.coordinate("x")
    compiled = lg.System(x.dot**2 / 2).compile().machine.called(lemke.form())
    for _ in range(100):
        n = int(random.integers(1, 8))
        root, right = random.normal(size=(n, n)), random.normal(size=n)
        matrix = root @ root.T + 0.1 * np.eye(n)
        z = pivoted(compiled, matrix, right)
        assert z is not None
        np.testing.assert_array_equal(z, pivoted(lemke, matrix, right))
        w = matrix @ z + right
        assert (z >= -1e-9).all() and (w >= -1e-8).all() and np.abs(z * w).max() < 1e-7
