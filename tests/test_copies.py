"""Copies, pickles and saved runs of public objects, in this process and in others."""

import copy
import gc
import io
import json
import multiprocessing
import os
import pickle
import random
import sys
import zipfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange.machine.drivers import SeriesDriver
from lagrange.show.files.loaded_run import arrays_of
from lagrange.trajectory.methods.registry import find, names
from tests import systems
from tests.models import g, shared_scene, theta
from tests.public import surface
from tests.public.test_wrong_calls import Caught
from tests.refusals import refusal


@cache
def pendulum() -> lg.System:
    return systems.pendulum()


def bounce() -> lg.Event:
    return lg.event(theta, direction=-1, reset={theta.dot: -0.9 * theta.dot})


@cache
def run(method: str, target: str = "llvm") -> lg.Solution:
    """Return a run with a reset, or a run without events if the method locates none."""
    return pendulum().run(3.0, method=method, events=[bounce(), lg.event(theta.dot)], target=target)


@cache
def a_race() -> lg.Race:
    return lg.race(pendulum(), 1.0, methods=["rk4"], steps=[0.1, 0.05])


EXAMPLES: dict[str, Callable[[], Any]] = {
    **{kind.__name__: make for kind, make in surface.INSTANCES.items()},
    "Event with a reset": bounce,
    "LagrangeError": lambda: lg.LagrangeError("what happened"),
    "RunError": lambda: lg.RunError("what happened"),
    "SceneError": lambda: lg.SceneError("what is wrong", file="a.toml", line=3, column=7),
    "StatementError": lambda: lg.StatementError("what is wrong"),
    "Status": lambda: lg.Status.MAX_WALL,
    "run with resets": lambda: run("taylor"),
    "path of dop853": lambda: run("dop853").trajectory,
    "flow of an implicit method": lambda: lg.flow(pendulum().compile(), method="radau5", rtol=1e-9),
    "status card": lambda: run("taylor").card(),
    "structure": lambda: pendulum().laws.structure,
    "derivation": lambda: pendulum().derivation(),
    "energy drift": lambda: run("taylor").drift,
    "statement": lambda: pendulum().statement,
    "kernel": lambda: pendulum().compile().kernel("energy"),
    "kernel of numpy": lambda: pendulum().compile("numpy").kernel("energy"),
    "series": lambda: pendulum().compile().series()[0],
}
"""One of everything that a user gets hold of: each public class, then what is returned by these."""


def copies(thing: Any) -> list[Any]:
    """Return a copy of each kind."""
    return [pickle.loads(pickle.dumps(thing)), copy.deepcopy(thing), copy.copy(thing)]


@pytest.mark.parametrize("name", EXAMPLES)
def test_everything_is_copied_and_pickled(name: str) -> None:
    thing = EXAMPLES[name]()
    for other in copies(thing):
        assert isinstance(other, type(thing)) or name == "kernel"
        if " at 0x" not in str(thing):
            assert str(other) == str(thing)


@pytest.mark.parametrize("name", names())
def test_every_method_comes_back_equal(name: str) -> None:
    method = find(name)
    assert pickle.loads(pickle.dumps(method)) == copy.deepcopy(method) == copy.copy(method) == method


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5", "verlet", "gauss3", "scipy-dop853"])
def test_a_solution_gives_the_same_numbers(method: str, target: str) -> None:
    solution = run(method, target)
    times = np.linspace(0.0, float(solution.t[-1]), 40)
    for second in copies(solution):
        assert second.message == solution.message
        assert second.status is solution.status
        np.testing.assert_array_equal(second.at(times), solution.at(times))
        np.testing.assert_array_equal(second.energy, solution.energy)
        np.testing.assert_array_equal(second[theta.dot], solution[theta.dot])
        np.testing.assert_array_equal(second.evaluate(theta.ddot * g), solution.evaluate(theta.ddot * g))
        for first, two in zip(second.t_events, solution.t_events, strict=True):
            np.testing.assert_array_equal(first, two)


def test_a_flow_that_was_used_gives_the_same_numbers() -> None:
    flow = lg.flow(pendulum().compile(), method="gauss3", step=0.01)
    end = flow(np.array([2.0, 0.0]), 0.0, 1.0)
    for other in copies(flow):
        np.testing.assert_array_equal(other(np.array([2.0, 0.0]), 0.0, 1.0), end)


def test_a_kernel_that_arrives_compiles_when_it_is_called() -> None:
    kernel: Any = pendulum().compile().kernel("rhs")
    parameters = pendulum().compile().parameter_array()
    other = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(kernel))))
    assert "_kernel" not in vars(other)
    y = np.array([[2.0, 1.0], [0.0, 0.5]])
    np.testing.assert_array_equal(other(0.0, y, parameters), kernel(0.0, y, parameters))
    np.testing.assert_array_equal(other.prepare(parameters), kernel.prepare(parameters))
    assert other.address != 0
    for missing in ("_nothing", "nothing"):
        with pytest.raises(AttributeError, match=missing):
            getattr(other, missing)


def test_digits_of_a_reference_survive() -> None:
    """Numbers of multiple precision belong to a context of mpmath whose classes cannot be pickled."""
    states = a_race().result.reference.states
    assert pickle.loads(pickle.dumps(a_race())).result.reference.states == states
    assert states[0][0]._mpf_[3] > 60  # bits: a double has 53


@pytest.mark.slow
def test_copies_leave_nothing_on_stderr(monkeypatch: pytest.MonkeyPatch) -> None:
    """Incomplete copies of modules were destroyed, with tracebacks of llvmlite on stderr."""
    lost: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    kernel: Any = pendulum().compile().kernel("rhs")
    series = pendulum().compile().series()[0]
    jet = SeriesDriver(pendulum().compile().machine, series.code(8), 8, pendulum().compile().parameter_array())
    for thing in (kernel, series, kernel._module, run("taylor").trajectory):
        copy.deepcopy(thing)
    with pytest.raises(ValueError, match="pickled"):
        copy.deepcopy(jet)  # it points to memory, and nobody gets hold of it
    gc.collect()
    assert not lost


def end_of(solution: lg.Solution) -> tuple[lg.Solution, Any]:
    """Return results of a solution in another process, and of a run there."""
    again = solution.model.statement.name
    return pendulum().run(1.0, method="taylor"), (again, solution.at(0.5), solution.energy[-1])


def moved(flow: Any) -> Any:
    return flow(np.array([2.0, 0.0]), 0.0, 1.0)


@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")  # of a library with threads, if a test has imported one
@pytest.mark.parametrize("start", [pytest.param("spawn", marks=pytest.mark.slow), "fork"])
def test_solutions_and_flows_go_to_a_pool_and_come_back(start: str) -> None:
    solution, flow = run("taylor"), lg.flow(pendulum().compile(), method="dop853")
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(start)) as pool:
        other, (name, state, energy) = pool.submit(end_of, solution).result()
        end = pool.submit(moved, flow).result()
    assert name == "pendulum"
    np.testing.assert_array_equal(state, solution.at(0.5))
    assert energy == solution.energy[-1]
    np.testing.assert_array_equal(end, moved(flow))
    own = pendulum().run(1.0, method="taylor")
    np.testing.assert_array_equal(other.at(0.7), own.at(0.7))
    np.testing.assert_array_equal(other.evaluate(theta**2), own.evaluate(theta**2))


# --- runs that are saved and loaded ----------------------------------------------------------------------------


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
    run = shared_scene(name).run()
    result = lg.load(run.to_npz(tmp_path / "run.npz")).animate(tmp_path / "run.html")
    expected = run.animate()
    sizes = np.abs(expected.states).max(axis=1, keepdims=True)
    assert (np.abs(result.states - expected.states) <= 1e-4 * sizes + 1e-12).all()
    assert [*result.points] == [*expected.points] and "interpolated" in result.notes[0]


@pytest.mark.parametrize("span", [(0.0, 8.0), (8.0, 0.0)])
def test_a_run_with_few_outputs_moves_from_its_file_too(span: tuple[float, float], tmp_path: Path) -> None:
    system = shared_scene("pendulum")
    run = lg.integrate(system.compile(), span, {"theta": 2.0}, t_eval=np.linspace(*span, 3))
    result, expected = lg.load(run.to_npz(tmp_path / "run.npz")).animate(), run.animate()
    np.testing.assert_allclose(result.states, expected.states, rtol=0, atol=1e-4 * np.abs(expected.states).max())


def test_an_older_file_moves_from_its_outputs_unless_they_are_too_far_apart(tmp_path: Path) -> None:
    run = shared_scene("double-pendulum").run(5.0)
    steps = lg.load(without_states_between(run.to_npz(tmp_path / "steps.npz"))).animate()
    np.testing.assert_allclose(steps.states, run.animate().states, rtol=0, atol=1e-4)
    few = lg.load(without_states_between(run.sampled([0.0, 1.0, 5.0]).to_npz(tmp_path / "few.npz")))
    assert "the states at t = 0 and 1 are too far apart for a moving pi" in refusal(few.animate, tmp_path / "few.html")
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


def _with_history(path: Path, values: tuple[int, int], added: int) -> Path:
    arrays = {"history_values": np.zeros(values), "history_added": np.zeros(added)}
    return _changed(path, history_begins=np.zeros(1), **arrays)


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    shared_scene("pendulum").run(0.1).to_npz(path)
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
    (partial(_changed, statement=np.array('{"form": 1, "nodes": []}')), "its statement is JSON, as development versio"),
    (partial(_changed, card=np.array("[" * 100_000)), "is not a run that to_npz wrote (RecursionError"),
    (partial(_changed, statement=np.array("a = " + "[" * 100_000)), "the file is nested too deeply"),
    (partial(_changed, history_begins=np.zeros(1)), "it lacks history_values and history_added"),
    (partial(_with_history, values=(1, 9), added=1), "it has (9,) parameters after events, not those of its system"),
    (
        partial(_with_history, values=(1, 9), added=2),
        "arrays of a history have the shapes (1,) (begins), (1, 9) (v",
    ),
    (
        partial(_with_history, values=(2, 9), added=1),
        "arrays of a history have the shapes (1,) (begins), (2, 9) (v",
    ),
]


@pytest.mark.parametrize(("change", "message"), CHANGES, ids=[message[:30] for _, message in CHANGES])
def test_a_card_or_statement_that_was_changed_is_refused_in_a_sentence(
    tmp_path: Path, change: Callable[[Path], Path], message: str
) -> None:
    path = shared_scene("pendulum").run(0.1).to_npz(tmp_path / "run.npz")
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
    path = shared_scene("pendulum").run(0.1).to_npz(tmp_path / "run.npz")
    with pytest.raises(lg.StatementError, match=r"bytes together, and a run from a file may have .* of 1e\+03 bytes"):
        arrays_of(path, 1e3)
    claims: list[tuple[Any, ...]] = [((2, 10**12),), ((2, -1),), ((2, 1), "|O"), ((2, 3), "<f8", b"\0" * 47)]
    for claim in claims:
        with pytest.raises(lg.StatementError, match=r"is not a file that solution.to_npz wrote \(.*(array|Object|neg)"):
            lg.load(_rewritten(path, "y", _array(*claim)))
    for content in (b"", b"\x93NUMPY\x09\x00", b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 500):
        assert "is not a file that solution.to_npz wrote" in refusal(lg.load, _rewritten(path, "y", content))


def test_files_with_any_bytes_changed_are_read_or_refused(tmp_path: Path) -> None:
    path = shared_scene("pendulum").run(0.1).to_npz(tmp_path / "run.npz")
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
    path = shared_scene("pendulum").run(0.1).to_npz(tmp_path / "run.npz")
    for name in ("message", "method", "form"):
        with pytest.raises(lg.StatementError, match=f"its {name} is .*, which has control characters") as refusal:
            lg.load(_card_with(path, **{name: "\x1b[31mred"}))
        assert str(refusal.value).isprintable()
    with pytest.raises(lg.StatementError, match=r"name is .*, which has control characters"):
        lg.load(_statement_with(path, '"pendulum"', r'"\u001b[31mred"'))
    for name in ("about", "source"):
        with pytest.raises(lg.StatementError, match=f"{name} contains a control character"):
            lg.load(_statement_with(path, f'\n{name} = "', f'\n{name} = "\\u001b[31m'))
