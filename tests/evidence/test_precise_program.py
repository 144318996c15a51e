"""Programs in multiple precision solve systems whose pivots vanish in their order."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from lagrange.evidence.precise_run import NoValue, evaluate
from lagrange.program.program import Instruction, Program, ProgramBlock


def solving(lower: Sequence[float]) -> Program:
    """Return a program that solves A x = y for two unknowns; `lower` is the triangle of A by rows."""
    code = [Instruction("constant", value=value) for value in lower]
    code.append(Instruction("factor", (0, 1, 2), order=2))
    code += [Instruction("state", place=0), Instruction("state", place=1), Instruction("solve", (3, 4, 5), order=2)]
    code += [Instruction("component", (6,), place=0), Instruction("component", (6,), place=1)]
    return Program("f", (ProgramBlock("y", 2),), 0, tuple(code), 0, (7, 8), (ProgramBlock("x", 2),), (2,))


@pytest.mark.parametrize(
    ("lower", "x"),
    [
        ((4.0, 2.0, 3.0), [-0.125, 0.75]),
        ((0.0, 2.0, 0.0), [1.0, 0.5]),
        ((1e-300, 2.0, 0.0), [1.0, 0.5]),
        ((0.0, 1.0, 5.0), [-3.0, 1.0]),
    ],
)
def test_pivots_that_vanish(lower: Sequence[float], x: list[float]) -> None:
    assert [float(one) for one in evaluate(solving(lower), 0.0, [1.0, 2.0], [])] == x


def test_a_singular_matrix_has_no_solution() -> None:
    with pytest.raises(NoValue, match="a matrix is singular"):
        evaluate(solving((1.0, 1.0, 1.0)), 0.0, [1.0, 2.0], [])
