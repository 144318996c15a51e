"""Comparison of compiled numbers with the formulas of a statement, at random states."""

from __future__ import annotations

import cmath
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from sympy import diff

from lagrange.errors import FAULT, RunError
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.given.function import with_values
from lagrange.statement.random_states import SamplePoint, holds, random_points
from lagrange.statement.statement import REFUSE, Statement


def solved_statement(model: Model) -> Statement:
    """Return the statement of a model, without constraints that follow from others."""
    statement = model.statement
    if not statement.constraints:
        return statement
    solved = model.equations.constraints.names
    kept = tuple(constraint for constraint in statement.constraints if constraint.name in solved)
    if len(kept) == len(statement.constraints):
        return statement
    return replace(statement, constraints=kept, redundant=REFUSE)


def sampled_statement(model: Model) -> tuple[Statement, Callable[[SamplePoint], SamplePoint]]:
    """Return the statement that a model is tested with, and a function from its points to points of the model.

    Inputs of the model become polynomials in time with random coefficients, so that their values and rates are
    consistent.
    """
    statement = solved_statement(model)
    if not statement.inputs or statement.open_form is None:
        return statement, lambda point: point
    kept = [constraint.name for constraint in statement.constraints]
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

    def of_model(point: SamplePoint) -> SamplePoint:
        at = {**point.parameters, t: point.t}
        inputs = {symbol: float(value.xreplace(at)) for symbol, value in table.items()}
        values = {p: inputs[p] if p in inputs else point.parameters[p] for p in statement.parameters}
        return replace(point, parameters=values)

    return varying, of_model


PLACES = 2
"""Number of random states at which a formula is compared. A wrong formula agrees at one with probability zero."""

LARGEST_ERROR = 1e-8
"""Largest difference, relative to the largest number compared. Cancellation costs some digits, a wrong term all."""


Values = Callable[[SamplePoint], tuple[Sequence[float], Sequence[complex]]]
"""Function that returns compiled numbers and the values of their formulas at a point."""


def compared(what: str, statement: Statement, values: Values) -> None:
    """Compare values of formulas with compiled numbers at random states.

    `values(point)` returns the compiled numbers and those of the formulas. Raises RunError if they differ; its
    message begins with `what`. A state at which a formula or a compiled number has no value is skipped.
    """
    holds(random_points(statement, seed=0), lambda point: agrees(what, statement, point, values), PLACES)


def agrees(what: str, statement: Statement, point: SamplePoint, values: Values) -> bool | None:
    """Return True if compiled numbers and values of formulas agree at a point; None if one has no value there.

    `values(point)` returns both. Raises RunError if they differ; its message begins with `what`.
    """
    try:
        compiled, formulas = values(point)
    except RunError:
        return None
    if not all(map(cmath.isfinite, (*compiled, *formulas))):
        return None
    off = np.abs(np.asarray(formulas) - np.asarray(compiled))
    scale = max(1e-300, *map(abs, compiled), *map(abs, formulas))
    if off.max() > LARGEST_ERROR * scale:
        worst = int(off.argmax())
        raise RunError(
            f"{what} of {statement.name} is wrong: a formula gives {formulas[worst]:.15g} where {compiled[worst]:.15g} "
            f"is compiled, at {point.describe(statement.names)}. {FAULT}"
        )
    return True
