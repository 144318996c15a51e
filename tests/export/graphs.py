"""Random expression graphs as exported modules; each operation is compared with mpmath and with this package."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Sequence
from typing import Any

import mpmath

from lagrange.algorithm.kernel.body import PreparedLayout
from lagrange.algorithm.kernel.kernels import kernel, prepare
from lagrange.export.module import ExportedQuantity, SourceModule, ValueNames
from lagrange.export.straight_line import with_outputs
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.interpreter import OPERATIONS
from lagrange.program.program import ARITY, Instruction, Program, ProgramBlock
from tests.operations import operations

STATES = 4
LENGTH = 14
"""Operations of a graph."""

CONDITIONS = {"less": 0, "less_equal": 0, "equal": 0, "and": 2, "or": 2, "not": 1}
"""Operations that give conditions, and how many of their operands are conditions."""
LEAVES = ("time", "state", "parameter", "constant", "factor", "solve", "component")
SPECIAL = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 5e-324, -1e-310, 1e300, -1e308, 3e5, 1.0000001)


def graph(seed: int, without: Sequence[str] = ()) -> Program:
    """Return a program of random operations on inputs and earlier results; every number is an output."""
    rng = random.Random(seed)
    code = [Instruction("state", place=k) for k in range(STATES)]
    code.append(Instruction("constant", value=rng.uniform(-3, 3)))
    code.append(Instruction("less", (0, 1)))
    names = [op for op in ARITY if op not in (*LEAVES, *without)]
    for _ in range(LENGTH):
        op = rng.choice(names)
        holds = 1 if op == "select" else CONDITIONS.get(op, 0)
        flags = [k for k, item in enumerate(code) if item.op in CONDITIONS]
        reals = [k for k, item in enumerate(code) if item.op not in CONDITIONS]
        args = [rng.choice(flags if place < holds else reals[-6:]) for place in range(ARITY[op] or 0)]
        code.append(Instruction(op, tuple(args)))
    return _with_results(f"graph_{seed}", code)


def _with_results(name: str, code: Sequence[Instruction]) -> Program:
    outputs = tuple(range(STATES, len(code)))
    values = (ProgramBlock("values", len(outputs)),)
    return Program(name, (ProgramBlock("y", STATES),), 0, tuple(code), 0, outputs, values, (len(outputs),))


def edges(without: Sequence[str] = ()) -> Program:
    """Return a program with each operation on one or two numbers, applied to the first inputs."""
    code = [Instruction("state", place=k) for k in range(STATES)]
    for op, arity in ARITY.items():
        if op not in (*LEAVES, *without, "and", "or", "not") and arity in (1, 2):
            code.append(Instruction(op, tuple(range(arity))))
    return _with_results("edges", code)


def points(seed: int, count: int) -> list[list[float]]:
    """Return inputs: ordinary numbers, zeros, infinities and NaN."""
    rng = random.Random(seed)
    return [
        [rng.choice(SPECIAL) if rng.random() < 0.25 else rng.uniform(-2, 2) for _ in range(STATES)]
        for _ in range(count)
    ]


def as_module(programs: Sequence[Program], more: Sequence[Procedure] = (), name: str = "graphs") -> SourceModule:
    """Return a module that consists of programs without parameters and other procedures."""
    prepared, first = PreparedLayout.of(programs), with_outputs(programs[0], programs[0].instructions, (0,))
    made = [(item, kernel(item, prepared, item.name, "Random operations.")) for item in programs]
    made += [(programs[0], item) for item in more]
    quantities = [
        ExportedQuantity(
            item.name, item.about, program, item, tuple(f"r{k}" for k in range(_results(item))), (_results(item),)
        )
        for program, item in made
    ]
    return SourceModule(
        name=name,
        statement=("random operations",),
        state=tuple(f"y{k}" for k in range(STATES)),
        parameters=(),
        values=(),
        units={},
        names=ValueNames(tuple(f"y{k}" for k in range(STATES)), (), ("first",), first),
        prepare=prepare(prepared, "Nothing depends on parameters."),
        prepared=prepared.size,
        quantities=tuple(quantities),
    )


def _results(procedure: Procedure) -> int:
    (out,) = (item.type for item in procedure.parameters if item.name == "out")
    size = getattr(out, "size", None)
    assert isinstance(size, int)
    return size


def wrong(program: Program, y: Sequence[float], result: Sequence[float]) -> Iterator[str]:
    """Yield the operations with an error above 4 ulp, or whose result is NaN or infinite unlike ours."""
    values: list[Any] = [*y, *result]
    for ref in range(STATES, len(program.instructions)):
        one, value = program.instructions[ref], values[ref]
        args = [values[arg] for arg in one.args]
        holds = 1 if one.op == "select" else CONDITIONS.get(one.op, 0)
        args = [bool(arg) if place < holds else arg for place, arg in enumerate(args)]
        expected = one.value if one.op == "constant" else OPERATIONS[one.op](*args)
        if one.op == "fma" and not abs(args[0] * args[1]) < 1e300:
            continue  # the product overflows where it is rounded by itself
        if not _near(one.op, args, value, float(expected)):
            yield f"{program.name}, {one.op}{tuple(args)} = {value!r} instead of {float(expected)!r}"


def _near(op: str, args: Sequence[Any], value: float, ours: float) -> bool:
    if not math.isfinite(ours):
        return value == ours or (math.isnan(value) and math.isnan(ours))
    if value == ours:
        return True
    if any(isinstance(arg, float) and not math.isfinite(arg) for arg in args) or (op == "atan2" and not args[0]):
        return abs(value - ours) <= 4 * math.ulp(ours)  # mpmath has no signed zeros, and few limits
    with mpmath.workdps(60):
        exact = operations(mpmath)[op](*(arg if isinstance(arg, bool) else mpmath.mpf(arg) for arg in args))
        size = abs(args[0] * args[1]) + abs(args[2]) if op == "fma" else abs(float(exact))
        return bool(abs(value - exact) <= 4 * math.ulp(float(size)))


def rarer() -> Procedure:
    """Return a procedure with operations that occur in no program, applied to y[0] and y[1]."""
    p = Builder("rarer", "Operations of integrators.")
    p.given("t", REAL)
    y, _, out = p.array("y", size=STATES, read=True), p.array("p", size=1, read=True), p.array("out", size=8)
    a, b = y[0], y[1]
    out[0], out[1] = p.operation("round", a), p.operation("copysign", a, b)
    out[2] = p.real(p.operation("exponent", a))
    out[3], out[4] = p.operation("mantissa", a), p.operation("magnitude", a, b)
    whole = p.operation("whole", b)
    out[5] = p.real(whole)
    out[6] = p.real(p.operation("quotient", whole, 3))
    out[7] = p.operation("two_to", whole)
    p.leave(p.false)
    return p.finish(FLAG)


def rarer_results(a: float, b: float) -> list[float]:
    """Return the reference results of `rarer`."""
    ops, whole = OPERATIONS, int(b)
    return [
        ops["round"](a),
        ops["copysign"](a, b),
        float(ops["exponent"](a)),
        ops["mantissa"](a),
        ops["magnitude"](a, b),
        float(whole),
        float(ops["quotient"](whole, 3)),
        ops["two_to"](whole),
    ]
