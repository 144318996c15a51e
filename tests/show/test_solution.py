"""A solution: rows by name, states in between, energy, expressions, the status card, tables and files."""

import csv
import errno
import io
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st
from sympy import cos, sin, sqrt
from sympy.physics.mechanics import dynamicsymbols

import lagrange as lg
from lagrange.errors import RunError, StatementError, counted
from lagrange.export import contents as export_contents
from lagrange.mechanics import conserved
from lagrange.page import player
from lagrange.page import web_page as page_write
from lagrange.show.files.atomic_file import cell, write_atomically, write_rows, write_together
from lagrange.statement.coordinate import coordinate, coordinates, t
from lagrange.statement.declare import declare
from lagrange.statement.event import event
from lagrange.system import System
from lagrange.trajectory.methods.runge_kutta import DOP853
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status
from tests.models import shared_scene
from tests.refusals import refusal
from tests.show.examples import k, m, oscillator, solved, x
from tests.systems import unit_pendulum

HARMONIC = oscillator()


def test_rows_by_expression_and_by_name() -> None:
    for key in (x, "x", dynamicsymbols("x")):
        np.testing.assert_array_equal(HARMONIC[key], HARMONIC.y[0])
    for key in (x.dot, "x_dot", sympy.Derivative(x, t)):
        np.testing.assert_array_equal(HARMONIC[key], HARMONIC.y[1])
    assert HARMONIC.names == ("x", "x_dot")


@pytest.mark.parametrize(
    ("call", "value", "words"),
    [
        (HARMONIC.__getitem__, "x_dott", "'x_dott' is neither a coordinate nor a velocity of this system; they are x "),
        (HARMONIC.__getitem__, "x_dott", "Did you mean 'x_dot'?"),
        (HARMONIC.__getitem__, coordinate("theta"), "'theta' is neither a coordinate nor a velocity"),
        (HARMONIC.__getitem__, 0, "'0' is neither a coordinate nor a velocity"),
        (HARMONIC.__getitem__, x.ddot, "For an expression use solution.evaluate"),
        (HARMONIC.at, 5.1, "t = 5.1 is outside the run, which went from 0 to 5"),
        (oscillator([0.0, -3.0]).at, 0.1, "t = 0.1 is outside the run, which went from -3 to 0"),
        (HARMONIC.at, [1.0, -0.5], "t = -0.5 is outside the run"),
        (HARMONIC.at, np.nan, "is not a time"),
        (HARMONIC.at, [[1.0]], "is not a time"),
        (HARMONIC.evaluate, "x**2", "the expression is the text 'x**2': give a SymPy expression"),
        (HARMONIC.evaluate, sympy.Matrix([x, x]), "is a matrix of shape (2, 1)"),
        (HARMONIC.evaluate, sympy.Symbol("stiffness") * x, "stiffness"),
        (HARMONIC.evaluate, 1j, "complex"),
    ],
)
def test_what_a_solution_does_not_have_is_refused(call: Any, value: Any, words: str) -> None:
    assert words in refusal(call, value)


def test_states_between_the_outputs() -> None:
    np.testing.assert_allclose(HARMONIC.at(0.123), [np.cos(0.246), -2 * np.sin(0.246)])
    times = [3, 0.2, 5.0]
    assert HARMONIC.at(times).shape == (2, 3)
    np.testing.assert_allclose(HARMONIC.at(times)[0], np.cos(2 * np.array(times)))
    assert HARMONIC.at([]).shape == (2, 0)
    np.testing.assert_array_equal(HARMONIC.at(5.0 + 1e-15), HARMONIC.at(5.0))


def test_energy_and_expressions() -> None:
    np.testing.assert_allclose(HARMONIC.energy, 2.0)
    cosine = np.cos(2 * HARMONIC.t)
    np.testing.assert_allclose(HARMONIC.evaluate(k * x**2 / 2), 2 * cosine**2)
    np.testing.assert_allclose(HARMONIC.evaluate(m * x.ddot + k * x), 0.0, atol=1e-14)
    np.testing.assert_allclose(HARMONIC.evaluate(t * x.dot), HARMONIC.t * HARMONIC["x_dot"])
    assert HARMONIC.evaluate(3).tolist() == [3.0] * 51
    np.testing.assert_allclose(HARMONIC.evaluate(sqrt(m) + 0.5), [1.5] * 51)


def test_the_card_is_plain_json() -> None:
    card = HARMONIC.card()
    assert json.loads(json.dumps(card, allow_nan=False)) == card
    assert card["system"] == "oscillator" and card["status"] == "success" and card["complete"] is True
    assert card["parameters"] == {"m": 1.0, "k": 4.0} and card["initial"] == {"x": 1.0, "x_dot": 0.0}
    assert card["steps"] == 50 and card["rejected"] == 3 and card["evaluations"] == 44 and card["wall"] == 0.0123
    assert card["t_start"] == 0.0 and card["t_end"] == 5.0 and card["outputs"] == 51
    assert card["energy"]["conserved"] is True and card["energy"]["relative"] < 1e-14


def test_the_card_says_what_was_aimed_at() -> None:
    settings = ("step", "rtol", "atol")
    unknown = HARMONIC.card()
    assert [unknown[key] for key in settings] == [None] * 3 and "tolerances" not in repr(HARMONIC)
    system = System(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1})
    equal = system.run(1.0, method="rk4", step=0.125)
    assert [equal.card()[key] for key in settings] == [0.125, None, None] and "\nstep          0.125\n" in repr(equal)
    assert [system.run(0.0, method="rk4").card()[key] for key in settings] == [0.0, None, None]
    for method in ("taylor", "scipy-rk45", DOP853(rtol=1e-7, atol=1e-8)):
        given: dict[str, Any] = {"rtol": 1e-7, "atol": 1e-8} if isinstance(method, str) else {}
        aimed = system.run(1.0, method=method, **given)
        assert [aimed.card()[key] for key in settings] == [None, 1e-7, 1e-8]
        assert "\ntolerances    rtol = 1e-07, atol = 1e-08\n" in repr(aimed)
    scaled = replace(HARMONIC, trajectory=replace(HARMONIC.trajectory, rtol=1e-9))
    assert "tolerances    rtol = 1e-09, atol follows the scale" in repr(scaled)


def test_require_raises_on_all_but_success_and_event() -> None:
    for status in Status:
        run = oscillator(status=status, message=f"It was {status.value}.")
        if status in (Status.SUCCESS, Status.EVENT):
            assert run.require() is run
        else:
            with pytest.raises(RunError, match=f"It was {status.value}"):
                run.require()
            assert f"It was {status.value}." in repr(run)


def test_drift_is_told_against_an_honest_scale() -> None:
    wrong = replace(HARMONIC, trajectory=replace(HARMONIC.trajectory, y=HARMONIC.y * np.linspace(1, 1.001, 51)))
    assert wrong.drift.relative == pytest.approx(0.002001, rel=1e-6) and "2.0e-03 of the initial energy" in repr(wrong)
    # A potential shifted so that E0 = 0: relative to E0 the drift would be infinite.
    shifted = declare(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2 - 2, parameters={m: 1, k: 4}, name="shifted")
    run = solved(shifted, HARMONIC.t, lambda s: 1.001 ** (s > 2) * np.array([np.cos(2 * s), -2 * np.sin(2 * s)]))
    assert run.drift.first == 0.0 and run.drift.relative == pytest.approx(2.001e-3, rel=2e-2)
    assert run.drift.against == "the largest |v.p|/2"


def test_an_energy_that_nothing_conserves_is_not_called_drift() -> None:
    run = oscillator(forces={x: -x.dot / 10})
    assert "energy drift" not in repr(run) and "(the system does not conserve it)" in repr(run)
    assert run.card()["energy"]["conserved"] is False


def test_a_rest_has_no_drift() -> None:
    statement = declare(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1, k: 4}, name="rest")
    run = solved(statement, np.linspace(0, 1, 3), lambda s: np.zeros((2, len(s))))
    assert run.drift.relative == 0.0 and "0.0e+00" in repr(run)


@pytest.mark.slow
def test_the_card_has_the_length_of_each_quaternion() -> None:
    """Euler's method stretches it: by sqrt(1 + (step * rate / 2)**2) in a step."""
    R = lg.rotation("R")
    run = lg.System(R.body.dot(R.body) / 2, initial={R.body: (0, 0, 2)}).run(0.5, method="euler", step=0.5)
    assert run.card()["lengths"] == {"R": pytest.approx(1.25**0.5 - 1)}
    assert "quaternion of R  length differs from 1 by at most 1.2e-01" in repr(run)
    assert HARMONIC.card()["lengths"] == {} and "quaternion" not in repr(HARMONIC)


def test_a_state_that_is_not_finite_still_has_a_card() -> None:
    statement = HARMONIC.model.statement
    run = solved(statement, np.array([0.0]), lambda s: np.full((2, len(s)), np.nan), Status.NON_FINITE, "x is nan.")
    assert "x is nan." in repr(run) and "not known" in repr(run)
    assert run.card()["initial"] == {"x": None, "x_dot": None} and run.card()["energy"] is None
    json.dumps(run.card(), allow_nan=False)


def test_a_run_without_output_still_has_a_card() -> None:
    run = oscillator([])
    assert "no outputs" in repr(run) and run.card()["outputs"] == 0 and run.card()["initial"] == {}
    assert run.card()["t_end"] == run.trajectory.span[1]
    assert "no output" in refusal(lambda: run.drift)


def test_csv_round_trips(tmp_path: Path) -> None:
    path = HARMONIC.to_csv(tmp_path / "run.csv")
    lines = path.read_text().splitlines()
    assert lines[0] == "t,x,x_dot" and len(lines) == 52
    read = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]]).T
    np.testing.assert_array_equal(read, np.vstack([HARMONIC.t, HARMONIC.y]))


def test_multipliers_stand_behind_the_state_in_tables(tmp_path: Path) -> None:
    x, y = coordinates("x y")
    rod = System((x.dot**2 + y.dot**2) / 2, y, constraints={"rod": x**2 + y**2 - 1}, initial={x: 0.6, y: -0.8})
    run = rod.run(1.0)
    lines = run.to_csv(tmp_path / "run.csv").read_text().splitlines()
    assert lines[0] == "t,x,y,x_dot,y_dot,lambda[rod]"
    assert [float(line.split(",")[-1]) for line in lines[1:]] == run.multipliers["rod"].tolist()
    pytest.importorskip("pandas")
    assert run.to_pandas()["lambda[rod]"].tolist() == run.multipliers["rod"].tolist()


def test_pandas_and_xarray() -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    frame = HARMONIC.to_pandas()
    assert list(frame.columns) == ["x", "x_dot"] and frame.index.name == "t" and frame.attrs["method"] == "exact"
    np.testing.assert_array_equal(frame["x_dot"].to_numpy(), HARMONIC["x_dot"])
    data = HARMONIC.to_xarray()
    assert data["x"].dims == ("t",) and data.attrs["status"] == "success"
    np.testing.assert_array_equal(data["x"].to_numpy(), HARMONIC["x"])
    frame.loc[0.0, "x"] = 99.0
    data["x"][0] = 99.0
    assert HARMONIC["x"][0] == 1.0, "what is handed out is a copy"


@pytest.mark.parametrize(("method", "package"), [("to_pandas", "pandas"), ("to_xarray", "xarray")])
def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch, method: str, package: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    assert refusal(getattr(HARMONIC, method)) == (
        f"{method}() needs {package}, which is not installed: pip install pandas xarray, or in a checkout "
        "pip install '.[data]'."
    )


def test_solutions_are_frozen() -> None:
    for field in fields(Solution):
        with pytest.raises(FrozenInstanceError):
            setattr(HARMONIC, field.name, None)


def test_one_of_a_kind_is_in_the_singular() -> None:
    card = repr(shared_scene("pendulum").run(1.0, method="rk4", step=1.0, t_eval=[1.0]))
    assert "0 to 1, 1 output\n" in card
    assert [counted(n, "step") for n in (0, 1, 2)] == ["0 steps", "1 step", "2 steps"]
    with pytest.raises(StatementError, match=r"this system has 1 coordinate \(theta\)"):
        shared_scene("pendulum").compile("numpy").accelerations([1.0, 2.0], [1.0, 2.0])


@pytest.mark.parametrize(("t_eval", "outputs"), [([0.0, 0.4, 0.9, 1.3, 1.7], "4 outputs"), ([], "no outputs")])
def test_the_card_shows_the_time_reached_and_not_that_of_the_last_output(t_eval: list[float], outputs: str) -> None:
    fall = System(kinetic=x.dot**2 / 2, potential=10 * x, initial={x: 9.0})
    run = fall.run(3.0, t_eval=t_eval, events=[event(x, terminal=True), x.dot, x - 100])
    assert f"0 to 1.34164, {outputs}" in repr(run) and "at t = 1.34164" in run.message
    assert run.card()["t_end"] == pytest.approx(1.8**0.5)
    assert "event 0: 1 time, event 1: 0 times, event 2: 0 times" in repr(run)


@pytest.mark.parametrize("outputs", [[10.0], [9.0, 10.0], [0.0, 10.0], None])
def test_the_drift_is_from_the_start_whatever_the_first_output_is(outputs: list[float] | None) -> None:
    run = shared_scene("pendulum").run(10, method="euler", step=0.01, t_eval=outputs)
    every = shared_scene("pendulum").run(10, method="euler", step=0.01)
    assert run.drift.first == pytest.approx(every.energy[0], rel=1e-14)
    assert run.drift.absolute == pytest.approx(np.abs(run.energy - every.energy[0]).max(), rel=1e-12)
    assert run.drift.relative > 1e-2 and run.drift.against == "the initial energy"


def test_a_run_whose_start_is_not_known_says_from_where_its_energy_drifts(tmp_path: Path) -> None:
    run = shared_scene("pendulum").run(10, method="euler", step=0.01, t_eval=[9.0, 10.0])
    loaded = lg.load(run.to_npz(tmp_path / "run.npz"))
    assert loaded.drift.against == "the energy at the first output" and loaded.drift.first == loaded.energy[0]
    assert "of the energy at the first output" in repr(loaded)


def test_momenta_drift_from_the_start_too() -> None:
    x, y = lg.coordinates("x y")
    free = lg.System(kinetic=(1 + y**2) * x.dot**2 / 2 + y.dot**2 / 2, potential=y**2 / 2, name="bead")
    start = {x.dot: 0.5, y: 1.5}
    whole = free.run(5.0, start, method="euler", step=0.01)
    late = free.run(5.0, start, method="euler", step=0.01, t_eval=[4.0, 5.0])
    assert abs(late.momentum_drift["p_x"][0]) > 1e-4
    assert late.momentum_drift["p_x"][-1] == pytest.approx(whole.momentum_drift["p_x"][-1], rel=0.5)


# --- What a system conserves, along a run ---


r, phi, theta, y = lg.coordinates("r phi theta y")
g, l = lg.parameters("g l")
BOB = (l * sin(theta) * cos(phi), l * sin(theta) * sin(phi), -l * cos(theta))
VALUES = {m: 1.3, g: 9.81, l: 0.7}


SPHERICAL = lg.System(lg.kinetic_energy(m, BOB), lg.gravity(m, BOB, g), parameters=VALUES)


def spherical(**start: float) -> lg.Solution:
    return SPHERICAL.run(2.0, {"theta": 1.0, "phi_dot": 2.0, **start}, rtol=1e-11)


def test_invariants_along_a_run() -> None:
    run = spherical()
    assert list(run.invariants) == ["energy", "p_phi"] == list(pickle.loads(pickle.dumps(run)).invariants)
    np.testing.assert_allclose(run.invariants["energy"], run.energy, rtol=1e-12)
    momentum = 1.3 * 0.7**2 * np.sin(run[theta]) ** 2 * run[phi.dot]
    np.testing.assert_allclose(run.invariants["p_phi"], momentum, rtol=1e-12)
    kepler = lg.System(lg.kinetic_energy(m, (x, y)), -k / sqrt(x**2 + y**2), parameters={m: 1, k: 2})
    orbit = kepler.run(3.0, {x: 1.0, y.dot: 1.2}, rtol=1e-11)
    assert len(orbit.invariants) == 4
    for values in orbit.invariants.values():
        # Runge-Lenz vector along y is zero; the others are of order one.
        assert values.shape == orbit.t.shape and np.ptp(values) < 1e-8
    assert lg.System(m * x.dot**2, k * x**2 * cos(lg.t), parameters={m: 1, k: 1}).run(0.1).invariants == {}


def test_the_card_and_the_plot_have_the_momenta() -> None:
    run = spherical()
    assert "p_phi drift" in repr(run) and " of its largest term" in repr(run)
    titles = [axis.get_title(loc="left") for axis in run.plot().axes]
    assert "drift of p_phi relative to the largest term" in titles
    # From rest along phi the momentum is zero: its terms are the scale, and nothing is divided by zero.
    assert spherical(phi_dot=0.0).momentum_drift["p_phi"].max() == 0.0
    free = lg.System(sum(m * lg.coordinate(f"f{i}").dot ** 2 for i in range(5)), parameters={m: 1})
    card = repr(free.run(0.1))
    assert card.count(" drift ") == 4 and "2 in solution.invariants" in card


def test_a_card_does_not_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conserved, "_symmetries", None)
    assert "p_phi drift" in repr(spherical())


# --- files are written completely or not at all, and failures have messages ------------------------------------


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


@given(st.lists(st.text(st.sampled_from("=+-@\t\r\n\0 \",'aä")), min_size=1, max_size=3))
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
    assert "there is no folder" in refusal(write_together, tmp_path / "no", {"a.csv": text("new")})
    assert "has control characters: give another" in refusal(write_together, tmp_path / "a\0b", {"a.csv": text("new")})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]


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
    assert "there is no folder" in refusal(WRITERS[kind], tmp_path / "missing")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("lazy")
def test_a_folder_that_cannot_be_made_is_refused_first(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert "cannot be made" in refusal(lambda: unit_pendulum().export("python", tmp_path / "file" / "out"))


@pytest.mark.usefixtures("lazy")
def test_a_folder_that_may_not_be_written_to_is_refused_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    assert "may not be written to" in refusal(WRITERS["html"], tmp_path)
