"""Build a `Statement` from what a user passes to `lagrange.System`, refusing what cannot be meant."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, listing, shown, suggestion
from lagrange.statement.choice import one_of, text
from lagrange.statement.constraint import Constraint, declare_constraints
from lagrange.statement.coordinate import check_name, check_symbol, name_of, t, velocity_of
from lagrange.statement.expression import entries, expression
from lagrange.statement.number import real_number
from lagrange.statement.statement import REDUNDANT, REFUSE, RunSettings, Statement
from lagrange.statement.survey import Survey

ORIGIN = "origin"
"""The point at zero, which links may name and no position may redefine."""


def declare(
    *,
    kinetic: Any = None,
    potential: Any = None,
    lagrangian: Any = None,
    coordinates: Sequence[Any] | None = None,
    forces: Mapping[Any, Any] | None = None,
    dissipation: Any = 0,
    constraints: Sequence[Any] | Mapping[str, Any] = (),
    redundant: str = REFUSE,
    parameters: Mapping[Any, Any] | None = None,
    initial: Mapping[Any, Any] | None = None,
    positions: Mapping[str, Any] | None = None,
    links: Iterable[Sequence[str]] = (),
    name: str = "system",
    about: str = "",
    source: str = "",
    run: RunSettings | None = None,
) -> Statement:
    """Check every part of a statement and return it frozen. Raises StatementError in the user's symbols."""
    main = "the kinetic energy" if lagrangian is None else "the Lagrangian"
    kinetic, potential, lagrangian = _energies(kinetic, potential, lagrangian)
    survey = Survey()
    survey.add(kinetic, main)
    survey.add(potential, "the potential energy")
    moving = dict.fromkeys(survey.velocities)
    held = declare_constraints(constraints, survey)
    chosen = _coordinates(coordinates, survey)
    by_name = {name_of(q): q for q in chosen}
    _check_velocities(chosen, moving, held, lagrangian, main)
    _check_constraints(held, chosen, redundant)

    force_table = _forces(forces, by_name, survey)
    dissipation = expression(dissipation, "the dissipation")
    survey.add(dissipation, "the dissipation")
    points = _positions(positions, survey)
    _check_declared(survey, chosen)

    values = _table(parameters, "parameters", "parameter to value")
    symbols, unify = _parameter_symbols(survey, values, by_name)
    clean = partial(_unified, unify)
    return Statement(
        coordinates=chosen,
        kinetic=clean(kinetic),
        potential=clean(potential),
        lagrangian=clean(lagrangian),
        forces=tuple(clean(force_table.get(q, sympy.S.Zero)) for q in chosen),
        dissipation=clean(dissipation),
        redundant=redundant,
        constraints=tuple(replace(one, expression=clean(one.expression)) for one in held),
        parameters=tuple(symbols.values()),
        defaults=MappingProxyType(_defaults(values, symbols)),
        initial=initial_state({} if initial is None else initial, chosen, (0.0,) * (2 * len(chosen))),
        positions=MappingProxyType({label: tuple(map(clean, point)) for label, point in points.items()}),
        links=_links(links, points),
        name=text(name, "name"),
        about=about,
        source=source,
        run=run or RunSettings(),
    )


def _unified(replacements: Mapping[Any, Any], expression: Any) -> Any:
    """Return the expression with one symbol for each parameter's name."""
    return expression.xreplace(replacements) if replacements else expression


def initial_state(given: Mapping[Any, Any], coordinates: tuple[Any, ...], base: tuple[float, ...]) -> tuple[float, ...]:
    """Return (q, v) as 2n floats: `base` overlaid with entries keyed by coordinate, velocity or name.

    A name is a coordinate's, or with ``_dot`` behind it its velocity's.
    """
    if not isinstance(given, Mapping):
        raise StatementError(
            f"initial is a {type(given).__name__}: give a dict such as {{{name_of(coordinates[0])}: 1.0}}; what is not "
            "named keeps its default."
        )
    rows = state_rows(coordinates)
    values = list(base)
    for key, value in given.items():
        if key not in rows:
            known = [label for label in rows if isinstance(label, str)]
            raise StatementError(
                f"initial names {_label(key)!r}, which is no coordinate or velocity of this system; they are "
                f"{listing(known)}." + suggestion(_label(key), known)
            )
        values[rows[key]] = real_number(value, f"the initial value of {_label(key)}")
    return tuple(values)


@lru_cache(maxsize=256)
def state_rows(coordinates: tuple[Any, ...]) -> Mapping[Any, int]:
    """Return the row of the state for each coordinate, velocity and name; made once, since SymPy takes 20 us each."""
    n = len(coordinates)
    rows: dict[Any, int] = {}
    for i, q in enumerate(coordinates):
        rows[q] = rows[name_of(q)] = i
        rows[velocity_of(q)] = rows[f"{name_of(q)}_dot"] = n + i
    return rows


def parameter_values(
    given: Mapping[Any, Any] | None, parameters: tuple[Any, ...], defaults: Mapping[Any, float]
) -> dict[Any, float]:
    """Return a value for every parameter: the defaults overlaid with `given`, keyed by symbol or name.

    Raises StatementError for a name that is no parameter, a value that is not a finite real number, and a
    parameter left without a value.
    """
    by_name = {symbol.name: symbol for symbol in parameters}
    values = dict(defaults)
    for key, value in _table(given, "parameters", "parameter to value").items():
        label = _label(key)
        if label not in by_name:
            raise StatementError(
                f"{label!r} is no parameter of this system; its parameters are {listing(by_name)}."
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


def _label(key: Any) -> str:
    if isinstance(key, str):
        return key[:80]
    if not isinstance(key, sympy.Basic):
        return shown(key)
    if isinstance(key, sympy.Derivative) and key == velocity_of(key.expr):
        return f"{name_of(key.expr)}_dot"
    if isinstance(key, sympy.Symbol):
        return str(key.name)
    return name_of(key) if key.args == (t,) else str(key)[:80]


def _table(given: Any, what: str, entries: str) -> Mapping[Any, Any]:
    """Return a mapping, empty for None; `entries` says what it maps to what."""
    if given is not None and not isinstance(given, Mapping):
        raise StatementError(f"{what} is a {type(given).__name__}: give a dict from {entries}.")
    return given or {}


def _energies(kinetic: Any, potential: Any, lagrangian: Any) -> tuple[Any, Any, Any]:
    """Return (T, V, L); a system given by L alone has T = L and V = 0."""
    if lagrangian is not None:
        if kinetic is not None or potential is not None:
            raise StatementError("give either lagrangian=, or kinetic= and potential=, not both.")
        whole = expression(lagrangian, "the Lagrangian")
        return whole, sympy.S.Zero, whole
    if kinetic is None:
        raise StatementError("no kinetic energy: give kinetic= and potential=, or lagrangian=.")
    kinetic = expression(kinetic, "the kinetic energy")
    potential = expression(0 if potential is None else potential, "the potential energy")
    return kinetic, potential, kinetic - potential


def _coordinates(given: Sequence[Any] | None, survey: Survey) -> tuple[Any, ...]:
    if given is not None and (not isinstance(given, Iterable) or (isinstance(given, np.ndarray) and not given.ndim)):
        raise StatementError(f"coordinates is {shown(given)}: give a list, such as [{shown(given)}].")
    found: dict[str, Any] = {}
    for q in survey.coordinates if given is None else given:
        if not isinstance(q, AppliedUndef) or q.args != (t,):
            raise StatementError(
                f"coordinates contains {shown(q)}, which is no coordinate: make one with lg.coordinate('x')."
            )
        name = check_symbol(name_of(q), "coordinate")
        if name in found:
            raise StatementError(f"coordinate {name} is listed twice: name each coordinate once.")
        found[name] = q
    if not found:
        raise StatementError(
            "no coordinates: the energies contain no function of time. Make one with lg.coordinate('x')."
        )
    for name in found:
        _check_rate(name, found, "coordinate")
    return tuple(found.values())


def _check_velocities(
    coordinates: tuple[Any, ...],
    velocities: Container[Any],
    constraints: Sequence[Constraint],
    lagrangian: Any,
    main: str,
) -> None:
    """Refuse a coordinate whose velocity stands nowhere in the energy, unless other equations may determine it.

    A constraint may, and in p*q.dot - H the coordinate q determines p: the slope along p has a velocity in it.
    """
    rates = [velocity_of(q) for q in coordinates]
    for q, rate in zip(coordinates, rates, strict=True):
        if rate in velocities or any(one.expression.has(q) for one in constraints):
            continue
        if not lagrangian.has(q) or not lagrangian.diff(q).has(*rates):
            raise StatementError(
                f"{main} does not contain {name_of(q)}.dot, so {name_of(q)} has no inertia and its acceleration is "
                f"undefined: add its kinetic energy, or make {name_of(q)} a parameter."
            )


def _check_constraints(constraints: Sequence[Constraint], coordinates: tuple[Any, ...], redundant: str) -> None:
    """Refuse more constraints than coordinates, unless redundant ones are allowed."""
    one_of(redundant, REDUNDANT, "redundant is {given}: give one of {known}.")
    if redundant == REFUSE and len(constraints) > len(coordinates):
        names = listing(name_of(q) for q in coordinates)
        many = "coordinates" if len(coordinates) > 1 else "coordinate"
        raise StatementError(
            f"there are {len(constraints)} constraints ({listing(one.name for one in constraints)}) for "
            f"{len(coordinates)} {many} ({names}): give at most as many constraints as coordinates."
        )


def _check_declared(survey: Survey, coordinates: tuple[Any, ...]) -> None:
    names = [name_of(q) for q in coordinates]
    declared = frozenset(coordinates)
    for q in survey.coordinates:
        if q not in declared:
            raise StatementError(
                f"{q} is used but not declared: add it to coordinates, which are {listing(names)}."
                + suggestion(name_of(q), names)
            )


def _forces(given: Mapping[Any, Any] | None, by_name: dict[str, Any], survey: Survey) -> dict[Any, Any]:
    table: dict[Any, Any] = {}
    for key, value in _table(given, "forces", "coordinate to generalized force").items():
        label = _label(key)
        if label not in by_name:
            raise StatementError(
                f"forces names {label!r}, which is no coordinate of this system; they are {listing(by_name)}."
                + suggestion(label, by_name)
            )
        if by_name[label] in table:
            raise StatementError(f"forces names {label!r} twice: give the sum of the forces on it.")
        table[by_name[label]] = expression(value, f"the force on {label}")
        survey.add(table[by_name[label]], f"the force on {label}")
    return table


def _positions(given: Mapping[str, Any] | None, survey: Survey) -> dict[str, tuple[Any, ...]]:
    points: dict[str, tuple[Any, ...]] = {}
    for label, point in _table(given, "positions", "name to point").items():
        what = f"the position of {check_name(label, 'point')}"
        if label == ORIGIN:
            raise StatementError("'origin' is the point at zero already: choose another name.")
        if not _has_length(point, 2, 3):
            raise StatementError(f"{what} is {shown(point)}: give two or three expressions, (x, y) or (x, y, z).")
        points[label] = tuple(expression(entry, what) for entry in point)
        for entry in points[label]:
            survey.add(entry, what)
    if len({len(point) for point in points.values()}) > 1:
        raise StatementError(
            "positions mixes points in the plane with points in space: give every point two entries, or every point "
            "three."
        )
    return points


def _links(links: Iterable[Sequence[str]], points: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    known = [ORIGIN, *points]
    given = entries(links, "links")
    if given is None:
        raise StatementError(f"links is {shown(links)}: give a list of pairs of point names.")
    pairs = []
    for link in given:
        if not _has_length(link, 2):
            raise StatementError(f"links contains {shown(link)}: give pairs of point names, such as ('origin', 'bob').")
        for end in link:
            one_of(end, known, "links names {given}, which is no position; they are {known}.")
        pairs.append((str(link[0]), str(link[1])))
    return tuple(pairs)


def _has_length(value: Any, *lengths: int) -> bool:
    """Return whether the value is a sequence, or a vector, of one of these lengths."""
    if isinstance(value, np.ndarray):
        return value.ndim == 1 and len(value) in lengths
    return isinstance(value, (list, tuple, sympy.MatrixBase)) and len(value) in lengths


def _parameter_symbols(
    survey: Survey, given: Mapping[Any, Any], by_name: dict[str, Any]
) -> tuple[dict[str, Any], dict[Any, Any]]:
    """Return the parameters by name, and replacements that make one symbol of several of the same name."""
    symbols: dict[str, Any] = {}
    unify: dict[Any, Any] = {}
    for symbol in [*survey.parameters, *(key for key in given if isinstance(key, sympy.Symbol))]:
        first = symbols.setdefault(check_name(symbol.name, "parameter"), symbol)
        if symbol != first and first.is_nonnegative and not symbol.is_nonnegative:
            symbols[symbol.name] = symbol  # what is not said to be positive may not become so
    for symbol in survey.parameters:
        if symbol != symbols[symbol.name]:
            unify[symbol] = symbols[symbol.name]
    for key in given:
        if isinstance(key, str):
            symbols.setdefault(check_name(key, "parameter"), sympy.Symbol(key, real=True))
        elif not isinstance(key, sympy.Symbol):
            raise StatementError(f"parameters names {shown(key)}: its keys are parameters (symbols) or their names.")
    for name in symbols:
        _check_clash(name, by_name)
    return symbols, unify


_MEANT = {t.name: "time: use lg.t for time", "pi": "the constant: use sympy.pi for the constant"}
"""What a plain symbol with one of these names probably stands for, and what to write instead."""


def _check_clash(name: str, by_name: dict[str, Any]) -> None:
    if name in _MEANT:
        raise StatementError(f"parameter {name!r} clashes with {_MEANT[name]}, and another name for the parameter.")
    check_symbol(name, "parameter")
    if name in by_name:
        raise StatementError(
            f"{name} is both a coordinate and a parameter: rename one. If the plain symbol {name} was meant as the "
            f"coordinate, use lg.coordinate('{name}') there."
        )
    _check_rate(name, by_name, "parameter")


def _check_rate(name: str, by_name: Container[str], what: str) -> None:
    """Refuse a name that stands for the velocity or the acceleration of a coordinate."""
    base, _, rate = name.rpartition("_")
    if base in by_name and rate in ("dot", "ddot"):
        kind = "velocity" if rate == "dot" else "acceleration"
        raise StatementError(
            f"{what} {name} has the name of {'a' if rate == 'dot' else 'an'} {kind}: write {base}.{rate} for the "
            f"{kind}, or "
            f"rename the {what}."
        )


def _defaults(given: Mapping[Any, Any], symbols: dict[str, Any]) -> dict[Any, float]:
    values: dict[Any, float] = {}
    for key, value in given.items():
        symbol = symbols[_label(key)]
        if symbol in values:
            raise StatementError(f"parameters gives {symbol.name} twice: give it once.")
        if value is not None:
            values[symbol] = _within(symbol, real_number(value, f"parameter {symbol.name}"))
    return values


def _within(symbol: Any, value: float) -> float:
    """Return the value, or refuse one below zero for a symbol that SymPy was told is positive."""
    if value < 0 and symbol.is_nonnegative:
        raise StatementError(
            f"parameter {symbol.name} is {value:g}, but its symbol was declared positive, and SymPy may have dropped "
            f"an abs or a root because of it: declare it with lg.parameters('{symbol.name}', positive=False)."
        )
    return value
