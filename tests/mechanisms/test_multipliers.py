"""Multipliers are tensions, contact forces and joint forces with the right signs."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipj, ellipk
from sympy import sqrt

import lagrange as lg
from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.statement.declare import declare
from lagrange.trajectory.run import flow
from tests.mechanisms.ladder import four_bar_ladder
from tests.models import loaded, shared_scene

x, y, theta = lg.coordinates("x y theta")
m, g, l = lg.parameters("m g l")


@cache
def model(name: str) -> Model:
    return model_of(loaded(name), machine("llvm"))


def value(name: str, parameter: str) -> float:
    """Return the value of a scene's parameter."""
    return {symbol.name: number for symbol, number in loaded(name).defaults.items()}[parameter]


# --- a rod ----------------------------------------------------------------------------------------------------


def pendulum(constraint: Any) -> Model:
    statement = declare(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints={"rod": constraint},
        parameters={m: 1.7, g: 9.81, l: 0.8},
    )
    return model_of(statement, machine("llvm"))


@pytest.mark.parametrize("angle", [-3.0, -1.1, 0.0, 0.4, 1.5707963267948966, 2.6])
@pytest.mark.parametrize("turn", [-4.0, 0.0, 1.3])
def test_the_tension_of_a_rod(angle: float, turn: float) -> None:
    """The tension m (g cos theta + l theta_dot^2) pulls the bob inwards, against the gradient of the length."""
    mass, gravity, length = 1.7, 9.81, 0.8
    q = length * np.array([np.sin(angle), -np.cos(angle)])
    v = length * turn * np.array([np.cos(angle), np.sin(angle)])
    tension = mass * (gravity * np.cos(angle) + length * turn**2)
    size = mass * (gravity + length * turn**2)
    by_length = pendulum(sqrt(x**2 + y**2) - l).multipliers(q, v)
    assert by_length == pytest.approx([-tension], abs=1e-12 * size)
    by_square = pendulum(x**2 + y**2 - l**2).multipliers(q, v)
    assert 2 * length * by_square == pytest.approx([-tension], abs=1e-12 * size)
    turned = pendulum(l**2 - x**2 - y**2).multipliers(q, v)
    assert turned == pytest.approx(-by_square, abs=1e-12 * size)


def test_the_rods_of_a_double_pendulum_carry_what_hangs_on_them() -> None:
    """At rest the upper rod carries both masses, and the lower rod the second mass."""
    m1, m2 = lg.parameters("m1 m2")
    x1, y1, x2, y2 = lg.coordinates("x1 y1 x2 y2")
    statement = declare(
        kinetic=m1 * (x1.dot**2 + y1.dot**2) / 2 + m2 * (x2.dot**2 + y2.dot**2) / 2,
        potential=m1 * g * y1 + m2 * g * y2,
        constraints={
            "upper": sqrt(x1**2 + y1**2) - l,
            "lower": sqrt((x2 - x1) ** 2 + (y2 - y1) ** 2) - 2 * l,
        },
        parameters={m1: 1.0, m2: 5.0, g: 10.0, l: 1.0},
    )
    result = model_of(statement, machine("llvm")).multipliers([0.0, -1.0, 0.0, -3.0], [0.0] * 4)
    assert result == pytest.approx([-60.0, -50.0], rel=1e-13)


# --- weights, walls and surfaces ------------------------------------------------------------------------------


def test_the_two_sides_of_a_heavy_wheel_pull_differently() -> None:
    """The tensions are m1 (g - a) and m2 (g + a)."""
    m1, m2, J, r, gravity = (value("atwood-machine", name) for name in ("m1", "m2", "J", "r", "g"))
    a = (m1 - m2) * gravity / (m1 + m2 + J / r**2)
    start = np.array(loaded("atwood-machine").initial)
    result = model("atwood-machine").multipliers(start[:3], start[3:])
    assert result == pytest.approx([-m1 * (gravity - a), -m2 * (gravity + a)], rel=1e-13)
    assert result[0] != pytest.approx(result[1], rel=0.01)


@pytest.mark.parametrize("angle", [0.3, 0.9, 1.4])
@pytest.mark.parametrize("turn", [-1.0, 0.0, 0.6])
def test_wall_and_floor_push_a_ladder(angle: float, turn: float) -> None:
    """By Newton's law for its middle, m x'' = N_wall and m y'' = N_floor - m g."""
    mass, length, gravity = (value("ladder", name) for name in ("m", "l", "g"))
    q = np.array([length / 2 * np.cos(angle), length / 2 * np.sin(angle), angle])
    v = turn * np.array([-q[1], q[0], 1.0])
    bend = -3 * gravity / (2 * length) * np.cos(angle)
    along, up = -q[1] * bend - q[0] * turn**2, q[0] * bend - q[1] * turn**2
    result = model("ladder").multipliers(q, v)
    assert result == pytest.approx([mass * along, mass * (up + gravity)], rel=1e-12, abs=1e-12)


# --- linkages: virtual work -----------------------------------------------------------------------------------


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
@pytest.mark.parametrize("name", ["slider-crank", "four-bar", "seven-body-mechanism", "hanging-chain"])
def test_the_multipliers_of_linkages_are_those_of_virtual_work(name: str, time: float) -> None:
    run: Any = flow(model(name), rtol=1e-12)
    state = run(np.array(loaded(name).initial), 0.0, time * loaded(name).run.t_end)
    q, v = np.split(state, 2)
    result = model(name).multipliers(q, v)
    expected = [virtual_work(name, q, v, i) for i in range(len(result))]
    assert result == pytest.approx(expected, rel=1e-7, abs=1e-7 * np.abs(result).max())


# --- published ------------------------------------------------------------------------------------------------
# Mechanisms with constraints against numbers that others have published.


def compiled(name: str) -> Model:
    return model_of(loaded(name), machine("llvm"))


def end(name: str) -> Any:
    """Return the state at the end of a scene's run."""
    run: Any = flow(compiled(name), rtol=1e-13, atol=1e-15)
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


def test_the_seven_body_mechanism_begins_as_published() -> None:
    model, start = compiled("seven-body-mechanism"), np.array(loaded("seven-body-mechanism").initial)
    result = model.accelerations(start[:7], start[7:])
    assert result == pytest.approx(ANDREWS_FIRST_ACCELERATIONS, rel=1e-13, abs=1e-9)
    pulls = model.multipliers(start[:7], start[7:])
    assert -pulls == pytest.approx(ANDREWS_FIRST_MULTIPLIERS, rel=1e-13, abs=1e-11)


def test_the_seven_body_mechanism_ends_as_published() -> None:
    """The published velocities are off their own constraints by 1e-9, which bounds the digits of the velocities.

    Our end states by taylor, dop853 and verner9 differ among themselves by less than 1e-12.
    """
    model, result = compiled("seven-body-mechanism"), end("seven-body-mechanism")
    last = np.array(ANDREWS_END)
    assert np.abs(model.evaluate("constraints", last[:7], last[7:])[6:]).max() > 5e-10
    assert result[:7] == pytest.approx(last[:7], rel=0, abs=2e-9)
    assert result[7:] == pytest.approx(last[7:], rel=1e-7, abs=0)
    accelerations = model.accelerations(last[:7], last[7:])
    assert accelerations == pytest.approx(ANDREWS_LAST_ACCELERATIONS, rel=0, abs=3e-7 * 5.7e5)
    assert -model.multipliers(last[:7], last[7:]) == pytest.approx(ANDREWS_LAST_MULTIPLIERS, rel=0, abs=3e-7 * 200)


def test_the_slider_crank_ends_as_published() -> None:
    """Five digits of idasSlCrank_dns in SUNDIALS, run there at a tolerance of 1e-6."""
    q, x, p = end("slider-crank")[:3]
    assert (q, x, p) == pytest.approx((1.2757, 1.0236, -0.49881), abs=5.1e-5)


def test_the_ladder_of_two_loops_is_the_scene() -> None:
    """For two loops the ladder equals the scene of the library."""
    made, scene = model_of(four_bar_ladder(2), machine("llvm")), compiled("four-bar-ladder")
    start = np.array(loaded("four-bar-ladder").initial)
    assert np.array(made.statement.initial) == pytest.approx(start)
    assert made.accelerations(start[:6], start[6:]) == pytest.approx(
        scene.accelerations(start[:6], start[6:]), abs=1e-12
    )
    assert made.multipliers(start[:6], start[6:]) == pytest.approx(scene.multipliers(start[:6], start[6:]), abs=1e-12)


@pytest.mark.parametrize(("method", "rtol"), [("taylor", 1e-8), ("dop853", 1e-9)])
def test_the_ladder_passes_where_its_rods_lie_in_one_line_as_published(method: str, rtol: float) -> None:
    """The position of B0 at t = 10 is compared with EXUDYN (steps of 1.25e-4) and with the reduced motion."""
    run: Any = flow(compiled("four-bar-ladder"), method=method, rtol=rtol)
    result = run(np.array(loaded("four-bar-ladder").initial), 0.0, 10.0)
    x, y, x_rate, y_rate = result[[0, 1, 6, 7]]
    assert (x, y, x_rate, y_rate) == pytest.approx((0.3284573768, 0.9445187937, 1.423050003, -0.4948670827), abs=5e-6)
    reduced = (0.32845811153906, 0.94451853817921, 1.42305147020307, -0.49486884548273)
    assert (x, y, x_rate, y_rate) == pytest.approx(reduced, abs=1e-6)


# --- free flip ------------------------------------------------------------------------------------------------
# A free body as a unit quaternion, against Jacobi's elliptic functions over a hundred flips about its middle axis.

FLIPS = 100


def body_rates(state: Any) -> Any:
    """Return the angular velocity in the body, 2 conj(q) q', (3, K)."""
    (w, x, y, z), (dw, dx, dy, dz) = np.split(state, 2)
    return 2 * np.array(
        [w * dx - x * dw - y * dz + z * dy, w * dy - y * dw - z * dx + x * dz, w * dz - z * dw - x * dy + y * dx]
    )


def elliptic(times: Any, inertias: Any, spin: Any) -> Any:
    """Return the angular velocity in the body, (3, K), from a spin (a, b, 0) with L^2 < 2 E I2, and the time of a flip.

    Source: L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed. (1976), section 37, with the axes 1 and 3 exchanged.
    """
    I1, I2, I3 = inertias
    energy, square = inertias @ spin**2 / 2, inertias**2 @ spin**2
    assert square < 2 * energy * I2
    first = np.sqrt((2 * energy * I3 - square) / (I1 * (I3 - I1)))
    second = np.sqrt((square - 2 * energy * I1) / (I2 * (I2 - I1)))
    third = np.sqrt((square - 2 * energy * I1) / (I3 * (I3 - I1)))
    speed = np.sqrt((I2 - I1) * (2 * energy * I3 - square) / (I1 * I2 * I3))
    m = (I3 - I2) * (square - 2 * energy * I1) / ((I2 - I1) * (2 * energy * I3 - square))
    quarter = ellipk(m) / speed
    sn, cn, dn, _ = ellipj(speed * (times + quarter), m)
    return np.array([first * dn, second * sn, third * cn]), 2 * quarter


def test_a_hundred_flips_are_elliptic_functions() -> None:
    """Rounding grows by e^5 from flip to flip. Conserved quantities keep the error to the phase."""
    scene = shared_scene("free-flip")
    values = {symbol.name: number for symbol, number in scene.statement.defaults.items()}
    inertias = np.array([values["I1"], values["I2"], values["I3"]])
    start = np.array(scene.statement.initial)
    spin = body_rates(start[:, None])[:, 0]
    assert spin[2] == 0.0
    _, flip = elliptic(0.0, inertias, spin)
    times = np.linspace(0.0, FLIPS * flip, 501)
    solution = scene.run(times[-1], rtol=1e-13, t_eval=times)
    assert solution.status is lg.Status.SUCCESS
    expected, _ = elliptic(times, inertias, spin)
    assert np.abs(body_rates(solution.y) - expected).max() <= 1e-8
    assert np.abs((solution.y[:4] ** 2).sum(axis=0) - 1).max() <= 1e-14
    assert np.count_nonzero(np.diff(np.sign(body_rates(solution.y)[1]))) == FLIPS
