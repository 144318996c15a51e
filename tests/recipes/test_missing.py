"""A recipe without its package is refused with the package and the command that installs it."""

from __future__ import annotations

import sys

import pytest

import lagrange as lg
from lagrange.errors import StatementError
from tests.models import model


@pytest.mark.parametrize("command", ["pip install jax", "pip install casadi", "pip install numba"])
def test_a_missing_package_is_named_with_its_command(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    package = command.split()[2]
    monkeypatch.setitem(sys.modules, package, None)
    expected = rf"model\.as_{package}\(\) needs {package}, which cannot be imported \(.*\): {command}$"
    with pytest.raises(StatementError, match=expected):
        getattr(model("pendulum", "llvm"), f"as_{package}")()


@pytest.mark.parametrize("method", ["as_jax", "as_casadi", "as_numba", "as_sympy"])
def test_an_unknown_quantity_is_refused_with_the_list(method: str) -> None:
    with pytest.raises(
        StatementError, match=r"'rsh' is not a quantity of a model: they are rhs, jacobian.*\. Did you mean 'rhs'\?"
    ):
        getattr(model("pendulum", "llvm"), method)("rsh")


def test_the_public_class_has_the_recipes() -> None:
    assert isinstance(lg.scene("pendulum").compile("numpy"), lg.Model)
    assert {name for name in dir(lg.Model) if name.startswith("as_")} == {
        *("as_casadi", "as_jax", "as_numba", "as_scipy", "as_sympy")
    }
