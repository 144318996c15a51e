"""The command `lagrange grade`: output and exit codes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from lagrange.cli.program import main
from tests.drop import Captured

RIGHT = "l*theta_ddot + g*sin(theta) = 0\n"


def graded(folder: Path, text: str | bytes, *options: str) -> int:
    path = folder / "answer.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return main(["grade", "pendulum", str(path), *options])


def test_right_and_wrong_equations(tmp_path: Path, capsys: Captured) -> None:
    assert graded(tmp_path, RIGHT) == 0
    assert capsys.readouterr().out == (
        "The equations are right: they are equivalent to those of the system, at the 5 states tried.\n"
    )
    assert graded(tmp_path, RIGHT.replace("+", "-")) == 1
    assert "has the wrong sign" in capsys.readouterr().out
    assert graded(tmp_path, RIGHT.replace("+", "-"), "--json") == 1
    data = json.loads(capsys.readouterr().out)
    assert (data["right"], data["wrong"]) == (False, [1]) and "theta_ddot" in data["counterexample"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_ddot + c\n", "line 1, column 14: 'c' is not a symbol of this system."),
        ("# nothing\n", "there is no equation: write one equation per line"),
        (
            b"\xff\xfea",
            "the file is not plain text; it may be a document of a word processor. Save the answer as plain text.",
        ),
        (b"PK\x03\x04\0\0theta", "the file is not plain text; it may be a document of a word processor."),
        (b"%PDF-1.4\n\xe2", "the file is not plain text; it may be a document of a word processor."),
        ("theta'' = 0\x1b[2J", "the file is not plain text; it may be a document of a word processor."),
        ("x" * 1_000_001, "the file has more than 1000000 bytes, too many for equations: give a shorter file."),
    ],
)
def test_what_cannot_be_read_is_a_wrong_request(
    text: str | bytes, message: str, tmp_path: Path, capsys: Captured
) -> None:
    assert graded(tmp_path, text) == 2
    assert f"{tmp_path / 'answer.txt'}: {message}" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_answers_of_any_usual_encoding_are_read(encoding: str, tmp_path: Path) -> None:
    assert graded(tmp_path, "l theta\u2019\u2019 = \u2013g sin theta \u00b7 1\r\n".encode(encoding)) == 0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("x" * 5000, "the file cannot be read (File name too long): check its name and its permissions."),
        ("nowhere.txt", "nowhere.txt: there is no such file. Give a text file"),
    ],
    ids=["too long", "missing"],
)
def test_a_file_that_cannot_be_opened(name: str, message: str, capsys: Captured) -> None:
    assert main(["grade", "pendulum", name]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_folder_of_answers_becomes_a_table(tmp_path: Path, capsys: Captured) -> None:
    """An unreadable file does not affect the others. Hidden files and folders are ignored."""
    folder = tmp_path / "answers"
    (folder / "older").mkdir(parents=True)
    right, wrong = b"l theta'' = -g sin theta", b"l theta'' = g sin theta"
    for name, answer in {
        "Ada.txt": right,
        "Ben.md": wrong,
        "Ben.txt": wrong,
        "Cam.txt": b"\xff\xfea",
        ".x": b"y",
    }.items():
        (folder / name).write_bytes(answer)
    table = tmp_path / "grades.csv"
    assert main(["grade", "pendulum", str(folder), "--out", str(table)]) == 1
    shown = capsys.readouterr().out
    assert [line.split()[:2] for line in shown.partition("\n\n")[0].splitlines()[2:] if line[0] != " "] == [
        ["Ada", "right"],
        ["Ben.md", "wrong"],
        ["Ben.txt", "wrong"],
        ["Cam", "cannot"],
    ]
    assert "1 of 4 are right, 2 wrong, and 1 cannot be read. Folders inside are left out" in " ".join(shown.split())
    assert max(map(len, shown.partition("\n\n")[0].splitlines())) <= 100
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0] == {"student": "Ada", "verdict": "right", "finding": "", "reading": "l*theta_ddot = -g*sin(theta)"}
    assert "has the wrong sign" in rows[1]["finding"] and rows[3]["finding"].startswith("the file is not plain text")
    assert main(["grade", "pendulum", str(folder), "--json"]) == 1
    assert [row["verdict"] for row in json.loads(capsys.readouterr().out)["answers"]] == [
        "right",
        "wrong",
        "wrong",
        "cannot be read",
    ]


def test_tables_are_for_folders_that_have_answers(tmp_path: Path, capsys: Captured) -> None:
    assert main(["grade", "pendulum", str(tmp_path)]) == 2
    assert f"{tmp_path}: the folder has no files." in " ".join(capsys.readouterr().err.split())
    assert graded(tmp_path, RIGHT, "--out", str(tmp_path / "table.csv")) == 2
    assert "a table is written only for a folder of answers: leave --out out, or give a folder." in " ".join(
        capsys.readouterr().err.split()
    )
