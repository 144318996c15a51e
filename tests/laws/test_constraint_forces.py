"""Laws of constraints at one state of random mechanisms: what their forces are, and what they do not depend on."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp
from hypothesis import given
from sympy import exp, sin

from lagrange.compiler import machine, model_of
from lagrange.statement.coordinate import coordinate, t
from lagrange.statement.declare import declare
from tests.laws.mechanisms import (
    PLACES,
    RATES,
    Mechanism,
    close,
    functions_of,
    gradient_of,
    has_velocities,
    holonomic,
    kinds,
    mechanisms,
    moving,
    rate_of,
    rationals,
    slope,
    some,
)

x, y, z = PLACES
two = kinds(PLACES).filter(lambda constraints: len(constraints) == 2)
places_only = holonomic(*PLACES).map(lambda phi: [phi])


def course(mechanism: Mechanism, s: float) -> dict[Any, float]:
    """Return place, velocity and time a little later, as the accelerations say."""
    a = mechanism.accelerations()
    q, v = mechanism.q + s * mechanism.v + s**2 / 2 * a, mechanism.v + s * a
    return {**dict(zip(RATES, v, strict=True)), t: mechanism.time + s, **dict(zip(PLACES, q, strict=True))}


# --- what the equations say -----------------------------------------------------------------------------------


@some
@given(mechanisms(forces=True) | moving())
def test_the_accelerations_keep_the_constraints(mechanism: Mechanism) -> None:
    """d psi/dt = G a + gamma = 0, by differences of what was stated."""
    kept = sp.lambdify([*RATES, t, *PLACES], [rate_of(one) for one in mechanism.constraints.values()])
    for i in range(len(mechanism.constraints)):
        assert slope(lambda s, i=i: kept(*course(mechanism, s).values())[i]) == close(0.0, 1e-7)


@some
@given(mechanisms(forces=True) | moving())
def test_masses_times_accelerations_are_the_forces_and_the_reactions(mechanism: Mechanism) -> None:
    """M a = h + G^T lambda, with G by SymPy."""
    model, at = mechanism.model, (mechanism.q, mechanism.v, mechanism.time)
    left = model.mass_matrix(mechanism.q, mechanism.time) @ mechanism.accelerations()
    assert left == close(model.evaluate("bias", *at) + mechanism.reaction())


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


@some
@given(mechanisms(two))
def test_no_constraint_does_work_by_itself(mechanism: Mechanism) -> None:
    rows = mechanism.model.evaluate("constraint_forces", mechanism.q, mechanism.v, mechanism.time)
    assert rows @ mechanism.v == close([0.0, 0.0])


@some
@given(moving())
def test_a_constraint_that_moves_does_work(mechanism: Mechanism) -> None:
    """lambda^T G v = -lambda^T b, where b is what the constraint demands of a body at rest."""
    rest = [rate_of(one).subs(dict.fromkeys(RATES, 0)) for one in mechanism.constraints.values()]
    power = -sum(force * mechanism.at(b) for force, b in zip(mechanism.multipliers(), rest, strict=True))
    assert mechanism.reaction() @ mechanism.v == close(power)


@some
@given(mechanisms(forces=True))
def test_two_constraints_more_leave_no_freedom_to_the_last(mechanism: Mechanism) -> None:
    """Holding a system at its own accelerations costs no force: the free system satisfies what it would do anyway."""
    free = mechanism.compile(constraints={})
    a = mechanism.accelerations(free)
    own = [v - c - d * (t - mechanism.time) for v, c, d in zip(RATES, mechanism.v, a, strict=True)]
    held = mechanism.compile(constraints=own[:2])
    assert mechanism.accelerations(held) == close(a)
    assert mechanism.multipliers(held) == close([0.0, 0.0])


# --- what they do not depend on -------------------------------------------------------------------------------


@some
@given(mechanisms(), functions_of(*PLACES))
def test_a_factor_that_changes_from_place_to_place_only_scales_multipliers(mechanism: Mechanism, f: Any) -> None:
    other = mechanism.compile(constraints={name: exp(f / 4) * one for name, one in mechanism.constraints.items()})
    assert mechanism.accelerations(other) == close(mechanism.accelerations(), 1e-8)
    assert mechanism.at(exp(f / 4)) * mechanism.multipliers(other) == close(mechanism.multipliers(), 1e-8)


@some
@given(mechanisms(two), rationals, rationals)
def test_combinations_of_constraints_say_the_same(mechanism: Mechanism, a: Any, b: Any) -> None:
    first, second = mechanism.constraints.values()
    if has_velocities(first) != has_velocities(second):
        return
    mix = np.array([[1.0, float(a)], [float(b), 1.0 + float(a * b)]])  # its determinant is 1
    other = mechanism.compile(constraints=[first + a * second, b * first + (1 + a * b) * second])
    assert mechanism.accelerations(other) == close(mechanism.accelerations())
    assert mix.T @ mechanism.multipliers(other) == close(mechanism.multipliers())


@some
@given(mechanisms(forces=True) | moving())
def test_a_holonomic_constraint_may_be_stated_as_its_rate(mechanism: Mechanism) -> None:
    other = mechanism.compile(constraints={name: rate_of(one) for name, one in mechanism.constraints.items()})
    assert mechanism.accelerations(other) == close(mechanism.accelerations())
    assert mechanism.multipliers(other) == close(mechanism.multipliers())


@some
@given(mechanisms(), functions_of(*PLACES, t))
def test_a_total_time_derivative_changes_neither_motion_nor_reactions(mechanism: Mechanism, f: Any) -> None:
    lagrangian = mechanism.energies["kinetic"] - mechanism.energies["potential"] + sp.diff(f, t).doit()
    other = mechanism.compile(lagrangian=lagrangian, kinetic=None, potential=None)
    assert mechanism.accelerations(other) == close(mechanism.accelerations(), 1e-8)
    assert mechanism.multipliers(other) == close(mechanism.multipliers(), 1e-8)


@some
@given(mechanisms(), rationals)
def test_a_factor_of_the_lagrangian_is_a_factor_of_the_reactions(mechanism: Mechanism, c: Any) -> None:
    lagrangian = c * (mechanism.energies["kinetic"] - mechanism.energies["potential"])
    other = mechanism.compile(lagrangian=lagrangian, kinetic=None, potential=None)
    assert mechanism.accelerations(other) == close(mechanism.accelerations(), 1e-8)
    assert mechanism.multipliers(other) == close(float(c) * mechanism.multipliers(), 1e-8)


@some
@given(mechanisms(places_only), rationals)
def test_a_potential_of_the_constraint_is_carried_by_the_multiplier(mechanism: Mechanism, c: Any) -> None:
    """V + c phi pushes with -c G, and the multiplier is greater by c."""
    phi = mechanism.constraints["c0"]
    other = mechanism.compile(potential=mechanism.energies["potential"] + c * phi)
    assert mechanism.accelerations(other) == close(mechanism.accelerations())
    assert mechanism.multipliers(other) == close(mechanism.multipliers() + float(c))


@some
@given(mechanisms(places_only), rationals)
def test_a_penalty_on_the_constraint_is_never_paid(mechanism: Mechanism, c: Any) -> None:
    phi = mechanism.constraints["c0"]
    other = mechanism.compile(potential=mechanism.energies["potential"] + 10 * c * phi**2)
    assert mechanism.accelerations(other) == close(mechanism.accelerations())
    assert mechanism.multipliers(other) == close(mechanism.multipliers())


@some
@given(mechanisms(places_only))
def test_inertia_across_the_constraint_does_not_matter(mechanism: Mechanism) -> None:
    """T + 5 (d phi/dt)^2 changes the mass matrix, and nothing that the constraint allows."""
    psi = rate_of(mechanism.constraints["c0"])
    other = mechanism.compile(kinetic=mechanism.energies["kinetic"] + 5 * psi**2)
    assert mechanism.accelerations(other) == close(mechanism.accelerations(), 1e-8)
    assert mechanism.multipliers(other) == close(mechanism.multipliers(), 1e-7)


@some
@given(mechanisms(), rationals)
def test_a_force_along_a_constraint_is_taken_up_by_it(mechanism: Mechanism, c: Any) -> None:
    row = gradient_of(mechanism.constraints["c0"])
    other = mechanism.compile(forces=dict(zip(PLACES, (c * one for one in row), strict=True)))
    assert mechanism.accelerations(other) == close(mechanism.accelerations())
    expected = mechanism.multipliers() - float(c) * np.eye(len(mechanism.constraints))[0]
    assert mechanism.multipliers(other) == close(expected)


@some
@given(mechanisms(), functions_of(*PLACES), functions_of(*PLACES))
def test_accelerations_and_multipliers_are_linear_in_the_forces(mechanism: Mechanism, P: Any, Q: Any) -> None:
    def found(*forces: Any) -> Any:
        other = mechanism.compile(forces=dict(zip(PLACES, forces, strict=False)))
        return np.concatenate([mechanism.accelerations(other), mechanism.multipliers(other)])

    assert found(P, Q) == close(found(P, 0) + found(0, Q) - found(0, 0))


# --- coordinates that are not free ----------------------------------------------------------------------------


def with_another(mechanism: Mechanism, f: Any, inertia: int) -> Any:
    """Return accelerations and multipliers with a coordinate w = f(x, y, z) beside the others."""
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


@some
@given(mechanisms(), functions_of(*PLACES))
def test_a_coordinate_that_a_constraint_determines_changes_nothing(mechanism: Mechanism, f: Any) -> None:
    """It has no inertia, so its constraint pushes nothing."""
    a, multipliers = with_another(mechanism, f, inertia=0)
    assert a[:3] == close(mechanism.accelerations())
    assert multipliers == close([*mechanism.multipliers(), 0.0])
    second = sp.diff(f, t, 2).doit()
    told = dict(zip((sp.diff(q, t, 2) for q in PLACES), mechanism.accelerations(), strict=True))
    assert a[3] == close(mechanism.at(second.subs(told)))


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
    found = small.accelerations(mechanism.q[:2], mechanism.v[:2])
    assert found == close(mechanism.accelerations()[:2], 1e-8)


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
    found = held.accelerations(q, v, time)
    assert found[:2] == close(small.accelerations(q[:2], v[:2], time), 1e-8)
    assert found[2] == close(float(sp.diff(drive, t, 2).subs(t, time)))
    needed = held.mass_matrix(q, time) @ found - held.evaluate("bias", q, v, time)
    assert needed == close([0.0, 0.0, held.multipliers(q, v, time)[0]], 1e-8)


@some
@given(mechanisms())
def test_a_constraint_that_is_not_linear_pushes_along_its_derivative(mechanism: Mechanism) -> None:
    """Chetaev: |v|^2 is kept, by a force along v."""
    speed = sum(v**2 for v in RATES) - float(mechanism.v @ mechanism.v)
    held = mechanism.compile(constraints={"speed": speed})
    a, push = mechanism.accelerations(held), mechanism.multipliers(held)[0]
    assert 2 * mechanism.v @ a == close(0.0)
    pull = held.mass_matrix(mechanism.q) @ a - held.evaluate("bias", mechanism.q, mechanism.v)
    assert pull == close(2 * push * mechanism.v)
