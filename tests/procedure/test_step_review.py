"""The review of steps as a procedure: interpreter and machine code agree, bit by bit, on runs with events."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest
from sympy import Abs, log, sin

from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.called import CompiledProcedure, compiled
from lagrange.procedure.form import Array, Callee, Procedure
from lagrange.procedure.interpreter import Span
from lagrange.procedure.interpreter import run as interpret
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from tests.models import model, x, y
from tests.trajectory.runs import run

START = {"x": 0.1, "y": 0.2, "x_dot": 0.3, "y_dot": 0.2}


class Compared:
    """Runs a procedure in machine code and in the interpreter, and holds what they give and write to be the same."""

    def __init__(self, procedure: Procedure) -> None:
        self.code: CompiledProcedure = compiled(procedure)
        self.procedure = procedure
        self.given: dict[str, Any] = {}
        self.calls: list[tuple[Any, ...]] = []

    def words(self) -> Any:
        return self.code.words()

    def give(self, words: Any, arguments: dict[str, Any]) -> None:
        self.code.give(words, arguments)
        self.given |= arguments

    def run_on(self, words: Any) -> Any:
        args = [self.given[name] for name in self.code.places]
        copies: list[Any] = [arg.copy() if isinstance(arg, np.ndarray) else arg for arg in args]
        types = [parameter.type for parameter in self.procedure.parameters]
        expected = interpret(self.procedure, *map(handed_over, types, copies))
        found = self.code.run_on(words)
        assert found == tuple(expected)
        for name, place in self.code.places.items():
            if name in ("sign", "near", "remaining", "which", "where", "when", "there"):
                count = found[1] if name in ("which", "where", "when", "there") else None
                assert (args[place][:count] == copies[place][:count]).all(), name
        self.calls.append(found)
        return found


def handed_over(kind: Any, arg: Any) -> Any:
    """Return an argument for the interpreter."""
    if isinstance(kind, Callee):
        return foreign(kind, arg)
    return arg.reshape(-1) if isinstance(arg, np.ndarray) else arg


def foreign(callee: Callee, place: int) -> Any:
    """Return compiled code as a function for the interpreter, which hands it arrays from places on."""
    kinds = [ctypes.c_void_p if isinstance(kind, Array) else ctypes.c_int64 for kind in callee.parameters]
    code = ctypes.CFUNCTYPE(ctypes.c_int64 if callee.results else None, *kinds)(place)

    def function(*args: Any) -> Any:
        return code(*(address(arg.memory) + 8 * arg.start if isinstance(arg, Span) else arg for arg in args))

    return function


@pytest.mark.parametrize("name", ["dopri5", "rk4", "gauss2"])
def test_machine_code_reviews_steps_as_the_interpreter_does(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Crossings, a kink that is halved for, a touch, a count that ends the run, and one without a value."""
    made: list[Compared] = []

    def compare(procedure: Procedure) -> Compared:
        made.append(Compared(procedure))
        return made[-1]

    monkeypatch.setattr("lagrange.machine.events.llvm_review.compiled", compare)
    monkeypatch.setattr("lagrange.trajectory.events.compiled_review.WORTH_COMPILING", 0)
    options: dict[str, Any] = {"rtol": 1e-5, "atol": 1e-5} if name == "dopri5" else {"step": 0.25}
    several = [y, event(x.dot, direction=-1), Abs(x) - 0.07, sin(5 * t) - y]
    for last in (event(x, terminal=3), log(x + 0.2), y - 5):
        found = run(model("Henon-Heiles"), 7.0, name, initial=START, events=[*several, last], **options)
        assert min(len(times) for times in found.t_events[:4]) > 0
    assert len(made) == 3 and sum(found[1] for one in made for found in one.calls) > 10
