"""Systems with one factored matrix, solved together: the same to the last bit as one by one, and less work."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import pytest

from lagrange.graph.node import Binding, Graph, Node
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.program.lower import lower
from lagrange.program.program import Program, SolveGroup, scheduled
from tests.machine.matrices import REGULAR, SINGULAR, Matrix, hollow, positive

ORDERS = (2, 3, 7, *(pytest.param(n, marks=pytest.mark.slow) for n in (6, 12)))
"""Of these 6 and 12 are written in loops, as 7 is, and take the longest to compile."""
WIDTH = 9


def one_by_one(program: Program, refs: Iterable[int], most: Callable[[int], int]) -> list[int | SolveGroup]:
    return list(refs)


def random_program(rng: np.random.Generator, n: int, *, hoisted: bool = False, multipliers: int = 0) -> Program:
    """Return a program with systems of one or two matrices, on right-hand sides that build upon solutions or not.

    The matrices are the first inputs or the parameters, n (n + 1) / 2 entries of each.
    """
    graph = Graph()
    matrices = [f"{name}{i}" for name in "ac" for i in range(n * (n + 1) // 2)]
    given = [graph.symbol(name, Binding.PARAMETER if hoisted else Binding.CONFIGURATION) for name in matrices]
    state = [graph.symbol(f"b{i}", Binding.CONFIGURATION) for i in range(n)]
    entries = [2 * entry for entry in given]  # not the parameters themselves, which are at hand anyway
    rows = [
        [[entries[start + i * (i + 1) // 2 + j] for j in range(i + 1)] for i in range(n)]
        for start in (0, len(given) // 2)
    ]
    known: list[Node] = list(state)
    outputs: list[Node] = []
    for count in rng.integers(1, 45, size=3):
        found: list[Node] = []
        for _ in range(count):
            right = [
                known[a] * float(rng.normal()) + known[b] for a, b in rng.integers(0, len(known), size=(n, 2)).tolist()
            ]
            chosen = rows[int(rng.integers(0, 4) == 0)]
            found += graph.solve(chosen, right, tuple(range(n - multipliers, n)))
        known += found
        outputs += [one + other for one, other in zip(found, found[::-1], strict=True)] + found
    time = graph.symbol("t", Binding.TIME)
    return lower("systems", {"x": outputs}, {"y": state if hoisted else [*given, *state]}, time, given * hoisted)


def both(program: Program, monkeypatch: pytest.MonkeyPatch, use: Callable[[LlvmKernel], Any]) -> tuple[Any, Any]:
    """Return what a kernel gives that solves together, and one that solves one by one."""
    together = use(LlvmKernel(program))
    with monkeypatch.context() as patch:
        patch.setattr("lagrange.algorithm.kernel.body.scheduled", one_by_one)
        return together, use(LlvmKernel(program))


def at(y: FloatArray, kernel: LlvmKernel) -> FloatArray:
    return kernel(0.0, y, np.empty(0))


def triangle(matrix: Any) -> FloatArray:
    found: FloatArray = np.asarray(matrix[np.tril_indices(len(matrix))], dtype=float)
    return found


def steps_of(program: Program, most: int = 32) -> list[int | SolveGroup]:
    return scheduled(program, range(program.hoisted, len(program.instructions)), lambda _: most)


@pytest.mark.parametrize("n", ORDERS)
@pytest.mark.parametrize("kind", REGULAR, ids=lambda kind: kind.__name__)
def test_together_is_one_by_one_to_the_last_bit(
    n: int, kind: Matrix, monkeypatch: pytest.MonkeyPatch, everything: bool
) -> None:
    """Matrices with trusted pivots and without, from the state and from the parameters, alone and in columns."""
    rng = np.random.default_rng([n, REGULAR.index(kind)])
    for hoisted in (False, True) if everything else (n % 2 == 0,):
        program = random_program(rng, n, hoisted=hoisted)
        matrices = np.concatenate([triangle(kind(rng, n)), triangle(positive(rng, n))])
        right = rng.normal(size=(n, WIDTH))
        many = right if hoisted else np.concatenate([np.repeat(matrices[:, None], WIDTH, axis=1), right])
        parameters = matrices if hoisted else np.empty(0)

        def use(kernel: LlvmKernel, many: Any = many, parameters: Any = parameters) -> Any:
            alone = kernel(0.0, many[:, 4].copy(), parameters)
            return np.column_stack([alone, kernel(0.0, many, parameters)])

        together, alone = both(program, monkeypatch, use)
        assert np.isfinite(alone).all()
        assert (together == alone).all()


@pytest.mark.parametrize("n", [3, pytest.param(6, marks=pytest.mark.slow)])
def test_multipliers_too(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pivots below zero for the last unknown, behind a matrix with pivots that are trusted or not."""
    rng = np.random.default_rng(n)
    program = random_program(rng, n, multipliers=1)
    for kind in (positive, hollow):
        a = kind(rng, n)
        a[-1, -1] = 0.0
        y = np.concatenate([triangle(a), triangle(a), rng.normal(size=n)])
        together, alone = both(program, monkeypatch, partial(at, y))
        assert (together == alone).all()


@pytest.mark.parametrize("kind", SINGULAR, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("n", ORDERS)
def test_a_singular_matrix_of_a_group_is_told(n: int, kind: Matrix) -> None:
    rng = np.random.default_rng(n)
    program = random_program(rng, n)
    assert any(isinstance(step, SolveGroup) for step in steps_of(program))
    good, right = triangle(positive(rng, n)), rng.normal(size=n)
    kernel, y = LlvmKernel(program), np.concatenate([triangle(kind(rng, n)), good, right])
    with pytest.raises(SingularMassMatrix):
        kernel(0.0, y, np.empty(0))
    many = np.repeat(np.concatenate([good, good, right])[:, None], WIDTH, axis=1)
    assert np.isfinite(kernel(0.0, many, np.empty(0))).all()
    many[:, 5] = y
    with pytest.raises(SingularMassMatrix) as raised:
        kernel(0.0, many, np.empty(0))
    assert raised.value.column == 5


@pytest.mark.parametrize("n", [7, 12])
def test_what_is_not_finite_stays_in_its_column(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """NaN in some right-hand sides leaves the other lanes of their vectors as they are."""
    rng = np.random.default_rng(n)
    graph = Graph()
    entries = [graph.symbol(f"a{i}", Binding.CONFIGURATION) for i in range(n * (n + 1) // 2)]
    right = [graph.symbol(f"b{i}", Binding.CONFIGURATION) for i in range(11 * n)]
    rows = [[1 * entries[i * (i + 1) // 2 + j] for j in range(i + 1)] for i in range(n)]
    outputs = [x for k in range(11) for x in graph.solve(rows, right[k * n : (k + 1) * n])]
    time = graph.symbol("t", Binding.TIME)
    program = lower("apart", {"x": outputs}, {"y": [*entries, *right]}, time, [])
    for kind in (positive, hollow):
        b = rng.normal(size=(11, n))
        b[[0, 3, 10]] = np.nan
        y = np.concatenate([triangle(kind(rng, n)), b.ravel()])
        together, alone = both(program, monkeypatch, partial(at, y))
        assert np.array_equal(together, alone, equal_nan=True)
        assert (np.isnan(together.reshape(11, n)).any(axis=1) == np.isnan(b).any(axis=1)).all()


def test_an_order_of_groups_is_an_order_of_the_program() -> None:
    """Each instruction comes once, behind all that it reads; a group has all its right-hand sides, and one factor."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        program, most = random_program(rng, 2), int(rng.integers(1, 33))
        code, steps = program.instructions, steps_of(program, most)
        groups = [step for step in steps if isinstance(step, SolveGroup)]
        grouped = [i for group in groups for i in group.solves]
        assert sorted(step for step in steps if isinstance(step, int)) == list(range(program.hoisted, len(code)))
        assert len(set(grouped)) == len(grouped)
        assert all(2 <= len(group.solves) <= most for group in groups)
        assert bool(groups) == (most > 1)
        done: set[int] = set(range(program.hoisted))
        ready: set[int] = set()
        for step in steps:
            if isinstance(step, SolveGroup):
                assert ready.issuperset(step.solves)
                assert {code[i].args[0] for i in step.solves} == {step.factor}
                done.update(step.solves)
            else:
                assert done.issuperset(code[step].args)
                (ready if step in grouped else done).add(step)


def test_a_group_has_one_test_of_its_pivots_and_one_call() -> None:
    """Twelve systems of order 2 are one branch to pivoting; of order 7, one call that solves all."""
    for n, pattern in ((2, r", !prof !1"), (7, r"call void @solve_columns\(i64 7, i64 16,")):
        graph = Graph()
        entries = [graph.symbol(f"a{i}", Binding.CONFIGURATION) for i in range(n * (n + 1) // 2)]
        right = [graph.symbol(f"b{i}", Binding.CONFIGURATION) for i in range(12 * n)]
        rows = [[1 * entries[i * (i + 1) // 2 + j] for j in range(i + 1)] for i in range(n)]
        outputs = [x for k in range(12) for x in graph.solve(rows, right[k * n : (k + 1) * n])]
        time = graph.symbol("t", Binding.TIME)
        kernel = LlvmKernel(lower("twelve", {"x": outputs}, {"y": [*entries, *right]}, time, []))
        assert len(re.findall(pattern, kernel.ir)) == 1
    assert "call void @solve_factored" not in kernel.ir.partition("define i32 @twelve(")[2]
