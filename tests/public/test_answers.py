"""Tests of unbounded arguments, arguments that were ignored, and errors while a refusal was written."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import sympy

import lagrange as lg
from lagrange.cli import program as cli
from lagrange.errors import LONGEST_SENTENCE, formula, shown
from tests.refusals import refusal

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

WRONG: list[tuple[Callable[[], Any], str]] = [
    (lambda: ensemble().explain(99), "member = 99: give a whole number from 0 to 2."),
    (lambda: ensemble().explain(-1), "member = -1: give a whole number from 0 to 2."),
    (lambda: ensemble().messages["0"], "member is '0' (str): give a number."),
    (lambda: ensemble().messages[1], "member 1 succeeded: the messages are of members that did not."),
    (lambda: loose.bifurcation(pendulum(), "m", [1, 2], points="many"), "points is 'many' (str): give a number."),
    (lambda: loose.bifurcation(pendulum(), "m", [1, 2], rtol="tight"), "rtol is 'tight' (str): give a number."),
    (lambda: loose.bifurcation(pendulum(), "m", [1, 2], follow=3), "follow = 3: give True or False."),
    (lambda: loose.bifurcation(pendulum(), "m", [1, 2], method="rk5"), "there is no method 'rk5'"),
    (lambda: loose.race(pendulum(), 0.1, digits="x", reference=[0, 0]), "digits is 'x' (str): give a number."),
    (lambda: loose.race(pendulum(), 0.1, outputs=1e308), "outputs = 1e+308: give a whole number from 1 to 100000."),
    (lambda: lg.poincare(pendulum(), theta, skip=2**63), "skip = 9223372036854775808: give a whole number from 0 to"),
    (
        lambda: lg.poincare(pendulum(), theta, [{}] * 3, skip=10**8),
        "the states of 3e+08 points, with those that skip= leaves",
    ),
    (lambda: loose.plot(run(), labels=5), "labels are 5: give a text for each of 1 run."),
    (lambda: loose.plot(run(), labels=endless()), "labels has more than 10000 entries: give fewer."),
    (lambda: loose.Model.evaluate(run().model, ["rhs"], [0.0], [0.0]), "name is ['rhs'] (list): give a text."),
    (lambda: run().invariants["enrgy"], "'enrgy' is not an invariant of this system; they are energy. Did you mean 'e"),
    (lambda: run().multipliers["rod"], "'rod' is not a constraint of this system; it has none."),
    (lambda: pendulum().constraint_forces[0], "0 is not a constraint of this system; it has none."),
    (lambda: pendulum().export("c", "a" * 300), "cannot be made (File name too long): name another folder"),
    (lambda: lg.trust_horizon(pendulum(), 0), "the span from 0 to 0 is empty: give an end such as span=10."),
    (lambda: lg.ensemble(pendulum(), 0.1, {"theta": [1.0, 2.0]}, store="\ud800"), "surrogates not allowed"),
    (lambda: run().plot(what=["theta"] * 101), "what lists 101 quantities: one figure shows at most 100."),
    (lambda: pendulum().plot_eigenvalues("m", [*range(10_001)]), "values of m, at least 1 and at most 10000."),
    (lambda: loose.System(theta.dot**2).compile("numpy", check=iter([1])), "give True or False."),
    (lambda: compiled().compile("numpy", check=iter([1])), "give True or False."),
    (lambda: pendulum().export("c", "a\x1b[31m"), "the path 'a\\x1b[31m' has control characters: give another name."),
]


@pytest.mark.parametrize(("call", "words"), WRONG, ids=[words[:40] for _, words in WRONG])
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
    lambda d: pendulum().run(0.1, rtol=d),
    lambda d: pendulum().run(0.1, {"theta": d}),
    lambda d: pendulum().run(0.1, {d: 1.0}),
    lambda d: pendulum().run(0.1, method=d),
    lambda d: pendulum().run(0.1, events=[d]),
    lambda d: pendulum().substitute({"m": d}),
    lambda d: lg.grid({"x": (d, 1, 3)}),
    lambda d: run().evaluate(d),
    lambda d: lg.kinetic_energy(d, [d]),
]


@pytest.mark.parametrize("call", DEEP)
def test_an_expression_of_600_levels_is_refused_in_a_sentence(call: Callable[[Any], Any]) -> None:
    with pytest.raises(lg.StatementError) as refusal:
        call(deep())
    assert "many parts" in str(refusal.value) or "nested more than 400 levels deep" in str(refusal.value)


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


@pytest.mark.parametrize("command", ["run", "export", "new"])
def test_a_folder_with_a_name_of_300_letters(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = {
        "run": ["run", "pendulum", "--t-end", "0.1"],
        "export": ["export", "pendulum", "--target", "c"],
        "new": ["new", "mine"],
    }
    assert cli.main([*words[command], "--out", str(tmp_path / ("a" * 300))]) == 2
    said = capsys.readouterr().err
    assert "File name too long" in said and len(said) < LONGEST_SENTENCE + 20


def test_words_that_no_command_knows_are_quoted_in_part(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", "pendulum", "b" * 5000]) == 2
    assert len(capsys.readouterr().err.splitlines()[-1]) <= LONGEST_SENTENCE
