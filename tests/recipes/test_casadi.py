"""The functions for CasADi: names, symbols of either kind, singular matrices, what has no value."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.errors import StatementError
from tests.models import build, model, x
from tests.recipes.agreement import named, singular, states, unbounded

casadi: Any = pytest.importorskip("casadi", reason="casadi is not installed")


def test_names_and_sizes() -> None:
    of = named("double-pendulum")
    rhs = of.as_casadi()
    assert rhs.name_in() == ["t", "y", "p"] and rhs.name_out() == ["rhs"]
    assert [rhs.numel_in(k) for k in range(3)] == [1, 4, len(of.parameter_array())]
    assert of.as_casadi("energy").name_out() == ["energy"]


def test_both_kinds_of_symbols_give_the_same_digits() -> None:
    of = named("four-bar")
    made = [of.as_casadi(symbols=kind) for kind in ("SX", "MX")]
    assert [one.is_a("SXFunction") for one in made] == [True, False]
    for time, y in states(of):
        np.testing.assert_array_equal(*(one(time, y, of.parameter_array()).full() for one in made))


def test_no_parameters_and_unknown_symbols() -> None:
    of = named("henon-heiles")
    assert not of.parameter_array().size
    time, y = list(states(of))[1]
    np.testing.assert_allclose(of.as_casadi()(time, y, []).full().ravel(), of.rhs(time, y), rtol=1e-14)
    with pytest.raises(StatementError, match="'DM' is not a kind of CasADi's symbols: they are SX and MX"):
        of.as_casadi(symbols="DM")


@pytest.mark.parametrize("n", [2, 6])
@pytest.mark.parametrize("symbols", ["SX", "MX"])
def test_a_singular_mass_matrix_is_nan_throughout_and_told(n: int, symbols: str) -> None:
    of = singular(n)
    regular, degenerate = np.ones(2 * n), np.array([0.0, 0.0, *[1.0] * (2 * n - 2)])
    checked, p = of.as_casadi(symbols=symbols, status=True), of.parameter_array()
    assert checked.name_out() == ["rhs", "singular"]
    assert [float(checked(0.0, y, p)[1]) for y in (regular, degenerate)] == [0.0, 1.0]
    rhs = of.as_casadi(symbols=symbols)
    assert np.isnan(rhs(0.0, degenerate, p).full()).all()
    np.testing.assert_allclose(rhs(0.0, regular, p).full().ravel(), of.rhs(0.0, regular), rtol=1e-13)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_a_matrix_that_is_not_finite_is_not_singular(n: int) -> None:
    of = unbounded(n)
    p = of.parameter_array()
    checked = of.as_casadi(status=True)
    for first in (0.0, -1.0, np.nan):
        state = np.array([first, *[1.0] * (2 * n - 1)])
        result, status = checked(0.0, state, p)
        np.testing.assert_array_equal(result.full().ravel(), of.interpreted("rhs")(0.0, state, p))
        assert float(status) == 0.0


def test_what_has_no_value_is_nan_or_infinite_as_in_the_model() -> None:
    of = build("numpy", kinetic=x.dot**2 / 2, potential=1 / x + x ** (5 / 2), initial={x: 1.0})
    rhs, p = of.as_casadi(), of.parameter_array()
    for y in ([0.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], [np.inf, 1.0], [1.0, -np.inf]):
        state = np.array(y)
        np.testing.assert_array_equal(rhs(0.0, state, p).full().ravel(), of.kernel("rhs")(0.0, state, p))


def test_an_integrator_of_casadi_runs_it() -> None:
    of = model("pendulum", "numpy")
    rhs, p = of.as_casadi(), of.parameter_array()
    t, y = casadi.SX.sym("t"), casadi.SX.sym("y", 2)
    run = casadi.integrator("run", "cvodes", {"x": y, "t": t, "ode": rhs(t, y, p)}, 0.0, 1.0, {"reltol": 1e-10})
    found = run(x0=[1.0, 0.0])["xf"].full().ravel()
    energies = [of.energy(state[:1], state[1:]) for state in (np.array([1.0, 0.0]), found)]
    assert abs(energies[1] - energies[0]) < 1e-6
