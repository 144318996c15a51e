"""Routh's procedure: the reduced system has the motion of the whole, and ignored coordinates are recovered."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, sin

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.mechanics import transformation as routh
from lagrange.statement.statement import Link
from tests.refusals import refusal

m, g, l, I1, I3, k, c = lg.parameters("m g l I1 I3 k c")
theta, phi, psi, x, y = lg.coordinates("theta phi psi x y")


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
        (plain, (x, y), "every coordinate of pair would be ignored: without one nothing is left to move."),
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
        with pytest.raises(StatementError, match=r"this is not a run of a Routhian of pair: run routhian\(...\) of"):
            plain().ignored(run)


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
