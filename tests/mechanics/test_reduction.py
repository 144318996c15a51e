"""Smaller and other forms with the same motion: eliminated and new coordinates, Routh's procedure."""

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, exp, pi, sin, sqrt

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.mechanics import transformation
from lagrange.mechanics import transformation as routh
from lagrange.statement.statement import Link
from tests.refusals import refusal

m, g, l, a, c = lg.parameters("m g l a c")
x, y, z, u, theta = lg.coordinates("x y z u theta")
ROD = x**2 + y**2 - l**2


def bead() -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints={"wire": y - a * x**2},
        dissipation=c * y.dot**2 / 2,
        forces={y: -l, x: -x},
        parameters={m: 1.2, g: 9.81, a: 0.7, c: 0.1, l: 0.3},
        initial={x: 0.6, y: 0.252, x.dot: 0.2, y.dot: 2 * 0.7 * 0.6 * 0.2},
        positions={"bead": (x, y)},
        links=[("origin", "bead")],
        name="bead",
    )


def test_a_bead_keeps_one_coordinate_and_all_that_was_stated() -> None:
    small = bead().eliminate(y).statement
    assert small.names == ("x",)
    assert small.constraints == ()
    assert sympy.expand(small.kinetic - m * (x.dot**2 + (2 * a * x * x.dot) ** 2) / 2) == 0
    assert sympy.expand(small.potential - m * g * a * x**2) == 0
    assert sympy.expand(small.dissipation - c * (2 * a * x * x.dot) ** 2 / 2) == 0
    assert sympy.expand(small.forces[0] - (-x - 2 * l * a * x)) == 0
    assert small.positions["bead"] == (x, a * x**2)
    assert small.links == (Link("origin", "bead"),)
    assert small.initial == (0.6, 0.2)
    assert small.defaults == bead().statement.defaults
    assert small.name == "bead"


@pytest.mark.parametrize("key", [y, "y", "wire"])
def test_coordinates_and_constraints_are_named_alike(key: Any) -> None:
    assert bead().eliminate(key).statement.names == ("x",)


@pytest.mark.parametrize(
    ("initial", "words"),
    [
        ({x: 0.6, y: -0.8}, "y is -0.8 there, and 0.8"),
        ({x: 0.6, y: 0.8, x.dot: 1.0, y.dot: 0.75}, "y.dot is 0.75 there, and -0.75"),
        ({x: 1.0, y.dot: 0.5}, "y.dot is 0.5 there, and undefined by"),
        ({x: 1.2, y: 0.8}, "y is 0.8 there, and 0.663325*I by"),
    ],
)
def test_a_branch_that_the_motion_does_not_start_on_is_refused(initial: Any, words: str) -> None:
    rod = lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2, constraints={"rod": ROD}, parameters={m: 1, l: 1}, initial=initial
    )
    message = refusal(rod.eliminate, {y: sqrt(l**2 - x**2)})
    assert message.startswith("y = 'sqrt(l**2 - x**2)' does not hold at the initial state: " + words)
    assert "Give the expression of the branch that is meant, or other initial values." in message


def test_initial_values_that_were_not_given_follow_from_the_branch() -> None:
    """Stated initial values may be rounded; missing ones follow from the branch."""
    stated: dict[str, Any] = {"kinetic": x.dot**2 + y.dot**2, "constraints": {"rod": ROD}, "parameters": {l: 1}}
    for initial in ({x: 0.6, x.dot: 1.0}, {x: 1 / 3, y: 0.942809}):
        small = lg.System(**stated, initial=initial).eliminate({y: sqrt(l**2 - x**2)})
        assert small.statement.initial == (initial[x], initial.get(x.dot, 0.0))


def test_a_lagrangian_stays_one() -> None:
    system = lg.System(lagrangian=x.dot**2 / 2 + y.dot**2 / 2 - x * y, constraints=[y - 2 * x])
    small = system.eliminate(y).statement
    assert small.potential == 0
    assert sympy.expand(small.lagrangian - (5 * x.dot**2 / 2 - 2 * x**2)) == 0


# --- the law -----------------------------------------------------------------------------------------------------


def random_system(seed: int) -> tuple[lg.System, Any, bool]:
    """Return a system, the expression of y by its random constraint, and whether that is surely always defined."""
    draw = np.random.default_rng(seed)

    def number() -> Any:
        return sympy.Rational(int(draw.integers(1, 9)), int(draw.integers(1, 9))) * int(draw.choice([-1, 1]))

    inner = [x, z, x * z, sin(x), cos(z), x**2, lg.t, exp(-(z**2)), x * lg.t]
    shape = sum(number() * inner[int(i)] for i in draw.choice(len(inner), 3, replace=False))
    kind = int(draw.integers(5))
    factor = [number(), a, 1 + x**2, exp(z), 2 + cos(x)][kind]
    velocities = (x.dot, y.dot, z.dot)
    kinetic = sum(abs(number()) * v**2 for v in velocities) + x.dot * z.dot * cos(y) / 9 + y.dot * x.dot * z / 99
    potential = number() * y**2 + number() * sin(y * x) + number() * z * y
    system = lg.System(
        kinetic=kinetic,
        potential=potential,
        coordinates=[x, y, z],
        constraints={"tie": factor * y - shape},
        forces={x: number() * y * x.dot, y: number() * z.dot + y, z: number() * lg.t},
        dissipation=abs(number()) * y.dot**2 / 2 + abs(number()) * (x.dot - y.dot) ** 2 / 4,
        parameters={a: 1.4},
    )
    return system, shape / factor, kind < 4


@pytest.mark.few
@pytest.mark.parametrize("seed", range(24))
def test_the_smaller_system_has_the_same_accelerations(seed: int) -> None:
    system, solved, safe = random_system(seed)
    small = system.eliminate(y if safe else {y: solved})
    q, v, t = np.array([0.4, -0.7]), np.array([0.3, 0.9]), 0.6
    model = small.compile(check=False)
    state = np.concatenate([q, v])[:, None]
    value = float(model.evaluate_expression(solved, [t], state)[0])
    rate = solved.diff(lg.t)
    speed = float(model.evaluate_expression(rate, [t], state)[0])
    whole = system.compile(check=False).accelerations([q[0], value, q[1]], [v[0], speed, v[1]], t)
    # Ten digits are right where a hundred operations cancel; a term that is missing is a hundredth at least.
    np.testing.assert_allclose(model.accelerations(q, v, t), whole[[0, 2]], rtol=1e-10, atol=1e-10)


# --- refusals ----------------------------------------------------------------------------------------------------


def pair(**constraints: Any) -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2 + theta.dot**2) / 2, coordinates=[x, y, theta], constraints=constraints
    )


@pytest.mark.parametrize(
    ("constraints", "expected", "words"),
    [
        ({"rod": ROD}, (), "eliminate() has no arguments: give a coordinate that a constraint determines."),
        ({"rod": ROD}, (z,), "'z' is not a coordinate of this system; they are x, y and theta."),
        ({"rod": ROD}, (y,), "rod does not determine y safely: it is not linear in y, so that y may have several"),
        ({"arm": x * y - theta * cos(x)}, (theta,), "arm does not determine theta safely: the coefficient of theta"),
        ({"rod": ROD}, ("rod",), "the constraint rod determines no coordinate safely: in no coordinate is it linear"),
        ({"roll": x.dot - y * theta.dot}, (x,), "x is in no constraint on positions: roll is a constraint on"),
        ({"roll": x.dot - y * theta.dot}, ("roll",), "the constraint roll determines no coordinate: roll is a"),
        ({"rod": ROD}, ({y: l - x},), "y = 'l - x' does not solve a constraint: give a solution of one of rod, the"),
        ({"rod": ROD}, ({y: y + x},), "the value of y is 'x(t) + y(t)': give an expression in the other coordinates,"),
        ({"tie": y - x, "same": theta - x}, (y, theta, x), "x is the only coordinate left: keep it, because a"),
    ],
)
def test_what_cannot_be_eliminated_is_refused(constraints: Any, expected: Any, words: str) -> None:
    assert refusal(pair(**constraints).eliminate, *expected).startswith(words)


@pytest.mark.parametrize("expected", [y, "floor", {y: 0}])
def test_a_multiplier_in_a_force_keeps_its_constraint(expected: Any) -> None:
    """The message was "a force contains lambda[floor], but system has no constraints"."""
    block = lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints={"floor": y},
        forces={x: -c * lg.multiplier("floor") * sympy.sign(x.dot)},
    )
    assert "the force on x contains the multiplier of floor, which has no value" in refusal(block.eliminate, expected)


def test_a_branch_has_to_hold_near_the_initial_state_alone() -> None:
    roof = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=g * y,
        constraints={"roof": y - sympy.Abs(x)},
        parameters={g: 1},
        initial={x: -1, y: 1},
    )
    assert roof.eliminate({y: -x}).accelerations() == {x: g / 2}
    assert "y = 'x' does not solve a constraint" in refusal(roof.eliminate, {y: x})


# --- routh's procedure: the reduced system has the motion of the whole, and ignored coordinates are recovered ---


I1, I3, k = lg.parameters("I1 I3 k")

phi, psi = lg.coordinates("phi psi")


def top() -> lg.System:
    tip = (l * sin(theta) * sin(phi), -l * sin(theta) * cos(phi), l * cos(theta))
    return lg.System(
        kinetic=I1 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2 + I3 * (psi.dot + cos(theta) * phi.dot) ** 2 / 2,
        potential=m * g * l * cos(theta),
        coordinates=[theta, phi, psi],
        dissipation=c * theta.dot**2 / 2,
        parameters={I1: 1, I3: 0.4, m: 1, g: 9.81, l: 0.3, c: 0.01},
        initial={theta: 0.6, phi: 0.2, psi.dot: 12.0, phi.dot: -0.4},
        positions={"tip": tip, "height": (0, 0, l * cos(theta))},
        links=[("origin", "tip"), ("origin", "height")],
        name="top",
    )


@pytest.mark.slow
def test_a_top_runs_alike_and_its_angles_come_back() -> None:
    system = top()
    small = system.routhian(phi, psi)
    assert small.statement.names == ("theta",)
    assert small.statement.links == (Link("origin", "height"),)
    whole = system.run(4.0, rtol=1e-12)
    part = small.run(4.0, rtol=1e-12)
    # Both err by some 1e-12 a step, at speeds of 12 a second.
    assert part[theta][-1] == pytest.approx(whole[theta][-1], abs=1e-9)
    result = system.ignored(part)
    for key in (phi, psi, phi.dot, psi.dot):
        row = whole.at(part.t)[whole.names.index(f"{key.expr.func}_dot" if key.is_Derivative else str(key.func))]
        np.testing.assert_allclose(result[key], row, atol=1e-9 * (1 + np.abs(row).max()))


def test_one_after_the_other_is_both_at_once() -> None:
    once, twice = top().routhian("psi", "phi"), top().routhian("psi").routhian(phi)
    assert sympy.simplify(once.statement.potential - twice.statement.potential) == 0
    assert once.parameters == pytest.approx(twice.parameters)


def test_a_term_that_is_linear_in_velocities_stays() -> None:
    """The momentum of x is m (x.dot + k y): gyroscopic terms and a potential in y alone."""
    system = lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2 + c * x.dot * y.dot,
        potential=-m * k * y * x.dot,
        coordinates=[x, y],
        forces={y: -k * x.dot},
        parameters={m: 1.1, k: 0.7, c: 0.2},
        initial={y: 0.3, x.dot: 1.0, y.dot: 0.1},
    )
    small = system.routhian(x)
    first, second = system.run(2.0, rtol=1e-12), small.run(2.0, rtol=1e-12)
    assert second[y][-1] == pytest.approx(first[y][-1], abs=1e-11)
    assert system.ignored(second)[x][-1] == pytest.approx(first[x][-1], abs=1e-11)


def plain(**more: Any) -> lg.System:
    return lg.System(m * (x.dot**2 + y.dot**2) / 2, coordinates=[x, y], name="pair", **more)


@pytest.mark.parametrize(
    ("make", "expected", "words"),
    [
        (plain, (), "routhian() has no arguments: give a coordinate that is ignorable."),
        (plain, (x, y), "every coordinate of pair would be ignored: leave out one of them, which then"),
        (lambda: plain(dissipation=c * x.dot**2 / 2), (x,), "x is not ignorable: the force '-c*Derivative(x(t), t)"),
        (lambda: plain(constraints={"tie": x - y}), (x,), "x is not ignorable: the constraint 'tie' acts on it. elimi"),
        (lambda: plain(forces={y: -x}), (x,), "x is not ignorable: the force on y depends on it. Choose another coord"),
        (
            lambda: lg.System(lagrangian=(x.dot + y.dot) ** 2 / 2 + x.dot * theta.dot + theta.dot**2 - theta**2),
            (x, y),
            "the Lagrangian of system has no Legendre transform: the determinant of d2L/dv2 of ",
        ),
        (
            lambda: lg.System(lagrangian=x.dot**4 + x.dot**2 + y.dot**2 / 2 - y**2),
            (x,),
            "the momenta of x are not linear in the velocities of x, so routhian() cannot solve for these: ",
        ),
    ],
)
def test_refusals(make: Any, expected: Any, words: str) -> None:
    assert refusal(make().routhian, *expected).startswith(words)


def test_a_run_of_another_system_is_refused() -> None:
    for run in (plain().run(0.1, parameters={m: 1}), 7):
        assert "this is not a run of a Routhian of pair: run routhian(...) of" in refusal(plain().ignored, run)


@pytest.mark.slow
def test_a_velocity_that_varies_too_fast_is_not_rebuilt() -> None:
    system = lg.System((x.dot**2 + y.dot**2) / 2, sympy.Rational(1, 2) * 10**8 * x**2 - x * y.dot, initial={x: 1.0})
    run = system.routhian(y).run(1.0, rtol=1e-6, t_eval=[0.0, 1.0])
    with pytest.raises(RunError, match="y cannot be computed to 1e-12: its velocity varies too fast between the"):
        system.ignored(run)


def test_a_wrong_routhian_is_found_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routh, "half_square", lambda mass, inverted, column: column[0] ** 2 / I1)
    with pytest.raises(RunError, match=r"the Routhian of top is wrong: a formula gives .* where .* is compiled, at th"):
        top().routhian(phi)


# --- new coordinates: the same motion in them, forces of equal work, and initial states that are solved for ----


w, mu = lg.parameters("w mu")

r, X, Y = lg.coordinates("r X Y")


def particle(**more: Any) -> lg.System:
    stated: dict[str, Any] = {
        "forces": {x: -c * y, y: -z.dot},
        "dissipation": c * (x.dot**2 + y.dot**2) / 2,
        "parameters": {m: 1.3, c: 0.1, w: 0.3, g: 2.0},
        "initial": {x: 1.0, y.dot: 2.0, z: 1.0},
        "positions": {"body": (x, y, z)},
        **more,
    }
    return lg.System(m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, m * g * z, coordinates=[x, y, z], **stated)


away, turn = lg.coordinates("away turn")  # of no other test, which might declare them in another order

TURNING = {x: X * cos(w * lg.t) - Y * sin(w * lg.t), y: X * sin(w * lg.t) + Y * cos(w * lg.t)}
ROUND = {x: r * cos(phi), y: r * sin(phi)}
BALL = {x: r * sin(theta) * cos(phi), y: r * sin(theta) * sin(phi), z: r * cos(theta)}


@pytest.mark.few(1)
@pytest.mark.parametrize("given", [TURNING, ROUND, BALL, {z: exp(u / 3) - 2}, {"x": u + z}], ids=str)
def test_the_motion_is_the_same(given: Any) -> None:
    system = particle()
    new = system.transform(given)
    first, second = system.run(1.5, rtol=1e-12), new.run(1.5, rtol=1e-12)
    for row, point in enumerate(new.statement.positions["body"]):
        # Both err by some 1e-12 a step.
        assert second.evaluate(point)[-1] == pytest.approx(first.y[row, -1], abs=1e-10)


def test_a_name_that_stays_takes_the_force_on_its_new_meaning() -> None:
    new = particle().transform({x: x + y, y: x - y})
    # The forces (-c y, -z') on the old coordinates, along the slopes (1, 1) and (1, -1); damping acts as before.
    pulls = -c * (x - y), -z.dot
    for q, force in zip(new.statement.coordinates[:2], new.statement.forces, strict=False):
        assert sympy.expand(force - (pulls[0] + {x: 1, y: -1}[q] * pulls[1])) == 0


def test_kepler_in_polar_coordinates_is_that_of_the_book() -> None:
    # Goldstein, Classical Mechanics, 3rd ed., section 3.2.
    system = lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        -mu / sqrt(x**2 + y**2),
        coordinates=[x, y],
        parameters={m: 1, mu: 1},
        initial={x: 0.0, y: 0.5, x.dot: -2.0, y.dot: 0.3},
    )
    new = system.transform(ROUND, positive=r)
    assert sympy.expand(new.statement.kinetic - m * (r.dot**2 + r**2 * phi.dot**2) / 2) == 0
    assert new.statement.potential == -mu / r
    start = dict(zip((*new.coordinates, *new.statement.velocities), new.statement.initial, strict=True))
    expected = {r: 0.5, phi: float(pi) / 2, r.dot: 0.3, phi.dot: 4.0}
    assert start == pytest.approx(expected, abs=1e-14)
    assert system.transform(ROUND).statement.potential == -mu / sympy.Abs(r)


def test_constraints_come_along_and_time_stands_in_the_velocities() -> None:
    ring = lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        coordinates=[x, y],
        constraints={"ring": x**2 + y**2 - 1},
        parameters={m: 1, w: 2},
        initial={x: 1.0, y.dot: 0.5},
    )
    new = ring.transform(ROUND)
    assert sympy.expand(new.statement.constraints[0].expression - (r**2 - 1)) == 0
    turning = ring.transform({x: r * cos(phi + w * lg.t), y: r * sin(phi + w * lg.t)})
    start = dict(zip((*turning.coordinates, *turning.statement.velocities), turning.statement.initial, strict=True))
    assert start == pytest.approx({r: 1.0, phi: 0.0, r.dot: 0.0, phi.dot: 0.5 - 2.0}, abs=1e-14)


@pytest.mark.slow
def test_dimensions_that_were_stated_are_kept_where_they_hold() -> None:
    sized = lg.System(
        m * (x.dot**2 + y.dot**2) / 2, g * m * y, coordinates=[x, y], dimensions={m: "kg", x: "m", y: "m"}
    )
    new = sized.transform(ROUND).statement
    assert {str(key) for key in new.dimensions} == {"m", "g", "t"}
    assert new.dimensions[g] == sized.routhian(x).statement.dimensions[g] == sized.hamiltonian().statement.dimensions[g]


def test_an_initial_state_may_be_given_in_the_new_coordinates() -> None:
    new = particle(initial={y.dot: 1.0}).transform(ROUND, initial={r: 2.0, "phi_dot": 0.5})
    start = dict(zip((*new.coordinates, *new.statement.velocities), new.statement.initial, strict=True))
    assert start == {r: 2.0, phi: 0.0, z: 0.0, r.dot: 0.0, phi.dot: 0.5, z.dot: 0.0}


@pytest.mark.parametrize(
    ("given", "more", "words"),
    [
        ([x], {}, "transform takes a dict from coordinates to expressions in new ones, as {x: r*cos(phi), y: r*sin("),
        ({x: away * cos(turn)}, {}, "the expressions for x have 2 new coordinates (away and turn), and 1 are"),
        ({x: r, y: 2 * r}, {}, "the expressions for x and y have 1 new coordinates (r), and 2 are replaced: a transf"),
        ({x: away + turn, y: 2 * away + 2 * turn}, {}, "x and y do not vary independently with away and turn: the det"),
        ({x: away, y: turn}, {"positive": x}, "positive contains x(t), which is not a new coordinate; they are away"),
        (ROUND, {"initial": 3}, "initial is an int: give a dict from new coordinate or velocity to value, such as {r"),
        ({x: exp(u) + 2}, {}, "no values of u were found at which x = 1, from 256 starts: give initial={u: ...}"),
    ],
)
def test_new_coordinates_that_are_none_are_refused(given: Any, more: Any, words: str) -> None:
    assert refusal(particle().transform, given, **more).startswith(words)


@pytest.mark.slow
def test_a_singular_initial_state_is_refused() -> None:
    # At x = y = 0 any angle will do; one that starts with y.dot = 1 needs another than zero.
    with pytest.raises(StatementError, match="the initial velocities have no values in the new coordinates, which"):
        particle(initial={y.dot: 1.0}).transform(ROUND)
    with pytest.raises(StatementError, match="the initial state in the new coordinates needs a value of mu: give one"):
        lg.System(x.dot**2, initial={x: 1.0}).transform({x: mu * u})


def test_a_wrong_transformation_is_found_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transformation, "_forces", lambda change: {z: -1 + 0 * np.pi})
    with pytest.raises(RunError, match=r"the transformation of system is wrong: a formula gives .* is compiled, at "):
        particle().transform(ROUND)


s = lg.coordinate("s")


def wagon() -> lg.System:
    kinetic = m * l**2 * theta.dot**2 / 2 + k * (s.dot**2 + l * s.dot * theta.dot * sympy.cos(theta))
    return lg.System(
        kinetic=kinetic,
        potential=-m * g * l * sympy.cos(theta),
        forces={s: -g * s},
        dissipation=k * theta.dot**2 / 2,
        parameters={m: 2.0, g: 9.81, l: 1.3, k: 2.6},
        initial={theta: 0.4, s.dot: 0.1},
        positions={"bob": (s + l * sympy.sin(theta), -l * sympy.cos(theta))},
    )


def test_expressions_stand_wherever_the_parameter_stood() -> None:
    """With k = mu m and mu = 1.3 the system moves as before."""
    changed = wagon().substitute({"k": mu * m, l: sympy.Rational(13, 10)})
    assert {p.name for p in changed.statement.parameters} == {"m", "g", "mu"}
    assert not {k, l} & {p for e in changed.statement.positions["bob"] for p in e.free_symbols}
    q, v = np.array([0.4, 0.2]), np.array([0.3, -0.1])
    result = changed.compile("numpy").accelerations(q, v, parameters={"mu": 1.3})
    # The same formulas with two numbers in them; rounded differently.
    assert result == pytest.approx(wagon().compile("numpy").accelerations(q, v), rel=1e-13)
    assert changed.statement.initial == wagon().statement.initial


def test_two_parameters_change_places() -> None:
    swapped = wagon().substitute({m: k, k: m}).statement
    assert sympy.expand(swapped.kinetic - wagon().statement.kinetic.xreplace({m: k, k: m})) == 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mass": 1}, "'mass' is not a parameter of this system; its parameters are"),
        ({theta: 0}, "theta is a coordinate: eliminate() solves a constraint for it, transform() states the"),
        ({l: theta}, "the value of l is theta(t), which is not constant: state the system with it, so that its"),
        ({l: -1}, "the value of l is -1, but l was declared positive, and SymPy may have dropped an abs or a root"),
    ],
)
def test_values_that_are_refused(given: Any, message: str) -> None:
    assert refusal(wagon().substitute, given).startswith(message)
