"""Printers and the interpreter agree, beside random functions, on sums of products, kernels and projection."""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.algorithm.constants import Outcome
from lagrange.algorithm.kernel.body import LARGEST_IN_SOURCE, PreparedLayout
from lagrange.algorithm.kernel.kernels import kernel, prepare
from lagrange.algorithm.projection import KEPT_VIOLATION, PROJECTION_CORRECTIONS, RESOLVED, project
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module
from lagrange.machine.model import Model
from lagrange.machine.python_source import loaded
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE
from lagrange.procedure.interpreter import run
from lagrange.program.program import Instruction, Program, ProgramBlock
from tests.models import SCENE_NAMES


@pytest.mark.parametrize("count", [1, 3, 8, 11, None])
def test_products_that_are_added_up_are_rounded_once(count: int | None) -> None:
    """The remainder of products that cancel is the rounding of one fused operation, in vectors and one by one."""
    p = Builder("scalar_product", "The sum of products.")
    n, a, b = p.given("n", WHOLE), p.array("a", room=4, read=True), p.array("b", room=4, read=True)
    with p.each(n if count is None else count) as i:
        total = p.fold("dot", a[i], b[i])
    p.leave(total)
    procedure = p.finish(REAL)
    small = [(3 + i) * 2.0**-30 for i in range(16)]
    numbers = [1 + x for x in small], [(-1) ** (i // 4) * (1 - x) for i, x in enumerate(small)]
    expected = run(procedure, 11, *numbers)[0]
    code = Module(module([procedure]), optimize=True)
    call = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64, *[ctypes.c_void_p] * 2)(code.address(procedure.name))
    first, second = (np.array(values) for values in numbers)
    assert call(11, first.ctypes.data, second.ctypes.data) == expected
    assert loaded(procedure)(11, *numbers) == pytest.approx(expected, abs=1e-15)


# --- kernels --------------------------------------------------------------------------------------------------
# Programs as procedures give what the interpreter gives, at singular matrices and with pivoting too.

NAMES = ("rhs", "jacobian", "energy", "mass_matrix", "momenta")


def evaluated(programs: list[Program], t: float, y: np.ndarray, parameters: np.ndarray) -> list[np.ndarray | None]:
    """Return the results of programs by their procedures, None for a singular matrix."""
    prepared = PreparedLayout.of(programs)
    p = memoryview(array("d", [0.0] * max(prepared.size, 1)))
    assert not loaded(prepare(prepared, "Prepare."))(parameters.data, p)
    result: list[np.ndarray | None] = []
    for program in programs:
        out = np.zeros(len(program.outputs))
        singular = loaded(kernel(program, prepared, program.name, "Evaluate."))(t, y.data, p, out.data)
        result.append(None if singular else out)
    return result


@pytest.mark.few(2)
@pytest.mark.parametrize("scene", SCENE_NAMES)
def test_every_scene(scene: str) -> None:
    system = lg.scene(scene)
    model: Model = system.compile("numpy")
    programs = [model.law(name).program for name in NAMES]
    y, values = np.array(system.statement.initial) + 0.1, model.parameter_array()
    for program, ours in zip(programs, evaluated(programs, 0.3, y, values), strict=True):
        expected = InterpretedKernel(program)(0.3, y, values).ravel()
        # Both do the same operations but for the order of sums in a solve.
        assert ours == pytest.approx(expected, rel=1e-12, abs=1e-13 * np.abs(expected).max(initial=1e-300))


def solving(order: int, *, hoisted: bool) -> Program:
    """Return a program that solves a system whose matrix is its input or its parameters."""
    size = order * (order + 1) // 2
    kind = "parameter" if hoisted else "state"
    code = [Instruction(kind, place=i) for i in range(size)]
    code.append(Instruction("factor", tuple(range(size)), order=order))
    right = [Instruction("state", place=i if hoisted else size + i) for i in range(order)]
    at = len(code)
    code += right
    code.append(Instruction("solve", (at - 1, *range(at, at + order)), order=order))
    code += [Instruction("component", (at + order,), place=i) for i in range(order)]
    outputs = tuple(range(at + order + 1, at + 2 * order + 1))
    inputs = (ProgramBlock("q", order if hoisted else size + order),)
    hoisting = at if hoisted else 0
    return Program(
        "solving", inputs, size if hoisted else 0, tuple(code), hoisting, outputs, (ProgramBlock("x", order),), (order,)
    )


MATRICES: dict[str, Callable[[int], Any]] = {
    "definite": lambda n: np.eye(n) * 3 + 0.5,
    "indefinite": lambda n: np.flipud(np.eye(n)) + 0.25 * np.eye(n),
    "singular": lambda n: np.ones((n, n)),
}


@pytest.mark.parametrize("order", [2, 9, LARGEST_IN_SOURCE + 2])
@pytest.mark.parametrize("kind", MATRICES)
@pytest.mark.parametrize("hoisted", [False, True])
def test_systems_are_solved_with_pivoting_where_it_is_needed(order: int, kind: str, hoisted: bool) -> None:
    matrix, x = MATRICES[kind](order), np.arange(1.0, order + 1)
    lower = np.array([matrix[i, j] for i in range(order) for j in range(i + 1)])
    right = matrix @ x
    program = solving(order, hoisted=hoisted)
    y = right if hoisted else np.concatenate([lower, right])
    given = lower if hoisted else np.zeros(0)
    if kind == "singular":
        if hoisted and order > LARGEST_IN_SOURCE:  # a factorization in memory is singular when it is prepared
            with pytest.raises(AssertionError):
                evaluated([program], 0.0, y, given)
        else:
            assert evaluated([program], 0.0, y, given) == [None]
        with pytest.raises(SingularMassMatrix):
            InterpretedKernel(program)(0.0, y, given)
    else:
        (result,) = evaluated([program], 0.0, y, given)
        assert result == pytest.approx(x, rel=1e-12)


def test_what_depends_on_parameters_alone_is_prepared_once_for_all_programs() -> None:
    model = lg.scene("double-pendulum").compile("numpy")
    rhs, again = model.law("rhs").program, model.law("accelerations").program
    assert PreparedLayout.of([rhs, again]).size == PreparedLayout.of([rhs]).size


# --- projection -----------------------------------------------------------------------------------------------
# The loop of the projection: when a state moves, how far, and the outcome if it cannot be projected.

Answer = tuple[list[float], float, float]
"""Corrections, the violation, and the violation that would remain."""


def projected(
    answers: list[Answer | None], state: list[float], lost: list[float] | None = None
) -> tuple[Outcome, bool, list[float], list[float], int]:
    """Run the projection with given corrections. Return its result, the state, the rounding errors, and the calls."""
    asked = 0

    def corrections(_: float, __: Any, ___: Any, out: Any) -> bool:
        nonlocal asked
        answer = answers[min(asked, len(answers) - 1)]
        asked += 1
        for i, value in enumerate([] if answer is None else [*answer[0], answer[1], answer[2]]):
            out[i] = value
        return answer is None

    y, low = list(state), [0.0] * len(state) if lost is None else list(lost)
    outcome, moved = run(project.form(dimension=len(state), block=1), corrections, [], 0.5, y, low)
    return Outcome(outcome), bool(moved), y, low, asked


def test_a_state_whose_violation_is_rounding_is_unchanged() -> None:
    result = projected([([1e-17, 2e-17], KEPT_VIOLATION, 0.0)], [1.0, 2.0])
    assert result == (Outcome.DONE, False, [1.0, 2.0], [0.0, 0.0], 1)


def test_a_state_and_its_rounding_error_move_as_one_number() -> None:
    """State and rounding errors together lose no bit of a correction below the spacing of the state."""
    state, lost, move = [1.0, -3.0], [2.0**-55, -(2.0**-54)], [2.0**-54 + 2.0**-80, 0.3]
    outcome, moved, after, low, asked = projected([(move, 1e-9, 0.0)], state, lost)
    assert (outcome, moved, asked) == (Outcome.DONE, True, 1)
    for i in range(2):
        total = Fraction(lost[i]) + Fraction(move[i])
        exact = Fraction(state[i]) + total
        # The sum of both small parts is rounded once, where it does not fit into a double.
        assert abs(Fraction(after[i]) + Fraction(low[i]) - exact) <= abs(total) * Fraction(1, 2**53)
    assert after[0] == 1.0
    assert low[0] > 0


def test_corrections_are_repeated_until_the_violation_is_rounding() -> None:
    answers: list[Answer | None] = [([0.1], 1e-2, 1e-4), ([0.01], 1e-4, 1e-8), ([1e-3], 1e-8, 1e-16), ([9.0], 1.0, 0.0)]
    outcome, moved, after, _, asked = projected(answers, [1.0])
    assert (outcome, moved, asked) == (Outcome.DONE, True, 3)
    assert after == [pytest.approx(1.111)]


@pytest.mark.parametrize(("violation", "outcome"), [(RESOLVED, Outcome.DONE), (2 * RESOLVED, Outcome.UNPROJECTED)])
def test_a_correction_that_leaves_more_than_half_is_not_made(violation: float, outcome: Outcome) -> None:
    """If a correction does not halve the violation, a small violation stays, and a large one makes the step fail."""
    assert projected([([5.0], violation, 0.6 * violation)], [1.0]) == (outcome, False, [1.0], [0.0], 1)


def test_slow_corrections_end_as_unprojected() -> None:
    outcome, moved, _, _, asked = projected([([1e-3], 1e-2, 4e-3)], [1.0])
    assert (outcome, moved, asked) == (Outcome.UNPROJECTED, True, PROJECTION_CORRECTIONS)


@pytest.mark.parametrize("answer", [([0.1], float("nan"), 0.0), ([0.1], 1.0, float("nan"))])
def test_a_violation_that_is_nan_is_no_success(answer: Answer) -> None:
    assert projected([answer], [1.0]) == (Outcome.UNPROJECTED, False, [1.0], [0.0], 1)


def test_a_state_with_a_singular_matrix_is_unchanged() -> None:
    """At a singular matrix the state is not changed; the run then ends with its message."""
    assert projected([None], [1.0]) == (Outcome.DONE, False, [1.0], [0.0], 1)
