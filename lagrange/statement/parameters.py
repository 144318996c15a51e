"""Parameters of a statement: their symbols and values, and tables that users key by symbol or name."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import Any

import sympy

from lagrange.errors import StatementError, listing, shown, suggestion
from lagrange.statement.coordinate import PARAMETERS, check_name, check_symbol, name_of, t
from lagrange.statement.given.motion import motion_of
from lagrange.statement.number import real_number
from lagrange.statement.survey import Survey


def parameter_values(
    given: Mapping[Any, Any] | None, parameters: tuple[Any, ...], defaults: Mapping[Any, float]
) -> dict[Any, float]:
    """Return a value for every parameter: the defaults overlaid with `given`, keyed by symbol or name.

    Raises StatementError for an unknown name, a value that is not a finite real number, and a parameter without a
    value.
    """
    by_name = {symbol.name: symbol for symbol in parameters}
    values = dict(defaults)
    for key, value in table_of(given, "parameters", "parameter to value").items():
        label = label_of(key)
        if label not in by_name:
            raise StatementError(
                f"{label!r} is not a parameter of this system; its parameters are {listing(by_name)}."
                + suggestion(label, by_name)
            )
        values[by_name[label]] = _within(by_name[label], real_number(value, f"parameter {label}"))
    missing = [symbol.name for symbol in parameters if symbol not in values]
    if missing:
        raise StatementError(
            f"no value for {'parameter' if len(missing) == 1 else 'parameters'} {listing(missing)}: give one, for "
            f"example parameters={{'{missing[0]}': 1.0}}."
        )
    return values


def label_of(key: Any) -> str:
    """Return the name of a key of a user's table, such as `theta_dot` for a velocity; for messages and for lookup."""
    if isinstance(key, str):
        return key[:80]
    if not isinstance(key, sympy.Basic):
        return shown(key)
    if isinstance(key, sympy.Derivative) and key.expr.args == (t,) and set(key.variables) == {t}:
        return rate_name(name_of(key.expr), len(key.variables))
    if isinstance(key, sympy.Symbol):
        return str(key.name)
    return name_of(key) if key.args == (t,) else shown(key)


def rate_name(name: str, order: int) -> str:
    """Return the name of a derivative in time: x, x_dot, x_ddot, x_dddot."""
    return f"{name}_{'d' * order}ot" if order else name


def coordinate_name(key: Any, names: Sequence[str]) -> str:
    """Return the name of the coordinate that a key names. Raises StatementError for an unknown one."""
    name = label_of(key)
    if name not in names:
        raise StatementError(
            f"{name!r} is not a coordinate of this system; they are {listing(names)}.{suggestion(name, names)}"
        )
    return name


def table_of(given: Any, what: str, entries: str) -> Mapping[Any, Any]:
    """Return a mapping, empty for None. Raises StatementError otherwise, with `entries`, such as "name to point"."""
    if given is not None and not isinstance(given, Mapping):
        raise StatementError(f"{what} is a {type(given).__name__}: give a dict from {entries}.")
    return given or {}


def parameter_symbols(
    survey: Survey, given: Mapping[Any, Any], functions: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[Any, Any]]:
    """Return the parameters by name, and replacements that unify symbols of the same name.

    Order: first the parameters with values, in the order of `given`, then the others in the order of declaration.
    """
    symbols: dict[str, Any] = {}
    unify: dict[Any, Any] = {}
    for symbol in [*survey.parameters, *(key for key in given if isinstance(key, sympy.Symbol))]:
        first = symbols.setdefault(check_name(symbol.name, "parameter"), symbol)
        if symbol != first and first.is_nonnegative and not symbol.is_nonnegative:
            symbols[symbol.name] = symbol  # of two symbols keep the one without an assumed sign
    for symbol in survey.parameters:
        if symbol != symbols[symbol.name]:
            unify[symbol] = symbols[symbol.name]
    for key in given:
        if isinstance(key, str):
            symbols.setdefault(check_name(key, "parameter"), sympy.Symbol(key, real=True))
        elif not isinstance(key, sympy.Symbol):
            raise StatementError(f"parameters names {shown(key)}: its keys are parameters (symbols) or their names.")
    for name in symbols:
        _check_clash(name, functions)
    valued = dict.fromkeys(label_of(key) for key in given)
    rest = PARAMETERS.of((name, name) for name in symbols if name not in valued)
    ordered = {name: symbols[name] for name in (*valued, *rest)}
    return ordered, unify


def in_own_parameters(value: Any, parameters: Sequence[Any]) -> Any:
    """Return an expression with a system's own parameters for symbols of the same name.

    Parameters of a scene have no assumed sign, those of `lg.parameters` are positive: to SymPy they differ.
    """
    by_name = {p.name: p for p in parameters}
    others = {s: by_name[s.name] for s in value.free_symbols if s.name in by_name and s not in parameters}
    return value.xreplace(others) if others else value


_MEANT = {t.name: "time: use lg.t for time", "pi": "the constant: use sympy.pi for the constant"}
"""Names that probably mean time or pi, with their meaning and the spelling to use instead."""


def _check_clash(name: str, by_name: Mapping[str, Any]) -> None:
    if name in _MEANT:
        raise StatementError(f"parameter {name!r} clashes with {_MEANT[name]}, and another name for the parameter.")
    check_symbol(name, "parameter")
    if name in by_name and motion_of(by_name[name]) is not None:
        raise StatementError(f"{name} is both a given function and a parameter: rename one.")
    if name in by_name:
        raise StatementError(
            f"{name} is both a coordinate and a parameter: rename one. If the plain symbol {name} was meant as the "
            f"coordinate, use lg.coordinate('{name}') there."
        )
    check_rate(name, by_name, "parameter")


def check_rate(name: str, by_name: Container[str], what: str) -> None:
    """Raise StatementError for a name such as `x_dot` or `x_ddot` of a coordinate x."""
    base, _, rate = name.rpartition("_")
    if base in by_name and rate in ("dot", "ddot"):
        kind = "velocity" if rate == "dot" else "acceleration"
        raise StatementError(
            f"{what} {name} has the name of {'a' if rate == 'dot' else 'an'} {kind}: write {base}.{rate} for the "
            f"{kind}, or "
            f"rename the {what}."
        )


def default_values(given: Mapping[Any, Any], symbols: dict[str, Any]) -> dict[Any, float]:
    """Return the values that a statement gives its parameters, by symbol."""
    values: dict[Any, float] = {}
    for key, value in given.items():
        symbol = symbols[label_of(key)]
        if symbol in values:
            raise StatementError(f"parameters gives {symbol.name} twice: give it once.")
        if value is not None:
            values[symbol] = _within(symbol, real_number(value, f"parameter {symbol.name}"))
    return values


def _within(symbol: Any, value: float) -> float:
    """Return the value. Raises StatementError for one below zero if the symbol was declared positive."""
    if value < 0 and symbol.is_nonnegative:
        raise StatementError(
            f"parameter {symbol.name} is {value:g}, but its symbol was declared positive, and SymPy may have dropped "
            f"an abs or a root because of it: declare it with lg.parameters('{symbol.name}', positive=False)."
        )
    return value
