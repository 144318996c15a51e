"""A place that cannot be written is refused before what shall stand there is made, which may take long."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import lagrange as lg
from lagrange.cli.program import main
from lagrange.export import contents as export_contents
from lagrange.page import animation
from lagrange.page import web_page as page_write
from lagrange.trajectory.solution import Solution
from tests.systems import unit_pendulum

theta = lg.coordinate("theta")


def never(*_: Any, **__: Any) -> Any:
    raise AssertionError("it is made before the place was looked at")


@pytest.fixture
def lazy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let everything that takes long fail."""
    for name in ("plot", "card"):
        monkeypatch.setattr(Solution, name, never)
    monkeypatch.setattr(animation, "recording_of", never)
    monkeypatch.setattr(page_write, "page_of", never)
    monkeypatch.setattr(export_contents, "module_of", never)


WRITERS: dict[str, Callable[[Path], Any]] = {
    "png": lambda place: unit_pendulum().run(1.0).to_png(place / "a.png"),
    "npz": lambda place: unit_pendulum().run(1.0).to_npz(place / "a.npz"),
    "folder": lambda place: unit_pendulum().run(1.0).to_folder(place),
    "html": lambda place: unit_pendulum().run(1.0).animate(place / "a.html"),
    "gif": lambda place: unit_pendulum().run(1.0).animate(place / "a.gif"),
    "page": lambda place: unit_pendulum().to_page(place / "a.html"),
    "scene": lambda place: unit_pendulum().to_scene(place / "a.toml"),
}


@pytest.mark.usefixtures("lazy")
@pytest.mark.parametrize("kind", WRITERS)
def test_a_missing_folder_is_refused_first(kind: str, tmp_path: Path) -> None:
    with pytest.raises(lg.StatementError, match="there is no folder"):
        WRITERS[kind](tmp_path / "missing")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("lazy")
def test_a_folder_that_cannot_be_made_is_refused_first(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(lg.StatementError, match="cannot be made"):
        unit_pendulum().export("python", tmp_path / "file" / "out")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="everybody may write everywhere")
@pytest.mark.usefixtures("lazy")
@pytest.mark.parametrize("kind", WRITERS)
def test_a_folder_that_may_not_be_written_to_is_refused_first(kind: str, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(lg.StatementError, match="may not be written to"):
            WRITERS[kind](tmp_path)
    finally:
        tmp_path.chmod(0o700)


def test_the_picture_of_an_ensemble_needs_its_folder_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(lg, "ensemble", never)
    out = str(tmp_path / "missing" / "a.png")
    assert main(["ensemble", "pendulum", "--vary", "theta=0:1:2", "--out", out]) == 2
    assert "there is no folder" in capsys.readouterr().err
