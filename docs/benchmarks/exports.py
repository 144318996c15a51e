"""Exported right-hand sides against our kernels and C by hand, and what an export and its compilation take."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from measure import Page, best, shown, verdict
from native import address, compiled, in_turn, kernel, library, pointer
from numpy.typing import NDArray
from systems import chain, double_pendulum
from taylor_systems import CASES, Case, rival

import lagrange as lg

CALLS = 20_000
LINKS = (5, 10)
TOLERANCES, SERIES = (1e-9, 1e-15), ("double", "solar")
SCRIPT = Path(__file__).with_name("exported_calls.mjs")


def exported(system: lg.System, folder: str, contents: list[str], size: int) -> tuple[Any, NDArray[Any]]:
    """Return the functions of a system's exported C by name, and the `size` numbers that they read."""
    made = system.export("c", folder, contents)
    source = next(path for path in made.files if path.suffix == ".c")
    loaded, numbers = library(source, Path(folder)), np.zeros(size)
    functions = {name: loaded[f"{source.stem}_{name}"] for name in ("prepare", *contents)}
    functions["prepare"](pointer(system.compile().parameter_array()), pointer(numbers))
    return functions, numbers


def rivals(system: lg.System, quantity: str, folder: str) -> dict[str, Callable[[], int]]:
    """Return calls of the exported function and of the kernel of a quantity, at a state of the system."""
    functions, numbers = exported(system, f"{folder}/{quantity}", [quantity], 10_000)
    y = np.linspace(0.3, 1.2, 2 * len(system.coordinates))
    return {
        "exported C": in_turn(address(functions[quantity]), numbers, y, CALLS),
        "our kernel": in_turn(*kernel(system.compile(), quantity), y, CALLS),
    }


def right_sides(page: Page, folder: str) -> None:
    """Compare the double pendulum with C by hand, and chains with our kernels."""
    system, rows = double_pendulum(), []
    hand = address(compiled("double_pendulum.c").by_hand)
    by_hand = in_turn(hand, system.compile().parameter_array(), np.linspace(0.3, 1.2, 4), CALLS)
    times = best({**rivals(system, "accelerations", folder), "C by hand": by_hand})
    ratio = times["exported C"] / times["C by hand"]
    rows.append(["double pendulum, accelerations", *row(times), "C by hand", shown(ratio), verdict(ratio, 1.1)])
    for n in LINKS:
        times = best(rivals(lg.System(**chain(n)), "rhs", folder))
        ratio = times["exported C"] / times["our kernel"]
        rows.append([f"{n} links, rhs", *row(times), "our kernel", shown(ratio), verdict(ratio, 1.1)])
    head = ["function", "exported C, ns", "our kernel, ns", "C by hand, ns", "against", "ratio", "at most 1.1"]
    page.table(head, rows)


def row(times: dict[str, float]) -> list[str]:
    """Return nanoseconds a call of each rival."""
    names = ("exported C", "our kernel", "C by hand")
    return [shown(times[name] / CALLS * 1e9) if name in times else "" for name in names]


def javascript(page: Page, folder: str) -> None:
    """Compare exported JavaScript in node with exported C."""
    if shutil.which("node") is None:
        page.text("node is not installed here: JavaScript was not measured.")
        return
    system = double_pendulum()
    made = system.export("javascript", folder, ["rhs"])
    y = [repr(float(x)) for x in np.linspace(0.3, 1.2, 4)]
    command = ["node", str(SCRIPT), str(made.files[0].resolve()), "2000000", *y]
    found = [float(subprocess.run(command, check=True, capture_output=True, text=True).stdout) for _ in range(5)]
    times = best(rivals(system, "rhs", folder))
    c, ratio = times["exported C"] / CALLS * 1e9, min(found) / (times["exported C"] / CALLS * 1e9)
    head = ["double pendulum, rhs", "ns a call", "of C's time", "at most 2"]
    page.table(head, [["C", shown(c), "1", ""], ["JavaScript", shown(min(found)), shown(ratio), verdict(ratio, 2.0)]])


def series(page: Page, folder: str) -> None:
    """Compare exported Taylor integrators with our own flow and heyoka's integrator at the same tolerance."""
    rows = []
    for case in CASES:
        if case.name not in SERIES:
            continue
        system = case.system()
        functions, numbers = exported(system, f"{folder}/series", ["taylor"], 100_000)
        for tolerance in TOLERANCES:
            run = taylor_run(functions["taylor"], case, numbers, tolerance)
            flow = lg.flow(system.compile(), method="taylor", rtol=tolerance, atol=tolerance)
            start = np.array(case.start)
            theirs = rival(case, system, "default", tolerance)
            times = best(
                {
                    "c": run,
                    "ours": partial(flow, start, 0.0, case.t_end),
                    "heyoka": partial(theirs.run, start, case.t_end),
                }
            )
            ratio, other = times["c"] / times["ours"], times["c"] / times["heyoka"]
            shares = [shown(ratio), verdict(ratio, 1.5), shown(other), verdict(other, 1.0)]
            rows.append([case.name, tolerance, *(shown(1e6 * one) for one in times.values()), *shares])
    head = ["system", "tolerance", "exported C, us", "ours, us", "heyoka, us"]
    page.table([*head, "C / ours", "at most 1.5", "C / heyoka", "at most 1"], rows)


def taylor_run(function: Any, case: Case, p: Any, tolerance: float) -> Any:
    """Return a function that runs a case by an exported Taylor integrator."""
    function.argtypes = [
        *[ctypes.c_void_p, ctypes.c_double],
        *[ctypes.c_void_p] * 2,
        *[ctypes.c_double] * 2,
        ctypes.c_int64,
    ]
    function.restype = ctypes.c_int64
    t, y, start = np.zeros(1), np.array(case.start), np.array(case.start)

    def run() -> None:
        t[0], y[:] = 0.0, start
        outcome = function(t.ctypes.data, case.t_end, y.ctypes.data, p.ctypes.data, tolerance, tolerance, 10_000_000)
        assert outcome == 0

    return run


def compilation(page: Page, folder: str) -> None:
    """Measure exports of chains, and gcc -O2 of what they write."""
    rows = []
    for n, most_export, most_compile in ((2, 3.0, 2.0), (10, 3.0, 2.0), (30, 3.0, 20.0)):
        system = lg.System(**chain(n))
        before = perf_counter()
        made = system.export("c", folder)
        export = perf_counter() - before
        source = next(path for path in made.files if path.suffix == ".c")
        seconds = []
        for _ in range(3):
            before = perf_counter()
            subprocess.run(["gcc", "-O2", "-c", "-o", f"{folder}/object.o", source], check=True)
            seconds.append(perf_counter() - before)
        worst = max(export / most_export, min(seconds) / most_compile)
        lines = len(source.read_text().splitlines())
        bars = f"{most_export:g} and {most_compile:g}"
        rows.append([n, lines, shown(export), shown(min(seconds)), bars, verdict(worst, 1.0)])
    page.table(["links", "lines of C", "export, s", "gcc -O2, s", "at most, s", "within"], rows)


def main() -> None:
    """Measure, print and write the page."""
    page = Page("Exported code", __file__)
    with tempfile.TemporaryDirectory() as folder:
        page.text("## Right-hand sides")
        right_sides(page, folder)
        page.text("## JavaScript\n\nIn node, called likewise from JavaScript, the least of five processes.")
        javascript(page, folder)
        page.text("## Taylor integrators\n\nWhole runs at the same tolerance, rtol = atol; heyoka in its faster mode.")
        series(page, folder)
        page.text("## Export and compilation\n\nContents rhs and energy with the self-test; times on the clock.")
        compilation(page, folder)
    page.write()


if __name__ == "__main__":
    main()
