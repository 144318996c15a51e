"""The multiplier of a constraint as a SymPy symbol. Its name has brackets, so that no parameter has the same."""

from __future__ import annotations

from typing import Any

from sympy import Symbol

from lagrange.statement.coordinate import check_name

_OPENING, _CLOSING = "lambda[", "]"


def multiplier(name: str) -> Any:
    """Return the multiplier of the constraint of that name, for events and `solution.evaluate`.

    It is the factor lambda in the generalized forces lambda dphi/dq that the constraint phi = 0 exerts, and a SymPy
    symbol that prints as lambda[name]. Raises StatementError for a name that is no identifier.
    """
    return Symbol(f"{_OPENING}{check_name(name, 'constraint')}{_CLOSING}", real=True)


def constraint_of(symbol: Any) -> str | None:
    """Return the name of the constraint whose multiplier a symbol is, or None."""
    name = str(symbol.name)
    if name.startswith(_OPENING) and name.endswith(_CLOSING):
        return name.removeprefix(_OPENING).removesuffix(_CLOSING)
    return None
