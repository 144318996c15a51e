"""Expressions of a user about a system, as nodes of its equations."""

from __future__ import annotations

from typing import Any

from lagrange.equations.euler_lagrange import Equations
from lagrange.errors import StatementError
from lagrange.graph.node import Node
from lagrange.statement.expression import expression as expression_of
from lagrange.statement.multiplier import check_multipliers
from lagrange.statement.parameters import in_own_parameters
from lagrange.statement.statement import Statement
from lagrange.statement.survey import Survey


def node_of(expression: Any, statement: Statement, equations: Equations) -> Node:
    """Return a SymPy expression in q, v, accelerations, multipliers, parameters and t as a node of the equations.

    Raises StatementError for an expression with anything else in it.
    """
    stated = expression_of(expression, "the expression")
    expression = in_own_parameters(stated, statement.parameters)
    survey = Survey()
    survey.add(expression, "the expression", accelerations=True, multipliers=True)
    check_multipliers(
        survey.multipliers, "the expression", [constraint.name for constraint in statement.constraints], statement.name
    )
    for leaf in (*survey.coordinates, *survey.given, *survey.unknown, *survey.parameters):
        if leaf not in equations.leaves:
            raise StatementError(f"the expression contains {leaf}, which this system does not have.")
    return equations.translate(expression)
