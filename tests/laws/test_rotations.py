"""Bodies that rotate in space: closed forms, constants of motion, Euler angles, and Euler's equations as printed."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, diag, sin

import lagrange as lg
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.evidence.check import SolvedTextbook, check
from lagrange.machine.numpy_machine import NumpySeries
from lagrange.program.series import convolutions
from lagrange.program.taylor import series_program
from lagrange.statement.space import matrix_of, product
from tests.models import shared_scene

R = lg.rotation("R")
m, g, a = lg.parameters("m g a")


def body(moments: Any, rates: Any, start: Any = (1, 0, 0, 0), potential: Any = 0, **more: Any) -> lg.System:
    kinetic = R.body.dot(diag(*moments) * R.body) / 2
    return lg.System(kinetic, potential, initial={R: start, R.body: rates}, **more)


@pytest.mark.slow
def test_attitude_after_a_period_of_the_rates() -> None:
    """The rates repeat after the period P, and the body has turned about its angular momentum (Montgomery, 1991).

    The angle is 2 E P / L minus the solid angle of the path of L in the body; here from elliptic integrals, 12 digits.
    """
    period, angle = 21.021931863585294, 1.165814335998
    run = body((1, 2, 3), (0.3, 1, 0.2)).run(period, rtol=1e-14)
    matrix, rates = run[R][-1], run[R.body]
    momentum = np.array([0.3, 2, 0.6])
    assert np.abs(rates[:, -1] - rates[:, 0]).max() < 1e-12
    assert np.abs(matrix @ momentum - momentum).max() < 1e-12
    assert abs(2 * np.cos(angle) + 1 - np.trace(matrix)) < 1e-11


@pytest.mark.few(1)
@pytest.mark.parametrize("weight", [0, 0.8])
def test_the_length_of_the_quaternion_stays_one(weight: float) -> None:
    """At the default tolerance errors of the length would add up to 1e-9; only the error of one step remains."""
    potential = weight * (R[2, 2] + 0.3 * R[0, 1])
    run = body((1, 1.6, 2.2), (2, 0.5, 0.1), lg.turn((0, 1, 1), 2), potential).run(500.0)
    assert np.abs(np.linalg.norm(run.y[:4], axis=0) - 1).max() < 1e-13


@pytest.mark.slow
def test_the_series_in_rates_is_that_of_the_quaternion() -> None:
    """Two bodies with all kinds of terms, in a mixed order of coordinates, at a random state."""
    S, (x, y) = lg.rotation("S"), lg.coordinates("x y")
    kinetic = R.body.dot(diag(1.1, 1.3, 1.7) * R.body) / 2 + S.body.dot(diag(2, 1.5, 1.2) * S.body) / 2
    kinetic += m * (x.dot**2 + x.dot * R.body[0] + y.dot**2 / 3) / 2
    system = lg.System(
        kinetic + S.body[0] * R.body[1] / 5 + x.dot * S[2, 2],
        m * x * R[2, 2] + x**2 * R[0, 1] + S[1, 2] * y + R[1, 1] * S[0, 0],
        parameters={m: 0.7},
        forces={R.space: (0.1, x, lg.t), S.body: (0, 0, -0.1 * R.body[2]), y: -y.dot},
        dissipation=S.body[2] ** 2 / 7,
        coordinates=[x, y, *S.quaternion, *R.quaternion],
    )
    draw, names, equations = np.random.default_rng(0), system.statement.names, euler_lagrange(system.statement)
    q, v = draw.normal(size=(2, 10))
    for each in (R, S):
        rows = [names.index(f"{each.name}_{entry}") for entry in "wxyz"]
        q[rows] /= np.linalg.norm(q[rows])
        v[rows] -= q[rows] * (q[rows] @ v[rows])
    state, values = np.concatenate([q, v]), np.array([0.7])
    programs = [series_program(item)[0] for item in (equations, replace(equations, turning=None))]
    result, expected = (NumpySeries(program).rows(8, 0.3, state, 1.0, values)[:, :20] for program in programs)
    assert np.abs(result - expected).max() < 1e-13 * np.abs(expected).max()
    sums, others = (convolutions(program.rules) for program in programs)
    assert sums < others / 2


def test_a_free_body_needs_the_products_of_its_seven_equations() -> None:
    """Twelve products of the quaternion and the rates, and three of the rates."""
    program = series_program(euler_lagrange(body((1, 2, 3), (0, 0, 0)).statement))[0]
    assert convolutions(program.rules) == 2 * (12 + 3)


@pytest.mark.parametrize("root", [-1, 1])
def test_steady_precession(root: int) -> None:
    """A top at a constant tilt precesses at the roots of J1 w^2 cos(tilt) - J3 spin w + m g a = 0."""
    tilt, spin, moments = 0.5, 10.0, (1.0, 1.0, 0.6)
    momentum = moments[2] * spin
    slow = (momentum + root * np.sqrt(momentum**2 - 4 * np.cos(tilt))) / (2 * np.cos(tilt))
    top = body(moments, (0, slow * np.sin(tilt), spin), lg.turn((1, 0, 0), tilt), R[2, 2])
    axis = top.run(2.0, rtol=1e-13)[R][-1, :, 2]
    expected = [np.sin(tilt) * np.sin(2 * slow), -np.sin(tilt) * np.cos(2 * slow), np.cos(tilt)]
    assert np.abs(axis - expected).max() < 1e-10


def test_limit_of_a_sleeping_top() -> None:
    """An upright top is stable above the spin 2 sqrt(m g a J1) / J3 = 4: a push of 1e-3 grows below it alone."""
    for spin, stable in ((3.9, False), (4.1, True)):
        run = body((1.0, 1.0, 0.5), (1e-3, 0, spin), potential=R[2, 2]).run(60.0)
        assert (run[R][:, 2, 2].min() > 0.9999) == stable


@pytest.mark.few(1)
@pytest.mark.parametrize(("axis", "growth"), [(0, 0.0), (1, 10 / 3**0.5), (2, 0.0)])
def test_stability_of_a_steady_spin(axis: int, growth: float) -> None:
    """Of a free body about its axes: growth w sqrt((J2 - J1)(J3 - J2)/(J1 J3)) about the middle one alone."""
    rates = [10 * (k == axis) for k in range(3)]
    linear = body((1, 2, 3), (0, 0, 0)).linearize({R.body: rates})
    values = np.linalg.eigvals(np.array(linear.A, dtype=float))
    assert values.real.max() == pytest.approx(growth, abs=1e-6)
    assert linear.note == "About a steady motion."


def top_on_a_joint() -> lg.System:
    """Return a top whose tip a ball joint holds."""
    (x, y, z), (J1, J3) = lg.coordinates("x y z"), lg.parameters("J1 J3")
    tip, values = (x, y, z) + R * (0, 0, -a), {m: 1.0, g: 9.81, a: 0.1, J1: 0.01, J3: 0.02}
    return lg.System(
        R.body.dot(diag(J1, J1, J3) * R.body) / 2 + lg.kinetic_energy(m, (x, y, z)),
        m * g * z,
        constraints=dict(zip(("joint_x", "joint_y", "joint_z"), tip, strict=True)),
        parameters=values,
    )


@pytest.mark.slow
def test_linear_equations_on_constraints_agree_with_the_compiled_model_anywhere() -> None:
    """`linearize` compares itself with the model, and raises if it differs: a top on its joint in free motion."""
    held = top_on_a_joint()
    hanging = held.modes({R: lg.turn((1, 0, 0), np.pi), "z": -0.1})
    assert [float(w) for w in hanging.frequencies] == pytest.approx([0, *[(0.981 / 0.02) ** 0.5] * 2], abs=1e-6)
    place, rates = sympy.Matrix(matrix_of(lg.turn((1, 2, 3), 1.1))), sympy.Matrix([0.4, -0.7, 1.3])
    centre, velocity = place[:, 2] / 10, place * rates.cross(sympy.Matrix([0, 0, 1])) / 10
    start = dict(zip(("x", "y", "z", "x_dot", "y_dot", "z_dot"), (*centre, *velocity), strict=True))
    result = held.substitute({a: sympy.Rational(1, 10)}).linearize({R: place, R.body: tuple(rates)} | start)
    assert result.note.startswith("Away from equilibrium") and result.A.shape == (6, 6)
    with pytest.raises(lg.StatementError, match=r"the point is not on the constraint 'joint_z', which is -a there"):
        held.linearize({R.body: (0, 0, 50)})


def test_small_turns_of_a_body_that_hangs() -> None:
    """A body hangs by a point: frequencies sqrt(m g a/J) about the two horizontal axes, and free turns about z."""
    hanging = body((0.5, 0.8, 0.4), (0, 0, 0), potential=-R[2, 2])
    assert np.allclose([float(w) for w in hanging.modes().frequencies], [0, 0.8**-0.5, 0.5**-0.5], rtol=1e-12)


def test_constant_of_kovalevskaya() -> None:
    top = body((2, 2, 1), (0.3, 0.5, -0.4), lg.turn((1, 2, 3), 0.7), R[2, 0])
    run = top.run(20.0, rtol=1e-13)
    rates, down = run[R.body], run[R][:, 2, :].T
    constant = np.abs((rates[0] + 1j * rates[1]) ** 2 - (down[0] + 1j * down[1])) ** 2
    assert np.ptp(constant) < 1e-12


def momentum_in_space(run: lg.Solution, moments: tuple[float, ...]) -> Any:
    return np.einsum("nij,j,jn->in", run[R], np.array(moments), run[R.body])


def test_the_variational_midpoint_keeps_the_momentum_in_space_and_the_length() -> None:
    """Its discrete Lagrangian has the symmetries of turns in space, which act linearly on quaternions."""
    run = body((1, 2, 3), (0.3, 1, 0.2)).run(20.0, method="variational-midpoint", step=0.05)
    momentum = momentum_in_space(run, (1, 2, 3))
    assert np.abs(momentum - momentum[:, :1]).max() < 1e-13
    assert np.abs(np.linalg.norm(run.y[:4], axis=0) - 1).max() < 1e-13


@pytest.mark.few(1)
@pytest.mark.parametrize(("method", "order"), [("variational-midpoint", 2), ("rk4", 4), ("munthe-kaas4", 4)])
def test_order_of_methods_on_attitudes(method: str, order: int) -> None:
    system = body((1, 2, 3), (0.3, 1, 0.2))
    exact = system.run(2.0, rtol=1e-14)[R][-1]
    errors = [np.abs(system.run(2.0, method=method, step=h)[R][-1] - exact).max() for h in (0.1, 0.05, 0.025)]
    slopes = [np.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert abs(slopes[-1] - order) < 0.15


def cayley_step(moments: Any, q: Any, w: Any, h: float) -> tuple[Any, Any]:
    """Return the quaternion and the rates of a free body after a step of rk4 in u = tan(a/2) n and the rates."""

    def slope(state: Any) -> Any:
        u, w = state
        return np.array([(w + np.cross(u, w) + u * (u @ w)) / 2, np.cross(moments * w, w) / moments])

    start = np.array([np.zeros(3), w])
    first = slope(start)
    second = slope(start + first * h / 2)
    third = slope(start + second * h / 2)
    fourth = slope(start + third * h)
    u, w = start + (first + 2 * second + 2 * third + fourth) * h / 6
    return np.array(product(q, (1, *u))) / np.sqrt(1 + u @ u), w


def test_a_step_of_munthe_kaas_is_one_in_local_coordinates() -> None:
    """The reference is a step in local coordinates by Euler's equations. rk4 does not keep the quaternion's length."""
    moments, q, w = np.array([1.0, 2.0, 3.0]), np.array([0.6, 0, 0.8, 0]), np.array([0.3, 1, 0.2])
    system = body(moments.tolist(), w.tolist(), q.tolist())
    for _ in range(10):
        q, w = cayley_step(moments, q, w, 0.1)
    run = system.run(1.0, method="munthe-kaas4", step=0.1)
    assert np.abs(run.y[:4, -1] - q).max() < 1e-14
    assert np.abs(run[R.body][:, -1] - w).max() < 1e-14
    for method, kept in (("munthe-kaas4", True), ("rk4", False)):
        y = system.run(400.0, method=method, step=0.1).y
        assert (np.abs(np.linalg.norm(y[:4], axis=0) - 1).max() < 1e-15) == kept


def test_an_adaptive_tableau_in_local_coordinates_controls_its_steps() -> None:
    system = body((1, 2, 3), (0.3, 1, 0.2))
    exact = system.run(20.0, rtol=1e-14)[R][-1]
    method = lg.methods.RungeKutta(lg.methods.Dopri5().tableau, law="local")
    run = system.run(20.0, method=method, rtol=1e-9)
    assert np.abs(run[R][-1] - exact).max() < 1e-8
    assert np.abs(np.linalg.norm(run.y[:4], axis=0) - 1).max() < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rolling-sphere", "gyroscope-on-gimbal"])
def test_munthe_kaas_moves_bodies_with_coordinates_and_constraints(name: str) -> None:
    system = shared_scene(name)
    exact = system.run(1.0, rtol=1e-13).y[:, -1]
    errors = [np.abs(system.run(1.0, method="munthe-kaas4", step=h).y[:, -1] - exact).max() for h in (0.04, 0.02)]
    assert abs(np.log2(errors[0] / errors[1]) - 4) < 0.2


def test_a_step_of_munthe_kaas_is_exported(tmp_path: Path) -> None:
    """The self-test of the exported Python takes a step and compares it with the step of this package."""
    made = shared_scene("heavy-top").export("python", tmp_path, contents=["munthe-kaas4"])
    assert any("munthe_kaas4" in path.read_text() for path in made.files)


def random_top(seed: int) -> tuple[lg.System, lg.System]:
    """Return a body with a fixed point in a random potential, stated with R and with Euler angles z, x, z."""
    draw = np.random.default_rng(seed)
    half = draw.uniform(0.5, 1.5, 3)
    moments = tuple(float(x) for x in (half[1] + half[2], half[2] + half[0], half[0] + half[1]))
    pull, bend = (tuple(float(x) for x in draw.uniform(-1, 1, 3)) for _ in range(2))
    phi, theta, psi = lg.coordinates("phi theta psi")

    def about(axis: int, angle: Any) -> Any:
        return sympy.rot_axis3(-angle) if axis == 2 else sympy.rot_axis1(-angle)

    turned = about(2, phi) * about(0, theta) * about(2, psi)
    rates = [
        phi.dot * sin(theta) * sin(psi) + theta.dot * cos(psi),
        phi.dot * sin(theta) * cos(psi) - theta.dot * sin(psi),
        phi.dot * cos(theta) + psi.dot,
    ]

    def potential(entry: Any) -> Any:
        return sum(pull[k] * entry(2, k) + bend[k] * entry(0, k) * entry(1, (k + 1) % 3) for k in range(3))

    angles = {phi: float(draw.uniform(-3, 3)), theta: float(draw.uniform(0.8, 2.2)), psi: float(draw.uniform(-3, 3))}
    speeds = {q.dot: float(draw.uniform(-0.5, 0.5)) for q in angles}
    start = np.array(turned.xreplace(angles).evalf(20), dtype=float)
    spins = [float(rate.xreplace(speeds).xreplace(angles)) for rate in rates]
    kinetic = sum(moment * rate**2 for moment, rate in zip(moments, rates, strict=True)) / 2
    other = lg.System(kinetic, potential(lambda i, j: turned[i, j]), coordinates=list(angles), initial=angles | speeds)
    return body(moments, spins, start, potential(lambda i, j: R[i, j])), other


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", [*range(5), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(5, 100))])
def test_the_motion_is_that_of_euler_angles(seed: int) -> None:
    """The motion stays away from the pole, for a time in which errors grow by at most a factor of ten."""
    rotating, angles = random_top(seed)
    first, second = rotating.run(0.5, rtol=1e-14), angles.run(0.5, rtol=1e-14)
    phi, theta, psi = (sympy.Symbol(name) for name in "fts")
    turned = sympy.rot_axis3(-phi) * sympy.rot_axis1(-theta) * sympy.rot_axis3(-psi)
    place = dict(zip((phi, theta, psi), second.y[:3, -1], strict=True))
    assert np.abs(first[R][-1] - np.array(turned.xreplace(place), dtype=float)).max() < 1e-12


@pytest.mark.slow
def test_a_derivation_too_long_to_be_solved_in_symbols_is_compared_at_each_point() -> None:
    """The equations are solved numerically at each point. A wrong inertia is detected."""
    held = top_on_a_joint()
    statement = held.statement
    textbook = SolvedTextbook(held.derivation(), statement, {})
    report = check(held.compile("numpy"), textbook=textbook, points=2)
    assert report and "textbook accelerations" in str(report)
    heavier = held.substitute({lg.parameters("J1"): sympy.Rational(101, 10000)})
    wrong = SolvedTextbook(heavier.derivation(), statement, {})
    assert not check(held.compile("numpy"), textbook=wrong, points=2)


@pytest.mark.slow
def test_a_rolling_ball_has_the_equations_of_chaplygin() -> None:
    """The derivation has Euler's equations with the moments of the contact forces, and the conditions of rolling."""
    system = shared_scene("rolling-sphere")
    rates = "x_dot - r*(R_body_x*R_yx + R_body_y*R_yy + R_body_z*R_yz)"
    text = system.derivation().text()
    assert f"f_rolling_x = {rates}" in text
    assert (
        f"""Equations of motion
    m*x_ddot = lambda[rolling_x]
    m*y_ddot = lambda[rolling_y]
    J1*R_body_x_dot + (J3 - J2)*R_body_y*R_body_z = r*lambda[rolling_y]*R_xx - r*lambda[rolling_x]*R_yx
    J2*R_body_y_dot + (J1 - J3)*R_body_x*R_body_z = r*lambda[rolling_y]*R_xy - r*lambda[rolling_x]*R_yy
    J3*R_body_z_dot + (J2 - J1)*R_body_x*R_body_y = r*lambda[rolling_y]*R_xz - r*lambda[rolling_x]*R_yz
    {rates} = 0"""
        in text
    )
    assert "leave 3 of 5 velocities free" in text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rolling-sphere", "gyroscope-on-gimbal"])
def test_a_derivation_in_turns_with_constraints_agrees_with_the_compiled_model(name: str) -> None:
    """One constraint is on velocities and one on coordinates. Both multipliers act on the rotation."""
    system = shared_scene(name)
    report = system.check(points=2)
    assert report
    assert "textbook accelerations" in str(report)
    run, exerted = system.run(0.5), system.derivation().multipliers
    for constraint, formula in exerted.items():
        assert np.abs(run.evaluate(formula) - run.multipliers[constraint]).max() < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rolling-sphere", "gyroscope-on-gimbal"])
@pytest.mark.parametrize(("method", "step"), [("taylor", None), ("rk4", 0.05)])
def test_constraints_keep_the_length_of_the_quaternion(name: str, method: str, step: float | None) -> None:
    """Projection also restores the length one, which rk4 would change by 1e-4 and taylor by 1e-10."""
    run = shared_scene(name).run(20.0, method=method, step=step)
    assert max(run.card()["lengths"].values()) < 1e-15


@pytest.mark.slow
def test_conserved_momenta_of_a_thrown_body_have_different_names() -> None:
    x, y, z = lg.coordinates("x y z")
    centre = sympy.Matrix([x, y, z])
    kinetic = R.body.dot(sympy.diag(1, 1, a) * R.body) / 2 + lg.kinetic_energy(m, centre)
    names = [quantity.name for quantity in lg.System(kinetic, m * g * z, name="box").conserved()]
    assert len(set(names)) == len(names)
    assert {"angular momentum z", "angular momentum z of R", "angular momentum z of the body of R"} <= set(names)


def example(name: str) -> lg.Solution:
    return shared_scene(name).run(rtol=1e-12)


def test_a_wing_nut_has_turned_over_every_half_period() -> None:
    """Four half periods are two periods of the rates, in which rounding errors grow by a factor of 10,000."""
    run = example("free-top")
    assert np.abs(run[R.body][:, -1] - run[R.body][:, 0]).max() < 1e-6
    assert run[R.body][1].min() < -0.999


def test_a_heavy_top_nods_between_the_roots_of_its_cubic() -> None:
    """Let go at rest, its height falls from u0 to the root u of 2 m g a J1 (1 - u^2) = p^2 (u0 - u)."""
    run = example("heavy-top")
    start, p = np.cos(0.5), 0.01 * run[R.body][2, 0]
    rate = 2 * 9.81 * 0.1 * 0.02
    low = np.roots([rate, -(p**2), p**2 * start - rate])
    assert abs(run[R][:, 2, 2].min() - low[np.abs(low) < 1][0]) < 2e-4
    assert run[R][:, 2, 2].max() < start + 1e-12


@pytest.mark.slow
def test_a_ball_of_chaplygin_keeps_its_momentum_about_the_point_of_contact() -> None:
    """K = J w + m r^2 (w - (w . z) z), in space: the force at the point of contact has no moment about it."""
    run = example("rolling-sphere")
    spin = run[R.space]
    momentum = momentum_in_space(run, (0.3, 0.4, 0.5)) + spin * np.array([[1], [1], [0]])
    assert np.abs(momentum - momentum[:, :1]).max() < 1e-9
    assert np.ptp(run.energy) < 1e-10


@pytest.mark.slow
def test_a_quadrotor_rises_and_rolls_by_the_integrals_of_its_thrusts() -> None:
    """The roll rate is the integral of 2 l u / J1; after whole periods of the sine it is back at zero."""
    run = example("quadrotor")
    t, rate = run.t, run[R.body][0]
    expected = 2 * 0.2 * 0.02 * (1 - np.cos(2 * np.pi * t)) / (2 * np.pi * 0.005)
    assert np.abs(rate - expected).max() < 1e-9
    assert abs(run[R][-1, 2, 1] - np.sin(2 * 0.2 * 0.02 * 2 / (2 * np.pi * 0.005))) < 1e-9


@pytest.mark.slow
def test_rods_on_ball_joints_keep_energy_and_momentum_about_the_vertical() -> None:
    """Turns of both quaternions about z from the left are a symmetry, which SymPy's derivative of L confirms."""
    system = shared_scene("rods-on-ball-joints")
    run = system.run(rtol=1e-12)
    generator: dict[Any, Any] = {}
    for each in (R, lg.rotation("S")):
        w, i, j, k = each.quaternion
        generator |= {w: -k / 2, i: -j / 2, j: i / 2, k: w / 2}
    assert np.ptp(run.energy) < 1e-10
    assert np.ptp(run.evaluate(system.noether(generator))) < 1e-11


@pytest.mark.slow
def test_linear_equations_anywhere_agree_with_the_compiled_model() -> None:
    """With a coordinate, torques and an input: `linearize` compares itself with the model, and raises if it differs."""
    draw = np.random.default_rng(0)
    x, u = lg.coordinate("x"), lg.parameters("u")
    energy = R.body.dot(diag(1.1, 1.3, 1.7) * R.body) / 2 + m * (x.dot**2 + x.dot * R.space[0]) / 2
    system = lg.System(
        energy,
        m * g * x * R[2, 2] + x**2 * R[0, 1],
        parameters={m: 0.7, g: 2.0, u: 0.3},
        forces={R.space: (0.1, x, u), R.body: (0, 0, -0.1 * R.body[2])},
    )
    place = {R: lg.turn(draw.normal(size=3), 1.1), R.body: tuple(draw.normal(size=3).tolist()), x: 0.4, x.dot: -0.2}
    assert system.linearize(place, inputs=[u]).note.startswith("Away from equilibrium")


@pytest.mark.slow
def test_a_rattleback_is_unstable_in_pitch_one_way_and_in_roll_the_other() -> None:
    """Its equations are reversible: exponents of the opposite spin have the opposite sign."""
    scene = lg.scene("rattleback")
    values = dict(scene.statement.defaults)
    exponents = [
        np.linalg.eigvals(np.array(scene.linearize({"z": 0.01, R.body: (0, 0, spin)}).A.subs(values), dtype=float))
        for spin in (-5.0, 5.0)
    ]
    fast, slow = (each[np.argmax(each.real)] for each in exponents)
    assert abs(fast.imag) > 100 > 40 > abs(slow.imag) > 0 and fast.real > 10 * slow.real > 1e-3
    assert np.sort(exponents[0].real) == pytest.approx(np.sort(-exponents[1].real), abs=1e-6)


@pytest.mark.slow
def test_linear_equations_of_a_sleeping_top_in_symbols() -> None:
    """For a spinning top: x'' = ((1 - J3/J1) w^2 + m g a/J1) x + (2 - J3/J1) w y'."""
    thick = lg.parameters("J3")
    top = body((m, m, thick), (0, 0, 0), potential=a * R[2, 2], parameters={m: 1.0, a: 1.0, thick: 0.5})
    matrix = top.linearize({R.body: (0, 0, 3)}).A
    expected = sympy.Matrix([[9 * (1 - thick / m) + a / m, 0, 0], [0, 9 * (1 - thick / m) + a / m, 0], [0, 0, 0]])
    assert (matrix[3:, :3] - expected).applyfunc(sympy.simplify).is_zero_matrix
    assert sympy.simplify(matrix[3, 4] - 3 * (2 - thick / m)) == 0


@pytest.mark.slow
def test_conserved_momenta_of_a_symmetric_top() -> None:
    top = body((m, m, a), (0.1, 0.2, 3), lg.turn((1, 0, 0), 0.4), g * R[2, 2], parameters={m: 1.0, g: 1.0, a: 0.5})
    names = [quantity.name for quantity in top.conserved()]
    assert names == ["energy", "angular momentum z", "angular momentum z of the body"]
    for name, values in top.run(5.0, rtol=1e-12).invariants.items():
        assert np.ptp(values) < 1e-9, name
