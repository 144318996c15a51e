"""Scenes with constraints have the motion of an independent formulation; multipliers are forces with right signs."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from sympy import cos, sin, sqrt

import lagrange as lg
from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.trajectory.run import flow
from tests.covering import Share
from tests.mechanisms.formulation import Formulation
from tests.mechanisms.scenes import FORMULATIONS
from tests.models import g, l, loaded, m, x, y
from tests.systems import rod_pendulum


@cache
def formulation(name: str) -> Formulation:
    return FORMULATIONS[name]()


@cache
def model(name: str, target: str = "llvm") -> Model:
    return model_of(loaded(name), machine(target))


@pytest.mark.few
@pytest.mark.parametrize("name", [*FORMULATIONS])
def test_a_scene_starts_where_its_formulation_does_and_on_its_constraints(name: str) -> None:
    start = np.array(loaded(name).initial)
    assert formulation(name).lift(formulation(name).first, 0.0) == pytest.approx(start, rel=1e-14, abs=2e-15)
    n = len(start) // 2
    if not loaded(name).constraints:
        return
    off = model(name).evaluate("constraints", start[:n], start[n:])
    size = max(1.0, np.abs(start).max())
    assert np.abs(off).max() <= 1e-15 * size**2


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("name", FORMULATIONS)
def test_the_accelerations_are_those_of_the_formulation(name: str, target: str, share: Share) -> None:
    compiled, expected = model(name, target), formulation(name)
    n = compiled.dimension
    for z in expected.draws(share(20)):
        time = 0.7
        state = expected.lift(z, time)
        result = compiled.accelerations(state[:n], state[n:], time)
        right = expected.accelerations(z, time)
        assert np.abs(result - right).max() <= 1e-11 * max(1.0, np.abs(right).max()), z


@cache
def expected_states(name: str) -> Any:
    """Return five times along the run of a scene, and the states there."""
    times = np.linspace(0.0, loaded(name).run.t_end, 6)[1:]
    return times, formulation(name).states(times)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name != "cartesian-pendulum")) for name in FORMULATIONS]
)
def test_the_run_is_that_of_the_formulation(name: str) -> None:
    times, right = expected_states(name)
    run: Any = flow(model(name), rtol=1e-13, atol=1e-15)
    size = np.maximum(np.abs(right).max(axis=1), 1.0)
    for time, expected in zip(times, right.T, strict=True):
        result = run(np.array(loaded(name).initial), 0.0, time)
        assert (np.abs(result - expected) / size).max() <= 1e-8, time


def test_a_velocity_constraint_put_into_the_lagrangian_of_the_rolling_disc_gives_another_motion() -> None:
    """The table in docs/constraints.md. Kane's method gives the accelerations of the scene."""
    q1, q2, q3 = lg.coordinates("q1 q2 q3")
    along, across = q3.dot + q1.dot * sin(q2), q1.dot * cos(q2)
    # The velocity of the centre is that of a rotation about the contact, which is taken to be at rest.
    kinetic = (along**2 + q2.dot**2) / 2 + (q2.dot**2 + 2 * along**2 + across**2) / 8
    wrong = lg.System(kinetic, cos(q2), coordinates=[q1, q2, q3]).compile(check=False)
    y = formulation("rolling-disc").lift(np.array([0.4, -0.7, 1.3, 0.2, -0.5, 0.4, -2.0, 1.1]), 0.0)
    right = model("rolling-disc").accelerations(y[:5], y[5:])[:3]
    assert right == pytest.approx([1.12283, -2.95154, -0.00999], abs=1e-5)
    assert wrong.accelerations(y[:3], y[5:8]) == pytest.approx([5.30670, -2.95154, 2.97867], abs=1e-5)


@pytest.mark.parametrize("angle", [-3.0, -1.1, 0.0, 0.4, 1.5707963267948966, 2.6])
@pytest.mark.parametrize("turn", [-4.0, 0.0, 1.3])
def test_the_tension_of_a_rod(angle: float, turn: float) -> None:
    """The tension m (g cos theta + l theta_dot^2) pulls the bob inwards, against the gradient of the length."""
    mass, gravity, length = 1.7, 9.81, 0.8
    q = length * np.array([np.sin(angle), -np.cos(angle)])
    v = length * turn * np.array([np.cos(angle), np.sin(angle)])
    tension = mass * (gravity * np.cos(angle) + length * turn**2)
    size = mass * (gravity + length * turn**2)
    by_length, by_square, turned = (
        rod_pendulum(constraints={"rod": rod}, parameters={m: mass, g: gravity, l: length}).compile().multipliers(q, v)
        for rod in (sqrt(x**2 + y**2) - l, x**2 + y**2 - l**2, l**2 - x**2 - y**2)
    )
    assert by_length == pytest.approx([-tension], abs=1e-12 * size)
    assert 2 * length * by_square == pytest.approx([-tension], abs=1e-12 * size)
    assert turned == pytest.approx(-by_square, abs=1e-12 * size)


def virtual_work(name: str, q: Any, v: Any, freed: int) -> float:
    """Return the force of a constraint by virtual work: M a - h along a displacement.

    The displacement satisfies the other constraints, and changes this one at the rate one.
    """
    of = model(name)
    forces = of.mass_matrix(q) @ of.accelerations(q, v) - of.evaluate("bias", q, v)
    gradient = differences(name, q)
    unit = np.zeros(len(gradient))
    unit[freed] = 1.0
    displacement = np.linalg.lstsq(gradient, unit, rcond=None)[0]
    return float(forces @ displacement)


def differences(name: str, q: Any) -> Any:
    """Return the gradient of the constraints by central differences of the stated expressions."""
    of, n, h = model(name), model(name).dimension, 1e-5
    m_ = len(loaded(name).constraints)
    columns = []
    for i in range(n):
        unit = np.eye(n)[i]
        sides = [of.evaluate("constraints", q + s * unit, np.zeros(n))[:m_] for s in (-2 * h, -h, h, 2 * h)]
        columns.append((sides[0] - 8 * sides[1] + 8 * sides[2] - sides[3]) / (12 * h))
    return np.array(columns).T


@pytest.mark.few(1)
@pytest.mark.parametrize("time", [0.0, 0.35, 0.6])
@pytest.mark.parametrize(
    "name", ["slider-crank", "four-bar", "seven-body-mechanism", "hanging-chain", "atwood-machine"]
)
def test_the_multipliers_of_linkages_are_those_of_virtual_work(name: str, time: float) -> None:
    run: Any = flow(model(name), rtol=1e-12)
    state = run(np.array(loaded(name).initial), 0.0, time * loaded(name).run.t_end)
    q, v = np.split(state, 2)
    result = model(name).multipliers(q, v)
    expected = [virtual_work(name, q, v, i) for i in range(len(result))]
    assert result == pytest.approx(expected, rel=1e-7, abs=1e-7 * np.abs(result).max())


# --- published ------------------------------------------------------------------------------------------------
# Mechanisms with constraints against numbers that others have published.


def end(name: str) -> Any:
    """Return the state at the end of a scene's run."""
    run: Any = flow(model(name), rtol=1e-13, atol=1e-15)
    return run(np.array(loaded(name).initial), 0.0, loaded(name).run.t_end)


# F. Mazzia, C. Magherini, Test Set for Initial Value Problem Solvers (2008), problem Andrews' squeezing mechanism:
# states at t = 0.03 by PSIDE on a Cray C90 at tolerances of 1e-14. There M a = f - G^T lambda, so lambda is ours with
# the other sign.
ANDREWS_END = (
    *(0.1581077119629904e2, -0.1575637105984298e2, 0.4082224013073101e-1, -0.5347301163226948),
    *(0.5244099658805304, 0.5347301163226948, 0.1048080741042263e1),
    *(0.1139920302151208e4, -0.1424379294994111e4, 0.1103291221937134e2, 0.1929337464421385e2),
    *(0.5735699284790808, -0.1929337464421385e2, 0.3231791658026955),
)
ANDREWS_FIRST_ACCELERATIONS = (14222.4439199541138705911625887, -10666.8329399655854029433719415, 0, 0, 0, 0, 0)
ANDREWS_FIRST_MULTIPLIERS = (98.5668703962410896057654982170, -6.12268834425566265503114393122, 0, 0, 0, 0)
ANDREWS_LAST_ACCELERATIONS = (
    *(-0.2463176316945196e5, 0.5185037701610329e5, 0.3241025686413781e6, 0.5667493645176213e6),
    *(0.1674362929479361e5, -0.5667493645176222e6, 0.9826520791458422e4),
)
ANDREWS_LAST_MULTIPLIERS = (
    *(0.1991753333731910e3, -0.2975531228015052e2, 0.2306654119098399e2),
    *(0.3145271365475927e2, 0.2264249232082739e2, 0.1161740700019673e2),
)


@pytest.mark.slow
def test_the_seven_body_mechanism_begins_and_ends_as_published() -> None:
    """The published velocities are off their own constraints by 1e-9, which bounds the digits of the velocities.

    Our end states by taylor, dop853 and verner9 differ among themselves by less than 1e-12.
    """
    of = model("seven-body-mechanism")
    q, v = np.split(np.array(loaded("seven-body-mechanism").initial), 2)
    assert of.accelerations(q, v) == pytest.approx(ANDREWS_FIRST_ACCELERATIONS, rel=1e-13, abs=1e-9)
    assert -of.multipliers(q, v) == pytest.approx(ANDREWS_FIRST_MULTIPLIERS, rel=1e-13, abs=1e-11)
    result, (q, v) = end("seven-body-mechanism"), np.split(np.array(ANDREWS_END), 2)
    assert result[:7] == pytest.approx(q, rel=0, abs=2e-9)
    assert result[7:] == pytest.approx(v, rel=1e-7, abs=0)
    assert of.accelerations(q, v) == pytest.approx(ANDREWS_LAST_ACCELERATIONS, rel=0, abs=3e-7 * 5.7e5)
    assert -of.multipliers(q, v) == pytest.approx(ANDREWS_LAST_MULTIPLIERS, rel=0, abs=3e-7 * 200)


def test_the_slider_crank_ends_as_published() -> None:
    """Five digits of idasSlCrank_dns in SUNDIALS, run there at a tolerance of 1e-6."""
    q, x, p = end("slider-crank")[:3]
    assert (q, x, p) == pytest.approx((1.2757, 1.0236, -0.49881), abs=5.1e-5)
