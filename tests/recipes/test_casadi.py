"""The functions for CasADi: names, both kinds of symbols, singular matrices, undefined values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.errors import StatementError
from tests.models import model
from tests.recipes.agreement import named, states

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
    assert [item.is_a("SXFunction") for item in made] == [True, False]
    for time, y in states(of):
        np.testing.assert_array_equal(*(item(time, y, of.parameter_array()).full() for item in made))


def test_no_parameters_and_unknown_symbols() -> None:
    of = named("henon-heiles")
    assert not of.parameter_array().size
    time, y = list(states(of))[1]
    np.testing.assert_allclose(of.as_casadi()(time, y, []).full().ravel(), of.rhs(time, y), rtol=1e-14)
    with pytest.raises(StatementError, match="'DM' is not a kind of CasADi's symbols: they are SX and MX"):
        of.as_casadi(symbols="DM")


def test_an_integrator_of_casadi_runs_it() -> None:
    of = model("pendulum", "numpy")
    rhs, p = of.as_casadi(), of.parameter_array()
    t, y = casadi.SX.sym("t"), casadi.SX.sym("y", 2)
    run = casadi.integrator("run", "cvodes", {"x": y, "t": t, "ode": rhs(t, y, p)}, 0.0, 1.0, {"reltol": 1e-10})
    result = run(x0=[1.0, 0.0])["xf"].full().ravel()
    energies = [of.energy(state[:1], state[1:]) for state in (np.array([1.0, 0.0]), result)]
    assert abs(energies[1] - energies[0]) < 1e-6
