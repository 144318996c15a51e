"""What the builder makes, and what it and the check refuse."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from lagrange.algorithm.outcome import Outcome
from lagrange.errors import LagrangeError
from lagrange.machine.python_source import loaded, source
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import (
    CONSTANT,
    REAL,
    WHOLE,
    Array,
    Each,
    Fold,
    Leave,
    Let,
    Parameter,
    Procedure,
    Record,
    Store,
)
from lagrange.procedure.interpreter import fused, run
from lagrange.procedure.verify import verify

CLOCK = Record.of("Clock", t=REAL, steps=WHOLE)


def gcd() -> Procedure:
    """Euclid's algorithm."""
    p = Builder("gcd", "The greatest common divisor of two positive numbers.")
    a, b = p.given("a", WHOLE), p.given("b", WHOLE)
    larger, smaller = p.variable(a, "larger"), p.variable(b, "smaller")
    with p.repeat(lambda: smaller.value > 0):
        rest = larger.value - (larger.value // smaller.value) * smaller.value
        larger.value = smaller.value
        smaller.value = rest
    p.leave(larger.value)
    return p.finish(WHOLE)


def test_an_algorithm_reads_as_in_the_book() -> None:
    assert run(gcd(), 54, 24) == (6,)
    assert source(gcd()) == (
        "def gcd(a, b):\n"
        '    """The greatest common divisor of two positive numbers."""\n'
        "    larger = a\n"
        "    smaller = b\n"
        "    while smaller > 0:\n"
        "        x13 = larger - _quotient(larger, smaller) * smaller\n"
        "        larger = smaller\n"
        "        smaller = x13\n"
        "    return larger\n"
    )


def broken(build: Callable[[Builder], Any]) -> str:
    """Return what is said of a procedure."""

    def whole() -> None:
        p = Builder("broken", "A malformed procedure.")
        build(p)
        p.finish()

    with pytest.raises(LagrangeError) as caught:
        whole()
    return str(caught.value)


def python_if(p: Builder) -> None:
    if p.given("x", REAL) > 0:
        p.note("never")


def wrong_kind(p: Builder) -> None:
    memory = p.array("memory")
    memory[0] = p.whole(1)


def mixed_kinds(p: Builder) -> None:
    p.given("x", REAL) + p.given("n", WHOLE)


def written_where_read(p: Builder) -> None:
    p.array("memory", read=True)[0] = 1.0


def from_another_way(p: Builder) -> None:
    x = p.given("x", REAL)
    with p.when(x < 0):
        y = x + 1.0
    p.leave(y + 1.0)


def without_results(p: Builder) -> None:
    with p.when(p.given("x", REAL) < 0):
        p.leave(1.0)
    p.finish(REAL)


def behind_the_end(p: Builder) -> None:
    x = p.given("x", REAL)
    p.leave()
    x + 1.0


def unknown_field(p: Builder) -> None:
    p.record("clock", CLOCK).hour = 1.0


def set_in_a_turn(p: Builder) -> None:
    memory = p.array("memory")
    total = p.variable(0.0)
    with p.each(3) as i:
        total.value = memory[i]


def decided_in_a_turn(p: Builder) -> None:
    memory = p.array("memory")
    with p.each(3) as i, p.when(memory[i] < 0):
        memory[i] = 0.0


def stored_elsewhere(p: Builder) -> None:
    memory = p.array("memory")
    with p.each(3):
        memory[0] = 1.0


def place_of_a_turn(p: Builder) -> None:
    memory = p.array("memory")
    with p.each(3) as i:
        memory[i] = memory[i + 1]


def sum_without_room(p: Builder) -> None:
    n, memory = p.given("n", WHOLE), p.array("memory")
    with p.each(n) as i:
        p.sum(memory[i])


def sum_outside(p: Builder) -> None:
    p.sum(p.given("x", REAL))


def turn_in_a_turn(p: Builder) -> None:
    with p.each(3), p.each(3):
        p.note("never")


def too_few_arguments(p: Builder) -> None:
    p.call(gcd(), 3)


def two_procedures_of_one_name(p: Builder) -> None:
    p.call(gcd(), 3, 4)
    p.call(gcd(), 5, 6)


def late_parameter(p: Builder) -> None:
    p.given("x", REAL) + 1.0
    p.given("y", REAL)


def two_of_one_name(p: Builder) -> None:
    p.given("x", REAL)
    p.given("x", REAL)


def late_otherwise(p: Builder) -> None:
    with p.when(p.given("x", REAL) < 0) as ways:
        p.note("below")
    p.note("between")
    with ways.otherwise():
        p.note("above")


def three_at_once(p: Builder) -> None:
    with p.each(6, width=3):
        p.note("again")


def loop_without_end(p: Builder) -> None:
    with p.loop(0, 3, 0):
        p.note("again")


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (python_if, "use `with p.when(...)` and not `if`"),
        (wrong_kind, "a whole stands where a real belongs"),
        (mixed_kinds, "add takes no real, whole"),
        (written_where_read, "is only read"),
        (from_another_way, "is read where it is not known"),
        (without_results, "ends without results"),
        (behind_the_end, "stands behind the end"),
        (unknown_field, "the record Clock has no field hour: it has t, steps"),
        (set_in_a_turn, "sets a variable from outside"),
        (decided_in_a_turn, "has a When"),
        (stored_elsewhere, "stores at another place than its own"),
        (place_of_a_turn, "at a place made of its index"),
        (sum_without_room, "has no room for a whole block"),
        (sum_outside, "outside of `each`"),
        (turn_in_a_turn, "an `each` stands in another"),
        (too_few_arguments, "gives 1 arguments for 2"),
        (two_procedures_of_one_name, "calls different procedures of one name among gcd, gcd"),
        (late_parameter, "comes behind the first statement"),
        (two_of_one_name, "two parameters have one name"),
        (late_otherwise, "right behind the block of its condition"),
        (loop_without_end, "a step that is not above zero"),
        (three_at_once, "an `each` of 3 iterations at once, which are one of (1, 2, 4, 8)"),
    ],
)
def test_what_is_malformed_is_refused(build: Callable[[Builder], Any], said: str) -> None:
    assert said in broken(build)


def folding(op: str, factor: int | None) -> Procedure:
    """Return a procedure that makes one number of one in some way."""
    iterations = Let(1, WHOLE, "constant", (), 3)
    body = iterations, Each(2, 1, (), (Fold(3, op, 0, factor),)), Leave((3,))
    return Procedure("folding", "One number of many.", (Parameter(0, "x", REAL),), (REAL,), body, {})


def test_a_parameter_does_not_hide_a_procedure_of_its_name() -> None:
    p = Builder("twice", "The greatest common divisor, twice.")
    p.leave(2 * p.call(gcd(), p.given("gcd", WHOLE), 24))
    assert loaded(p.finish(WHOLE))(54) == 12


def test_a_constant_of_a_block_is_made_once() -> None:
    p = Builder("constants", "The same number in blocks inside and beside each other.")
    x = p.given("x", REAL)
    with p.when(x < 2.0) as ways:
        total = p.variable(x + 2.0 + 3.0)
        with p.when(x < 3.0):
            total.value = total.value * 3.0
        p.leave(total.value)
    with ways.otherwise():
        p.leave(x - 3.0)
    made = p.finish(REAL)
    assert run(made, 1.0) == (18.0,) and run(made, 2.5) == (-0.5,)
    assert str(made.body).count("data=3.0") == 2 and str(made.body).count("data=2.0") == 1
    assert p.constant(0.0, REAL).ref != p.constant(-0.0, REAL).ref


def test_the_check_does_not_trust_the_builder() -> None:
    good = gcd()
    foreign = Let(99, REAL, "add", (0, 1))
    with pytest.raises(LagrangeError, match="no way to make one number"):
        verify(folding("dot", None))
    for op in ("dot", "add"):
        verify(folding(op, 0 if op == "dot" else None))
    for body in ((foreign, *good.body), (Store(0, 1, 1), *good.body), (*good.body, good.body[-1])):
        with pytest.raises(LagrangeError):
            verify(Procedure(good.name, good.about, good.parameters, good.results, body, {}))


def test_the_largest_magnitude_is_that_of_all_numbers_or_nan() -> None:
    p = Builder("size", "The largest |x|.")
    n, x = p.given("n", WHOLE), p.array("x", room=4, read=True)
    with p.each(n) as i:
        size = p.largest_magnitude(x[i])
    p.leave(size.value, p.magnitude(x[0], x[1]))
    made = p.finish(REAL, REAL)
    for call in (lambda *given: run(made, *given), loaded(made)):
        assert call(3, [2.0, -3.0, 1.0]) == (3.0, 3.0)
        assert call(0, [-0.0, -0.0]) == (0.0, 0.0)
        assert all(math.isnan(value) for value in call(3, [math.inf, math.nan, -2.0]))


def test_a_record_is_memory_that_python_and_machine_code_share() -> None:
    p = Builder("tick", "Take a step in time.")
    h, clock = p.given("h", REAL), p.record("clock", CLOCK)
    clock.t = clock.t + h
    clock.steps = clock.steps + 1
    tick, held = p.finish(), CLOCK.structure(1.0, 4)
    run(tick, 0.25, held)
    assert (held.t, held.steps) == (1.25, 5)


@pytest.mark.parametrize(
    ("a", "b", "c", "expected"),
    [
        (0.1, 10.0, -1.0, 5.551115123125783e-17),  # 0.1 is 5.55e-18 above a tenth
        (1e200, 1e200, -math.inf, -math.inf),
        (1e200, 1e200, 0.0, math.inf),
        (-0.0, 1.0, -0.0, -0.0),
    ],
)
def test_a_fused_product_is_rounded_once(a: float, b: float, c: float, expected: float) -> None:
    found = fused(a, b, c)
    assert found == expected
    assert math.copysign(1.0, found) == math.copysign(1.0, expected)


def test_an_outcome_is_a_whole_like_any_other() -> None:
    p = Builder("told", "Copy numbers unless there are too few, and return an outcome.")
    source_, target, count = p.array("source", read=True), p.given("target", Array()), p.given("count", WHOLE)
    p.leave_if(count < int(Outcome.PAUSED), Outcome.PAUSED)
    p.copy(source_, target, count)
    p.leave(Outcome.DONE)
    procedure = p.finish(WHOLE)
    data = [one.data for one in procedure.body if isinstance(one, Let) and one.op == CONSTANT]
    assert [(type(one), one) for one in data] == [(int, 1), (int, 0)]
    there = [0.0, 0.0]
    assert run(procedure, [1.0, 2.0], there, 0) == (1,)
    assert there == [0.0, 0.0]
    assert run(procedure, [1.0, 2.0], there, 2) == (0,)
    assert there == [1.0, 2.0]
