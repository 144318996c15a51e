"""Time of every method on nine systems for an error at the end of a run.

python docs/benchmarks/methods.py --cache /tmp/cache
"""

from __future__ import annotations

import math
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from measure import Page, milliseconds, saved
from systems import elastic_pendulum
from taylor import Cache, expected
from taylor_systems import CASES, Case

import lagrange as lg

GOALS = (1e-3, 1e-6, 1e-9, 1e-12)
TOLERANCES = tuple(10.0**-k for k in range(3, 15))
LIMIT = 0.15
"""Seconds of one run, beyond which finer ones of a method are left out."""
REPEATS = 3
FASTEST = 6
"""How many methods are named at each goal."""

STIFFNESS, OMEGA = 1e4, 50.0
FAMILIES = {
    "taylor": "#d1495b",
    "explicit, step control": "#0b6e99",
    "explicit, fixed steps": "#7fb7d1",
    "splitting": "#3c7d45",
    "implicit or variational": "#a35c00",
    "SciPy, SUNDIALS": "#8a8a8a",
}


def stiff_chain() -> lg.System:
    """Return six masses joined by stiff linear and soft quartic springs in turn, between two walls.

    Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, I.5.1.
    """
    q = lg.coordinates("q1 q2 q3 q4 q5 q6")
    omega = lg.parameters("omega")
    places = [0, *q, 0]
    stiff = sum((q[2 * i + 1] - q[2 * i]) ** 2 for i in range(3))
    soft = sum((places[2 * i + 1] - places[2 * i]) ** 4 for i in range(4))
    return lg.System(
        kinetic=sum(x.dot**2 for x in q) / 2,
        potential=omega**2 / 4 * stiff + soft,
        coordinates=q,
        parameters={omega: OMEGA},
        name="Fermi-Pasta-Ulam problem",
    )


def stiff_chain_start() -> tuple[float, ...]:
    """Return the book's initial state: one soft and one stiff mode."""
    root = math.sqrt(0.5)
    q = (root * (1 - 1 / OMEGA), root * (1 + 1 / OMEGA), 0.0, 0.0, 0.0, 0.0)
    return (*q, 0.0, 2 * root, 0.0, 0.0, 0.0, 0.0)


def pleiades_start() -> tuple[float, ...]:
    """Return the initial state of the library's scene."""
    stated = lg.scene("pleiades").statement
    return tuple(float(x) for x in stated.initial)


NAMES = ("pendulum", "double", "kepler", "henon-heiles", "solar")
OWN = (
    Case("pleiades", "seven stars in the plane", lambda: lg.scene("pleiades"), pleiades_start(), 3.0),
    Case(
        "elastic",
        f"elastic pendulum, k = {STIFFNESS:g}",
        partial(elastic_pendulum, STIFFNESS),
        (0.75, 0.5, 0.0, 0.0),
        4.0,
    ),
    Case("fpu", f"2m = 6, omega = {OMEGA:g}", stiff_chain, stiff_chain_start(), 20.0),
)


def cases() -> list[Case]:
    """Return the systems in the order of the page."""
    shared = {case.name: case for case in CASES}
    return [*(shared[name] for name in NAMES), *OWN, shared["chain10"]]


def family(name: str) -> str:
    """Return which family a method belongs to."""
    claims = {row.name: row.claims for row in lg.methods.table()}[name]
    if name == "taylor":
        return "taylor"
    if name == "cvode" or name.startswith("scipy-"):
        return "SciPy, SUNDIALS"
    if not claims.explicit:
        return "implicit or variational"
    if claims.adaptive:
        return "explicit, step control"
    return "splitting" if claims.symplectic else "explicit, fixed steps"


def measure(page: Page, case: Case, names: Sequence[str], cache: Cache) -> Any:
    """Race the methods on a system, and add its table."""
    system = case.system()
    ends, doubt = expected(case, system, cache)
    n = len(case.start) // 2
    begun = perf_counter()
    found = lg.race(
        system,
        case.t_end,
        case.initial(system.compile()),
        methods=names,
        tolerances=TOLERANCES,
        reference=np.asarray(ends[0], dtype=float),
        relative=True,
        repeats=REPEATS,
        max_wall=LIMIT,
    )
    page.text(f"## {case.name}: {case.about}, t = {case.t_end:.4g}")
    page.text(f"{n} coordinates; the two runs of the reference differ by {doubt:.0e}; {perf_counter() - begun:.0f} s.")
    page.table(("error", "the fastest, ms"), [(f"{goal:.0e}", "; ".join(podium(found, goal))) for goal in GOALS])
    refused = [e for e in found if e.status == "refused"]
    if refused:
        page.text("Refused: " + ", ".join(dict.fromkeys(e.method for e in refused)) + ".")
    return found


def podium(found: Any, goal: float) -> list[str]:
    """Return the methods that reach an error, fastest first, with their milliseconds."""
    times = {name: needed([e for e in found if e.method == name and e.complete], goal) for name in found.methods}
    reached = sorted((seconds, name) for name, seconds in times.items() if math.isfinite(seconds))
    return [f"{name} {milliseconds(seconds)}" for seconds, name in reached[:FASTEST]]


def needed(entries: Sequence[Any], goal: float) -> float:
    """Return the seconds of the fastest run with at most that error."""
    return min((e.time for e in entries if e.error <= goal), default=math.inf)


def draw(found: dict[str, Any]) -> None:
    """Draw error against time, a panel for each system, a colour for each family."""
    figure = Figure(figsize=(13, 12), layout="constrained")
    axes = figure.subplots(3, 3).ravel()
    families = {name: family(name) for race in found.values() for name in race.methods}
    for axis, (title, race) in zip(axes, found.items(), strict=False):
        for name in race.methods:
            points = [(e.time, e.error) for e in race if e.method == name and e.complete and e.error < 10]
            if points:
                colour = FAMILIES[families[name]]
                width = 2.2 if name == "taylor" else 0.9
                axis.plot(*zip(*points, strict=True), "-o", color=colour, markersize=2.5, linewidth=width, zorder=width)
        axis.set(xscale="log", yscale="log", title=title, xlabel="time of a run, s", ylabel="relative error at the end")
        axis.grid(color="#e3e3e3", linewidth=0.6)
    handles = [axes[0].plot([], [], "-o", color=c, markersize=3)[0] for c in FAMILIES.values()]
    figure.legend(handles, list(FAMILIES), loc="outside lower center", ncols=len(FAMILIES), frameon=False)
    saved(figure, "methods.png", 110)


def summary(page: Page, found: dict[str, Any]) -> None:
    """Add each method's time as a multiple of the fastest one's, for one error."""
    names = list(dict.fromkeys(name for race in found.values() for name in race.methods))
    for goal in (1e-3, 1e-6, 1e-9):
        lines = []
        best = {title: min(needed([e for e in race if e.complete], goal), math.inf) for title, race in found.items()}
        for name in names:
            cells = []
            for title, race in found.items():
                seconds = needed([e for e in race if e.method == name and e.complete], goal)
                cells.append(f"{seconds / best[title]:.3g}" if math.isfinite(seconds) else "")
            lines.append((name, *cells))
        page.text(f"## Time as a multiple of the fastest at a relative error of {goal:.0e}")
        page.table(("method", *found), lines)
    page.text("An empty cell: refused, not reached at any setting, or not within the time that a run is given.")


def request() -> Namespace:
    """Return what the command line asks for."""
    parser = ArgumentParser(description="Race every method on nine systems, and write the page and its picture.")
    parser.add_argument("--cache", type=Path, help="folder for heyoka's references")
    parser.add_argument("--only", nargs="+", default=[], help="systems to race on, without writing the page")
    parser.add_argument("--methods", nargs="+", default=[], help="methods to race, without writing the page")
    return parser.parse_args()


def main() -> None:
    """Measure, print, and write the page."""
    options = request()
    page = Page("Every method on nine systems", __file__)
    names = options.methods or lg.methods.names()
    with tempfile.TemporaryDirectory() as folder:
        cache = Cache(options.cache or Path(folder))
        chosen = [case for case in cases() if not options.only or case.name in options.only]
        found = {case.name: measure(page, case, names, cache) for case in chosen}
    summary(page, found)
    if not (options.only or options.methods):
        draw(found)
        page.text("![Error against time for every method](methods.png)")
        page.write()


if __name__ == "__main__":
    main()
