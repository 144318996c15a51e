"""All arrays given by users obey one rule: states, parameters, times, references."""

from __future__ import annotations

import inspect
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange import methods
from tests.public.audit import MARK, TEXT
from tests.public.surface import flow, model, solution
from tests.refusals import refusal

WRONG: list[tuple[Any, str]] = [
    (np.array([1j, 0.0]), "complex128"),
    (np.array(["1", "2"]), "<U1"),
    (["1", "2"], "<U1"),
    (np.array([True, False]), "bool"),
    ([True, 1.0], "bool"),
    (np.array([1.0, 2.0], dtype=object), "object"),
    (np.ma.array([1.0, 2.0], mask=[False, True]), "is a masked array"),
]

PLACES: dict[str, Callable[[Any], Any]] = {
    "q": lambda a: model().energy(a, [0.0, 0.0]),
    "v": lambda a: model().momenta([0.0, 0.0], a),
    "y": lambda a: model().rhs(0.0, _twice(a)),
    "y0": lambda a: flow()(_twice(a), 0.0, 0.1),
    "parameters of a model": lambda a: model().rhs(0.0, np.zeros(4), _array(a)),
    "parameters of a flow": lambda a: flow()(np.zeros(4), 0.0, 0.1, _array(a)),
    "t": lambda a: model().rhs(a, np.zeros((4, 2))),
    "t_eval": lambda a: lg.integrate(model(), (0.0, 2.0), method="rk4", t_eval=a),
    "at": lambda a: solution().at(a),
    "reference": lambda a: lg.race(model(), 0.1, {"x": 1.0}, methods=["rk4"], steps=[0.01], reference=_twice(a)),
}


def _array(a: Any) -> Any:
    return a if isinstance(a, np.ndarray) else np.array(a) if isinstance(a[0], str) else np.array(a, dtype=bool)


def _twice(a: Any) -> Any:
    if isinstance(a, list):
        return a * 2
    return np.ma.array([1.0] * 4, mask=[True] * 4) if isinstance(a, np.ma.MaskedArray) else np.concatenate([a, a])


@pytest.mark.parametrize("place", PLACES)
def test_what_is_no_array_of_real_numbers_is_refused_wherever_it_enters(place: str) -> None:
    for value, word in WRONG:
        assert word in refusal(PLACES[place], value)


def test_a_parameter_array_says_no_more_than_a_dict_may() -> None:
    for wrong, words in (
        (np.nan, "parameter k is nan"),
        (-1.0, "parameter k is -1, but its symbol was declared positi"),
    ):
        for given in (np.array([1.0, wrong]), {"m": 1.0, "k": wrong}):
            with pytest.raises(lg.StatementError, match=words):
                model().rhs(0.0, np.zeros(4), given)


@pytest.mark.parametrize("wrong", [0, False, "", [], ()])
def test_only_none_and_an_empty_dict_stand_for_the_defaults(wrong: Any) -> None:
    with pytest.raises(lg.StatementError):
        model().rhs(0.0, np.zeros(4), wrong)
    with pytest.raises(lg.StatementError):
        lg.integrate(model(), (0.0, 0.1), wrong)
    assert model().rhs(0.0, np.ones(4), {}).shape == (4,)


@pytest.mark.parametrize("times", [np.broadcast_to(0.05, 10**9), range(10**9)])
def test_a_billion_times_are_refused_with_their_size(times: Any) -> None:
    words = "has 1e.09 entries, which takes 29.8 GiB of memory: give fewer at once"
    with pytest.raises(lg.StatementError, match=f"t_eval {words}"):
        lg.integrate(model(), (0.0, 0.1), t_eval=times)
    with pytest.raises(lg.StatementError, match=f"t {words}"):
        solution().at(times)


@pytest.mark.parametrize("wrong", [False, (0.0, 1.0), "1", None, np.array([1.0, 2.0])])
def test_options_of_a_trust_horizon(wrong: Any) -> None:
    loose: Any = lg.trust_horizon
    with pytest.raises(lg.StatementError):
        loose(model(), (0.0, 1.0), wrong if wrong is not None else 3)
    with pytest.raises(lg.StatementError, match="error is"):
        loose(model(), (0.0, 1.0), error=wrong)
    if wrong is not False:
        with pytest.raises(lg.StatementError, match=r"relative = .*: give True or False"):
            loose(model(), (0.0, 1.0), relative=wrong)


def test_a_picture_has_dots_to_draw_with_and_a_path_a_length() -> None:
    loose: Any = solution()
    with pytest.raises(lg.StatementError, match="dpi = 1: give a whole number from 10 to 1200"):
        solution().to_png("never.png", dpi=1)
    with pytest.raises(lg.RunError, match="File name too long"):
        solution().to_folder("a" * 100_000)
    with pytest.raises(lg.StatementError, match=r"the path is 3 \(int\): give the path"):
        loose.to_csv(3)


def test_a_method_that_returns_no_trajectory_is_told_so() -> None:
    class Own:
        name, claims = "own", lg.Claims(order=1)

        def integrate(self, problem: lg.Problem) -> Any:
            return {"t": problem.t0}

    with pytest.raises(
        lg.StatementError, match=r"method own returned {'t': 0.0}: integrate\(\) must return an lg.Traj"
    ):
        lg.flow(model(), method=Own())(np.zeros(4), 0.0, 0.1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"t": [1.0]}, "a trajectory has t of shape (1,) and y of shape"),
        ({"y": np.zeros((4, 6)) * 1j}, "y of a trajectory has entries of type complex128"),
        ({"status": "success"}, "a trajectory has the status 'success'"),
        ({"dense": None}, "and the dense output None: give"),
        ({"span": None}, "a trajectory has the span None: give its first and last time"),
    ],
)
def test_a_trajectory_is_checked_when_it_is_made(change: dict[str, Any], words: str) -> None:
    assert words in refusal(lg.Trajectory, **{**vars(solution().trajectory), **change})


# --- text -----------------------------------------------------------------------------------------------------
# No text of a user's is ever run: every public callable, every argument, every container.

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_no_text_is_run_whatever_it_is_in(tmp_path: Path, everything: bool) -> None:
    part = 1 if everything else 120
    result = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.public.audit", str(part)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"},
        check=True,
    )
    answer = json.loads(result.stdout)
    assert answer["wrong"] == []
    assert answer["canary"] == []
    assert answer["calls"] > 10_000 // part


@pytest.mark.parametrize("call", [
    lambda x: lg.rotational_energy([TEXT], [x.dot]),
    lambda x: lg.rotational_energy(1, [TEXT]),
    lambda x: lg.rotational_energy([[TEXT]], [x.dot]),
    lambda x: lg.kinetic_energy(1, [TEXT]),
    lambda x: lg.kinetic_energy(TEXT, [x]),
    lambda x: lg.gravity(1, [x], TEXT),
    lambda x: lg.spring(1, [x], [0], TEXT),
])  # fmt: skip
def test_text_in_an_energy_is_refused(call: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert callable(call)
    with pytest.raises(lg.StatementError, match="is the text '__import__"):
        call(lg.coordinate("x"))
    assert not (tmp_path / MARK).exists()


# --- docstrings -----------------------------------------------------------------------------------------------
# Docstrings of the public surface say what a call raises, and name nothing that is not there.

CLASSES = (lg.System, lg.Solution, lg.Race)
"""Classes whose methods say it one by one; that of Model says once what all of its methods raise."""
LINKED = re.compile(r"`((?:System|Model|Solution|Race)\.\w+|lagrange\.\w+|lg\.\w+)(?:\(\w*\))?`")


def calls() -> Iterator[tuple[str, Any]]:
    """Yield all public functions and methods with parameters, by name."""
    for module, names in ((lg, lg.__all__), (methods, methods.__all__)):
        for name in names:
            thing = getattr(module, name)
            if inspect.isfunction(thing) and name[0].islower():
                yield name, thing
    for kind in CLASSES:
        for name, thing in inspect.getmembers(kind, callable):
            if not name.startswith("_"):
                yield f"{kind.__name__}.{name}", thing


def takes_something(thing: Any) -> bool:
    return bool(set(inspect.signature(thing).parameters) - {"self", "cls"})


@pytest.mark.parametrize("thing", [pytest.param(thing, id=name) for name, thing in calls() if takes_something(thing)])
def test_a_call_that_takes_something_says_what_it_raises(thing: Any) -> None:
    assert re.search(r"\b[Rr]aise[sd]?\b|Error\b", inspect.getdoc(thing) or "")


def test_the_names_that_docstrings_refer_to_are_there() -> None:
    texts = [inspect.getdoc(thing) or "" for _, thing in calls()]
    named = {name for text in texts for name in LINKED.findall(text)}
    assert len(named) > 5
    for name in sorted(named):
        home, _, member = name.rpartition(".")
        assert hasattr(lg if home in ("lg", "lagrange") else getattr(lg, home), member), name
