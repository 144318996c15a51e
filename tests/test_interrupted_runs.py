"""`lagrange run --out`, stopped by SIGINT or SIGTERM at random moments: a folder with a card holds one run.

Three signals are tried in turn, twenty with --all; `LAGRANGE_SIGNALS=200` tries 200. Moments are parts of the time
that a run takes here and now, half of them in the first half of its writing: what comes after is soon over. That each
operation of the exchange may be stopped is shown one by one in tests/show/test_transaction.py.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.covering import Share

SEED = int(os.environ.get("LAGRANGE_SEED", "20"))

NAMES = ("card.json", "trajectory.csv", "trajectory.png")

SENTENCE = "lagrange: interrupted; no file was left half written.\n"

FACTOR, PATIENCE = 2.0, 120.0
"""A run that was sent a signal ends within `FACTOR` times what is measured for a whole run, and `PATIENCE` seconds."""


@dataclass
class Runs:
    """Runs into one folder, each from its own initial angle, which tells its files apart."""

    folder: Path
    angle: int = 0
    whole: float = 0.0
    writing: float = 10.0
    seen: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0

    def start(self) -> subprocess.Popen[str]:
        """Start a run from the next angle."""
        self.angle += 1
        options = ("--initial", f"theta={self.angle / 1000}", "--t-end", "3", "--no-check", "--out", str(self.folder))
        return subprocess.Popen(
            [sys.executable, "-m", "lagrange", "run", "pendulum", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def measure(self) -> None:
        """Let a run get to its end, and take its time and that of its writing."""
        began = time.perf_counter()
        with self.start() as process:
            self.wait(process, writing=True)
            wrote = time.perf_counter()
            self.wait(process, writing=False)
            self.writing = min(self.writing, time.perf_counter() - wrote)
            printed, complaint = process.communicate(timeout=600)
        assert (process.returncode, complaint) == (0, "") and "written to" in printed
        assert self.held() == self.angle
        self.whole = time.perf_counter() - began

    def wait(self, process: subprocess.Popen[str], *, writing: bool) -> None:
        """Wait until new files are prepared, or are no more."""
        while process.poll() is None and any(self.folder.glob(".*.part")) is not writing:
            time.sleep(0.002)

    def held(self) -> int:
        """Return the angle of the run that the folder holds, having seen that all its files are of that run."""
        assert sorted(path.name for path in self.folder.iterdir()) == sorted((*NAMES, "notes.txt"))
        assert (self.folder / "notes.txt").read_text() == "mine"
        card = json.loads((self.folder / "card.json").read_text("utf-8"))
        angle: float = card["initial"]["theta"]
        first, *_, last = (self.folder / "trajectory.csv").read_text("utf-8").splitlines()[1:]
        assert float(first.split(",")[1]) == angle
        assert float(last.split(",")[1]) == card["final"]["theta"]
        return round(angle * 1000)

    def interrupt(self, number: signal.Signals, moment: float, *, writing: bool) -> None:
        """Send a run a signal at a moment, and see what comes of it."""
        before, held = {name: (self.folder / name).read_bytes() for name in NAMES}, self.held()
        with self.start() as process:
            if writing:
                self.wait(process, writing=True)
                time.sleep(moment * self.writing)
            else:
                time.sleep(moment * self.whole)
            handled = listens(process.pid)
            process.send_signal(number)
            sent = time.perf_counter()
            printed, complaint = process.communicate(timeout=600)
            self.slowest = max(self.slowest, time.perf_counter() - sent)
        assert time.perf_counter() - sent < PATIENCE + FACTOR * self.whole
        if not (self.folder / "card.json").exists():
            assert handled and process.returncode == 128 + number and not any(self.folder.glob(".*"))
            self.seen["interrupted in the exchange, no card"] += 1
            self.measure()
            return
        after = {name: (self.folder / name).read_bytes() for name in NAMES}
        now = self.held()
        new = [name for name in NAMES if after[name] != before[name]]
        assert (now, new) in ((held, []), (self.angle, list(NAMES))), "all files are new, or all are old"
        if not handled and process.returncode == 0:
            assert new
            self.seen["all was done"] += 1
        elif not handled:
            assert not new
            self.seen["the interpreter was still starting"] += 1
        else:
            assert "Traceback" not in complaint and "Exception ignored" not in complaint, complaint
            assert (process.returncode, complaint) in ((128 + number, SENTENCE), (128 + number, ""), (0, ""))
            assert complaint or (printed.startswith("pendulum: ") and new)
            self.seen[f"exit code {process.returncode}, {'new' if new else 'old'} files"] += 1


def listens(process: int) -> bool:
    """Return whether the program handles its signals by now: Python alone never handles SIGHUP."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except FileNotFoundError:
        return False
    (caught,) = (int(line.split()[1], 16) for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(caught >> (signal.SIGHUP - 1) & 1)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads /proc to know when signals are handled")
def test_signals_at_random_moments(tmp_path: Path, share: Share) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    runs, chance = Runs(tmp_path), random.Random(SEED)
    count = int(os.environ.get("LAGRANGE_SIGNALS", share(20)))
    for k in range(count):
        if k % 20 == 0:
            runs.measure()
        number, writing = (signal.SIGINT, signal.SIGTERM)[k % 2], k % 4 in (1, 2)
        runs.interrupt(number, chance.uniform(*((0, 0.5) if writing else (0, 1.1))), writing=writing)
    for what, times in sorted(runs.seen.items()):
        sys.stdout.write(f"{times:4} {what}\n")
    sys.stdout.write(f"a whole run {runs.whole:.2f} s, slowest end {runs.slowest:.2f} s after the signal\n")
    assert sum(runs.seen.values()) == count
