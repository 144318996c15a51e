"""The multiplier of a constraint as a SymPy symbol. Its name has brackets, which no parameter may have."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from sympy import Symbol

from lagrange.errors import StatementError, listing, suggestion
from lagrange.statement.coordinate import check_name

_OPENING, _CLOSING = "lambda[", "]"


def multiplier(name: str) -> Any:
    """Return the multiplier of the constraint of that name, for forces, events and `solution.evaluate`.

    It is the factor lambda in the generalized forces lambda dphi/dq that the constraint phi = 0 exerts, and a SymPy
    symbol that prints as lambda[name]. Raises StatementError for a name that is not an
    identifier.
    """
    return Symbol(f"{_OPENING}{check_name(name, 'constraint')}{_CLOSING}", real=True)


def constraint_of(symbol: Any) -> str | None:
    """Return the name of the constraint if the symbol is its multiplier, else None."""
    name = str(symbol.name)
    if name.startswith(_OPENING) and name.endswith(_CLOSING):
        return name.removeprefix(_OPENING).removesuffix(_CLOSING)
    return None


def check_multipliers(names: Iterable[str], what: str, held: Sequence[str], system: str) -> None:
    """Raise StatementError for the multiplier of an unknown constraint.

    `names` are the constraints whose multipliers an expression contains, `held` the constraints of the system.
    """
    for name in names:
        if name not in held:
            have = f"the constraints are {listing(held)}" if held else f"{system} has no constraints"
            raise StatementError(f"{what} contains {multiplier(name)}, but {have}." + suggestion(name, held))
