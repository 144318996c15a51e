"""Files are written whole or not at all, and every failure is said in words."""

from __future__ import annotations

import csv
import errno
import io
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagrange.errors import RunError, StatementError
from lagrange.show.files.atomic_file import cell, write_atomically, write_rows


def hello(file: BinaryIO) -> None:
    file.write(b"hello")


def left_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_file_is_there_and_nothing_else(tmp_path: Path) -> None:
    assert write_atomically(tmp_path / "a.txt", hello) == tmp_path / "a.txt"
    assert (tmp_path / "a.txt").read_bytes() == b"hello" and left_in(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("failure", [ValueError("bad"), KeyboardInterrupt(), MemoryError()])
def test_a_failure_half_way_leaves_the_old_file(tmp_path: Path, failure: BaseException) -> None:
    (tmp_path / "a.txt").write_text("old")

    def half(file: BinaryIO) -> None:
        file.write(b"new")
        raise failure

    with pytest.raises(type(failure)):
        write_atomically(tmp_path / "a.txt", half)
    assert (tmp_path / "a.txt").read_text() == "old" and left_in(tmp_path) == ["a.txt"]


@pytest.mark.parametrize(
    ("code", "kind", "words"),
    [
        (errno.ENOSPC, RunError, "the disk is full. Nothing was written; free some space"),
        (errno.EDQUOT, RunError, "the disk quota is used up"),
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


FULL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
from lagrange.errors import RunError
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.files.atomic_file import write_rows
try:
    write_atomically(sys.argv[1], lambda file: write_rows(file, ["t"], [range(100_000)]))
except RunError as error:
    sys.stdout.write(str(error))
"""


def test_a_real_limit_of_the_system(tmp_path: Path) -> None:
    pytest.importorskip("resource")
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "a.csv")], capture_output=True, text=True, check=True, timeout=300
    )
    assert "it is too large. Nothing was written" in done.stdout and left_in(tmp_path) == []


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
        ("+1", "'+1"),
        ("-1", "'-1"),
        ("@SUM(A1)", "'@SUM(A1)"),
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
    assert [found.removeprefix("'") for found in read] == [text.removeprefix("'") for text in texts]
    assert not any(found.lstrip(" ").startswith(("=", "+", "-", "@", "\t", "\r")) for found in read)


@given(st.lists(st.floats(allow_nan=False), min_size=1))
def test_numbers_round_trip(values: list[float]) -> None:
    assert [float(cell(value)) for value in values] == values


def test_many_rows_and_columns_of_one_length(tmp_path: Path) -> None:
    columns = (range(10_000), np.linspace(0, 1, 10_000).tolist())
    path = write_atomically(tmp_path / "a.csv", lambda file: write_rows(file, ("i", "x"), columns))
    lines = path.read_text().splitlines()
    assert len(lines) == 10_001 and lines[:2] == ["i,x", "0,0.0"] and lines[-1] == "9999,1.0"
    with pytest.raises(ValueError, match="zip"):
        write_atomically(tmp_path / "b.csv", lambda file: write_rows(file, ("i", "x"), (range(3), range(4))))
    assert left_in(tmp_path) == ["a.csv"]
