"""What a fresh process costs: imports, the command line's help, a cold run.

python docs/benchmarks/startup.py
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

from measure import Page, milliseconds, verdict

TIMES = 9
IMPORT_BAR, HELP_BAR, RUN_BAR = 0.2, 0.3, 3.0

BARE, SYMPY, LAGRANGE, ALL = (
    "pass",
    "import sympy",
    "import sympy, lagrange",
    "import sympy, lagrange; lagrange.System; lagrange.integrate; lagrange.methods",
)


def python(code: str) -> float:
    """Return the seconds of a new interpreter that runs the code."""
    return _seconds([sys.executable, "-c", code])


def command(*words: str) -> float:
    """Return the seconds of a command line of lagrange in a new process."""
    return _seconds([str(Path(sys.executable).with_name("lagrange")), *words])


def _seconds(words: list[str]) -> float:
    start = perf_counter()
    subprocess.run(words, check=True, capture_output=True)
    return perf_counter() - start


def fastest(runs: dict[str, Callable[[], float]]) -> dict[str, float]:
    """Return the least seconds of each, the runs taking turns."""
    times = {name: run() for name, run in runs.items()}
    for _ in range(TIMES - 1):
        for name, run in runs.items():
            times[name] = min(times[name], run())
    return times


def main() -> None:
    """Measure, print and write the page."""
    page = Page(
        "Starting up",
        __file__,
        f"Each line is a new process, the fastest of {TIMES}; files are in the disk cache, bytecode is compiled.",
    )
    with tempfile.TemporaryDirectory() as folder:
        runs: dict[str, Callable[[], float]] = {
            f"python -c '{code}'": lambda c=code: python(c) for code in (BARE, SYMPY)
        }
        runs |= {f"python -c '{code}'": lambda c=code: python(c) for code in (LAGRANGE, ALL)}
        runs["lagrange --help"] = lambda: command("--help")
        runs["lagrange run double-pendulum --out DIR"] = lambda: command("run", "double-pendulum", "--out", folder)
        times = fastest(runs)
    page.table(("process", "ms"), [(f"`{name}`", milliseconds(seconds)) for name, seconds in times.items()])
    bare = times[f"python -c '{SYMPY}'"]
    rows = [
        ("`import lagrange` beyond `import sympy`", times[f"python -c '{LAGRANGE}'"] - bare, IMPORT_BAR),
        ("the same, and every public name loaded", times[f"python -c '{ALL}'"] - bare, None),
        ("`lagrange --help`", times["lagrange --help"], HELP_BAR),
        ("`lagrange run double-pendulum`, cold", times["lagrange run double-pendulum --out DIR"], RUN_BAR),
    ]
    page.table(
        ("what", "ms", "bar, ms", "within"),
        [
            (name, milliseconds(max(s, 0.0)), milliseconds(bar) if bar else "", verdict(s, bar) if bar else "")
            for name, s, bar in rows
        ],
    )
    page.write()


if __name__ == "__main__":
    main()
