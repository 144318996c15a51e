"""The same text is compiled once in a process, and what is kept of it is bounded."""

from __future__ import annotations

from typing import Any

import pytest

from lagrange.machine.llvm import engine
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.object_code import ObjectCode
from tests.models import build, c, k, m, x

TEXT = "define double @f(double %a) {\n  %b = fadd double %a, 1.0\n  ret double %b\n}\n"


def test_a_system_that_is_stated_again_is_not_compiled_again(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[str] = []
    emitting: Any = engine._compiled

    def noted(text: str, *how: object) -> bytes:
        compiled.append(text)
        return bytes(emitting(text, *how))

    monkeypatch.setattr(engine, "COMPILED", ObjectCode())
    monkeypatch.setattr(engine, "_compiled", noted)

    def rates(stiffness: Any) -> list[float]:
        made = build(kinetic=m * x.dot**2 / 2, potential=stiffness * x**2 / 2, forces={x: -c * x.dot})
        return [float(rate) for rate in made.rhs(0.0, [0.5, 0.25])]

    first, count = rates(k), len(compiled)
    assert rates(k) == first and len(compiled) == count > 0
    assert rates(2 * k) != first and len(compiled) > count


def test_each_way_of_compiling_has_its_code(monkeypatch: pytest.MonkeyPatch) -> None:
    ways: list[tuple[object, ...]] = []
    emitting: Any = engine._compiled
    monkeypatch.setattr(engine, "COMPILED", ObjectCode())

    def noted(text: str, *how: object) -> bytes:
        ways.append(how)
        return bytes(emitting(text, *how))

    monkeypatch.setattr(engine, "_compiled", noted)
    for _ in range(2):
        for how in ([], ["quickly"], ["optimize"], ["merge"], ["optimize", "quickly"]):
            assert Module(TEXT, **dict.fromkeys(how, True)).address("f")
    assert len(ways) == len(set(ways)) == 5


def test_what_is_kept_is_bounded_and_the_oldest_goes_first() -> None:
    made: list[str] = []
    kept = ObjectCode(room=250)

    def compiled(text: str) -> bytes:
        made.append(text)
        return text.encode() * 100

    def ask(text: str) -> bytes:
        return kept.of(text, "", lambda: compiled(text))

    assert [ask(text) for text in "abab"] == [text.encode() * 100 for text in "abab"] and made == ["a", "b"]
    for text in "aca":
        ask(text)
    assert made == ["a", "b", "c"], "a was asked for after b, which goes"
    ask("b")
    assert made == ["a", "b", "c", "b"]
    assert ask("wide") == b"wide" * 100, "what is larger than the room is not kept, and comes all the same"
    kept.forget()
    ask("b")
    assert made[4:] == ["wide", "b"]
