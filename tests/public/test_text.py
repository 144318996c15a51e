"""No text of a user's is ever run: every public callable, every argument, every container."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import lagrange as lg
from tests.public.audit import MARK, TEXT

ROOT = Path(__file__).resolve().parents[2]


def test_no_text_is_run_whatever_it_is_in(tmp_path: Path, everything: bool) -> None:
    part = 1 if everything else 120
    result = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.public.audit", str(part)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"},
        check=True,
    )
    answer = json.loads(result.stdout)
    assert answer["wrong"] == []
    assert answer["canary"] == []
    assert answer["calls"] > 10_000 // part


@pytest.mark.parametrize("call", [
    lambda x: lg.rotational_energy([TEXT], [x.dot]),
    lambda x: lg.rotational_energy(1, [TEXT]),
    lambda x: lg.rotational_energy([[TEXT]], [x.dot]),
    lambda x: lg.kinetic_energy(1, [TEXT]),
    lambda x: lg.kinetic_energy(TEXT, [x]),
    lambda x: lg.gravity(1, [x], TEXT),
    lambda x: lg.spring(1, [x], [0], TEXT),
])  # fmt: skip
def test_text_in_an_energy_is_refused(call: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert callable(call)
    with pytest.raises(lg.StatementError, match="is the text '__import__"):
        call(lg.coordinate("x"))
    assert not (tmp_path / MARK).exists()
