"""Mutants: change one operator, comparison or number of the source at random, and see whether a test fails.

    pip install -e '.[mutants]'
    python docs/benchmarks/mutants.py [--count 100] [--seed 1] [--rooms program trajectory ...]

Cosmic Ray makes the mutants and runs the tests in a copy of the committed tree in `out/mutants`. The tests that execute
the changed code run first; pytest-testmon selects them. If none fails, all default tests run: a test that finds a
result in a cache depends on code that it does not execute. A second call with the same arguments continues a stopped
run; remove the folder to start anew. The script prints each mutant that survived, as a difference of the source.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import TestOutcome, WorkItem, WorkResult
from measure import FOLDER

ROOT = FOLDER.parents[1]

ROOMS = ("machine", "trajectory", "program", "evidence")
"""Folders of `lagrange` whose files are changed unless others are given."""

RARE = re.compile(r"_Is$|_IsNot$|Shift|_Mod|_Pow|Bit(And|Or|Xor)|Decorator|ExceptionReplacer|ZeroIteration")
"""Changes that are left out. Few people make these mistakes; `|` mostly stands in types, and `is` often equals `==`."""

TEXT_TESTS = ("test_house.py", "test_layering.py", "test_documents.py")
"""Tests of the text of the source. They would detect a mutant without running it."""

LONGEST = 1200.0
"""Seconds after which the tests of one mutant are stopped. The mutant then counts as killed."""

NONE_SELECTED = 5
"""The exit status of pytest if no test was selected."""


def shell(*command: str, folder: Path) -> None:
    """Run a program of the environment in a folder. An error ends the script."""
    subprocess.run([sys.executable, "-m", *command], cwd=folder, check=True)


def prepare(folder: Path, rooms: Sequence[str], seed: int, count: int) -> None:
    """Copy the tree to a folder, record which tests execute which code, and draw a sample of `count` mutants."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder)], check=True)
    left_out = [f"--ignore=tests/{name}" for name in TEXT_TESTS]
    shell("pytest", "-q", "-n", "auto", "--testmon", *left_out, folder=folder)
    every_test = " ".join([sys.executable, "-m pytest -q -x -n auto", *left_out])
    selected = " ".join([sys.executable, "-m pytest -q -x --testmon --testmon-nocollect", *left_out])
    command = f"bash -c '({selected} || [ $? = {NONE_SELECTED} ]) && {every_test}'"
    lines = [
        "[cosmic-ray]",
        f"module-path = {[f'lagrange/{room}' for room in rooms]}",
        f"timeout = {LONGEST}",
        "excluded-modules = []",
        f"test-command = {json.dumps(command)}",
        "[cosmic-ray.distributor]",
        "name = 'local'",
    ]
    (folder / "mutants.toml").write_text("\n".join(lines), encoding="utf-8")
    shell("cosmic_ray.cli", "init", "mutants.toml", "mutants.sqlite", folder=folder)
    with use_db(folder / "mutants.sqlite") as session:
        every = sorted(session.work_items, key=lambda item: repr(item.mutations))
        every = [item for item in every if not RARE.search(item.mutations[0].operator_name)]
        session.clear()
        session.add_work_items(random.Random(seed).sample(every, count))


def results(folder: Path) -> list[tuple[WorkItem, WorkResult]]:
    """Return each mutant that met tests, with the outcome."""
    with use_db(folder / "mutants.sqlite") as session:
        return list(session.completed_work_items)


def main() -> None:
    """Draw mutants, run the tests of each, and print the survivors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=ROOMS)
    options = parser.parse_args()
    folder = ROOT / "out" / "mutants"
    if not (folder / "mutants.sqlite").exists():
        prepare(folder, options.rooms, options.seed, options.count)
    shell("cosmic_ray.cli", "exec", "mutants.toml", "mutants.sqlite", folder=folder)
    outcomes = results(folder)
    survivors = [result for _, result in outcomes if result.test_outcome == TestOutcome.SURVIVED]
    for survivor in survivors:
        print(survivor.diff, end="\n\n")
    print(f"{len(outcomes) - len(survivors)} of {len(outcomes)} mutants were killed")


if __name__ == "__main__":
    main()
