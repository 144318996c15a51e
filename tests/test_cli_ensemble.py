"""The command `lagrange ensemble`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.cli import main

VARY = ["--vary", "theta=0.1:2:3", "--vary", "l=0.5:1:2", "--t-end", "1"]


def test_runs_are_counted_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ensemble", "pendulum", *VARY, "--out", str(tmp_path / "map.png")]) == 0
    said = capsys.readouterr().out
    assert said.startswith("pendulum: 6 members (3 x 2), varying theta and l") and "6 success" in said
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    assert main(["ensemble", "pendulum", *VARY, "--set", "g=9", "--method", "rk4", "--step", "0.1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["shape"] == [3, 2]


def test_a_store_is_written_and_gone_on_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    zarr = pytest.importorskip("zarr")
    command = [
        "ensemble",
        "pendulum",
        *VARY,
        "--keep",
        "end,max:theta,mean:theta_dot",
        "--out",
        str(tmp_path / "runs.zarr"),
    ]
    assert main(command) == 0 and main(command) == 0
    assert "all members were stored" in capsys.readouterr().out
    group = zarr.open_group(str(tmp_path / "runs.zarr"), mode="r")
    alone = lg.scene("pendulum").run(1.0, {"theta": 2.0}, parameters={"l": 1.0})
    assert group["max(theta)"][5] == pytest.approx(2.0) and group["theta_end"][5] == pytest.approx(alone.y[0, -1])


def test_failures_are_an_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ensemble", "henon-heiles", "--vary", "x=0:1:3", "--t-end", "15"]) == 1
    assert "step_too_small" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ([], "nothing varies: give --vary NAME=LOW:HIGH:COUNT"),
        (["--vary", "theta=1"], "--vary theta=1: write NAME=LOW:HIGH:COUNT"),
        (["--vary", "theta=a:b:3"], "--vary theta: 'a' is not a number"),
        (["--vary", "thet=0:1:3"], "Did you mean 'theta'?"),
        (["--vary", "theta=0:1:3", "--vary", "theta=0:1:3"], "--vary names something twice"),
        (["--vary", "l=1:2:3", "--set", "l=1"], "l varies, and has a value as well"),
        (["--vary", "l=1:2:3", "--keep", "max:phi"], "'phi' is no coordinate and no velocity of pendulum"),
    ],
)
def test_wrong_requests_are_refused(options: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ensemble", "pendulum", *options]) == 2
    assert text in capsys.readouterr().err.replace("\n", " ")
