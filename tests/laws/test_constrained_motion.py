"""Laws of the motion of random mechanisms: along runs, on all machines, in batches, and for compiled derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import assume, given
from hypothesis import strategies as st

from lagrange.compiler import machine, model_of
from lagrange.evidence.precise import Precise
from lagrange.machine.model import Model
from lagrange.statement.coordinate import coordinates, t
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement
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
    holonomic,
    kinds,
    kinetic_energies,
    mechanisms,
    moving,
    potentials,
    put,
    rationals,
    seeds,
    slope,
    some,
)
from tests.series import CONTEXT, DIGITS, NUMBER, series

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


@some
@given(mechanisms())
def test_energy_is_conserved_along_a_run(mechanism: Mechanism) -> None:
    compiled = mechanism.compile("llvm")
    assert compiled.conservative
    result = run(compiled, mechanism.state)
    energy = compiled.energy(result[:3], result[3:])
    assert energy == close(np.full(energy.shape, energy[0]), 1e-9)


@pytest.mark.slow
@some
@given(kinetic_energies(x, y), potentials(x, y), kinds((x, y)), seeds)
def test_a_momentum_that_no_constraint_holds_is_conserved(T: Any, V: Any, held: Any, seed: int) -> None:
    """Neither the energies nor the constraints contain z, and the constraints do not contain its velocity."""
    free = [item.subs(z.dot, 0).subs(z, 0) for item in held][:1]
    mechanism = put({"kinetic": T, "potential": V}, free, seed)
    compiled = mechanism.compile("llvm")
    result = run(compiled, mechanism.state)
    momentum = compiled.momenta(result[:3], result[3:])[2]
    assert momentum == close(np.full(momentum.shape, momentum[0]), 1e-9)


@pytest.mark.slow
@some
@given(mechanisms(forces=True) | moving(), st.integers(6, 40))
def test_series_of_any_order_give_the_motion(mechanism: Mechanism, order: int) -> None:
    compiled = mechanism.compile("llvm")
    rtol = 1e-10 if order > 8 else 1e-7
    result = run(compiled, mechanism.state, Taylor(rtol=rtol, atol=rtol, order=order), 0.1)[:, -1]
    assert result == close(run(compiled, mechanism.state, "dop853", 0.1)[:, -1], 100 * rtol if order <= 8 else 1e-7)


# --- power ----------------------------------------------------------------------------------------------------


def power(mechanism: Mechanism, model: Model) -> float:
    """Return dE/dt along the motion, by differences."""
    flow = model.rhs(mechanism.time, mechanism.state)

    def energy(s: float) -> float:
        there = mechanism.state + s * flow
        return float(model.energy(there[:3], there[3:], mechanism.time + s))

    return slope(energy)


@some
@given(mechanisms(), functions_of(*RATES))
def test_friction_takes_its_power_from_the_energy(mechanism: Mechanism, D: Any) -> None:
    """dE/dt = -v . dD/dv: constraints do no work."""
    other = mechanism.compile(dissipation=D)
    rubbing = sum(mechanism.at(v * sp.diff(D, v)) for v in RATES)
    assert power(mechanism, other) == close(-rubbing, 1e-6)


# --- what is compiled -----------------------------------------------------------------------------------------

QUANTITIES = ("accelerations", "multipliers", "constraint_forces", "constraints", "jacobian", "rhs")


@pytest.mark.slow
@some
@given(mechanisms(forces=True) | moving())
def test_machine_code_and_numpy_agree(mechanism: Mechanism) -> None:
    compiled, at = mechanism.compile("llvm"), (mechanism.q, mechanism.v, mechanism.time)
    for quantity in QUANTITIES:
        expected = mechanism.model.evaluate(quantity, *at)
        assert compiled.evaluate(quantity, *at) == close(expected, 1e-11), quantity


@pytest.mark.slow
@some
@given(mechanisms(forces=True) | moving(), st.sampled_from(["llvm", "numpy"]))
def test_the_jacobian_is_the_slope_of_the_right_hand_side(mechanism: Mechanism, target: str) -> None:
    compiled = mechanism.compile(target)
    result = compiled.jacobian(mechanism.time, mechanism.state)
    for column, unit in zip(result.T, np.eye(6), strict=True):
        slopes = [
            slope(lambda s, i=i, unit=unit: float(compiled.rhs(mechanism.time, mechanism.state + s * unit)[i]))
            for i in range(6)
        ]
        assert column == close(slopes, 1e-6 * max(1.0, float(np.abs(result).max())))


# --- other coordinates ----------------------------------------------------------------------------------------


@pytest.mark.slow
@some
@given(mechanisms(forces=True), st.permutations(range(3)))
def test_the_order_of_coordinates_does_not_matter(mechanism: Mechanism, order: list[int]) -> None:
    other = mechanism.compile(coordinates=[PLACES[i] for i in order])
    result = other.accelerations(mechanism.q[order], mechanism.v[order], mechanism.time)
    assert result == close(mechanism.accelerations()[order])
    assert other.multipliers(mechanism.q[order], mechanism.v[order], mechanism.time) == close(mechanism.multipliers())


@some
@given(mechanisms(), rationals, rationals)
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
    there = model_of(declare(coordinates=[u, w, s], constraints=constraints, **energies), machine("numpy"))
    inner = nearest(places, [u, w, s], mechanism.q)
    jacobian = np.array(J.subs(dict(zip((u, w, s), inner, strict=True))), dtype=float)
    assume(abs(np.linalg.det(jacobian)) > 0.5)
    v = np.linalg.solve(jacobian, mechanism.v)
    bend = np.array([-float(a) / 4 * np.sin(inner[1]) * v[1] ** 2, float(b) / 2 * v[0] ** 2, 0.0])
    assert jacobian @ there.accelerations(inner, v) + bend == close(mechanism.accelerations(), 1e-8)
    assert there.multipliers(inner, v) == close(mechanism.multipliers(), 1e-8)


def nearest(places: Any, symbols: list[Any], q: Vector) -> Vector:
    """Return the coordinates (u, w, s) of a point (x, y, z), by Newton's method."""
    plain = [sp.Dummy() for _ in symbols]
    both = sp.lambdify(plain, [expression.subs(dict(zip(symbols, plain, strict=True))) for expression in places])
    result = q.copy()
    for _ in range(200):
        result = result - (np.array(both(*result), dtype=float) - q) / 2
    assume(np.abs(np.array(both(*result), dtype=float) - q).max() < 1e-14)
    return result


# --- constrained series ---------------------------------------------------------------------------------------
# Taylor coefficients of random mechanisms, in 200 digits, against what the law of motion leaves of their series.

ORDER = 9
TIME = NUMBER("0.25")

three = st.tuples(rationals, rationals, rationals)


def law(lagrangian: Any) -> list[Any]:
    """Return the rows of M, then the other terms of d/dt dL/dv - dL/dq, differentiated by SymPy."""
    momenta = [sp.diff(lagrangian, v) for v in RATES]
    mass = [sp.diff(p, v) for p in momenta for v in RATES]
    rest = [
        sum(sp.diff(p, x) * v for x, v in zip(PLACES, RATES, strict=True)) - sp.diff(lagrangian, q)
        for p, q in zip(momenta, PLACES, strict=True)
    ]
    return mass + rest


def residuals(judge: Precise, result: Any, h: Any) -> tuple[Any, Any]:
    """Return the residuals of a polynomial motion at the time h: of M a + rest perpendicular to G, and of phi."""
    powers = [h**k for k in range(len(result))]
    q = [sum(c * s for c, s in zip(result[:, i], powers, strict=True)) for i in range(3)]
    v = [sum(k * result[k, i] * powers[k - 1] for k in range(1, len(result))) for i in range(3)]
    a = [sum(k * (k - 1) * result[k, i] * powers[k - 2] for k in range(2, len(result))) for i in range(3)]
    *mass, r1, r2, r3, g1, g2, g3, off = judge(q, v, TIME + h, {})
    e1, e2, e3 = (
        sum(c * x for c, x in zip(mass[3 * i : 3 * i + 3], a, strict=True)) + r for i, r in enumerate((r1, r2, r3))
    )
    return max(abs(e1 * g2 - e2 * g1), abs(e2 * g3 - e3 * g2), abs(e3 * g1 - e1 * g3)), abs(off)


def start(statement: Statement, place: Sequence[Any], wish: Sequence[Any]) -> list[Any]:
    """Return a point and the admissible velocities nearest to given ones, in multiple precision."""
    phi = statement.constraints[0].expression
    rows = Precise([*(sp.diff(phi, q) for q in PLACES), sp.diff(phi, t).doit()], statement, DIGITS)
    q, w = ([NUMBER(first.p) / first.q for first in numbers] for numbers in (place, wish))
    *G, rate = rows(q, w, TIME, {})
    size = sum(first**2 for first in G)
    assume(size > 0.1)
    return [*q, *(first - rate / size * second for first, second in zip(w, G, strict=True))]


@pytest.mark.slow
@some
@given(kinetic_energies(*PLACES), potentials(*PLACES), holonomic(*PLACES), functions_of(t, *PLACES), three, three)
def test_a_series_is_that_of_the_motion(T: Any, V: Any, phi: Any, moving: Any, place: Any, wish: Any) -> None:
    """For a series of order p, the residual of the equations of motion is of order h^(p-1), that of phi h^(p+1)."""
    phi = phi + moving / 8
    phi -= phi.subs(dict(zip(PLACES, place, strict=True))).subs(t, sp.Rational(1, 4))
    statement = declare(coordinates=list(PLACES), kinetic=T, potential=V, constraints=[phi])
    result = series(statement, ORDER, TIME, start(statement, place, wish))
    judge = Precise([*law(T - V), *(sp.diff(phi, q) for q in PLACES), phi], statement, DIGITS)
    step = NUMBER(10) ** -12
    both = zip(residuals(judge, result, step), residuals(judge, result, 2 * step), strict=True)
    for (near, far), expected in zip(both, (ORDER - 1, ORDER + 1), strict=True):
        assert near < step ** (expected - 1)
        if near > NUMBER(10) ** (20 - DIGITS):  # a series that ends leaves nothing
            assert CONTEXT.log(far / near, 2) > expected - 0.1
