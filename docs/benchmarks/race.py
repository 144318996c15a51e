"""Time for an error at the end of a run: SciPy's solvers on a lambdified right-hand side, heyoka and lagrange.

python docs/benchmarks/race.py --cache /tmp/cache
"""

from __future__ import annotations

import math
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np
from equations import lambdified
from measure import Page, microseconds, shown
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from taylor import TRUSTED, Cache, Measured, Point, envelope, error, expected, time_for, winners
from taylor_systems import CASES, MODES, Case, rival

NAMES = ("pendulum", "kepler", "double")
TOLERANCES = (1e-4, 1e-7, 1e-10, 1e-13)
GOALS = (1e-6, 1e-10)
OURS = ("taylor", "dop853")
SCIPY = ("DOP853", "Radau", "LSODA")
BASE, HEYOKA = "lagrange taylor", "heyoka taylor_adaptive"
LABELS = (BASE, "lagrange dop853", HEYOKA, *(f"SciPy {name}" for name in SCIPY))
LIMIT = 2.0
"""Seconds of one run, beyond which a solver of SciPy is not waited for."""


class TooSlowError(Exception):
    """A run took longer than the limit."""


class Race(Measured):
    """Runs of one case by all that take part."""

    def __init__(self, case: Case, ends: NDArray[Any]) -> None:
        super().__init__(case, ends)
        self.lost: dict[tuple[str, float], str] = {}

    def scipy(self, rhs: Callable[[float, Any], list[float]], method: str, tolerance: float) -> None:
        """Add a solver of SciPy, unless it fails or takes too long."""
        label = f"SciPy {method}"
        solve = partial(solve_ivp, method=method, rtol=tolerance, atol=tolerance)
        span = (0.0, self.case.t_end)
        try:
            solve(until(rhs, LIMIT), span, self.y0[0])
        except TooSlowError:
            self.lost[label, tolerance] = f"over {LIMIT:g} s"
            return
        found = [solve(rhs, span, start) for start in self.y0]
        if not all(solution.success for solution in found):
            self.lost[label, tolerance] = "fails"
            return
        off = error([solution.y[:, -1] for solution in found], self.expected)
        name = f"{label} {tolerance:g}"
        self._add(name, label, tolerance, off, float(np.mean([len(solution.t) - 1 for solution in found])))
        self.calls[name] = partial(self._solve, solve, rhs)

    def _solve(self, solve: Callable[..., Any], rhs: Callable[[float, Any], list[float]]) -> None:
        for start in self.y0:
            solve(rhs, (0.0, self.case.t_end), start)


def until(rhs: Callable[[float, Any], list[float]], seconds: float) -> Callable[[float, Any], list[float]]:
    """Return a right-hand side that raises after so many seconds."""
    end = thread_time() + seconds

    def call(t: float, y: Any) -> list[float]:
        if thread_time() > end:
            raise TooSlowError
        return rhs(t, y)

    return call


def measure(page: Page, case: Case, rounds: int, cache: Cache) -> list[Point]:
    """Measure a system, and add its table."""
    system = case.system()
    model = system.compile()
    ends, doubt = expected(case, system, cache)
    race = Race(case, ends)
    for method in OURS:
        race.ours(model, method, f"lagrange {method}", TOLERANCES)
    for tolerance in TOLERANCES:
        for mode in MODES:
            race.theirs(rival(case, system, mode, tolerance))
    rhs = lambdified(system, "math")
    for method in SCIPY:
        for tolerance in TOLERANCES:
            race.scipy(rhs, method, tolerance)
    points = race.times(rounds)
    best = [Point(HEYOKA, p.tolerance, p.seconds, p.error, p.steps) for p in winners(points)]
    points = [*(p for p in points if p.label not in MODES), *best]
    page.text(f"## {case.name}: {case.about}, t = {case.t_end:.4g}")
    page.table(("method", *(f"{t:.0e}: us, error, steps" for t in TOLERANCES)), rows(points, race.lost))
    if doubt > TRUSTED * min(p.error for p in points):
        page.text("**The reference is not good enough for the least errors.**")
    return points


def rows(points: Sequence[Point], lost: Mapping[tuple[str, float], str]) -> list[list[str]]:
    """Return a line per method: time and error at each tolerance."""
    at = {(p.label, p.tolerance): p for p in points}
    return [[label, *(cell(at.get((label, t)), lost.get((label, t), "none")) for t in TOLERANCES)] for label in LABELS]


def cell(point: Point | None, otherwise: str) -> str:
    """Return time, error and steps."""
    return f"{microseconds(point.seconds)}, {point.error:.0e}, {point.steps:.0f}" if point else otherwise


def multiple(points: Sequence[Point], label: str, goal: float) -> str:
    """Return the time of a method for an error as a multiple of the base's, a bound where it is not reached."""
    own = [p for p in points if p.label == label]
    theirs, rough = time_for(own, goal)
    ours, bound = time_for([p for p in points if p.label == BASE], goal)
    if math.isnan(ours):
        return "none"
    if math.isnan(theirs):
        return f"> {shown(envelope(own)[-1].seconds / ours)}"
    sign = {(True, False): "<= ", (False, True): ">= ", (True, True): "~ "}.get((bool(rough), bool(bound)), "")
    return sign + shown(theirs / ours)


def summary(page: Page, found: Mapping[str, Sequence[Point]]) -> None:
    """Add the table of multiples."""
    page.text(f"## Time as a multiple of {BASE}'s, at the same error")
    head = [f"{name}, {goal:.0e}" for name in found for goal in GOALS]
    wanted = [(points, goal) for points in found.values() for goal in GOALS]
    lines = [[label, *(multiple(points, label, goal) for points, goal in wanted)] for label in LABELS]
    page.table(("method", *head), lines)
    page.text(
        "Times are interpolated on each method's line of error against time, both in logarithms, through those points "
        "that none of its others beats in both. A `>` stands where a method's least error is larger: the multiple is "
        "that of the time for its least error."
    )
    if any(cell.startswith(("<=", ">=", "~")) for line in lines for cell in line[1:]):
        page.text("`<=`, `>=` and `~` stand where the roughest run of the method, of the base or of both is better.")


def request() -> Namespace:
    """Return what the command line asks for."""
    parser = ArgumentParser(description="Time lagrange, heyoka and SciPy at the same error, and write the page.")
    parser.add_argument("--rounds", type=int, default=10, help="turns of every run in the timing")
    parser.add_argument("--cache", type=Path, help="folder for heyoka's code and the references")
    return parser.parse_args()


def main() -> None:
    """Measure, print, and write the page."""
    options = request()
    page = Page("SciPy, heyoka and lagrange", __file__)
    with tempfile.TemporaryDirectory() as folder:
        cache = Cache(options.cache or Path(folder))
        found = {case.name: measure(page, case, options.rounds, cache) for case in CASES if case.name in NAMES}
    summary(page, found)
    page.write()


if __name__ == "__main__":
    main()
