"""Scene files: a TOML text becomes a Statement, and every refusal names file, line and column."""

from __future__ import annotations

import math
import os
import re
import stat
import sys
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any, NoReturn

import sympy

from lagrange.errors import SceneError, StatementError, listing, shown, suggestion
from lagrange.statement import places
from lagrange.statement.choice import one_of
from lagrange.statement.coordinate import check_name, check_symbol, coordinate_of, name_of, velocity_of
from lagrange.statement.declare import ORIGIN, declare
from lagrange.statement.energy import first_order_remedy, without_velocity
from lagrange.statement.given import given
from lagrange.statement.number import TOO_LARGE, real_number
from lagrange.statement.statement import KINDS, REDUNDANT, REFUSE, Link, RunSettings, Statement
from lagrange.statement.text import read_expression, read_number

LARGEST_FILE = 1_048_576
"""Largest size of a file, in bytes."""
MOST_DOTS = 20_000_000
"""Largest sum over the lines of (number of dots)**2. The time and memory of tomllib for keys such as a.a.a grow like
this sum."""
MOST_HEADERS = 5_000
"""Largest number of lines that start with a bracket; tomllib takes 30 us for each."""

_POSITION = re.compile(r"(?s)(.*) \(at (?:line (\d+), column (\d+)|end of document)\)")
_DECIMAL = re.compile(r"(?<![\w.])[+-]?[0-9][0-9_]*(?:\.[0-9_]+)?(?:[eE][+-]?[0-9_]+)?(?![\w.])")
_CONDITION = re.compile(r"\bif\b")
_INEQUALITY = re.compile(r"[<>]|!=")
_KINDS = (
    (bool, "true or false"),
    (str, "a text"),
    (int, "an integer"),
    (float, "a number"),
    (list, "a list"),
    (Mapping, "a table"),
)


class Document:
    """A TOML file as data. Raises SceneError for a file that cannot be read or is not TOML.

    `text` is the content of the file; None reads it from `path`.
    """

    def __init__(self, path: str | os.PathLike[str], text: str | None = None) -> None:
        if not isinstance(path, (str, os.PathLike)):
            raise SceneError(f"{shown(path)} ({type(path).__name__}) is no path: give the path of a scene file.")
        self.file = str(path)
        content = self._read(path) if text is None else text.encode()
        self.content = self._decode(self._within(content)).replace("\r\n", "\n")
        self.data = self._parse()

    def refuse(self, reason: str, *path: str | int, column: int | None = None, key: bool = False) -> NoReturn:
        """Raise a SceneError with line and column of the value at `path`, or of the nearest table around it.

        `key` points at the key instead; `column` points into the text of the value.
        """
        keys, values = self._places
        offset = 0
        for known in (path[:length] for length in range(len(path), 0, -1)):
            if known in keys or known in values:
                offset = keys.get(known, 0) if key or known not in values else values[known]
                break
        if column is not None and path in values:
            offset = places.inside(self.content, offset, column)
        line, place = places.line_and_column(self.content, offset)
        raise SceneError(reason, file=self.file, line=line, column=place)

    def check_keys(self, table: Mapping[str, Any], known: Collection[str], what: str, *path: str | int) -> None:
        """Raise SceneError for a key of the table at `path` that is not in `known`."""
        for name in table:
            if name not in known:
                self.refuse(
                    f"{name[:80]!r} is no {what}; there are {listing(known)}.{suggestion(name[:80], known)}",
                    *path,
                    name,
                    key=True,
                )

    def table(self, key: str, known: Collection[str] | None = None, what: str = "") -> Mapping[str, Any]:
        """Return a table of the file, empty if it is missing. Raises SceneError for a key that is not in `known`."""
        table = self.data.get(key, {})
        if not isinstance(table, Mapping):
            self.refuse(f"{key} is {kind_of(table)}: write a table [{key}] of names and values.", key)
        if known is not None:
            self.check_keys(table, known, what, key)
        return table

    def text(self, *path: str | int) -> str:
        """Return the text at a path. Raises SceneError for another type."""
        value = self.value(*path)
        if not isinstance(value, str):
            self.refuse(f"{path[-1]} is {kind_of(value)}: give a text in quotation marks.", *path)
        return value

    def words(self, key: str) -> str:
        """Return the text of a key on one line, empty if it is missing.

        Raises SceneError for control characters, which a terminal would act on.
        """
        text = " ".join(self.text(key).split()) if key in self.data else ""
        if not text.isprintable():
            self.refuse(f"{key} contains a control character: write plain text.", key)
        return text

    def number(self, *path: str | int) -> float:
        """Return the number at a path, or the value of a constant expression such as "pi/6"."""
        value, what = self.value(*path), _dotted(path)
        if not isinstance(value, (int, float, str)) or isinstance(value, bool):
            self.refuse(f'{what} is {kind_of(value)}: give a number, or a constant expression such as "pi/6".', *path)
        try:
            return read_number(value) if isinstance(value, str) else real_number(value, what)
        except SceneError as error:
            self.refuse(f"{what}: {error.reason}", *path, column=error.column)
        except StatementError as error:
            self.refuse(str(error), *path)

    def expression(self, names: Mapping[str, Any], *path: str | int) -> Any:
        """Return the text or number at a path as a SymPy expression; `names` maps names to symbols."""
        value, what = self.value(*path), _dotted(path)
        if not isinstance(value, (int, float, str)) or isinstance(value, bool):
            self.refuse(f'{what} is {kind_of(value)}: give an expression as a text, such as "2*x".', *path)
        if not isinstance(value, str):
            value = repr(self.number(*path))
        try:
            return read_expression(value, names)
        except SceneError as error:
            self.refuse(f"{what}: {error.reason}", *path, column=error.column)

    def equation(self, names: Mapping[str, Any], *path: str | int) -> Any:
        """Return the expression that is zero: the one at a path, or left minus right side of a text "left == right"."""
        value = self.value(*path)
        if not isinstance(value, str) or value.count("==") != 1 or _CONDITION.search(value):
            if isinstance(value, str) and _INEQUALITY.search(value) and not _CONDITION.search(value):
                self.refuse(
                    f"{_dotted(path)} is an inequality. Constraints are equations: state the one that holds, and end "
                    "the run by an event where the multiplier changes sign.",
                    *path,
                )
            return self.expression(names, *path)
        sides, begin = [], 0
        for side in value.split("=="):
            try:
                sides.append(read_expression(side, names))
            except SceneError as error:
                place = None if error.column is None else error.column + begin
                self.refuse(f"{_dotted(path)}: {error.reason}", *path, column=place)
            begin += len(side) + len("==")
        left, right = sides
        return left - right

    def value(self, *path: str | int) -> Any:
        """Return the value at an existing path."""
        value: Any = self.data
        for key in path:
            value = value[key]
        return value

    @cached_property
    def _places(self) -> tuple[dict[places.KeyPath, int], dict[places.KeyPath, int]]:
        return places.places(self.content)

    def _read(self, path: str | os.PathLike[str]) -> bytes:
        """Return the bytes of a regular file. Other kinds are refused: a pipe would block, a device may have no end."""
        data, mode = b"", 0
        try:
            mode = Path(path).stat().st_mode
            if stat.S_ISREG(mode):
                with Path(path).open("rb") as stream:
                    data = stream.read(LARGEST_FILE + 1)
        except FileNotFoundError:
            self._fail("there is no such file: check the path.")
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            self._fail(f"the file cannot be read ({reason}): check the path and its permissions.")
        if not stat.S_ISREG(mode):
            kind = "folder" if stat.S_ISDIR(mode) else "device or pipe"
            self._fail(f"this is a {kind}: give the path of a scene file.")
        return data

    def _within(self, data: bytes) -> bytes:
        if len(data) > LARGEST_FILE:
            self._fail(f"the file has more than {LARGEST_FILE} bytes, the most that a scene may have.")
        return data

    def _decode(self, data: bytes) -> str:
        try:
            return data.decode("utf-8").removeprefix("\ufeff")
        except UnicodeDecodeError as error:
            before = data[: error.start]
            line, column = before.count(b"\n") + 1, error.start - before.rfind(b"\n")
            self._fail(f"byte 0x{data[error.start]:02x} is not UTF-8: save the file as UTF-8.", line, column)

    def _parse(self) -> dict[str, Any]:
        lines = self.content.split("\n")
        if (
            sum(line.count(".") ** 2 for line in lines) > MOST_DOTS
            or sum(line.lstrip().startswith("[") for line in lines) > MOST_HEADERS
        ):
            self._fail(
                "the file has too many dots in its lines, or too many brackets before them: state it in fewer tables."
            )
        try:
            return tomllib.loads(self.content, parse_float=_double)
        except RecursionError:
            self._fail("the file is nested too deeply: a scene has tables in tables at most.")
        except tomllib.TOMLDecodeError as error:
            reason, line, column = _split(str(error), len(lines))
            self._fail(f"this is not TOML: {reason}.", line, column)
        except ValueError:
            # An integer has more digits than Python's limit, or `_double` refused a float.
            self._refuse_number()

    def _refuse_number(self) -> NoReturn:
        """Raise SceneError at the first number of the file that is out of the range of doubles.

        The file is valid TOML up to this number.
        """
        for path, offset in sorted(self._places[1].items(), key=itemgetter(1)):
            match = _DECIMAL.match(self.content, offset)
            if match and (reason := _out_of_range(match.group())):
                line, column = places.line_and_column(self.content, offset)
                self._fail(f"{_dotted(path)[:80]} is {reason}.", line, column)
        raise AssertionError("a number that the reader refuses stands in the file")

    def _fail(self, reason: str, line: int | None = None, column: int | None = None) -> NoReturn:
        raise SceneError(reason, file=self.file, line=line, column=column)


def kind_of(value: Any) -> str:
    """Return the type of a TOML value in words, such as "a list"."""
    return next((word for kind, word in _KINDS if isinstance(value, kind)), "a date or time")


def _dotted(path: tuple[str | int, ...]) -> str:
    """Return a path as it is written in TOML, with indices in brackets: positions.bob[0]."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)[1:]


def _double(text: str) -> float:
    """Return the double of a TOML float. Raises ValueError if it overflows to infinity or underflows to zero."""
    if _out_of_range(text):
        raise ValueError(text)
    return float(text)


def _out_of_range(text: str) -> str:
    """Return the words of a message if a decimal has no double, else "".

    Also for an integer with more digits than Python's limit, which tomllib cannot read.
    """
    digits = sum(map(str.isdigit, text))
    shown = text if len(text) <= 20 else f"a number of {digits} digits"
    if text.lstrip("+-").replace("_", "").isdigit():
        limit = sys.get_int_max_str_digits()
        return f"{shown}, {TOO_LARGE}" if 0 < limit < digits else ""
    value = float(text)
    if math.isinf(value) and digits:
        return f"{shown}, {TOO_LARGE}"
    if value == 0.0 and text.lower().partition("e")[0].strip("+-0._"):
        return f"{shown}, too small for a floating-point number: give one above 4.9e-324, or 0"
    return ""


def _split(message: str, last: int) -> tuple[str, int | None, int | None]:
    match = _POSITION.fullmatch(message)
    if match is None:
        return message.rstrip("."), None, None
    line, column = match.group(2), match.group(3)
    return match.group(1), int(line) if line else last, int(column) if column else None


LIBRARY = Path(__file__).resolve().parents[1] / "scenes"

KEYS = (
    *("name", "about", "source", "coordinates", "kinetic", "potential", "lagrangian", "forces", "dissipation"),
    *("constraints", "redundant", "parameters", "given", "initial", "positions", "links", "run", "dimensions"),
)
RUN_KEYS = ("t_end", "method", "rtol", "atol", "step")

_TITLE = re.compile(r"(?=.*[^\W_])(?![.\s]).{0,63}\S")


@dataclass(frozen=True)
class LibraryScene:
    """A scene of the library: its name, a description, its published source, and its file."""

    name: str
    about: str
    source: str
    path: Path


def read_scene(path: str | os.PathLike[str]) -> Statement:
    """Return the statement in a scene file.

    A scene is data: reading it runs no code, imports nothing, and opens no other file.
    Raises SceneError with file, line and column.
    """
    return _Scene(Document(path)).statement()


def scene_from_text(text: str) -> Statement:
    """Return the statement in the text of a scene file. Raises SceneError with line and column."""
    return _Scene(Document("", text)).statement()


def load(name: str) -> Statement:
    """Return a scene of the library by its name, such as "double-pendulum"."""
    return read_scene(library_path(name))


def library_path(name: str) -> Path:
    """Return the file of a scene of the library."""
    files = {path.stem: path for path in LIBRARY.glob("*.toml")}
    return files[one_of(name, sorted(files), "the library has no scene {given}; it has {known}.")]


def library() -> list[LibraryScene]:
    """Return the scenes of the library, by name."""
    scenes = [_Scene(Document(path)) for path in sorted(LIBRARY.glob("*.toml"))]
    return [
        LibraryScene(
            scene.title(), scene.document.words("about"), scene.document.words("source"), Path(scene.document.file)
        )
        for scene in scenes
    ]


class _Scene:
    """Reads the fields of one document. Each method raises SceneError with line and column of its field."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.data = document.data
        document.check_keys(self.data, KEYS, "key of a scene")

    def statement(self) -> Statement:
        """Return the checked statement."""
        document = self.document
        coordinates = {name: coordinate_of(name) for name in self.coordinate_names()}
        velocities = {f"{name}_dot": velocity_of(q) for name, q in coordinates.items()}
        values = self.parameters(coordinates)
        symbols = {name: sympy.Symbol(name, real=True) for name in values}
        names = {**coordinates, **velocities, **symbols, **self.given(coordinates, symbols)}
        forces = document.table("forces", coordinates, "coordinate of this scene")
        initial = document.table("initial", [*coordinates, *velocities], "coordinate or velocity of this scene")
        stated = self.energies(names)
        applied = {coordinates[name]: document.expression(names, "forces", name) for name in forces}
        dissipation = document.expression(names, "dissipation") if "dissipation" in self.data else sympy.S.Zero
        self.check_velocities(coordinates, stated, applied, dissipation)
        try:
            return declare(
                **stated,
                coordinates=list(coordinates.values()),
                forces=applied,
                dissipation=dissipation,
                constraints=self.constraints(names),
                redundant=self.redundant(),
                parameters={symbols[name]: value for name, value in values.items()},
                initial={name: document.number("initial", name) for name in initial},
                positions=self.positions(names),
                links=self.links(),
                name=self.title(),
                about=document.words("about"),
                source=document.words("source"),
                run=self.run(),
                dimensions=self.dimensions(names),
            )
        except SceneError:
            raise
        except StatementError as error:
            raise SceneError(str(error), file=document.file) from None

    def title(self) -> str:
        """Return the name of the scene, by default that of its file."""
        name = self.document.text("name") if "name" in self.data else Path(self.document.file).stem
        if not (_TITLE.fullmatch(name) and name.isprintable()):
            if "name" not in self.data:
                return "scene"
            self.document.refuse(
                "a scene's name has 1 to 64 printable characters, with a letter or digit, no dot at its beginning, "
                "and no space at its ends.",
                "name",
            )
        return name

    def coordinate_names(self) -> list[str]:
        """Return the names of the coordinates."""
        names = self.data.get("coordinates")
        if not isinstance(names, list) or not names:
            self.document.refuse(
                'coordinates is missing or is no list of names: write coordinates = ["theta"].', "coordinates"
            )
        known: list[str] = []
        for i, name in enumerate(names):
            if not isinstance(name, str):
                self.document.refuse(f"a coordinate is {kind_of(name)}: give its name as a text.", "coordinates", i)
            self.check_free(name, "coordinate", known, "coordinates", i)
            known.append(name)
        return known

    def parameters(self, coordinates: Mapping[str, Any]) -> dict[str, float]:
        """Return the values of the parameters."""
        values: dict[str, float] = {}
        for name in self.document.table("parameters"):
            self.check_free(name, "parameter", coordinates, "parameters", name)
            values[name] = self.document.number("parameters", name)
        return values

    def given(self, coordinates: Mapping[str, Any], symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Return the given functions of time and their first two derivatives, by name."""
        names: dict[str, Any] = {}
        for name, motion in self.document.table("given").items():
            self.check_free(name, "given function", coordinates, "given", name)
            if name in symbols:
                self.document.refuse(f"{name} is a parameter already: choose another name.", "given", name, key=True)
            values = motion if isinstance(motion, list) else self.document.expression(symbols, "given", name)
            try:
                function = given(name, values)
            except StatementError as error:
                self.document.refuse(str(error), "given", name)
            names |= {name: function, f"{name}_dot": function.dot, f"{name}_ddot": function.ddot}
        return names

    def check_free(self, name: str, what: str, coordinates: Any, *path: str | int) -> None:
        """Raise SceneError for a name that is malformed, or that has a meaning already."""
        key = path[0] != "coordinates"
        try:
            check_symbol(name, what)
        except StatementError as error:
            self.document.refuse(str(error), *path, key=key)
        taken = ""
        if name in coordinates:
            taken = "a coordinate already"
        elif any(name == f"{q}{rate}" or q == f"{name}{rate}" for q in coordinates for rate in ("_dot", "_ddot")):
            taken = "taken: x_dot and x_ddot are velocity and acceleration of x"
        if taken:
            self.document.refuse(f"{name!r} cannot name a {what}, it is {taken}: choose another name.", *path, key=key)

    def energies(self, names: Mapping[str, Any]) -> dict[str, Any]:
        """Return kinetic and potential energy, or the Lagrangian."""
        main = "lagrangian" if "lagrangian" in self.data else "kinetic"
        if main == "lagrangian" and (other := next((key for key in ("kinetic", "potential") if key in self.data), "")):
            self.document.refuse(
                f"give either lagrangian, or kinetic and potential, not lagrangian and {other}.", other, key=True
            )
        if main not in self.data:
            self.document.refuse(
                'there is no energy: write kinetic = "..." and potential = "...", or lagrangian = "...".'
            )
        return {key: self.document.expression(names, key) for key in (main, "potential") if key in self.data}

    def check_velocities(
        self, coordinates: Mapping[str, Any], energies: Mapping[str, Any], forces: Mapping[Any, Any], dissipation: Any
    ) -> None:
        """Raise SceneError, at the energy, for a coordinate whose acceleration no equation determines."""
        if "constraints" in self.data:
            return
        main, *_ = energies
        whole, present = energies[main] - energies.get("potential", 0), energies[main].atoms(sympy.Derivative)
        chosen, alone = tuple(coordinates.values()), main == "lagrangian"
        still = without_velocity(chosen, present, (), energies[main], whole, forces, dissipation, alone=alone)
        if still is not None:
            name = name_of(still)
            self.document.refuse(
                f"{main} does not contain {name}_dot, so {name} has no inertia and its acceleration is undefined: add "
                f"its kinetic energy, or make {name} a parameter. {first_order_remedy(f'{name}_dot')}",
                main,
            )

    def constraints(self, names: Mapping[str, Any]) -> dict[str, Any] | list[Any]:
        """Return the constraints: a list of expressions that are zero, or of equations with ==, or a table by name."""
        stated = self.data.get("constraints", [])
        if isinstance(stated, list):
            return [self.document.equation(names, "constraints", i) for i in range(len(stated))]
        table = self.document.table("constraints")
        for name in table:
            try:
                check_name(name, "constraint")
            except StatementError as error:
                self.document.refuse(str(error), "constraints", name, key=True)
        return {name: self.document.equation(names, "constraints", name) for name in table}

    def redundant(self) -> str:
        """Return the treatment of constraints that follow from others: one of `REDUNDANT`."""
        choice: Any = self.data.get("redundant", REFUSE)
        if not isinstance(choice, str) or choice not in REDUNDANT:
            self.document.refuse(f"redundant is {kind_of(choice)}: write one of {listing(REDUNDANT)}.", "redundant")
        return str(choice)

    def dimensions(self, names: Mapping[str, Any]) -> dict[str, str] | None:
        """Return the dimensions or units by name, None if the scene states none."""
        if "dimensions" not in self.data:
            return None
        known = ["t", *(name for name in names if names[name].is_Symbol or names[name].is_Function)]
        table = self.document.table("dimensions", known, "symbol of this scene")
        return {name: self.document.text("dimensions", name) for name in table}

    def positions(self, names: Mapping[str, Any]) -> dict[str, tuple[Any, ...]]:
        """Return the named points, two or three expressions each."""
        points: dict[str, tuple[Any, ...]] = {}
        table = self.document.table("positions")
        for name, entries in table.items():
            try:
                check_name(name, "point")
            except StatementError as error:
                self.document.refuse(str(error), "positions", name, key=True)
            if name == ORIGIN:
                self.document.refuse(
                    "'origin' is the point at zero already: choose another name.", "positions", name, key=True
                )
            if not isinstance(entries, list) or len(entries) not in (2, 3):
                self.document.refuse(
                    f"the position of {name} is a list of two or three expressions, such as ['x', 'y'].",
                    "positions",
                    name,
                )
            if points and len(entries) != len(next(iter(points.values()))):
                self.document.refuse(
                    "some positions have two entries and some three: give all of them as many.", "positions", name
                )
            points[name] = tuple(self.document.expression(names, "positions", name, i) for i in range(len(entries)))
        return points

    def links(self) -> list[Link]:
        """Return the links: pairs of points, each drawn as a rod or as a spring."""
        known = [ORIGIN, *self.document.table("positions")]
        links = self.data.get("links", [])
        if not isinstance(links, list):
            self.document.refuse(
                f'links is {kind_of(links)}: write a list of pairs of points, such as [["origin", "bob"]].', "links"
            )
        for i, link in enumerate(links):
            if not isinstance(link, list) or len(link) not in (2, 3):
                self.document.refuse(
                    'a link is a pair of points, such as ["origin", "bob"] or ["origin", "bob", "spring"].', "links", i
                )
            for j, word in enumerate(link):
                allowed, what = (known, "position") if j < 2 else (KINDS, "kind of link")
                if word not in allowed:
                    shown = repr(word[:80]) if isinstance(word, str) else kind_of(word)
                    hint = suggestion(word[:80], allowed) if isinstance(word, str) else ""
                    self.document.refuse(
                        f"links names {shown}, which is no {what}; they are {listing(allowed)}.{hint}", "links", i, j
                    )
        return [Link(*link) for link in links]

    def run(self) -> RunSettings:
        """Return the settings of a run from the table [run]."""
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
            self.document.refuse("method is no name of a method: write one such as 'dop853'.", "run", "method")
        return RunSettings(**{**table, **numbers})
