"""The conserved quantity of a symmetry that a user gives; refused, with the rate of the quantity, where it is none.

Source: V. I. Arnold, Mathematical Methods of Classical Mechanics, 2nd ed., 1989, section 20.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sympy import Float, Rational, S

from lagrange.equations.identities import canonical
from lagrange.equations.terms import TooLargeError, differentiable
from lagrange.equations.textbook_algebra import TextbookAlgebra
from lagrange.errors import StatementError, formula, listing, shown, suggestion
from lagrange.machine.model import Model
from lagrange.mechanics.quantity_rates import check_constant, quantity_rates
from lagrange.mechanics.symmetries import Symmetry, SymmetryEquation
from lagrange.statement.coordinate import t
from lagrange.statement.expression import expression
from lagrange.statement.parameters import in_own_parameters, label_of
from lagrange.statement.statement import Statement
from lagrange.statement.survey import Survey

LONGEST_SHOWN = 200
"""Characters of a quantity in a message."""


def noether_quantity(model: Model, generator: Mapping[Any, Any]) -> Any:
    """Return p . xi - tau E - F of a symmetry {q: xi, t: tau}; raises StatementError where it is none."""
    statement = model.statement
    given = _given(statement, generator)
    stated = TextbookAlgebra(statement)
    equation = SymmetryEquation(stated)
    xi = tuple(differentiable(given.get(q, S.Zero).xreplace(stated.plain)) for q in statement.coordinates)
    try:
        moved = Symmetry(xi, given.get(t, S.Zero))
        symmetry = equation.completed(moved) or moved
        quantity = stated.show(equation.quantity(symmetry))
        if _kept(model, symmetry) and equation.proven(symmetry):
            check_constant(model, {"the quantity of this symmetry": quantity})
            return quantity
    except TooLargeError:
        raise StatementError(
            f"{statement.name} is too large for this symmetry to be tested in symbols: substitute numbers for its "
            "parameters."
        ) from None
    raise StatementError(_refusal(model, stated, equation, symmetry, quantity))


def _given(statement: Statement, generator: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return the generator by coordinate, and t, checked."""
    if not isinstance(generator, Mapping) or not generator:
        raise StatementError(
            f"noether takes a dict from coordinates to how they move, as {{x: -y, y: x}}, not {shown(generator)}."
        )
    by_name = {**dict(zip(statement.names, statement.coordinates, strict=True)), t.name: t}
    found: dict[Any, Any] = {}
    for key, value in generator.items():
        label = label_of(key)
        if label not in by_name:
            raise StatementError(
                f"{label!r} is no coordinate of this system and not t; its coordinates are {listing(statement.names)}."
                + suggestion(label, list(statement.names))
            )
        what, survey = f"the motion of {label}", Survey()
        stated = in_own_parameters(expression(value, what), statement.parameters)
        # Symmetries are proven with exact numbers: a decimal is the fraction that it is written as.
        found[by_name[label]] = stated.xreplace({number: Rational(str(number)) for number in stated.atoms(Float)})
        survey.add(found[by_name[label]], what)
        known = (*statement.coordinates, *statement.parameters)
        if survey.velocities or (label == t.name and (survey.coordinates or found[t].has(t))):
            where = "parameters alone" if label == t.name else "coordinates, parameters and t"
            raise StatementError(f"{what} is {shown(str(value))}: a point symmetry has an expression in {where}.")
        for leaf in (*survey.coordinates, *survey.parameters):
            if leaf not in known:
                raise StatementError(
                    f"{what} contains {leaf}, which this system does not have; it has {listing(map(str, known))}."
                )
    return found


def _kept(model: Model, symmetry: Symmetry) -> bool:
    """Whether the forces of constraints do no work in a shift of time, or there is none."""
    return symmetry.tau == 0 or model.equations.structure.workless


def _refusal(
    model: Model, stated: TextbookAlgebra, equation: SymmetryEquation, symmetry: Symmetry, quantity: Any
) -> str:
    """Return why the generator is no symmetry, with the rate of its quantity."""
    (found,) = quantity_rates(model, [quantity])
    worst = found.worst
    across = [
        one.name
        for one, terms in zip(model.statement.constraints, equation.across(symmetry), strict=True)
        if canonical(stated.algebra, terms)
    ]
    if worst is None:
        return (
            f"it was not found that this is a symmetry of {model.statement.name}: no proof was found that its quantity "
            f"{_spelled(model, quantity)} is conserved, and no state at which it changes."
        )
    rate = str(stated.show(equation.defect(symmetry)).xreplace(dict(model.statement.plain)))
    formula = "" if across or len(rate) > LONGEST_SHOWN else f" {rate}, which is"
    cause = f" It does not keep the constraint {listing(across)}." if across else ""
    return (
        f"this is no symmetry of {model.statement.name}: its quantity {_spelled(model, quantity)} changes at the "
        f"rate{formula} {found.values[worst]:.4g} at {found.described(worst)}.{cause}"
    )


def _spelled(model: Model, quantity: Any) -> str:
    """Return a quantity in the spelling of scenes, cut where it is long."""
    return formula(quantity.xreplace(dict(model.statement.plain)), LONGEST_SHOWN)
