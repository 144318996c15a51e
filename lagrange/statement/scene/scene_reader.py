"""Read a scene file: which keys it may have, and how its TOML text becomes a Statement.

Every refusal names file, line and column.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import sympy
from sympy.core.assumptions import _assume_defined
from sympy.core.facts import InconsistentAssumptions

from lagrange.errors import SceneError, StatementError, listing, shown
from lagrange.statement.contact import Contact, along, contact, impact_speed
from lagrange.statement.coordinate import (
    acceleration_of,
    check_name,
    check_symbol,
    coordinate_of,
    name_of,
    t,
    velocity_of,
)
from lagrange.statement.declare import ENERGIES, declare
from lagrange.statement.energy import Shape, shape
from lagrange.statement.event import Event, declare_events, event
from lagrange.statement.expression import printable, real_number
from lagrange.statement.given.function import given
from lagrange.statement.given.motion import table
from lagrange.statement.parameters import rate_name
from lagrange.statement.rotation import Rotation, rotation_of, shorthands
from lagrange.statement.run_settings import RunSettings
from lagrange.statement.scene.expressions import MULTIPLIER, Expressions, read_number
from lagrange.statement.scene.guard import RefusalError
from lagrange.statement.scene.toml_document import LARGEST_FILE, LARGEST_STORED, Document, dotted, kind_of
from lagrange.statement.scene.unevaluated import UnevaluatedExpressions
from lagrange.statement.statement import REFUSE, Statement

KEYS = (
    *("name", "about", "source", "coordinates", "kinetic", "potential", "lagrangian", "forces", "dissipation"),
    *("constraints", "redundant", "parameters", "given", "initial", "positions", "links", "run", "dimensions"),
    *("signs", "tables", "definitions", "functions", "evaluate", "events", "contacts", "simultaneous", "rotations"),
    "surfaces",
)
OPEN = "open"  # Text in a scene for a parameter or a given function without a value
NO_SIGN = "none"
"""Sign of a parameter without any assumption for SymPy. A parameter without an entry in [signs] is real."""
TABLE_KEYS = ("argument", "points", "values")
MOST_RATES = 6  # Highest order of derivatives of a given function that a scene can contain
CONTACT_KEYS = ("gap", "slip", "restitution", "friction")
SHAPE_KEYS = ("shape", "size", "rotation", "at")
RUN_KEYS = ("t_end", "method", "rtol", "atol", "step")
EVENT_KEYS = ("when", "direction", "terminal", "reset")

_TITLE = re.compile(r"(?=.*[^\W_])(?![.\s]).{0,63}\S")
_CONDITION = re.compile(r"\bif\b")
_INEQUALITY = re.compile(r"[<>]|!=")


def read_scene(path: str | os.PathLike[str]) -> Statement:
    """Return the statement in a scene file. Raises SceneError with file, line and column.

    A scene is data: reading it runs no code, imports nothing, and opens no other file.
    """
    return SceneReader(path).statement()


def stored_statement(text: Any) -> Statement:
    """Return the statement in a scene text that lagrange wrote. Raises StatementError for other or changed texts."""
    if not isinstance(text, str) or text.lstrip()[:1] == "{":
        raise StatementError(
            "its statement is JSON, as development versions before lagrange 0.1.0 wrote: state the system and run it "
            "again, or read it with the version that wrote it."
        )
    try:
        return SceneReader("", text, LARGEST_STORED).statement()
    except SceneError:
        raise
    except (
        *(KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError, MemoryError),
        *(NotImplementedError, RefusalError),
    ) as error:
        reason = str(error)[:120]
        raise StatementError(f"the stored statement cannot be read ({type(error).__name__}: {reason}).") from error


class SceneDocument(Document):
    """TOML file of a scene, whose values are read as numbers or as SymPy expressions.

    A path to a value consists of keys and indices, such as ("positions", "bob", 0).
    """

    @contextmanager
    def located(self, *path: str | int, key: bool = False) -> Iterator[None]:
        """Context manager in which a StatementError becomes a SceneError, located at the value at `path`.

        If `key` is true, the error is located at the key of the value.
        """
        try:
            yield
        except SceneError:
            raise
        except StatementError as error:
            self.refuse(str(error), *path, *error.place, key=key)

    def number(self, *path: str | int) -> float:
        """Return the number at a path, or the value of a constant expression there, such as "pi/6"."""
        value, what = self.value(*path), dotted(path)
        if not isinstance(value, (int, float, str)) or isinstance(value, bool):
            self.refuse(f'{what} is {kind_of(value)}: give a number, or a constant expression such as "pi/6".', *path)
        if isinstance(value, str):
            return float(self._of_text(read_number, *path))
        with self.located(*path):
            return real_number(value, what)

    def expression(self, reader: Expressions, *path: str | int) -> Any:
        """Return the text or number at a path of keys and indices in the file, as a SymPy expression."""
        return self._of_text(reader.read, *path)

    def one_or_more(self, reader: Expressions, *path: str | int) -> Any:
        """Return the expression at a path, or a tuple of expressions if there is a list."""
        is_list = isinstance(self.value(*path), list)
        return self.expressions(reader, *path) if is_list else self.expression(reader, *path)

    def expressions(self, reader: Expressions, *path: str | int) -> tuple[Any, ...]:
        """Return the expressions in the list at a path."""
        entries = self.value(*path)
        if not isinstance(entries, list):
            self.refuse(f'{dotted(path)} is {kind_of(entries)}: give a list of expressions, such as ["x", "y"].', *path)
        return tuple(self.expression(reader, *path, i) for i in range(len(entries)))

    def define(self, reader: Expressions, *path: str | int) -> None:
        """Define the last key of a path as a name for the expression at the path."""
        self._of_text(partial(reader.define, str(path[-1])), *path)

    def _of_text(self, read: Callable[[str], Any], *path: str | int, text: str | None = None) -> Any:
        """Return the result of `read` for the text at a path, or for `text`.

        `text` is a part of the text at the path, in which characters keep their columns. A SceneError of `read` gets
        the line of the file, and the column there. A number at the path is read as its text.
        """
        value, what = self.value(*path) if text is None else text, dotted(path)
        if not isinstance(value, (int, float, str)) or isinstance(value, bool):
            self.refuse(f'{what} is {kind_of(value)}: give an expression as a text, such as "2*x".', *path)
        if not isinstance(value, str):
            value = repr(self.number(*path))
        try:
            return read(value)
        except SceneError as error:
            self.refuse(f"{what}: {error.reason}", *path, column=error.column)

    def equation(self, reader: Expressions, *path: str | int) -> Any:
        """Return the expression at a path, which is zero. For a text "left == right" it is left minus right side."""
        value = self.value(*path)
        if not isinstance(value, str) or value.count("==") != 1 or _CONDITION.search(value):
            if isinstance(value, str) and _INEQUALITY.search(value) and not _CONDITION.search(value):
                self.refuse(
                    f"{dotted(path)} is an inequality. Constraints are equations: state the one that holds, and end "
                    "the run by an event where the multiplier changes sign.",
                    *path,
                )
            return self.expression(reader, *path)
        end = value.index("==")
        sides = value[:end], " " * (end + 2) + value[end + 2 :]  # Blanks keep the columns of the right side
        left, right = (self._of_text(reader.read, *path, text=side) for side in sides)
        return left - right


class SceneReader:
    """Reader of one scene file as a Statement, field by field. SceneErrors have line and column of the field.

    `path` is the path of the file, and `text` its content. Without `text` the file is read. `most` is its largest size
    in bytes. Methods take the `reader` of the file's expressions and its `rotations`.
    """

    def __init__(self, path: str | os.PathLike[str], text: str | None = None, most: int = LARGEST_FILE) -> None:
        self.document = document = SceneDocument(path, text, most)
        self.data = document.data
        document.check_keys(self.data, KEYS, "key of a scene")
        self.evaluated: Any = self.data.get("evaluate", True)
        if not isinstance(self.evaluated, bool):
            document.refuse(f"evaluate is {kind_of(self.evaluated)}: write true or false.", "evaluate")

    def statement(self) -> Statement:
        """Return the checked statement of the scene file."""
        document = self.document
        rotations = self.rotations()
        turning = {name_of(q): q for each in rotations for q in each.quaternion}
        names = dict.fromkeys((*self.coordinate_names(turning), *turning))
        coordinates = {name: turning.get(name) or coordinate_of(name) for name in names}
        velocities = {f"{name}_dot": velocity_of(q) for name, q in coordinates.items()}
        values = self.parameters(coordinates)
        symbols = self.symbols(values)
        given_names = self.given(coordinates, symbols)
        speed = {impact_speed.name: impact_speed} if "contacts" in self.data else {}
        runs = {along.name: along} if "surfaces" in self.data else {}
        turned = shorthands(each.name for each in rotations)
        names = {**turned, **speed, **runs, **given_names, **coordinates, **velocities, **symbols}
        reader = self.reader(names, given_names)
        forces = self.forces(reader, coordinates, rotations)
        known = [*coordinates, *velocities, *(name_of(rate) for each in rotations for rate in each.body)]
        initial = document.table("initial", known, "coordinate or velocity of this scene")
        stated = {key: document.expression(reader, key) for key in ENERGIES if key in self.data}
        dissipation = document.expression(reader, "dissipation") if "dissipation" in self.data else sympy.S.Zero
        with document.located():
            declared = declare(
                **stated,
                coordinates=list(coordinates.values()),
                forces=forces,
                dissipation=dissipation,
                constraints=self.constraints(reader),
                redundant=self.data.get("redundant", REFUSE),
                parameters={symbols[name]: value for name, value in values.items()},
                initial={name: document.number("initial", name) for name in initial},
                positions=self.positions(reader, rotations),
                links=self.data.get("links", []),
                name=self.title(),
                about=document.words("about"),
                source=document.words("source"),
                run=self.run(),
                dimensions=self.dimensions(names),
                contacts=self.contacts(reader),
                simultaneous=self.data.get("simultaneous"),
                surfaces={name: document.expressions(reader, "surfaces", name) for name in document.table("surfaces")},
                suffix="_dot" if self.evaluated else "",
            )
        if "events" not in self.data:
            return declared
        return replace(declared, run=replace(declared.run, events=self.events(reader, declared)))

    def forces(
        self, reader: Expressions, coordinates: Mapping[str, Any], rotations: Sequence[Rotation]
    ) -> dict[Any, Any]:
        """Return {coordinate: force}, and torques about the axes of bodies by their names, such as R_body_x."""
        known = [*coordinates, *(name_of(rate) for each in rotations for rate in each.body)]
        stated = self.document.table("forces", known, "coordinate of this scene")
        return {coordinates.get(name, name): self.document.expression(reader, "forces", name) for name in stated}

    def events(self, reader: Expressions, declared: Statement) -> tuple[Event, ...]:
        """Return the events of the scene, from the list of tables [[events]].

        An event is a zero of `when`; other keys are optional. The events are checked against the statement `declared`.
        """
        tables = self.data["events"]
        if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
            self.document.refuse('events is not a list of tables: write [[events]] and when = "y" below it.', "events")
        for q, name in zip(declared.coordinates, declared.names, strict=True):
            reader.enter(f"{name}_ddot", acceleration_of(q))
        stated = [self.event(reader, i, table) for i, table in enumerate(tables)]
        with self.document.located("events"):
            return declare_events(stated, declared)

    def event(self, reader: Expressions, i: int, table: Mapping[str, Any]) -> Event:
        """Return the event in `table`, the entry with index i of [[events]]."""
        path = ("events", i)
        self.document.check_keys(table, EVENT_KEYS, "key of an event", *path)
        reset = table.get("reset", {})
        if "when" not in table or not isinstance(reset, Mapping):
            wrong = "reset is not a table of names and new values" if "when" in table else "an event has no key `when`"
            self.document.refuse(f'{wrong}: write when = "y" and, if need be, reset = {{ y_dot = "-y_dot" }}.', *path)
        when = self.document.equation(reader, *path, "when")
        direction = self.document.number(*path, "direction") if "direction" in table else 0
        values = {name: self.document.expression(reader, *path, "reset", name) for name in reset}
        with self.document.located(*path):
            return event(when, direction=direction, terminal=table.get("terminal", False), reset=values)

    def title(self) -> str:
        """Return the name of the scene. The default is the name of its file."""
        name = self.document.text("name") if "name" in self.data else Path(self.document.file).stem
        if "name" in self.data and not self.evaluated:
            return printable(name, "name")  # A system of Python may have any name
        if not (_TITLE.fullmatch(name) and name.isprintable()):
            if "name" not in self.data:
                return "scene"
            self.document.refuse(
                "a scene's name must have 1 to 64 printable characters, with a letter or digit, no dot at its start, "
                "and no space at its ends.",
                "name",
            )
        return name

    def coordinate_names(self, turning: Collection[str]) -> list[str]:
        """Return the names of the coordinates in the file, which need not contain quaternion entries of rotations.

        `turning` are the names of these entries.
        """
        names = self.names("coordinates", "theta")
        if not (names or turning):
            self.document.refuse('there are no coordinates: write coordinates = ["theta"].', "coordinates")
        known: list[str] = []
        for i, name in enumerate(names):
            self.check_free(name, "coordinate", known, "coordinates", i)
            known.append(name)
        return known

    def names(self, key: str, example: str) -> list[str]:
        """Return the list of names at a key of the scene, or [] without the key. `example` is a name for messages."""
        names = self.data.get(key, [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            self.document.refuse(f'{key} must be a list of names: write {key} = ["{example}"].', key)
        return names

    def rotations(self) -> list[Rotation]:
        """Return the rotations that the scene names. The entries of their quaternions are coordinates."""
        names = self.names("rotations", "R")
        if repeated := [name for name in names if names.count(name) > 1]:
            self.document.refuse(f"rotations names {repeated[0]!r} twice: name each rotation once.", "rotations")
        with self.document.located("rotations"):
            return [rotation_of(check_name(name, "rotation")) for name in names]

    def parameters(self, coordinates: Mapping[str, Any]) -> dict[str, float | None]:
        """Return {name: value} of the parameters. The value is None for the text "open"."""
        values: dict[str, float | None] = {}
        for name in self.document.table("parameters"):
            self.check_free(name, "parameter", coordinates, "parameters", name)
            is_open = self.document.value("parameters", name) == OPEN
            values[name] = None if is_open else self.document.number("parameters", name)
        return values

    def symbols(self, names: Collection[str]) -> dict[str, Any]:
        """Return {name: symbol} of the parameters, with the assumptions in [signs]. Other parameters are real."""
        signs = self.document.table("signs", names, "parameter of this scene")
        return {name: self.symbol(name) if name in signs else sympy.Symbol(name, real=True) for name in names}

    def symbol(self, name: str) -> Any:
        """Return a parameter with the assumptions of its text in [signs], such as "positive" or "not zero integer"."""
        words = self.document.text("signs", name).replace("not ", "not_").split()
        assumed = {word.removeprefix("not_"): not word.startswith("not_") for word in words if word != NO_SIGN}
        unknown = [word for word in assumed if word not in _assume_defined]
        reason = (
            f"the sign of {name} is {shown(self.document.text('signs', name), 60)}: write positive, nonnegative, real, "
            f"or {NO_SIGN} for a symbol about which nothing is assumed."
        )
        if unknown or not words:
            self.document.refuse(reason, "signs", name)
        try:
            return sympy.Symbol(name, **assumed)
        except InconsistentAssumptions:
            self.document.refuse(reason, "signs", name)

    def reader(self, names: Mapping[str, Any], given_names: Mapping[str, Any]) -> Expressions:
        """Return the reader of the scene's expressions, which also knows the tables and definitions of the file.

        `names` maps identifiers to SymPy objects, and `given_names` those of given functions of time.
        """
        functions = self.names("functions", "U")
        for i, name in enumerate(functions):
            self.check_free(name, "function", names, "functions", i)
        reader: Expressions = (
            Expressions(names, (MULTIPLIER, *functions))
            if self.evaluated
            else UnevaluatedExpressions(names, given_names.values(), functions)
        )
        for name in self.document.table("tables"):
            self.check_free(name, "table", reader.names, "tables", name)
            reader.enter(name, self.measured(reader, name))
        for name in self.document.table("definitions"):
            self.check_free(name, "definition", reader.names, "definitions", name)
            self.document.define(reader, "definitions", name)
        return reader

    def measured(self, reader: Expressions, name: str) -> Any:
        """Return the table `name` of measured values as a SymPy expression, a cubic spline in its argument."""
        entry = self.document.value("tables", name)
        if not isinstance(entry, Mapping) or set(entry) != set(TABLE_KEYS):
            self.document.refuse(
                f'the table {name} is {kind_of(entry)}: write {{ argument = "x", points = [...], values = [...] }}.',
                *("tables", name),
            )
        with self.document.located("tables", name):
            return table(self.document.expression(reader, "tables", name, "argument"), entry["points"], entry["values"])

    def given(self, coordinates: Mapping[str, Any], symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Return {name: function} of the given functions of time and their derivatives, such as X and X_dot."""
        names: dict[str, Any] = {}
        reader: Expressions = (
            Expressions(symbols) if self.evaluated else UnevaluatedExpressions(symbols, (t, *symbols.values()))
        )
        for name, motion in self.document.table("given").items():
            self.check_free(name, "given function", coordinates, "given", name)
            if name in symbols:
                self.document.refuse(f"{name} is a parameter already: choose another name.", "given", name, key=True)
            values = motion
            if not isinstance(motion, list):
                values = None if motion == OPEN else self.document.expression(reader, "given", name)
            with self.document.located("given", name):
                function = given(name, values)
            names[name] = function
            names |= {rate_name(name, k): sympy.Derivative(function, (t, k)) for k in range(1, MOST_RATES + 1)}
        return names

    def check_free(self, name: str, what: str, coordinates: Any, *path: str | int) -> None:
        """Raise SceneError, located at a path, for a name that is malformed or taken.

        `coordinates` are the names that are taken. For each name x, x_dot and x_ddot are taken too. `what` is the kind
        of the named object in the message.
        """
        key = path[0] not in ("coordinates", "functions")
        with self.document.located(*path, key=key):
            check_symbol(name, what)
        taken = ""
        rates = [f"{name}_dot", f"{name}_ddot"] if what == "coordinate" else []
        base, _, rate = name.rpartition("_")
        if name in coordinates:
            taken = "a coordinate already" if path[0] in ("coordinates", "parameters", "given") else "taken already"
        elif (base in coordinates and rate in ("dot", "ddot")) or any(q in coordinates for q in rates):
            taken = "taken: x_dot and x_ddot are velocity and acceleration of x"
        if taken:
            self.document.refuse(
                f"{name!r} cannot name a {what}, because it is {taken}: choose another name.", *path, key=key
            )

    def constraints(self, reader: Expressions) -> dict[str, Any] | list[Any]:
        """Return the constraints, a list or a dict by name. An expression is zero; an equation has the sign ==."""
        stated = self.data.get("constraints", [])
        if isinstance(stated, list):
            return [self.document.equation(reader, "constraints", i) for i in range(len(stated))]
        names = self.document.table("constraints")
        return {name: self.document.equation(reader, "constraints", name) for name in names}

    def contacts(self, reader: Expressions) -> dict[str, Contact]:
        """Return the contacts by name, each from a table [contacts.name]."""
        contacts: dict[str, Contact] = {}
        for name, entries in self.document.table("contacts").items():
            path = "contacts", name
            if not isinstance(entries, Mapping) or "gap" not in entries:
                self.document.refuse(f'the contact {name[:80]} has no gap: write a table with gap = "y".', *path)
            self.document.check_keys(entries, CONTACT_KEYS, "key of a contact", *path)
            parts = {
                key: (self.document.one_or_more if key in ("slip", "friction") else self.document.expression)(
                    reader, *path, key
                )
                for key in entries
            }
            with self.document.located(*path):
                contacts[name] = contact(**parts)
        return contacts

    def dimensions(self, names: Mapping[str, Any]) -> dict[str, str] | None:
        """Return {name: dimension or unit as text}, or None without [dimensions]. `names` are all known symbols."""
        if "dimensions" not in self.data:
            return None
        known = ["t", *(name for name in names if names[name].is_Symbol or names[name].is_Function)]
        table = self.document.table("dimensions", known, "symbol of this scene")
        return {name: self.document.text("dimensions", name) for name in table}

    def positions(self, reader: Expressions, rotations: Sequence[Rotation]) -> dict[str, tuple[Any, ...] | Shape]:
        """Return the named points, tuples of two or three expressions, and the shapes of bodies, by name."""
        return {
            name: self.shape(reader, entries, rotations, "positions", name)
            if isinstance(entries, Mapping)
            else self.document.expressions(reader, "positions", name)
            for name, entries in self.document.table("positions").items()
        }

    def shape(self, reader: Expressions, table: Mapping[str, Any], rotations: Sequence[Rotation], *path: str) -> Shape:
        """Return the shape of a body in a table of [positions], such as { shape = "disc", size = "r", rotation = "R" }.

        Without `rotation` the body does not rotate, and without `at` its centre is at the origin. `path` is the path of
        the table.
        """
        self.document.check_keys(table, SHAPE_KEYS, "key of a shape", *path)
        if "shape" not in table or "size" not in table:
            self.document.refuse('a body to draw has no shape or no size: write shape = "disc" and size = "r".', *path)
        turned = {each.name: each for each in rotations}
        if table.get("rotation", None) not in (None, *turned):
            known = listing(turned) or "none"
            self.document.refuse(f"the rotation of a shape must be one of this scene: {known}.", *path, "rotation")
        with self.document.located(*path):
            return shape(
                self.document.text(*path, "shape"),
                turned.get(table.get("rotation", "")),
                self.document.one_or_more(reader, *path, "size"),
                self.document.one_or_more(reader, *path, "at") if "at" in table else (0, 0, 0),
            )

    def run(self) -> RunSettings:
        """Return the settings of a run in the table [run]."""
        table = self.document.table("run", RUN_KEYS, "setting of [run]")
        numbers = {key: self.document.number("run", key) for key in table if key != "method"}
        if numbers.get("t_end") == 0.0:
            self.document.refuse(
                "t_end is 0: give the time at which the run ends, other than the start.", "run", "t_end"
            )
        for key in ("rtol", "step"):
            if numbers.get(key, 1.0) <= 0.0:
                self.document.refuse(f"{key} is {numbers[key]:g}: give a number above zero.", "run", key)
        if numbers.get("atol", 0.0) < 0.0:
            self.document.refuse(f"atol is {numbers['atol']:g}: give zero or a number above.", "run", "atol")
        if "method" in table and not re.fullmatch(r"[\w.:+-]{1,64}", self.document.text("run", "method")):
            self.document.refuse("method is not a name of a method: write one such as 'dop853'.", "run", "method")
        return RunSettings(**{**table, **numbers})
