"""Check the arguments of `lagrange.System` and build a `Statement` from them: energies, forces, constraints, points."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef
from sympy.core.relational import Relational
from sympy.logic.boolalg import BooleanAtom

from lagrange.errors import StatementError, formula, listing, located, shown, suggestion
from lagrange.statement.contact import along, declare_contacts
from lagrange.statement.coordinate import (
    COORDINATES,
    check_name,
    check_symbol,
    declared,
    is_ours,
    name_of,
    rotation_name,
    t,
    velocity_of,
)
from lagrange.statement.energy import Shape, first_order_remedy, without_velocity
from lagrange.statement.expression import (
    TEXTS,
    as_typed,
    check_once,
    entries,
    expression,
    in_full,
    is_shorthand,
    one_of,
    real_number,
    refusing_deep,
    text,
)
from lagrange.statement.given.function import check_given, coordinate_or_given
from lagrange.statement.given.motion import motion_of
from lagrange.statement.parameters import (
    Survey,
    check_rate,
    default_values,
    label_of,
    parameter_symbols,
    rate_name,
    table_of,
)
from lagrange.statement.rotation import (
    check_moments,
    check_start,
    explanation,
    forces_on_coordinates,
    in_coordinates,
    in_symbols,
    is_scalar,
    reading,
    start_in_turns,
    with_length,
    without_inertia,
)
from lagrange.statement.run_settings import RunSettings
from lagrange.statement.statement import EDGE, KINDS, REDUNDANT, REFUSE, Constraint, Link, Statement, friction_names
from lagrange.statement.units.dimension_check import with_dimensions
from lagrange.statement.vocabulary.letters import NAME

ORIGIN = "origin"  # Name of the point (0, 0, 0), at which links may begin or end; a position must not have this name

ENERGIES = {"lagrangian": "the Lagrangian", "kinetic": "the kinetic energy", "potential": "the potential energy"}
"""Arguments of `lagrange.System` that are energies, with the noun for each in messages."""


@refusing_deep
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
    dimensions: Mapping[Any, Any] | None = None,
    contacts: Mapping[str, Any] | None = None,
    simultaneous: str | None = None,
    surfaces: Mapping[str, Any] | None = None,
    suffix: str = ".dot",
) -> Statement:
    """Return the checked `Statement` of a system from the arguments of `lagrange.System`. Raises StatementError.

    `suffix` ends the name of a velocity in the message that refuses a coordinate without inertia. If `suffix` is empty,
    the equations of motion refuse such a coordinate later.
    """
    survey, alone = Survey(), lagrangian is not None
    typed, energies = _energies(kinetic, potential, lagrangian, survey)
    checked = _declare_constraints(zeros := _typed_zeros(constraints), survey)
    chosen = _coordinates(coordinates, survey, _first_order(forces, dissipation))
    by_name = dict(zip(map(name_of, chosen), chosen, strict=True))
    force_table, drag = _forces(forces, by_name, survey), _dissipation(dissipation, by_name, survey)
    fields = _drawn(positions, links, surfaces, survey) | declare_contacts(contacts, simultaneous, survey, checked)
    _check_constraints(checked, chosen, redundant)
    check_given(survey, by_name)
    known, unify = _parameters(parameters, survey, by_name, friction_names(fields["contacts"]))
    statement = Statement(
        coordinates=chosen,
        **dict(zip(("kinetic", "potential", "lagrangian"), energies, strict=True)),
        forces=tuple(force_table.get(q, sympy.S.Zero) for q in chosen),
        dissipation=drag,
        redundant=redundant,
        constraints=checked,
        initial=initial_state({} if initial is None else initial, chosen, _at_rest(chosen)),
        name=text(name, "name"),
        about=about,
        source=source,
        run=run or RunSettings(),
        **fields,
        **known,
        **_functions(survey, chosen if coordinates is None else ()),
    )
    if suffix:
        _check_velocities(statement, suffix, alone=alone)
    statement = _with_rotations(statement, typed, forces, dissipation, zeros)
    statement = statement.mapped(lambda stated: stated.xreplace(unify)) if unify else statement
    return statement if dimensions is None else with_dimensions(statement, dimensions)


def _with_rotations(
    statement: Statement, typed: Mapping[str, Any], forces: Any, dissipation: Any, zeros: Mapping[str, Any]
) -> Statement:
    """Return the statement with two additions for its rotations; a statement without rotations is unchanged.

    First, the kinetic energy gets an inertia for the length of each quaternion, without which the mass matrix would be
    singular. Second, the field `reading` gets the same statement in small rotations about the body axes, from which
    readable equations are derived. `typed` are the energies by name, and `zeros` the constraint expressions by name.
    Energies, constraints, `forces` and `dissipation` are as the user typed them.
    """
    kinetic, names = with_length(statement.kinetic, statement.coordinates)
    if not names:
        return statement
    for name in names:
        check_moments(kinetic, name, statement.defaults)
    lagrangian = statement.lagrangian + kinetic - statement.kinetic
    whole = replace(statement, kinetic=kinetic, lagrangian=lagrangian, rotations=names)
    parts = reading(typed, forces, dissipation, zeros.values(), statement.coordinates, names)
    if parts is None:
        return whole
    pairs = zip(statement.constraints, parts["constraints"], strict=True)
    parts["constraints"] = tuple(replace(constraint, expression=zero) for constraint, zero in pairs)
    values = dict(zip((*statement.coordinates, *statement.velocities), statement.initial, strict=True))
    about = " ".join([*([statement.about] if statement.about else []), *(explanation(name, values) for name in names)])
    start = start_in_turns(names, parts["coordinates"], values)
    read = replace(whole, **parts, about=about, initial=start, positions=MappingProxyType({}), links=())
    return replace(whole, reading=read)


def _at_rest(coordinates: tuple[Any, ...]) -> tuple[float, ...]:
    """Return the default initial state (q, v), 2n floats: zeros, but 1 for the scalar entry of each quaternion."""
    return (*(float(is_scalar(q)) for q in coordinates), *(0.0 for _ in coordinates))


def _functions(survey: Survey, inferred: Iterable[Any]) -> dict[str, Any]:
    """Return {field: value} for the fields `given`, `orders`, `unknown` and `inferred` of a `Statement`.

    `survey` has the functions of the statement. The argument `inferred` has the coordinates that the user did not list.
    The field `inferred` names those of them that the user did not declare either.
    """
    return {
        "given": tuple(survey.given),
        "orders": tuple(survey.given.values()),
        "unknown": tuple(survey.unknown),
        "inferred": tuple(name_of(q) for q in inferred if not declared(q)),
    }


@located("parameters")
def _parameters(
    stated_values: Any, survey: Survey, taken_names: Mapping[str, Any], frictions: Collection[str]
) -> tuple[dict[str, Any], Mapping[Any, Any]]:
    """Return {field: value} for `parameters` and `defaults` of `Statement`, and replacements {other symbol: parameter}.

    The replacements unite symbols of the same name but different assumptions. `stated_values` is the user's table of
    values. `taken_names` maps names that a parameter must not have to their symbols. `frictions` are names of
    coefficients of friction.
    """
    values = table_of(stated_values, "parameters", "parameter to value")
    symbols, unify = parameter_symbols(survey, values, {**taken_names, **{name_of(f): f for f in survey.given}})
    given_values = {key: value for key, value in values.items() if value is not None}
    defaults = MappingProxyType(default_values(given_values, symbols, frictions))
    return {"parameters": tuple(symbols.values()), "defaults": defaults}, unify


def initial_state(
    initial: Mapping[Any, Any], coordinates: tuple[Any, ...], base: tuple[float, ...]
) -> tuple[float, ...]:
    """Return the state (q, v), 2n floats: the state `base`, changed by the values in `initial`.

    Keys of `initial` are coordinates, velocities or their names, such as "theta_dot". Raises StatementError for others.
    """
    if not isinstance(initial, Mapping):
        what = "an array" if isinstance(initial, np.ndarray) else f"a {type(initial).__name__}"
        raise StatementError(
            f"initial is {what}: give a dict such as {{{name_of(coordinates[0])}: 1.0}}; what is not named keeps its "
            "default."
        )
    if not initial:
        return base
    rows, values = state_rows(coordinates), list(base)
    named = [rows[key] for key in initial if key in rows]
    if len(set(named)) < len(named):
        check_once([label_of(key) for key in initial], "initial")
    if any(key not in rows for key in initial):
        initial = in_coordinates(initial, dict(zip((*coordinates, *map(velocity_of, coordinates)), base, strict=True)))
    for key, value in initial.items():
        if key not in rows:
            labels = (label for label in rows if isinstance(label, str))
            known = in_symbols(labels, dict.fromkeys(filter(None, map(rotation_name, coordinates))))
            raise StatementError(
                f"initial names {label_of(key)!r}, which is not a coordinate or velocity of this system; they are "
                f"{listing(known)}." + suggestion(label_of(key), known)
            )
        row = rows[key]
        label = rate_name(name_of(coordinates[row % len(coordinates)]), row // len(coordinates))
        values[row] = real_number(value, f"the initial value of {label}")
    check_start(coordinates, values)
    return tuple(values)


@lru_cache(maxsize=256)
def state_rows(coordinates: tuple[Any, ...]) -> Mapping[Any, int]:
    """Return {coordinate, velocity or name: index in the state (q, v)}. Cached, since SymPy takes 20 us for a key."""
    n = len(coordinates)
    rows: dict[Any, int] = {}
    for i, q in enumerate(coordinates):
        rows[q] = rows[name_of(q)] = i
        rows[velocity_of(q)] = rows[f"{name_of(q)}_dot"] = n + i
    return rows


def _energies(
    kinetic: Any, potential: Any, lagrangian: Any, survey: Survey
) -> tuple[dict[str, Any], tuple[Any, Any, Any]]:
    """Return {argument: energy as typed} of the stated energies, and the expressions (T, V, L) of a Statement.

    The energies T, V and L are the user's arguments `kinetic`, `potential` and `lagrangian`, None if not given. In the
    results shorthands such as R[0, 0] are replaced. The symbols of the energies are added to `survey`. A system stated
    by L alone has T = L and V = 0.
    """
    if lagrangian is not None and (kinetic is not None or potential is not None):
        with located("lagrangian"):
            raise StatementError("give either lagrangian=, or kinetic= and potential=, not both.")
    if lagrangian is None and kinetic is None:
        raise StatementError(
            "no kinetic energy: give kinetic= and potential=, or lagrangian=. States of first order have kinetic=0."
        )
    stated = {"lagrangian": lagrangian}
    if lagrangian is None:
        stated = {"kinetic": kinetic, "potential": 0 if potential is None else potential}
    typed = {name: as_typed(energy, ENERGIES[name]) for name, energy in stated.items()}
    full = {name: in_full(energy) for name, energy in typed.items()}
    for name, energy in full.items():
        with located(name):
            survey.add(energy, ENERGIES[name])
    main = full["kinetic" if lagrangian is None else "lagrangian"]
    minus = full.get("potential", sympy.S.Zero)
    return typed, (main, minus, main - minus)


@located("coordinates")
def _coordinates(coordinates: Sequence[Any] | None, survey: Survey, first_order: Iterable[Any]) -> tuple[Any, ...]:
    """Return the coordinates of a system: the user's list, or without a list those found in the expressions.

    `survey` has the symbols of the energies and constraints. `first_order` are coordinates with a force or dissipation,
    which may occur in no energy; without a list they are added to the survey. Raises StatementError for a listed object
    that is not a coordinate, and if there are no coordinates.
    """
    if coordinates is not None and (
        not isinstance(coordinates, Iterable) or (isinstance(coordinates, np.ndarray) and not coordinates.ndim)
    ):
        raise StatementError(f"coordinates is {shown(coordinates)}: give a list, such as [{shown(coordinates)}].")
    if coordinates is None:
        survey.coordinates.update(dict.fromkeys(first_order))
        # An undeclared function may be meant as a given motion, unless all are SymPy's, as from `dynamicsymbols`.
        undeclared = [q for q in survey.coordinates if not declared(q)]
        if undeclared and any(map(is_ours, survey.coordinates)):
            names = [name_of(q) for q in survey.coordinates if declared(q)]
            raise StatementError(coordinate_or_given(name_of(undeclared[0]), names))
        coordinates = COORDINATES.of((name_of(q), q) for q in survey.coordinates)
    by_name: dict[str, Any] = {}
    for q in coordinates:
        if not isinstance(q, AppliedUndef) or q.args != (t,) or motion_of(q) is not None:
            raise StatementError(
                f"coordinates contains {shown(q)}, which is not a coordinate: make one with lg.coordinate('x')."
            )
        name = check_symbol(name_of(q), "coordinate")
        if name in by_name:
            raise StatementError(f"coordinate {name} is listed twice: name each coordinate once.")
        by_name[name] = q
    if not by_name:
        raise StatementError(f"no coordinates: the energies contain no function of time. {_make_one(survey)}")
    for name in by_name:
        check_rate(name, by_name, "coordinate")
    return tuple(by_name.values())


def _first_order(forces: Any, dissipation: Any) -> Iterator[Any]:
    """Yield coordinates with a force, and coordinates whose velocity is in the dissipation.

    Such a coordinate may occur in no energy, as a charge whose current only heats a resistor.
    """
    rates = dissipation.atoms(sympy.Derivative) if isinstance(dissipation, sympy.Basic) else ()
    for q in (*(forces if isinstance(forces, Mapping) else ()), *(rate.expr for rate in rates)):
        if isinstance(q, AppliedUndef) and q.args == (t,) and motion_of(q) is None and not is_shorthand(q):
            yield q


def _make_one(survey: Survey) -> str:
    """Return the hint of a message on a missing coordinate: how to declare one.

    For a parameter in `survey` such as `theta_dot`, the hint says that it is not a velocity, and how to declare
    `theta`.
    """
    for symbol in survey.parameters:
        name = symbol.name.removesuffix("dot").removesuffix("_")
        if symbol.name.endswith("dot") and NAME.fullmatch(name):
            return (
                f"{symbol.name} is a plain symbol, not a velocity: make {name} = lg.coordinate({name!r}), and write "
                f"{name}.dot for it."
            )
    return "Make one with lg.coordinate('x')."


def _check_velocities(statement: Statement, suffix: str, *, alone: bool) -> None:
    """Raise StatementError for a coordinate whose acceleration no equation determines.

    `suffix` ends the name of a velocity in the message. `alone` is true if the user stated the Lagrangian L alone.
    """
    still = without_velocity(statement, alone=alone)
    if still is None:
        return
    key, name = "lagrangian" if alone else "kinetic", name_of(still)
    main, rate = ENERGIES[key], f"{name}{suffix}"
    with located(key):
        if (turned := rotation_name(still)) is not None:
            raise StatementError(without_inertia(turned))
        if any(symbol.name == f"{name}dot" for symbol in statement.lagrangian.free_symbols):
            raise StatementError(
                f"{main} contains the plain symbol {name}dot, which is not a velocity: write {rate} for it, with "
                f"{name} = lg.coordinate({name!r})."
            )
        raise StatementError(
            f"{main} does not contain {rate}, so {name} has no inertia and its acceleration is undefined: add its "
            f"kinetic energy, or make {name} a parameter or a given function of time. {first_order_remedy(rate)}"
        )


def _check_constraints(constraints: Sequence[Constraint], coordinates: tuple[Any, ...], redundant: str) -> None:
    """Raise StatementError for an unknown word `redundant`, and if it refuses more constraints than coordinates."""
    with located("redundant"):
        one_of(redundant, REDUNDANT, "redundant is {given}: give one of {known}.")
    if redundant == REFUSE and len(constraints) > len(coordinates):
        names = listing(name_of(q) for q in coordinates)
        noun = "coordinates" if len(coordinates) > 1 else "coordinate"
        raise StatementError(
            f"there are {len(constraints)} constraints ({listing(constraint.name for constraint in constraints)}) for "
            f"{len(coordinates)} {noun} ({names}): give at most as many constraints as coordinates."
        )


@located("forces")
def _forces(forces: Mapping[Any, Any] | None, by_name: dict[str, Any], survey: Survey) -> dict[Any, Any]:
    """Return {coordinate: force}, and add symbols of the forces to `survey`. `by_name` maps names to coordinates."""
    table: dict[Any, Any] = {}
    forces = forces_on_coordinates(forces, by_name.values())
    known = in_symbols(by_name, dict.fromkeys(filter(None, map(rotation_name, by_name.values()))))
    for key, value in table_of(forces, "forces", "coordinate to generalized force").items():
        label = label_of(key)
        if label not in by_name:
            raise StatementError(
                f"forces names {label!r}, which is not a coordinate of this system; they are {listing(known)}."
                + suggestion(label, known)
            )
        if by_name[label] in table:
            raise StatementError(f"forces names {label!r} twice: give the sum of the forces on it.")
        with located(label):
            table[by_name[label]] = expression(value, f"the force on {label}")
            survey.add(table[by_name[label]], f"the force on {label}", multipliers=True)
    return table


@located("dissipation")
def _dissipation(function: Any, by_name: Mapping[str, Any], survey: Survey) -> Any:
    """Return Rayleigh's dissipation function D, and add its symbols to `survey`.

    Raises StatementError for a D without velocities, because its force -dD/dv is zero.
    """
    dissipation = expression(function, "the dissipation")
    survey.add(dissipation, "the dissipation")
    if dissipation != 0 and not Survey().add(dissipation, "the dissipation").velocities:
        raise StatementError(
            f"the dissipation is {formula(dissipation, 60)}, without a velocity, and its force -dD/d(velocity) is "
            f"zero: state it with velocities, as in c*{next(iter(by_name))}.dot**2/2, or add it to the potential "
            "energy."
        )
    return dissipation


def _drawn(positions: Any, links: Iterable[Sequence[str]], surfaces: Any, survey: Survey) -> dict[str, Any]:
    """Return {field: value} for the drawn fields `positions`, `links` and `surfaces`; add their symbols to `survey`."""
    points, edges = _positions(positions, survey)
    lines = _surfaces(surfaces, points, survey)
    views = {"positions": MappingProxyType(points), "surfaces": MappingProxyType(lines)}
    return {"links": (*edges, *_links(links, points)), **views}


@located("positions")
def _positions(
    positions: Mapping[str, Any] | None, survey: Survey
) -> tuple[dict[str, tuple[Any, ...]], tuple[Link, ...]]:
    """Return {name: point} of the positions to draw, and the edges of shapes as links; add symbols to `survey`.

    The corners of a shape named `body` are the points body_1, body_2, ...
    """
    points, table = dict[str, tuple[Any, ...]](), dict[str, Any]()
    edges: list[Link] = []
    for label, point in table_of(positions, "positions", "name to point").items():
        if isinstance(point, Shape):
            names = [f"{label}_{k}" for k in range(1, len(point.corners) + 1)]
            table |= dict(zip(names, point.corners, strict=True))
            edges += [Link(names[a], names[b], EDGE) for a, b in point.edges]
        else:
            table[label] = point
    for label, point in table.items():
        with located(label):
            if label == ORIGIN:
                raise StatementError("'origin' is the point at zero already: choose another name.")
            what = f"the position of {check_name(label, 'point')}"
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
    return points, tuple(edges)


@located("surfaces")
def _surfaces(table: Mapping[str, Any] | None, points: dict[str, Any], survey: Survey) -> dict[str, tuple[Any, ...]]:
    """Return {name: point} of the surfaces to draw. The point moves along the surface as `along` grows from 0 to 1.

    Its entries are expressions in `along`, parameters and t, as many as those of the named positions `points`. Their
    symbols are added to `survey`.
    """
    surfaces: dict[str, tuple[Any, ...]] = {}
    size = len(next(iter(points.values()), ()))
    for name, point in table_of(table, "surfaces", "name to point").items():
        what = f"the surface {check_name(name, 'surface')}"
        if not points:
            raise StatementError(
                f"{what} is drawn for a moving point, and there is none: state in positions what moves on it."
            )
        if not _has_length(point, size):
            raise StatementError(
                f"{what} is {shown(point)}: give a point of {size} expressions in lg.along, as many as a position has, "
                f"such as ({', '.join(['2*lg.along', '0', '0'][:size])})."
            )
        surfaces[name] = tuple(expression(entry, what) for entry in point)
        leaves = Survey()
        for entry in surfaces[name]:
            for target in (leaves, survey):
                target.add(entry.xreplace({along: sympy.S.Half}), what)
        if leaves.coordinates or leaves.velocities:
            raise StatementError(
                f"{what} contains {listing(map(name_of, leaves.coordinates))}: write a surface in lg.along, parameters "
                "and t only. A body that moves is drawn by links between its points."
            )
        if not any(entry.has(along) for entry in surfaces[name]):
            raise StatementError(f"{what} is one point: give a point that moves as lg.along grows from 0 to 1.")
    return surfaces


@located("links")
def _links(links: Iterable[Sequence[str]], points: dict[str, Any]) -> tuple[Link, ...]:
    """Return the links between named points. Raises StatementError for unknown points or kinds, and for other types."""
    end = [ORIGIN, *points], "links names {given}, which is not a position; they are {known}."
    kind = KINDS, "links has the kind {given}; the kinds are {known}."
    pairs = None if isinstance(links, TEXTS) else entries(links, "links")
    if pairs is None:
        raise StatementError(f"links is {shown(links)}: give a list of pairs of point names, [('origin', 'bob')].")
    for i, link in enumerate(pairs):
        with located(i):
            if not _has_length(link, 2, 3):
                raise StatementError(
                    f"links contains {shown(link)}: give pairs of point names, such as ('origin', 'bob'), or "
                    "('origin', 'bob', 'spring')."
                )
            for k, (part, (known, refusal)) in enumerate(zip(link, (end, end, kind), strict=False)):
                with located(k):
                    one_of(part, known, refusal)
    return tuple(Link(*link) for link in pairs)


def _has_length(value: Any, *lengths: int) -> bool:
    """Return True if the value is a list, tuple, vector or matrix whose number of entries is one of `lengths`."""
    if isinstance(value, np.ndarray):
        return value.ndim == 1 and len(value) in lengths
    return isinstance(value, (list, tuple, sympy.MatrixBase)) and len(value) in lengths


@located("constraints")
def _declare_constraints(zeros: Mapping[str, Any], survey: Survey) -> tuple[Constraint, ...]:
    """Return constraints from {name: expression that stays zero}, and add their symbols to `survey`.

    Raises StatementError for an expression without a coordinate.
    """
    constraints = []
    for name, typed in zeros.items():
        what, zero = f"constraint {name!r}", in_full(typed)
        with located(name):
            leaves = Survey().add(zero, what)
            survey.add(zero, what)
            if not leaves.coordinates:
                raise StatementError(_no_coordinates(what, zero))
        constraints.append(Constraint(name, zero, not leaves.velocities))
    return tuple(constraints)


@located("constraints")
def _typed_zeros(constraints: Any) -> dict[str, Any]:
    """Return {name: expression that stays zero}; constraints in a list are named constraint_1, constraint_2, ..."""
    if isinstance(constraints, Mapping):
        named = dict(constraints)
        for name in named:
            with located(name):
                check_name(name, "constraint")
    else:
        listed = entries(constraints, "constraints")
        if listed is None:
            raise StatementError(
                f"constraints is {shown(constraints)}: give a list such as [x**2 + y**2 - l**2], or a dict such as "
                "{'rod': x**2 + y**2 - l**2}."
            )
        named = {f"constraint_{i}": stated for i, stated in enumerate(listed, 1)}
    return {name: _zero_of(stated, f"constraint {name!r}") for name, stated in named.items()}


def _zero_of(stated: Any, what: str) -> Any:
    """Return the expression that is zero if the constraint `stated` holds: itself, or left minus right side."""
    if isinstance(stated, sympy.Eq):
        return as_typed(stated.lhs, f"the left side of {what}") - as_typed(stated.rhs, f"the right side of {what}")
    if isinstance(stated, (BooleanAtom, bool)):
        verdict = "always true: it constrains nothing. Leave it out" if stated else "never true: no motion satisfies it"
        raise StatementError(f"{what} is {verdict}. Where == was meant, write sympy.Eq(left, right).")
    if isinstance(stated, Relational):
        raise StatementError(
            f"{what} is {shown(str(stated))}, an inequality. Constraints are equations: state the equation that holds, "
            "and end the run by an event where the multiplier changes sign, lg.multiplier(name)."
        )
    if isinstance(stated, TEXTS):
        raise StatementError(f"{what} is the text {shown(stated, 60)}: give a SymPy expression that is zero, or an Eq.")
    return as_typed(stated, what)


def _no_coordinates(what: str, zero: Any) -> str:
    """Return the error message for a constraint `what` whose expression `zero` has no coordinate and no velocity."""
    if zero.is_zero:
        return f"{what} is 0 = 0, which always holds: leave it out."
    if zero.is_number:
        return f"{what} is {formula(zero, 60)} = 0, which never holds: no motion satisfies it."
    return (
        f"{what} contains no coordinate and no velocity ({formula(zero, 60)} = 0): a constraint relates coordinates or "
        "velocities. State a relation of parameters in the values of parameters."
    )
