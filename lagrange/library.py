"""The library of scenes: their names, and the system of each."""

from __future__ import annotations

from lagrange.show.notebook.shown_lists import SceneList
from lagrange.statement import scene as scene_files
from lagrange.system import System


def scene(name: str) -> System:
    """Return a system of the scene library; `lagrange.scenes()` lists the names.

    Raises StatementError for an unknown name, with the known ones.
    """
    return System.from_statement(scene_files.load(name))


def scenes() -> list[str]:
    """Return the names of the scene library."""
    entries = scene_files.library()
    return SceneList((entry.name for entry in entries), (entry.about for entry in entries))
