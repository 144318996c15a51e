"""Files are written completely or not at all, and failures have messages."""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.export import contents as export_contents
from lagrange.page import player
from lagrange.page import web_page as page_write
from lagrange.show.files.atomic_file import cell, write_atomically, write_rows, write_together
from lagrange.trajectory.solution import Solution
from tests.systems import unit_pendulum


def hello(file: BinaryIO) -> None:
    file.write(b"hello")


def left_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize(
    ("code", "kind", "words"),
    [
        (errno.ENOSPC, RunError, "the disk is full. Nothing was written; free some space"),
        (errno.EDQUOT, RunError, "the disk quota is used up"),
        (errno.EFBIG, RunError, "it is too large. Nothing was written"),
        (errno.EIO, RunError, "Nothing was written"),
        (errno.EACCES, StatementError, "may not be written to. Name another folder."),
        (errno.EROFS, StatementError, "may not be written to. Name another folder."),
    ],
)
@pytest.mark.parametrize("where", ["fsync", "open", "replace"])
def test_the_system_s_refusals_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, kind: type[Exception], words: str, where: str
) -> None:
    (tmp_path / "a.txt").write_text("old")

    def refuse(*_: Any, **__: Any) -> Any:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os if where == "fsync" else Path, where, refuse)
    with pytest.raises(kind) as refusal:
        write_atomically(tmp_path / "a.txt", hello)
    monkeypatch.undo()
    assert f"Cannot write {tmp_path / 'a.txt'}: " in str(refusal.value) and words in str(refusal.value)
    assert (tmp_path / "a.txt").read_text() == "old" and left_in(tmp_path) == ["a.txt"]


def test_what_is_no_place_for_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path, words in (
        (tmp_path / "no" / "a.txt", f"there is no folder {tmp_path / 'no'}"),
        (tmp_path / "file" / "a.txt", f"there is no folder {tmp_path / 'file'}"),
        (tmp_path, "it is a folder"),
        (Path("/dev/null"), "it is a device or a pipe"),
    ):
        with pytest.raises(StatementError, match="Cannot write") as refusal:
            write_atomically(path, hello)
        assert words in str(refusal.value)
    with pytest.raises(RunError, match="name too long"):
        write_atomically(tmp_path / ("a" * 300), hello)
    assert Path("/dev/null").is_char_device()


def test_a_link_is_followed_and_permissions_are_kept(tmp_path: Path) -> None:
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "real.txt").chmod(0o640)
    (tmp_path / "link.txt").symlink_to("real.txt")
    assert write_atomically(tmp_path / "link.txt", hello) == tmp_path / "real.txt"
    assert (tmp_path / "link.txt").is_symlink() and (tmp_path / "real.txt").read_text() == "hello"
    assert (tmp_path / "real.txt").stat().st_mode & 0o777 == 0o640
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "new.txt", hello)
    finally:
        os.umask(before)
    assert (tmp_path / "new.txt").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1, "0.1"),
        (-2.5, "-2.5"),
        (np.float64(1e300), "1e+300"),
        (np.float32(0.5), "0.5"),
        (float("-inf"), "-inf"),
        (np.int64(-3), "-3"),
        (Fraction(-1, 2), "-0.5"),
        ("theta_dot", "theta_dot"),
        ("=1+1", "'=1+1"),
        (" =1", "' =1"),
        ("\t=1", "'\t=1"),
        ('a "b", c', '"a ""b"", c"'),
        ("a\nb", '"a\nb"'),
        ("=a,b", '"\'=a,b"'),
    ],
)
def test_cells(value: object, text: str) -> None:
    assert cell(value) == text


@given(st.lists(st.text(), min_size=1, max_size=3))
def test_any_text_survives_and_none_is_a_formula(texts: list[str]) -> None:
    line = ",".join(map(cell, texts)) + "\n"
    (read,) = list(csv.reader(io.StringIO(line, newline="")))
    assert [result.removeprefix("'") for result in read] == [text.removeprefix("'") for text in texts]
    assert not any(result.lstrip(" ").startswith(("=", "+", "-", "@", "\t", "\r")) for result in read)


def test_columns_have_one_length(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="zip"):
        write_atomically(tmp_path / "b.csv", lambda file: write_rows(file, ("i", "x"), (range(3), range(4))))
    assert left_in(tmp_path) == []


# --- A folder with the last file holds one whole set of files, whatever stops the writing, and wherever ---


posix = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")

OLD = {"a.csv": "old", "b.png": "old", "c.json": "old"}
NEW = {"a.csv": "new", "c.json": "new"}
MINE = {"mine.txt": "old"}


def text(words: str) -> Any:
    return lambda file: file.write(words.encode())


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in sorted(folder.iterdir())}


WAYS = ("kill", "full", "SIGINT")


@cache
def all_stopped(what: str) -> dict[str, list[dict[str, Any]]]:
    """Return the files that remain after each operation is stopped by some causes; see broken_writes.py."""
    program = Path(__file__).with_name("broken_writes.py")
    with TemporaryDirectory() as folder:
        command = [sys.executable, str(program), folder, what, *WAYS]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert "Traceback" not in done.stderr and done.returncode == 0, done.stderr
    result: dict[str, list[dict[str, Any]]] = json.loads(done.stdout)
    return result


def stopped(how: str, what: str) -> list[dict[str, Any]]:
    result = all_stopped(what)[how]
    assert len(result) > 4 and result[-1]["code"] == 0, "every operation is reached, and one run goes through"
    return result


def test_all_files_or_none_of_them(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("old")
    paths = write_together(tmp_path, {name: text("old") for name in OLD})
    assert paths == [tmp_path / name for name in OLD] and contents(tmp_path) == {**OLD, **MINE}
    paths = write_together(tmp_path, {"a.csv": text("new"), "b.png": None, "c.json": text("new")})
    assert paths == [tmp_path / "a.csv", tmp_path / "c.json"] and contents(tmp_path) == {**NEW, **MINE}


@pytest.mark.parametrize("failure", [ValueError("bad"), KeyboardInterrupt(), MemoryError(), RunError("no picture")])
def test_a_writer_that_fails_leaves_what_was_there(tmp_path: Path, failure: BaseException) -> None:
    write_together(tmp_path, {name: text("old") for name in OLD})

    def fails(file: BinaryIO) -> None:
        file.write(b"half")
        raise failure

    with pytest.raises(type(failure)):
        write_together(tmp_path, {"a.csv": text("new"), "b.png": fails, "c.json": text("new")})
    assert contents(tmp_path) == OLD


@posix
@pytest.mark.parametrize("how", WAYS)
def test_stopped_anywhere_a_folder_with_the_last_file_is_whole(how: str) -> None:
    partial = 0
    for result in stopped(how, "together"):
        seen = {name: words for name, words in result["left"].items() if not name.startswith(".")}
        hidden = sorted(result["left"].keys() - seen.keys())
        assert seen.pop("mine.txt") == "old" and set(seen.values()) <= {"old", "new"}, "every file is whole"
        assert "c.json" not in seen or seen in (OLD, NEW), "the last file is there only while all are"
        partial += "c.json" not in seen
        assert how == "kill" or not hidden, "only a killed process leaves its parts"
        assert result["then"] == {**NEW, **MINE}, "the next one who writes makes it whole"
    assert partial, "some stop falls into the exchange"


@posix
@pytest.mark.parametrize("how", WAYS)
def test_a_single_file_stopped_anywhere_is_whole(how: str) -> None:
    for result in stopped(how, "single"):
        assert result["left"]["a.csv"] in ("old", "new")
        assert how == "kill" or set(result["left"]) == {*OLD, *MINE}
        assert result["then"] == {**OLD, **MINE, "a.csv": "new"}


def test_what_is_no_place_for_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").mkdir()
    with pytest.raises(StatementError, match=r"a\.csv: it is a folder\. Name a file in it\."):
        write_together(tmp_path, {"a.csv": text("new"), "b.csv": text("new")})
    with pytest.raises(StatementError, match="there is no folder"):
        write_together(tmp_path / "no", {"a.csv": text("new")})
    with pytest.raises(StatementError, match=r"has control characters: give another name"):
        write_together(tmp_path / "a\0b", {"a.csv": text("new")})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]


# --- A place that cannot be written is refused before what shall stand there is made, which may take long ---


theta = lg.coordinate("theta")


def never(*_: Any, **__: Any) -> Any:
    raise AssertionError("it is made before the place was looked at")


@pytest.fixture
def lazy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every slow function fail."""
    for name in ("plot", "card"):
        monkeypatch.setattr(Solution, name, never)
    monkeypatch.setattr(player, "recording_of", never)
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


@pytest.mark.usefixtures("lazy")
def test_a_folder_that_may_not_be_written_to_is_refused_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(lg.StatementError, match="may not be written to"):
        WRITERS["html"](tmp_path)
