"""A statement with other expressions in it; what is not mentioned is carried over."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from lagrange.statement.constraint import Constraint
from lagrange.statement.coordinate import t
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement


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
    """Return the statement with `put` applied to every expression, checked again.

    `coordinates` are those of the new statement. `forces` are finished; where they are not given, `put` makes them of
    the old ones, as it does with `constraints`, old ones in any case. `parameters` are all that the new expressions
    may contain, with None for those that have no value. `initial` is keyed by coordinate and velocity.
    """
    chosen = statement.coordinates if coordinates is None else tuple(coordinates)
    held = statement.constraints if constraints is None else constraints
    if forces is None:
        forces = {q: put(force) for q, force in zip(statement.coordinates, statement.forces, strict=True)}
    if parameters is None:
        parameters = {p: statement.defaults.get(p) for p in statement.parameters}
    parameters = {p: parameters[p] for p in (*statement.defaults, *parameters) if p in parameters}  # as stated
    if initial is None:
        initial = dict(zip((*statement.coordinates, *statement.velocities), statement.initial, strict=True))
    alone = statement.potential == 0 and statement.kinetic == statement.lagrangian
    energies = (
        {"lagrangian": put(statement.lagrangian)}
        if alone
        else {"kinetic": put(statement.kinetic), "potential": put(statement.potential)}
    )
    made = declare(
        **energies,
        coordinates=chosen,
        forces={q: force for q, force in forces.items() if force != 0},
        dissipation=put(statement.dissipation),
        constraints={one.name: put(one.expression) for one in held},
        redundant=statement.redundant,
        parameters=parameters,
        initial=initial,
        positions={label: tuple(map(put, point)) for label, point in statement.positions.items()},
        links=statement.links,
        name=statement.name,
    )
    return with_origin(made, statement)


def with_origin(made: Statement, statement: Statement) -> Statement:
    """Return a statement that was made of another with what that says of itself: text, run, dimensions."""
    left = {t, *made.coordinates, *made.parameters}
    sizes = MappingProxyType({symbol: size for symbol, size in statement.dimensions.items() if symbol in left})
    return replace(made, about=statement.about, source=statement.source, run=statement.run, dimensions=sizes)
