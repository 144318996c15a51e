"""Samples of inputs: the value and the rates at a point of a polynomial in time, one for each input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from sympy import diff

from lagrange.evidence.independent import solved_statement
from lagrange.evidence.sample import Point
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.given import with_values
from lagrange.statement.statement import Statement


def sampled_statement(model: Model) -> tuple[Statement, Callable[[Point], Point]]:
    """Return the statement by which a model is tested, and what makes a point of it one of the model.

    Inputs are polynomials in time with random coefficients there, so that their rates belong to their values.
    """
    statement = solved_statement(model)
    if not statement.inputs or statement.open_form is None:
        return statement, lambda point: point
    kept = [one.name for one in statement.constraints]
    stated = replace(
        statement.open_form, constraints=tuple(c for c in statement.open_form.constraints if c.name in kept)
    )
    varying = with_values(stated)
    polynomials = dict(varying.prescribed)
    rates, table = dict(statement.inputs), dict[Any, Any]()
    for leaf, value in statement.prescribed:
        symbol, polynomial = value, polynomials[leaf]
        while symbol in rates and symbol not in table:
            table[symbol] = polynomial
            symbol, polynomial = rates[symbol], diff(polynomial, t)

    def of_model(point: Point) -> Point:
        at = {**point.parameters, t: point.t}
        inputs = {symbol: float(value.xreplace(at)) for symbol, value in table.items()}
        values = {p: inputs[p] if p in inputs else point.parameters[p] for p in statement.parameters}
        return replace(point, parameters=values)

    return varying, of_model
