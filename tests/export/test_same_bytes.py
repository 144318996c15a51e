"""The same statement gives the same bytes in every process, whatever the seed of Python's hashes."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

import lagrange as lg

TARGETS = tuple(name for name in lg.targets() if name != "fmu")
"""An FMU is the sources of C and what a compiler makes of them; its bytes have a test of their own."""

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
import hashlib, pathlib, sys, tempfile
import lagrange as lg
from lagrange.export.target import find
found = hashlib.sha256()
for scene, contents in (
    ("double-pendulum", ["rhs", "energy", "jacobian", "dop853", "main"]),
    ("four-bar", ["rhs", "multipliers", "rk4"]),
):
    system = lg.scene(scene)
    for target in sys.argv[1:]:
        with tempfile.TemporaryDirectory() as folder:
            steps = find(target).contents >= {"steps", "main"}
            some = [one for one in contents if steps or one not in ("rk4", "dop853", "main")]
            made = system.export(target, folder, some)
            for path in made.files:
                found.update(path.name.encode() + path.read_bytes())
print(found.hexdigest())
"""


def digest(seed: int) -> str:
    environment = {**os.environ, "PYTHONHASHSEED": str(seed), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *TARGETS], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.mark.slow
def test_two_processes() -> None:
    first = digest(1)
    assert len(first) == len(hashlib.sha256().hexdigest())
    assert digest(2) == first


@pytest.mark.conformance
def test_fifty_processes() -> None:
    assert len({digest(seed) for seed in range(50)}) == 1
