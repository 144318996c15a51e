"""Programs: what is malformed is refused, what is right prints, and the tables of operations are complete."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import pytest

from lagrange.errors import LagrangeError
from lagrange.machine.kernel.arithmetic import OPERATIONS
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import LIBRARY, spell
from lagrange.procedure.form import OPERATIONS as KINDS
from lagrange.program.program import ARITY, Instruction, Program, ProgramBlock

I = Instruction
SOUND = Program(
    name="sound",
    inputs=(ProgramBlock("q", 1), ProgramBlock("v", 1)),
    parameters=1,
    instructions=(
        I("parameter", place=0),
        I("constant", value=0.1),
        I("mul", (0, 1)),
        I("state", place=0),
        I("state", place=1),
        I("time"),
        I("fma", (2, 3, 5)),
        I("factor", (3, 1, 4), order=2),
        I("solve", (7, 6, 4), order=2),
        I("component", (8,), 1),
    ),
    hoisted=3,
    outputs=(9, 6, 9),
    results=(ProgramBlock("a", 1), ProgramBlock("b", 2)),
    shape=(3,),
)


def changed(i: int, instruction: Instruction) -> tuple[Instruction, ...]:
    return (*SOUND.instructions[:i], instruction, *SOUND.instructions[i + 1 :])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"instructions": changed(6, I("fuse", (2, 3, 5)))}, "%6 has the unknown operation fuse"),
        ({"instructions": changed(6, I("fma", (2, 3)))}, "%6 = fma has 2 operands"),
        ({"instructions": changed(6, I("fma", (2, 3, 6)))}, "%6 = fma reads a later result"),
        ({"instructions": changed(6, I("fma", (2, 3, 9)))}, "%6 = fma reads a later result"),
        ({"instructions": changed(6, I("fma", (2, 3, -1)))}, "%6 = fma reads a later result"),
        ({"instructions": changed(5, I("time", (0,)))}, "%5 = time has 1 operands"),
        ({"instructions": changed(7, I("factor", (3, 1), order=2))}, "%7 factors a matrix of order 2 from 2 entries"),
        (
            {"instructions": changed(8, I("solve", (7, 6), order=2))},
            "%8 solves a system of order 2 with 1 right-hand sides",
        ),
        ({"hoisted": 4}, "%3 = state is hoisted but depends on the state"),
        ({"hoisted": 6}, "is hoisted but depends on the state"),
        ({"shape": (2,)}, r"3 outputs do not fill the shape \(2,\)"),
        ({"outputs": (9, 6, 10)}, "an output is not a result"),
        ({"outputs": (9, 6, -1)}, "an output is not a result"),
        (
            {"instructions": changed(7, I("factor", (3, 1, 4), order=2, negative=(1, 2)))},
            r"%7 = factor of order 2 has the pivots \[1, 2\] below zero",
        ),
        ({"instructions": changed(6, I("fma", (2, 3, 5), negative=(0,)))}, "%6 = fma of order 0 has the pivots"),
        ({"instructions": changed(4, I("state", place=2))}, "%4 = state 2 is not there"),
        ({"instructions": changed(0, I("parameter", place=-1))}, "%0 = parameter -1 is not there"),
        ({"results": (ProgramBlock("a", 2),)}, r"3 outputs do not fill a\[2\]"),
        (
            {"results": (ProgramBlock("q", 1), ProgramBlock("b", 2))},
            r"\['q', 'v', 'q', 'b'\] do not name its inputs and results",
        ),
        ({"results": (ProgramBlock("a", 1), ProgramBlock("t", 2))}, "do not name its inputs and results"),
        ({"results": (ProgramBlock("a", 1), ProgramBlock("b c", 2))}, "do not name its inputs and results"),
        ({"returned": ("c",)}, r"\['c'\] are not among its results"),
        ({"returned": ("b",)}, r"\['a'\] are not returned, and are no inputs"),
    ],
)
def test_a_malformed_program_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(LagrangeError, match=f"program sound is malformed: .*{message}"):
        replace(SOUND, **change)


def test_a_program_prints_every_instruction_with_its_exact_numbers() -> None:
    assert str(SOUND).splitlines() == [
        "sound: t, q[1], v[1], p[1] -> a[1], b[2] as [3]",
        "once per parameters:",
        "  %0 = parameter 0",
        "  %1 = constant 0.10000000000000001",
        "  %2 = mul %0 %1",
        "every time:",
        "  %3 = state 0",
        "  %4 = state 1",
        "  %5 = time",
        "  %6 = fma %2 %3 %5",
        "  %7 = factor 2 %3 %1 %4",
        "  %8 = solve 2 %7 %6 %4",
        "  %9 = component 1 %8",
        "return %9 %6 %9",
    ]


def test_an_indefinite_matrix_says_which_pivots_are_below_zero() -> None:
    assert str(I("factor", (3, 1, 4), order=2, negative=(1,))) == "factor 2 -1 %3 %1 %4"


def test_what_is_saved_is_what_the_rest_reads() -> None:
    assert SOUND.saved == (2,)
    hoisted = Program(
        name="hoisted",
        inputs=(ProgramBlock("q", 1), ProgramBlock("v", 1)),
        parameters=3,
        instructions=(
            *(I("parameter", place=i) for i in range(3)),
            I("mul", (0, 1)),
            I("mul", (1, 2)),
            I("factor", (3, 4, 2), order=2),
            I("sin", (3,)),
            I("state", place=0),
            I("solve", (5, 7, 7), order=2),
            I("component", (8,), 0),
        ),
        hoisted=7,
        outputs=(9,),
        results=(ProgramBlock("a", 1),),
        shape=(1,),
    )
    # The entries of a saved matrix are kept with its factors, to factor it again with pivoting; sin is read by nobody.
    assert hoisted.saved == (3, 4, 5)


LEAVES = {"time", "state", "parameter", "constant"}
SYSTEMS = {"factor", "solve", "component"}


def test_every_operation_is_spelled_for_numpy() -> None:
    assert set(OPERATIONS) == set(ARITY) - LEAVES - SYSTEMS


@pytest.mark.parametrize("lanes", [1, 4])
@pytest.mark.parametrize("op", sorted(set(ARITY) - LEAVES - SYSTEMS))
def test_every_operation_is_spelled_for_llvm(op: str, lanes: int) -> None:
    """On any number of lanes, but for those of the C library: vector routines have names of their own."""
    e, args = Emitter(), [f"%a{i}" for i in range(ARITY[op] or 0)]
    with pytest.raises(NotImplementedError) if lanes > 1 and op in LIBRARY else nullcontext():
        last = spell(e, op, KINDS[op][0][0], args, lanes)
        assert e.lines[-1].startswith(f"  {last} = ")
        assert all(arg in "".join(e.lines) for arg in args)


def test_only_matrices_have_any_number_of_operands() -> None:
    assert {op for op, arity in ARITY.items() if arity is None} == {"factor", "solve"}
