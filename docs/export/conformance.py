"""Build, test and run every target with every scene of the library, and write the table to `out`.

Each scene is exported with all contents that it and the target have. A cell says what came of it: the number of results
that the self-test found right, and the largest difference of the trajectory that `main` writes from ours, relative to
its largest entries. Without a tool a cell says which one is missing. The script ends with status 1 if a cell fails.
"""

from __future__ import annotations

import csv
import io
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import lagrange as lg
from lagrange.export.registry import find
from lagrange.export.target import QUANTITIES

PAGE = Path(__file__).resolve().parents[2] / "out" / "conformance.md"
METHODS = ("rk4", "verlet", "dop853")
TRAJECTORY = 1e-11
"""What the end of a short trajectory may differ by, relative to the largest entry: both runs have tolerance 1e-13."""

STRICT = {
    "c": ("cc -std=c99", "cc -std=c99 -Wall -Wextra -Wconversion -Werror"),
    "fmu": ("cc -std=c99", "cc -std=c99 -Wall -Wextra -Wconversion -Werror"),
    "fortran": ("gfortran ", "gfortran -Wall -Wextra -Werror "),
    "rust": ("rustc ", "rustc -D warnings "),
}
"""What makes a warning an error, where the commands of a target do not ask for it."""

PACKAGES = {"jax": "jax", "casadi": "casadi"}
"""What a target needs of Python, beside NumPy."""


@dataclass(frozen=True)
class Cell:
    """What came of a scene with a target."""

    text: str
    good: bool
    ran: bool


def contents_of(system: lg.System, target: str) -> list[str]:
    """Return all contents that a system and a target have."""
    statement = system.statement
    stated = {
        "events": False,
        "multipliers": bool(statement.constraints),
        "positions": bool(statement.positions),
        "energies": not statement.lagrangian_alone,
    }
    found = [name for name in QUANTITIES if stated.get(name, True)]
    known = find(target).contents
    if "steps" in known:
        found += [name for name in METHODS if allowed(system, target, name)]
    return found + ["main"] * ("main" in known)


def allowed(system: lg.System, target: str, name: str) -> bool:
    """Whether a method steps a system."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            system.export(target, folder, [name])
        except lg.StatementError:
            return False
        return True


def cell(scene: str, target: str) -> Cell:
    """Export a scene, build and run its test, and compare the trajectory of its main."""
    system = lg.scene(scene)
    with tempfile.TemporaryDirectory() as folder:
        try:
            made = system.export(target, folder, contents_of(system, target))
        except lg.StatementError as error:
            return Cell(f"refused: {error}", good=False, ran=False)
        missing = missing_tool(target, made.commands)
        if missing:
            return Cell(f"not run: {missing} is not installed", good=True, ran=False)
        done = run(made.commands, target, folder)
        if done.returncode:
            return Cell(f"FAILED: {(done.stdout + done.stderr)[-300:]}", good=False, ran=True)
        said = done.stdout.strip().splitlines()
        text = said[-1].partition(": ")[2] or said[-1] if said else "passed"
        if not made.run_commands:
            return Cell(text, good=True, ran=True)
        done = run(made.run_commands, target, folder)
        if done.returncode:
            return Cell(f"{text}; main FAILED: {done.stderr[-200:]}", good=False, ran=True)
        error = difference(system, done.stdout)
        return Cell(f"{text}; {error:.0e}", good=error <= TRAJECTORY, ran=True)


def missing_tool(target: str, commands: Any) -> str:
    """Return a package or a program of the commands that is not there."""
    package = PACKAGES.get(target)
    if package and find_spec(package) is None:
        return package
    words = [command.split()[0] for command in commands]
    return next((word for word in words if not word.startswith("./") and shutil.which(word) is None), "")


def run(commands: Any, target: str, folder: str) -> Any:
    """Run shell lines of our own in a folder, warnings being errors."""
    plain, strict = STRICT.get(target, ("", ""))
    lines = [line.replace(plain, strict, 1) if plain and line.startswith(plain) else line for line in commands]
    environment = {**os.environ, "PYTHONWARNINGS": "error"}
    script = " && ".join(lines)
    return subprocess.run(
        ["sh", "-c", script], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def difference(system: lg.System, table: str) -> float:
    """Return how far the early part of a table of main is from our run."""
    head, *rows = csv.reader(io.StringIO(table))
    states = np.array(rows, dtype=float)
    few = states[: max(2, len(states) // 100 + 1)]
    n = 2 * len(system.statement.coordinates)
    ours = system.run(float(few[-1, 0]), t_eval=few[:, 0], rtol=1e-13, atol=1e-13, method="dop853")
    assert head[0] == "t"
    return float(np.abs(few[:, 1 : n + 1].T - ours.y).max() / max(1.0, np.abs(ours.y).max()))


def section(target: str, cells: dict[str, Cell]) -> str:
    """Return the part of the page about a target."""
    mine = list(cells.values())
    good, ran = sum(one.good and one.ran for one in mine), sum(one.ran for one in mine)
    told = f"{good} of {ran} scenes that ran are right; {len(mine) - ran} did not run."
    rows = [f"| {scene} | {one.text} |" for scene, one in cells.items()]
    return "\n".join([f"## {target}", "", told, "", "| scene | result |", "|---|---|", *rows])


def known_sections() -> dict[str, str]:
    """Return the parts of the page that is there, by target."""
    parts = PAGE.read_text("utf-8").split("\n## ")[1:] if PAGE.exists() else []
    return {part.partition("\n")[0]: f"## {part}".rstrip("\n") for part in parts}


def main(names: list[str], scenes: list[str]) -> int:
    """Write the page for all targets; where some are named, the others keep what the page says of them."""
    sections, bad = known_sections(), []
    for target in names or list(lg.targets()):
        cells = {scene: cell(scene, target) for scene in scenes}
        bad += [f"{target}, {scene}: {one.text}" for scene, one in cells.items() if not one.good]
        sections[target] = section(target, cells)
        methods = ", ".join(METHODS)
        about = f"Contents: all quantities that the scene has, {methods} where they apply, and main."
        head = ["# Conformance of exported files", (__doc__ or "").partition("\n\n")[2].strip(), about]
        kept = [sections[name] for name in lg.targets() if name in sections]
        PAGE.parent.mkdir(exist_ok=True)
        PAGE.write_text("\n\n".join([*head, *kept]) + "\n", encoding="utf-8")
        print(f"{target}: written", flush=True)
    print("\n".join(bad) or "all cells that ran are right")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], lg.scenes()))
