"""Given functions of time: open, as an expression, as a table; messages about undeclared functions."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from scipy.interpolate import CubicSpline
from sympy import Function, cos, sin
from sympy.core.cache import clear_cache
from sympy.physics.mechanics import dynamicsymbols

import lagrange as lg
from lagrange.statement.coordinate import name_of
from lagrange.statement.given.motion import motion_of
from lagrange.statement.scene.scene_reader import read_scene
from tests.refusals import refusal
from tests.statement.scenes import DROP, write

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


@pytest.mark.few(2)
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
    cubic = pendulum(lg.given("X", (TIMES, TIMES**3 / 9))).run(3.0, method=method)  # a spline that is exact
    np.testing.assert_allclose(cubic.at(3.0), pendulum(t**3 / 9).run(3.0).at(3.0), rtol=1e-7)
    outside = "X is given from t = 0 to 3, and the run goes from 0 to 4: nothing is extrapolated."
    assert refusal(lambda: driven.run(4.0, method=method)).startswith(outside)
    assert refusal(lambda: lg.flow(driven.compile(), method=method)([1.0, 0.0], 0.0, 4.0)).startswith(outside)
    assert np.isnan(driven.compile().rhs(4.0, [1.0, 0.0])[1])


def test_a_function_that_nobody_declared_is_asked_about() -> None:
    clear_cache()  # SymPy may keep an equal function of theta of another test, which `coordinate` did not make
    u, question = (
        Function("undeclared")(t),
        "Is undeclared a coordinate or a given motion? Add lg.coordinate(",
    )
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
