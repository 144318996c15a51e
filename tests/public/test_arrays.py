"""All arrays given by users obey one rule: states, parameters, times, references."""

import inspect
import itertools
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from lagrange import methods
from lagrange.cli import program as cli
from lagrange.errors import LONGEST_SENTENCE, formula, shown
from tests.public.surface import flow, model, solution, system
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
        columns = np.array([[1.0, 1.0], [1.0, wrong]])
        for given in (columns[:, 1], columns, {"m": 1.0, "k": wrong}):
            assert re.search(words, refusal(model().rhs, 0.0, np.zeros(4), given))


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
    assert re.search(f"t_eval {words}", refusal(lg.integrate, model(), (0.0, 0.1), t_eval=times))
    assert re.search(f"t {words}", refusal(solution().at, times))


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
    assert answer["calls"] > 8_000 // part


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


# --- answers --------------------------------------------------------------------------------------------------
# Tests of unbounded arguments, arguments that were ignored, and errors while a refusal was written.


theta = lg.coordinate("theta")


@cache
def pendulum() -> Any:
    return lg.scene("pendulum")


@cache
def ensemble() -> Any:
    return lg.ensemble(pendulum(), 0.1, {"theta": [0.1, 0.2, 0.3]}, workers=1)


@cache
def run() -> Any:
    return pendulum().run(0.1)


@cache
def compiled() -> Any:
    system = lg.scene("pendulum")
    system.compile("numpy")
    return system


def endless() -> Iterator[str]:
    return itertools.repeat("x")


loose: Any = lg  # calls that the types refuse
loose_model: Any = model
loose_flow: Any = flow
loose_system: Any = system

WRONG_ARGUMENTS: list[tuple[Callable[[], Any], str]] = [
    (lambda: ensemble().explain(99), "member = 99: give a whole number from 0 to 2."),
    (lambda: ensemble().messages["0"], "member is '0' (str): give a number."),
    (lambda: ensemble().messages[1], "member 1 succeeded, so it has no message: ask for a member that did not succeed"),
    (lambda: loose.bifurcation(pendulum(), "m", [1, 2], points="many"), "points is 'many' (str): give a number."),
    (lambda: loose.bifurcation(pendulum(), "m", [1, 2], follow=3), "follow = 3: give True or False."),
    (lambda: loose.race(pendulum(), 0.1, outputs=1e308), "outputs = 1e+308: give a whole number from 1 to 100000."),
    (lambda: lg.poincare(pendulum(), theta, skip=2**63), "skip = 9223372036854775808: give a whole number from 0 to"),
    (lambda: lg.poincare(pendulum(), theta, [{}] * 3, skip=10**8), "the states of 3e+08 points, with those that skip="),
    (lambda: loose.plot(run(), labels=5), "labels are 5: give a text for each of 1 run."),
    (lambda: loose.plot(run(), labels=endless()), "labels has more than 10000 entries: give fewer."),
    (lambda: loose.Model.evaluate(run().model, ["rhs"], [0.0], [0.0]), "name is ['rhs'] (list): give a text."),
    (lambda: run().invariants["enrgy"], "'enrgy' is not an invariant of this system; they are energy. Did you mean 'e"),
    (lambda: run().multipliers["rod"], "'rod' is not a constraint of this system; it has none."),
    (lambda: pendulum().constraint_forces[0], "0 is not a constraint of this system; it has none."),
    (lambda: pendulum().export("c", "a" * 300), "cannot be made (File name too long): name another folder"),
    (lambda: lg.trust_horizon(pendulum(), 0), "the span from 0 to 0 is empty: give an end such as span=10."),
    (lambda: lg.ensemble(pendulum(), 0.1, {"theta": [1.0, 2.0]}, store="\ud800"), "surrogates not allowed"),
    (lambda: run().plot(what=["theta"] * 101), "what = [...] has 101 quantities: one figure shows at most 100."),
    (lambda: pendulum().plot_eigenvalues("m", [*range(10_001)]), "give a list of 1 to 10000 values of m."),
    (lambda: compiled().compile("numpy", check=iter([1])), "give True or False."),
    (lambda: pendulum().export("c", "a\x1b[31m"), "the path 'a\\x1b[31m' has control characters: give another name."),
    (lambda: loose.methods.RK4().integrate({}), "rk4 cannot run"),
    (lambda: lg.targets()["C"], "there is no target 'C'; the targets are c, "),
    (lambda: lg.shape("box", None, ({}, 1, 1)), "an entry of the size of a shape is {}"),
    (lambda: lg.table(sympy.Symbol("q", commutative=False), [0, 1, 2, 3], [0, 1, 0, 1]), "not real"),
    # Parts of arguments, which were accepted and raised Python's errors later.
    (lambda: loose_model().on_same_machine(loose_system().statement, 5), "kept = 5"),
    (lambda: loose_model().mass_matrix([range(10**9)]), "q has 1e+09 entries"),
    (lambda: loose_model().momenta([0.1, 0.2], [0.1, 0.2], [[range(10**9)]]), "the time t has 1e+09"),
    (lambda: loose_model().singular_message(0.0, [[]]), "q has shape"),
    (lambda: loose_model().rhs(0.0, [[1.0, 2.0], [True, 0.0]]), "y has entries of type bool"),
    (lambda: loose_model().rhs(0.0, b"abcd"), "y is the text b'abcd': give real numbers"),
    (lambda: loose_flow()([1.0, 0.0, 0.0, 0.0], 0.0, 0.1, [1.0]), "or a NumPy array of 2 values in the order"),
    (lambda: loose_flow()([[1.0, 0.0, 0.0, 0.0]], 0.0, 0.1), "A flow takes one state; lg.ensemble runs many"),
    (lambda: solution().at(0.5 + 1e-9), "t = 0.500000001 is outside the run, which went from 0 to"),
    (lambda: loose_system().accelerations()["x"], "the keys are the coordinates x and y themselves"),
    (lambda: loose_system().compare({"x": np.zeros(3)}), "give a number"),
]


@pytest.mark.parametrize(("call", "words"), WRONG_ARGUMENTS, ids=[words[:40] for _, words in WRONG_ARGUMENTS])
def test_a_wrong_argument_is_refused_whether_it_is_used_or_not(call: Callable[[], Any], words: str) -> None:
    assert words in refusal(call)


def test_sentences_are_short_where_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """The base class of errors shortens a long sentence in the middle, where the names are."""
    monkeypatch.setattr("lagrange.errors.LONGEST_SENTENCE", 10**9)
    calls: list[Callable[[], Any]] = [
        lambda: lg.scene("pendulums"),
        lambda: pendulum().run(1.0, method="rk5"),
        lambda: lg.methods.tableau([[0]], [2], order=1, name="a" * 1000),
        lambda: lg.System.from_scene("a" * 1000),
        lambda: run().to_csv("a/" * 500 + "b.csv"),
        lambda: run().to_png("a" * 1000),
    ]
    for call in calls:
        with pytest.raises(lg.LagrangeError) as refusal:
            call()
        assert len(str(refusal.value)) <= 400


def test_a_mapping_of_results_is_still_a_mapping() -> None:
    assert "enrgy" not in run().invariants and run().invariants.get("enrgy") is None
    assert 0 not in ensemble().messages and ensemble().messages.get(0) is None


@cache
def deep() -> Any:
    """Return an expression with 600 levels of nesting, which SymPy prints by recursion."""
    made: Any = sympy.Symbol("u")
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(50_000)
    try:
        for _ in range(300):
            made = sympy.Add(sympy.sin(made, evaluate=False), 1, evaluate=False)
        hash(made)
    finally:
        sys.setrecursionlimit(limit)
    return made


DEEP: list[Callable[[Any], Any]] = [
    lambda d: pendulum().run(d),
    lambda d: pendulum().run(0.1, {"theta": d}),
    lambda d: pendulum().run(0.1, method=d),
    lambda d: pendulum().run(0.1, events=[d]),
    lambda d: pendulum().substitute({"m": d}),
    lambda d: lg.grid({"x": (d, 1, 3)}),
    lambda d: run().evaluate(d),
    lambda d: lg.kinetic_energy(d, [d]),
]


@pytest.mark.parametrize("call", DEEP)
def test_an_expression_of_600_levels_is_refused_in_a_sentence(call: Callable[[Any], Any]) -> None:
    message = refusal(call, deep())
    assert "many parts" in message or "nested more than 400 levels deep" in message


def test_values_are_quoted_in_few_words() -> None:
    wide = sympy.Add(*sympy.symbols("s:3000"))
    for value in (deep(), wide, sympy.Integer(10) ** 5000):
        assert len(formula(value)) <= 90 and len(shown(value)) <= 90
    assert formula(theta**2) == "theta(t)**2"


def test_a_message_is_one_printable_sentence() -> None:
    said = str(lg.StatementError("name \x1b[31mred\x07\n is \ud800, " + "word " * 200 + "and what to do."))
    assert said.isprintable() and len(said) <= LONGEST_SENTENCE
    assert said.startswith("name \\x1b[31mred\\x07  is \\ud800, word") and said.endswith("word and what to do.")
    assert str(lg.SceneError("reason", file="a\tb.toml", line=3)) == "a\\tb.toml:3: reason"


def test_words_that_no_command_knows_are_quoted_in_part(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", "pendulum", "b" * 5000]) == 2
    assert len(capsys.readouterr().err.splitlines()[-1]) <= LONGEST_SENTENCE
