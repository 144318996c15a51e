"""Other expressions for parameters: numbers, ratios such as mu = m1/m2, or one parameter for two."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lagrange.errors import StatementError, formula, listing, shown, suggestion
from lagrange.mechanics.rewriting import rewritten
from lagrange.statement.coordinate import name_of, t
from lagrange.statement.expression import expression
from lagrange.statement.given import given as given_function
from lagrange.statement.motion import motion_of
from lagrange.statement.parameters import in_own_parameters, label_of
from lagrange.statement.statement import Statement
from lagrange.statement.survey import Survey


def substituted(statement: Statement, given: Mapping[Any, Any]) -> Statement:
    """Return the statement with expressions for some parameters, which are keyed by symbol or name.

    Parameters that only the expressions contain are new, and have no value. Raises StatementError for a key that is no
    parameter, and for an expression in coordinates or time: the derivatives of what it stands in would lack its own. A
    given function of time is a key too, with the values of `lagrange.given`.
    """
    if not isinstance(given, Mapping) or not given:
        raise StatementError(f"substitute takes a dict from parameters to values, as {{l: 1}}, not {shown(given)}.")
    by_name = {symbol.name: symbol for symbol in statement.parameters}
    functions = {name_of(function): function for function in statement.given}
    table: dict[Any, Any] = {}
    for key, value in given.items():
        name = label_of(key).removesuffix("(t)")
        if name in functions:
            table[functions[name]] = given_function(name, value)
            continue
        if name not in by_name:
            raise StatementError(_no_parameter(name, statement, list(by_name)))
        table[by_name[name]] = _value(by_name[name], value, by_name)
    for function in statement.given:
        motion = motion_of(function)
        if function not in table and motion and motion.expression is not None:
            table[function] = given_function(name_of(function), motion.expression.subs(table, simultaneous=True))
    left = {p: statement.defaults.get(p) for p in statement.parameters if p not in table}
    new = {symbol for value in table.values() for symbol in value.free_symbols} - {*left, t}
    parameters = left | dict.fromkeys(sorted(new, key=str))
    return rewritten(statement, lambda stated: stated.subs(table, simultaneous=True), parameters=parameters)


def _no_parameter(name: str, statement: Statement, known: list[str]) -> str:
    if name in statement.names:
        return (
            f"{name} is a coordinate: eliminate() solves a constraint for it, transform() states the system in other "
            "coordinates; substitute() replaces parameters."
        )
    parameters = f"its parameters are {listing(known)}." + suggestion(name, known) if known else "it has none."
    return f"{name!r} is no parameter of this system; {parameters}"


def _value(parameter: Any, given: Any, by_name: Mapping[str, Any]) -> Any:
    """Return the expression for a parameter, with the system's own symbols."""
    what = f"the value of {parameter}"
    value, survey = expression(given, what), Survey()
    survey.add(value, what)
    if survey.coordinates or survey.velocities or value.has(t):
        raise StatementError(
            f"{what} is {formula(value, 60)}, which is not constant: state the system with it, so that its derivatives "
            "are taken."
        )
    value = in_own_parameters(value, tuple(by_name.values()))
    if parameter.is_nonnegative and value.is_negative:
        raise StatementError(
            f"{what} is {value}, but {parameter} was declared positive, and SymPy may have dropped an abs or a root "
            f"because of it: declare it with lg.parameters({parameter.name!r}, positive=False)."
        )
    return value
