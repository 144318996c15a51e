"""The examples run, and their output is right."""

import ast
import json
import math
import os
import re
import runpy
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.image
import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from examples import (
    beats,
    double_pendulum,
    euler_against_rk4,
    flip_times,
    magnet_pendulum,
    pendulum_period,
    phase_portraits,
    poincare_section,
    throw_in_wind,
)


def assert_is_a_picture(path: Path) -> None:
    pixels = matplotlib.image.imread(path)
    assert pixels.shape[0] > 300
    assert pixels.shape[1] > 300
    assert np.ptp(pixels) > 0.5


def numbers(line: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+(?:e[-+]\d+)?", line)]


def test_period_of_a_pendulum(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = pendulum_period.main(tmp_path / "new")
    assert len(rows) == len(pendulum_period.DEGREES)
    for _degrees, measured, exact in rows:
        assert measured == pytest.approx(exact, rel=1e-10)
    # K(1/2) = Gamma(1/4)^2 / (4 sqrt(pi)): the period at 90 degrees without elliptic integrals of anybody's.
    quarter = math.gamma(0.25) ** 2 / (4 * math.sqrt(math.pi)) * math.sqrt(1.0 / 9.81)
    at_right_angles = next(measured for degrees, measured, _ in rows if degrees == 90)
    assert at_right_angles == pytest.approx(4 * quarter, rel=1e-12)
    table = capsys.readouterr().out.splitlines()
    printed = numbers(next(line for line in table if line.strip().startswith("90°")))
    assert printed[0] == pytest.approx(4 * quarter, abs=1e-11)
    assert printed[1] == pytest.approx(4 * quarter, abs=1e-11)
    assert printed[3] == pytest.approx(-15.279)
    assert_is_a_picture(tmp_path / "new" / "pendulum_period.png")


@pytest.mark.slow
def test_euler_against_rk4(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = euler_against_rk4.main(tmp_path)
    over_the_top = 2 * 9.81
    start = 9.81 * (1 - math.cos(1.5))
    assert result["euler"][0] == pytest.approx(1.0, abs=0.05)
    assert result["rk4"][0] == pytest.approx(4.0, abs=0.05)
    assert result["euler"][1] > over_the_top
    assert result["rk4"][1] == pytest.approx(start, rel=1e-6)
    table = [numbers(line) for line in capsys.readouterr().out.splitlines()[1:6]]
    assert [row[0] for row in table] == pytest.approx([0.02, 0.01, 0.005, 0.0025, 0.00125])
    assert [b[1] / a[1] for a, b in pairwise(table)] == pytest.approx([1 / 2] * 4, rel=0.01)
    assert_is_a_picture(tmp_path / "euler_against_rk4.png")


@pytest.mark.slow
def test_double_pendulum(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    solution = double_pendulum.main(tmp_path)
    assert solution["theta1"][0] == solution["theta2"][0] == math.pi / 2
    assert np.ptp(solution.energy) < 1e-9
    out = capsys.readouterr().out
    assert "l₁⋅l₂⋅m₂⋅sin(θ₁ - θ₂)" in out
    assert "the energy is conserved" in out
    assert "Everything holds." in out
    assert "double pendulum: success" in out
    assert_is_a_picture(tmp_path / "double_pendulum.png")


@pytest.mark.slow
def test_phase_portraits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = phase_portraits.main(tmp_path)
    for (method, step), row in result.items():
        assert row["order"] == pytest.approx(4 if method == "RK4" else 2, abs=0.05)
        if method != "RK4":
            # 3000 steps with angles up to 7000, whose spacing is 1e-12: two roundings of each are seen.
            assert row["recursion"] < 1e-11
        exact = method == "integrable"
        assert (row["invariant"] < 1e-9) is exact, (method, step)
        assert row["energy"] > 1e-5
    assert result["variational", 0.9]["invariant"] > 0.1
    assert result["RK4", 0.9]["energy"] > 1.0
    # With the other sign the map is that of the inverted pendulum, off by twice the force.
    theta, _ = phase_portraits.orbit("integrable", 0.1, 100, 1.0, 0.0)
    middle = theta[1:-1]
    kick = theta[:-2] - 2 * middle + theta[2:]
    assert np.abs(kick + 0.1**2 * np.sin(middle)).max() < 0.1**4 / 4
    assert phase_portraits.residual("variational", 0.1, theta) > 1e-6
    assert "integrable" in capsys.readouterr().out
    assert_is_a_picture(tmp_path / "phase_portraits.png")


@pytest.mark.slow
def test_poincare_section(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    orbits = poincare_section.main(tmp_path)
    result = np.concatenate(orbits)
    assert len(result) == 10_000
    # An event is located to round-off, and 500 crossings at rtol 1e-12 leave the energy within some 1e-12.
    assert np.abs(result[:, 0]).max() < 1e-14
    assert (result[:, 2] > 0).all()
    assert np.abs(poincare_section.energy(result) - poincare_section.ENERGY).max() < 1e-11
    out = capsys.readouterr().out
    assert "10000 crossings of 20 orbits" in out
    assert_is_a_picture(tmp_path / "poincare_section.png")


@pytest.mark.slow
def test_flip_times(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flip_times.flips, "__defaults__", (40, 20.0))
    runs = flip_times.main(tmp_path)
    times = flip_times.flip_times(runs)
    assert times.shape == (1600,)
    assert 0.3 < np.isfinite(times).mean() < 0.69
    assert "0 of these flipped" in capsys.readouterr().out
    assert_is_a_picture(tmp_path / "flip_times.png")


@pytest.mark.slow
def test_magnet_pendulum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(magnet_pendulum.rests, "__defaults__", (41,))
    runs = magnet_pendulum.main(tmp_path)
    labels = magnet_pendulum.nearest(runs)
    places = np.array([np.median(runs.y[:2, labels == k], axis=1) for k in range(3)])
    # At rest on the line from the middle to a magnet, where spring and magnets balance: three times the same distance.
    # At the end of the runs 3e-7 of an oscillation is left.
    distances = np.linalg.norm(places, axis=1)
    assert distances == pytest.approx([distances[0]] * 3, rel=1e-5) and 0.95 < distances[0] < 1.0
    assert np.degrees(np.arctan2(places[:, 1], places[:, 0])) == pytest.approx([90.0, -150.0, -30.0], abs=1e-3)
    # The mirror x -> -x exchanges the magnets to the left and to the right.
    exchanged = np.array([0, 2, 1])[labels.reshape(41, 41)][::-1]
    off_axis = np.abs(runs.given("x").reshape(41, 41)) > 1e-9
    assert (exchanged == labels.reshape(41, 41))[off_axis].mean() > 0.99  # a border is sensitive to rounding
    assert_is_a_picture(tmp_path / "magnet_pendulum.png")


@pytest.mark.slow
def test_beats(tmp_path: Path) -> None:
    modes, alone = beats.main(tmp_path)
    # At an amplitude of 0.02 the terms beyond second order are 1e-4 of the energy.
    assert np.ptp(modes, axis=1) == pytest.approx([0.0, 0.0], abs=3e-4 * modes.sum(axis=0)[0])
    assert alone[0, 0] == pytest.approx(alone[1].max(), rel=0.02)  # all of it goes to the other
    assert_is_a_picture(tmp_path / "beats.png")


@pytest.mark.slow
def test_throw_in_wind(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(throw_in_wind.throws, "__defaults__", (256, 1))
    runs = throw_in_wind.main(tmp_path)
    landed = runs.y_events[0][:, 0]
    assert np.abs(landed[:, 1]).max() < 1e-12 and (landed[:, 3] < 0).all()
    # Sobol's points are spread evenly: the mean of 256 is that of the distribution, 4 Gamma(3/2), within a hundredth.
    assert runs.given("w").mean() == pytest.approx(4 * math.gamma(1.5), rel=0.01)
    assert "correlation of the distance with the wind: +0.9" in capsys.readouterr().out
    assert_is_a_picture(tmp_path / "throw_in_wind.png")


# --- notebooks -------------------------------------------------------------------------------------------------

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = runpy.run_path(str(ROOT / "docs" / "notebooks.py"))
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)[^)]*\)")
ALLOWED = frozenset(("lagrange", "sympy", "numpy", *sys.stdlib_module_names))
LONGEST = 60.0
"""Seconds of the processor that a notebook may take: the longest takes five."""
HANGS = 600
"""Seconds after which a cell counts as one that does not end."""

notebooks = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def cells(path: Path, kind: str) -> list[tuple[str, str]]:
    """Return the names and sources of the cells of one kind."""
    result = json.loads(path.read_text("utf-8"))["cells"]
    return [(cell["id"], "".join(cell["source"])) for cell in result if cell["cell_type"] == kind]


def imported(source: str) -> set[str]:
    """Return the packages that a cell imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=aliases):
                names |= {alias.name.partition(".")[0] for alias in aliases}
            case ast.ImportFrom(module=str(module)):
                names.add(module.partition(".")[0])
    return names


def tolerances_without_a_reason(source: str) -> list[int]:
    """Return the lines of a cell that assert a numerical bound without a comment."""
    lines = source.splitlines()
    bounds = [
        node.lineno
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Assert)
        and any(isinstance(part, ast.Constant) and isinstance(part.value, float) for part in ast.walk(node.test))
    ]
    return [line for line in bounds if "# " not in lines[line - 1] and not _explained(lines[: line - 1])]


def _explained(above: list[str]) -> bool:
    """Return True if a comment precedes a line in its group of lines."""
    while above and above[-1].strip():
        if above[-1].strip().startswith("#"):
            return True
        above = above[:-1]
    return False


def is_shown(data: dict[str, str]) -> bool:
    """Return True if the output of a cell is a picture, a page, a formula, or readable text."""
    return len(data) > 1 or not re.search(r"<Figure size| object at 0x|^\w+\(", data["text/plain"])


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the name of a kernel that runs the Python of this test."""
    folder = tmp_path_factory.mktemp("jupyter")
    (folder / "kernels" / "this-python").mkdir(parents=True)
    argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    spec = {"argv": argv, "display_name": "this Python", "language": "python", "env": {"PYTHONPATH": str(ROOT)}}
    (folder / "kernels" / "this-python" / "kernel.json").write_text(json.dumps(spec), "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JUPYTER_PATH", str(folder))
        yield "this-python"


def time_of_processes() -> float:
    """Return the processor time of all processes that were started here and have ended."""
    times = os.times()
    return times.children_user + times.children_system


@pytest.mark.slow
@notebooks
def test_the_notebook_runs(path: Path, kernel: str, tmp_path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    began = time_of_processes()
    NotebookClient(
        notebook, timeout=HANGS, kernel_name=kernel, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    taken = time_of_processes() - began
    outputs = [(cell.id, output) for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert [(name, output.text) for name, output in outputs if output.get("name") == "stderr"] == []
    assert [(name, output.data) for name, output in outputs if "data" in output and not is_shown(output.data)] == []
    assert (
        sum("image/png" in output.data or "text/html" in output.data for _, output in outputs if "data" in output) >= 1
    )
    assert taken < LONGEST
    SCRIPT["store_outputs"](
        path, nbformat.writes(notebook)
    )  # the documentation site shows it, and need not run it again


@notebooks
def test_the_notebook_is_stored_in_one_form(path: Path) -> None:
    text = path.read_text("utf-8")
    assert SCRIPT["stored"](text) == text, f"run docs/notebooks.py: {path.name} has outputs or metadata of its own"
    nbformat.validate(nbformat.reads(text, as_version=4))


@notebooks
def test_cells_have_names_that_stay(path: Path) -> None:
    names = [cell["id"] for cell in json.loads(path.read_text("utf-8"))["cells"]]
    assert len(names) == len(set(names))
    assert [name for name in names if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name)] == []


@notebooks
def test_the_notebook_needs_nothing_but_the_package_and_what_it_is_made_of(path: Path) -> None:
    assert set().union(*(imported(source) for _, source in cells(path, "code"))) - ALLOWED == set()


@notebooks
def test_every_tolerance_has_a_reason(path: Path) -> None:
    asserted = [name for name, source in cells(path, "code") if "assert " in source]
    assert len(asserted) >= 3
    assert {name: lines for name, source in cells(path, "code") if (lines := tolerances_without_a_reason(source))} == {}


@notebooks
def test_every_link_of_the_notebook_leads_somewhere(path: Path) -> None:
    targets = [target for _, source in cells(path, "markdown") for target in LINK.findall(source)]
    assert [target for target in targets if "://" not in target and not (path.parent / target).exists()] == []


def test_what_a_notebook_gave_is_kept_for_its_text_and_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebooks.py"))
    monkeypatch.setitem(script["outputs_path"].__globals__, "ROOT", tmp_path)
    notebook = tmp_path / "a.ipynb"
    for text in ("1", "2"):
        notebook.write_text(text, "utf-8")
        assert not script["outputs_path"](notebook).exists()
        script["store_outputs"](notebook, f"outputs of {text}")
        assert script["outputs_path"](notebook).read_text("utf-8") == f"outputs of {text}"
    assert len(list((tmp_path / "build" / "notebooks").iterdir())) == 1
