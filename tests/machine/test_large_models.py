"""Large models compile in time in proportion to their size."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.algorithm.series.packing import pack
from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.graph import rebuild as rebuilding
from lagrange.graph.node import Node
from lagrange.machine.kernel.llvm_module import KernelCode
from lagrange.machine.llvm.emitter import MOST_ACCESSES, Emitter
from lagrange.machine.llvm.engine import lanes
from lagrange.machine.llvm.procedures import INLINE_ANGLES
from lagrange.machine.model import Model
from lagrange.machine.series.interpreted_driver import NumpySeries
from lagrange.machine.series.llvm_driver import CompiledJet
from lagrange.program.catalogue import program_of
from lagrange.program.taylor import series_program


def nested(depth: int) -> lg.System:
    """Return a potential of sines in one another, as written out by hand or by a program."""
    x = lg.coordinate("x")
    inner: Any = x
    for _ in range(depth):
        inner = sp.Add(sp.sin(inner, evaluate=False), sp.Integer(1), evaluate=False)
    return lg.System(kinetic=x.dot**2 / 2, potential=inner, initial={x: 0.3}, name="nested sines")


def chain(count: int) -> lg.System:
    """Return masses in a row between springs that stiffen."""
    q = [lg.coordinate(f"x{i}") for i in range(count)]
    stretch = [a - b for a, b in pairwise(q)]
    return lg.System(
        kinetic=sp.Add(*[x.dot**2 / 2 for x in q]),
        potential=sp.Add(*[d**2 / 2 + d**4 / 4 for d in stretch]),
        initial={q[0]: 0.3},
        name="chain",
    )


def many_angles(count: int) -> lg.System:
    """Return a potential of many harmonics."""
    x = lg.coordinate("x")
    return lg.System(
        kinetic=x.dot**2 / 2,
        potential=sp.Add(*[sp.cos(k * x) / k for k in range(1, count + 1)]),
        initial={x: 0.3},
        name="harmonics",
    )


def accesses(text: str) -> int:
    """Return the most loads and stores in one basic block of some IR."""
    most = now = 0
    for line in text.splitlines():
        now = 0 if line.endswith((":", "{")) else now + ((" load " in line) or line.startswith("  store "))
        most = max(most, now)
    return most


@pytest.fixture(scope="module")
def equations() -> Equations:
    return euler_lagrange(nested(100).statement)


def test_no_block_of_a_series_holds_more_than_llvm_compares_quickly(equations: Equations) -> None:
    """In one block 100 sines took 4 s to compile, 200 took 13 s; what an operand stores before a cut counts too."""
    jet = CompiledJet(pack(series_program(equations)[0], lanes()), 0)
    assert accesses(jet.ir) <= MOST_ACCESSES + 8 * lanes()


def test_a_series_in_many_blocks_is_that_of_the_interpreter(equations: Equations) -> None:
    program = series_program(equations)[0]
    y, none = np.array([0.3, 0.1]), np.empty(0)
    expected = NumpySeries(program).rows(12, 0.0, y, 0.5, none)
    found = CompiledJet(pack(program, lanes()), 0).rows(12, 0.0, y, 0.5, none)
    # Derivatives of 100 sines in one another lose a digit or so: the two sum in another order.
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13)


def test_a_small_function_is_one_block() -> None:
    e = Emitter()
    for i in range(MOST_ACCESSES):
        e.get("%y", i)
    assert "unreachable" not in e.function("define void @f(ptr %y)")
    e.get("%y", 0)
    assert "unreachable" in e.function("define void @f(ptr %y)")


@pytest.mark.parametrize("system", [nested, chain])
def test_the_start_of_a_series_is_built_once(system: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each value used to be built anew from the coordinates up, so that 1,500 sines took two minutes."""
    calls: list[Node] = []
    real = rebuilding.rebuild

    def counted(node: Node, args: Sequence[Node]) -> Node:
        calls.append(node)
        return real(node, args)

    monkeypatch.setattr(rebuilding, "rebuild", counted)
    counts = []
    for size in (20, 80):
        calls.clear()
        series_program(euler_lagrange(system(size).statement))
        counts.append(len(calls))
    assert counts[1] < 5 * counts[0]


def test_replacements_reach_what_was_built_before_them() -> None:
    equations = euler_lagrange(chain(2).statement)
    x, y = equations.q
    a, b, c = (equations.graph.node(n) for n in (2, 3, 5))
    swapped = rebuilding.Substitution()
    inner, outer = x + y, (x + y) * x
    assert swapped(outer) is outer
    swapped.replace(x, a)
    assert swapped(outer) is (a + y) * a
    swapped.replace(inner, b)
    assert swapped(outer) is b * a
    swapped.replace(y, c)
    assert swapped(outer) is b * a


def test_the_inertia_of_a_lone_coordinate_is_looked_up_without_the_whole_matrix() -> None:
    """A chain of 1,000 masses wrote and read a million entries of which 1,000 count, at the start of each run."""
    model = chain(40).compile(check=False)
    assert isinstance(model, Model)
    zeros = np.zeros(40)
    assert model.column_without_inertia(0.0, zeros, zeros, np.empty(0)) is None
    assert len(model._masses.program.outputs) == 40


def test_a_deep_and_a_wide_system_run() -> None:
    for system in (nested(60), chain(60)):
        first, second = (system.run(1.0, method=method, rtol=1e-9).require().y for method in ("taylor", "dop853"))
        np.testing.assert_allclose(
            first[:, -1], second[:, -1], rtol=1e-6, atol=1e-8
        )  # a hundred times the tolerance, over one unit of time


@pytest.mark.slow
def test_many_angles_share_a_function() -> None:
    """Written out at each place, 20,000 cosines were 76 million characters, which took two minutes to compile."""
    most = 8 * INLINE_ANGLES + 44
    few, many = (series_program(euler_lagrange(many_angles(count).statement))[0] for count in (40, most))
    jets = [CompiledJet(pack(program, lanes()), 0) for program in (few, many)]
    assert "@sine_and_cosine_8" not in jets[0].ir
    assert jets[1].ir.count("call { <8 x double>, <8 x double> } @sine_and_cosine_8") == most // 8
    y, none = np.array([0.3, 0.1]), np.empty(0)
    expected = NumpySeries(many).rows(6, 0.0, y, 0.01, none)
    # Sums of 108 terms of either sign, in another order: a few hundred rounding errors of the largest.
    np.testing.assert_allclose(jets[1].rows(6, 0.0, y, 0.01, none), expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("quantity", ["jacobian", "mass_matrix"])
def test_zeros_of_matrices_take_no_code_in_batches(quantity: str) -> None:
    """Twice the masses have twice the entries that are not zero: the kernel over columns is twice as long."""
    sizes = [
        len(KernelCode(program_of(quantity, chain(count).compile("numpy").equations)).column_module(4).splitlines())
        for count in (20, 40)
    ]
    assert sizes[1] < 2.2 * sizes[0]
    model, rng = chain(20).compile(), np.random.default_rng(0)
    q, v = rng.uniform(-1, 1, (2, 20, 9))
    together = model.evaluate(quantity, q, v)
    for k in range(9):
        np.testing.assert_allclose(together[..., k], model.evaluate(quantity, q[:, k], v[:, k]), rtol=1e-13, atol=1e-13)
