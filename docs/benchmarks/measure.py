"""Time rivals side by side, describe the machine, and write the tables of a benchmark to `out/benchmarks`."""

from __future__ import annotations

import gc
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import thread_time
from typing import TYPE_CHECKING, Any

import lagrange

if TYPE_CHECKING:  # the import would change the times of first imports
    from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parent
OUT = FOLDER.parents[1] / "out" / "benchmarks"
"""Folder of the tables and pictures that the scripts write; Git ignores it."""

PACKAGES = ("numpy", "scipy", "sympy", "llvmlite", "heyoka")


def best(
    runs: Mapping[str, Callable[[], Any]],
    *,
    rounds: int = 30,
    least: float = 0.02,
    patience: float = math.inf,
    clock: Callable[[], float] = thread_time,
) -> dict[str, float]:
    """Return the processor seconds of one call of each, the least of many rounds.

    The rivals take turns, each called for at least `least` seconds in every round, so that a busy moment of the machine
    falls on all of them. If `least` is 0, each is called once a round and not before. A rival whose rounds have taken
    more than `patience` seconds has no more. All run on one thread, whose processor time is the time on the clock when
    nothing else runs; of several threads the clock is `process_time`.
    """
    counts, spent, times = dict.fromkeys(runs, 1), dict.fromkeys(runs, 0.0), dict.fromkeys(runs, math.inf)
    for name, run in runs.items():
        if least:
            counts[name], spent[name] = _first_round(run, least, clock)
            times[name] = spent[name] / counts[name]
    collecting = gc.isenabled()
    gc.disable()
    try:
        for _ in range(rounds):
            for name, run in runs.items():
                if spent[name] <= patience:
                    seconds = _timed(run, counts[name], clock)
                    times[name] = min(times[name], seconds / counts[name])
                    spent[name] += seconds
    finally:
        if collecting:
            gc.enable()
    return times


def _first_round(run: Callable[[], Any], least: float, clock: Callable[[], float]) -> tuple[int, float]:
    """Return how many calls take at least `least` seconds, and the seconds that they took."""
    run()
    count = 1
    while (seconds := _timed(run, count, clock)) < least:
        count = max(2 * count, int(1.2 * count * least / max(seconds, 1e-9)))
    return count, seconds


def _timed(run: Callable[[], Any], count: int, clock: Callable[[], float]) -> float:
    start = clock()
    for _ in range(count):
        run()
    return clock() - start


def in_new_process(script: str, *arguments: str, seconds: float | None = None) -> Any:
    """Return what a script prints as JSON in its last line, from a new process that may take so many seconds."""
    done = subprocess.run([sys.executable, script, *arguments], stdout=subprocess.PIPE, check=True, timeout=seconds)
    return json.loads(done.stdout.splitlines()[-1])


def machine() -> list[str]:
    """Return what was measured on: processor, operating system, versions."""
    versions = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return [
        f"{date.today().isoformat()}, {processor()}, {platform.system()} {platform.machine()}",
        f"Python {platform.python_version()}, lagrange {lagrange.__version__}, {versions}, {compiler()}",
    ]


def processor() -> str:
    """Return the processor's name and what of its vector units matters."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    facts: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(":")
        facts.setdefault(name.strip(), value.strip())
    flags = facts.get("flags", "").split()
    vectors = next((name for name in ("avx512f", "avx2") if name in flags), "no AVX2")
    family = f"family {facts.get('cpu family', '?')}, model {facts.get('model', '?')}"
    return f"{facts.get('model name', 'a processor')} ({family}, {vectors}, {os.cpu_count()} cores)"


def compiler() -> str:
    """Return the C compiler's version."""
    try:
        shown = subprocess.run(["gcc", "--version"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return "no gcc"
    return shown.splitlines()[0]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


class Page:
    """A page of tables and sentences; it is printed while it grows, and written at the end."""

    def __init__(self, title: str, script: str) -> None:
        self.script = Path(script)
        self.parts = [
            f"# {title}",
            "`docs/benchmarks` says how this is measured.",
            "\n".join(f"{line}  " for line in machine()).rstrip(),
        ]
        for part in self.parts:
            print(part, end="\n\n")

    def text(self, words: str) -> None:
        """Add a paragraph or a heading."""
        self.parts.append(words)
        print(words, end="\n\n", flush=True)

    def table(self, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """Add a table, its columns as wide as they need to be."""
        cells = [list(head), *([str(cell) for cell in row] for row in rows)]
        widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
        lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in cells]
        lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
        self.text("\n".join(lines))

    def write(self) -> None:
        """Write the page to `out/benchmarks`, under the name of its script."""
        OUT.mkdir(parents=True, exist_ok=True)
        path = OUT / f"{self.script.stem}.md"
        made = f"Made by `{self.script.name}`."
        path.write_text("\n\n".join([*self.parts, made]) + "\n", encoding="utf-8")
        print(f"wrote {path}", file=sys.stderr)


def saved(figure: Figure, name: str, dpi: int) -> None:
    """Save a picture beside the tables."""
    OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(OUT / name, dpi=dpi)


def shown(value: float) -> str:
    """Return three digits of a number, or all before the point."""
    return f"{value:.0f}" if value >= 1000 else f"{value:.3g}"


def milliseconds(seconds: float) -> str:
    """Return a duration in ms."""
    return shown(1e3 * seconds)


def microseconds(seconds: float) -> str:
    """Return a duration in us."""
    return shown(1e6 * seconds)


def verdict(value: float, bar: float) -> str:
    """Say whether a value is within its bar."""
    return "yes" if value <= bar else "**no**"
