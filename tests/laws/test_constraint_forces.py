"""Laws of constraint forces at one state of random mechanisms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from sympy import sin

from lagrange.compiler import machine, model_of
from lagrange.statement.coordinate import coordinate, t
from lagrange.statement.declare import declare
from tests.laws.mechanisms import (
    PLACES,
    RATES,
    Mechanism,
    close,
    functions_of,
    holonomic,
    mechanisms,
    moving,
    rate_of,
    rationals,
    slope,
    some,
)

x, y, z = PLACES
places_only = holonomic(*PLACES).map(lambda phi: [phi])


def course(mechanism: Mechanism, s: float) -> dict[Any, float]:
    """Return coordinates, velocities and time a little later, by the accelerations."""
    a = mechanism.accelerations()
    q, v = mechanism.q + s * mechanism.v + s**2 / 2 * a, mechanism.v + s * a
    return {**dict(zip(RATES, v, strict=True)), t: mechanism.time + s, **dict(zip(PLACES, q, strict=True))}


# --- what the equations say -----------------------------------------------------------------------------------


@some
@given(mechanisms(forces=True) | moving())
def test_the_accelerations_keep_the_constraints(mechanism: Mechanism) -> None:
    """d psi/dt = G a + gamma = 0, by differences of the stated constraints."""
    kept = sp.lambdify([*RATES, t, *PLACES], [rate_of(item) for item in mechanism.constraints.values()])
    for i in range(len(mechanism.constraints)):
        assert slope(lambda s, i=i: kept(*course(mechanism, s).values())[i]) == close(0.0, 1e-7)


@some
@given(mechanisms(forces=True) | moving())
def test_masses_times_accelerations_are_the_forces_and_the_reactions(mechanism: Mechanism) -> None:
    """M a = h + G^T lambda, with G by SymPy."""
    model, at = mechanism.model, (mechanism.q, mechanism.v, mechanism.time)
    left = model.mass_matrix(mechanism.q, mechanism.time) @ mechanism.accelerations()
    assert left == close(model.evaluate("bias", *at) + mechanism.reaction())


@pytest.mark.slow
@some
@given(mechanisms(forces=True))
def test_the_momentum_changes_by_the_forces_and_the_reactions(mechanism: Mechanism) -> None:
    """dp/dt = dL/dq + Q + G^T lambda: p by differences along the motion, the rest by SymPy."""
    model, a = mechanism.model, mechanism.accelerations()

    def momentum(s: float, i: int) -> float:
        q, v = mechanism.q + s * mechanism.v + s**2 / 2 * a, mechanism.v + s * a
        return float(model.momenta(q, v, mechanism.time)[i])

    lagrangian = mechanism.energies["kinetic"] - mechanism.energies["potential"]
    applied = mechanism.energies["forces"]
    forces = [mechanism.at(sp.diff(lagrangian, q) + applied.get(q, 0)) for q in PLACES]
    rates = [slope(lambda s, i=i: momentum(s, i)) for i in range(3)]
    assert rates == close(np.array(forces) + mechanism.reaction(), 1e-7)


@some
@given(mechanisms())
def test_each_constraint_pushes_along_its_own_gradient(mechanism: Mechanism) -> None:
    rows = mechanism.model.evaluate("constraint_forces", mechanism.q, mechanism.v, mechanism.time)
    assert rows == close(mechanism.multipliers()[:, None] * mechanism.gradient)


# --- what they do not depend on -------------------------------------------------------------------------------


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


# --- coordinates that are not free ----------------------------------------------------------------------------


def with_another(mechanism: Mechanism, f: Any, inertia: int) -> Any:
    """Return accelerations and multipliers with an additional coordinate w = f(x, y, z)."""
    w = coordinate("w")
    statement = declare(
        coordinates=[*PLACES, w],
        kinetic=mechanism.energies["kinetic"] + inertia * w.dot**2 / 2,
        potential=mechanism.energies["potential"],
        constraints={**mechanism.constraints, "own": w - f},
    )
    rate = sp.diff(f, t).doit()
    q, v = [*mechanism.q, mechanism.at(f)], [*mechanism.v, mechanism.at(rate)]
    model = model_of(statement, machine("numpy"))
    return model.accelerations(q, v), model.multipliers(q, v)


@pytest.mark.slow
@some
@given(mechanisms(), functions_of(*PLACES))
def test_a_coordinate_that_a_constraint_determines_changes_nothing(mechanism: Mechanism, f: Any) -> None:
    """The additional coordinate has no inertia, so its constraint exerts no force."""
    a, multipliers = with_another(mechanism, f, inertia=0)
    assert a[:3] == close(mechanism.accelerations())
    assert multipliers == close([*mechanism.multipliers(), 0.0])
    second = sp.diff(f, t, 2).doit()
    told = dict(zip((sp.diff(q, t, 2) for q in PLACES), mechanism.accelerations(), strict=True))
    assert a[3] == close(mechanism.at(second.subs(told)))


@pytest.mark.slow
@some
@given(mechanisms(), functions_of(*PLACES))
def test_a_coordinate_with_inertia_that_is_determined_is_inertia_of_the_others(mechanism: Mechanism, f: Any) -> None:
    a, multipliers = with_another(mechanism, f, inertia=3)
    inside = mechanism.energies["kinetic"] + sp.Rational(3, 2) * sp.diff(f, t).doit() ** 2
    other = mechanism.compile(kinetic=inside)
    assert a[:3] == close(mechanism.accelerations(other), 1e-8)
    assert multipliers[:-1] == close(mechanism.multipliers(other), 1e-8)
    assert multipliers[-1] == close(3 * a[3], 1e-8)


@some
@given(mechanisms(holonomic(x, y).map(lambda phi: [z - phi.subs(z, 0)])))
def test_eliminating_a_coordinate_by_hand_gives_the_motion(mechanism: Mechanism) -> None:
    place = z - mechanism.constraints["c0"]
    rate = sp.diff(place, t).doit()

    def inside(expression: Any) -> Any:
        return expression.subs(z.dot, rate).subs(z, place)

    energies = {name: inside(mechanism.energies[name]) for name in ("kinetic", "potential")}
    small = model_of(declare(coordinates=[x, y], **energies), machine("numpy"))
    result = small.accelerations(mechanism.q[:2], mechanism.v[:2])
    assert result == close(mechanism.accelerations()[:2], 1e-8)


@some
@given(mechanisms(places_only), functions_of(t), rationals)
def test_a_driven_coordinate_may_be_put_into_the_energies(mechanism: Mechanism, f: Any, c: Any) -> None:
    """z = f(t): the multiplier is the force of the drive."""
    time, drive = mechanism.time, f + c * sin(t)
    held = mechanism.compile(constraints={"drive": z - drive})
    q = [*mechanism.q[:2], float(drive.subs(t, time))]
    v = [*mechanism.v[:2], float(sp.diff(drive, t).subs(t, time))]

    def inside(expression: Any) -> Any:
        return expression.subs(z.dot, sp.diff(drive, t)).subs(z, drive)

    energies = {name: inside(mechanism.energies[name]) for name in ("kinetic", "potential")}
    small = model_of(declare(coordinates=[x, y], **energies), machine("numpy"))
    result = held.accelerations(q, v, time)
    assert result[:2] == close(small.accelerations(q[:2], v[:2], time), 1e-8)
    assert result[2] == close(float(sp.diff(drive, t, 2).subs(t, time)))
    needed = held.mass_matrix(q, time) @ result - held.evaluate("bias", q, v, time)
    assert needed == close([0.0, 0.0, held.multipliers(q, v, time)[0]], 1e-8)


@some
@given(mechanisms())
def test_a_constraint_that_is_not_linear_pushes_along_its_derivative(mechanism: Mechanism) -> None:
    """By Chetaev's rule |v|^2 is kept constant by a force along v."""
    speed = sum(v**2 for v in RATES) - float(mechanism.v @ mechanism.v)
    held = mechanism.compile(constraints={"speed": speed})
    a, push = mechanism.accelerations(held), mechanism.multipliers(held)[0]
    assert 2 * mechanism.v @ a == close(0.0)
    pull = held.mass_matrix(mechanism.q) @ a - held.evaluate("bias", mechanism.q, mechanism.v)
    assert pull == close(2 * push * mechanism.v)
