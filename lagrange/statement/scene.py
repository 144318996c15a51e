"""Scene files: a TOML text becomes a `Statement`, and every refusal names file, line and column."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sympy

from lagrange.errors import SceneError, StatementError, listing, suggestion
from lagrange.statement.choice import one_of
from lagrange.statement.coordinate import check_name, check_symbol, coordinate_of, name_of, velocity_of
from lagrange.statement.declare import ORIGIN, declare
from lagrange.statement.document import Document, kind_of
from lagrange.statement.given import given
from lagrange.statement.inertia import first_order_remedy, without_velocity
from lagrange.statement.link import KINDS, Link
from lagrange.statement.statement import REDUNDANT, REFUSE, RunSettings, Statement

LIBRARY = Path(__file__).resolve().parents[1] / "scenes"

KEYS = (
    *("name", "about", "source", "coordinates", "kinetic", "potential", "lagrangian", "forces", "dissipation"),
    *("constraints", "redundant", "parameters", "given", "initial", "positions", "links", "run", "dimensions"),
)
RUN_KEYS = ("t_end", "method", "rtol", "atol", "step")

_TITLE = re.compile(r"(?=.*[^\W_])(?![.\s]).{0,63}\S")


@dataclass(frozen=True)
class LibraryScene:
    """A scene of the library: what it shows, where it was published, and its file."""

    name: str
    about: str
    source: str
    path: Path


def read_scene(path: str | os.PathLike[str]) -> Statement:
    """Return the statement in a scene file.

    A scene is data: reading it runs, imports and opens nothing. Raises SceneError with file, line and column.
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
    """Reads the fields of one document; each method refuses at the place of what it reads."""

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
        """Refuse a name that is malformed or means something else already."""
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
        """Refuse a coordinate whose velocity stands nowhere, at the energy that lacks it."""
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
        given = self.data.get("constraints", [])
        if isinstance(given, list):
            return [self.document.equation(names, "constraints", i) for i in range(len(given))]
        table = self.document.table("constraints")
        for name in table:
            try:
                check_name(name, "constraint")
            except StatementError as error:
                self.document.refuse(str(error), "constraints", name, key=True)
        return {name: self.document.equation(names, "constraints", name) for name in table}

    def redundant(self) -> str:
        """Return what is done with constraints that follow from others."""
        given: Any = self.data.get("redundant", REFUSE)
        if not isinstance(given, str) or given not in REDUNDANT:
            self.document.refuse(f"redundant is {kind_of(given)}: write one of {listing(REDUNDANT)}.", "redundant")
        return str(given)

    def dimensions(self, names: Mapping[str, Any]) -> dict[str, str] | None:
        """Return the dimensions or units by name, None where there are none."""
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
        """Return the pairs of points between which to draw, with what to draw."""
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
        """Return how the scene asks to be run."""
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
