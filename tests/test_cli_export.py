"""The commands `lagrange export` and `lagrange targets`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.cli.program import main

Captured = pytest.CaptureFixture[str]


def test_export_writes_files_and_says_how_they_are_tested(tmp_path: Path, capsys: Captured) -> None:
    folder = tmp_path / "new" / "out"
    assert main(["export", "pendulum", "--target", "c", "--out", str(folder), "--contents", "rhs, jacobian"]) == 0
    said = capsys.readouterr().out
    assert [path.name for path in sorted(folder.iterdir())] == ["pendulum.c", "pendulum.h", "pendulum_test.c"]
    assert f"wrote {folder / 'pendulum.c'}" in said
    assert "  ./pendulum_test" in said


def test_parameters_and_data(tmp_path: Path, capsys: Captured) -> None:
    request = ["export", "pendulum", "--target", "c", "--out", str(tmp_path), "--set", "l=2.5", "--json"]
    assert main(request) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["commands"][-1] == "./pendulum_test"
    assert ", 2.5" in (tmp_path / "pendulum.c").read_text()


def test_a_wrong_request_is_said_in_a_sentence(tmp_path: Path, capsys: Captured) -> None:
    assert main(["export", "pendulum", "--target", "cobol", "--out", str(tmp_path)]) == 2
    assert "there is no target 'cobol'; the targets are c" in capsys.readouterr().err
    assert main(["export", "pendulum", "--target", "c", "--out", str(tmp_path), "--contents", "rsh"]) == 2
    assert "contents has the unknown name 'rsh'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_targets_are_listed(capsys: Captured) -> None:
    assert main(["targets"]) == 0
    said = capsys.readouterr().out
    assert all(name in said and about in said for name, about in lg.targets().items())
