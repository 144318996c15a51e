"""Trajectories by Taylor series against heyoka: time for time at the same error, from the same T and V.

python docs/benchmarks/taylor.py --only pendulum chain5 --cache /tmp/cache
"""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import heyoka as hy
import numpy as np
from measure import Page, best, microseconds, shown
from numpy.typing import NDArray
from taylor_systems import CASES, MODES, Case, Rival, chain_system, reference, relative, rival

import lagrange as lg

METHOD = "taylor"
TOLERANCES = (1e-6, 1e-8, 1e-11, 1e-14, 1e-16)
COMPARED = (1e-6, 1e-11, 1e-16)
SWEEP = tuple(10.0**-k for k in range(2, 17))
PATIENCE = 1.0
"""Seconds of all rounds of a run, beyond which it has no more."""
TRUSTED = 0.05
"""The largest doubt about the reference, as a share of the least error that is measured with it."""
RELATIVE = (10, 30)
ABOVE_ROUND_OFF = SWEEP[:-4]
"""Tolerances for chains in relative angles, whose mass matrix is ill-conditioned."""


@dataclass(frozen=True)
class Point:
    """One method at one tolerance: seconds for a run, error at its end, steps."""

    label: str
    tolerance: float
    seconds: float
    error: float
    steps: float


@dataclass(frozen=True)
class Row:
    """What the summary says of a system: heyoka's best at each tolerance, and all of our points."""

    case: Case
    theirs: Sequence[Point]
    ours: Sequence[Point]


class Cache:
    """What is worth keeping between runs: heyoka's code and how long it took, its faster modes, reference states."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        hy.llvm_state.set_diskcache_path(str(folder))
        self.folder = folder
        self._file = folder / "notes.json"
        self._notes: dict[str, Any] = json.loads(self._file.read_text("utf-8")) if self._file.exists() else {}

    def key(self, case: Case, system: lg.System) -> str:
        """Return a name for a case that changes with its statement and its run."""
        parts = (system.statement.lagrangian, system.parameters, case.starts().tobytes(), case.t_end, case.products)
        digest = hashlib.sha256(repr((hy.__version__, *parts)).encode()).hexdigest()
        return f"{case.name}-{digest[:10]}"

    def noted(self, name: str) -> Any:
        """Return what was noted under a name, None if nothing was."""
        return self._notes.get(name)

    def note(self, name: str, value: Any) -> None:
        """Keep a string or number."""
        self._notes[name] = value
        self._file.write_text(json.dumps(self._notes, indent=1), encoding="utf-8")

    def rival(self, name: str, build: Callable[[], Rival]) -> Rival:
        """Return an integrator with the seconds that it took when its code was first compiled."""
        made = build()
        if (seconds := self.noted(name)) is None:
            self.note(name, made.seconds)
            return made
        return replace(made, seconds=seconds)

    def states(self, name: str, compute: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Return an array, from the disk if it was ever computed."""
        path = self.folder / f"{name}.npy"
        if not path.exists():
            np.save(path, compute())
        states: NDArray[Any] = np.load(path)
        return states


def error(found: Sequence[NDArray[Any]], expected: NDArray[Any]) -> float:
    """Return the largest error of a final state: the geometric mean over the starts."""
    largest = np.abs(np.array(found) - expected).max(axis=1).astype(float)
    return float(np.exp(np.log(np.maximum(largest, 1e-20)).mean()))


class Measured:
    """Runs of one case, which take turns when they are timed."""

    def __init__(self, case: Case, expected: NDArray[Any]) -> None:
        self.case, self.expected, self.y0 = case, expected, case.starts()
        self.points: dict[str, tuple[str, float, float, float]] = {}
        self.calls: dict[str, Callable[[], None]] = {}

    def ours(self, model: lg.Model, method: str, label: str = "ours", sweep: Sequence[float] = SWEEP) -> None:
        """Add our method at all tolerances at which it gets to the end."""
        for tolerance in sweep:
            flow = lg.flow(model, method=method, rtol=tolerance, atol=tolerance)
            try:
                ends = [flow(start, 0.0, self.case.t_end) for start in self.y0]
                steps = self._steps(model, method, tolerance)
            except lg.RunError:
                continue
            self._add(f"{label} {tolerance:g}", label, tolerance, error(ends, self.expected), steps)
            self.calls[f"{label} {tolerance:g}"] = partial(self._flow, flow)

    def theirs(self, rival: Rival) -> bool:
        """Add an integrator of heyoka, unless it gives no numbers."""
        steps, ends = [], []
        for start in self.y0:
            steps.append(rival.run(start, self.case.t_end))
            ends.append(rival.integrator.state.copy())
        if not np.isfinite(ends).all():
            return False
        name = f"{rival.mode} {rival.tolerance:g}"
        self._add(name, rival.mode, rival.tolerance, error(ends, self.expected), float(np.mean(steps)))
        self.calls[name] = partial(self._propagate, rival)
        return True

    def times(self, rounds: int) -> list[Point]:
        """Return all points, timed side by side."""
        found = best(self.calls, rounds=rounds, patience=PATIENCE)
        return [
            Point(label, tolerance, found[name] / len(self.y0), off, steps)
            for name, (label, tolerance, off, steps) in self.points.items()
        ]

    def _add(self, name: str, label: str, tolerance: float, off: float, steps: float) -> None:
        self.points[name] = (label, tolerance, off, steps)

    def _steps(self, model: lg.Model, method: str, tolerance: float) -> float:
        span = (0.0, self.case.t_end)
        start = dict(zip(model.layout.names(), self.y0[0], strict=True))
        return float(lg.integrate(model, span, start, method=method, rtol=tolerance, atol=tolerance).steps)

    def _flow(self, flow: Any) -> None:
        for start in self.y0:
            flow(start, 0.0, self.case.t_end)

    def _propagate(self, rival: Rival) -> None:
        for start in self.y0:
            rival.run(start, self.case.t_end)


def winners(points: Sequence[Point]) -> list[Point]:
    """Return heyoka's faster mode at each tolerance."""
    theirs = [point for point in points if point.label in MODES]
    tolerances = sorted({point.tolerance for point in theirs}, reverse=True)
    return [min((p for p in theirs if p.tolerance == each), key=lambda p: p.seconds) for each in tolerances]


def envelope(points: Sequence[Point]) -> list[Point]:
    """Return the points that no other beats in both time and error, from rough to fine."""
    kept: list[Point] = []
    for point in sorted(points, key=lambda p: p.seconds):
        if not kept or point.error < kept[-1].error:
            kept.append(point)
    return kept


def time_for(points: Sequence[Point], goal: float) -> tuple[float, str]:
    """Return the seconds for an error by interpolation, and `at most` if it is rougher than all points.

    The seconds are NaN where no point reaches the error.
    """
    curve = envelope(points)
    if not curve or goal < curve[-1].error:
        return float("nan"), ""
    if goal >= curve[0].error:
        return curve[0].seconds, "at most "
    errors = np.log([p.error for p in reversed(curve)])
    seconds = np.log([p.seconds for p in reversed(curve)])
    return float(np.exp(np.interp(np.log(goal), errors, seconds))), ""


def ratio(theirs: Point, ours: Sequence[Point]) -> str:
    """Return heyoka's time as a multiple of ours at heyoka's error."""
    seconds, bound = time_for(ours, theirs.error)
    if math.isnan(seconds):
        return "not reached"
    return f"{'>= ' if bound else ''}{theirs.seconds / seconds:.2f}"


def least(points: Sequence[Point]) -> str:
    """Return the least error of a sequence of points."""
    return f"{min((p.error for p in points), default=float('nan')):.1e}"


def rivals(case: Case, system: lg.System, options: Namespace, cache: Cache) -> list[Rival]:
    """Return heyoka's integrators for all tolerances: both modes, the one asked for, or the one that won before."""
    key, found = cache.key(case, system), []
    for tolerance in options.tolerances:
        known = cache.noted(f"{key}-{tolerance:g}")
        asked = options.heyoka_mode or known or "both"
        for mode in MODES:
            if asked in (mode, "both") and (mode == "compact" or tolerance >= case.unrolled):
                name = f"{key}-{mode}-{tolerance:g}"
                found.append(cache.rival(name, partial(rival, case, system, mode, tolerance)))
    return found


def expected(case: Case, system: lg.System, cache: Cache) -> tuple[NDArray[Any], float]:
    """Return the final states of the reference, and by how much its two runs differ."""
    sure = replace(case, products=True)
    states = cache.states(cache.key(sure, system) + "-reference", partial(reference, sure, system))
    return states[0], float(np.abs(states[0] - states[1]).max())


def measure(page: Page, case: Case, options: Namespace, cache: Cache) -> Row:
    """Measure a system, and print what there is to see in it."""
    begun = perf_counter()
    system = case.system()
    model = system.compile()
    stated = perf_counter() - begun
    ends, doubt = expected(case, system, cache)
    runs = Measured(case, ends)
    begun = perf_counter()
    runs.ours(model, options.method)
    swept = perf_counter() - begun
    built = rivals(case, system, options, cache)
    failed = [r for r in built if not runs.theirs(r)]
    points = runs.times(options.rounds)
    theirs, ours = winners(points), [p for p in points if p.label == "ours"]
    key = cache.key(case, system)
    if options.heyoka_mode in (None, "both"):
        for point in theirs:
            cache.note(f"{key}-{point.tolerance:g}", point.label)
    page.text(f"## {case.name}: {case.about}, t = {case.t_end:g}")
    page.text(
        f"{len(system.coordinates)} coordinates. From the statement to our model {stated:.2f} s, to flows at "
        f"{len(ours)} tolerances, each run, {swept:.2f} s more. The two runs of the reference differ by {doubt:.0e}."
    )
    if doubt > TRUSTED * min(p.error for p in points):
        page.text("**The reference is not good enough for the least errors.**")
    if failed:
        page.text(f"heyoka gives NaN: {', '.join(f'{r.mode} at {r.tolerance:g}' for r in failed)}.")
    detail(page, points, built, ours)
    return Row(case, theirs, ours)


def detail(page: Page, points: Sequence[Point], built: Sequence[Rival], ours: Sequence[Point]) -> None:
    """Add a system's tables: every integrator of heyoka, every tolerance of ours."""
    compiled = {(r.mode, r.tolerance): r for r in built}
    rows = []
    for point in (p for p in points if p.label in MODES):
        made = compiled[point.label, point.tolerance]
        seconds, bound = time_for(ours, point.error)
        mine = "" if math.isnan(seconds) else bound + microseconds(seconds)
        rows.append(
            (
                f"{point.tolerance:g}",
                point.label,
                made.integrator.order,
                f"{point.steps:.0f}",
                f"{point.error:.1e}",
                microseconds(point.seconds),
                mine,
                ratio(point, ours),
                f"{made.seconds:.2f}",
            )
        )
    if rows:
        head = ("tolerance", "mode", "order", "steps", "error", "heyoka, us", "ours, us", "ratio", "T and V to it, s")
        page.table(head, rows)
    if ours:
        table = [(f"{p.tolerance:g}", f"{p.steps:.0f}", f"{p.error:.1e}", microseconds(p.seconds)) for p in ours]
        page.table(("our rtol = atol", "steps", "error", "us"), table)


def summary(page: Page, rows: Sequence[Row], tolerances: Sequence[float]) -> None:
    """Add the table of ratios, and of the least errors."""
    shown_at = [t for t in tolerances if t in COMPARED] or list(tolerances)
    lines = []
    for row in rows:
        at = {p.tolerance: p for p in row.theirs}
        cells = [ratio(at[t], row.ours) if t in at else "none" for t in shown_at]
        times = [f"{microseconds(at[t].seconds)} {at[t].label}" if t in at else "none" for t in shown_at]
        lines.append((row.case.name, *times, *cells, least(row.theirs), least(row.ours)))
    page.text("## heyoka's time as a multiple of ours, at heyoka's error")
    head = [f"heyoka at {t:g}, us" for t in shown_at] + [f"ratio at {t:g}" for t in shown_at]
    page.table(("system", *head, "heyoka's least error", "ours"), lines)


def turned(page: Page, n: int, options: Namespace, cache: Cache) -> None:
    """Measure what relative angles cost beside absolute ones, the same motion."""
    case = next(each for each in CASES if each.name == f"chain{n}")
    systems = {"absolute": chain_system(n), "relative": chain_system(n, turned=True)}
    ends, _ = expected(case, systems["absolute"], cache)
    runs = {"absolute": Measured(case, ends), "relative": Measured(case, np.array([relative(y) for y in ends]))}
    runs["relative"].y0 = np.array([relative(y) for y in case.starts()])
    both = Measured(case, ends)
    for name, one in runs.items():
        one.ours(systems[name].compile(), options.method, name, ABOVE_ROUND_OFF)
        both.points |= one.points
        both.calls |= one.calls
    points = both.times(options.rounds)
    absolute = {p.tolerance: p for p in points if p.label == "absolute"}
    rows = []
    for p in points:
        other = absolute.get(p.tolerance)
        if p.label == "relative" and other:
            cells = (f"{other.error:.1e}", f"{p.error:.1e}", f"{other.steps:.0f}", f"{p.steps:.0f}")
            times = (microseconds(other.seconds), microseconds(p.seconds), shown(p.seconds / other.seconds))
            rows.append((f"{p.tolerance:g}", *cells, *times))
    page.text(f"## {n} links, angles absolute and relative")
    head = ("rtol = atol", "error, abs.", "rel.", "steps, abs.", "rel.", "us, abs.", "rel.", "relative / absolute")
    page.table(head, rows)


def request() -> Namespace:
    """Return what the command line asks for."""
    names = [*(case.name for case in CASES), *(f"relative{n}" for n in RELATIVE)]
    parser = ArgumentParser(description="Time trajectories against heyoka. Without --only the page is written.")
    parser.add_argument("--only", nargs="+", choices=names, metavar="SYSTEM", help=", ".join(names))
    parser.add_argument("--tolerances", nargs="+", type=float, default=TOLERANCES, help="heyoka's")
    parser.add_argument("--method", default=METHOD, help="ours")
    parser.add_argument("--rounds", type=int, default=10, help="turns of every rival in the timing")
    parser.add_argument("--cache", type=Path, help="folder for heyoka's code and the references")
    parser.add_argument("--heyoka-mode", choices=(*MODES, "both"), help="else: the cache's winner, or both")
    options = parser.parse_args()
    options.names = options.only or names
    return options


def run(page: Page, options: Namespace, cache: Cache) -> None:
    """Measure what was asked for."""
    rows = [measure(page, case, options, cache) for case in CASES if case.name in options.names]
    for n in RELATIVE:
        if f"relative{n}" in options.names:
            turned(page, n, options, cache)
    if rows:
        summary(page, rows, options.tolerances)


def main() -> None:
    """Measure, print, and write the page unless only a part was asked for."""
    options = request()
    page = Page("Trajectories against heyoka", __file__)
    with tempfile.TemporaryDirectory() as folder:
        run(page, options, Cache(options.cache or Path(folder)))
    if options.only is None:
        page.write()


if __name__ == "__main__":
    main()
