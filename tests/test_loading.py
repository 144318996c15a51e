"""Runs that are saved and loaded."""

from __future__ import annotations

import io
import json
import os
import random
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.show.files.loaded_run import arrays_of
from tests.public.test_wrong_calls import Caught
from tests.refusals import refusal

x, y = lg.coordinates("x y")
m, k, w = lg.parameters("m k w")
b = sympy.Symbol("b", real=True)
TIMES = [0.0, 1.0, 2.0, 3.0]


def rich() -> lg.System:
    """Return a system with given functions, conditions, a constraint and points."""
    X, Y = lg.given("X", sympy.sin(w * lg.t)), lg.given("Y", (TIMES, [0.0, 0.1, 0.3, 0.1]))
    choice = sympy.Piecewise((x**3, sympy.And(x > 0, sympy.Or(y < 1, x > 2))), (sympy.Abs(x) * sympy.pi, True))
    return lg.System(
        kinetic=m * (x.dot**2 + (y.dot + X.dot) ** 2) / 2,
        potential=k * (x - Y) ** 2 / 2 + sympy.Float("0.1", 40) * choice + sympy.Rational(1, 3) * sympy.asinh(y),
        forces={x: -b * x.dot},
        dissipation=sympy.Max(x.dot, 0) ** 2 / 7,
        constraints={"line": y - x - sympy.sinc(x) / 9 + sympy.Rational(1, 9)},
        parameters={m: 1, k: 2.5, w: 3, b: 0.1},
        initial={x.dot: 0.25, y.dot: 0.25},
        positions={"p": (x, y)},
        links=[("origin", "p")],
        name="rich",
    )


def test_a_run_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    run = rich().run(2.0, parameters={k: 3.0}, events=[lg.event(x.dot), lg.event(y - 9)], t_eval=np.linspace(0, 2, 9))
    run.to_npz(path)
    again = lg.load(path)
    assert again.card() == run.card() and again.status is run.status
    for first, second in ((again.y, run.y), (again.energy, run.energy), (again.evaluate(x.ddot), run.evaluate(x.ddot))):
        np.testing.assert_array_equal(first, second)
    for ours, theirs in ((again.t_events, run.t_events), (again.y_events, run.y_events)):
        for first, second in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(again.at(run.t[4]), run.y[:, 4])
    with pytest.raises(lg.RunError, match=r"there is no state at t = 0\.1234: a file has the outputs of a run"):
        again.at(0.1234)
    assert again.model.statement.defaults[k] == 2.5 and again.parameters[k] == 3.0


def without_states_between(path: Path) -> Path:
    """Write a file in the format of older versions."""
    with np.load(path) as result:
        arrays = {name: result[name] for name in result.files if not name.endswith("_between")}
    np.savez(path, **arrays)
    return path


@pytest.mark.few
@pytest.mark.parametrize("name", ["double-pendulum", "charge-in-field", "two-point-vortices", "cartesian-pendulum"])
def test_a_run_from_a_file_moves_as_the_run(name: str, tmp_path: Path) -> None:
    """Animations of a loaded run agree to a pixel, a thousandth of the picture; it has four states for each step."""
    run = lg.scene(name).run()
    result = lg.load(run.to_npz(tmp_path / "run.npz")).animate(tmp_path / "run.html")
    expected = run.animate()
    sizes = np.abs(expected.states).max(axis=1, keepdims=True)
    assert (np.abs(result.states - expected.states) <= 1e-4 * sizes + 1e-12).all()
    assert [*result.points] == [*expected.points] and "interpolated" in result.notes[0]


@pytest.mark.parametrize("span", [(0.0, 8.0), (8.0, 0.0)])
def test_a_run_with_few_outputs_moves_from_its_file_too(span: tuple[float, float], tmp_path: Path) -> None:
    system = lg.scene("pendulum")
    run = lg.integrate(system.compile(), span, {"theta": 2.0}, t_eval=np.linspace(*span, 3))
    result, expected = lg.load(run.to_npz(tmp_path / "run.npz")).animate(), run.animate()
    np.testing.assert_allclose(result.states, expected.states, rtol=0, atol=1e-4 * np.abs(expected.states).max())


def test_an_older_file_moves_from_its_outputs_unless_they_are_too_far_apart(tmp_path: Path) -> None:
    run = lg.scene("double-pendulum").run(5.0)
    steps = lg.load(without_states_between(run.to_npz(tmp_path / "steps.npz"))).animate()
    np.testing.assert_allclose(steps.states, run.animate().states, rtol=0, atol=1e-4)
    few = lg.load(without_states_between(run.sampled([0.0, 1.0, 5.0]).to_npz(tmp_path / "few.npz")))
    with pytest.raises(lg.StatementError, match=r"the states at t = 0 and 1 are too far apart for a moving picture"):
        few.animate(tmp_path / "few.html")
    assert not (tmp_path / "few.html").exists()


def _changed(path: Path, **changes: Any) -> Path:
    with np.load(path) as result:
        arrays = {**result, **changes}
    other = path.with_name("other.npz")
    np.savez(other, **{name: array for name, array in arrays.items() if array is not None})
    return other


def _card_with(path: Path, **changes: Any) -> Path:
    with np.load(path) as result:
        card = json.loads(str(result["card"]))
    return _changed(path, card=np.array(json.dumps({**card, **changes})))


def _statement_with(path: Path, old: str, new: str) -> Path:
    with np.load(path) as result:
        text = str(result["statement"])
    assert old in text
    return _changed(path, statement=np.array(text.replace(old, new)))


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    lg.scene("pendulum").run(0.1).to_npz(path)
    np.save(tmp_path / "one.npy", np.zeros(3))
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "text.npz").write_text("no archive", encoding="utf-8")
    cases: list[tuple[Any, str]] = [
        (3, "the path is 3 (int): give the path of a file."),
        (tmp_path / "none.npz", "cannot be read (No such file or directory)"),
        (tmp_path / "pipe", "is a device or a pipe: give a file"),
        (tmp_path, "is a folder: give a fi"),
        (tmp_path / "one.npy", "is not a file that solution.to_npz wrote (File is not a zip file)."),
        (tmp_path / "text.npz", "is not a file that solution.to_npz wrote"),
        (_changed(path, statement=None), "is not a run that to_npz wrote: it lacks statement."),
    ]
    for given, message in cases:
        assert message in refusal(lg.load, given)


CHANGES: list[tuple[Callable[[Path], Path], str]] = [
    (partial(_card_with, status="perfect"), "'perfect' is not a valid Status"),
    (partial(_card_with, target="fortran"), "there is no target 'fortran'"),
    (partial(_statement_with, old='["theta"]', new='["theta", "x"]'), "cannot be used: the Lagrangian h"),
    (partial(_statement_with, old="theta_dot**2", new="Integral(theta_dot)"), "'Integral' is not a function here"),
    (partial(_statement_with, old="theta_dot**2", new="theta_dot**9**9**9"), "a power of a constant that is computed"),
    (partial(_statement_with, old="kinetic =", new="kinetc ="), "'kinetc' is not a key of a scene"),
    (partial(_statement_with, old="kinetic =", new="kinetic"), "this is not TOML"),
    (
        partial(_changed, statement=np.array('{"form": 1, "nodes": []}')),
        "its statement is JSON, as development versions",
    ),
    (partial(_changed, card=np.array("[" * 100_000)), "is not a run that to_npz wrote (RecursionError"),
    (partial(_changed, statement=np.array("a = " + "[" * 100_000)), "the file is nested too deeply"),
]


@pytest.mark.parametrize(("change", "message"), CHANGES, ids=[message[:30] for _, message in CHANGES])
def test_a_card_or_statement_that_was_changed_is_refused_in_a_sentence(
    tmp_path: Path, change: Callable[[Path], Path], message: str
) -> None:
    path = lg.scene("pendulum").run(0.1).to_npz(tmp_path / "run.npz")
    assert message in refusal(lg.load, change(path))


def _rewritten(path: Path, name: str, content: bytes) -> Path:
    """Return an archive with changed bytes of one array."""
    second = path.with_name("other.npz")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(second, "w") as new:
        for first in old.namelist():
            new.writestr(first, content if first == f"{name}.npy" else old.read(first))
    return second


def _array(shape: Any, kind: str = "<f8", data: bytes = b"") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"shape": shape, "fortran_order": False, "descr": kind})
    return file.getvalue() + data


def test_the_size_of_arrays_is_known_before_they_are_made(tmp_path: Path) -> None:
    path = lg.scene("pendulum").run(0.1).to_npz(tmp_path / "run.npz")
    with pytest.raises(lg.StatementError, match=r"bytes together, and a run from a file may have .* of 1e\+03 bytes"):
        arrays_of(path, 1e3)
    claims: list[tuple[Any, ...]] = [((2, 10**12),), ((2, -1),), ((2, 1), "|O"), ((2, 3), "<f8", b"\0" * 47)]
    for claim in claims:
        with pytest.raises(lg.StatementError, match=r"is not a file that solution.to_npz wrote \(.*(array|Object|neg)"):
            lg.load(_rewritten(path, "y", _array(*claim)))
    for content in (b"", b"\x93NUMPY\x09\x00", b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 500):
        with pytest.raises(lg.StatementError, match=r"is not a file that solution\.to_npz wrote"):
            lg.load(_rewritten(path, "y", content))


def test_files_with_any_bytes_changed_are_read_or_refused(tmp_path: Path) -> None:
    path = lg.scene("pendulum").run(0.1).to_npz(tmp_path / "run.npz")
    content, chance = path.read_bytes(), random.Random(11)
    for number in range(200):
        changed = bytearray(content)
        for _ in range(chance.choice((1, 2, 30))):
            changed[chance.randrange(len(changed))] = chance.randrange(256)
        path.write_bytes(changed[: chance.randrange(len(changed))] if number % 5 == 0 else changed)
        caught = Caught()
        with caught:
            lg.load(path)
        assert caught.error is None or isinstance(caught.error, lg.StatementError), (number, caught.error)


def test_characters_on_which_a_terminal_acts_are_refused(tmp_path: Path) -> None:
    path = lg.scene("pendulum").run(0.1).to_npz(tmp_path / "run.npz")
    for name in ("message", "method", "form"):
        with pytest.raises(lg.StatementError, match=f"its {name} is .*, which has control characters") as refusal:
            lg.load(_card_with(path, **{name: "\x1b[31mred"}))
        assert str(refusal.value).isprintable()
    with pytest.raises(lg.StatementError, match=r"name is .*, which has control characters"):
        lg.load(_statement_with(path, '"pendulum"', r'"\u001b[31mred"'))
    for name in ("about", "source"):
        with pytest.raises(lg.StatementError, match=f"{name} contains a control character"):
            lg.load(_statement_with(path, f'\n{name} = "', f'\n{name} = "\\u001b[31m'))
