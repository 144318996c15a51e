"""The statement that a model solves: of redundant constraints the independent ones."""

from __future__ import annotations

from dataclasses import replace

from lagrange.machine.model import Model
from lagrange.statement.statement import REFUSE, Statement


def solved_statement(model: Model) -> Statement:
    """Return the statement of a model without the constraints that follow from others."""
    statement = model.statement
    if not statement.constraints:
        return statement
    solved = model.equations.constraints.names
    kept = tuple(one for one in statement.constraints if one.name in solved)
    if len(kept) == len(statement.constraints):
        return statement
    return replace(statement, constraints=kept, redundant=REFUSE)
