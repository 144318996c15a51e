"""A quantity of a model as a casadi.Function, loaded from the text that files have."""

from __future__ import annotations

from typing import Any

from lagrange.export.languages.casadi import source
from lagrange.machine.model import Model
from lagrange.machine.python_source import defined
from lagrange.recipes.missing import missing
from lagrange.recipes.text import entries, quantity_program
from lagrange.statement.choice import one_of
from lagrange.statement.number import flag

SYMBOLS = ("SX", "MX")
"""CasADi's kinds of symbols: of numbers, and of matrices."""


def casadi_function(model: Model, quantity: str, symbols: str, *, status: bool) -> Any:
    """Return a quantity as a casadi.Function; see `Model.as_casadi`."""
    program = quantity_program(model, quantity)
    one_of(symbols, SYMBOLS, "{given} is no kind of CasADi's symbols: they are {known}.")
    try:
        import casadi
    except ImportError as error:
        raise missing("as_casadi", "pip install casadi", error) from error
    name = f"{quantity}_checked" if flag(status, "status") else quantity
    return defined(source(program, quantity, entries(model)), name, {})(getattr(casadi, symbols))
