"""A program with fewer operations computes the same."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.program.program import Instruction, Program, ProgramBlock
from lagrange.program.simplify import LARGEST, LONGEST, operations, simplified

STATES = 4


def program(*code: Instruction, outputs: tuple[int, ...]) -> Program:
    """Return a program of one parameter, which is first, and of four states, which follow."""
    given = (Instruction("parameter"), *(Instruction("state", place=i) for i in range(STATES)))
    size = len(outputs)
    return Program(
        "made", (ProgramBlock("y", STATES),), 1, (*given, *code), 1, outputs, (ProgramBlock("a", size),), (size,)
    )


def results(of: Program) -> Any:
    with np.errstate(all="ignore"):
        return InterpretedKernel(of)(0.3, np.random.default_rng(3).normal(size=(STATES, 50)), np.array([1.7]))


P, U, V, W, X = range(5)


def test_what_cancels_is_not_computed() -> None:
    """p x (u - v) + (p v x + w), as the derivative of an angle between two links gives, is p x u + w."""
    given = program(
        Instruction("sub", (U, V)),  # 5
        Instruction("mul", (P, X)),
        Instruction("mul", (6, 5)),
        Instruction("mul", (P, V)),
        Instruction("fma", (8, X, W)),
        Instruction("add", (7, 9)),  # 10
        outputs=(10,),
    )
    found = simplified(given)
    assert operations(given) == 7 and operations(found) == 3
    assert results(found) == pytest.approx(results(given), rel=1e-13)
    assert [one.op for one in found.instructions[found.hoisted :] if one.op != "state"].count("sub") == 0


@pytest.mark.parametrize("first", [1, -1])
@pytest.mark.parametrize("second", ["add", "sub"])
def test_what_does_not_cancel_stays(first: int, second: str) -> None:
    """Of four sums of x (u - v) and x v with signs, two are x u or -x u."""
    turned = Instruction("neg", (6,)) if first < 0 else Instruction("add", (6, W))
    given = program(
        Instruction("sub", (U, V)),
        Instruction("mul", (X, 5)),
        turned,
        Instruction("mul", (V, X)),
        Instruction(second, (7, 8)),
        outputs=(9,),
    )
    found = simplified(given)
    assert results(found) == pytest.approx(results(given), rel=1e-13, abs=1e-13)
    code = found.instructions
    differs = any(one.op == "sub" and all(code[arg].op == "state" for arg in one.args) for one in code)
    assert differs == ((first > 0) != (second == "add"))


def test_signs_go_where_they_cost_nothing() -> None:
    """-(u - v) is v - u, -p u has -p computed once, and a sum of two negatives is the negative of a sum."""
    given = program(
        Instruction("sub", (U, V)),  # 5
        Instruction("neg", (5,)),
        Instruction("mul", (P, U)),
        Instruction("neg", (7,)),
        Instruction("constant", value=-0.5),
        Instruction("mul", (9, W)),  # 10
        Instruction("neg", (X,)),
        Instruction("add", (10, 11)),
        Instruction("neg", (12,)),
        Instruction("abs", (11,)),
        outputs=(6, 8, 13, 14),
    )
    found = simplified(given)
    assert operations(found) == 5 and (results(found) == results(given)).all()
    assert "neg" not in [one.op for one in found.instructions[found.hoisted :]]


def test_a_sum_that_vanishes_is_zero() -> None:
    given = program(
        Instruction("sub", (U, V)),
        Instruction("add", (5, V)),
        Instruction("sub", (6, U)),
        Instruction("mul", (7, X)),
        outputs=(8,),
    )
    assert results(simplified(given)) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("seed", range(40))
def test_random_programs_compute_the_same(seed: int) -> None:
    """Of operations on earlier results, most of them sums and products of inputs that recur."""
    rng = np.random.default_rng(seed)
    code: list[Instruction] = []
    names = {"add": 2, "sub": 2, "mul": 2, "neg": 1, "fma": 3, "div": 2, "abs": 1, "cos": 1, "sin": 1, "max": 2}
    chosen = rng.choice(list(names), size=30, p=[0.2, 0.2, 0.2, 0.12, 0.08, 0.04, 0.04, 0.04, 0.04, 0.04])
    for k, op in enumerate(chosen.tolist()):
        here = len(code) + 1 + STATES
        args = tuple(int(arg) for arg in rng.integers(max(0, here - 9) if k % 2 else 0, here, names[op]))
        code.append(Instruction(op, args))
    last = 1 + STATES + len(code)
    given = program(*code, outputs=(last - 1, last - 2, last - 7, last - 12))
    found, expected = results(simplified(given)), results(given)
    finite = np.isfinite(expected) & (np.abs(expected) < 1e6)
    assert operations(simplified(given)) <= operations(given)
    assert found[finite] == pytest.approx(expected[finite], rel=1e-6, abs=1e-6)


def test_the_double_pendulum_has_no_products_that_cancel() -> None:
    """27 operations without the sharing, and 20 with it; a chain of five has 206 and 165."""
    kernel = lg.scene("double-pendulum").compile(target="numpy").kernel("rhs")
    assert operations(kernel.program) >= 27 and operations(simplified(kernel.program)) <= 20


def test_long_programs_and_long_sums_are_left_alone() -> None:
    long = program(*(Instruction("neg", (i,)) for i in range(5 - 1, 4 + LARGEST)), outputs=(LARGEST,))
    assert simplified(long) is long
    sums = [Instruction("sin", (U,))]
    for k in range(3 * LONGEST):
        sums += [Instruction("mul", (5 + 2 * k, U)), Instruction("add", (6 + 2 * k, V))]
    wide = program(*sums, outputs=(5 + 6 * LONGEST,))
    assert results(simplified(wide)) == pytest.approx(results(wide), rel=1e-12)
