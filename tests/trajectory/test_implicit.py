"""Implicit methods against their formulas and their claims."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sympy import exp

from lagrange.statement.coordinate import t
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, build, k, model, x
from tests.trajectory.runs import EQUAL, FIXED, IMPLICIT, MOMENTA, SLOPES, exact, run

# --- formulas, written out again ------------------------------------------------------------------------------

R3, R15 = 3**0.5, 15**0.5
TABLEAUS: dict[str, tuple[Any, Any, Any]] = {
    "backward-euler": ([[1]], [1], [1]),
    "trapezoidal": ([[0, 0], [0.5, 0.5]], [0.5, 0.5], [0, 1]),
    "implicit-midpoint": ([[0.5]], [1], [0.5]),
    "gauss2": ([[1 / 4, 1 / 4 - R3 / 6], [1 / 4 + R3 / 6, 1 / 4]], [0.5, 0.5], [0.5 - R3 / 6, 0.5 + R3 / 6]),
    "gauss3": (
        [
            [5 / 36, 2 / 9 - R15 / 15, 5 / 36 - R15 / 30],
            [5 / 36 + R15 / 24, 2 / 9, 5 / 36 - R15 / 24],
            [5 / 36 + R15 / 30, 2 / 9 + R15 / 15, 5 / 36],
        ],
        [5 / 18, 4 / 9, 5 / 18],
        [0.5 - R15 / 10, 0.5, 0.5 + R15 / 10],
    ),
}


def by_tableau(name: str, f: Callable[..., Any], t: float, y: Any, h: float) -> Any:
    """Return the step with stages found by fixed-point iteration, which has nothing in common with Newton's."""
    A, b, c = (np.array(part, dtype=float) for part in TABLEAUS[name])
    slopes = np.array([f(t, y)] * len(b))
    for _ in range(200):
        slopes = np.array([f(t + ci * h, y + h * row @ slopes) for ci, row in zip(c, A, strict=True)])
    return y + h * b @ slopes


def test_every_method_has_its_formula_or_its_twin() -> None:
    assert {*TABLEAUS, "bdf2"} == set(SLOPES)
    assert {*TWINS, *PAIRS, "discrete-gradient"} == set(MOMENTA)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", TABLEAUS)
def test_steps_follow_the_formula(name: str, target: str) -> None:
    compiled = model("cart and pole", target)
    h = 0.02
    found = run(compiled, 0.3 + 12 * h, name, start=0.3, step=h)
    state = np.array(compiled.statement.initial)
    for i in range(12):
        assert found.y[:, i] == pytest.approx(state, rel=1e-12, abs=1e-14)
        state = by_tableau(name, compiled.rhs, 0.3 + i * h, state, h)
    assert found.y[:, -1] == pytest.approx(state, rel=1e-12)


@pytest.mark.parametrize("target", TARGETS)
def test_bdf2_is_a_parabola_through_three_states(target: str) -> None:
    compiled = model("cart and pole", target)
    h = 0.02
    found = run(compiled, 10.5 * h, "bdf2", step=h)
    assert found.steps == 11
    for i in range(1, 10):
        before, y, new = found.y[:, i - 1 : i + 2].T
        slope = (3 * new - 4 * y + before) / (2 * h)
        assert slope == pytest.approx(compiled.rhs(found.t[i + 1], new), rel=1e-11, abs=1e-12)


TWINS = {
    "variational-midpoint": "implicit-midpoint",
    "variational-trapezoid": "velocity-verlet",
    "galerkin4": "gauss2",
    "galerkin6": "gauss3",
    "rattle": "velocity-verlet",
    "constrained-midpoint": "implicit-midpoint",
}


@pytest.mark.parametrize("system", ["Henon-Heiles", "coupled masses", "saddle"])
@pytest.mark.parametrize("name", TWINS)
def test_with_a_constant_mass_matrix_a_variational_method_is_a_known_one(name: str, system: str) -> None:
    """Marsden and West, 2001, sections 2.6.1 and 2.6.2; Gauss's tableau is its own conjugate (HLW, VI.6.4)."""
    compiled = model(system)
    ours, theirs = (run(compiled, 1.0, each, step=0.05) for each in (name, TWINS[name]))
    assert ours.y == pytest.approx(theirs.y, rel=1e-12, abs=1e-13)


PAIRS: dict[str, tuple[Any, Any, Any]] = {
    "lobatto4": (
        [[0, 0, 0], [5 / 24, 1 / 3, -1 / 24], [1 / 6, 2 / 3, 1 / 6]],
        [[1 / 6, -1 / 6, 0], [1 / 6, 1 / 3, 0], [1 / 6, 5 / 6, 0]],
        [1 / 6, 2 / 3, 1 / 6],
    ),
}
"""Lobatto IIIA and IIIB, as Hairer and Wanner print them, II, tables IV.5.7 and IV.5.8."""


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("system", ["Henon-Heiles", "coupled masses", "saddle"])
@pytest.mark.parametrize("name", PAIRS)
def test_lobattos_pairs_follow_the_formula(name: str, system: str, target: str) -> None:
    compiled, h = model(system, target), 0.05
    A, B, b = map(np.array, PAIRS[name])
    found = run(compiled, 12 * h, name, step=h)
    q, v = np.split(np.array(compiled.statement.initial), 2)
    for i in range(12):
        assert found.y[:, i] == pytest.approx(np.concatenate([q, v]), rel=1e-12, abs=1e-13)
        pushes = np.array([compiled.accelerations(q, v)] * len(b))
        for _ in range(100):
            places = q + h * A @ (v + h * B @ pushes)
            pushes = np.array([compiled.accelerations(place, v) for place in places])
        q, v = q + h * b @ (v + h * B @ pushes), v + h * b @ pushes


# --- claims ---------------------------------------------------------------------------------------------------

COUNTS = {1: (800, 1131, 1600), 2: (200, 283, 400), 4: (40, 57, 80), 6: (16, 22, 30)}


@pytest.mark.parametrize("system", ["cart and pole", "elastic pendulum", "bead on a hoop"])
@pytest.mark.parametrize("name", EQUAL)
def test_the_observed_order_is_the_claimed_one(name: str, system: str) -> None:
    """With forces, dissipation, explicit time and mass matrices that move."""
    compiled, claims, end = model(system), find(name).claims, 1.2
    truth = exact(compiled, end).y[:, -1]
    counts = COUNTS[claims.order]
    errors = [np.abs(run(compiled, end, name, step=end / n).y[:, -1] - truth).max() for n in counts]
    assert min(errors) > 1e-12 and max(errors) < 0.2
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(claims.order, abs=0.15), errors


@pytest.mark.parametrize("system", ["pendulum", "double pendulum", "elastic pendulum", "Henon-Heiles"])
@pytest.mark.parametrize("name", EQUAL)
def test_what_claims_to_conserve_energy_does_and_the_rest_does_not(name: str, system: str) -> None:
    """2000 steps of 0.02, some 40 to a swing: the error must be round-off, and must not be for the others."""
    compiled = model(system)
    found = run(compiled, 40.0, name, step=0.02)
    n = compiled.dimension
    energy = compiled.energy(found.y[:n], found.y[n:])
    scale = np.abs(energy).max() + np.abs(compiled.evaluate("lagrangian", found.y[:n], found.y[n:])).max()
    error = np.abs(energy - energy[0]).max() / scale
    if find(name).claims.energy:
        assert error < 1e-12
    elif find(name).claims.order <= 2:
        assert error > 1e-6


@pytest.mark.few
@pytest.mark.parametrize("name", [name for name in IMPLICIT if find(name).claims.a_stable])
def test_what_claims_to_be_stable_damps_what_is_too_fast_for_its_steps(name: str) -> None:
    """Over-damped and oscillating, a thousand times too fast for the step: nothing grows."""
    for damping in (0.0, 2e4):
        compiled = build(
            kinetic=x.dot**2 / 2,
            potential=k * x**2 / 2,
            dissipation=damping * x.dot**2 / 2,
            parameters={k: 1e8},
            initial={x: 1.0},
        )
        o: Any = {"step": 0.1} if name in FIXED else {"rtol": 1e-3, "atol": 1e-3}
        found = run(compiled, 10.0, name, **o)
        # Without friction what is damped is energy that the motion keeps.
        assert found.status is Status.SUCCESS or (not damping and found.status is Status.UNRELIABLE)
        assert np.abs(found.y[0]).max() < 1 + 1e-9, (damping, np.abs(found.y[0]).max())


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", EQUAL)
def test_the_order_where_masses_grow(name: str, target: str) -> None:
    """Momenta depend on time itself: of L = e^t (x'^2 - x^2) / 2 the motion is x'' + x' + x = 0."""
    compiled = build(target, lagrangian=exp(t) * (x.dot**2 - x**2) / 2, coordinates=[x], initial={x: 1.0})
    w, end = np.sqrt(0.75), 1.5
    expected = np.exp(-end / 2) * (np.cos(w * end) + np.sin(w * end) / (2 * w))
    counts = np.array([6, 9, 13] if find(name).claims.order > 4 else [20, 30, 45])
    errors = [abs(run(compiled, end, name, step=end / n).y[0, -1] - expected) for n in counts]
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(find(name).claims.order, abs=0.3)
