"""The command `lagrange race`: output, files and exit codes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lagrange.cli.program import main
from tests.drop import DROP, Captured, data, printed, written

SCENE = DROP.replace('"m*g*y"', '"m*g*y + sin(y)"')
QUICK = ["--tolerances", "1e-4,1e-8", "--steps", "0.1,0.05,0.025", "--repeats", "1", "--digits", "18"]


@pytest.fixture
def scene(tmp_path: Path) -> str:
    return written(tmp_path, SCENE)


def test_the_table_is_printed_and_files_are_written(scene: str, tmp_path: Path, capsys: Captured) -> None:
    out = tmp_path / "deep" / "er"
    said = printed(capsys, "race", scene, "--methods", "dop853, rk4", *QUICK, "--out", str(out))
    assert said.startswith("drop, t = 0 to 2: largest error of the state at t = 2\n")
    assert said.endswith(f"written to {out}: table.csv and plot.png\n")
    table = np.genfromtxt(out / "table.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert table["method"].tolist() == ["dop853"] * 2 + ["rk4"] * 3
    assert table["setting"].tolist() == [1e-4, 1e-8, 0.1, 0.05, 0.025]
    assert (np.diff(table["error"][2:]) < 0).all()
    assert (out / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_options_reach_the_race(scene: str, capsys: Captured) -> None:
    options = [
        *("--t-end", "1", "--set", "g=4", "--initial", "y_dot=1", "--outputs", "4", "--relative", "--max-wall", "5")
    ]
    plain, race = (data(capsys, "race", scene, "--methods", "rk4", *QUICK, *more) for more in ([], options))
    assert (race["t_end"], race["relative"], race["files"]) == (1.0, True, [])
    assert race["measure"] == "largest error of the state at 4 times, relative to each entry's size"
    assert "18 digits" in race["reference"]
    assert [entry["timed"] for entry in race["entries"]] == [1, 1, 1]
    assert plain["entries"][0]["error"] != race["entries"][0]["error"]


def test_no_run_at_the_end_is_a_failure_with_a_table(tmp_path: Path, capsys: Captured) -> None:
    picture = tmp_path / "plot.png"
    picture.write_text("of an earlier race")
    request = ["race", "elastic-pendulum", "--t-end", "1", "--methods", "verlet", *QUICK, "--out", str(tmp_path)]
    assert main(request) == 1
    assert "refused" in capsys.readouterr().out
    assert (tmp_path / "table.csv").exists() and not picture.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--methods", "rk5"], "Did you mean 'rk4'"),
        (["--methods", ""], "there is no method ''"),
        (["--tolerances", "1e-6,small"], "--tolerances: 'small' is not a number"),
        (["--tolerances", "0"], "tolerances contains 0"),
        (["--steps", "0.1,,0.2"], "--steps: '' is not a number"),
        (["--t-end", "0"], "no length"),
    ],
    ids=lambda value: " ".join(value)[:30],
)
def test_refusals(scene: str, options: list[str], words: str, capsys: Captured) -> None:
    assert main(["race", scene, *options]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert words in captured.err
