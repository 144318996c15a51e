"""Linear equations about a point or a motion, with constraints, and systems expanded about a point."""

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import Abs, Matrix, Max, Min, Piecewise, Rational, acos, cos, pi, sign, simplify, sin, sqrt

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.mechanics import small_changes
from lagrange.mechanics.plain_form import Shortener, numeric
from tests.models import shared_scene
from tests.refusals import refusal
from tests.systems import conical_pendulum, pendulum, rod_pendulum

m, g, l, k, c, w, M, r = lg.parameters("m g l k c w M r")
u = lg.parameters("u", positive=False)
x, y, z, theta, phi, heading, lean, spin = lg.coordinates("x y z theta phi heading lean spin")
WRONG: Any = 3


def cart(**more: Any) -> lg.System:
    bob = (x + l * sin(theta), -l * cos(theta))
    return lg.System(
        lg.kinetic_energy(M, x) + lg.kinetic_energy(m, bob),
        lg.gravity(m, bob, g),
        coordinates=[x, theta],
        forces={x: u - k * sin(theta.dot)},
        dissipation=c * theta.dot**2 / 2,
        parameters={m: 1, g: 9.81, l: 0.7, M: 2, k: 0.3, c: 0.2, **more},
        name="cart",
    )


def test_an_inverted_pendulum_on_a_cart_has_the_matrices_of_the_book() -> None:
    # K. Ogata, Modern Control Engineering, 5th ed., 2010, example 3-6, with theta from the top.
    plain = cart().substitute({k: 0, c: 0})
    lin = plain.linearize({theta: pi}, inputs=[u])
    assert lin.equilibrium
    assert lin.note == "About an equilibrium."
    expected = Matrix([[0, 0, 1, 0], [0, 0, 0, 1], [0, m * g / M, 0, 0], [0, (M + m) * g / (M * l), 0, 0]])
    assert (lin.A - expected).applyfunc(sympy.simplify).is_zero_matrix
    assert Matrix([0, 0, 1 / M, 1 / (M * l)]) == lin.B


def test_a_linearization_is_the_compiled_jacobian_anywhere() -> None:
    system = cart(u=1.5)
    lin = system.linearize({theta: 0.4, x.dot: -0.2, "theta_dot": 0.9, "u": 1.5}, inputs="u")
    assert not lin.equilibrium
    assert lin.note.startswith("Away from equilibrium: the forces left are ")
    jacobian = system.compile("numpy").jacobian(0.0, [0.0, 0.4, -0.2, 0.9])
    # Formulas in 30 digits beside doubles.
    np.testing.assert_allclose(numeric(lin.A, {}), jacobian, rtol=1e-12, atol=1e-13)


def test_a_given_function_is_an_input_too() -> None:
    push, pivot = lg.given("push"), lg.given("pivot")
    spring = lg.System(m * x.dot**2 / 2, k * x**2 / 2, forces={x: push}, parameters={m: 2, k: 3})
    for given in (push, "push"):
        lin = spring.linearize({"push": 0}, inputs=given)
        assert (Matrix([[0, 1], [-k / m, 0]]), Matrix([0, 1 / m])) == (lin.A, lin.B)
    assert spring.linearize({x: 1, push: k}, inputs=[push]).equilibrium
    shaken = lg.System(m * (x.dot + pivot.dot) ** 2 / 2, k * x**2 / 2, coordinates=[x])
    assert "the statement contains derivatives of the input pivot, and in" in refusal(shaken.linearize, inputs=[pivot])


def test_a_steady_motion_is_one_and_others_are_told() -> None:
    pendulum = conical_pendulum(parameters={m: 1, g: 9.81, l: 1, w: 5})
    steady = pendulum.linearize({theta: acos(g / (l * w**2)), phi.dot: w})
    assert steady.note == "About a steady motion."
    assert sympy.simplify(steady.K[0, 0] - m * (l**2 * w**4 - g**2) / w**2) == 0
    assert steady.at == {theta: acos(g / (l * w**2)), phi: 0, phi.dot: w}
    moving = pendulum.linearize({theta: pi, theta.dot: 0, phi.dot: w})
    assert moving.equilibrium
    tilted = cart().substitute({k: 0, c: 0, u: 0}).linearize({theta: 0, x.dot: 1})
    assert tilted.note == "About a steady motion."
    falling = lg.System(m * x.dot**2 / 2, k * x**2 / 2 - k * x).linearize({x: 1, x.dot: w})
    assert falling.note == "Away from equilibrium: x moves, and the matrices are valid at this instant."


def test_constraints_leave_independent_coordinates() -> None:
    # A bead on the wire y = a x^2 at its lowest point swings with w^2 = 2 a g.
    wire = lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        m * g * y,
        coordinates=[x, y],
        constraints={"wire": y - k * x**2},
        dissipation=c * y.dot**2,
        parameters={m: 1, g: 9.81, k: 0.8, c: 0.1},
    )
    lin = wire.linearize({})
    assert lin.coordinates == (x,)
    assert (Matrix([m]), Matrix([0]), Matrix([2 * g * k * m])) == (lin.M, lin.C, lin.K)
    assert lin.basis == Matrix([1, 0])
    assert lin.note == "About an equilibrium on the constraints."
    both = {"wire": y - k * x**2, "same": 2 * y - 2 * k * x**2}
    twice = lg.System(wire.kinetic, m * g * y, constraints=both, redundant="allow", parameters={m: 1, g: 9.81, k: 0.8})
    assert twice.linearize({}).K == lin.K


def test_a_knife_edge_has_more_positions_than_velocities() -> None:
    sledge: dict[str, Any] = {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2 + M * theta.dot**2 / 2,
        "coordinates": [x, y, theta],
        "constraints": {"edge": y.dot * cos(theta) - x.dot * sin(theta)},
        "parameters": {m: 1, M: 2, k: 3},
    }
    sled = lg.System(potential=k * (x**2 + y**2 + theta**2) / 2, **sledge)
    lin = sled.linearize({})
    assert (lin.M.shape, lin.K.shape, lin.A.shape) == ((2, 2), (2, 3), (5, 5))
    assert (
        Matrix([[0, 0, 0, 1, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 1], [-k / m, 0, 0, 0, 0], [0, 0, -k / M, 0, 0]]) == lin.A
    )
    modes = sled.modes({})
    assert set(modes.frequencies) == {sympy.sqrt(k) / sympy.sqrt(m), sympy.sqrt(k) / sympy.sqrt(M)}
    assert (modes.linearization.coordinates, modes.stable) == ((x, theta), None)
    blown = lg.System(potential=k * x * y, **sledge)
    assert "system has constraints on velocities, and its forces depend on more" in refusal(blown.modes, {})


def test_corners_that_do_not_matter_leave_the_matrices() -> None:
    drag = lg.System(m * x.dot**2 / 2, k * x**2 / 2, forces={x: -c * x.dot * abs(x.dot)}).linearize()
    assert (drag.C[0], drag.K[0]) == (0, k)
    beside = lg.System(m * x.dot**2 / 2, Piecewise((k * x**2, x < 1), (2 * k * x**2, True))).linearize({x: 2})
    assert beside.K[0] == 4 * k


def test_a_branch_that_is_not_known_at_the_point_remains() -> None:
    """A corner at x = 0 beside a force whose branch depends on the time, or on a parameter without a value."""
    for factor in (Min(1, sin(lg.t)), Min(u, w)):
        spring = lg.System(m * x.dot**2 / 2, k * x**2 / 2 + Max(x, 0) ** 3, forces={x: x * factor}).linearize()
        assert simplify(spring.K[0] - k + factor) == 0


def test_it_pickles_and_says_what_it_is() -> None:
    lin = cart().linearize({}, inputs=[u])
    again = pickle.loads(pickle.dumps(lin))
    assert (again.M, again.at, again.B) == (lin.M, lin.at, lin.B)
    assert repr(lin).startswith("<Linearization: About an equilibrium. M = [[M + m, l*m], [l*m, ")


def linear(*energies: Any, at: Any = None, inputs: Any = (), **more: Any) -> Any:
    return lg.System(*energies, **more).linearize(at or {}, inputs=inputs)


T, PLANE = m * x.dot**2 / 2, x.dot**2 + y.dot**2
CORNER = "the forces on x have a corner or a jump at x = 0, where {} is zero,"
FILTER: dict[str, Any] = {"forces": {x: y}, "constraints": {"filter": y.dot - u + y}, "inputs": [u]}
CROSSED: dict[str, Any] = {"constraints": [x * y, x + y * z], "coordinates": [x, y, z], "initial": {z: 1}, "at": {z: 0}}
STILL: dict[str, Any] = {"constraints": [x - 1, y - x], "initial": {x: 1, y: 1}, "at": {x: 1, y: 1}}
MOVED: dict[str, Any] = {"constraints": [x - y * (1 + sin(lg.t))], "coordinates": [x, y], "initial": {}}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: cart().linearize(WRONG), "at is an int: give a dict from coordinate or velocity to value, such as"),
        (lambda: cart().linearize({z: 0}), "at names 'z', which is not a coordinate, velocity or input; they are x, x"),
        (lambda: cart().linearize({}, inputs=["v"]), "inputs contains 'v', which is not a parameter of this system: c"),
        (
            lambda: rod_pendulum().linearize({y: -l}, inputs=[x]),
            "inputs contains 'x', which is a coordinate or a velocity",
        ),
        (
            lambda: lg.System(m * (x.dot + lg.given("X").dot) ** 2 / 2).linearize(inputs=[lg.given("X").ddot]),
            "the statement contains derivatives of the input X, and in the term B u of linear equations there are none"
            ": leave X out, and state its effect as a force",
        ),
        (lambda: linear(T, **FILTER), "the constraint 'filter' contains the input u, so B would need the rate of u"),
        (lambda: linear(T, k * abs(x)), CORNER.format("x") + " so that they are not linear near it."),
        (lambda: linear(T, k * x**2, forces={x: -sign(x.dot)}), CORNER.format("x_dot")),
        (lambda: lg.System(T, k / x, initial={x: 1}, name="hill").modes(), "the forces of hill, or their derivatives"),
        (
            lambda: rod_pendulum().linearize({y: -l, y.dot: 1}),
            "the velocities are not on the constraint 'rod', which is -2*l t",
        ),
        (lambda: disc().linearize({x.dot: 1.0, spin.dot: 1.0}), "the velocities are not on the constraint 'along', wh"),
        (lambda: linear(PLANE, **MOVED), "the constraint 'constraint_1' depends on time: no point satisfies it at all"),
        (lambda: linear(PLANE, **STILL), "the constraints allow no motion to linearize: leave one"),
        (lambda: linear(PLANE + z.dot**2, **CROSSED), "the constraints are dependent at this point, so choose another"),
        (lambda: linear(x**2 * x.dot**2, k * x, initial={x: 1}), "the mass matrix of system is singular at this"),
        (lambda: linear(x**2 * x.dot**2, k * x**2, initial={x: 1}).A, "the mass matrix is singular at this point, so"),
    ],
)
def test_refusals(call: Any, words: str) -> None:
    assert refusal(call).startswith(words)


@pytest.mark.parametrize("name", ["linearize", "substitute", "noether", "compare", "transform"])
def test_a_key_of_thousands_of_digits_is_refused_in_a_sentence(name: str) -> None:
    with pytest.raises(StatementError, match=r"(is not|neither t nor|which is not) a (coordinate|parameter)"):
        getattr(cart(u=0), name)({sympy.Integer(10) ** 5000: 1})


@pytest.mark.parametrize("symbols", ["q", "inputs"])
def test_a_wrong_linearization_is_found_by_number(monkeypatch: pytest.MonkeyPatch, symbols: str) -> None:
    right = small_changes.AtPoint.slopes

    def wrong(self: Any, nodes: Any, leaves: Any) -> Any:
        off = leaves is self.equations.q if symbols == "q" else len(leaves) == 1
        return [[(1.001 if off else 1) * slope for slope in row] for row in right(self, nodes, leaves)]

    monkeypatch.setattr(small_changes.AtPoint, "slopes", wrong)
    with pytest.raises(RunError, match=r"the linearization of cart is wrong: a formula gives .* is compiled, at "):
        cart().linearize({theta: pi}, inputs=[u])


def test_formulas_of_any_size_are_refused_without_being_walked() -> None:
    """The expression has 2^60 nodes as a tree, but only 180 different ones."""
    large = x
    for number in range(60):
        large = (large + number) * (large - 1)
    shortener = Shortener("A", lambda _: False)
    assert refusal(shortener.short, large).startswith("A would be formulas of more than 15,000 symbols and op")


def test_the_inverse_of_a_sparse_mass_matrix_is_short() -> None:
    """The inverse for a chain is short; as minors over a determinant it had 100,000 operations."""
    n = 5
    places = [lg.coordinate(f"x_{i}") for i in range(n)]
    masses = sympy.symbols(f"m0:{n}", positive=True)
    speeds = [sum(q.dot for q in places[: i + 1]) for i in range(n)]
    chain = lg.System(sum(m * v**2 for m, v in zip(masses, speeds, strict=True)) / 2, sum(q**2 for q in places) / 2)
    rates = chain.linearize().A[n:, :n]
    assert all((rates[i, j] == 0) is (abs(i - j) > 1) for i in range(n) for j in range(n))
    assert sum(rate.count_ops() for rate in rates) < 40


@pytest.mark.parametrize(("push", "balanced"), [(lambda side: 2 * side, False), (lambda side: 2 * side**2, True)])
def test_a_pole_of_coordinates_is_an_equilibrium_only_if_forces_vanish_next_to_it(push: Any, balanced: bool) -> None:
    """A sideways force on a spherical pendulum has no component along either angle at theta = 0, phi = pi/2."""
    (m, g, l), (theta, phi) = lg.parameters("m g l"), lg.coordinates("theta phi")
    side = l * sin(theta) * cos(phi)
    kinetic = m * l**2 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2
    system = lg.System(kinetic, m * g * (push(side) - l * cos(theta)), coordinates=[theta, phi])
    linear = system.linearize({phi: pi / 2})
    assert linear.equilibrium is balanced
    assert balanced or "next to this point the forces do not vanish" in linear.note


# --- linear equations about motions on constraints: closed forms, and differences of the flow ------------------


def disc(*order: Any) -> lg.System:
    """Return a thin disc that rolls: (x, y) is the point of contact."""
    centre = Matrix([x + r * sin(lean) * sin(heading), y - r * sin(lean) * cos(heading), r * cos(lean)])
    about_axle = spin.dot + heading.dot * sin(lean)
    turning = m * r**2 * (lean.dot**2 + (heading.dot * cos(lean)) ** 2 + 2 * about_axle**2) / 8
    velocity = centre.diff(lg.t)
    return lg.System(
        m * velocity.dot(velocity) / 2 + turning,
        m * g * centre[2],
        coordinates=order or [x, y, heading, lean, spin],
        constraints={"along": x.dot - r * spin.dot * cos(heading), "across": y.dot - r * spin.dot * sin(heading)},
        parameters={m: 1.3, g: 9.81, r: 0.4, w: 5},
        name="disc",
    )


@pytest.mark.slow
def test_a_disc_that_rolls_straight_is_stable_above_its_critical_spin() -> None:
    # With the moments m r^2/4 and m r^2/2, leaning and turning follow 5/4 r lean'' + 3/2 r w heading' = g lean and
    # heading'' = 2 w lean', which is stable where w^2 > g/(3 r).
    straight = {x.dot: r * w, spin.dot: w}
    modes = disc().modes(straight)
    assert modes.linearization.note == "About a steady motion on the constraints."
    assert modes.symbolic
    assert sympy.expand(modes.frequencies[2] ** 2 - (12 * w**2 / 5 - 4 * g / (5 * r))) == 0
    critical = np.sqrt(9.81 / (3 * 0.4))
    path = disc().eigenvalues(w, [0.0, 0.99 * critical, 1.01 * critical, 20.0], straight)
    assert path.stable.tolist() == [False, False, True, True]
    assert path.eigenvalues.shape == (4, 8)  # five positions, and three independent velocities


@pytest.mark.slow
def test_independent_coordinates_may_be_any() -> None:
    result = disc(spin, lean, heading, x, y).linearize({x.dot: r * w, spin.dot: w})
    assert result.velocity_coordinates == (lean, heading, x)
    assert result.coordinates == (spin, lean, heading, x, y)
    assert result.equilibrium
    assert result.C[0, 1] * result.C[1, 0] == -3 * m**2 * r**4 * w**2 / 4


def random_system(seed: int) -> tuple[lg.System, Any, Any]:
    """Return a system whose z and heading' follow from the others, with z = f(x, y, t) and heading' = h."""
    random = np.random.default_rng(seed)

    def draw() -> Any:
        return Rational(int(random.integers(3, 12)), 7)

    above = draw() * x**2 + draw() * sin(x - draw() * y)
    turning = draw() * x.dot * cos(draw() * heading) + (draw() + z) * y.dot + draw() * sin(x) * z.dot
    kinetic = sum(draw() * q.dot**2 for q in (x, y, z, heading)) + (x.dot * draw() * cos(heading) + y.dot) ** 2
    kinetic += draw() * sin(x) ** 2 * heading.dot**2 + draw() * x.dot * y
    potential = g * z + draw() * x * heading + draw() * cos(x * y)
    system = lg.System(
        kinetic,
        potential,
        coordinates=[z, heading, x, y],
        constraints={"on": z - above, "turn": heading.dot - turning},
        forces={x: -draw() * x.dot * y, heading: draw() * z.dot * heading.dot},
        parameters={g: 2},
        name=f"random {seed}",
    )
    return system, above, turning


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(4))
def test_the_matrix_is_the_slope_of_the_motion_on_the_constraints(seed: int) -> None:
    system, above, turning = random_system(seed)
    model, steps = system.compile("numpy"), 1e-4

    def whole(values: Any) -> Any:
        """Return the whole state of the disc from x, y, the heading, x' and y'."""
        table = dict(zip((x.dot, y.dot, x, y, heading), (*values[3:], *values[:3][[1, 2, 0]]), strict=True))
        table[z.dot] = above.diff(lg.t).subs(table)
        table[z] = above.subs(table)
        table[heading.dot] = turning.subs(table)
        return np.array([float(table[s]) for s in (*system.coordinates, *(q.dot for q in system.coordinates))])

    values = np.array([0.25, 0.5, -0.375, 0.625, -0.75])  # exact in binary: heading, x, y, x', y'
    rows = [1, 2, 3, 6, 7]
    columns = []
    for change in steps * np.eye(5):
        near = [model.rhs(0.0, whole(values + share * change))[rows] for share in (-2, -1, 1, 2)]
        columns.append((near[0] - 8 * near[1] + 8 * near[2] - near[3]) / (12 * steps))
    exact = dict(zip((heading, x, y, x.dot, y.dot), map(Rational, values), strict=True))
    exact[z.dot] = above.diff(lg.t).subs(exact)
    exact |= {z: above.subs({x: exact[x], y: exact[y]})}
    exact[heading.dot] = turning.subs(exact)
    lin = system.linearize(exact)
    assert lin.coordinates == (heading, x, y)
    assert lin.velocity_coordinates == (x, y)
    difference = np.array(columns).T - numeric(lin.A, {g: 2})
    # Fourth-order differences with steps of 1e-4 leave rounding, 1e-16/1e-4 times a few.
    assert np.abs(difference).max() <= 1e-9 * np.abs(columns).max()


def test_an_equilibrium_in_decimals_is_not_followed_along_constraints() -> None:
    with pytest.raises(StatementError, match="disc has constraints, and an equilibrium in decimals cannot be"):
        disc().eigenvalues(w, [1.0], {x.dot: 0.4, spin.dot: 1.0})


# --- systems expanded about a point, compared with the full system and its linearization; refusals -------------


a = lg.parameters("a")


def test_the_pendulum_swings_harmonically() -> None:
    small = pendulum().small({theta: 0})
    assert list(small.parameters) == list(pendulum().parameters)
    assert small.equations() == [sympy.Eq(m * l**2 * theta.ddot + m * g * l * theta, 0)]
    assert small.statement.potential == m * g * l * theta**2 / 2 - m * g * l
    assert small.statement.about == ("Expanded about theta = 0 to order 2 in changes of coordinates and velocities.")
    assert small.check()


def test_away_from_equilibrium_terms_of_first_order_stay_and_are_told() -> None:
    small = pendulum().small({theta: pi / 2})
    assert small.accelerations() == {theta: -g / l}
    assert small.statement.about == (
        "Expanded about theta = pi/2 to order 2 in changes of coordinates and velocities. "
        "The point is not an equilibrium: terms of first order remain, and accelerations are those "
        "of the system at the point alone."
    )
    assert "no equilibrium" not in pendulum().small({theta: pi}).statement.about


def error(system: lg.System, at: dict[Any, float], order: int, size: float) -> float:
    """Return the error of the expansion's accelerations at a distance from the point."""
    full, small = system.compile(check=False), system.small(at, order=order).compile(check=False)
    draw = np.random.default_rng(3)
    keys = (*system.coordinates, *system.statement.velocities)
    y0 = np.array([float(at.get(key, 0.0)) for key in keys]) + size * draw.uniform(-1, 1, len(keys))
    n = len(keys) // 2
    return float(np.max(np.abs(full.accelerations(y0[:n], y0[n:], 0.4) - small.accelerations(y0[:n], y0[n:], 0.4))))


FORCED = lg.System(
    m * (x.dot**2 + (l + x) ** 2 * theta.dot**2) / 2,
    -m * g * (l + x) * cos(theta) + k * x**2 / 2,
    dissipation=c * sqrt(1 + x) * x.dot**2 / 2,
    forces={theta: a * sin(lg.t) * sin(theta) - theta.dot**3},
    coordinates=[x, theta],
    parameters={m: 1, l: 1, g: 9.81, k: 40, c: 0.3, a: 0.2},
)


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize(
    ("system", "at"),
    [
        (shared_scene("double-pendulum"), {}),
        (FORCED, {x: 9.81 / 40}),
        (shared_scene("elastic-pendulum"), {lg.coordinate("r"): 1.0}),
    ],
    ids=["double", "forced", "elastic"],
)
def test_the_error_falls_with_the_order(system: lg.System, at: dict[Any, float], order: int) -> None:
    # About an equilibrium, equations of order n - 1 leave an error of order n: a tenth of the distance leaves 10^-n of
    # it. Where the terms of that order vanish by symmetry it falls faster.
    far, near = (error(system, at, order, size) for size in (2e-2, 2e-3))
    assert near <= 10 ** (0.5 - order) * far and near < far


def test_constraints_are_expanded_with_their_curvature() -> None:
    rod = shared_scene("cartesian-pendulum")
    length = next(p for p in rod.statement.parameters if p.name == "l")
    small = rod.small({"y": -length})
    assert sympy.expand(small.statement.constraints[0].expression - rod.statement.constraints[0].expression) == 0
    assert "no equilibrium" not in small.statement.about
    wire = lg.System(m * (x.dot**2 + y.dot**2) / 2, constraints={"wire": y - a * (cos(x) - 1)})
    assert wire.small().statement.constraints[0].expression == a * x**2 / 2 + y


KINETIC = m * x.dot**2 / 2
NONE = "the potential energy has no expansion about {}: it"
AT_CORNER = f"{NONE} has a corner or a jump where {{}} is zero, as at this point. Choose a point next to it."
INFINITE = (
    f"{NONE}, or a derivative up to order 2, is not finite there. Choose another point, or coordinates that are "
    "regular at it."
)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: shared_scene("spherical-pendulum").small(), "the inertia of phi vanishes at theta = 0 and phi = 0, s"),
        (lambda: lg.System(KINETIC, k * Abs(x)).small(), AT_CORNER.format("x = 0", "x")),
        (
            lambda: lg.System(KINETIC, Piecewise((x**2, x > a), (0, True))).small({x: a}),
            AT_CORNER.format("x = a", "a - x"),
        ),
        (lambda: lg.System(KINETIC, x ** Rational(3, 2)).small(), INFINITE.format("x = 0")),
        (lambda: shared_scene("cartesian-pendulum").small(), "the point is not on the constraint 'rod', which is -l**"),
        (lambda: pendulum().small(order=1), "order = 1: give a whole number from 2 to 8."),
    ],
)
def test_what_has_no_expansion_is_refused(act: Callable[[], Any], message: str) -> None:
    assert refusal(act).startswith(message)
