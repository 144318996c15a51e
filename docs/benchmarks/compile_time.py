"""Statement to compiled model: chains of pendulums, against bars in seconds and against SymPy's own route.

python docs/benchmarks/compile_time.py
"""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from itertools import pairwise
from time import perf_counter, process_time
from typing import Any

from measure import Page, in_new_process, milliseconds, verdict

BARS = {2: 0.2, 5: 0.3, 10: 0.6, 20: 1.2, 30: 2.5}
RELATIVE = 2.0
"""Relative angles may take this many times the bar."""

PEERS = {5: 5.0, 12: 15.0}
"""Links, and how many times faster than SymPy lagrange has to be."""

PATIENCE = 300
"""Seconds that a comparison with SymPy may take."""

STAGES = ("state", "equations", "machine code", "check", "all", "passed")
ALL = STAGES.index("all")


def compiled(n: int, *, relative: bool) -> tuple[float, ...]:
    """Return processor seconds of each stage and of all, from nothing said to a checked model, and the seconds passed.

    SymPy starts with empty caches, and LLVM without object code.
    """
    from sympy.core.cache import clear_cache
    from systems import chain

    import lagrange as lg
    from lagrange.evidence.quick_check import quick_check
    from lagrange.machine.llvm.engine import COMPILED

    clear_cache()
    COMPILED.forget()
    gc.collect()
    began = perf_counter()
    marks = [process_time()]
    statement = chain(n, relative=relative)
    marks.append(process_time())
    system = lg.System(**statement)
    marks.append(process_time())
    model = system.compile(check=False)
    marks.append(process_time())
    quick_check(model)
    marks.append(process_time())
    stages = [after - before for before, after in pairwise(marks)]
    return (*stages, sum(stages), perf_counter() - began)


def fastest(n: int, *, relative: bool, times: int = 5) -> tuple[float, ...]:
    """Return the least of several compilations, stage by stage."""
    return tuple(map(min, zip(*(compiled(n, relative=relative) for _ in range(times)), strict=True)))


def by_sympy(n: int) -> float:
    """Return the seconds of SymPy's way: LagrangesMethod, then lambdify(cse=True) of mass matrix and forcing."""
    import sympy
    from sympy.core.cache import clear_cache
    from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

    clear_cache()
    gc.collect()
    start = process_time()
    q = dynamicsymbols(f"theta1:{n + 1}")
    masses, lengths, g = sympy.symbols(f"m1:{n + 1}"), sympy.symbols(f"l1:{n + 1}"), sympy.Symbol("g")
    x = y = lagrangian = 0
    for i in range(n):
        x, y = x + lengths[i] * sympy.sin(q[i]), y - lengths[i] * sympy.cos(q[i])
        speed2 = sympy.diff(x, dynamicsymbols._t) ** 2 + sympy.diff(y, dynamicsymbols._t) ** 2
        lagrangian += masses[i] * speed2 / 2 - masses[i] * g * y
    method = LagrangesMethod(lagrangian, q)
    method.form_lagranges_equations()
    arguments = [*q, *(sympy.diff(c, dynamicsymbols._t) for c in q), *masses, *lengths, g]
    sympy.lambdify(arguments, [method.mass_matrix, method.forcing], cse=True)
    return process_time() - start


def side_by_side(n: int) -> dict[str, float] | None:
    """Return the seconds of both, taken in one new process, or None where SymPy takes too long."""
    try:
        found: dict[str, float] = in_new_process(__file__, "--peer", str(n), seconds=PATIENCE)
    except subprocess.TimeoutExpired:
        return None
    return found


def peer(n: int) -> None:
    """Measure both ways in this process, in turn, and print the seconds as JSON."""
    fastest(2, relative=False, times=1)
    by_sympy(2)
    times: dict[str, list[float]] = {"lagrange": [], "sympy": []}
    for _ in range(3):
        times["lagrange"].append(compiled(n, relative=False)[ALL])
        times["sympy"].append(by_sympy(n))
    print(json.dumps({name: min(values) for name, values in times.items()}))


def first_costs() -> dict[str, float]:
    """Return, from the best of several new processes, what is paid once: imports, LLVM, the first compilation."""
    found = [in_new_process(__file__, "--first") for _ in range(5)]
    return {name: min(run[name] for run in found) for name in found[0]}


def first() -> None:
    """Print what the first compilation of a process costs, step by step, as JSON."""
    marks: dict[str, float] = {}

    def mark(name: str, start: float) -> float:
        now = process_time()
        marks[name] = now - start
        return now

    now = process_time()
    import sympy

    now = mark("import sympy", now)
    import lagrange.system

    now = mark("the rest of lagrange.System, numpy included", now)
    from lagrange.machine.llvm import engine, processor

    now = mark("import llvmlite", now)
    processor.start()
    now = mark("start LLVM", now)
    engine.linear_solver(often=True)
    now = mark("compile the linear solver", now)
    import lagrange.evidence.quick_check

    now = mark("the rest of the check's imports", now)
    cold = compiled(2, relative=False)[ALL]
    warm = fastest(2, relative=False, times=3)[ALL]
    marks["first compilation beyond a later one (n = 2)"] = cold - warm
    del sympy, lagrange
    print(json.dumps(marks))


def main() -> None:
    """Measure, print and write the page."""
    page = Page("Statement to compiled model", __file__)
    fastest(2, relative=False, times=2)
    for relative, title in ((False, "Angles from the vertical"), (True, "Relative angles")):
        page.text(f"## {title}")
        page.table(
            ("n", *(f"{stage}, ms" for stage in STAGES), "bar, ms", "within"),
            (_row(n, relative=relative) for n in BARS),
        )
    page.text("## Against SymPy's `LagrangesMethod` and `lambdify(cse=True)`, in the same process")
    page.table(("n", "lagrange, ms", "SymPy, ms", "times faster", "bar", "within"), map(_peer_row, PEERS))
    page.text("## Paid once per process")
    page.table(("what", "ms"), [(name, milliseconds(seconds)) for name, seconds in first_costs().items()])
    page.write()


def _row(n: int, *, relative: bool) -> tuple[Any, ...]:
    stages = fastest(n, relative=relative, times=5 if n <= 20 else 4)
    bar = BARS[n] * (RELATIVE if relative else 1.0)
    return (n, *map(milliseconds, stages), milliseconds(bar), verdict(stages[ALL], bar))


def _peer_row(n: int) -> tuple[Any, ...]:
    times = side_by_side(n)
    if times is None:
        return (n, "", f"more than {PATIENCE} s", "", PEERS[n], "yes")
    ratio = times["sympy"] / times["lagrange"]
    shown = (milliseconds(times["lagrange"]), milliseconds(times["sympy"]), f"{ratio:.1f}", f"{PEERS[n]:g}")
    return (n, *shown, verdict(PEERS[n], ratio))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--peer", n]:
            peer(int(n))
        case ["--first"]:
            first()
        case _:
            main()
