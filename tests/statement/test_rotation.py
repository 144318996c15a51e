"""Statements with rotations, and energies of standard parts."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from scipy.spatial.transform import Rotation as Matrix
from sympy import cos, diag, sin

import lagrange as lg
from lagrange.dynamics.runs import starts_of
from lagrange.members.table import member_table
from lagrange.statement.coordinate import parameters
from lagrange.statement.declare import declare
from lagrange.statement.energy import gravity, kinetic_energy, rotational_energy, spring
from lagrange.statement.rotation import in_coordinates
from lagrange.statement.space import body_rates, matrix_of, space_rates
from tests.models import m, x
from tests.refusals import nested, refusal

R = lg.rotation("R")
J1, J3 = lg.parameters("J1 J3")
KINETIC = R.body.dot(diag(J1, J1, J3) * R.body) / 2
VALUES = {m: 1.0, J1: 0.02, J3: 0.01}


def top(**more: Any) -> lg.System:
    return lg.System(KINETIC, m * R[2, 2], parameters=VALUES, **more)


TOP = top()
"""The top that runs of several tests share."""


def test_a_vector_is_turned_there_and_back() -> None:
    turned = R * (1, 2, 3)
    run = TOP.run(0.1, {R: lg.turn((1, 2, 2), 0.9), R.body: (1, 2, 3)})
    assert np.allclose(run[turned], np.einsum("nij,j->in", run[R], [1, 2, 3]), rtol=0, atol=1e-14)
    assert np.allclose(run[R.T * turned], np.array([[1], [2], [3]]), rtol=0, atol=1e-13)
    assert np.allclose(run[R * R.body], run["R.space"], rtol=0, atol=1e-13)
    assert np.allclose(run[R][0], Matrix.from_rotvec(0.9 * np.array([1, 2, 2]) / 3).as_matrix(), rtol=0, atol=1e-15)


def test_rates_are_those_of_the_matrix() -> None:
    """dR/dt = R hat(body rates), entry by entry, from SymPy's derivative of R."""
    run = TOP.run(0.2, {R: lg.turn((1, 1, 0), 0.5), R.body: (1, -2, 3)})
    rates = run[R.body]
    hat = np.array([np.cross(np.eye(3), rate) for rate in rates.T]).transpose(0, 2, 1) * -1
    for i in range(3):
        for j in range(3):
            assert np.allclose(run.evaluate(R[i, j].diff(lg.t)), (run[R] @ hat)[:, i, j], rtol=0, atol=1e-12)


@pytest.mark.few(1)
@pytest.mark.parametrize("turned", [(0.1, -0.7, 0.4), (3.0, 0.2, 0.1), (0, 0, np.pi)])
def test_a_start_is_a_turn_a_matrix_or_a_quaternion(turned: Any) -> None:
    expected = Matrix.from_rotvec(turned)
    i, j, k, w = expected.as_quat()
    starts = (lg.turn(turned, float(np.linalg.norm(turned))), expected.as_matrix(), (w, i, j, k))
    for start in (*starts, sympy.Matrix(expected.as_matrix())):
        run = top(initial={R: start, R.space: (0.1, 0.2, 0.3)}).run(0.01)
        assert np.allclose(run[R][0], expected.as_matrix(), rtol=0, atol=1e-14)
        assert np.allclose(run[R.space][:, 0], [0.1, 0.2, 0.3], rtol=0, atol=1e-14)


def test_a_new_start_keeps_the_rates_about_the_axes_of_the_body() -> None:
    run = top(initial={R.body: (1, 2, 3)}).run(0.01, {R: lg.turn((0, 1, 0), 2.0)})
    assert np.allclose(run[R.body][:, 0], [1, 2, 3], rtol=0, atol=1e-14)


def test_rates_are_kept_whatever_the_length_of_the_quaternion() -> None:
    """In a long run the length of the quaternion differs from one by rounding; here by a hundredth."""
    values = dict(zip(R.quaternion, (1.01, 0, 0, 0), strict=True))
    values |= {q.dot: rate for q, rate in zip(R.quaternion, (0, 0.2, 0.4, -0.3), strict=True)}
    result = in_coordinates({R: lg.turn((1, 1, 1), 0.7)}, values)
    after = body_rates([result[q] for q in R.quaternion], [result[q.dot] for q in R.quaternion])
    assert np.allclose(after, np.array([0.4, 0.8, -0.6]) / 1.01, rtol=0, atol=1e-14)


def test_a_torque_changes_the_angular_momentum() -> None:
    """A torque about an axis of space changes the angular momentum there; one about a body axis is turned by R."""
    for forces, expected in (({R.space: (1, 2, -1)}, [0.1, 0.2, -0.1]), ({R.body: (0, 0, 2)}, [0, 0, 0.2])):
        system = lg.System(R.body.dot(R.body) / 2, forces=forces)
        assert np.allclose(system.run(0.1, rtol=1e-12)[R.space][:, -1], expected, rtol=0, atol=1e-13)


def test_a_tuple_beside_a_turned_vector_is_a_vector() -> None:
    turned, place = R * (0, 0, 2), (x, 0, 1)
    column = sympy.Matrix(place)
    assert place + turned == turned + list(place) == turned + column
    assert place - turned == column - turned
    assert turned - np.array([1, 2, 3]) == turned - sympy.Matrix([1, 2, 3])
    assert R.T * sympy.Matrix([0, 0, 2]) == R.T * (0, 0, 2)
    assert lg.kinetic_energy(m, place + turned) == lg.kinetic_energy(m, column + turned)


@pytest.mark.slow
def test_single_rates_are_keys_of_starts_forces_runs_and_pictures() -> None:
    start = top(initial={"R_body_z": 5, R.body[0]: 1}, forces={R.space[1]: 2, "R_body_z": x.subs(x, 3)}).statement
    whole = top(initial={R.body: (1, 0, 5)}, forces={R.space: (0, 2, 0), R.body: (0, 0, 3)}).statement
    assert start.initial == whole.initial
    turned = top(initial={R: (0.6, 0.8, 0, 0), R.body: (1, 0, 5)}).statement.initial
    entries = {"R_w": 0.6, R.quaternion[1]: 0.8, "R_body_z": 5, R.body[0]: 1}
    assert top(initial=entries).statement.initial == turned
    assert all(sympy.expand(a - b) == 0 for a, b in zip(start.forces, whole.forces, strict=True))
    assert start.reading is not None and whole.reading is not None and start.reading.forces == whole.reading.forces
    run = top(initial={R: lg.turn((1, 2, 0), 0.4), R.space: (1, 2, 3)}).run(0.1, {R.space[1]: 0})
    assert np.allclose(run[R.space][:, 0], [1, 0, 3], rtol=0, atol=1e-14)
    assert (run["R_space_z"] == run[R.space][2]).all() and (run[R.body[0]] == run["R_body_x"]).all()
    assert (run["R"] == run[R]).all() and (run["R_zx"] == run[R][:, 2, 0]).all()
    (axis,) = run.plot("R_body_z").axes
    assert axis.get_title(loc="left") == r"$R_{\mathrm{body}, z}$"
    assert np.allclose(np.asarray(axis.lines[0].get_ydata())[[0, -1]], run["R_body_z"][[0, -1]], rtol=1e-6)


def test_rates_vary_between_the_members_of_an_ensemble() -> None:
    model = top(initial={R: lg.turn((1, 1, 1), 0.7), R.space: (1, 2, 3)}).compile("numpy", check=False)
    for known, rates in ((body_rates, R.body), (space_rates, R.space)):
        table = member_table(model, {rates[2]: [4.0, 5.0], rates[0].func.__name__: [0.1, 0.2]}, None)
        states = table.starts(np.arange(2)).states
        result = np.array(known([*states[:, :4].T], [*states[:, 4:].T]))
        assert np.allclose(result[[0, 2]], [[0.1, 0.2], [4.0, 5.0]], rtol=0, atol=1e-14)
        assert np.allclose(np.linalg.norm(states[:, :4], axis=1), 1, rtol=0, atol=1e-15)


EULER = J1 * R.body[0].diff(lg.t) - (J1 - J3) * R.body[1] * R.body[2] - m * R[2, 1]
OTHERS = "J1*R_body_y' + (J1 - J3)*R_body_x*R_body_z = -m*R_zx", "d/dt(J3*R_body_z) = 0"


@pytest.mark.slow
def test_equations_are_written_and_compared_in_rates() -> None:
    system = TOP
    assert sympy.expand(system.equations()[0].lhs - EULER) == 0
    assert system.momenta[R.turns[2]] == J3 * R.body[2]
    assert system.compare([EULER, *OTHERS])
    left = "2 equations are given and 3 are needed: the acceleration of R is left open"
    assert left in system.compare(OTHERS).message


y = lg.coordinate("y")


SCENE = """
name = "top"
rotations = ["R"]
kinetic = "J*(R_body_x**2 + R_body_y**2 + R_body_z**2)/2"
potential = "k*R_zz"
[parameters]
J = 2.0
k = 1.0
[initial]
R_body_x = 0.2
"""


def test_a_scene_names_entries_and_rates(tmp_path: Path) -> None:
    (tmp_path / "top.toml").write_text(SCENE)
    run = lg.System.from_scene(tmp_path / "top.toml").run(1.0)
    assert np.allclose(run[R.body][:, 0], [0.2, 0, 0])
    assert "J*R_body_x_dot - k*R_zy = 0" in lg.System.from_scene(tmp_path / "top.toml").derivation().text()
    (tmp_path / "bad.toml").write_text(SCENE.replace('["R"]', '"R"'))
    with pytest.raises(lg.SceneError, match=r"rotations must be a list of names"):
        lg.System.from_scene(tmp_path / "bad.toml")
    (tmp_path / "bad.toml").write_text(SCENE.replace('["R"]', '["R", "R"]'))
    with pytest.raises(lg.SceneError, match=r"rotations names 'R' twice"):
        lg.System.from_scene(tmp_path / "bad.toml")
    (tmp_path / "bad.toml").write_text(SCENE + "R_w = 0.8\n")
    with pytest.raises(lg.SceneError, match=r"bad\.toml:9:2: the start of R is a quaternion of length 0\.8"):
        lg.System.from_scene(tmp_path / "bad.toml")


def anything(value: Any) -> Any:
    """Return a value of a type that a function does not accept."""
    return value


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a sum": (lambda: R + 1, "use its entries"),
    "two entries": (lambda: R * (1, 2), "turns a vector of three entries, not 2 entries"),
    "right of its vector": (lambda: sympy.Matrix([1, 2, 3]) * R, "it stands left of the vector"),
    "a long quaternion": (lambda: top(initial={R: (1, 1, 0, 0)}), "a quaternion of length 1.41421"),
    "a matrix that stretches": (lambda: top(initial={R: np.diag([1, 1, 2])}), "differs from the unit matrix by 3"),
    "velocities that stretch": (lambda: top(initial={"R_w_dot": 0.5}), "change the length of the quaternion"),
    "modes of a spin": (lambda: TOP.modes({R.body: (0, 0, 1)}), "modes and equilibria are those of a body at rest"),
    "a reset to a long quaternion": (
        lambda: TOP.run(0.1, events=lg.event(R[2, 2], reset={R: (1, 1, 0, 0)})),
        "the reset of R is a quaternion of length 1.41421",
    ),
    "an entry without a value": (
        lambda: top(initial={R: [1.0, 0.0, 0.0, sympy.Lambda(m, m)]}),
        r"the start of R is \[1.0, 0.0, 0.0, Lambda\(",
    ),
    "a deep rate": (lambda: top(initial={R.body: (nested(x, 350), 0, 0)}), "nested too deeply for SymPy"),
    "two rates": (lambda: top(initial={R.body: (1, 2)}), "give its components about the axes x, y and z"),
    "a turn and an entry": (lambda: top(initial={R: (1, 0, 0, 0), "R_w": 1}), "gives both R and R_w: give one"),
    "a torque on R": (lambda: top(forces={R: (1, 0, 0)}), "give torques on R.body or .space"),
    "a rate twice": (lambda: top(initial={R.body: (1, 2, 3), "R_body_x": 1}), "initial names R_body_x twice"),
    "its velocity": (lambda: R.dot, "its rates are R.body and R.space, and the rates of these R.body.diff"),
    "a product with NaN": (lambda: R.T * np.float32(np.nan), "is neither a number nor a vector"),
    "two entries beside a vector": (lambda: (1, 2) + R * lg.x, r"a vector in space is \(1, 2\): give three entries"),
    "an unknown row": (lambda: TOP.run(0.1)["R_a"], "neither a coordinate nor a velocity.*they are R and R.body"),
    "members of another length": (
        lambda: lg.ensemble(TOP, 0.1, initial={"R_x": [0.0, 0.5]}),
        "the start of R is a quaternion of length 1.11803",
    ),
    "starts of another length": (
        lambda: starts_of(TOP.compile("numpy", check=False), [[1, 0, 0, 0.5, 0, 0, 0, 0]], np.zeros(8)),
        "the start of R is a quaternion of length 1.11803",
    ),
    "a moment above the sum": (
        lambda: lg.System(R.body.dot(diag(1, 1, 3) * R.body) / 2),
        "the moments of inertia of R are 1, 1 and 3",
    ),
    "a moment above the sum at a run": (
        lambda: lg.System(R.body.dot(diag(1, 1, m) * R.body) / 2).run(1.0, parameters={m: 3}),
        "the moments of inertia of R are 1, 1 and 3",
    ),
    "a moment above the sum in a member": (
        lambda: lg.ensemble(
            lg.System(R.body.dot(diag(1, 1, m) * R.body) / 2, parameters={m: 1}), 0.1, parameters={m: [1.0, 1.5, 2.5]}
        ),
        "the moments of inertia of R are 1, 1 and 2.5",
    ),
    "a power of a vector": (lambda: R.body**2, r"its square is a.dot\(a\), such as R.body.dot\(R.body\)"),
    "a start that is off": (
        lambda: TOP.run(0.1, {R: np.eye(3) + 4e-4 * np.eye(3, k=1)}),
        r"differs from the unit matrix by 0.0004. Give all digits, .* nearest rotation: u @ vh",
    ),
    "a sum with a number": (lambda: R.body + 1, "a vector or matrix and 1 have no sum: give three entries"),
    "an absolute rate": (lambda: lg.System(abs(R.body[0])), "singular where R.body is zero"),
    "a place that is no dict": (lambda: TOP.linearize(anything(R)), "at is a Rotation: give a dict"),
    "a root that is singular at rest": (
        lambda: lg.System(sympy.sqrt(R.body.dot(R.body))),
        "a root or a quotient that is singular where R.body is zero",
    ),
    "no inertia": (lambda: lg.System(m * x.dot**2 / 2, R[0, 0]), "gives R no inertia at rest: add its energy"),
    "no inertia about an axis": (
        lambda: lg.System(R.body.dot(diag(J1, J1, 0) * R.body) / 2).compile(),
        "R has no inertia about the axis z of its body.* constrain this motion",
    ),
    "no inertia about a held axis": (
        lambda: lg.System(R.body.dot(diag(J1, J1, 0) * R.body) / 2, constraints={"held": R.body[0]}).compile(),
        "a motion with R_body_z = 1 satisfies the constraints and has no inertia",
    ),
    "a torque with the dimension of a force": (
        lambda: top(forces={R.space: (0, m**2, 0)}, dimensions={m: "energy"}),
        r"the torque on R_body_x has the term R_yx\*m\*\*2, whose dimension is .*; it should be energy",
    ),
    "an energy with the dimension of a force": (
        lambda: top(dimensions={m: "force"}),
        r"the potential energy has the term R_zz\*m, whose dimension is force",
    ),
    "Hamilton's equations": (TOP.hamiltonian, "are not written out for rotations"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_meaning_is_refused(case: str) -> None:
    attempt, sentence = REFUSED[case]
    assert re.search(sentence, refusal(attempt))


def test_a_product_of_turns_turns_by_the_right_one_first() -> None:
    both = lg.turn((1, 0, 0), 0.7) * lg.turn((0, 0, 1), 0.4)
    matrices = [np.array(matrix_of(part), dtype=float) for part in (lg.turn((1, 0, 0), 0.7), lg.turn((0, 0, 1), 0.4))]
    assert np.array(matrix_of(both), dtype=float) == pytest.approx(matrices[0] @ matrices[1], abs=1e-15)
    assert TOP.run(0.1, {R: both}).status is lg.Status.SUCCESS


@pytest.mark.slow
def test_an_inertia_that_is_constant_in_space_is_remarked() -> None:
    tensor = diag(1, 2, 2)
    (said,) = lg.System(R.space.dot(tensor * R.space) / 2).statement.remarks()
    assert "The inertia of R is constant about the axes of space" in said and "about its own axes, R.body." in said
    for energy in (2 * R.space.dot(R.space), R.space.dot(R * (tensor * (R.T * R.space)))):
        assert not lg.System(energy / 2).statement.remarks()


def test_a_rotation_is_held_with_its_rates() -> None:
    tied = lg.System(KINETIC, constraints={"upright": R[2, 2] - sympy.cos(0.3)}, parameters=VALUES)
    start = {R: lg.turn((1, 0, 0), 0.31), R.body: (0, 0, 2)}
    assert "upright" in refusal(tied.consistent, start, hold=[R])
    kept = tied.consistent({R: lg.turn((1, 0, 0), 0.3), R.body: (0, 0, 2)}, hold=[R.body])
    assert kept.moved == 0


@pytest.mark.slow
def test_messages_on_events_name_entries_and_rates() -> None:
    event = lg.event(R[2, 2] + R.body[0] - sympy.log(R[0, 2] - 3))
    assert "R_body_x + R_zz - log(R_xz - 3) is nan" in TOP.run(1.0, events=event).message
    with pytest.raises(lg.StatementError, match="it may contain its coordinates, their velocities and t"):
        lg.System(R.body.dot(R.body)).run(1.0, events=x)


SPEED = sympy.sqrt(R.body.dot(R.body))


@pytest.mark.parametrize(
    ("stated", "what"),
    [
        ({"forces": {R.body: tuple(-rate / SPEED for rate in R.body)}}, "a force"),
        ({"forces": {R.space: tuple(-rate / SPEED for rate in R.space)}}, "a force"),
        ({"dissipation": SPEED}, "the dissipation"),
        ({"dissipation": sympy.sqrt(R.space.dot(R.space))}, "the dissipation"),
        ({"potential": SPEED}, "or the potential energy"),
    ],
)
def test_a_root_of_the_rates_that_is_singular_at_rest_is_refused(stated: dict[str, Any], what: str) -> None:
    with pytest.raises(lg.StatementError, match=f"{what}.* has a root or a quotient that is singular where R.body is"):
        lg.System(KINETIC, **stated)


def test_roots_of_the_rates_that_are_smooth_at_rest_are_not_refused() -> None:
    for drag in (SPEED**3 + abs(R.body[2]), sympy.sqrt(R.body.dot(R.body) + 0.01) + abs(R.space[2]) ** 1.5):
        lg.System(KINETIC, dissipation=drag, forces={R.body: tuple(-rate * SPEED for rate in R.body)})


@pytest.mark.slow
def test_an_energy_that_is_not_quadratic_in_the_rates_has_no_moments_to_judge() -> None:
    rates = R.body.dot(R.body)
    assert lg.System(rates + sympy.sqrt(1 + 100 * R.body[0] ** 2)).check(points=1)


@pytest.mark.slow
def test_a_rate_coupled_to_another_velocity_is_no_moment_of_the_body() -> None:
    """A ball of moment 0.1 drives a mass of 5 by a belt, so the energy about y has the coefficient 5.1."""
    kinetic = R.body.dot(R.body) / 20 + 5 * (x.dot + R.space[1]) ** 2 / 2
    run = lg.System(kinetic + x.dot**2 / 2, initial={R.space: (0, 1, 0)}).run(1.0)
    # Momenta are conserved: x.dot = 0 and R.space[1] = 1 stay.
    assert abs(run[R.space][1, -1] - 1) < 1e-9 and abs(run[x.dot][-1]) < 1e-9


def test_a_start_names_a_rotation_by_its_text() -> None:
    expected = TOP.run(0.1, {R: lg.turn((1, 2, 3), 0.4), R.space: (1, 2, 3)}).y
    assert np.array_equal(TOP.run(0.1, {"R": lg.turn((1, 2, 3), 0.4), "R.space": (1, 2, 3)}).y, expected)


@pytest.mark.parametrize("length", [1e-200, 1e300])
def test_an_axis_has_any_length(length: float) -> None:
    """An axis of any length is allowed, even if its square overflows."""
    assert lg.turn((0, length, 0), math.pi) == pytest.approx((0, 0, 1, 0), abs=1e-15)


def test_a_rotation_turns_a_matrix() -> None:
    """R J R^T is the inertia in axes of space: w . (R J R^T) w = W . J W with w = R W."""
    inertia = diag(1, 2, 2.5)
    run = TOP.run(0.1, {R: lg.turn((1, 2, 3), 0.4), R.body: (1, 2, 3)})
    for given in (inertia, np.diag([1, 2, 2.5])):
        in_space = run.evaluate(R.space.dot(R * given * R.T * R.space))
        assert np.allclose(in_space, run.evaluate(R.body.dot(inertia * R.body)), rtol=1e-13)


def test_an_event_sets_rates_and_attitude() -> None:
    """An event reverses the rates of a free body, which then turns back."""
    free = lg.System(R.body.dot(diag(1, 2, 2.5) * R.body) / 2, initial={R: lg.turn((1, 2, 3), 0.4), R.body: (1, 3, 2)})
    back = free.run(2.0, events=[lg.event(lg.t - 1, reset={R.body: -R.body})], rtol=1e-13)
    assert np.abs(back[R][-1] - back[R][0]).max() < 1e-12
    turned = free.run(1.0, events=[lg.event(lg.t - 0.5, reset={R: lg.turn(lg.x, 0.1), R.body[2]: 0})], rtol=1e-13)
    i, j, _ = free.run(0.5, rtol=1e-13)[R.body][:, -1]
    after = free.run(0.5, {R: lg.turn(lg.x, 0.1), R.body: (i, j, 0)}, rtol=1e-13)
    assert np.abs(turned[R][-1] - after[R][-1]).max() < 1e-12
    with pytest.raises(lg.StatementError, match=r"the reset gives both R.body and R.space"):
        lg.event(lg.t - 1, reset={R.body: (0, 0, 0), R.space: (0, 0, 0)})


def test_a_violated_constraint_is_quoted_as_it_is_typed() -> None:
    held = top(constraints={"spin": R.space[2] - R.body[2]})
    with pytest.raises(lg.StatementError, match=r"'spin' \((-R_body_z \+ R_space_z|R_space_z - R_body_z)\) is"):
        held.run(1.0, {R: lg.turn(lg.x, 1), R.body: (0, 0, 1)})


# --- energies of standard parts, such as springs and rods ------------------------------------------------------


theta = lg.coordinate("theta")

g, l, k, a = parameters("g l k a")
w1, w2, w3 = parameters("w1 w2 w3")
i1, i2, i3 = parameters("i1 i2 i3")


def zero(expression: Any) -> bool:
    return bool(sympy.simplify(expression) == 0)


def test_kinetic_energy_squares_the_velocity() -> None:
    assert kinetic_energy(m, [x, y]) == m * (x.dot**2 + y.dot**2) / 2
    assert kinetic_energy(m, (x,)) == kinetic_energy(m, x) == m * x.dot**2 / 2
    assert zero(kinetic_energy(m, [l * sin(theta), -l * cos(theta)]) - m * l**2 * theta.dot**2 / 2)
    assert kinetic_energy(2, sympy.Matrix([x, y, 3, 0.5])) == x.dot**2 + y.dot**2


def test_rotational_energy_of_a_scalar_of_moments_and_of_a_tensor() -> None:
    assert rotational_energy(i1, theta.dot) == i1 * theta.dot**2 / 2
    assert zero(rotational_energy([i1, i2, i3], [w1, w2, w3]) - (i1 * w1**2 + i2 * w2**2 + i3 * w3**2) / 2)
    assert zero(rotational_energy(i1, [w1, w2]) - i1 * (w1**2 + w2**2) / 2)
    tensor = [[i1, k], [k, i2]]
    expected = (i1 * w1**2 + 2 * k * w1 * w2 + i2 * w2**2) / 2
    assert zero(rotational_energy(tensor, [w1, w2]) - expected)
    assert zero(rotational_energy(sympy.Matrix(tensor), sympy.Matrix([w1, w2])) - expected)
    assert zero(rotational_energy(sympy.Matrix([i1, i2]), [w1, w2]) - (i1 * w1**2 + i2 * w2**2) / 2)


def test_gravity_takes_the_height_along_up() -> None:
    assert gravity(m, [x, y], g) == m * g * y
    assert gravity(m, [x, y, theta], g) == m * g * theta
    assert gravity(m, [x, y], g, up=[1, 0]) == m * g * x
    assert gravity(m, [x, y], g, up=(0, -2)) == -m * g * y
    assert zero(gravity(m, [x, y], g, up=[3, 4]) - m * g * (3 * x + 4 * y) / 5)
    assert gravity(m, x, g) == m * g * x


def test_a_spring_has_a_rest_length() -> None:
    assert spring(k, [x, y], [0, 0]) == k * (x**2 + y**2) / 2
    assert zero(spring(k, [x, y], [0, 0], l) - k * (sympy.sqrt(x**2 + y**2) - l) ** 2 / 2)
    assert spring(k, x, y) == k * (x - y) ** 2 / 2
    assert spring(k, [x, y], [1, 2], 0.0) == k * ((x - 1) ** 2 + (y - 2) ** 2) / 2


def test_a_spring_with_one_end_goes_to_the_origin() -> None:
    assert spring(k, x) == k * x**2 / 2
    assert spring(k, [x, y], rest_length=l) == spring(k, [x, y], [0, 0], l)


def test_a_rate_may_be_made_of_an_angle() -> None:
    assert rotational_energy(i1, k * sympy.sin(x)) == i1 * k**2 * sympy.sin(x) ** 2 / 2
    assert rotational_energy(i1, k * x + y.dot) == i1 * (k * x + y.dot) ** 2 / 2
    assert rotational_energy(i1, k * lg.t + y.dot) == i1 * (k * lg.t + y.dot) ** 2 / 2
    assert rotational_energy(i1, sympy.sin(x) / 2) == i1 * sympy.sin(x) ** 2 / 8
    assert rotational_energy(i1, sympy.sin(x) * y.dot) == i1 * sympy.sin(x) ** 2 * y.dot**2 / 2
    assert rotational_energy(i1, [k, lg.given("w")]) == i1 * k**2 / 2 + i1 * lg.given("w") ** 2 / 2


def test_what_is_stated_is_real() -> None:
    assert declare(kinetic=x.dot**2, potential=sympy.Abs(sympy.exp(k * x))).potential == sympy.exp(k * x)
    assert declare(kinetic=x.dot**2, potential=sympy.Abs(x * sympy.exp(x))).potential == sympy.Abs(x) * sympy.exp(x)
    shortened = declare(kinetic=kinetic_energy(m, sympy.Abs(x) * sympy.exp(x))).kinetic
    slope = sympy.exp(x) * (sympy.Abs(x) + sympy.sign(x))
    assert zero(shortened - m * (slope * x.dot) ** 2 / 2)


REFUSALS: list[tuple[Any, str]] = [
    (lambda: kinetic_energy(m, "x"), "the position is the text 'x': give SymPy expressions."),
    (lambda: kinetic_energy(m, (y, x.dot)), "the position contains x.dot, a rate: give the place in x, or write the"),
    (lambda: kinetic_energy(m, y * x.ddot), "the position contains x.ddot, an acceleration: give the place in x"),
    (lambda: kinetic_energy(m, (nested(x, 350), y)), "nested too deeply for SymPy: give symbols to its inner parts"),
    (lambda: kinetic_energy(m, []), "the position is empty: give at least one component."),
    (lambda: gravity(m, [x, y], g, up=[0, 0, 1]), "up has 3 components and the position 2: give both the same number "),
    (lambda: rotational_energy(i1, x), "the angular velocity is x, an angle: give its rate, such as x.dot."),
    (lambda: rotational_energy(i1, y.dot + x), "the angular velocity has the term x, an angle: give its rate, such as"),
    (lambda: rotational_energy(i1, x.dot * (y + x.dot)), "has the term x.dot**2 in x.dot*(x.dot + y), a product of"),
    (lambda: rotational_energy(i1, sympy.sin(x)), "the angular velocity is sin(x), a number without a rate: give its"),
    (lambda: rotational_energy(i1, y.dot + k / l * sympy.sin(x)), "the angular velocity has the term k*sin(x)/l, a nu"),
    (lambda: rotational_energy(i1, [0, 0, x.ddot]), "component 2 of the angular velocity contains x.ddot, an accelera"),
    (lambda: rotational_energy(i1, k * lg.t), "the angular velocity is k*t, an angle or its function: give its rate,"),
    (lambda: rotational_energy(i1, y.dot + x.dot**2), "the angular velocity has the term x.dot**2, a product of"),
    (lambda: rotational_energy(i1, [0, 0, lg.rotation("R").body[2] ** 2]), "the term R_body_z**2, a product of rates"),
    (lambda: rotational_energy([1, -2, 1], [w1, w2, w3]), "the inertia has the moment -2 below zero, which no body"),
    (lambda: rotational_energy([[1, 2], [2, 1]], [w1, w2]), "the inertia has a principal moment below zero"),
    (lambda: rotational_energy([[i1, k], [0, i2]], [w1, w2]), "the inertia is not symmetric: entry (0, 1) is k, and"),
    (lambda: spring(k, [x, y], [0]), "the ends of the spring have 2 and 1 components: give both the same number of co"),
]


@pytest.mark.parametrize(("call", "message"), REFUSALS, ids=[message[:30] for _, message in REFUSALS])
def test_refusals(call: Any, message: str) -> None:
    assert message in refusal(call)
