"""The library of scenes: their files, with names, descriptions and sources."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lagrange.statement.expression import one_of
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.scene.toml_document import Document
from lagrange.statement.statement import Statement

LIBRARY = Path(__file__).resolve().parents[2] / "scenes"


@dataclass(frozen=True)
class LibraryScene:
    """A scene of the library: its name, a description, its published source, and its file."""

    name: str
    about: str
    source: str
    path: Path


def load(name: str) -> Statement:
    """Return a scene of the library by its name, such as "double-pendulum"."""
    return read_scene(library_path(name))


def library_path(name: str) -> Path:
    """Return the file of a scene of the library."""
    files = {path.stem: path for path in LIBRARY.glob("*.toml")}
    return files[one_of(name, sorted(files), "the library has no scene {given}; it has {known}.")]


def library() -> list[LibraryScene]:
    """Return the scenes of the library, sorted by name."""
    scenes = [(path, Document(path)) for path in sorted(LIBRARY.glob("*.toml"))]
    return [LibraryScene(path.stem, scene.words("about"), scene.words("source"), path) for path, scene in scenes]
