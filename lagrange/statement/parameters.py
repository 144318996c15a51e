"""Find the symbols of expressions, refuse unsupported functions, read values of parameters, and refuse missing ones."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import sympy
from sympy.core.function import AppliedUndef
from sympy.core.relational import Relational
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import ITE, And, BooleanAtom, Not, Or

from lagrange.errors import StatementError, formula, listing, shown, singular
from lagrange.statement.coordinate import PARAMETERS, check_name, check_symbol, constraint_of, name_of, t, velocity_of
from lagrange.statement.expression import check_once, one_of, real_number
from lagrange.statement.given.motion import Motion, motion_of
from lagrange.statement.vocabulary.functions import SYMPY_CLASSES, WORDS

_PLAIN = (sympy.Add, sympy.Mul, sympy.Pow, ExprCondPair, Relational, And, Or, Not, ITE, BooleanAtom)


@dataclass
class Survey:
    """Symbols and functions in some expressions.

    Each field has them in order of first appearance, with dicts as ordered sets. `coordinates` and `velocities` are
    functions of time and their derivatives. `parameters` are plain symbols. `multipliers` are names of constraints.
    `given` maps given functions of time to the order of their highest derivative. `unknown` are undefined functions of
    coordinates, such as U(r). `seen` has the subexpressions that were already searched.
    """

    coordinates: dict[Any, None] = field(default_factory=dict)
    velocities: dict[Any, None] = field(default_factory=dict)
    parameters: dict[Any, None] = field(default_factory=dict)
    multipliers: dict[str, None] = field(default_factory=dict)
    given: dict[Any, int] = field(default_factory=dict)
    unknown: dict[Any, None] = field(default_factory=dict)
    seen: set[Any] = field(default_factory=set)

    def add(self, expression: Any, what: str, *, accelerations: bool = False, multipliers: bool = False) -> Survey:
        """Collect the symbols of an expression, and return this survey.

        Raises StatementError for functions that have no derivative or value.

        `what` is the name of the expression in messages. `accelerations` and `multipliers` are true if the expression
        may contain these; else they are refused.
        """
        for node in _distinct(expression, self.seen):
            if isinstance(node, sympy.Symbol):
                if node != t:
                    self._add_symbol(node, what, multipliers)
            elif isinstance(node, AppliedUndef):
                self._add_function(node, what)
            elif isinstance(node, sympy.Derivative):
                self._add_derivative(node, what, accelerations)
            elif isinstance(node, sympy.Subs):
                self._add_unknown(node.expr, what)
            else:
                _check_supported(node, what)
        return self

    def require(self, known: Container[Any], what: str, rest: str) -> None:
        """Raise StatementError for a collected symbol or function that is not in `known`.

        The message begins with `what`, the name of the expression, and ends with the text `rest`.
        """
        for leaf in (*self.coordinates, *self.given, *self.unknown, *self.parameters):
            if leaf not in known:
                raise StatementError(f"{what} contains {leaf}, which this system does not have{rest}")

    def _add_symbol(self, node: Any, what: str, multipliers: bool) -> None:
        constraint = constraint_of(node)
        if constraint is None:
            self.parameters[node] = None
        elif multipliers:
            self.multipliers[constraint] = None
        else:
            raise StatementError(
                f"{what} contains {node}, the multiplier of a constraint, which is found from the motion. It may be "
                "used in forces, events and solution.evaluate(...)."
            )

    def _add_function(self, node: Any, what: str) -> None:
        if node.args != (t,):
            self._add_unknown(node, what)
        elif (motion := motion_of(node)) is None:
            check_symbol(name_of(node), "coordinate")
            self.coordinates[node] = None
        else:
            self._add_given(node, motion, 0)

    def _add_given(self, node: Any, motion: Motion, order: int) -> None:
        self.given[node] = max(order, self.given.get(node, 0))
        if isinstance(motion.values, sympy.Expr):
            self.add(motion.values, f"the given function {name_of(node)}")

    def _add_unknown(self, node: Any, what: str) -> None:
        """Add an undefined function of coordinates, such as U(r), to the collected functions.

        `node` is the function or its derivative, and `what` is the name of the expression in messages. Raises
        StatementError for a derivative of anything else, which SymPy has not evaluated.
        """
        function = node.expr if isinstance(node, sympy.Derivative) else node
        if not isinstance(function, AppliedUndef) or motion_of(function) is not None:
            raise StatementError(
                f"{what} contains {node}, a derivative that is not evaluated. Call .doit() on it, or write it out."
            )
        check_symbol(name_of(function), "function")
        self.unknown[function] = None

    def _add_derivative(self, node: Any, what: str, accelerations: bool) -> None:
        inner = node.expr
        if isinstance(inner, AppliedUndef) and inner.args != (t,):
            self._add_unknown(node, what)
            return
        if not isinstance(inner, AppliedUndef) or set(node.variables) != {t}:
            raise StatementError(
                f"{what} contains {node}, a derivative that is not evaluated. Call .doit() on it, or write it out."
            )
        order = len(node.variables)
        motion = motion_of(inner)
        if motion is not None:
            self._add_given(inner, motion, order)
            return
        if order > 2 or (order == 2 and not accelerations):
            leaves = "coordinates, velocities and accelerations" if accelerations else "coordinates and velocities"
            raise StatementError(
                f"{what} contains the derivative of order {order} of {name_of(inner)}. Only {leaves} are allowed: "
                f"write it in terms of {name_of(inner)} and {name_of(inner)}.dot."
            )
        self._add_function(inner, what)
        self.velocities[velocity_of(inner)] = None


def _distinct(expression: Any, seen: set[Any]) -> Iterator[Any]:
    """Yield each distinct subexpression that is not in `seen`, parents first, and add it to `seen`.

    The arguments of functions of time and of their derivatives are not yielded.
    """
    stack = [expression]
    while stack:
        node = stack.pop()
        if node in seen:
            continue
        seen.add(node)
        yield node
        stack.extend(reversed(_parts(node)))


def _parts(node: Any) -> tuple[Any, ...]:
    """Return the arguments of a node that may contain symbols. A function of time or its derivative has none."""
    if isinstance(node, sympy.Subs):
        return tuple(node.point)
    function = node.expr if isinstance(node, sympy.Derivative) else node
    if isinstance(function, AppliedUndef):
        return () if function.args == (t,) else tuple(function.args)
    return () if isinstance(node, sympy.Derivative) else tuple(node.args)


def _check_supported(node: Any, what: str) -> None:
    if isinstance(node, sympy.Pow) and _is_zero(node.base) and node.exp.is_negative:
        raise StatementError(f"{what} contains {formula(node, 80)}: check for a division by zero.")
    if isinstance(node, sympy.Pow) and not node.exp.is_number and _is_zero(node.base):
        raise StatementError(
            f"{what} contains {formula(node, 80)}: a power of zero jumps where its exponent changes sign and has no "
            "derivative. Write a Piecewise, or another base."
        )
    if isinstance(node, _PLAIN):
        return
    if node is sympy.I:
        raise StatementError(
            f"{what} contains the imaginary unit I. Energies and forces are real: write real expressions."
        )
    if isinstance(node, (sympy.Number, sympy.NumberSymbol)) or node in (sympy.zoo, sympy.nan):
        if not node.is_finite:
            raise StatementError(f"{what} contains {node}, which is not a finite number: check for a division by zero.")
        return
    if type(node) in SYMPY_CLASSES:
        return
    raise StatementError(
        f"{what} contains {type(node).__name__} in {formula(node, 80)!r}, which is not supported. The functions are "
        f"{listing([*WORDS, 'Piecewise'])}, and powers."
    )


def _is_zero(base: Any) -> bool:
    """Return True if the base of a power is zero. Sums with symbols are not tested, since SymPy takes 10 ms for one."""
    return bool((base.is_Symbol or not base.free_symbols) and base.is_zero)


def parameter_values(
    overrides: Mapping[Any, Any] | None,
    parameters: tuple[Any, ...],
    defaults: Mapping[Any, float],
    frictions: Collection[str] = (),
) -> dict[Any, float]:
    """Return {parameter: value} for all `parameters`: the `defaults`, replaced by `overrides`.

    Keys of `overrides` are symbols or names. `frictions` are the names of coefficients of friction. Raises
    StatementError for an unknown name, a value that is not a finite real number, a negative coefficient of friction,
    and a parameter without a value.
    """
    by_name = {symbol.name: symbol for symbol in parameters}
    table = table_of(overrides, "parameters", "parameter to value")
    for key in table:
        parameter_name(key, by_name)
    values = {**defaults, **default_values(table, by_name, frictions)}
    missing = [symbol.name for symbol in parameters if symbol not in values]
    if missing:
        raise StatementError(
            f"no value for {'parameter' if len(missing) == 1 else 'parameters'} {listing(missing)}: give one, for "
            f"example parameters={{'{missing[0]}': 1.0}}."
        )
    return values


def label_of(key: Any) -> str:
    """Return the name of a key in a user's table, for messages and to find the quantity: `theta_dot` for a velocity."""
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
    """Return the name of the time derivative of order `order` of the coordinate `name`: x, x_dot, x_ddot, x_dddot."""
    return f"{name}_{'d' * order}ot" if order else name


def coordinate_name(key: Any, names: Sequence[str]) -> str:
    """Return the name of the coordinate `key`, a symbol or name. Raises StatementError if it is not one of `names`."""
    return one_of(label_of(key), names, "{given} is not a coordinate of this system; they are {known}.")


def parameter_name(key: Any, names: Collection[str]) -> str:
    """Return the name of the parameter `key`, a symbol or a name. Raises StatementError if it is not one of `names`."""
    return one_of(label_of(key), names, "{given} is not a parameter of this system; its parameters are {known}.")


def table_of(table: Any, what: str, entries: str) -> Mapping[Any, Any]:
    """Return the dict `table`, or an empty dict for None. Raises StatementError for other types.

    In the message `what` is the name of the table, and `entries` describes its keys and values.
    """
    if table is not None and not isinstance(table, Mapping):
        raise StatementError(f"{what} is {singular(type(table).__name__)}: give a dict from {entries}.")
    return table or {}


def parameter_symbols(
    survey: Survey, table: Mapping[Any, Any], functions: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[Any, Any]]:
    """Return {name: parameter}, and replacements {other symbol: parameter} for symbols of the same name.

    `survey` has the symbols of the expressions, and `table` maps parameters to values. Parameters in the table come
    first, in its order, then the others in the order of declaration. `functions` maps the names of coordinates and
    given functions, which parameters must not have, to these functions.
    """
    symbols: dict[str, Any] = {}
    for symbol in [*survey.parameters, *(key for key in table if isinstance(key, sympy.Symbol))]:
        first = symbols.setdefault(check_name(symbol.name, "parameter"), symbol)
        if symbol != first and first.is_nonnegative and not symbol.is_nonnegative:
            symbols[symbol.name] = symbol  # of two symbols keep the one without an assumed sign
    unify = {symbol: symbols[symbol.name] for symbol in survey.parameters if symbol != symbols[symbol.name]}
    for key in table:
        if isinstance(key, str):
            symbols.setdefault(check_name(key, "parameter"), sympy.Symbol(key, real=True))
        elif not isinstance(key, sympy.Symbol):
            raise StatementError(f"parameters names {shown(key)}: its keys are parameters (symbols) or their names.")
    for name in symbols:
        _check_clash(name, functions)
    valued = dict.fromkeys(label_of(key) for key in table)
    rest = PARAMETERS.of((name, name) for name in symbols if name not in valued)
    return {name: symbols[name] for name in (*valued, *rest)}, unify


def in_own_parameters(value: Any, parameters: Sequence[Any]) -> Any:
    """Return the expression `value` with a system's `parameters` in place of other symbols of the same names.

    Parameters of a scene have no assumed sign, and those of `lg.parameters` are positive. For SymPy they differ.
    """
    by_name = {p.name: p for p in parameters}
    others = {s: by_name[s.name] for s in value.free_symbols if s.name in by_name and s not in parameters}
    return value.xreplace(others) if others else value


_MEANT = {t.name: "time: use lg.t for time", "pi": "the constant: use sympy.pi for the constant"}
"""Names that probably mean time or pi, with the end of the message that says what to write instead."""


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
    """Raise StatementError for a name such as `x_dot` or `x_ddot` if `by_name` contains a coordinate x.

    `what` is the kind of the named object in the message, such as "parameter".
    """
    base, _, rate = name.rpartition("_")
    if base in by_name and rate in ("dot", "ddot"):
        kind = "velocity" if rate == "dot" else "acceleration"
        raise StatementError(
            f"{what} {name} has the name of {'a' if rate == 'dot' else 'an'} {kind}: write {base}.{rate} for the "
            f"{kind}, or rename the {what}."
        )


def default_values(
    table: Mapping[Any, Any], symbols: dict[str, Any], frictions: Collection[str] = ()
) -> dict[Any, float]:
    """Return {parameter: value} for a `table` of values by symbol or name. `symbols` are the parameters by name.

    `frictions` are the names of coefficients of friction. Raises StatementError for a value that is not a finite real
    number, for a negative coefficient of friction or positive parameter, and for one parameter with two values.
    """
    values: dict[Any, float] = {}
    check_once([label_of(key) for key in table], "parameters")
    for key, value in table.items():
        symbol = symbols[label_of(key)]
        values[symbol] = _within(symbol, real_number(value, f"parameter {symbol.name}"), frictions)
    return values


def _within(symbol: Any, value: float, frictions: Collection[str]) -> float:
    """Return `value`. Raises StatementError for a negative value of a positive symbol or a coefficient of friction."""
    if value < 0 and symbol.name in frictions:
        raise StatementError(f"the coefficient of friction {symbol.name} is {value:g}: give one that is not negative.")
    if value < 0 and symbol.is_nonnegative:
        raise StatementError(
            f"parameter {symbol.name} is {value:g}, but its symbol was declared positive, and SymPy may have dropped "
            f"an abs or a root because of it: declare it with lg.parameters('{symbol.name}', positive=False)."
        )
    return value
