"""The functions for CasADi: names, both kinds of symbols, singular matrices, undefined values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.errors import StatementError
from tests.recipes.agreement import named, states

casadi: Any = pytest.importorskip("casadi", reason="casadi is not installed")


def test_names_and_sizes() -> None:
    of = named("double-pendulum")
    rhs = of.as_casadi()
    assert rhs.name_in() == ["t", "y", "p"] and rhs.name_out() == ["rhs"]
    assert [rhs.numel_in(k) for k in range(3)] == [1, 4, len(of.parameter_array())]
    assert of.as_casadi("energy").name_out() == ["energy"]


def test_no_parameters_and_unknown_symbols() -> None:
    of = named("henon-heiles")
    assert not of.parameter_array().size
    time, y = list(states(of))[1]
    np.testing.assert_allclose(of.as_casadi()(time, y, []).full().ravel(), of.rhs(time, y), rtol=1e-14)
    with pytest.raises(StatementError, match="'DM' is not a kind of CasADi's symbols: they are SX and MX"):
        of.as_casadi(symbols="DM")
