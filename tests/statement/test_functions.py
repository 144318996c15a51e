"""Functions in statements: given functions of time, tables, elementary functions, and Mod."""

import math
import pickle
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from mpmath import libmp
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from sympy import Function, cos, sin
from sympy.core.cache import clear_cache
from sympy.physics.mechanics import dynamicsymbols

import lagrange as lg
from lagrange.statement.coordinate import name_of
from lagrange.statement.given.motion import motion_of
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.vocabulary.functions import ALIASES, ELEMENTARY, WORDS, Elementary
from tests.refusals import refusal
from tests.statement.examples import DROP, write

t = lg.t
theta, x = lg.coordinates("theta x")
m, g, l, w, a = lg.parameters("m g l w a")
TIMES = np.linspace(0.0, 3.0, 16)


def pendulum(pivot: Any, **more: Any) -> lg.System:
    """Return a pendulum whose pivot moves along a line."""
    bob = (pivot + l * sin(theta), -l * cos(theta))
    values = {m: 1, g: 9.81, l: 1} | more.pop("values", {})
    return lg.System(
        **({"kinetic": lg.kinetic_energy(m, bob), "potential": lg.gravity(m, bob, g)} | more),
        parameters=values,
        initial={theta: 1.0},
    )


def test_a_given_function_is_no_coordinate_and_is_told_from_one_with_other_values() -> None:
    X = lg.given("X")
    assert str(X) == "X(t)" and X.dot == X.diff(t) and X.ddot == X.diff(t, 2)
    assert lg.given("X") == X and lg.coordinate("X") != X and Function("X")(t) != X
    assert lg.given("X", sin(t)) != lg.given("X", cos(t)) != X
    table = lg.given("X", (TIMES, TIMES**2))
    for item in (X, lg.given("X", sin(t)), table):
        assert pickle.loads(pickle.dumps(item)) == item
    known = motion_of(table)
    assert known is not None and known.span == (0.0, 3.0)


def test_a_given_motion_stays_open_in_a_derivation() -> None:
    X = lg.given("X")
    driven = pendulum(X)
    assert driven.coordinates == (theta,)
    expected = -(g * sin(theta) + X.ddot * cos(theta)) / l
    assert sympy.simplify(driven.accelerations()[theta] - expected) == 0
    page = str(driven.derivation())
    assert "X_ddot" in page and "X_dot" in page and "Derivative" not in page
    assert r"\ddot{X}" in driven.derivation().latex()
    assert any("energy is not conserved: the Lagrangian depends on time" in item for item in driven.structure)
    for call in (lambda: driven.run(1.0), driven.check):
        assert refusal(call).startswith("X is a given function of time, and has no values to compute with: state")


def test_a_function_of_coordinates_stays_open_in_a_derivation() -> None:
    r, phi = lg.coordinates("r phi")
    U, F = Function("U"), lg.given("F")
    central = lg.System(m * (r.dot**2 + r**2 * phi.dot**2) / 2, U(r), forces={r: F})
    result = central.accelerations()[r] - (r * phi.dot**2 - U(r).diff(r) / m + F / m)
    assert sympy.simplify(result) == 0
    assert "phi does not appear in L: it is cyclic, so p_phi is conserved." in central.structure
    assert "U(r(t)) has no formula" in refusal(lambda: lg.System(m * x.dot**2 / 2, U(x)).run(1.0)).replace("x", "r")
    wire = lg.System(lg.kinetic_energy(m, (x, U(x * t))), m * g * U(x))
    assert "depends on time" in " ".join(wire.structure)


@pytest.mark.slow
def test_an_expression_is_put_in_for_a_run() -> None:
    X, pivot = lg.given("X", a * sin(w * t)), a * sin(w * t)
    values = {a: 0.1, w: 2.0}
    driven, written = pendulum(X, values=values), pendulum(pivot, values=values)
    run, other = (system.run(5.0, events=[lg.event(shown - 0.05)]) for system, shown in ((driven, X), (written, pivot)))
    np.testing.assert_allclose(run.at(5.0), other.at(5.0), rtol=1e-12)
    np.testing.assert_allclose(run.t_events[0], other.t_events[0], rtol=1e-12)
    np.testing.assert_allclose(run.evaluate(X.ddot), -0.4 * np.sin(2.0 * run.t), rtol=1e-12, atol=1e-15)
    assert driven.check()
    assert pickle.loads(pickle.dumps(run)).evaluate(X)[3] == run.evaluate(X)[3]
    assert "X = a*sin(w*t)" in driven.derivation().text()


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("function", "formula"),
    [
        (lg.given("Z", (TIMES, TIMES**3 / 9)), t**3 / 9),
        (lg.given("Z", sin(t)), sin(t)),
        (t * lg.given("X", sin(t)).dot, t * cos(t)),
    ],
)
def test_a_given_function_is_put_in_for_an_open_one(function: Any, formula: Any) -> None:
    X = lg.given("X")
    driven = pendulum(X).substitute({X: function})
    assert [name_of(f) for f in driven.statement.given] == ["X"]
    np.testing.assert_allclose(driven.run(2.0).at(2.0), pendulum(formula).run(2.0).at(2.0), rtol=1e-7)
    assert "Z(t), a given function without values" in refusal(lambda: pendulum(X).substitute({X: lg.given("Z")}))


@pytest.mark.parametrize("method", ["taylor", pytest.param("dop853", marks=pytest.mark.slow)])
def test_a_table_is_a_spline_whose_first_two_derivatives_are_continuous(method: str) -> None:
    X, spline = lg.given("X", (TIMES, np.sin(2 * TIMES))), CubicSpline(TIMES, np.sin(2 * TIMES))
    driven = pendulum(X)
    run = driven.run(3.0, method=method, rtol=1e-10, t_eval=np.linspace(0.0, 3.0, 50))
    for order, leaf in enumerate((X, X.dot, X.ddot)):
        np.testing.assert_allclose(run.evaluate(leaf), spline(run.t, order), atol=1e-13)
    outside = "X is given from t = 0 to 3, and the run goes from 0 to 4: nothing is extrapolated."
    assert refusal(lambda: driven.run(4.0, method=method)).startswith(outside)
    assert refusal(lambda: lg.flow(driven.compile(), method=method)([1.0, 0.0], 0.0, 4.0)).startswith(outside)
    assert np.isnan(driven.compile().rhs(4.0, [1.0, 0.0])[1])


def test_a_function_that_nobody_declared_is_asked_about() -> None:
    clear_cache()  # SymPy may keep an equal function of theta of another test, which `coordinate` did not make
    u, question = (Function("undeclared")(t), "Is undeclared a coordinate or a given motion? Add lg.coordinate(")
    assert question in refusal(lambda: pendulum(u))
    assert question in refusal(lambda: pendulum(u, coordinates=[theta]))
    assert question in refusal(lambda: pendulum(0, forces={theta: u}))
    free = lg.System(m * dynamicsymbols("y_undeclared").diff(t) ** 2 / 2)
    assert free.structure[-1].startswith("y_undeclared is taken as a coordinate, because the energies contain a")
    assert "taken" not in pendulum(0).structure[-1]
    lg.coordinate("y_of_another_system")
    others = dynamicsymbols("y_undeclared y_of_another_system")
    assert lg.System(m * sum(q.diff(t) ** 2 for q in others) / 2).statement.inferred == ("y_undeclared",)


REFUSALS: list[tuple[Any, str]] = [
    (lambda: lg.given("t"), "'t' cannot name a given function, because it is time"),
    (lambda: lg.given("X", sin(theta)), "contains theta(t): give an expression in lg.t and parameters."),
    (lambda: lg.given("X", (TIMES, TIMES[1:])), "has times of shape (16,) and values of shape (15,)"),
    (lambda: lg.given("X", (TIMES, [*TIMES[1:], np.nan])), "X has nan at index 15 of its values: give finite numbers"),
    (lambda: lg.given("X", ([-np.inf, *TIMES[1:]], TIMES)), "X has -inf at index 0 of its times: give finite numbers"),
    (lambda: lg.given("X", ([0, 1, 2], [0, 1, 2])), "has 3 times: give 4 to 200. Thin a longer table out"),
    (lambda: lg.given("X", ([0, 1, 1, 2], [0, 1, 2, 3])), "go from 1 to 1: give times that rise."),
    (lambda: pendulum(lg.given("theta")), "theta names a given function of time and a coordinate"),
    (lambda: pendulum(lg.given("m")), "m is both a given function and a parameter: rename one."),
    (lambda: pendulum(lg.given("X"), coordinates=[theta, lg.given("X")]), "X(t), which is not a coordinate: make one"),
    (
        lambda: pendulum(lg.given("X", (TIMES, TIMES)) + lg.given("Y", (TIMES + 9, TIMES))),
        "the tables of X and Y have no times in common",
    ),
    (lambda: pendulum(0).run(1.0, events=[lg.event(lg.given("X"))]), "event 0 contains X(t), which this system"),
]


@pytest.mark.parametrize(("call", "message"), REFUSALS, ids=[message[:30] for _, message in REFUSALS])
def test_refusals(call: Any, message: str) -> None:
    assert message in refusal(call)


def test_a_scene_has_given_functions(tmp_path: Path) -> None:
    lean: dict[str, Any] = {"forces": DROP, "kinetic": "m*(l**2*theta_dot**2 + 2*l*theta_dot*X_dot*cos(theta))/2"}
    result = read_scene(write(tmp_path, given={"X": "sin(2*t)/g"}, **lean))
    assert result.given == (lg.given("X", sin(2 * t) / sympy.Symbol("g", real=True)),)
    table = read_scene(write(tmp_path, given={"X": [[0, 1, 2, 3], [0, 1, 4, 9]]}, **lean))
    assert lg.System.from_statement(table).run(3.0).status.complete
    for wrong, message in (
        ({"X": "theta"}, "'theta' is not declared"),
        ({"m": "t"}, "m is a parameter already"),
        ({"X": [[0, 1], [0, 1]]}, "has 2 times: give 4 to 200."),
    ):
        with pytest.raises(lg.SceneError) as caught:
            read_scene(write(tmp_path, given=wrong, **lean))
        assert message in caught.value.reason and caught.value.line is not None


# --- forces and potentials given by tables: `lagrange.table` ---------------------------------------------------


e = lg.parameters("e")

POINTS = np.array([-2.0, -1.2, -0.5, 0.1, 0.6, 1.4, 2.0])
VALUES = np.sin(2 * POINTS) + POINTS**2
SPLINE = CubicSpline(POINTS, VALUES)


def body(**options: Any) -> lg.System:
    return lg.System(m * x.dot**2 / 2, **options, parameters={m: 2}, initial={x: 1, x.dot: 0.5})


def rates(force: Any, t: float, z: Any) -> list[Any]:
    """Return the derivative of the state of a body of mass 2."""
    return [z[1], force(z[0]) / 2]


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_motions_in_a_measured_potential_and_by_a_measured_force_are_those_of_the_spline(method: str) -> None:
    slope = SPLINE.derivative()
    systems = [
        (body(potential=lg.table(x, POINTS, VALUES)), lambda q: -slope(q)),
        (body(forces={x: lg.table(x, POINTS, -VALUES)}), lambda q: -SPLINE(q)),
    ]
    for system, force in systems:
        run = system.run(3.0, method=method, rtol=1e-10)
        other = solve_ivp(partial(rates, force), (0, 3), [1, 0.5], rtol=1e-11, atol=1e-12)
        # dop853 goes over the knots of the force, where its second derivative has a corner, by step control alone.
        assert run.y[:, -1] == pytest.approx(other.y[:, -1], abs=1e-7)
        assert run.status is lg.Status.SUCCESS


def test_taylor_ends_steps_on_the_knots_and_conserves_the_energy() -> None:
    run = body(potential=lg.table(x, POINTS, VALUES)).run(3.0, rtol=1e-13)
    crossed = [knot for knot in POINTS if run[x].min() < knot < run[x].max()]
    assert len(crossed) >= 2
    for knot in crossed:
        assert np.abs(run[x] - knot).min() < 1e-12
    assert run.drift.relative < 1e-12


@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4"])
@pytest.mark.parametrize("kind", ["potential", "force"])
def test_a_run_stops_where_the_table_ends(method: str, kind: str) -> None:
    table = lg.table(x, POINTS, VALUES)
    system = body(potential=table) if kind == "potential" else body(forces={x: -table})
    for speed in (9, -9):
        run = system.run(5.0, {x.dot: speed}, method=method, step=0.001 if method == "rk4" else None)
        assert run.status is lg.Status.NON_FINITE
        assert abs(run[x][-1] - math.copysign(2, speed)) < 0.02
        assert f"x = {run[x][-1]:.6g} leaves its table, which has values from -2.0008 to 2.0006" in run.message


def test_a_start_outside_is_named() -> None:
    with pytest.raises(lg.StatementError, match=r"x = 3 leaves its table, which has values from -2\.0008"):
        body(potential=lg.table(x, POINTS, VALUES)).run(1.0, {x: 3})
    run = body(forces={x: lg.table(x, POINTS, VALUES)}).run(1.0, {x: 3})
    assert "x = 3 leaves its table" in run.message


@pytest.mark.parametrize(
    ("argument", "points", "values", "said"),
    [
        (x, [0, 2, 1, 3], [0, 1, 2, 3], "the points of the table over x go from 2 to 1: give points that rise"),
        (x, [0, 1, 2, 3], [0, math.nan, 2, 3], "the table over x has nan at index 1 of its values"),
        (x, [0, 1, 2, 3], [0, 1, 2], r"has points of shape \(4,\) and values of shape \(3,\)"),
        (x, [0, 1, 2], [0, 1, 2], "has 3 points: give 4 to 200"),
        (x, np.arange(201), np.arange(201), "has 201 points: give 4 to 200. Thin a longer table out"),
        (1.5, [0, 1, 2, 3], [0, 1, 2, 3], "the argument of the table is 1.5, a number"),
    ],
)
def test_what_is_no_table_is_refused(argument: Any, points: Any, values: Any, said: str) -> None:
    with pytest.raises(lg.StatementError, match=said):
        lg.table(argument, points, values)


@pytest.mark.slow
def test_a_derivation_writes_tables_as_functions() -> None:
    system = body(potential=e * lg.table(x / a, POINTS, VALUES), forces={x: -lg.table(x.dot, POINTS, -VALUES)})
    text = system.derivation().text()
    assert "V = e*S1(x/a)" in text and "S1 is a table of 7 points from -2 to 2." in text
    assert "m*x_ddot + e*S1'(x/a)/a = -S2(x_dot)" in text
    single = body(potential=lg.table(x, POINTS, VALUES))
    assert "\\[ m \\ddot{x} + S'(x) = 0 \\]" in single.derivation().latex()
    # The equations that are returned as expressions have the cubics.
    assert system.equations()[0].lhs.subs(x, 0.3).has(sympy.Piecewise)


def test_a_table_of_numbers_with_units_is_refused_with_the_remedy() -> None:
    for energy in (lg.table(x, POINTS, VALUES), e * lg.table(x, POINTS, VALUES), lg.table(x / a, POINTS, VALUES)):
        with pytest.raises(
            lg.StatementError, match=r"table\(x(/a)?\).* have no unit: .* value\*lg.table\(x/point"
        ) as refusal:
            body(potential=energy, dimensions={m: "kg", x: "m", a: "m"})
        assert len(str(refusal.value)) <= 400
    wrong = r"the term x/a in table\(x/a\), whose unit is 100 .* or a in m instead of cm"
    with pytest.raises(lg.StatementError, match=wrong):
        body(potential=e * lg.table(x / a, POINTS, VALUES), dimensions={m: "kg", x: "m", a: "cm"})


def test_a_table_with_a_point_at_zero_is_written_and_read(tmp_path: Path) -> None:
    """In SymPy the float 0.0 differs from 0, so that it was refused as too small."""
    system = lg.System(x.dot**2 / 2, lg.table(x, [-1.0, 0.0, 1.0, 2.0], [0, 1, 0, 2]), initial={x: 0.5})
    text = system.to_scene(tmp_path / "a.toml").read_text("utf-8")
    assert "points = [" in text and " if " not in text, "no cubic is written out"
    again = lg.System.from_scene(tmp_path / "a.toml")
    assert again.potential == system.potential


# --- mod in a statement: the remainder, its derivative between jumps, and runs that pass its jumps -------------


k = lg.parameters("k")
SAW: Any = x % 2 - 1


def rolling() -> lg.System:
    """Return a mass in a potential of period 2: a parabola about each even integer."""
    return lg.System(
        m * x.dot**2 / 2, k * SAW**2 / 2, parameters={m: 1, k: 3}, initial={x: 0.3, x.dot: 2.5}, name="rolling"
    )


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("place", [-7.7, -0.2, 0.4, 1.9, 11.5])
def test_a_force_is_that_of_the_remainder(place: float, target: str) -> None:
    model = rolling().compile(target)
    # Some roundings of the angle, 2 pi x/2, and of its sine.
    expected = -3 * (math.fmod(math.fmod(place, 2) + 2, 2) - 1)
    assert model.accelerations([place], [0.0])[0] == pytest.approx(expected, rel=1e-12, abs=1e-13)
    assert model.jacobian(0.0, [place, 0.0])[1, 0] == pytest.approx(-3, rel=1e-12)


@pytest.mark.parametrize(("dividend", "divisor"), [(7.25, 3), (-7.25, 3), (7.25, -3), (-7.25, -3), (0.5, 1.5)])
def test_the_sign_is_that_of_the_divisor(dividend: float, divisor: float) -> None:
    system = lg.System(m * x.dot**2 / 2, 0, forces={x: sympy.Mod(x, sympy.Float(divisor))}, parameters={m: 1})
    result = system.compile("numpy").accelerations([dividend], [0.0])[0]
    assert result == pytest.approx(dividend % divisor, rel=1e-13)


@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_a_run_passes_the_jumps_of_its_force(method: str) -> None:
    run = rolling().run(6.0, method=method, rtol=1e-10)
    assert run.status is lg.Status.SUCCESS
    assert run[x][-1] > 10
    energies = run[x.dot] ** 2 / 2 + 3 * (np.mod(run[x], 2) - 1) ** 2 / 2
    # A step across a jump of the force is repeated until its error is within the tolerance.
    np.testing.assert_allclose(energies, energies[0], rtol=1e-7)


@pytest.mark.slow
def test_remainders_of_remainders_and_their_derivatives_are_written_out() -> None:
    inner: Any = sympy.Mod(sympy.Mod(x, 5) + x, 2)
    system = lg.System(m * x.dot**2 / 2, 0, forces={x: inner + sympy.Mod(x, 3).diff(x)}, parameters={m: 1})
    assert system.check()
    result = system.compile("numpy").accelerations([7.3], [0.0])[0]
    assert result == pytest.approx((7.3 % 5 + 7.3) % 2 + 1, rel=1e-12)


def test_a_scene_file_says_mod(tmp_path: Path) -> None:
    path = tmp_path / "rolling.toml"
    rolling().to_scene(path)
    again = lg.System.from_scene(path)
    text = 'name = "rolling"\ncoordinates = ["x"]\nkinetic = "x_dot**2/2"\npotential = "3*(mod(x, 2) - 1)**2/2"\n'
    path.write_text(text)
    for system in (again, lg.System.from_scene(path)):
        assert system.compile("numpy").accelerations([0.4], [0.0])[0] == pytest.approx(1.8, rel=1e-12)


def test_taylor_ends_a_step_on_each_jump() -> None:
    """The body passes two jumps of its force upwards, turns, and comes back over them."""
    thrown = lg.System(m * x.dot**2 / 2, 0, forces={x: sympy.Mod(x, 1) - 1}, parameters={m: 1})
    run = thrown.run(5.5, {x: 0.5, x.dot: 1.4}, rtol=1e-13, events=[x.dot])
    assert run.status is lg.Status.SUCCESS
    v, whole = run[x.dot], np.floor(run[x])
    for jump in (1, 2):
        for part in (run[x][v > 0], run[x][v <= 0]):
            assert np.abs(part - jump).min() < 1e-13
    energy = v**2 / 2 - (whole / 2 + (run[x] - whole) ** 2 / 2) + run[x]
    np.testing.assert_allclose(energy, energy[0], atol=1e-11)
    assert run.at(2 * run.t_events[0][0]) == pytest.approx([0.5, -1.4], abs=1e-11)


# --- the records of elementary functions: derivatives, symmetries, exact and precise values are right ----------


PLACES = {"acosh": (1.25, 2.5, 40.0), "log": (0.1, 2.5, 40.0)}
EVERY = pytest.mark.parametrize("function", ELEMENTARY.values(), ids=list(ELEMENTARY))


def places(function: Elementary) -> tuple[float, ...]:
    return PLACES.get(function.name, (-0.75, 0.25, 0.9))


@EVERY
def test_all_lives_of_a_function_have_its_value(function: Elementary) -> None:
    for x in places(function):
        value = function.of_float(x)
        # Libraries are right to 2 ulp.
        others = (float(function.of_array(np.array([x]))[0]), float(function.symbolic(x)))
        exact = libmp.to_float(function.precise(libmp.from_float(x), 53, "n"))
        assert (*others, exact) == pytest.approx((value,) * 3, rel=2.0**-50)


@EVERY
def test_symmetries_exact_values_and_domains(function: Elementary) -> None:
    argument, value = function.exact
    assert function.of_float(float(argument)) == value
    x = 0.4
    if function.odd or function.even:
        assert function.of_float(-x) == (-1 if function.odd else 1) * function.of_float(x)
    outside = [x for x in (-2.0, 0.0, 2.0) if not has_value(function, x)]
    assert bool(outside) == (not function.everywhere)
    assert math.isinf(function.pole) == (function.name == "log")


def has_value(function: Elementary, x: float) -> bool:
    try:
        return math.isfinite(function.of_float(x))
    except ValueError:
        return False


# --- The functions that a statement may use ---


REQUIRED = (
    "sin cos tan asin acos atan atan2 exp log sqrt sinh cosh tanh cot sec csc sinc asinh acosh atanh erf heaviside abs "
    "sign min max mod"
)


def test_the_words_are_complete_and_named_as_they_are_listed() -> None:
    assert set(REQUIRED.split(" ")) == set(WORDS)
    assert all(word.name == name for name, word in WORDS.items())


def test_aliases_lead_to_words() -> None:
    assert set(ALIASES.values()) <= set(WORDS)
    assert not set(ALIASES) & set(WORDS)
