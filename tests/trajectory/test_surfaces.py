"""The sides on which a run starts, from the state alone: no mass matrix is asked for on sides that are not the state's.

With a side of zero |v|**(3/2) has an infinite inertia, |v|**3 none, and a branch without inertia is taken.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import Abs, Max, Min, Piecewise, Rational, sign, sqrt

from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.run import flow as flow_of
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, build, x, y, z
from tests.trajectory.runs import run

a, b, c = x.dot, y.dot, z.dot

START = {x: 0.4, y: -0.1, z: -0.8, a: 0.7, b: 0.5, c: 0.6}

INERTIAS = {
    "a power of a speed": (1 + x / 10) * a**2 + b**2 + c**2 / 2 + a * Abs(b) ** Rational(3, 2) / 10,
    "another power": (1 + x / 10) * a**2 + b**2 + c**2 / 2 + a * Abs(b) ** Rational(7, 4) / 10,
    "a power of a place": (2 + sqrt(Abs(y))) * a**2 + b**2 + c**2 / 2 + a * b * Abs(x) ** Rational(-1, 4),
    "a cube": Abs(a) ** 3 / 3 + b**2 / 2 + c**2 / 2 - x**2 / 2,
    "a place": Abs(x) * a**2 / 2 + b**2 / 2 + c**2 / 2 - x * y,
    "a sign": (3 * sign(x) + sign(y)) * a**2 / 2 + b**2 / 2 + c**2 / 2 - x * y,
    "a branch": Piecewise((a**2 / 2, x > 0), (0, True)) + b**2 / 2 + c**2 / 2 - x * y,
    "the larger": Max(x, y) * a**2 / 2 - Min(y, z) * b**2 / 2 + c**2 / 2 - x * y,
}


@pytest.mark.parametrize("order", [20, 30, 31, 64])
@pytest.mark.parametrize("name", INERTIAS)
@pytest.mark.parametrize("target", TARGETS)
def test_the_start_is_regular_where_the_state_is(name: str, order: int, target: str) -> None:
    """Orders at which the series of some of these are written out, and at which they are looped."""
    model = build(target, lagrangian=INERTIAS[name], coordinates=[x, y, z], initial=START)
    found = run(model, 0.125, Taylor(rtol=1e-12, atol=1e-13, order=order))
    assert found.status is Status.SUCCESS, found.message
    expected = run(model, 0.125, "dop853", rtol=1e-13, atol=1e-14)
    assert found.y[:, -1] == pytest.approx(expected.y[:, -1], abs=1e-11)


def test_written_out_and_looped_are_both_among_them() -> None:
    model = build(lagrangian=INERTIAS["a power of a speed"], coordinates=[x, y, z], initial=START)
    series, _ = model.series()
    assert [series.form(order) for order in (30, 31)] == ["written out", "in loops"]


@pytest.mark.parametrize("target", TARGETS)
def test_the_order_by_cost_and_a_flow(target: str) -> None:
    model = build(target, lagrangian=INERTIAS["a power of a speed"], coordinates=[x, y, z], initial=START)
    start = np.array(model.statement.initial)
    assert flow_of(model, method="taylor")(start, 0.0, 0.5) == pytest.approx(
        run(model, 0.5, "dop853", rtol=1e-13, atol=1e-14).y[:, -1], abs=1e-9
    )


@pytest.mark.parametrize("target", TARGETS)
def test_an_infinite_inertia_is_not_a_singular_one(target: str) -> None:
    """At rest |v|**(3/2) has an infinite second derivative."""
    start: dict[Any, float] = START | {b: 0.0}
    model = build(target, lagrangian=INERTIAS["a power of a speed"], coordinates=[x, y, z], initial=start)
    assert run(model, 0.125, "taylor").status is Status.NON_FINITE
    assert run(model, 0.125, "dop853").status is Status.NON_FINITE


@pytest.mark.parametrize("target", TARGETS)
def test_a_start_without_inertia_is_still_singular(target: str) -> None:
    start: dict[Any, float] = START | {a: 0.0}
    model = build(target, lagrangian=INERTIAS["a cube"], coordinates=[x, y, z], initial=start)
    assert run(model, 0.125, "taylor").status is Status.SINGULAR


def test_a_surface_that_depends_on_the_side_of_another() -> None:
    """At x = 0 the sign that |y + sign(x)| asks about is decided by the side to which x goes."""
    for speed, force in ((1.0, 1.0), (-1.0, -1.0)):
        model = build(
            kinetic=(a**2 + b**2) / 2, potential=-Abs(y + sign(x)), coordinates=[x, y], initial={a: speed, y: 0.25}
        )
        found = run(model, 1.0, "taylor")
        assert found.y[:, -1] == pytest.approx([speed, 0.25 + force / 2, speed, force], rel=1e-13)
