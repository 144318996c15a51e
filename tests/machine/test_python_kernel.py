"""Printed Python gives the results of the interpreter, also for undefined values and zero pivots."""

import itertools
import math
import re
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.compiler import machine
from lagrange.machine.backend import Kernel, SingularMassMatrix
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.kernel.python_kernel import FUNCTIONS, PythonKernel, printed
from lagrange.machine.kernel.straight_lines import LARGEST_IN_PYTHON, StraightLines
from lagrange.machine.python_source import defined
from lagrange.program.program import ARITY, Instruction, Program, ProgramBlock
from tests.models import TARGETS
from tests.operations import operations
from tests.refusals import refusal

x, y, z = lg.coordinates("x y z")
k = lg.parameters("k")


def pendulums(count: int) -> lg.System:
    angles = lg.coordinates(" ".join(f"q{i}" for i in range(count)))
    across = [sum(sp.sin(q) for q in angles[: i + 1]) for i in range(count)]
    down = [-sum(sp.cos(q) for q in angles[: i + 1]) for i in range(count)]
    kinetic = sum(lg.kinetic_energy(1, pair) for pair in zip(across, down, strict=True))
    return lg.System(kinetic=kinetic, potential=9.81 * sum(down), coordinates=list(angles))


def branches() -> lg.System:
    """Return a system with a one-sided spring, a wall, and a force of powers, roots and logarithms."""
    pull = sp.Piecewise((k * x**2, x > 0), (-sp.sqrt(1 - x), True))
    forces = {x: pull - abs(y) * sp.sign(y), y: sp.Min(x, y) + sp.Max(x, sp.atan2(y, 2)) + sp.exp(-(x**2)) + sp.tanh(y)}
    mass = (x.dot**2 + (2 + sp.cos(x)) * y.dot**2 + y.dot * x.dot) / 2
    return lg.System(kinetic=mass, forces=forces, parameters={k: 1.5}, coordinates=[x, y])


SYSTEMS = {
    "2 links": pendulums(2),
    "5 links": pendulums(5),
    "branches": branches(),
    "a line": lg.System(kinetic=x.dot**2),
}
QUANTITIES = ("rhs", "jacobian", "energy", "momenta", "mass_matrix")


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("name", SYSTEMS)
def test_printed_and_interpreted_are_the_same(name: str, quantity: str) -> None:
    """All operations are rounded alike, except functions such as sine, and linear systems."""
    model = SYSTEMS[name].compile(target="numpy")
    kernel = model.kernel(quantity)
    assert isinstance(kernel, PythonKernel)
    interpreted, parameters = InterpretedKernel(kernel.program), model.parameter_array()
    n = model.dimension
    states = np.random.default_rng(1).normal(size=(2 * n, 300))
    with np.errstate(all="ignore"):
        for column in range(0, 300, 37):
            result = kernel(0.3, states[:, column], parameters)
            assert result == pytest.approx(interpreted(0.3, states[:, column], parameters), rel=1e-11, abs=1e-11)
        many, expected = kernel(0.3, states, parameters), interpreted(0.3, states, parameters)
    assert many.shape == expected.shape == (*kernel.program.shape, 300)
    assert many == pytest.approx(expected, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("name", SYSTEMS)
def test_quick_calls_have_the_bits_of_the_kernel(name: str, quantity: str) -> None:
    """Quick calls have the bits of the kernel, for one array or two, with few results or many."""
    model = SYSTEMS[name].compile(target="numpy")
    kernel, parameters, n = model.kernel(quantity), model.parameter_array(), model.dimension
    quick = kernel.quick(parameters)
    assert quick is not None and quick is kernel.quick(parameters.copy())
    for y in np.random.default_rng(4).normal(size=(8, 2 * n)):
        expected = kernel(0.3, y, parameters)
        for result in (quick.whole(0.3, y), quick.parts(np.float64(0.3), y[:n].copy(), y[n:].copy())):
            if result is None:  # where Python raises in a branch that is not taken, or there is no finite value
                assert name == "branches"
                continue
            assert result is not None and result.dtype == float and result.shape == expected.shape
            assert np.array_equal(result, expected) and result.flags.writeable
        wrong: list[Any] = [y[:-1], y.astype(int), y.astype(">f8"), y.tolist(), y[None], np.ma.array(y)]
        assert all(quick.whole(0.3, item) is None for item in wrong)
        y[-1] = math.nan
        assert quick.whole(0, y) is quick.whole(math.inf, y) is quick.parts(0.3, y[:n], y) is None
        assert (quick.whole(0.3, y) is None) == (not np.isfinite(kernel(0.3, y, parameters)).all())


def rows_program() -> Program:
    """Return a program whose results are read later, are output twice, equal an input, or are chosen."""
    code = (
        Instruction("parameter"),
        Instruction("mul", (0, 0)),
        Instruction("state"),
        Instruction("state", place=1),
        Instruction("add", (2, 3)),
        Instruction("mul", (4, 2)),
        Instruction("sub", (5, 4)),
        Instruction("min", (6, 5)),
        Instruction("less", (4, 6)),
        Instruction("select", (8, 7, 4)),
        Instruction("fma", (9, 4, 6)),
        Instruction("sin", (10,)),
        Instruction("mul", (1, 11)),
        Instruction("max", (12, 9)),
    )
    outputs = (5, 13, 2, 11, 11, 10, 1)
    return Program("rows", (ProgramBlock("y", 2),), 1, code, 2, outputs, (ProgramBlock("a", 7),), (7,))


def test_rows_are_written_in_place_where_nothing_reads_them_later() -> None:
    program, parameters = rows_program(), np.array([1.5])
    y = np.random.default_rng(5).normal(size=(2, 333))
    given = y.copy()
    kernel = PythonKernel(program)
    result = kernel(0.0, y, parameters)
    assert result == pytest.approx(InterpretedKernel(program)(0.0, y, parameters), rel=1e-14) and (y == given).all()
    for column in range(0, 333, 50):
        assert kernel(0.0, y[:, column].copy(), parameters) == pytest.approx(result[:, column], rel=1e-14)
    text, buffers = StraightLines(program).columns()
    assert buffers == 4 and "np.add(y0, y1, b0)" in text and "np.multiply(b0, y0, o0)" in text


def test_sines_of_many_angles_are_made_of_the_tangents_of_their_halves(monkeypatch: pytest.MonkeyPatch) -> None:
    """If tangents are fast, sines are computed from them, within two ulps of 1.

    A call for many states must have the digits of calls for single states, as dense output uses both.
    """
    code = (
        *(Instruction("state", place=i) for i in range(3)),
        Instruction("sin", (0,)),
        Instruction("cos", (0,)),
        Instruction("sin", (1,)),
        Instruction("add", (2, 0)),
        Instruction("cos", (6,)),
        Instruction("mul", (3, 4)),
        Instruction("sin", (8,)),
        Instruction("cos", (2,)),
    )
    program = Program("angles", (ProgramBlock("y", 3),), 0, code, 0, (3, 4, 5, 7, 9, 10), (ProgramBlock("a", 6),), (6,))
    y, none = np.random.default_rng(7).normal(size=(3, 500)), np.empty(0)
    y[:, 100:200], y[:, 200:300], y[:, 300:310] = 1e5 * y[:, 100:200], 1e-9 * y[:, 200:300], np.pi
    y[:, 310:313], y[:, 313], y[:, 314] = np.pi / 2, 0.0, -np.pi
    expected = InterpretedKernel(program)(0.0, y, none)
    for fast in (False, True):
        monkeypatch.setattr("lagrange.machine.kernel.python_kernel.tangents_are_fast", lambda fast=fast: fast)
        kernel = PythonKernel(program)
        result = kernel.columns(0.0, [y], none)
        assert np.array_equal(kernel(0.0, y, none), expected)
        assert np.abs(result - expected).max() <= 2 * np.finfo(float).eps
        assert result[2] == pytest.approx(expected[2], rel=1e-15, abs=0.0)  # sines keep their digits near zeros
        assert ("np.tan(" in printed(program)) == fast == ("np.sin(" not in printed(program))
    assert np.isnan(kernel.columns(0.0, [np.full((3, 2), np.inf)], none)).all()


def test_blocks_of_every_length_join(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = SYSTEMS["2 links"].compile(target="numpy").kernel("rhs")
    monkeypatch.setattr("lagrange.machine.kernel.python_kernel.MOST_COLUMNS", 64)
    states = np.random.default_rng(2).normal(size=(4, 200))
    for count in (0, 1, 63, 64, 65, 200):
        result = kernel(np.linspace(0, 1, count), states[:, :count], np.empty(0))
        assert result.shape == (4, count)
        for column in range(0, count, 31):
            assert result[:, column] == pytest.approx(kernel(0.0, states[:, column], np.empty(0)), rel=1e-13)


@pytest.mark.parametrize(
    ("force", "value"),
    [(1 / x, math.inf), (sp.log(x), -math.inf), (sp.sqrt(x - 1), math.nan), (sp.exp(1000 * (x + 1)), math.inf)],
)
def test_what_has_no_value_is_infinite_or_nan(force: Any, value: float) -> None:
    """Python itself raises an error there."""
    model = lg.System(kinetic=x.dot**2 / 2, forces={x: force}).compile(target="numpy", check=False)
    quick = model.kernel("rhs").quick(np.empty(0))
    assert quick is not None and quick.whole(0.0, np.zeros(2)) is None
    alone, many = (model.kernel("rhs")(0.0, np.zeros(shape), np.empty(0)) for shape in (2, (2, 3)))
    assert alone[1] == pytest.approx(value, nan_ok=True) and many[1, 2] == pytest.approx(value, nan_ok=True)


def test_a_singular_matrix_is_named_by_its_column(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lagrange.machine.kernel.python_kernel.MOST_COLUMNS", 64)
    moving = (x.dot**2 + y.dot**2 + 2 * sp.cos(x) * x.dot * y.dot) / 2
    kernel = lg.System(kinetic=moving, coordinates=[x, y], initial={x: 1.0}).compile(target="numpy").kernel("rhs")
    states = np.ones((4, 150))
    states[0, 101] = 0.0
    with pytest.raises(SingularMassMatrix) as caught:
        kernel(0.0, states, np.empty(0))
    assert caught.value.column == 101
    with pytest.raises(SingularMassMatrix):
        kernel(0.0, states[:, 101], np.empty(0))


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_the_source_is_what_runs(quantity: str, target: str) -> None:
    """The printed source runs with only the names that it uses."""
    model = SYSTEMS["branches"].compile(target=target)
    text = model.source(quantity)
    assert text == SYSTEMS["branches"].compile(target="numpy").source(quantity)
    one = defined(text, quantity, {**FUNCTIONS, "np": np})
    many = defined(text, f"{quantity}_columns", {**FUNCTIONS, "np": np})
    state, parameters = np.array([0.3, -0.4, 0.2, 0.6]), model.parameter_array()
    expected = model.kernel(quantity)(0.25, state, parameters)
    result = one(parameters.tolist())(0.25, state.tolist())
    assert np.reshape(result, expected.shape) == pytest.approx(expected, rel=1e-13)
    buffers = int(text.split(" rows b to work with")[0].rsplit(" ", 1)[1])
    out, columns = np.empty((expected.size, 3)), np.tile(state[:, None], 3)
    assert many(parameters.tolist())(np.full(3, 0.25), columns, out, np.empty((buffers, 3)))
    assert out[:, 2] == pytest.approx(expected.ravel(), rel=1e-13)
    assert "k" not in re.findall(r"[A-Za-z_]+", "".join(line for line in text.splitlines() if line[:1] != "#"))


def test_a_source_that_is_not_there_is_told() -> None:
    large = pendulums(LARGEST_IN_PYTHON + 1).compile(target="numpy")
    assert "rhs solves a linear system of 13 unknowns, and at most 12 are printed" in refusal(large.source, "rhs")
    assert "'power' is not a quantity of a model: they are rhs" in refusal(large.source, "power")


# --- functions ------------------------------------------------------------------------------------------------
# Every operation on every machine: against mpmath, at the edges of its domain, and in columns of any width.

SOLVING = ("factor", "solve", "component")
LEAVES = ("time", "state", "parameter", "constant")
OPERATIONS = [op for op in ARITY if op not in SOLVING + LEAVES]
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
    """Return the operation in mpmath. A positive argument in place of a condition means true."""
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
    """Return a mask of equality up to round-off; NaN equals NaN, and infinities have equal signs."""
    close = np.abs(a - b) <= 1e-14 * np.abs(b) + 1e-300
    return (np.isnan(a) & np.isnan(b)) | (a == b) | close


@pytest.mark.few(8)
@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
@pytest.mark.parametrize("op", OPERATIONS)
def test_both_machines_agree_at_the_edges(op: str) -> None:
    points = np.array(list(itertools.product(SPECIAL, repeat=ARITY[op] or 0))).T
    if op == "fma":  # one rounding or two: where a*b overflows, or the sum cancels, they may differ
        product, total = points[0] * points[1], points[0] * points[1] + points[2]
        points = points[:, (np.abs(product) < 1e300) & ~(np.abs(total) < 1e-9 * np.abs(product))]
    reference = run("numpy", op, points)
    result = run("llvm", op, points)
    wrong = ~same(result, reference)
    assert not wrong.any(), (points[:, wrong][:, :3], result[wrong][:3], reference[wrong][:3])
    alone = np.array([run("llvm", op, column) for column in points.T])
    wrong = ~same(alone, reference)
    assert not wrong.any(), (points[:, wrong][:, :3], alone[wrong][:3], reference[wrong][:3])


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


@pytest.mark.few(2)
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
    result = both(0.0, columns, np.empty(0))
    with mpmath.workprec(1200):
        for values, exact in zip(result, (mpmath.sin, mpmath.cos), strict=True):
            expected = [exact(mpmath.mpf(angle)) for angle in angles]
            for angle, value, true in zip(angles, values, expected, strict=True):
                unit = math.ulp(float(true))
                assert abs(mpmath.mpf(value) - true) <= 1.3 * unit, (angle, value)
    alone = np.array([both(0.0, column, np.empty(0)) for column in columns[:, ::17].T]).T
    assert (alone == result[:, ::17]).all() or where in ("huge", "at the end of the range")


def test_sine_of_zero_keeps_its_sign() -> None:
    for zero in (0.0, -0.0):
        for result in (run("llvm", "sin", [zero]), run("llvm", "sin", [[zero] * 9])[4]):
            assert math.copysign(1.0, float(result)) == math.copysign(1.0, zero)
