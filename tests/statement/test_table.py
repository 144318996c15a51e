"""Forces and potentials given by tables: `lagrange.table`."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import lagrange as lg

x, y = lg.coordinates("x y")
m, a, e = lg.parameters("m a e")

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
        (x, [0, 1, 2, 3], [0, math.nan, 2, 3], "give two lists of finite numbers"),
        (x, [0, 1, 2, 3], [0, 1, 2], r"has points of shape \(4,\) and values of shape \(3,\)"),
        (x, [0, 1, 2], [0, 1, 2], "has 3 points: give 4 to 200"),
        (x, np.arange(201), np.arange(201), "has 201 points: give 4 to 200. Thin a longer table out"),
        (1.5, [0, 1, 2, 3], [0, 1, 2, 3], "the argument of the table is 1.5, a number"),
    ],
)
def test_what_is_no_table_is_refused(argument: Any, points: Any, values: Any, said: str) -> None:
    with pytest.raises(lg.StatementError, match=said):
        lg.table(argument, points, values)


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
