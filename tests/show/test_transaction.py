"""A folder with the last file holds one whole set of files, whatever stops the writing, and wherever."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import pytest

from lagrange.errors import RunError, StatementError
from lagrange.show.files.atomic_file import write_together

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
    """Return what each operation leaves behind when it is stopped in some ways; see broken_writes.py."""
    program = Path(__file__).with_name("broken_writes.py")
    with TemporaryDirectory() as folder:
        command = [sys.executable, str(program), folder, what, *WAYS]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert "Traceback" not in done.stderr and done.returncode == 0, done.stderr
    found: dict[str, list[dict[str, Any]]] = json.loads(done.stdout)
    return found


def stopped(how: str, what: str) -> list[dict[str, Any]]:
    found = all_stopped(what)[how]
    assert len(found) > 4 and found[-1]["code"] == 0, "every operation is reached, and one run goes through"
    return found


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
    for found in stopped(how, "together"):
        seen = {name: words for name, words in found["left"].items() if not name.startswith(".")}
        hidden = sorted(found["left"].keys() - seen.keys())
        assert seen.pop("mine.txt") == "old" and set(seen.values()) <= {"old", "new"}, "every file is whole"
        assert "c.json" not in seen or seen in (OLD, NEW), "the last file is there only while all are"
        partial += "c.json" not in seen
        assert how == "kill" or not hidden, "only a killed process leaves its parts"
        assert found["then"] == {**NEW, **MINE}, "the next one who writes makes it whole"
    assert partial, "some stop falls into the exchange"


@posix
@pytest.mark.parametrize("how", WAYS)
def test_a_single_file_stopped_anywhere_is_whole(how: str) -> None:
    for found in stopped(how, "single"):
        assert found["left"]["a.csv"] in ("old", "new")
        assert how == "kill" or set(found["left"]) == {*OLD, *MINE}
        assert found["then"] == {**OLD, **MINE, "a.csv": "new"}


def test_what_is_no_place_for_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").mkdir()
    with pytest.raises(StatementError, match=r"a\.csv: it is a folder\. Name a file in it\."):
        write_together(tmp_path, {"a.csv": text("new"), "b.csv": text("new")})
    with pytest.raises(StatementError, match="there is no folder"):
        write_together(tmp_path / "no", {"a.csv": text("new")})
    with pytest.raises(StatementError, match=r"has control characters: give another name"):
        write_together(tmp_path / "a\0b", {"a.csv": text("new")})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]
