"""Kernels of systems with constraints, compared with dense linear algebra on all machines."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.compiler import machine, model_of
from lagrange.errors import RunError
from lagrange.graph.node import Binding, Graph, Node
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.llvm import procedures
from lagrange.machine.model import Model
from lagrange.program.lower import lower
from lagrange.program.program import Program, SolveGroup, scheduled
from lagrange.statement.statement import Statement
from tests.covering import Share
from tests.machine.matrices import REGULAR, SINGULAR, Matrix, positive
from tests.models import m, stated
from tests.series_systems import HELD, ladder, rods

CASES: dict[str, Callable[[], Statement]] = {**HELD, "12 rods": lambda: rods(12)}
"""24 coordinates and 12 multipliers are written out by LLVM, and interpreted on the numpy target."""


@cache
def model(name: str, target: str) -> Model:
    return model_of(CASES[name](), machine(target))


def motion(model: Model, q: Any, v: Any) -> tuple[Any, Any]:
    """Return the accelerations and multipliers by dense linear algebra, from M, h and the nodes of G and gamma."""
    held = model.equations.constraints
    m, n = len(held), model.dimension
    y = np.concatenate([q, v])
    nodes = (*(entry for row in held.gradient for entry in row), *held.bias)
    result = model.function("rows", nodes)(0.25, y, model.parameter_array())
    gradient, gamma = result[: m * n].reshape(m, n), result[m * n :]
    mass, bias = model.mass_matrix(q, 0.25, v=v), model.evaluate("bias", q, v, 0.25)
    whole = np.block([[mass, -gradient.T], [gradient, np.zeros((m, m))]])
    solution = np.linalg.solve(whole, np.concatenate([bias, -gamma]))
    return solution[:n], solution[n:]


def states(model: Model, count: int) -> tuple[Any, Any]:
    """Return coordinates and velocities near the initial ones, (n, count) each; they need not obey the constraints."""
    rng = np.random.default_rng(5)
    y = np.array(model.statement.initial)[:, None] + rng.uniform(-0.1, 0.1, (model.layout.size, count))
    return y[model.layout.q], y[model.layout.v]


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("name", CASES)
def test_accelerations_and_multipliers_are_those_of_the_whole_system(name: str, target: str) -> None:
    held = model(name, target)
    q, v = states(held, 6)
    many = held.accelerations(q, v, 0.25), held.multipliers(q, v, 0.25)
    for k in range(6):
        a, multipliers = motion(held, q[:, k], v[:, k])
        # Both solve to some hundred rounding errors: the systems are well conditioned.
        for result, expected in ((held.accelerations(q[:, k], v[:, k], 0.25), a), (many[0][:, k], a)):
            assert result == pytest.approx(expected, rel=1e-11, abs=1e-12 * np.abs(a).max())
        for result in (held.multipliers(q[:, k], v[:, k], 0.25), many[1][:, k]):
            assert result == pytest.approx(multipliers, rel=1e-11, abs=1e-12 * np.abs(multipliers).max())


@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_near_a_configuration_where_constraints_depend_on_one_another_pivots_are_taken_by_size(target: str) -> None:
    """The bars of a ladder are within 1e-4 of one line. Elimination without pivoting would lose eight digits."""
    held = model_of(ladder(3), machine(target))
    angle = np.pi / 2 - 1e-4
    q = np.ravel([(i + np.sin(angle), np.cos(angle)) for i in range(4)])
    v = np.ravel([(np.cos(angle), -np.sin(angle)) for _ in range(4)])
    result, (expected, _) = held.accelerations(q, v, 0.25), motion(held, q, v)
    assert result == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
    straight = np.ravel([(i + 1.0, 0.0) for i in range(4)])
    with pytest.raises(RunError):
        held.accelerations(straight, np.zeros(8), 0.25)


@pytest.mark.parametrize(("loops", "largest"), [(5, 8), pytest.param(60, 50_000, marks=pytest.mark.slow)])
def test_a_large_system_that_is_singular_takes_its_memory_from_the_heap(
    loops: int, largest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The matrix of 60 loops has 243 unknowns and half a megabyte; with its factors it exceeds a thread's stack."""
    monkeypatch.setattr(procedures, "LARGEST_ON_STACK", largest)
    held = model_of(ladder(loops), machine("llvm"))
    straight = np.ravel([(i + 1.0, 0.0) for i in range(loops + 1)])
    with pytest.raises(RunError):
        held.accelerations(straight, np.zeros(2 * loops + 2), 0.25)
    bent = np.ravel([(i + 0.28, 0.96) for i in range(loops + 1)])
    assert np.isfinite(held.accelerations(bent, np.zeros(2 * loops + 2), 0.25)).all()


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("light", [1e-6, 1e-9, 1e-12, 1e-15, 1e-17])
def test_a_light_body_tied_to_a_heavy_one_has_its_acceleration(light: float, target: str) -> None:
    """Both accelerations are F / (m + M).

    Without pivoting that of the light body would be a difference of equal forces.
    """
    a, b = lg.coordinates("a b")
    tied = stated(
        kinetic=m * a.dot**2 / 2 + b.dot**2 / 2, potential=-a, constraints={"tie": a - b}, parameters={m: light}
    )
    held, zero = model_of(tied, machine(target)), np.zeros(2)
    exact = 1 / (1 + light)
    assert held.accelerations(zero, zero) == pytest.approx([exact, exact], rel=1e-11)
    many = held.accelerations(np.zeros((2, 9)), np.zeros((2, 9)))
    assert many == pytest.approx(np.full((2, 9), exact), rel=1e-11)


# --- solve groups ---------------------------------------------------------------------------------------------
# Systems with one factored matrix, solved together: the same to the last bit as one by one, and less work.

ORDERS = (2, 3, 7, *(pytest.param(n, marks=pytest.mark.slow) for n in (6, 12)))
"""Of these 6 and 12 are written in loops, as 7 is, and take the longest to compile."""
WIDTH = 9


def one_by_one(program: Program, refs: Iterable[int], most: Callable[[int], int]) -> list[int | SolveGroup]:
    return list(refs)


def random_program(rng: np.random.Generator, n: int, *, hoisted: bool = False, multipliers: int = 0) -> Program:
    """Return a program with systems of one or two matrices. Some right-hand sides depend on earlier solutions.

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
        result: list[Node] = []
        for _ in range(count):
            right = [
                known[a] * float(rng.normal()) + known[b] for a, b in rng.integers(0, len(known), size=(n, 2)).tolist()
            ]
            chosen = rows[int(rng.integers(0, 4) == 0)]
            result += graph.solve(chosen, right, tuple(range(n - multipliers, n)))
        known += result
        outputs += [first + second for first, second in zip(result, result[::-1], strict=True)] + result
    time = graph.symbol("t", Binding.TIME)
    return lower("systems", {"x": outputs}, {"y": state if hoisted else [*given, *state]}, time, given * hoisted)


def both(program: Program, monkeypatch: pytest.MonkeyPatch, use: Callable[[LlvmKernel], Any]) -> tuple[Any, Any]:
    """Return the results of two kernels: one solves for all right-hand sides together, the other one by one."""
    together = use(LlvmKernel(program))
    with monkeypatch.context() as patch:
        patch.setattr("lagrange.algorithm.kernel.body.scheduled", one_by_one)
        return together, use(LlvmKernel(program))


def at(y: FloatArray, kernel: LlvmKernel) -> FloatArray:
    return kernel(0.0, y, np.empty(0))


def triangle(matrix: Any) -> FloatArray:
    result: FloatArray = np.asarray(matrix[np.tril_indices(len(matrix))], dtype=float)
    return result


def steps_of(program: Program, most: int = 32) -> list[int | SolveGroup]:
    return scheduled(program, range(program.hoisted, len(program.instructions)), lambda _: most)


@pytest.mark.slow
@pytest.mark.parametrize("n", ORDERS)
@pytest.mark.parametrize("kind", REGULAR, ids=lambda kind: kind.__name__)
def test_together_is_one_by_one_to_the_last_bit(
    n: int, kind: Matrix, monkeypatch: pytest.MonkeyPatch, everything: bool
) -> None:
    """Matrices with and without trusted pivots, from the state and from parameters, for one state and in columns."""
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


@pytest.mark.few(1)
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


def test_an_order_of_groups_is_an_order_of_the_program(share: Share) -> None:
    """Each instruction occurs once, after all that it reads.

    A group has all its right-hand sides and one factorization.
    """
    for seed in range(share(30)):
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
