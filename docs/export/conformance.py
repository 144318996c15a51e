"""Build, test and run every target with every scene of the library, and write the table to `out`.

Each scene is exported with all contents that it and the target have. A cell has the number of results that pass the
self-test. With `main` it also has the largest difference of the written trajectory from ours, relative to the largest
entries. If a tool is missing, the cell names it. The script ends with status 1 if a cell fails.
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
from lagrange.export.target import QUANTITIES, find

PAGE = Path(__file__).resolve().parents[2] / "out" / "conformance.md"
METHODS = ("rk4", "verlet", "dop853")
TRAJECTORY = 1e-11
"""Limit of the difference of a short trajectory, relative to its largest entry: both tolerances are 1e-13."""

STRICT = {
    "c": ("cc -std=c99", "cc -std=c99 -Wall -Wextra -Wconversion -Werror"),
    "fmu": ("cc -std=c99", "cc -std=c99 -Wall -Wextra -Wconversion -Werror"),
    "fortran": ("gfortran ", "gfortran -Wall -Wextra -Werror "),
    "rust": ("rustc ", "rustc -D warnings "),
}
"""Replacements in the commands of a target that turn warnings into errors."""

PACKAGES = {"jax": "jax", "casadi": "casadi"}
"""Python packages that a target needs beside NumPy."""


@dataclass(frozen=True)
class Cell:
    """Result of a scene with a target."""

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
    """True if the target can export steps of a method for a system."""
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
        largest = difference(system, done.stdout)
        return Cell(f"{text}; {largest:.0e}", good=largest <= TRAJECTORY, ran=True)


def missing_tool(target: str, commands: Any) -> str:
    """Return the name of a missing package or program, or an empty string."""
    package = PACKAGES.get(target)
    if package and find_spec(package) is None:
        return package
    words = [command.split()[0] for command in commands]
    return next((word for word in words if not word.startswith("./") and shutil.which(word) is None), "")


def run(commands: Any, target: str, folder: str) -> Any:
    """Run the commands of a target in a folder, with warnings as errors."""
    plain, strict = STRICT.get(target, ("", ""))
    lines = [line.replace(plain, strict, 1) if plain and line.startswith(plain) else line for line in commands]
    environment = {**os.environ, "PYTHONWARNINGS": "error"}
    script = " && ".join(lines)
    return subprocess.run(
        ["sh", "-c", script], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def difference(system: lg.System, table: str) -> float:
    """Return the relative difference between the early part of a table that `main` wrote and our run."""
    head, *rows = csv.reader(io.StringIO(table))
    states = np.array(rows, dtype=float)
    few = states[: max(2, len(states) // 100 + 1)]
    n = 2 * len(system.statement.coordinates)
    ours = system.run(float(few[-1, 0]), t_eval=few[:, 0], rtol=1e-13, atol=1e-13, method="dop853")
    assert head[0] == "t"
    return float(np.abs(few[:, 1 : n + 1].T - ours.y).max() / max(1.0, np.abs(ours.y).max()))


def section(target: str, cells: dict[str, Cell]) -> str:
    """Return the section of a target, as Markdown."""
    mine = list(cells.values())
    good, ran = sum(one.good and one.ran for one in mine), sum(one.ran for one in mine)
    told = f"{good} of {ran} scenes that ran are right; {len(mine) - ran} did not run."
    rows = [f"| {scene} | {one.text} |" for scene, one in cells.items()]
    return "\n".join([f"## {target}", "", told, "", "| scene | result |", "|---|---|", *rows])


def known_sections() -> dict[str, str]:
    """Return the sections that an earlier run wrote, by target."""
    parts = PAGE.read_text("utf-8").split("\n## ")[1:] if PAGE.exists() else []
    return {part.partition("\n")[0]: f"## {part}".rstrip("\n") for part in parts}


def main(names: list[str], scenes: list[str]) -> int:
    """Write the sections of the named targets, or of all. Other sections of an earlier run stay."""
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
