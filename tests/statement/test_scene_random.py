"""Scenes damaged at random: read, or refused with a place; never anything else."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from lagrange.errors import SceneError
from lagrange.statement.scene.library import LIBRARY
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.statement import Statement
from tests.covering import examples

TEXTS = [path.read_text("utf-8") for path in sorted(LIBRARY.glob("*.toml")) if path.stat().st_size < 2000]
PIECES = [
    "",
    " ",
    "\n",
    '"',
    "'",
    "[",
    "]",
    "{",
    "}",
    "=",
    "#",
    ".",
    ",",
    "\\",
    "1",
    "x",
    "t",
    "**",
    "(",
    ")",
    "é",
    "\x00",
    "[run]\n",
]


@settings(max_examples=examples(150))
@given(
    st.sampled_from(TEXTS),
    st.integers(0, 2000),
    st.integers(0, 12),
    st.one_of(st.sampled_from(PIECES), st.text(max_size=6).filter(lambda text: text.isprintable())),
)
def test_a_damaged_scene_is_read_or_refused(text: str, start: int, length: int, piece: str) -> None:
    start %= len(text)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text[:start] + piece + text[start + length :], encoding="utf-8")
        try:
            found: Statement | SceneError = read_scene(path)
        except SceneError as refused:
            found = refused
    if isinstance(found, SceneError):
        assert found.line is not None
        assert found.file == str(path)
        assert found.reason.endswith((".", "?"))
