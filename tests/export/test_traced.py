"""Models exported for JAX and CasADi pass their self-tests, and run as the pages say."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

import lagrange as lg
from tests.export.callers import run, section
from tests.export.systems import every_scene, held
from tests.export.test_modules import coupled

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
    system = lg.scene(scene)
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
    system = lg.scene("pendulum")
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
    system = lg.scene("double-pendulum")
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
