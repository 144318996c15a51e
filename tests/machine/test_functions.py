"""Every operation on every machine: against mpmath, at the edges of its domain, and in columns of any width."""

from __future__ import annotations

import itertools
import math
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest

from lagrange.compiler import machine
from lagrange.machine.backend import Kernel
from lagrange.program.program import ARITY, Instruction, Program, ProgramBlock
from tests.models import TARGETS
from tests.operations import operations

SYSTEMS = ("factor", "solve", "component")
LEAVES = ("time", "state", "parameter", "constant")
OPERATIONS = [op for op in ARITY if op not in SYSTEMS + LEAVES]
LOGIC = ("and", "or", "not")
WIDTHS = (1, 2, 7, 8, 9, 64)
SPECIAL = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 5e-324, -1e-310, 1e-300, 1e300, -1e308, 3e5)


def program_of(op: str, hoisted: bool = False) -> Program:
    """Return a program of one operation on the first entries of the state, or of the parameters."""
    leaf = "parameter" if hoisted else "state"
    arity = ARITY[op] or 0
    code = [Instruction(leaf, place=i) for i in range(arity)]
    args = tuple(range(arity))
    if op in LOGIC or op == "select":  # conditions are made, not given: is the number positive?
        code.append(Instruction("constant"))
        conditions = range(1 if op == "select" else arity)
        code += [Instruction("less", (arity, i)) for i in conditions]
        args = tuple(arity + 1 + i for i in conditions) + args[len(conditions) :]
    code.append(Instruction(op, args))
    return Program(
        name=f"one_{op}",
        inputs=(ProgramBlock("y", 0 if hoisted else arity + arity % 2),),
        parameters=arity if hoisted else 0,
        instructions=tuple(code),
        hoisted=len(code) if hoisted else 0,
        outputs=(len(code) - 1,),
        results=(ProgramBlock("value", 1),),
        shape=(1,),
    )


@cache
def kernel(target: str, op: str, hoisted: bool = False) -> Kernel:
    return machine(target).load(program_of(op, hoisted))


def run(target: str, op: str, columns: Any) -> Any:
    """Return the operation on columns (arity, k), or on one state (arity,)."""
    columns = np.asarray(columns, dtype=float)
    if len(columns) % 2:
        columns = np.concatenate([columns, np.zeros_like(columns[:1])])
    return kernel(target, op)(0.0, columns, np.empty(0))[0]


def samples(op: str, count: int) -> Any:
    """Return ordinary arguments inside the domain, (arity, count)."""
    rng = np.random.default_rng(sum(map(ord, op)))
    low, high = {
        "asin": (-1, 1),
        "acos": (-1, 1),
        "acosh": (1, 9),
        "atanh": (-1, 1),
        "log": (0.01, 9),
        "sqrt": (0, 9),
        "power": (0.1, 3),
    }.get(op, (-4, 4))
    return rng.uniform(low, high, (ARITY[op] or 0, count))


def reference(op: str, *args: Any) -> Any:
    """Return the operation in mpmath; arguments that stand for conditions hold where they are positive."""
    conditions = len(args) if op in LOGIC else 1 if op == "select" else 0
    return operations(mpmath)[op](*(arg > 0 for arg in args[:conditions]), *args[conditions:])


def test_there_is_a_reference_for_every_operation() -> None:
    assert set(operations(mpmath)) == set(OPERATIONS)


@pytest.mark.parametrize("op", OPERATIONS)
@pytest.mark.parametrize("target", TARGETS)
def test_values_in_columns_of_every_width_and_alone(target: str, op: str) -> None:
    points = samples(op, max(WIDTHS))
    with mpmath.workdps(40):
        expected = np.array([float(reference(op, *map(mpmath.mpf, column))) for column in points.T])
    slack = 1e-15 if op == "fma" else 0.0  # in two roundings a sum may cancel
    for width in WIDTHS:
        assert run(target, op, points[:, :width]) == pytest.approx(expected[:width], rel=1e-15 * 4, abs=slack)
    alone = [float(run(target, op, column)) for column in points.T]
    assert alone == pytest.approx(list(expected), rel=1e-15 * 4, abs=slack)


def same(a: Any, b: Any) -> Any:
    """Equal up to round-off, with NaN equal to NaN and infinities by sign."""
    close = np.abs(a - b) <= 1e-14 * np.abs(b) + 1e-300
    return (np.isnan(a) & np.isnan(b)) | (a == b) | close


@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
@pytest.mark.parametrize("op", OPERATIONS)
def test_both_machines_agree_at_the_edges(op: str) -> None:
    points = np.array(list(itertools.product(SPECIAL, repeat=ARITY[op] or 0))).T
    if op == "fma":  # one rounding or two: where a*b overflows, or the sum cancels, they may differ
        product, total = points[0] * points[1], points[0] * points[1] + points[2]
        points = points[:, (np.abs(product) < 1e300) & ~(np.abs(total) < 1e-9 * np.abs(product))]
    reference = run("numpy", op, points)
    found = run("llvm", op, points)
    wrong = ~same(found, reference)
    assert not wrong.any(), (points[:, wrong][:, :3], found[wrong][:3], reference[wrong][:3])
    alone = np.array([run("llvm", op, column) for column in points.T])
    wrong = ~same(alone, reference)
    assert not wrong.any(), (points[:, wrong][:, :3], alone[wrong][:3], reference[wrong][:3])


@pytest.mark.parametrize("op", [op for op in OPERATIONS if op not in ("less", "less_equal", "equal", *LOGIC, "select")])
@pytest.mark.parametrize("target", TARGETS)
def test_nan_is_never_lost(target: str, op: str) -> None:
    for i in range(ARITY[op] or 0):
        point = samples(op, 9)
        point[i, 5] = np.nan
        found = run(target, op, point)
        assert np.isnan(found[5])
        assert np.isfinite(np.delete(found, 5)).all()
        assert np.isnan(run(target, op, point[:, 5]))


@pytest.mark.parametrize("op", OPERATIONS)
@pytest.mark.parametrize("target", TARGETS)
def test_work_on_parameters_alone_is_done_once_and_gives_the_same(target: str, op: str) -> None:
    for point in samples(op, 5).T:
        hoisted = kernel(target, op, hoisted=True)(0.0, np.empty(0), point)[0]
        assert hoisted == pytest.approx(float(run(target, op, point)), rel=1e-15, abs=1e-15)


ANGLES = {
    "small": np.geomspace(1e-320, 1.0, 400),
    "ordinary": np.linspace(-40.0, 40.0, 4001),
    "around multiples of a right angle": np.array(
        [k * np.pi / 2 * (1 + j * 2.0**-52) for k in range(1, 600) for j in (-2, -1, 0, 1, 2)]
    ),
    "large": np.geomspace(40.0, 2.0**20 - 1, 3000),
    "at the end of the range": 2.0**20 + np.linspace(-3.0, 3.0, 601),
    "huge": np.geomspace(2.0**21, 1e308, 200),
}


@pytest.mark.few
@pytest.mark.parametrize("where", ANGLES)
def test_sine_and_cosine_are_good_to_little_more_than_a_unit(where: str, everything: bool) -> None:
    angles = ANGLES[where][:: 1 if everything else 6]
    angles = np.concatenate([angles, -angles])
    code = (Instruction("state"), Instruction("sin", (0,)), Instruction("cos", (0,)))
    program = Program(
        "pair",
        (ProgramBlock("y", 2),),
        0,
        (*code, Instruction("state", place=1)),
        0,
        (1, 2),
        (ProgramBlock("pair", 2),),
        (2,),
    )
    both = machine("llvm").load(program)
    columns = np.stack([angles, np.zeros_like(angles)])
    found = both(0.0, columns, np.empty(0))
    with mpmath.workprec(1200):
        for values, exact in zip(found, (mpmath.sin, mpmath.cos), strict=True):
            expected = [exact(mpmath.mpf(angle)) for angle in angles]
            for angle, value, true in zip(angles, values, expected, strict=True):
                unit = math.ulp(float(true))
                assert abs(mpmath.mpf(value) - true) <= 1.3 * unit, (angle, value)
    alone = np.array([both(0.0, column, np.empty(0)) for column in columns[:, ::17].T]).T
    assert (alone == found[:, ::17]).all() or where in ("huge", "at the end of the range")


def test_sine_of_zero_keeps_its_sign() -> None:
    for zero in (0.0, -0.0):
        for found in (run("llvm", "sin", [zero]), run("llvm", "sin", [[zero] * 9])[4]):
            assert math.copysign(1.0, float(found)) == math.copysign(1.0, zero)
