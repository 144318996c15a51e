"""Laws that hold for every Lagrangian, tested on the compiled models of random systems."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, assume, given, settings
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
from tests.covering import examples
from tests.laws.mechanisms import functions_of, potentials, rationals, slope

x, y = coordinates("x y")
few = settings(max_examples=examples(6), suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
some = settings(max_examples=examples(10), suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


def kinetic_energies(*leaves: Any) -> st.SearchStrategy[Any]:
    """Return quadratic forms in the velocities that are positive at all tested states."""
    pair = st.tuples(functions_of(*leaves), functions_of(*leaves))
    return pair.map(lambda g: (x.dot**2 + y.dot**2) / 2 + (g[0] * x.dot + g[1] * y.dot) ** 2 / 8)


exponents = st.sampled_from([sp.Rational(3, 2), sp.Rational(7, 4), sp.Rational(5, 3), sp.Rational(5, 2), sp.Integer(3)])


def bent_energies(*leaves: Any) -> st.SearchStrategy[Any]:
    """Return kinetic energies with powers of abs, whose mass matrices depend on velocities and have switches."""

    def energy(g: Any, p: Any, q: Any, leaf: Any, c: Any) -> Any:
        bend = x.dot * sp.Abs(y.dot) ** p + sp.Abs(x.dot) ** q + y.dot**2 * sp.Abs(leaf - sp.Rational(3, 2)) ** (p / 2)
        return x.dot**2 + y.dot**2 + (g * y.dot) ** 2 / 16 + c * bend / 16

    return st.builds(energy, functions_of(*leaves), exponents, exponents, st.sampled_from(leaves), rationals)


velocities = st.tuples(st.floats(0.3, 0.9), st.sampled_from([-1.0, 1.0])).map(lambda pair: pair[0] * pair[1])
states = st.lists(st.floats(-0.9, 0.9), min_size=4, max_size=4).map(np.array)


def model(target: str = "numpy", **options: Any) -> Model:
    statement = declare(**{"coordinates": [x, y]} | options)
    return model_of(statement, machine(target))


def accelerations(of: Model, state: Any, time: float = 0.3) -> Any:
    return of.accelerations(state[:2], state[2:], time)


def rate(f: Any, direction: Any) -> float:
    """Return the derivative of f(s) along s * direction at s = 0; the error is about 1e-11 of f."""
    return slope(lambda s: f(s * direction))


@some
@given(kinetic_energies(x, y), potentials(x, y), functions_of(x, y, x.dot, y.dot), functions_of(x, y, x.dot), states)
def test_the_mass_matrix_is_symmetric_positive_and_solves(T: Any, V: Any, Q: Any, D: Any, state: Any) -> None:
    compiled = model(kinetic=T, potential=V, forces={x: Q, y: D})
    M = compiled.mass_matrix(state[:2])
    assert (M == M.T).all() and np.linalg.eigvalsh(M).min() > 0.99
    h = compiled.evaluate("bias", state[:2], state[2:])
    assert M @ accelerations(compiled, state, 0.0) == pytest.approx(h, rel=1e-9, abs=1e-9)
    p = compiled.momenta(state[:2], state[2:])
    assert M @ state[2:] == pytest.approx(p, rel=1e-11, abs=1e-11)


@some
@given(kinetic_energies(x, y), potentials(x, y), functions_of(x, y, x.dot, y.dot), functions_of(x.dot, y.dot), states)
def test_power_is_that_of_the_forces_and_the_dissipation(T: Any, V: Any, Q: Any, D: Any, state: Any) -> None:
    """dE/dt = Q.v - v.dD/dv."""
    assume(D == 0 or not sp.sympify(D).is_number)  # a dissipation without a velocity is refused
    compiled = model(kinetic=T, potential=V, forces={x: Q, y: x - y.dot}, dissipation=D)
    flow = compiled.rhs(0.0, state)
    change = rate(lambda s: compiled.energy(*np.split(state + s, 2)), flow)
    at = dict(zip((x.dot, y.dot, x, y), np.roll(state, 2), strict=True))
    rubbing = x.dot * sp.diff(D, x.dot) + y.dot * sp.diff(D, y.dot)
    power = Q * x.dot + (x - y.dot) * y.dot - rubbing
    assert change == pytest.approx(float(power.subs(at)), rel=1e-7, abs=1e-6 * (1 + np.abs(flow).max()))


@some
@given(kinetic_energies(x, y), potentials(x, y), functions_of(x, y), rationals, states)
def test_explicit_time_changes_the_energy_by_its_own_slope(T: Any, V: Any, U: Any, w: Any, state: Any) -> None:
    """dE/dt = -dL/dt for L = T - V - U cos(w t)."""
    compiled = model(kinetic=T, potential=V + U * cos(w * t))
    time = 0.4
    direction = np.append(compiled.rhs(time, state), 1.0)

    def energy(s: Any) -> float:
        q, v = np.split(state + s[:4], 2)
        return float(compiled.energy(q, v, time + s[4]))

    at = dict(zip((x, y), state, strict=False))
    expected = float((-w * sin(w * time) * U).subs(at))
    assert rate(energy, direction) == pytest.approx(expected, rel=1e-7, abs=1e-6 * (1 + np.abs(direction).max()))


def run(compiled: Model, state: Any, end: float) -> Any:
    start = dict(zip(("x", "y", "x_dot", "y_dot"), map(float, state), strict=True))
    result, _ = trajectory_of(compiled, (0.0, end), start, RunOptions("dop853", 1e-11, 1e-12, max_steps=20_000))
    assert result.status is Status.SUCCESS, result.message
    return result


@few
@given(kinetic_energies(x, y), potentials(x, y), functions_of(x, y), states)
def test_energy_is_conserved_along_a_run(T: Any, V: Any, A: Any, state: Any) -> None:
    """Energy is conserved also with a potential linear in velocities, whose forces do no work."""
    compiled = model("llvm", lagrangian=T - V + A * x.dot - x * y.dot)
    assert compiled.conservative
    result = run(compiled, state, 1.0)
    energy = compiled.energy(result.y[:2], result.y[2:])
    assert np.abs(energy - energy[0]).max() < 1e-8 * (1 + np.abs(energy[0]))


@few
@given(kinetic_energies(x), potentials(x), functions_of(x), states)
def test_the_momentum_of_a_cyclic_coordinate_is_conserved(T: Any, V: Any, A: Any, state: Any) -> None:
    compiled = model("llvm", lagrangian=T - V + A * y.dot, forces={x: -y.dot})
    assert compiled.equations.structure.cyclic == (1,)
    result = run(compiled, state, 1.0)
    momentum = compiled.momenta(result.y[:2], result.y[2:])[1]
    assert np.abs(momentum - momentum[0]).max() < 1e-8 * (1 + np.abs(momentum[0]))


@some
@given(kinetic_energies(x, y), potentials(x, y), functions_of(x, y, t), states)
def test_a_total_time_derivative_changes_nothing(T: Any, V: Any, F: Any, state: Any) -> None:
    """L and L + dF/dt have the same motion."""
    plain, gauged = model(kinetic=T, potential=V), model(lagrangian=T - V + sp.diff(F, t))
    expected = accelerations(plain, state)
    assert accelerations(gauged, state) == pytest.approx(expected, rel=1e-8, abs=1e-8 * (1 + np.abs(expected).max()))


@some
@given(kinetic_energies(x, y), potentials(x, y), functions_of(x, y, x.dot), states, rationals, rationals)
def test_the_motion_is_the_same_in_other_coordinates(T: Any, V: Any, P: Any, state: Any, a: Any, b: Any) -> None:
    """With x = u + a sin(w)/4 and y = w + b u^2/4: L and J^T Q in (u, w) give the accelerations of (x, y)."""
    u, w = coordinates("u w")
    places = sp.Matrix([u + a * sin(w) / 4, w + b * u**2 / 4])
    J = places.jacobian([u, w])
    rates = J * sp.Matrix([u.dot, w.dot])

    def moved(expression: Any) -> Any:
        return expression.subs({x.dot: rates[0], y.dot: rates[1]}).subs({x: places[0], y: places[1]})

    forces = J.T * sp.Matrix([moved(P), moved(-y.dot)])
    there = model(kinetic=moved(T), potential=moved(V), forces={u: forces[0], w: forces[1]}, coordinates=[u, w])
    here = model(kinetic=T, potential=V, forces={x: P, y: -y.dot})
    at = {u.dot: state[2], w.dot: state[3], u: state[0], w: state[1]}
    jacobian = np.array(J.subs(at), dtype=float)
    if abs(np.linalg.det(jacobian)) < 0.2:
        return
    place = np.array(places.subs(at), dtype=float).ravel()
    velocity = jacobian @ state[2:]
    inner = accelerations(there, state)
    bend = np.array([-float(a) * np.sin(state[1]) / 4 * state[3] ** 2, float(b) / 2 * state[2] ** 2])
    expected = accelerations(here, np.concatenate([place, velocity]))
    assert jacobian @ inner + bend == pytest.approx(expected, rel=1e-7, abs=1e-7)


@some
@given(
    bent_energies(x, y),
    potentials(x, y),
    st.tuples(velocities, velocities, velocities, velocities).map(np.array),
    st.integers(4, 64) | st.integers(40, 64),
    st.sampled_from(["numpy", "llvm", "llvm"]),
)
def test_series_of_any_order_give_the_motion(T: Any, V: Any, state: Any, order: int, target: str) -> None:
    """Mass matrices have fractional powers of abs and depend on velocities. Orders go up to the highest.

    Above some order the series are computed in loops.
    """
    compiled = model(target, lagrangian=T - V)
    start = dict(zip(("x", "y", "x_dot", "y_dot"), map(float, state), strict=True))
    rtol = 1e-9 if order > 8 else 1e-6
    result, _ = trajectory_of(compiled, (0.0, 0.1), start, RunOptions(Taylor(rtol=rtol, atol=rtol, order=order)))
    if result.status is Status.SINGULAR:
        # Now and then a system is drawn that loses its inertia on the way: then that is so.
        masses = (compiled.mass_matrix(y[:2], v=y[2:]) for y in (result.y[:, 0], result.y[:, -1]))
        first, last = (np.abs(np.linalg.eigvalsh(mass)).min() for mass in masses)
        assert last < 1e-3 * first
        return
    assert result.status is Status.SUCCESS, result.message
    assert result.y[:, -1] == pytest.approx(run(compiled, state, 0.1).y[:, -1], abs=100 * rtol)
