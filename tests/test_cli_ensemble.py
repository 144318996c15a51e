"""The command `lagrange ensemble`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import lagrange as lg
from lagrange.cli.program import main
from lagrange.members import jobs, store
from tests.drop import Captured, Patch, data, printed

VARY = ["--vary", "theta=0.1:2:3", "--vary", "l=0.5:1:2", "--t-end", "1"]


def test_runs_are_counted_and_written(tmp_path: Path, capsys: Captured) -> None:
    said = printed(capsys, "ensemble", "pendulum", *VARY, "--out", str(tmp_path / "map.png"))
    assert said.startswith("pendulum: 6 members (3 x 2), varying theta and l") and "6 success" in said
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    options = ["--set", "g=9", "--method", "rk4", "--step", "0.1"]
    assert data(capsys, "ensemble", "pendulum", *VARY, *options)["shape"] == [3, 2]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("out", "more", "begins"),
    [
        ("a.svg", ["--what", "max:theta_dot", "--keep", "max:theta_dot", "--style", "dark"], b"<?xml"),
        ("a.pdf", ["--points", "20"], b"%PDF"),
        ("a.csv", ["--keep", "end,counts,drift"], b"member,theta,l,t_end,status,theta_end,theta_dot_end,steps"),
    ],
)
def test_every_kind_of_file(out: str, more: list[str], begins: bytes, tmp_path: Path) -> None:
    assert main(["ensemble", "pendulum", *VARY, "--out", str(tmp_path / out), *more]) == 0
    assert (tmp_path / out).read_bytes().startswith(begins)


def test_an_interrupted_store_goes_on(tmp_path: Path, capsys: Captured, monkeypatch: Patch) -> None:
    pytest.importorskip("zarr")
    monkeypatch.setattr(store, "LARGEST_BLOCK", 2)
    monkeypatch.setattr(jobs, "LARGEST_CHUNK", 2)
    monkeypatch.setattr(jobs, "FIRST_CHUNK", 2)
    command = ["ensemble", "pendulum", *VARY, "--workers", "1", "--out", str(tmp_path / "runs.zarr"), "--progress"]
    with monkeypatch.context() as patch:
        patch.setattr(store.StoredResults, "write", interrupting(store.StoredResults.write, 1))
        assert main(command) == 130
    said = capsys.readouterr()
    assert "2 success and 4 interrupted" in said.out and "the same command goes on from here" in said.out
    assert said.err.startswith("2 of 6 members, ") and said.err.endswith(" left\n")
    assert main(command) == 0
    said = capsys.readouterr()
    assert "ended   6 success" in said.out and "2 were stored before" in said.out
    assert said.err.startswith("6 of 6 members, ")


def interrupting(function: Any, after: int) -> Any:
    """Return a function that raises KeyboardInterrupt after a number of calls."""
    calls = iter(range(after))

    def called(*arguments: Any) -> Any:
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return function(*arguments)

    return called


def test_failures_are_an_exit_code(capsys: Captured) -> None:
    assert main(["ensemble", "henon-heiles", "--vary", "x=0:1:3", "--t-end", "15"]) == 1
    assert "step_too_small" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ([], "nothing varies: give --vary NAME=LOW:HIGH:COUNT"),
        (["--vary", "theta=1"], "--vary theta=1: write NAME=LOW:HIGH:COUNT"),
        (["--vary", "theta=a:b:3"], "--vary theta: 'a' is not a number"),
        (["--vary", "thet=0:1:3"], "Did you mean 'theta'?"),
        (["--vary", "theta=0:1:0"], "the number of values of theta = 0: give a whole number from 1"),
        (["--vary", "theta=0:1:20000", "--vary", "l=1:2:20000"], "--vary gives 4e+08 members, which run for"),
        (["--vary", "theta=0:1:3", "--keep", "ende"], "Did you mean 'end'?"),
        (["--vary", "theta=0:1:3", "--keep", "max:thet"], "these are theta and theta_dot. Did you mean 'theta'?"),
        (
            ["--vary", "theta=0:1:3", "--out", "a.foo"],
            "--out a.foo: give a name that ends in .png, .svg or .pdf for a picture, in .csv",
        ),
        (["--vary", "theta=0:1:3", "--out", "a.nc"], "A netCDF file is made in Python, by runs.to_xarray()"),
        (
            ["--vary", "theta=0:1:3", "--out", "runs"],
            "or in .zarr for a folder with the results of any number of members.",
        ),
        (["--vary", "theta=0:1:3", "--out", "no/a.csv"], "there is no folder"),
        (
            ["--vary", "theta=0:1:3", "--what", "theta"],
            "--what chooses the quantity of a picture, but no picture is written",
        ),
        (["--vary", "theta=0:1:3", "--out", "a.png", "--what", "thet"], "theta, theta_dot and t_end. Did you mean"),
        (["--vary", "theta=0:1:3", "--out", "a.csv", "--points", "9"], "--points: a table has one line per member"),
        (
            ["--vary", "theta=0:1:3", "--vary", "l=1:2:2", "--vary", "g=9:10:2", "--out", "a.png"],
            "theta, l and g vary, and a picture has two axes",
        ),
        (["--vary", "theta=0:1:3", "--vary", "theta=0:1:3"], "--vary gives theta twice: give it once."),
        (["--vary", "l=1:2:3", "--set", "l=1"], "l has both a range of values, --vary l, and a single value"),
        (["--vary", "l=1:2:3", "--out", "a.png", "--what", "max:theta"], "l, theta, theta_dot and t_end. Add --keep m"),
    ],
)
def test_wrong_requests_are_refused(options: list[str], text: str, capsys: Captured) -> None:
    assert main(["ensemble", "pendulum", *options]) == 2
    assert text in capsys.readouterr().err.replace("\n", " ")


# --- export ---------------------------------------------------------------------------------------------------
# The commands `lagrange export` and `lagrange targets`.


def test_export_writes_files_and_says_how_they_are_tested(tmp_path: Path, capsys: Captured) -> None:
    folder = tmp_path / "new" / "out"
    request = ["export", "pendulum", "--target", "c", "--out", str(folder)]
    said = printed(capsys, *request, "--contents", "rhs, jacobian")
    assert [path.name for path in sorted(folder.iterdir())] == ["pendulum.c", "pendulum.h", "pendulum_test.c"]
    assert f"wrote {folder / 'pendulum.c'}" in said
    assert "  ./pendulum_test" in said
    assert data(capsys, *request, "--set", "l=2.5")["commands"][-1] == "./pendulum_test"
    assert ", 2.5" in (folder / "pendulum.c").read_text()


def test_a_wrong_request_is_said_in_a_sentence(tmp_path: Path, capsys: Captured) -> None:
    assert main(["export", "pendulum", "--target", "cobol", "--out", str(tmp_path)]) == 2
    assert "there is no target 'cobol'; the targets are c" in capsys.readouterr().err
    assert main(["export", "pendulum", "--target", "c", "--out", str(tmp_path), "--contents", "rsh"]) == 2
    assert "contents has the unknown name 'rsh'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_targets_are_listed(capsys: Captured) -> None:
    said = printed(capsys, "targets")
    assert all(name in said and about in said for name, about in lg.targets().items())
