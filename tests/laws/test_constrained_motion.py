"""Laws of the motion of random mechanisms: along runs, on all machines, in batches, and for compiled derivatives."""

from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import assume, given
from hypothesis import strategies as st
from sympy import cos, sin

from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.statement.coordinate import coordinates, t
from lagrange.statement.declare import declare
from lagrange.trajectory.integrator import RunOptions
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Status
from tests.laws.mechanisms import (
    PLACES,
    RATES,
    Mechanism,
    Vector,
    close,
    functions_of,
    mechanisms,
    moving,
    multipliers,
    rate_of,
    rationals,
    slope,
    some,
)

x, y, z = PLACES
LENGTH = 0.5


def run(model: Model, state: Vector, method: Any = None, end: float = LENGTH, begin: float = 0.3) -> Vector:
    """Return the states of a run, (6, K). Samples whose constraints become dependent are rejected."""
    names = [*(q.func.__name__ for q in PLACES), *(f"{q.func.__name__}_dot" for q in PLACES)]
    options = RunOptions(method or Taylor(rtol=1e-12, atol=1e-14), max_steps=5_000)
    start = dict(zip(names, map(float, state), strict=True))
    result, _ = trajectory_of(model, (begin, begin + end), start, options)
    assume(result.status not in (Status.SINGULAR, Status.MAX_STEPS))
    assert result.status is Status.SUCCESS, result.message
    states: Vector = result.y
    return states


# --- runs -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@some
@given(mechanisms(), functions_of(*PLACES))
def test_energy_is_conserved_along_a_run(mechanism: Mechanism, A: Any) -> None:
    """Also with a potential linear in velocities, whose forces do no work."""
    lagrangian = mechanism.energies["kinetic"] - mechanism.energies["potential"] + A * x.dot - x * y.dot
    compiled = mechanism.compile("llvm", lagrangian=lagrangian, kinetic=None, potential=None)
    assert compiled.conservative
    result = run(compiled, mechanism.state)
    energy = compiled.energy(result[:3], result[3:])
    assert energy == close(np.full(energy.shape, energy[0]), 1e-9)


@pytest.mark.slow
@some
@given(mechanisms(forces=True) | moving(), st.integers(6, 40))
def test_series_of_any_order_give_the_motion(mechanism: Mechanism, order: int) -> None:
    compiled = mechanism.compile("llvm")
    rtol = 1e-10 if order > 8 else 1e-7
    result = run(compiled, mechanism.state, Taylor(rtol=rtol, atol=rtol, order=order), 0.1)[:, -1]
    assert result == close(run(compiled, mechanism.state, "dop853", 0.1)[:, -1], 100 * rtol if order <= 8 else 1e-7)


@some
@given(mechanisms(forces=True), functions_of(*RATES), functions_of(*PLACES), rationals)
def test_power_is_that_of_forces_friction_and_explicit_time(mechanism: Mechanism, D: Any, U: Any, w: Any) -> None:
    """dE/dt = Q.v - v.dD/dv - dL/dt: constraints do no work."""
    other = mechanism.compile(dissipation=D, potential=mechanism.energies["potential"] + U * cos(w * t))
    pushing = sum(force * q.dot for q, force in mechanism.energies["forces"].items())
    rubbing = sum(v * sp.diff(D, v) for v in RATES)
    expected = mechanism.at(pushing - rubbing - w * sin(w * t) * U)
    flow = other.rhs(mechanism.time, mechanism.state)

    def energy(s: float) -> float:
        there = mechanism.state + s * flow
        return float(other.energy(there[:3], there[3:], mechanism.time + s))

    assert slope(energy) == pytest.approx(expected, rel=1e-7, abs=1e-6 * (1 + np.abs(flow).max()))


# --- other coordinates ----------------------------------------------------------------------------------------


@pytest.mark.slow
@some
@given(mechanisms(forces=True), st.permutations(range(3)))
def test_the_order_of_coordinates_does_not_matter(mechanism: Mechanism, order: list[int]) -> None:
    other = mechanism.compile(coordinates=[PLACES[i] for i in order])
    result = other.accelerations(mechanism.q[order], mechanism.v[order], mechanism.time)
    assert result == close(mechanism.accelerations()[order])
    assert multipliers(other, mechanism.q[order], mechanism.v[order], mechanism.time) == close(mechanism.multipliers())


@some
@given(mechanisms(forces=True), rationals, rationals)
@pytest.mark.slow
def test_the_motion_is_the_same_in_other_coordinates(mechanism: Mechanism, a: Any, b: Any) -> None:
    """In x = u + a sin(w)/4, y = w + b u^2/4, z = s accelerations follow by the chain rule; multipliers are equal."""
    u, w, s = coordinates("u w s")
    new = sp.Matrix([u, w, s])
    places = sp.Matrix([u + a * sp.sin(w) / 4, w + b * u**2 / 4, s])
    J = places.jacobian(list(new))
    rates = J * sp.Matrix([q.dot for q in (u, w, s)])

    def moved(expression: Any) -> Any:
        return expression.subs(dict(zip(RATES, rates, strict=True))).subs(dict(zip(PLACES, places, strict=True)))

    energies = {name: moved(mechanism.energies[name]) for name in ("kinetic", "potential")}
    constraints = {name: moved(item) for name, item in mechanism.constraints.items()}
    pushes = J.T * sp.Matrix([moved(sp.sympify(mechanism.energies["forces"].get(q, 0))) for q in PLACES])
    forces = dict(zip(new, pushes, strict=True))
    stated = declare(coordinates=[u, w, s], constraints=constraints, forces=forces, **energies)
    there = model_of(stated, machine("numpy"))
    inner = nearest(places, [u, w, s], mechanism.q)
    jacobian = np.array(J.subs(dict(zip((u, w, s), inner, strict=True))), dtype=float)
    assume(abs(np.linalg.det(jacobian)) > 0.5)
    v = np.linalg.solve(jacobian, mechanism.v)
    bend = np.array([-float(a) / 4 * np.sin(inner[1]) * v[1] ** 2, float(b) / 2 * v[0] ** 2, 0.0])
    assert jacobian @ there.accelerations(inner, v) + bend == close(mechanism.accelerations(), 1e-8)
    assert multipliers(there, inner, v, mechanism.time) == close(mechanism.multipliers(), 1e-8)


def nearest(places: Any, symbols: list[Any], q: Vector) -> Vector:
    """Return the coordinates (u, w, s) of a point (x, y, z), by Newton's method."""
    plain = [sp.Dummy() for _ in symbols]
    both = sp.lambdify(plain, [expression.subs(dict(zip(symbols, plain, strict=True))) for expression in places])
    result = q.copy()
    for _ in range(200):
        result = result - (np.array(both(*result), dtype=float) - q) / 2
    assume(np.abs(np.array(both(*result), dtype=float) - q).max() < 1e-14)
    return result


# --- laws of constraint forces at one state of random mechanisms -----------------------------------------------


def course(mechanism: Mechanism, s: float) -> dict[Any, float]:
    """Return coordinates, velocities and time a little later, by the accelerations."""
    a = mechanism.accelerations()
    q, v = mechanism.q + s * mechanism.v + s**2 / 2 * a, mechanism.v + s * a
    return {**dict(zip(RATES, v, strict=True)), t: mechanism.time + s, **dict(zip(PLACES, q, strict=True))}


@some
@given(mechanisms(forces=True) | moving())
def test_accelerations_keep_the_constraints_and_balance_forces_and_reactions(mechanism: Mechanism) -> None:
    """M a = h + G^T lambda, with G by SymPy, each multiplier along its own gradient.

    d psi/dt = G a + gamma = 0, by differences of the stated constraints.
    """
    kept = sp.lambdify([*RATES, t, *PLACES], [rate_of(item) for item in mechanism.constraints.values()])
    for i in range(len(mechanism.constraints)):
        assert slope(lambda s, i=i: kept(*course(mechanism, s).values())[i]) == close(0.0, 1e-7)
    model, at = mechanism.model, (mechanism.q, mechanism.v, mechanism.time)
    mass = model.mass_matrix(mechanism.q, mechanism.time)
    assert (mass == mass.T).all() and np.linalg.eigvalsh(mass).min() > 0.99
    assert mass @ mechanism.v == close(model.momenta(*at))
    reaction = mechanism.gradient.T @ mechanism.multipliers()
    assert mass @ mechanism.accelerations() == close(model.evaluate("bias", *at) + reaction)
    if mechanism.constraints:
        rows = model.evaluate("constraint_forces", *at)
        assert rows == close(mechanism.multipliers()[:, None] * mechanism.gradient)


@some
@given(mechanisms(forces=True) | moving())
def test_a_holonomic_constraint_may_be_stated_as_its_rate(mechanism: Mechanism) -> None:
    second = mechanism.compile(constraints={name: rate_of(first) for name, first in mechanism.constraints.items()})
    assert mechanism.accelerations(second) == close(mechanism.accelerations())
    assert mechanism.multipliers(second) == close(mechanism.multipliers())


@some
@given(mechanisms(), functions_of(*PLACES, t))
def test_a_total_time_derivative_changes_neither_motion_nor_reactions(mechanism: Mechanism, f: Any) -> None:
    lagrangian = mechanism.energies["kinetic"] - mechanism.energies["potential"] + sp.diff(f, t).doit()
    other = mechanism.compile(lagrangian=lagrangian, kinetic=None, potential=None)
    assert mechanism.accelerations(other) == close(mechanism.accelerations(), 1e-8)
    assert mechanism.multipliers(other) == close(mechanism.multipliers(), 1e-8)
