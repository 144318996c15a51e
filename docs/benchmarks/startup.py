"""Time of a new process: imports, the help of the command line, a cold run.

python docs/benchmarks/startup.py
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
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


Times = tuple[float, float]
"""Processor seconds, and seconds passed."""


def python(code: str) -> Times:
    """Time a new interpreter that runs the code."""
    return _times([sys.executable, "-c", code])


def command(*words: str) -> Times:
    """Time a command line of lagrange in a new process."""
    return _times([str(Path(sys.executable).with_name("lagrange")), *words])


def _times(words: list[str]) -> Times:
    start, used = perf_counter(), _used()
    subprocess.run(words, check=True, capture_output=True)
    return _used() - used, perf_counter() - start


def _used() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def fastest(runs: Mapping[str, Callable[[], Times]]) -> dict[str, Times]:
    """Return the least of each, the runs taking turns."""
    found: dict[str, list[Times]] = {name: [] for name in runs}
    for _ in range(TIMES):
        for name, run in runs.items():
            found[name].append(run())
    return {name: (min(t[0] for t in times), min(t[1] for t in times)) for name, times in found.items()}


def main() -> None:
    """Measure, print and write the page."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # the processes shall find bytecode
    page = Page("Starting up", __file__)
    with tempfile.TemporaryDirectory() as folder:
        lines = {f"python -c '{code}'": code for code in (BARE, SYMPY, LAGRANGE, ALL)}
        runs = {name: partial(python, code) for name, code in lines.items()}
        runs["lagrange --help"] = partial(command, "--help")
        runs["lagrange run double-pendulum"] = partial(command, "run", "double-pendulum", "--out", folder)
        times = fastest(runs)
    page.table(
        ("process", "processor, ms", "passed, ms"),
        [(f"`{name}`", milliseconds(used), milliseconds(passed)) for name, (used, passed) in times.items()],
    )
    used = {name: pair[0] for name, pair in times.items()}
    without = used[f"python -c '{SYMPY}'"]
    rows = [
        ("`import lagrange` beyond `import sympy`", used[f"python -c '{LAGRANGE}'"] - without, IMPORT_BAR),
        ("the same with every public name loaded", used[f"python -c '{ALL}'"] - without, None),
        ("`lagrange --help`", used["lagrange --help"], HELP_BAR),
        ("`lagrange run double-pendulum`, cold", used["lagrange run double-pendulum"], RUN_BAR),
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
