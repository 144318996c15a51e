"""Text of the statement at the top of an exported file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib.metadata import version
from typing import Any

from sympy import count_ops
from sympy.printing.str import StrPrinter

from lagrange.export.comments import wrapped
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.text import Notation
from lagrange.show.units import unit_of
from lagrange.statement.coordinate import name_of
from lagrange.statement.event import Event
from lagrange.statement.statement import Statement

WIDTH = 104

INPUTS = (
    "the last parameters. What is prepared from parameters does not depend on them: their places may be written before "
    "every call. A run holds them."
)
"""Comment on the inputs of an exported file."""

LONG = 300
"""Number of operations above which terms keep SymPy's order: textbook order takes seconds for thousands."""


LICENSE = "BSD-3-Clause"
"""License of the text of exported files that is ours; the equations are the user's."""


def generator() -> str:
    """Return the name and the version of this package."""
    return f"lagrange {version('lagrange-mechanics')}"


def statement_lines(statement: Statement, events: Sequence[Event] = ()) -> Iterator[str]:
    """Yield lines: name, version, license, energies, forces, constraints, events, coordinates, parameters, units.

    Coordinates are in order, parameters have their values. Given functions of time appear by name, as stated.
    """
    inputs = [symbol.name for symbol, _ in statement.inputs]
    statement = statement.open_form or statement
    write = _writer(statement)
    yield from wrapped(f"{statement.name}: equations of motion, made by {generator()}", WIDTH)
    yield f"SPDX-License-Identifier: {LICENSE}"
    if statement.about:
        yield from wrapped(statement.about, WIDTH)
    yield ""
    if statement.kinetic is None or statement.potential is None:
        yield from _formula("L", write(statement.lagrangian))
    else:
        yield from _formula("T", write(statement.kinetic))
        yield from _formula("V", write(statement.potential))
    for name, force in zip(statement.names, statement.forces, strict=True):
        if force != 0:
            yield from _formula(f"force on {name}", write(force))
    if statement.dissipation != 0:
        yield from _formula("D", write(statement.dissipation))
    for one in statement.constraints:
        yield from _formula(f"constraint {one.name}", f"{write(one.expression)} = 0")
    for known in statement.known_motions:
        yield from wrapped(known if isinstance(known, str) else f"{name_of(known[0])} = {write(known[1])}", WIDTH)
    for k, event in enumerate(events):
        yield from _formula(f"event{k}", f"{write(event.expression)}{_told(event, write)}")
    yield ""
    yield from _listed("coordinates", [_with_unit(statement, name) for name in statement.names])
    yield from _listed("parameters", [_valued(statement, p) for p in statement.parameters])
    if inputs:
        yield from wrapped(f"inputs: {', '.join(inputs)}: {INPUTS}", WIDTH)


def _told(event: Event, write: Callable[[Any], str]) -> str:
    """Return the text after the expression of an event: direction, end of the run, reset."""
    said = [{1: "rising", -1: "falling"}[event.direction]] if event.direction else []
    said += [f"terminal at occurrence {event.terminal}"] * (event.terminal > 0)
    said += [f"reset {write(key)} to {write(value)}" for key, value in event.reset.items()]
    return f" ({', '.join(said)}; the reset is not exported)" if event.reset else f" ({', '.join(said)})" * bool(said)


def _writer(statement: Statement) -> Callable[[Any], str]:
    """Return the function that writes an expression as text: in textbook order, or for long ones in SymPy's order."""
    booklike = cache(lambda: Typesetter(statement, Notation()))
    printer, plain = StrPrinter({"order": "none"}), statement.plain

    def named(other: Callable[[Any], str]) -> Callable[[Any], str]:
        return lambda node: plain[node].name if node in plain else other(node)

    # Long expressions are not rewritten in plain symbols first: SymPy needs seconds for that.
    printer._print_AppliedUndef = named(printer._print_Function)
    printer._print_Derivative = named(printer.emptyPrinter)

    def write(expression: Any) -> str:
        if count_ops(expression) <= LONG:
            return booklike().write(expression)
        return str(printer.doprint(expression))

    return write


def _formula(name: str, text: str) -> list[str]:
    return wrapped(f"{name} = {text}", WIDTH)


def _listed(what: str, parts: Sequence[str]) -> list[str]:
    return wrapped(f"{what}: {', '.join(parts) or 'none'}", WIDTH)


def _with_unit(statement: Statement, name: str) -> str:
    unit = unit_of(statement, name)
    return f"{name} [{unit}]" if unit else name


def _valued(statement: Statement, parameter: Any) -> str:
    value, unit = statement.defaults.get(parameter), unit_of(statement, parameter.name)
    given = "" if value is None else f" = {value!r}"
    return f"{parameter.name}{given} [{unit}]" if unit else f"{parameter.name}{given}"
