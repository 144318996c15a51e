"""Files of one run appear together or not at all, whatever stops the writing, and wherever."""

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
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.files.atomic_folder import ARRIVING, LEAVING, WRITING, recover, write_together
from tests.covering import waiting

posix = pytest.mark.skipif(os.name != "posix", reason="locks and signals are those of POSIX")

OLD = {"a.csv": "old", "b.png": "old", "c.json": "old"}
NEW = {"a.csv": "new", "c.json": "new"}
MINE = {"mine.txt": "old"}


def text(words: str) -> Any:
    return lambda file: file.write(words.encode())


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in sorted(folder.iterdir())}


TOGETHER = ("kill", "full", "dead", "SIGINT", "SIGTERM", "full+1", "full+2")
LATER = ("full+3", "full+4", "full+5", "full+6")
SINGLE = ("kill", "full", "SIGINT", "SIGTERM")


@cache
def all_stopped(what: str, ways: tuple[str, ...]) -> dict[str, list[dict[str, Any]]]:
    """Return what each operation leaves behind when it is stopped in some ways; see broken_writes.py."""
    program = Path(__file__).with_name("broken_writes.py")
    with TemporaryDirectory() as folder:
        command = [sys.executable, str(program), folder, what, *ways]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert "Traceback" not in done.stderr and done.returncode == 0, done.stderr
    found: dict[str, list[dict[str, Any]]] = json.loads(done.stdout)
    return found


def stopped(how: str, what: str, ways: tuple[str, ...]) -> list[dict[str, Any]]:
    found = all_stopped(what, ways)[how]
    assert len(found) > 5 and found[-1]["code"] == 0, "every operation is reached, and one run goes through"
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
@pytest.mark.parametrize("how", [*TOGETHER, *waiting(*LATER)])
def test_stopped_anywhere_it_is_one_run(how: str) -> None:
    for found in stopped(how, "together", TOGETHER if how in TOGETHER else LATER):
        seen = {name: words for name, words in found["left"].items() if not name.startswith(".")}
        hidden = sorted(found["left"].keys() - seen.keys())
        assert seen.pop("mine.txt") == "old"
        assert len(set(seen.values())) <= 1, "no file of one run stands beside a file of another"
        assert "c.json" not in seen or seen in (OLD, NEW), "the last file is there only while all are"
        if how in ("full", "SIGINT", "SIGTERM"):
            assert seen in (OLD, NEW)
        if how == "SIGINT":
            assert not hidden
        if how == "full":  # what it cannot remove at the end, the next one removes
            assert (seen, hidden) == (OLD, []) if found["code"] == 8 else seen == NEW
        assert found["then"] in ({**OLD, **MINE}, {**NEW, **MINE}), "the next one who writes sets it right"


@posix
@pytest.mark.parametrize("how", SINGLE)
def test_a_single_file_stopped_anywhere_is_whole(how: str) -> None:
    for found in stopped(how, "single", SINGLE):
        assert found["left"]["a.csv"] in ("old", "new")
        assert how == "kill" or how == "SIGTERM" or set(found["left"]) == {*OLD, *MINE}
        assert found["then"] == {**OLD, **MINE, "a.csv": "next"}, "nothing of a killed process is left"


LIMITED = """
import resource, sys
from lagrange.errors import RunError
from lagrange.show.files.atomic_folder import write_together
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
text = lambda size: lambda file: file.write(b"n" * size)
try:
    write_together(sys.argv[1], {"a.csv": text(9_000), "b.png": text(11_000), "c.json": text(10)})
except RunError as error:
    sys.stdout.write(str(error))
"""


def test_a_real_limit_of_the_system(tmp_path: Path) -> None:
    pytest.importorskip("resource")
    write_together(tmp_path, {name: text("old") for name in OLD})
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(tmp_path)], capture_output=True, text=True, check=True, timeout=300
    )
    assert done.stdout == (
        f"Cannot write {tmp_path / 'b.png'}: it is too large. Nothing was written; free some space or write elsewhere."
    )
    assert contents(tmp_path) == OLD


def test_what_cannot_be_put_back_is_said_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_together(tmp_path, {name: text("old") for name in OLD})
    replace, moves = Path.replace, []

    def breaks(self: Path, target: Path) -> Path:
        moves.append(target)
        if len(moves) > 2:
            raise OSError(5, "Input/output error")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", breaks)
    with pytest.raises(RunError, match="could not be put back and is in") as refusal:
        write_together(tmp_path, {name: text("new") for name in OLD})
    monkeypatch.undo()
    (kept,) = tmp_path.glob(".lagrange-*")
    assert str(kept) in str(refusal.value) and "puts it back or completes the change" in str(refusal.value)
    assert sorted(path.name for path in (kept / "old").iterdir()) == ["01-b.png", "02-c.json"]
    recover(tmp_path)
    assert contents(tmp_path) == OLD


@posix
def test_what_another_process_is_about_is_left_to_it(tmp_path: Path) -> None:
    inner: list[dict[str, bool]] = []

    def while_another_writes(file: BinaryIO) -> None:
        write_together(tmp_path, {"a.csv": text("other"), "c.json": text("other")})
        write_atomically(tmp_path / "d.txt", lambda _: write_atomically(tmp_path / "d.txt", text("other")))
        inner.append({path.name: path.is_dir() for path in tmp_path.iterdir()})
        file.write(b"new")

    write_together(tmp_path, {"a.csv": while_another_writes, "c.json": text("new")})
    assert [name.rpartition(".")[2] for name, folder in inner[0].items() if folder] == [WRITING]
    assert contents(tmp_path) == {**NEW, "d.txt": ""}


def test_the_states_in_which_a_process_may_be_killed(tmp_path: Path) -> None:
    if os.name != "posix":
        pytest.skip("without locks nothing tells whose folder it is")
    for state, part, expected in ((WRITING, "new", {}), (LEAVING, "old", {"a": "x"}), (ARRIVING, "new", {"a": "x"})):
        folder = tmp_path / state
        (folder / f".lagrange-00.{state}" / part).mkdir(parents=True)
        (folder / f".lagrange-00.{state}" / part / "00-a").write_text("x")
        (folder / f".lagrange-01.{state}").mkdir()
        recover(folder)
        assert contents(folder) == expected


def test_links_are_followed_and_permissions_are_kept(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "real.csv").write_text("old")
    (tmp_path / "real.csv").chmod(0o640)
    (tmp_path / "out" / "a.csv").symlink_to("../real.csv")
    assert write_together(tmp_path / "out", {"a.csv": text("new")}) == [tmp_path / "real.csv"]
    assert (tmp_path / "out" / "a.csv").is_symlink() and (tmp_path / "real.csv").read_text() == "new"
    assert (tmp_path / "real.csv").stat().st_mode & 0o777 == 0o640


def test_what_is_no_place_for_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").mkdir()
    with pytest.raises(StatementError, match=r"a\.csv: it is a folder\. Name a file in it\."):
        write_together(tmp_path, {"a.csv": text("new"), "b.csv": text("new")})
    with pytest.raises(StatementError, match="there is no folder"):
        write_together(tmp_path / "no", {"a.csv": text("new")})
    with pytest.raises(StatementError, match=r"embedded null byte\. Name another file\."):
        write_together(tmp_path / "a\0b", {"a.csv": text("new")})
    (tmp_path / "c.csv").symlink_to("b.csv")
    with pytest.raises(StatementError, match=r"b\.csv and c\.csv are links to one file, .*\. Remove the links\."):
        write_together(tmp_path, {"b.csv": text("new"), "c.csv": text("new")})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "c.csv"]


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="needs a second file system")
def test_a_link_to_another_file_system_is_refused(tmp_path: Path) -> None:
    elsewhere = Path("/dev/shm") / f"lagrange-{os.getpid()}.csv"
    if elsewhere.parent.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("it is the same file system")
    (tmp_path / "a.csv").symlink_to(elsewhere)
    with pytest.raises(StatementError, match=r"it is a link to another file system, /dev/shm/.*\. Remove the link"):
        write_together(tmp_path, {"a.csv": text("new")})
    assert not elsewhere.exists()
