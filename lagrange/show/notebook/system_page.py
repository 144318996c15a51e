"""The page of a system in a notebook: energies, parameters, initial state, equations, conserved quantities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, counted
from lagrange.show.notation.sections import LAGRANGIAN, Formula, ShownQuantity, constraint_quantity
from lagrange.show.notation.symbols import markdown_text
from lagrange.show.notebook.page_writer import (
    MOST_SHOWN_OPERATIONS,
    PageWriter,
    Part,
    bold,
    joined,
    left_out,
    listed,
    operations,
)
from lagrange.show.units import unit_of
from lagrange.statement.statement import Statement

INSTEAD = "`print(system.derivation())` has it as text, `system.equations()` and the like as SymPy expressions."


def system_page(derivation: Derivation, findings: Sequence[str]) -> str:
    """Return the page of a system; `findings` are sentences about its structure and conserved quantities."""
    return joined(_parts(derivation, findings), INSTEAD)


def _parts(derivation: Derivation, findings: Sequence[str]) -> Iterator[Part]:
    statement = derivation.statement
    writer = PageWriter(statement)
    count = len(statement.coordinates)
    head = f"{bold(statement.name)}: {counted(count, 'coordinate')}"
    names = " " + ", ".join(map(writer.inline, statement.coordinates)) if count <= NAMED_COORDINATES else ""
    yield "the coordinates", f"{head}{names}" + (f". {markdown_text(statement.about)}" if statement.about else "")
    yield from _stated(statement, writer)
    yield "the parameters", _parameters(statement, writer)
    yield "the initial state", _initial(statement, writer)
    yield "the equations of motion", _equations(derivation, writer)
    yield "the structure", f"{bold('Structure')}\n\n" + "\n".join(f"- {markdown_text(finding)}" for finding in findings)


NAMED_COORDINATES = 12
"""Largest number of coordinates that are named; more are only counted."""


def _stated(statement: Statement, writer: PageWriter) -> Iterator[Part]:
    """Yield the energies, forces and constraints; short ones share a formula."""
    if statement.lagrangian_alone:
        rows: list[tuple[Any, Any]] = [(LAGRANGIAN, statement.lagrangian)]
    else:
        rows = [(ShownQuantity("T"), statement.kinetic), (ShownQuantity("V"), statement.potential)]
    rows += [
        (ShownQuantity("Q", (name,)), force)
        for name, force in zip(statement.names, statement.forces, strict=True)
        if force != 0
    ]
    rows += [(ShownQuantity("D"), statement.dissipation)] if statement.dissipation != 0 else []
    rows += [motion for motion in statement.known_motions if not isinstance(motion, str)]
    rows += [(constraint_quantity(constraint), constraint.expression) for constraint in statement.constraints]
    short = [Formula(row) for row in rows if row[1].count_ops() <= MOST_SHOWN_OPERATIONS]
    if short:
        yield "the energies, forces and constraints", writer.under("Stated", short)
    for name, what in rows:
        if (size := int(what.count_ops())) > MOST_SHOWN_OPERATIONS:
            yield "", left_out(_called(name), f"it has {size} operations", INSTEAD)
    for motion in statement.known_motions:
        if isinstance(motion, str):
            yield "a given motion", markdown_text(motion)


def _called(quantity: Any) -> str:
    return " ".join((quantity.letter, *quantity.indices)) if isinstance(quantity, ShownQuantity) else str(quantity)


def _parameters(statement: Statement, writer: PageWriter) -> str:
    if not statement.parameters:
        return ""
    values = {symbol: statement.defaults.get(symbol) for symbol in statement.parameters}
    units = {symbol: unit_of(statement, symbol.name) for symbol in statement.parameters}
    return listed("Parameters", writer.values(values, units), len(values))


def _initial(statement: Statement, writer: PageWriter) -> str:
    symbols = (*statement.coordinates, *statement.velocities)
    values = {symbol: value for symbol, value in zip(symbols, statement.initial, strict=True) if value}
    units = {symbol: unit_of(statement, name) for symbol, name in zip(symbols, statement.state_names, strict=True)}
    rest = "" if len(values) == len(symbols) else "all else 0" if values else "all 0"
    return listed("Initial state", ", ".join(filter(None, (writer.values(values, units), rest))), len(values))


def _equations(derivation: Derivation, writer: PageWriter) -> str:
    statement = derivation.statement
    name = "the equations of motion"
    if (size := operations(statement)) > MOST_SHOWN_OPERATIONS:
        return left_out(name, f"they are derived from {size} operations, which takes long", INSTEAD)
    try:
        return writer.equations("Equations of motion", (*derivation.equations, *derivation.constraints))
    except StatementError as refusal:
        return left_out(name, str(refusal), INSTEAD)
