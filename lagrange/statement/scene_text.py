"""A statement as the text of a scene file. The text is read back and compared before it is returned."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import sympy

from lagrange.errors import SceneError, StatementError
from lagrange.statement.coordinate import name_of, t
from lagrange.statement.dimension import Dimension, named
from lagrange.statement.expression_text import expression_text
from lagrange.statement.letters import NAME
from lagrange.statement.motion import Table, motion_of
from lagrange.statement.multiplier import constraint_of
from lagrange.statement.same_statement import difference
from lagrange.statement.scene import scene_from_text
from lagrange.statement.statement import REFUSE, ROD, Statement
from lagrange.statement.text import RefusalError

BARE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_")
"""The characters of a TOML key without quotation marks."""

ENERGIES = {"lagrangian": "the Lagrangian", "kinetic": "the kinetic energy", "potential": "the potential energy"}
"""Keys of energies, and their names in messages."""


def scene_text(statement: Statement) -> str:
    """Return the text of a scene file that reads back as the statement.

    Raises StatementError for parts that scenes cannot state: parameters and given functions without values, functions
    that are not written out, names that scenes refuse, and expressions longer than those of scenes.
    """
    statement = statement.open_form or statement
    if statement.unknown:
        raise _refusal(statement, f"it contains {statement.unknown[0]}, which is not written out")
    text = "\n".join(_Writer(statement).lines()) + "\n"
    try:
        again = scene_from_text(text)
    except SceneError as error:
        raise _refusal(statement, error.reason.rstrip(".")) from None
    if other := difference(statement, again):
        raise _refusal(statement, f"{other} would be read back as something else")
    return text


def _refusal(statement: Statement, reason: str) -> StatementError:
    return StatementError(f"{statement.name} cannot be written as a scene: {reason}.")


class _Writer:
    """Writes one statement, a line for each value."""

    def __init__(self, statement: Statement) -> None:
        self.statement = statement
        self.plain = dict(statement.plain)
        for function in statement.given:
            name = name_of(function)
            for order, rate in enumerate(("", "_dot", "_ddot")):
                rated = sympy.Derivative(function, (t, order)) if order else function
                self.plain[rated] = sympy.Symbol(f"{name}{rate}", real=True)

    def lines(self) -> Iterator[str]:
        """Yield the lines of the file."""
        statement = self.statement
        yield f"name = {_quoted(statement.name)}"
        for key in ("about", "source"):
            if text := getattr(statement, key):
                yield f"{key} = {_quoted(text)}"
        yield f"coordinates = [{', '.join(map(_quoted, statement.names))}]"
        for key in ("lagrangian",) if statement.lagrangian_alone else ("kinetic", "potential"):
            yield f"{key} = {self.text(ENERGIES[key], getattr(statement, key))}"
        if statement.dissipation != 0:
            yield f"dissipation = {self.text('the dissipation', statement.dissipation)}"
        if statement.redundant != REFUSE:
            yield f"redundant = {_quoted(statement.redundant)}"
        if statement.links:
            shown = ([link.start, link.end, *([link.kind] * (link.kind != ROD))] for link in statement.links)
            yield f"links = [{', '.join(f'[{_joined(map(_quoted, link))}]' for link in shown)}]"
        for key, entries in self.tables().items():
            if entries:
                yield f"\n[{key}]"
                yield from (f"{_key(name)} = {value}" for name, value in entries.items())

    def tables(self) -> Mapping[str, Mapping[str, str]]:
        """Return the tables of the file, with the text of each value."""
        statement = self.statement
        forces = zip(statement.names, statement.forces, strict=True)
        states = zip(statement.state_names, statement.initial, strict=True)
        settings = {key: getattr(statement.run, key) for key in ("t_end", "rtol", "atol", "step")}
        run = {key: repr(float(value)) for key, value in settings.items() if value is not None}
        if statement.run.method is not None:
            run["method"] = _quoted(statement.run.method)
        return {
            "parameters": {p.name: self.value(p) for p in statement.parameters},
            "given": {name_of(function): self.motion(function) for function in statement.given},
            "initial": {name: repr(value) for name, value in states if value or name in statement.names},
            "forces": {name: self.text(f"the force on {name}", force) for name, force in forces if force != 0},
            "constraints": {
                constraint.name: self.text(constraint.name, constraint.expression)
                for constraint in statement.constraints
            },
            "positions": {
                label: f"[{_joined(self.text(f'the position of {label}', entry) for entry in point)}]"
                for label, point in statement.positions.items()
            },
            "dimensions": dict(self.dimensions()),
            "run": run,
        }

    def text(self, what: str, expression: Any) -> str:
        """Return an expression as a quoted text."""
        plain = expression.xreplace(self.plain)
        multipliers = sorted(str(s) for s in plain.free_symbols if constraint_of(s) is not None)
        if multipliers:
            raise _refusal(self.statement, f"{what} contains {multipliers[0]}, and scenes have no multipliers")
        rates = plain.atoms(sympy.Derivative)
        try:
            if rates:
                raise RefusalError(f"the derivative {min(map(str, rates))}")
            return _quoted(expression_text(plain))
        except RefusalError as error:
            raise _refusal(self.statement, f"{what} contains {error}") from None

    def value(self, parameter: Any) -> str:
        """Return the value of a parameter."""
        if parameter not in self.statement.defaults:
            raise _refusal(self.statement, f"{parameter.name} has no value, and a scene gives every parameter one")
        return repr(float(self.statement.defaults[parameter]))

    def motion(self, function: Any) -> str:
        """Return the values of a given function: a text, or lists of times and values."""
        motion = motion_of(function)
        if motion is None or motion.values is None:
            raise _refusal(self.statement, f"{name_of(function)} is given without values")
        if isinstance(motion.values, Table):
            return (
                f"[{_joined(f'[{_joined(map(repr, row))}]' for row in (motion.values.points, motion.values.values))}]"
            )
        return self.text(f"the given function {name_of(function)}", motion.values)

    def dimensions(self) -> Iterator[tuple[str, str]]:
        """Yield (name, quoted unit or dimension). Reading infers units that follow from the stated ones again."""
        for symbol, dimension in self.statement.dimensions.items():
            name = symbol.name if isinstance(symbol, sympy.Symbol) else name_of(symbol)
            if symbol == t and dimension == named("second"):
                continue
            yield name, _quoted(dimension.unit or _powers(dimension))


def _powers(one: Dimension) -> str:
    return "*".join(f"{name}**({power})" if power != 1 else name for name, power in one.exponents) or "1"


def _joined(texts: Iterable[str]) -> str:
    return ", ".join(texts)


def _quoted(text: str) -> str:
    """Return a TOML string. JSON escapes the same characters as TOML, except the control character DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    return name if set(name) <= BARE and NAME.fullmatch(name) else _quoted(name)
