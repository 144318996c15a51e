"""The same statement gives the same bytes in every process; targets whose packages are broken are named."""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
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
from lagrange.trajectory.methods.runge_kutta import DOP853, RK4
from lagrange.trajectory.methods.runge_kutta import runge_kutta_step as step_of
from lagrange.trajectory.methods.splitting import Verlet, splitting_step
from tests.models import SYSTEMS
from tests.systems import unit_pendulum

ROOT = Path(__file__).resolve().parent.parent
NAMES = ("double pendulum", "chain of 7", "cart and pole", "blocks", "friction", "8 carried masses", "saddle")
CHOSEN = ("rhs", "energy")


def texts(name: str, quantities: Iterable[str] = QUANTITIES) -> dict[str, str]:
    """Return all generated text of a system: programs, and LLVM IR for one state and for columns."""
    equations = euler_lagrange(SYSTEMS[name]())
    result = {}
    for quantity in quantities:
        program = program_of(quantity, equations)
        result[f"{name} {quantity} program"] = repr(program)
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


@pytest.mark.few(1)
@pytest.mark.parametrize("name", NAMES)
def test_no_text_names_what_the_user_named(name: str) -> None:
    """Names of symbols do not occur in generated code."""
    for key, text in texts(name).items():
        if not key.endswith("program"):
            for symbol in ("theta", "omega", "parameter m", "a0.dot"):
                assert symbol not in text, key


# --- targets whose packages are broken: messages name the package, and do not advise the same target again -----


class Broken(ModuleType):
    """A finder that makes a package fail like one with a broken shared library."""

    def __getattr__(self, name: str) -> Any:
        raise OSError("Could not load shared object file: libllvmlite.so")


@pytest.fixture(params=["a module is missing", "a shared library is missing"])
def broken(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Break llvmlite, unload the modules that use it, and return the text that the message must contain."""
    users = [name for name in sys.modules if name.startswith("lagrange.machine.llvm_machine")]
    for name in users:
        monkeypatch.delitem(sys.modules, name)
    gone: Any = None
    if request.param == "a module is missing":
        monkeypatch.setitem(sys.modules, "lagrange.machine.llvm.engine", gone)
        yield "lagrange.machine.llvm.engine"
    else:
        monkeypatch.setitem(sys.modules, "lagrange.machine.llvm.engine", Broken("lagrange.machine.llvm.engine"))
        yield "libllvmlite.so"


def test_the_message_names_what_cannot_be_loaded(broken: str) -> None:
    system = unit_pendulum()
    with pytest.raises(lg.StatementError, match="target 'llvm' cannot be loaded") as refusal:
        system.run(1.0)
    assert broken in str(refusal.value) and "run(..., target='numpy')" in str(refusal.value)
    assert system.run(1.0, target="numpy").status is lg.Status.SUCCESS


def test_numpy_is_checked_without_llvm(broken: str) -> None:
    """The check of the numpy target must not compile for LLVM."""
    report = unit_pendulum().check(target="numpy")
    assert report
    assert "not compared with the target llvm" in str(report) and broken in str(report)


def test_a_broken_numpy_target_does_not_send_to_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    gone: Any = None
    monkeypatch.delitem(sys.modules, "lagrange.machine.numpy_machine", raising=False)
    monkeypatch.setitem(sys.modules, "lagrange.machine.python_source", gone)
    with pytest.raises(lg.StatementError, match="target 'numpy' cannot be loaded") as refusal:
        unit_pendulum().compile("numpy")
    assert "python_source" in str(refusal.value) and str(refusal.value).count("numpy") == 1
