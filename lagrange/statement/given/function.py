"""Given functions of time, `lagrange.given`: known motions as expressions or tables, and inputs without values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, formula, listing, suggestion
from lagrange.statement.coordinate import check_symbol, function_of_time, name_of, t
from lagrange.statement.expression import expression
from lagrange.statement.given.motion import MARK, Motion, checked_table, motion_of
from lagrange.statement.parameters import Survey, check_rate, rate_name
from lagrange.statement.statement import Statement

DEGREE = 3
"""Degree of the polynomial that replaces a function without values while the structure of the equations is analysed."""
EXTRA_ORDERS = 2
"""Number of derivatives of an input beyond the highest one in the statement. Equations contain none of higher order."""


def given(name: str, values: Any = None) -> Any:
    """Return the given function of time `name`: a motion that is known, or an input.

    `values` is an expression in `lagrange.t` and parameters, or a table (times, values) of 4 to 200 increasing times. A
    cubic spline joins the values of a table: its first and second derivatives are continuous. The expression may
    contain given functions that have values. Without `values` the function stays open: derivations contain it with its
    derivatives, and a run raises StatementError. `.dot` and `.ddot` are its derivatives. Raises StatementError for
    other values.
    """
    check_symbol(name, "given function")
    return function_of_time(name, {MARK: Motion(_values(f"the given function {name}", values))})


def _values(what: str, values: Any) -> Any:
    """Return the checked values of a given function: an expression in t and parameters, a table, or None.

    `what` is the name of the function in messages. Raises StatementError for other values.
    """
    if values is None:
        return None
    if isinstance(values, (list, tuple, np.ndarray)):
        return checked_table(what, values, "times")
    stated, survey = expression(values, what), Survey()
    if (motion := motion_of(stated)) is not None and motion.values is not None:
        return motion.values
    survey.add(stated, what)
    formulas: dict[Any, Any] = {}
    for function, highest in survey.given.items():
        motion = motion_of(function)
        if motion is None or motion.values is None:
            raise StatementError(
                f"{what} is {formula(stated, 60)}, which contains {function}, a given function without values: give "
                "an expression in lg.t and parameters, or a table (times, values)."
            )
        for order in range(highest + 1):
            formulas[sympy.Derivative(function, (t, order)) if order else function] = motion.derivative(order)
    stated = stated.xreplace(formulas)
    leaves = [*survey.coordinates, *survey.unknown]
    if leaves:
        raise StatementError(
            f"{what} is {formula(stated, 60)}, which contains {leaves[0]}: give an expression in lg.t and parameters. "
            "A given function cannot depend on the motion: state such a term in a force, a constraint or an energy."
        )
    return stated


def coordinate_or_given(name: str, coordinates: Sequence[str]) -> str:
    """Return the message for an undeclared function of time, which may be meant as a coordinate or as a given motion.

    `coordinates` are the names of the declared coordinates.
    """
    return (
        f"{name} is a function of time that is not among the declared coordinates, {listing(coordinates)}. Is {name} a "
        f"coordinate or a given motion? Add lg.coordinate({name!r}) to coordinates if its motion is to be found. Write "
        f"lg.given({name!r}), or with values lg.given({name!r}, sin(lg.t)), for a given motion or input."
        f"{suggestion(name, coordinates)}"
    )


def check_given(survey: Survey, coordinates: Mapping[str, Any]) -> None:
    """Raise StatementError for a function of time that is neither a coordinate nor a given function.

    The error is also raised for given functions whose name is taken, or whose tables have no time in common.
    `coordinates` maps names to coordinates, and `survey` has the functions of the statement.
    """
    if undeclared := [q for q in survey.coordinates if coordinates.get(name_of(q)) != q]:
        raise StatementError(coordinate_or_given(name_of(undeclared[0]), [*coordinates]))
    names: dict[str, Any] = {}
    for function in survey.given:
        name = name_of(function)
        if name in coordinates or name in names:
            other = "a coordinate" if name in coordinates else "a given function with other values"
            raise StatementError(f"{name} names a given function of time and {other}: rename one of them.")
        check_rate(name, coordinates, "given function")
        names[name] = function
    spans = {name: motion.span for name, function in names.items() if (motion := motion_of(function)) is not None}
    if spans and max(first for first, _ in spans.values()) >= min(last for _, last in spans.values()):
        raise StatementError(f"the tables of {listing(spans)} have no times in common: give them over the same times.")


def with_values(statement: Statement) -> Statement:
    """Return the statement with its given functions replaced by their expressions in t.

    Given functions without values, and undefined functions of coordinates such as U(r), become polynomials with symbols
    as coefficients. So the equations can be analysed, but not run: `require_values` refuses to run them.
    """
    coefficients: dict[Any, None] = {}

    def polynomial(function: Any) -> Callable[[int], Any]:
        return Motion(_polynomial(name_of(function), (t,), coefficients)).derivative

    return _put_in(statement, polynomial, coefficients)


def with_inputs(statement: Statement) -> Statement:
    """Return the statement with given functions replaced by their values. Functions without values become inputs.

    An input is a parameter whose value changes along a motion. A function X gives the inputs X, X_dot, X_ddot, ...;
    the time derivative of each input is the next one.
    """
    rates: dict[Any, Any] = {}

    def symbols(function: Any) -> Callable[[int], Any]:
        count = statement.highest(function) + 1 + EXTRA_ORDERS
        chain = [sympy.Symbol(rate_name(name_of(function), order), real=True) for order in range(count)]
        rates.update(zip(chain, [*chain[1:], None], strict=True))
        return chain.__getitem__

    filled = _put_in(statement, symbols, rates)
    return filled if filled is statement else replace(filled, inputs=tuple(rates.items()))


def _put_in(
    statement: Statement, open_values: Callable[[Any], Callable[[int], Any]], symbols: dict[Any, Any]
) -> Statement:
    """Return the statement with given functions replaced by their values, and undefined functions by polynomials.

    For a given function without values, `open_values(function)` returns a callable that maps an order to the expression
    that replaces the derivative of this order. The callable adds new symbols of these expressions to `symbols`, which
    become the last parameters.
    """
    if statement.prescribed or not (statement.given or statement.unknown):
        return statement
    table: dict[Any, Any] = {}
    by_name = {p.name: p for p in statement.parameters}
    for function in statement.given:
        motion = motion_of(function)
        known_values = motion is not None and motion.values is not None
        derivative = motion.derivative if motion is not None and known_values else open_values(function)
        for order in range(statement.highest(function) + 1):
            value = derivative(order)
            replaced = {p: by_name[p.name] for p in value.free_symbols if p.name in by_name and p not in symbols}
            table[sympy.Derivative(function, (t, order)) if order else function] = value.xreplace(replaced)

    def put(expression: Any) -> Any:
        replaced = expression.xreplace(table)
        return _written_out(replaced, symbols) if statement.unknown else replaced

    return replace(
        statement.mapped(put),
        prescribed=tuple(table.items()),
        open_form=statement,
        parameters=(*statement.parameters, *symbols),
    )


def _polynomial(name: str, arguments: Sequence[Any], coefficients: dict[Any, None]) -> Any:
    """Return a polynomial of degree `DEGREE` in the arguments. Its coefficients are new symbols, added to the dict."""
    monomials = [arguments[0] ** k for k in range(DEGREE + 1)]
    if len(arguments) > 1:
        monomials = sorted(sympy.itermonomials(arguments, DEGREE), key=str)
    symbols = [sympy.Symbol(f"{name}[{k}]", real=True) for k in range(len(monomials))]
    coefficients.update(dict.fromkeys(symbols))
    return sympy.Add(*(c * term for c, term in zip(symbols, monomials, strict=True)))


def _written_out(expression: Any, coefficients: dict[Any, None]) -> Any:
    """Return the expression with polynomials in place of its undefined functions of coordinates, such as U(r).

    The coefficients of the polynomials are new symbols, which are added to `coefficients`.
    """
    functions = [node for node in expression.atoms(AppliedUndef) if node.args != (t,)]
    for function in sorted({node.func for node in functions}, key=str):
        arguments = [sympy.Dummy(real=True) for _ in range(max(len(n.args) for n in functions if n.func == function))]
        polynomial = _polynomial(function.__name__, arguments, coefficients)
        expression = expression.replace(function, sympy.Lambda(tuple(arguments), polynomial))
    return expression.replace(_is_pending, lambda node: node.doit())


def _is_pending(node: Any) -> bool:
    """Return True for a derivative or substitution that SymPy has not evaluated, except time derivatives."""
    return isinstance(node, sympy.Subs) or (
        isinstance(node, sympy.Derivative) and not (isinstance(node.expr, AppliedUndef) and node.expr.args == (t,))
    )


def require_values(statement: Statement, remedy: str = "") -> None:
    """Raise StatementError if a given function has no values, or if a function of coordinates has no formula.

    The message first offers the text `remedy`, such as "linearize(inputs=[{}])", with the function's name in {}.
    """
    names = [name_of(function) for function in open_functions(statement)]
    if names:
        is_open = "is a given function of time, and has" if len(names) == 1 else "are given functions of time, and have"
        raise StatementError(
            f"{listing(names)} {is_open} no values to compute with: {remedy.format(names[0])}"
            f"state lg.given({names[0]!r}, expression in lg.t) or lg.given({names[0]!r}, (times, values)), or put one "
            f"in with system.substitute({{{names[0]!r}: ...}})."
        )
    statement.require_formulas()


def open_functions(statement: Statement) -> list[Any]:
    """Return the given functions of a statement that have no values."""
    motions = [(function, motion_of(function)) for function in statement.given]
    return [function for function, motion in motions if motion is None or motion.values is None]


def check_span(statement: Statement, t0: float, t1: float) -> None:
    """Raise StatementError for a run from t0 to t1 outside the times of a table."""
    for function in statement.given:
        motion = motion_of(function)
        first, last = motion.span if motion else (-np.inf, np.inf)
        if min(t0, t1) < first or max(t0, t1) > last:
            raise StatementError(
                f"{name_of(function)} is given from t = {first:g} to {last:g}, and the run goes from {t0:g} to {t1:g}: "
                "nothing is extrapolated. Give a longer table, or t_start and t_end within it."
            )


def replaced(function: Any, values: Any) -> Mapping[Any, Any]:
    """Return {function: given function of the same name with these `values`}, to replace it in expressions."""
    return {function: given(name_of(function), values)}
