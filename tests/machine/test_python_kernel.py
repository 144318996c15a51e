"""Printed Python computes what the interpreter does, also where there is no value and where pivots vanish."""

from __future__ import annotations

import copy
import math
import pickle
import re
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.kernel.python_kernel import FUNCTIONS, PythonKernel
from lagrange.machine.kernel.python_text import WRITTEN_OUT, fits, scalar_source
from lagrange.machine.python_source import defined
from lagrange.program.program import Instruction, Program, ProgramBlock

x, y, z = lg.coordinates("x y z")
k = lg.parameters("k")


def pendulums(count: int) -> lg.System:
    angles = lg.coordinates(" ".join(f"q{i}" for i in range(count)))
    across = [sum(sp.sin(q) for q in angles[: i + 1]) for i in range(count)]
    down = [-sum(sp.cos(q) for q in angles[: i + 1]) for i in range(count)]
    kinetic = sum(lg.kinetic_energy(1, pair) for pair in zip(across, down, strict=True))
    return lg.System(kinetic=kinetic, potential=9.81 * sum(down), coordinates=list(angles))


def branches() -> lg.System:
    """A spring that pulls one way, a wall, and a force by powers, roots and logarithms."""
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
    """Each operation is rounded alike but for sines and the like, and what is divided by a matrix."""
    model = SYSTEMS[name].compile(target="numpy")
    kernel = model.kernel(quantity)
    assert isinstance(kernel, PythonKernel)
    interpreted, parameters = InterpretedKernel(kernel.program), model.parameter_array()
    n = model.dimension
    states = np.random.default_rng(1).normal(size=(2 * n, 300))
    with np.errstate(all="ignore"):
        for column in range(0, 300, 37):
            found = kernel(0.3, states[:, column], parameters)
            assert found == pytest.approx(interpreted(0.3, states[:, column], parameters), rel=1e-11, abs=1e-11)
        many, expected = kernel(0.3, states, parameters), interpreted(0.3, states, parameters)
    assert many.shape == expected.shape == (*kernel.program.shape, 300)
    assert many == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_blocks_of_every_length_join(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = SYSTEMS["2 links"].compile(target="numpy").kernel("rhs")
    monkeypatch.setattr("lagrange.machine.kernel.python_kernel.MOST_COLUMNS", 64)
    states = np.random.default_rng(2).normal(size=(4, 200))
    for count in (0, 1, 63, 64, 65, 200):
        found = kernel(np.linspace(0, 1, count), states[:, :count], np.empty(0))
        assert found.shape == (4, count)
        for column in range(0, count, 31):
            assert found[:, column] == pytest.approx(kernel(0.0, states[:, column], np.empty(0)), rel=1e-13)


@pytest.mark.parametrize(
    ("force", "value"),
    [(1 / x, math.inf), (sp.log(x), -math.inf), (sp.sqrt(x - 1), math.nan), (sp.exp(1000 * (x + 1)), math.inf)],
)
def test_what_has_no_value_is_infinite_or_nan(force: Any, value: float) -> None:
    """Python raises there."""
    model = lg.System(kinetic=x.dot**2 / 2, forces={x: force}).compile(target="numpy", check=False)
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


@pytest.mark.parametrize("hoisted", [True, False])
def test_pivots_of_multipliers_are_below_zero(hoisted: bool) -> None:
    """A particle held on a plane: [[m, g], [g, 0]] (a, l) = (f, 0)."""
    first = Instruction("parameter") if hoisted else Instruction("state")
    code = (
        first,
        Instruction("constant", value=2.0),
        Instruction("constant", value=0.0),
        Instruction("factor", (0, 1, 2), order=2, negative=(1,)),
        Instruction("state", place=1),
        Instruction("solve", (3, 4, 2), order=2),
        Instruction("component", (5,)),
        Instruction("component", (5,), place=1),
    )
    program = Program(
        "held", (ProgramBlock("q", 2),), 1, code, 4 if hoisted else 0, (6, 7), (ProgramBlock("a", 2),), (2,)
    )
    kernel, parameters = PythonKernel(program), np.array([3.0])
    for given in (np.array([3.0, 5.0]), np.array([[3.0, 3.0], [5.0, 6.0]])):
        assert kernel(0.0, given, parameters)[0] == pytest.approx(0.0, abs=1e-15)
        assert kernel(0.0, given, parameters)[1] == pytest.approx(given[1] / 2)
    # Without inertia no pivot can be trusted, and the interpreter still finds the answer.
    assert kernel(0.0, np.array([0.0, 5.0]), np.array([0.0])) == pytest.approx([0.0, 2.5])


def test_a_large_system_is_interpreted() -> None:
    assert fits(pendulums(3).compile(target="numpy").kernel("rhs").program) and WRITTEN_OUT >= 10
    order = WRITTEN_OUT + 1
    entries = tuple(range(order * (order + 1) // 2))
    code = (*(Instruction("state", place=i) for i in entries), Instruction("factor", entries, order=order))
    assert not fits(
        Program("wide", (ProgramBlock("q", len(entries)),), 0, code, 0, (0,), (ProgramBlock("a", 1),), (1,))
    )


def test_the_source_is_made_of_our_own_names() -> None:
    """Whatever coordinates are called, and whatever numbers are in the statement."""
    odd = sp.Symbol("k")
    system = lg.System(kinetic=x.dot**2 / 2, potential=odd * x**2 * sp.Float("0.1"), parameters={odd: 2.0})
    text = scalar_source(system.compile(target="numpy").kernel("rhs").program)
    assert "k" not in text.replace("k in", "") and "x.dot" not in text and text.startswith("def rhs(p):\n    p0, = p\n")


def test_copies_compute_the_same() -> None:
    kernel = SYSTEMS["branches"].compile(target="numpy").kernel("rhs")
    state, parameters = np.array([0.3, -0.2, 1.0, 0.5]), np.array([1.5])
    expected = kernel(0.0, state, parameters)
    for twin in (copy.deepcopy(kernel), pickle.loads(pickle.dumps(kernel))):
        assert np.array_equal(twin(0.0, state, parameters), expected)


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_the_source_is_what_runs(quantity: str, target: str) -> None:
    """It is run as it stands, with nothing but the names that it speaks of."""
    model = SYSTEMS["branches"].compile(target=target)
    text = model.source(quantity)
    assert text == SYSTEMS["branches"].compile(target="numpy").source(quantity)
    one = defined(text, quantity, {**FUNCTIONS, "np": np})
    many = defined(text, f"{quantity}_columns", {**FUNCTIONS, "np": np})
    state, parameters = np.array([0.3, -0.4, 0.2, 0.6]), model.parameter_array()
    expected = model.kernel(quantity)(0.25, state, parameters)
    found = one(parameters.tolist())(0.25, state.tolist())
    assert np.reshape(found, expected.shape) == pytest.approx(expected, rel=1e-13)
    buffers = int(text.split(" rows b to work with")[0].rsplit(" ", 1)[1])
    out, columns = np.empty((expected.size, 3)), np.tile(state[:, None], 3)
    assert many(parameters.tolist())(np.full(3, 0.25), columns, out, np.empty((buffers, 3)))
    assert out[:, 2] == pytest.approx(expected.ravel(), rel=1e-13)
    assert "k" not in re.findall(r"[A-Za-z_]+", "".join(line for line in text.splitlines() if line[:1] != "#"))


def test_a_source_that_is_not_there_is_told() -> None:
    large = pendulums(WRITTEN_OUT + 1).compile(target="numpy")
    with pytest.raises(lg.StatementError, match="rhs solves a linear system of 13 unknowns, which is not printed: 12"):
        large.source("rhs")
    with pytest.raises(lg.StatementError, match="'power' is no quantity of a model: they are rhs"):
        large.source("power")
