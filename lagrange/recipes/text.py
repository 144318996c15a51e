"""The comments of a printed quantity: the entries of its vectors in the user's names."""

from __future__ import annotations

from lagrange.machine.model import Model
from lagrange.program.program import Program


def quantity_program(model: Model, quantity: str) -> Program:
    """Return the program of a quantity by name. Raises StatementError for an unknown one."""
    return model.interpreted(quantity).program


def entries(model: Model) -> list[str]:
    """Return what stands in y and in p, a line each, in plain letters."""
    state, parameters = model.layout.names(), [symbol.name for symbol in model.statement.parameters]
    return [f"{letter} = [{ascii(', '.join(names))[1:-1]}]" for letter, names in (("y", state), ("p", parameters))]
