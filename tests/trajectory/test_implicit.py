"""Implicit methods against their formulas and their claims."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.statement.coordinate import coordinates
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.implicit import ImplicitMethod
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, B, build, g, k, l, model, x
from tests.trajectory.runs import EQUAL, FIXED, IMPLICIT, SLOPES, exact, implicit, run


@pytest.mark.parametrize("target", TARGETS)
def test_bdf2_is_a_parabola_through_three_states(target: str) -> None:
    compiled = model("cart and pole", target)
    h = 0.02
    result = run(compiled, 10.5 * h, "bdf2", step=h)
    assert result.steps == 11
    for i in range(1, 10):
        before, y, new = result.y[:, i - 1 : i + 2].T
        slope = (3 * new - 4 * y + before) / (2 * h)
        assert slope == pytest.approx(compiled.rhs(result.t[i + 1], new), rel=1e-11, abs=1e-12)


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
    """Sources: Marsden and West, 2001, sections 2.6.1 and 2.6.2; Hairer, Lubich and Wanner, section VI.6.4."""
    compiled = model(system)
    ours, theirs = (run(compiled, 1.0, each, step=0.05) for each in (name, TWINS[name]))
    assert ours.y == pytest.approx(theirs.y, rel=1e-12, abs=1e-13)


# --- claims ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("system", ["pendulum", "double pendulum", "elastic pendulum", "Henon-Heiles"])
@pytest.mark.parametrize("name", EQUAL)
def test_what_claims_to_conserve_energy_does_and_the_rest_does_not(name: str, system: str) -> None:
    """In 2000 steps the energy error of methods that claim conservation is round-off; that of the others is not."""
    compiled = model(system)
    result = run(compiled, 40.0, name, step=0.02)
    n = compiled.dimension
    energy = compiled.energy(result.y[:n], result.y[n:])
    scale = np.abs(energy).max() + np.abs(compiled.evaluate("lagrangian", result.y[:n], result.y[n:])).max()
    error = np.abs(energy - energy[0]).max() / scale
    if find(name).claims.energy:
        assert error < 1e-12
    elif find(name).claims.order <= 2:
        assert error > 1e-6


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [name for name in IMPLICIT if find(name).claims.a_stable])
def test_what_claims_to_be_stable_damps_what_is_too_fast_for_its_steps(name: str) -> None:
    """Overdamped and oscillating motions a thousand times faster than the step do not grow."""
    for damping in (0.0, 2e4):
        compiled = build(
            kinetic=x.dot**2 / 2,
            potential=k * x**2 / 2,
            dissipation=damping * x.dot**2 / 2,
            parameters={k: 1e8},
            initial={x: 1.0},
        )
        o: Any = {"step": 0.1} if name in FIXED else {"rtol": 1e-3, "atol": 1e-3}
        result = run(compiled, 10.0, name, **o)
        # Without friction what is damped is energy that the motion keeps.
        assert result.status is Status.SUCCESS or (not damping and result.status is Status.UNRELIABLE)
        assert np.abs(result.y[0]).max() < 1 + 1e-9, (damping, np.abs(result.y[0]).max())


# --- newton ---------------------------------------------------------------------------------------------------
# How Newton's method begins, stops and fails: machines, cost, units, round-off, and methods of one's own.

# --- the cost -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("step", [1e-3, 1e-2])
@pytest.mark.parametrize("name", SLOPES)
def test_a_stage_costs_few_evaluations(name: str, step: float, target: str) -> None:
    """Extrapolated guesses and a reused inverse: 1.9 to 3.9 evaluations of each stage were measured."""
    result = run(model("double pendulum", target), 1.0, name, step=step)
    problem = Problem(model("oscillator"), {}, 0.0, 1.0, np.zeros(2))
    stages = len(implicit(name).plan(problem).step.solves[0].calls)
    assert result.evaluations <= (4.0 * stages + 1) * result.steps


# --- units, stiffness, round-off ------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize("name", EQUAL)
def test_units_do_not_matter(name: str) -> None:
    """Lengths and times in units from 1e-30 to 1e30 give the same corrections and the same result."""
    compiled = model("elastic pendulum")
    counts, ends = [], []
    for length, time in itertools.product((1e-30, 1.0, 1e30), repeat=2):
        result = run(
            compiled,
            0.75 * time,
            name,
            step=0.013 * time,
            parameters={l: 0.7 * length, g: 9.81 * length / time**2, k: 3.2 / time**2},
            initial={"r": 1.1 * length, "theta": 0.4, "theta_dot": 0.3 / time},
        )
        assert result.status.complete, result.message
        counts.append(result.evaluations)
        ends.append(result.y[:2, -1] / [length, 1])
    assert np.ptp(counts) <= 0.15 * max(counts)  # by chance, as between machines
    assert np.abs(np.array(ends) - ends[0]).max() < 1e-12


# --- how it fails ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", TARGETS)
def test_a_step_without_a_solution_is_told(target: str) -> None:
    """Backward Euler for v' = v^2 has no real solution beyond v h = 1/4."""
    compiled = build(target, kinetic=x.dot**2 / 2, forces={x: x.dot**2}, initial={x.dot: 1.0})
    result = run(compiled, 2.0, "backward-euler", step=0.1)
    assert result.status is Status.DIVERGED
    assert result.y[1, -1] * 0.1 > 0.2 and np.isfinite(result.y).all() and len(result.t) == result.steps + 1
    assert "backward-euler stopped at t = " in result.message and "the step did not converge" in result.message
    assert "The last correction of Newton's method was still " in result.message
    assert result.message.endswith("smooth the jump, such as by tanh(v/0.001).")


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", EQUAL)
def test_newton_does_not_leap_to_another_root(name: str, target: str) -> None:
    """v' = v^2 and x'' = 6x^2 have a pole at t = 1. The mass x^2 is zero at x = 0, which is reached at t = 0.5.

    A step may end so close to x = 0 that the mass matrix is singular there; rounding decides.
    """
    pole = build(target, kinetic=x.dot**2 / 2, forces={x: x.dot**2}, initial={x: 0.0, x.dot: 1.0})
    double = build(target, kinetic=x.dot**2 / 2, forces={x: 6 * x**2}, initial={x: 1.0, x.dot: 2.0})
    shrinking = build(target, kinetic=x**2 * x.dot**2 / 2, initial={x: 1.0, x.dot: -1.0})
    for compiled, step, end in ((pole, 0.01, 1.0), (double, 0.01, 1.0), (shrinking, 1e-3, 0.5)):
        if compiled is double and name in ("variational-trapezoid", "rattle"):
            continue  # Its equations are linear here, as Verlet's: they have one root.
        result = run(compiled, 3.0, name, step=step)
        singular = (Status.SINGULAR,) if compiled is shrinking else ()
        assert result.status in (Status.DIVERGED, *singular), result.message
        assert 0.9 * end <= result.t[-1] <= end and np.abs(result.y).max() < 3e6


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", EQUAL)
@pytest.mark.parametrize("size", [100.0, 1000.0])
def test_a_law_that_rounds_more_than_its_terms_show(size: float, name: str, target: str) -> None:
    """The force is a difference of cubes of `size`, so corrections stop decreasing far above round-off."""
    compiled = build(target, kinetic=x.dot**2 / 2, potential=(x + B) ** 4 / 4 - B**3 * x, initial={x: 1.0})
    result = run(compiled, 0.4 / size, name, step=2e-3 / size, parameters={B: size})
    assert result.status is Status.SUCCESS, result.message
    fine = exact(compiled, 0.4 / size, parameters={B: size})
    assert result.y[0, -1] == pytest.approx(fine.y[0, -1], abs=0.5 if name == "backward-euler" else 1e-3)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", IMPLICIT)
def test_a_mass_matrix_that_becomes_singular_is_told(name: str, target: str) -> None:
    """From x = 1 on only y + z has inertia.

    Methods of momenta detect it when Newton's matrix is updated, within 64 steps.
    """
    y, z = coordinates("y z")
    compiled = build(
        target,
        kinetic=x.dot**2 / 2 + (y.dot + z.dot) ** 2 / 2 + sp.Max(0, 1 - x) * z.dot**2 / 2,
        coordinates=[x, y, z],
        initial={x: 0.5, x.dot: 1.0, y.dot: -0.4},
    )
    o: Any = {"step": 0.01} if name in FIXED else {}
    result = run(compiled, 5.0, name, **o)
    assert result.status is Status.SINGULAR, result.message
    assert np.isfinite(result.y).all() and 0.4 < result.t[-1] < (0.51 if implicit(name).law == "rhs" else 1.15)
    assert "the mass matrix is singular at t = " in result.message


# --- of one's own ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", TARGETS)
def test_a_method_of_ones_own(target: str) -> None:
    """A user's method: Alexander's two-stage singly diagonally implicit method of order 2, with two solves."""
    gamma = 1 - 0.5**0.5

    def step(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
        a = solve(lambda a: f(t + h * gamma, y + a * (h * gamma)) - a, lambda: f(t, y))
        start = y + a * (h * (1 - gamma))
        b = solve(lambda b: f(t + h, start + b * (h * gamma)) - b, a)
        return start + b * (h * gamma)

    alexander = ImplicitMethod("sdirk2", Claims(order=2, a_stable=True, explicit=False), step)
    compiled = model("cart and pole", target)
    truth = exact(compiled, 1.0).y[:, -1]
    errors = [np.abs(run(compiled, 1.0, alexander, step=1.0 / n).y[:, -1] - truth).max() for n in (50, 71, 100)]
    assert -np.polyfit(np.log([50, 71, 100]), np.log(errors), 1)[0] == pytest.approx(2, abs=0.15)
