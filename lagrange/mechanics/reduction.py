"""Derive a system with fewer coordinates or parameters: eliminate constraints, substitute parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import sympy

from lagrange.equations.terms import differentiable, printable
from lagrange.errors import StatementError, formula, listing, shown, suggestion
from lagrange.mechanics.plain_form import PlainForm, in_fractions, simplest, time_derivative, vanishes
from lagrange.statement.coordinate import name_of, t, velocity_of
from lagrange.statement.declare import declare
from lagrange.statement.expression import TYPED_ROUNDING, check_once, expression, refusing_deep
from lagrange.statement.given.function import given as given_function
from lagrange.statement.given.motion import motion_of
from lagrange.statement.parameters import Survey, coordinate_name, in_own_parameters, label_of
from lagrange.statement.random_states import NEAR_INITIAL
from lagrange.statement.rotation import rotation_of
from lagrange.statement.statement import Constraint, Statement


def rewritten(
    statement: Statement,
    put: Callable[[Any], Any],
    *,
    coordinates: Sequence[Any] | None = None,
    forces: Mapping[Any, Any] | None = None,
    constraints: Sequence[Constraint] | None = None,
    parameters: Mapping[Any, Any] | None = None,
    initial: Mapping[Any, float] | None = None,
) -> Statement:
    """Return a new statement: the old one with the function `put` applied to each of its expressions.

    Each further argument replaces a part of the statement; None leaves this part unchanged. `coordinates` are the new
    coordinates. `forces` are the new forces {coordinate: expression}, to which `put` is not applied. `constraints` are
    the old constraints that remain; `put` is applied to them. `parameters` are all parameters of the new expressions,
    {symbol: value or None}. `initial` is the new initial state, by coordinate and velocity. If rotations remain,
    expressions contain their matrix entries and rates by name, such as R_xx(t). Raises StatementError if the result is
    not a valid statement.
    """
    chosen = statement.coordinates if coordinates is None else tuple(coordinates)
    left = {c.name for c in (statement.constraints if constraints is None else constraints)}
    read = read_with(statement, chosen)
    if forces is None:
        forces = {key: put(force) for key, force in read.applied.items()}
    if parameters is None:
        parameters = {p: statement.defaults.get(p) for p in statement.parameters}
    parameters = {p: parameters[p] for p in (*statement.defaults, *parameters) if p in parameters}  # in stated order
    if initial is None:
        initial = dict(zip((*statement.coordinates, *statement.velocities), statement.initial, strict=True))
    names = ["lagrangian"] if read.lagrangian_alone else ["kinetic", "potential"]
    energies = {name: put(getattr(read, name)) for name in names}
    result = declare(
        **energies,
        coordinates=chosen,
        forces={q: force for q, force in forces.items() if force != 0},
        dissipation=put(read.dissipation),
        constraints={c.name: put(c.expression) for c in read.constraints if c.name in left},
        redundant=statement.redundant,
        parameters=parameters,
        initial=initial,
        positions={label: tuple(map(put, point)) for label, point in statement.positions.items()},
        links=statement.links,
        contacts={each.name: each.mapped(put) for each in statement.contacts},
        simultaneous=statement.simultaneous or None,
        surfaces={label: tuple(map(put, point)) for label, point in statement.surfaces.items()},
        name=statement.name,
    )
    return with_origin(result, statement)


def read_with(statement: Statement, coordinates: Sequence[Any]) -> Statement:
    """Return `statement.reading`: the same system, in which rotations are described by rates about the body axes.

    The statement itself is returned if `reading` is None, or if a quaternion is not among the new `coordinates`.
    """
    kept = all(q in coordinates for name in statement.rotations for q in rotation_of(name).quaternion)
    return statement.reading if statement.reading is not None and kept else statement


def with_origin(derived: Statement, statement: Statement) -> Statement:
    """Return the statement `derived` with the texts, run settings and dimensions of `statement`, its original.

    The run settings are taken without events, and the dimensions of symbols that are left.
    """
    left = {t, *derived.coordinates, *derived.parameters}
    sizes = MappingProxyType({symbol: size for symbol, size in statement.dimensions.items() if symbol in left})
    run = replace(statement.run, events=())
    return replace(derived, about=statement.about, source=statement.source, run=run, dimensions=sizes)


@refusing_deep
def substituted(statement: Statement, replacements: Mapping[Any, Any]) -> Statement:
    """Return the statement with other expressions for some parameters: `replacements` is {symbol or name: expression}.

    A given function of time may also be replaced, by any value that `lagrange.given` takes. Parameters that occur only
    in the new expressions have no value. Raises StatementError for a key that is not a parameter, and for an expression
    in coordinates or time, whose derivatives would be missing in the equations.
    """
    if not isinstance(replacements, Mapping) or not replacements:
        raise StatementError(
            f"substitute takes a dict from parameters to values, as {{l: 1}}, not {shown(replacements)}."
        )
    by_name = {symbol.name: symbol for symbol in statement.parameters}
    functions = {name_of(function): function for function in statement.given}
    table: dict[Any, Any] = {}
    names = [label_of(key).removesuffix("(t)") for key in replacements]
    check_once(names, "substitute")
    for name, value in zip(names, replacements.values(), strict=True):
        if name in functions:
            table[functions[name]] = given_function(name, value)
            continue
        if name in statement.names:
            raise StatementError(
                f"{name} is a coordinate: eliminate() solves a constraint for it, transform() states the system in "
                "other coordinates; substitute() replaces parameters."
            )
        if name not in by_name:
            known = f"its parameters are {listing(by_name)}." + suggestion(name, by_name) if by_name else "it has none."
            raise StatementError(f"{name!r} is not a parameter of this system; {known}")
        table[by_name[name]] = _value(by_name[name], value, by_name)
    for function in statement.given:
        motion = motion_of(function)
        if function not in table and motion and motion.expression is not None:
            table[function] = given_function(name_of(function), motion.expression.subs(table, simultaneous=True))
    left = {p: statement.defaults.get(p) for p in statement.parameters if p not in table}
    new = {symbol for value in table.values() for symbol in value.free_symbols} - {*left, t}
    parameters = left | dict.fromkeys(sorted(new, key=str))
    return rewritten(statement, lambda stated: stated.subs(table, simultaneous=True), parameters=parameters)


def _value(parameter: Any, replacement: Any, by_name: Mapping[str, Any]) -> Any:
    """Return the user's expression `replacement` for a parameter, in the parameters of the system, {name: symbol}."""
    what = f"the value of {parameter}"
    value, survey = expression(replacement, what), Survey()
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


@refusing_deep
def reduced(statement: Statement, requests: Sequence[Any]) -> Statement:
    """Return a statement without the requested coordinates, and without the constraints that determine them.

    A request is a coordinate, its name, the name of a constraint, or a dict {coordinate: expression}. Raises
    StatementError if no constraint determines a coordinate.
    """
    if not requests:
        raise StatementError("eliminate() has no arguments: give a coordinate that a constraint determines.")
    for request in requests:
        for name, value in _requests(request, statement):
            statement = _without(statement, name, value)
    return statement


def _requests(request: Any, statement: Statement) -> list[tuple[str, Any]]:
    """Return (name, expression or None) for each coordinate that a user's request eliminates.

    A request is a coordinate, its name, the name of a constraint, or a dict {coordinate: expression}. If the expression
    is None, a constraint is to be solved for the coordinate.
    """
    if isinstance(request, Mapping):
        return [(coordinate_name(key, statement.names), value) for key, value in request.items()]
    constraints = {constraint.name: constraint for constraint in statement.constraints}
    if isinstance(request, str) and request in constraints and request not in statement.names:
        return [(_coordinate_of(constraints[request], statement), None)]
    return [(coordinate_name(request, statement.names), None)]


def _coordinate_of(constraint: Constraint, statement: Statement) -> str:
    """Return the last coordinate that a constraint determines uniquely. Raises StatementError if there is none."""
    if not constraint.holonomic:
        raise StatementError(
            f"the constraint {constraint.name} determines no coordinate: {_on_velocities([constraint.name])}"
        )
    for name in reversed(statement.names):
        if _solution(constraint, name, statement) is not None:
            return name
    raise StatementError(
        f"the constraint {constraint.name} determines no coordinate safely: in no coordinate is it linear with a "
        "coefficient that never vanishes. Give a branch, such as eliminate({y: -sqrt(l**2 - x**2)})."
    )


def _solution(constraint: Constraint, name: str, statement: Statement) -> Any:
    """Return the expression for the coordinate `name` that solves a constraint, or None if it is not unique.

    The expression has symbols in place of functions of time.
    """
    plain = statement.plain
    c = plain[statement.coordinates[statement.names.index(name)]]
    zero = constraint.expression.xreplace(plain)
    if not constraint.holonomic or not zero.has(c):
        return None
    slope = sympy.expand(differentiable(zero).diff(c))
    if slope.has(c):
        slope = simplest(slope)
    # SymPy proves of some slopes that they are never zero for real symbols and positive parameters.
    if slope.has(c) or not (slope.is_nonzero or sympy.factor(slope).is_nonzero):
        return None
    return sympy.expand(-zero.xreplace({c: sympy.S.Zero}) / slope)


def _without(statement: Statement, name: str, replacement: Any) -> Statement:
    """Return the statement without the coordinate `name` and one constraint that determines it.

    `replacement` is the user's expression for the coordinate. If it is None, a constraint is solved for the coordinate.
    Raises StatementError if no constraint determines it.
    """
    if len(statement.coordinates) == 1:
        raise StatementError(f"{name} is the only coordinate left: keep it, because a system needs a coordinate.")
    q = statement.coordinates[statement.names.index(name)]
    candidates = [c for c in statement.constraints if c.expression.has(q)]
    if replacement is None:
        solutions = ((constraint, _solution(constraint, name, statement)) for constraint in candidates)
        solution = next((pair for pair in solutions if pair[1] is not None), None)
        if solution is None:
            raise StatementError(_refusal(candidates, name, statement))
        constraint, solved = solution
    else:
        constraint, solved = _checked(candidates, name, replacement, statement)
    for other, force in zip(statement.names, statement.forces, strict=True):
        if force.has(constraint.multiplier):
            raise StatementError(
                f"{name} is determined by {constraint.name}, and the force on {other} contains the multiplier of "
                f"{constraint.name}, which has no value without it: keep {name} and {constraint.name}, or state the "
                "force in coordinates and velocities."
            )
    _check_initial(statement, name, solved)
    return _substituted(statement, name, constraint, solved)


def _check_initial(statement: Statement, name: str, solved: Any) -> None:
    """Raise StatementError if initial values contradict `solved`, the expression for the coordinate `name`.

    The coordinate and its velocity are compared. A stated zero is not compared, since zero is the default, nor an
    expression with a parameter that has no value.
    """
    plain, n = statement.plain, len(statement.coordinates)
    state = zip((*statement.coordinates, *statement.velocities), statement.initial, strict=True)
    numbers = {**{plain[symbol]: number for symbol, number in state}, **statement.defaults}
    values = {symbol: sympy.Float(number) for symbol, number in numbers.items()} | {t: sympy.S.Zero}
    derived = {name: (statement.names.index(name), solved)}
    derived[f"{name}.dot"] = n + derived[name][0], time_derivative(differentiable(solved), statement.plain)
    for label, (row, known) in derived.items():
        stated, computed = statement.initial[row], printable(known).xreplace(values).evalf()
        if not stated or not computed.is_number:
            continue
        if not computed.is_finite or abs(computed - stated) > TYPED_ROUNDING * max(abs(computed), abs(stated)):
            follows = f"{computed.evalf(6)}" if computed.is_finite else "undefined"
            raise StatementError(
                f"{name} = {shown(str(printable(solved)))} does not hold at the initial state: {label} is {stated:.6g} "
                f"there, and {follows} by this expression. Give the expression of the branch that is meant, or other "
                "initial values."
            )


def _refusal(constraints: Sequence[Constraint], name: str, statement: Statement) -> str:
    """Return the error message for a coordinate, `name`, that no constraint determines.

    `constraints` are the constraints that contain the coordinate; the list may be empty.
    """
    if not constraints:
        return f"{name} is in no constraint, so it cannot be eliminated: it moves freely."
    holonomic = [constraint for constraint in constraints if constraint.holonomic]
    if not holonomic:
        names = [constraint.name for constraint in constraints]
        return f"{name} is in no constraint on positions: {_on_velocities(names)}"
    plain = statement.plain
    c = plain[statement.coordinates[statement.names.index(name)]]
    slope = differentiable(holonomic[0].expression.xreplace(plain)).diff(c)
    cause = (
        f"it is not linear in {name}, so that {name} may have several values or none"
        if simplest(slope).has(c)
        else f"the coefficient of {name}, {printable(sympy.factor(slope))}, may vanish"
    )
    return (
        f"{holonomic[0].name} does not determine {name} safely: {cause}. Say which value is meant, as in "
        f"eliminate({{{name}: ...}}), with an expression in the other coordinates."
    )


def _on_velocities(names: Sequence[str]) -> str:
    """Return the error message for constraints on velocities, `names`, which cannot be eliminated."""
    return (
        f"{listing(names)} {'is a constraint' if len(names) == 1 else 'are constraints'} on velocities, which may not "
        "be put into the energies, since the forces of the constraint would be missing. Keep it, or state the "
        "constraint on positions that it is the rate of."
    )


def _checked(
    constraints: Sequence[Constraint], name: str, replacement: Any, statement: Statement
) -> tuple[Constraint, Any]:
    """Return (constraint, expression), where the user's expression for a coordinate solves the constraint.

    `name` is the coordinate, and `replacement` the expression as the user gave it. The returned expression has symbols
    in place of functions of time. `constraints` are those that contain the coordinate. Raises StatementError if the
    expression solves none of them.
    """
    what, q = f"the value of {name}", statement.coordinates[statement.names.index(name)]
    stated = in_own_parameters(expression(replacement, what), statement.parameters)
    survey = Survey()
    survey.add(stated, what)
    if q in survey.coordinates or survey.velocities:
        raise StatementError(
            f"{what} is {shown(str(stated))}: give an expression in the other coordinates, parameters and t."
        )
    known = (*statement.coordinates, *statement.given, *statement.parameters)
    survey.require(known, what, f"; it has {listing(map(str, known))}.")
    plain = statement.plain
    solved = stated.xreplace(plain)

    def put(zero: Any) -> Any:
        return in_fractions(zero.xreplace(plain).xreplace({plain[q]: solved}))

    holonomic = [constraint for constraint in constraints if constraint.holonomic]
    if not holonomic:
        raise StatementError(_refusal(constraints, name, statement))
    for constraint in holonomic:
        if vanishes(PlainForm(statement), put(constraint.expression), NEAR_INITIAL):
            return constraint, solved
    raise StatementError(
        f"{name} = {shown(str(solved))} does not solve a constraint: give a solution of one of "
        f"{listing(constraint.name for constraint in holonomic)}, the constraints on positions that contain {name}."
    )


def _substituted(statement: Statement, name: str, constraint: Constraint, solved: Any) -> Statement:
    """Return the statement with the expression `solved` in place of the coordinate `name`, and without `constraint`."""
    index = statement.names.index(name)
    gone = statement.coordinates[index]
    plain = statement.plain
    stated = {symbol: leaf for leaf, symbol in plain.items()}
    left = [(q, plain[q]) for q in statement.coordinates if q != gone]
    smooth = differentiable(solved)
    slopes = {q: smooth.diff(symbol) for q, symbol in left}
    rate = time_derivative(smooth, plain)

    def back(expr: Any) -> Any:
        return printable(expr).xreplace(stated)

    table = {gone: back(solved), velocity_of(gone): back(rate)}

    def put(expr: Any) -> Any:
        return expr.xreplace(table)

    pull = put(statement.forces[index])
    forces = {
        q: put(statement.forces[i]) + pull * back(slopes[q]) for i, q in enumerate(statement.coordinates) if q != gone
    }
    start = dict(zip((*statement.coordinates, *statement.velocities), statement.initial, strict=True))
    return rewritten(
        statement,
        put,
        coordinates=[q for q, _ in left],
        forces=forces,
        constraints=[other for other in statement.constraints if other is not constraint],
        initial={key: start[key] for q, _ in left for key in (q, velocity_of(q))},
    )
