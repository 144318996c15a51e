"""Programs as text for JAX and CasADi: operations, literals, refusals, self-tests, and the text itself."""

import importlib.util
import itertools
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.export.languages import casadi, fortran, jax, julia, modelica, octave, rust
from lagrange.export.straight_line import STRUCTURE, Language, StraightLinePrinter
from lagrange.export.traced import LITERALS
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.python_source import defined
from lagrange.program.program import ARITY, Instruction, Program, ProgramBlock
from lagrange.recipes import sympy as sympy_recipe
from lagrange.statement.vocabulary.functions import CONDITIONS
from tests.export.callers import every_scene, held, run, section
from tests.export.test_modules import coupled
from tests.models import shared_scene

SOURCES: dict[str, Callable[..., str]] = {"jax": jax.LIBRARY.source, "casadi": casadi.LIBRARY.source}
every_package = pytest.mark.parametrize("package", ["casadi", pytest.param("jax", marks=pytest.mark.slow)])
MATHEMATICS = [op for op in ARITY if op not in STRUCTURE]

VALUES = (
    *(0.0, -0.0, 1.0, -1.0, 0.3, -0.7, 0.999999, 1.01, 2.5, -3.75, 7.3, 1e-9, -1e-9, 30.0, -30.0, 600.3, -699.0),
    *(-0.393, 0.4142, -18.91952339134551),
    *(1e17, -1e17, 1e300, math.inf, -math.inf, math.nan),
)
NORMAL = float(np.finfo(float).tiny)
"""The least normal double; JAX takes what is smaller for zero."""


def program_of(code: Sequence[Instruction], states: int, outputs: Sequence[int] = ()) -> Program:
    """Return a program whose result is the last value, or the named ones."""
    results = tuple(outputs) or (len(code) - 1,)
    values = (ProgramBlock("values", len(results)),)
    return Program("f", (ProgramBlock("y", states),), 0, tuple(code), 0, results, values, (len(results),))


def operations(names: Sequence[str], count: int) -> Program:
    """Return the operations on a number of arguments, as instructions. A condition is true, false or y < 0.5."""
    code = [Instruction("state", place=i) for i in range(count)]
    code += [Instruction("constant", value=value) for value in (0.5, 2.0, 3.0)]
    code += [Instruction("less", (i, count)) for i in range(count)]
    result = []
    for op in names:
        conditions = {"select": 1, "and": 2, "or": 2, "not": 1}.get(op, 0)
        args = [i + count + 3 if i < conditions else i for i in range(count)]
        code.append(Instruction(op, tuple(args)))
        if op in CONDITIONS:
            code.append(Instruction("select", (len(code) - 1, count + 1, count + 2)))
        result.append(len(code) - 1)
    return program_of(code, count, result)


def values_of(package: str, program: Program, y: Any, p: Any = ()) -> Any:
    """Return the results of a program for columns of states, by the text printed for a package."""
    module: Any = pytest.importorskip(package, reason=f"{package} is not installed")
    text = SOURCES[package](program, "f")
    if package == "jax":
        module.config.update("jax_enable_x64", val=True)
        return np.asarray(module.jit(module.vmap(defined(text, "f", {}), (None, 1, None), 1))(0.0, y, np.array(p)))
    result = [
        defined(text, "f", {})(kind).map(y.shape[1])(0.0, y, np.array(p)).full() for kind in (module.SX, module.MX)
    ]
    np.testing.assert_array_equal(result[0], result[1])
    return result[0]


@every_package
def test_every_operation_is_that_of_numpy(package: str) -> None:
    """Assert that each operation has an error of at most 4 ulp, with NumPy's NaN and infinities."""
    for count in (1, 2, 3):
        names = [op for op in MATHEMATICS if ARITY[op] == count]
        program = operations(names, count)
        y = np.array(list(itertools.product(VALUES if count < 3 else (*VALUES[::3], math.nan), repeat=count))).T
        for op, exact, result in zip(
            names, InterpretedKernel(program)(0.0, y, np.zeros(0)), values_of(package, program, y), strict=True
        ):
            with np.errstate(all="ignore"):
                size = np.abs(y[0] * y[1]) + np.abs(y[2]) if op == "fma" else np.abs(exact)
                off = np.abs(result - exact) / np.spacing(np.maximum(size, NORMAL))
            same = (result == exact) | (np.isnan(result) & np.isnan(exact))
            tiny = (np.abs(exact) < NORMAL) & (result == 0.0) & (package == "jax")
            bad = ~(same | tiny | (np.isfinite(exact) & np.isfinite(result) & (off <= 4)))
            assert not bad.any(), (op, y[:, bad][:, 0], exact[bad][0], result[bad][0])


@every_package
def test_every_regular_matrix_is_solved(package: str, everything: bool) -> None:
    """Assert that indefinite matrices of each size are solved. Some have a zero diagonal and need exchanges of rows."""
    draw = np.random.default_rng(4)
    for n in (1, 2, 3, 4, 6) if everything else (1, 4):
        count = n * (n + 1) // 2
        code = [Instruction("state", place=i) for i in range(count + n)]
        code.append(Instruction("factor", tuple(range(count)), order=n))
        code.append(Instruction("solve", (count + n, *range(count, count + n)), order=n))
        code += [Instruction("component", (count + n + 1,), place=i) for i in range(n)]
        a = draw.normal(size=(20, n, n))
        a += a.transpose(0, 2, 1)
        if n % 2 == 0:
            a[:10] *= 1 - np.eye(n)
        right, (i, j) = draw.normal(size=(20, n)), np.tril_indices(n)
        program = program_of(code, count + n, range(count + n + 2, count + 2 * n + 2))
        result = values_of(package, program, np.concatenate([a[:, i, j], right], axis=1).T).T
        exact = np.linalg.solve(a, right[..., None])[..., 0]
        off = np.abs(result - exact).max(axis=1) / (np.linalg.cond(a) * np.abs(exact).max(axis=1))
        assert off.max() < 1e-14, n  # elimination is off by some roundings for each unknown


LANGUAGES = (
    *(jax.LIBRARY.language, casadi.LIBRARY.language, fortran.LANGUAGE, julia.LANGUAGE, modelica.LANGUAGE),
    *(octave.LANGUAGE, rust.LANGUAGE),
)


@pytest.mark.parametrize("language", LANGUAGES, ids=[one.name for one in LANGUAGES])
def test_every_table_is_complete(language: Language) -> None:
    lacks = {"erf"} if language.name in ("Julia", "Rust") else set()
    assert set(language.operations) - {"fnma", "log1p"} == set(MATHEMATICS) - lacks
    assert set(sympy_recipe.OPERATIONS) >= set(MATHEMATICS)


def test_mathematics_that_a_library_does_not_have_is_refused_by_name() -> None:
    fewer = {op: item for op, item in casadi.OPERATIONS.items() if op != "erf"}
    poorer = replace(casadi.LIBRARY.language, operations=fewer)
    with pytest.raises(StatementError, match="f contains erf, which CasADi does not have: state the system without it"):
        StraightLinePrinter(operations(["erf"], 1), poorer)


@pytest.mark.parametrize("value", [0.1, -0.1, 1e-320, -0.0, 1 / 3, math.pi, math.inf, -math.inf, math.nan, 2.0**70])
def test_literals_are_read_back_as_the_same_double(value: float) -> None:
    result = defined(f"def f():\n    return {LITERALS.real(value)}\n", "f", {})()
    assert np.float64(result).tobytes() == np.float64(value).tobytes() or (math.isnan(result) and math.isnan(value))


@every_package
def test_constants_are_divided_as_doubles_and_numbers_are_conditions(package: str) -> None:
    numbers = [Instruction("constant", value=value) for value in (1.0, 0.0)]
    by_zero = [*numbers, Instruction("div", (0, 1)), Instruction("state"), Instruction("mul", (2, 3))]
    y = np.array([[1.0, -1.0]])
    assert values_of(package, program_of(by_zero, 1), y)[0].tolist() == [math.inf, -math.inf]
    chosen = [*numbers, Instruction("state"), Instruction("select", (2, 0, 1))]
    assert values_of(package, program_of(chosen, 1), np.array([[0.0, 0.5]]))[0].tolist() == [0.0, 1.0]


# --- models exported for JAX and CasADi pass their self-tests, and run as the pages say ------------------------


QUANTITIES = ("rhs", "energy", "jacobian", "mass_matrix", "momenta", "accelerations")
STRICT = "python -W error"

TARGETS = [
    pytest.param(
        name,
        marks=[
            pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed"),
            *([pytest.mark.slow] if name == "jax" else []),
        ],
    )
    for name in ("jax", "casadi")
]
every_target = pytest.mark.parametrize("target", TARGETS)


def printed(system: lg.System, target: str, contents: list[str], folder: Path) -> str:
    """Return the output of the self-test of an exported system."""
    made = system.export(target, folder, contents)
    for text in (file.read_text() for file in made.files):
        assert text.isascii() and text.endswith("\n") and not text.endswith("\n\n")
        assert all(line == line.rstrip() for line in text.splitlines())
    (command,) = made.commands
    assert command == f"python {made.files[1].name}"
    assert made.run_commands == ()
    return run(command.replace("python", STRICT), folder)


@every_target
@pytest.mark.parametrize("scene", every_scene("double-pendulum", "cartesian-double-pendulum"))
def test_a_scene_conforms(target: str, scene: str, tmp_path: Path) -> None:
    system = shared_scene(scene)
    assert printed(system, target, [*QUANTITIES, *held(system)], tmp_path).endswith("results are right\n")


@every_target
def test_wrong_numbers_and_singular_matrices_fail_the_self_test(target: str, tmp_path: Path) -> None:
    file, test = coupled().export(target, tmp_path, ["rhs"]).files
    state, result = "            1.0, 0.0, 0.0, 0.5,", "results = [y2, "
    assert state in test.read_text() and result in file.read_text()
    test.write_text(test.read_text().replace(state, "            0.0, 0.0, 0.5, 0.1,"))
    file.write_text(file.read_text().replace(result, "results = [y2 + 1e-9, "))
    with pytest.raises(AssertionError, match="coupled: 15 of 24 results are right") as caught:
        run(f"python {test.name}", tmp_path)
    said = str(caught.value)
    assert said.count("a matrix is singular") == 1
    assert len(re.findall(r"rhs, state \d, result 0: \S+ instead of", said)) == 5


@every_target
def test_events_are_exported_and_steps_are_refused(target: str, tmp_path: Path) -> None:
    system = shared_scene("pendulum")
    theta = system.statement.coordinates[0]
    with pytest.raises(lg.StatementError, match=f"target '{target}' has no rk4: leave it out of contents"):
        system.export(target, tmp_path, ["rk4"])
    _, test = system.export(target, tmp_path, events=[theta.dot]).files
    assert run(f"{STRICT} {test.name}", tmp_path).endswith("pendulum: 24 of 24 results are right\n")


@pytest.mark.slow
@every_target
def test_the_program_on_the_page_runs(target: str, tmp_path: Path) -> None:
    program = section({"jax": "JAX", "casadi": "CasADi"}[target]).split("```python\n")[2].partition("```")[0]
    (tmp_path / "program.py").write_text(program)
    system = shared_scene("double-pendulum")
    system.export(target, tmp_path, ["rhs", "energy"])
    rows = [line.split() for line in run(f"{STRICT} program.py", tmp_path).splitlines()]
    model, y, given = system.compile(), np.array([1.0, 0.5, 0.0, 0.0]), {"l2": 0.5}
    rate = np.concatenate([y[2:], model.accelerations(y[:2], y[2:], parameters=given)])
    assert np.array(rows[0], dtype=float) == pytest.approx(rate, rel=1e-13)

    def energy(state: np.ndarray) -> float:
        return float(model.energy(state[:2], state[2:], parameters=given))

    slope = [(energy(y + 1e-5 * step) - energy(y - 1e-5 * step)) / 2e-5 for step in np.eye(4)]
    assert np.array(rows[1], dtype=float) == pytest.approx(slope, abs=1e-8)  # of a central difference
    if target == "jax":
        assert [float(item) for item in rows[2]] == pytest.approx([energy(y), energy(2 * y)], rel=1e-14)
        assert rows[3] == ["False"]
    else:
        end = system.run(1.0, initial={"theta1": 1.0, "theta2": 0.5}, rtol=1e-12, parameters=given).y[:, -1]
        assert np.array(rows[2], dtype=float) == pytest.approx(end, abs=1e-6)  # CVODES at 1e-10, a unit of time
