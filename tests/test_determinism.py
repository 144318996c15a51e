"""The same statement gives the same bytes in every process, for any hash seed, and again in this process."""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from sympy import Abs, Max, Min, Piecewise, cos

import lagrange as lg
from lagrange.algorithm.step.error_control import steps_of
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.export.target import find
from lagrange.machine.kernel.llvm_kernel import KernelCode
from lagrange.machine.llvm.engine import called_ir
from lagrange.machine.llvm_machine import loop_layout
from lagrange.program.catalogue import QUANTITIES, program_of
from lagrange.trajectory.methods.explicit import DOP853, RK4
from lagrange.trajectory.methods.explicit import runge_kutta_step as step_of
from lagrange.trajectory.methods.splitting import Verlet, splitting_step
from tests.models import SYSTEMS

ROOT = Path(__file__).resolve().parent.parent
NAMES = ("double pendulum", "chain of 7", "cart and pole", "blocks", "friction", "8 carried masses", "saddle")
CHOSEN = ("rhs", "energy")


def texts(name: str, quantities: Iterable[str] = QUANTITIES) -> dict[str, str]:
    """Return all generated text of a system: programs, and LLVM IR for one state and for columns."""
    equations = euler_lagrange(SYSTEMS[name]())
    result = {}
    for quantity in quantities:
        program = program_of(quantity, equations)
        result[f"{name} {quantity} program"] = str(program)
        result[f"{name} {quantity} scalar"] = KernelCode(program).scalar_module()
        result[f"{name} {quantity} columns"] = KernelCode(program).column_module(4)
    return result


def drivers() -> dict[str, str]:
    verlet = Verlet()
    steps = {"rk4": step_of(RK4().tableau), "dop853": step_of(DOP853().tableau)}
    steps["verlet"] = splitting_step("verlet", verlet.stages)
    return {
        f"{name} driver": called_ir(steps_of(loop_layout(step, dimension)))
        for name, step in steps.items()
        for dimension in (4, 40)
    }


EXPORTED = {
    "double-pendulum": ["rhs", "energy", "jacobian", "dop853", "main"],
    "four-bar": ["rhs", "multipliers", "rk4"],
}
"""Scenes and their exported contents. An FMU is the sources of C and what a compiler makes of them."""


def exports() -> dict[str, str]:
    """Return the text of all exported files."""
    result: dict[str, str] = {}
    for name, contents in EXPORTED.items():
        for target in lg.targets().keys() - {"fmu"}:
            steps = find(target).contents >= {"steps", "main"}
            chosen = [item for item in contents if steps or item not in ("rk4", "dop853", "main")]
            with TemporaryDirectory() as folder:
                files = lg.scene(name).export(target, folder, chosen).files
                result |= {f"{target} {path.name}": path.read_text() for path in files}
    return result


def digests(count: int) -> dict[str, str]:
    result = drivers() | exports()
    for name in NAMES[:count]:
        result |= texts(name, CHOSEN)
    return {key: hashlib.sha256(text.encode()).hexdigest() for key, text in result.items()}


def reports() -> list[str]:
    """Return the output of `check` for a scene, and for a system with branches."""
    x, y = lg.coordinates("x y")
    a, b = lg.parameters("a b")
    branched = lg.System(
        kinetic=(a * x.dot**2 + b * y.dot**2) / 2 + cos(x - y) * x.dot * y.dot / 3,
        potential=Max(x, y, a) ** 2 + Abs(x - b) ** 3 + Piecewise((b * x, x + y < 40), (x**2, True)) + Min(x, y) * b,
        forces={x: -a * x.dot + b * Abs(y.dot)},
    )
    return [str(branched.check(points=2)), str(lg.scene("falling-ball").check(points=2))]


def in_processes(call: str, count: int) -> tuple[Any, list[Any]]:
    """Return the result of a call in one process, and in others with different hash seeds."""
    code = f"import json; from tests.test_determinism import *; print(json.dumps({call}))"
    runs = []
    for seed in [0, 1, *["random"] * (count - 2)]:
        environment = {**os.environ, "PYTHONHASHSEED": str(seed), "PYTHONPATH": str(ROOT)}
        runs.append(
            subprocess.Popen(
                [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment, cwd=ROOT
            )
        )
    answers = []
    for run in runs:
        out, err = run.communicate(timeout=300)
        assert run.returncode == 0, err.decode()
        answers.append(json.loads(out))
    return answers[0], answers[1:]


@pytest.mark.slow
def test_every_process_prints_the_same_check() -> None:
    first, others = in_processes("reports()", 6)
    assert sum(report.count("Everything holds.") for report in first) == 2
    assert all(reports == first for reports in others)


def test_a_second_build_gives_the_same_text(everything: bool) -> None:
    for name in NAMES if everything else NAMES[:1]:
        assert texts(name) == texts(name)


@pytest.mark.slow
def test_every_process_gives_the_same_text(everything: bool) -> None:
    count, processes = (4, 6) if everything else (1, 2)
    first, others = in_processes(f"digests({count})", processes)
    assert sum("scalar" in name for name in first) == count * len(CHOSEN)
    assert all(digests == first for digests in others)


@pytest.mark.few
@pytest.mark.parametrize("name", NAMES)
def test_no_text_names_what_the_user_named(name: str) -> None:
    """Names of symbols do not occur in generated code."""
    for key, text in texts(name).items():
        if not key.endswith("program"):
            for symbol in ("theta", "omega", "parameter m", "a0.dot"):
                assert symbol not in text, key
