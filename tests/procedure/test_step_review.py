"""Steps with events as a procedure: interpreter and machine code agree, bit by bit, on runs with events and resets."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest
from sympy import Abs, log, sin

from lagrange.algorithm.events.event_steps import LOOK, event_steps
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.called import CompiledProcedure, compiled
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Callee, Procedure, Record
from lagrange.procedure.interpreter import Span
from lagrange.procedure.interpreter import run as interpret
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from tests.models import model, x, y
from tests.trajectory.runs import run

START = {"x": 0.1, "y": 0.2, "x_dot": 0.3, "y_dot": 0.2}


WRITTEN = (
    *("sign", "near", "remaining", "came", "stayed", "settings", "reals", "counts", "y"),
    *("which", "when", "there", "break_rows", "break_times"),
)


class Compared:
    """Runs a procedure in machine code and in the interpreter, and holds what they give and write to be the same."""

    def __init__(self, procedure: Procedure) -> None:
        self.code: CompiledProcedure = compiled(procedure)
        self.call = self.code.bound()
        self.procedure = procedure
        self.given: dict[str, Any] = {}
        self.codes: list[int] = []
        self.jumps = 0

    def bound(self) -> Compared:
        return self

    def give(self, **arguments: Any) -> None:
        self.call.give(**arguments)
        self.given |= arguments

    def __call__(self) -> Any:
        types = [parameter.type for parameter in self.procedure.parameters]
        args = [self.given[name] for name in self.code.places]
        before = [copied(arg) for arg in args]
        expected = interpret(self.procedure, *map(handed_over, types, args))
        after = [copied(arg) for arg in args]
        for arg, old in zip(args, before, strict=True):
            put_back(arg, old)
        found = self.call()
        assert [found] == list(expected)
        run, review = (self.given_record(name, args) for name in ("event_run", "review"))
        sizes = {"which": review.written, "when": review.written, "there": review.written}
        sizes |= {"break_rows": run.breaks, "break_times": run.breaks}
        for name, place in self.code.places.items():
            if name in WRITTEN:
                count = sizes.get(name)
                assert np.array_equal(args[place][:count], after[place][:count], equal_nan=True), name
            elif isinstance(types[place], Record):
                assert fields(args[place]) == fields(after[place]), name
        self.codes.append(found)
        self.jumps = run.jumps
        return found

    def given_record(self, name: str, args: list[Any]) -> Any:
        return args[self.code.places[name]]


def fields(one: Any) -> list[Any]:
    return [getattr(one, name) for name, _ in one._fields_]


def copied(arg: Any) -> Any:
    """Return an argument as it is now."""
    if isinstance(arg, np.ndarray):
        return arg.copy()
    return type(arg).from_buffer_copy(arg) if isinstance(arg, ctypes.Structure) else arg


def put_back(arg: Any, old: Any) -> None:
    """Let an argument be what it was."""
    if isinstance(arg, np.ndarray):
        arg[...] = old
    elif isinstance(arg, ctypes.Structure):
        for field in arg._fields_:
            setattr(arg, field[0], getattr(old, field[0]))


def handed_over(kind: Any, arg: Any) -> Any:
    """Return an argument for the interpreter."""
    if isinstance(kind, Callee):
        return foreign(kind, arg)
    return arg.reshape(-1) if isinstance(arg, np.ndarray) else arg


def foreign(callee: Callee, place: int) -> Any:
    """Return compiled code as a function for the interpreter, which hands it arrays from places on."""
    numbers: dict[Any, Any] = {REAL: ctypes.c_double, WHOLE: ctypes.c_int64, FLAG: ctypes.c_int32}
    kinds = [ctypes.c_void_p if isinstance(kind, Array) else numbers[kind] for kind in callee.parameters]
    flag = callee.results == (FLAG,)
    code = ctypes.CFUNCTYPE(numbers[callee.results[0]] if callee.results else None, *kinds)(place)

    def function(*args: Any) -> Any:
        found = code(*(address(arg.memory) + 8 * arg.start if isinstance(arg, Span) else arg for arg in args))
        return bool(found) if flag else found

    return function


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "name",
    ["dopri5", "gauss2", pytest.param("rk4", marks=pytest.mark.slow), pytest.param("radau5", marks=pytest.mark.slow)],
)
def test_machine_code_takes_steps_with_events_as_the_interpreter_does(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Crossings, a kink that is halved for, a touch, resets, a count that ends the run, and one without a value."""
    made: list[Compared] = []

    def compare(procedure: Procedure) -> Any:
        if procedure is not event_steps.form():
            return compiled(procedure)
        made.append(Compared(procedure))
        return made[-1]

    monkeypatch.setattr("lagrange.machine.llvm_machine.compiled", compare)
    monkeypatch.setattr("lagrange.trajectory.events.event_loop.WORTH_COMPILING", 0)
    options: dict[str, Any] = {"step": 0.25} if name in ("rk4", "gauss2") else {"rtol": 1e-5, "atol": 1e-5}
    several = [y, event(x.dot, direction=-1), Abs(x) - 0.07, sin(5 * t) - y]
    wall = event(x + 0.1, direction=-1, reset={x.dot: -0.9 * x.dot})
    for last in (event(x, terminal=3), log(x + 0.2), wall):
        end = 7.0 if last is not wall else 20.0
        found = run(model("Henon-Heiles"), end, name, initial=START, events=[*several, last], **options)
        assert min(len(times) for times in found.t_events[:4]) > 0
    assert len(made) == 3 and min(len(one.codes) for one in made) > 0
    assert made[-1].jumps > 2 and LOOK in made[1].codes
