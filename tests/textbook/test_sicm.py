"""The derivation against equations printed in Structure and Interpretation of Classical Mechanics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import sympy

from lagrange.equations.derivation import derive
from lagrange.statement.coordinate import acceleration_of, coordinate, t, velocity_of
from lagrange.statement.declare import declare

DATA = json.loads((Path(__file__).parent / "references.json").read_text("utf-8"))
CASES = DATA["cases"]
POTENTIAL = sympy.Lambda(sympy.Symbol("s"), -sympy.Symbol("mu") / sympy.Symbol("s") + sympy.Symbol("s") ** 2)
"""Stands for the book's undefined U(r), which a statement must write out."""


class Reader:
    """Reads the book's expressions, in which xd and xdd are the derivatives of x."""

    def __init__(self, names: list[str]) -> None:
        self.names = names
        s = sympy.Symbol("s")
        r = sympy.sqrt(sum(sympy.Symbol(name) ** 2 for name in names[:2]))
        self.slope = POTENTIAL(s).diff(s).subs(s, r)
        self.table: dict[Any, Any] = {sympy.Symbol("t"): t}
        for name in names:
            q = coordinate(name)
            self.table |= {
                sympy.Symbol(name): q,
                sympy.Symbol(f"{name}d"): velocity_of(q),
                sympy.Symbol(f"{name}dd"): acceleration_of(q),
            }

    def __call__(self, text: str) -> Any:
        words = {"U": POTENTIAL, "V": POTENTIAL, "UP": self.slope, "A": sympy.Symbol("A"), "C": sympy.Symbol("C")}
        return sympy.sympify(text, locals=words).doit().xreplace(self.table)


def prepare(case: dict[str, Any]) -> tuple[Reader, list[Any], Any]:
    read = Reader(case["q"])
    qs = [coordinate(name) for name in case["q"]]
    statement = declare(name=case["name"], kinetic=read(case["T"]), potential=read(case["V"]), coordinates=qs)
    return read, qs, derive(statement)


def having(key: str) -> pytest.MarkDecorator:
    cases = [case for case in CASES if key in case["reference"]]
    return pytest.mark.parametrize("case", cases, ids=[case["name"] for case in cases])


def same(found: Any, printed: Any) -> bool:
    return bool(sympy.simplify(found - printed) == 0)


@having("eom")
def test_equations_of_motion(case: dict[str, Any]) -> None:
    read, _, derivation = prepare(case)
    for equation, printed in zip(derivation.equations, case["reference"]["eom"], strict=True):
        assert equation.rhs == 0
        assert same(equation.lhs, read(printed)), printed


@having("acc")
def test_accelerations(case: dict[str, Any]) -> None:
    read, qs, derivation = prepare(case)
    for q, printed in zip(qs, case["reference"]["acc"], strict=True):
        assert same(derivation.accelerations[q], read(printed)), printed


@having("p")
def test_momenta_and_energy(case: dict[str, Any]) -> None:
    read, qs, derivation = prepare(case)
    for q, printed in zip(qs, case["reference"]["p"], strict=True):
        assert same(derivation.momenta[q], read(printed)), printed
    assert same(derivation.energy, read(case["reference"]["energy"]))


def test_every_case_is_used() -> None:
    assert len(CASES) >= 9
    assert all({"eom", "acc", "p"} & set(case["reference"]) for case in CASES)
