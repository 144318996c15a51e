"""Scenes of the library that comes with the package: find them by name, list them, and load one as a Statement."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from lagrange.errors import StatementError, shown, suggestion
from lagrange.statement.expression import one_of
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.scene.toml_document import Document
from lagrange.statement.statement import Statement

LIBRARY = Path(__file__).resolve().parents[2] / "scenes"
LONGEST_FILE_NAME = 255  # Length in bytes of names that are too long for a file of the operating system


@dataclass(frozen=True)
class LibraryScene:
    """Scene of the library: its name, description `about`, published `source`, and the path of its file."""

    name: str
    about: str
    source: str
    path: Path


def load(name: str) -> Statement:
    """Return the statement of a scene of the library, by its name, such as "double-pendulum"."""
    return read_scene(library_path(name))


def library_path(name: str) -> Path:
    """Return the file of a scene of the library. Raises StatementError for unknown names and for paths of files."""
    files = {path.stem: path for path in LIBRARY.glob("*.toml")}
    text = os.fspath(name) if isinstance(name, (str, Path)) else ""
    is_short = len(text.encode(errors="replace")) < LONGEST_FILE_NAME
    is_path = text.endswith(".toml") or "/" in text or os.sep in text
    if is_path or (text not in files and is_short and Path(text).is_file()):
        raise StatementError(
            f"the library has no scene {shown(text)}: read a file with lg.System.from_scene({shown(text)}), or give "
            f"the name of a scene, such as 'pendulum'.{suggestion(text.removesuffix('.toml'), sorted(files))}"
        )
    return files[one_of(name, sorted(files), "the library has no scene {given}; it has {known}.")]


def library() -> list[LibraryScene]:
    """Return the scenes of the library, sorted by name."""
    scenes = [(path, Document(path)) for path in sorted(LIBRARY.glob("*.toml"))]
    return [LibraryScene(path.stem, scene.words("about"), scene.words("source"), path) for path, scene in scenes]
