"""Many runs of one system: members side by side, against heyoka's batch mode and against runs one by one.

python docs/benchmarks/ensembles.py --only pendulum double --members 2000
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from time import process_time
from typing import Any

import heyoka as hy
import numpy as np
from measure import Page, microseconds, shown
from numpy.typing import NDArray
from taylor_systems import CASES, MODES, Case, equations, reference

import lagrange as lg

SPANS = {
    "pendulum": 20.0,
    "henon-heiles": 50.0,
    "kepler": 20 * np.pi,
    "double": 5.0,
    "chain5": 2.0,
    "chain10": 1.0,
    "solar": 50_000.0,
}
"""The time at the end of each member."""

BARS = {
    "pendulum": 2.5,
    "henon-heiles": 2.5,
    "kepler": 2.5,
    "double": 3.0,
    "chain5": 10.0,
    "chain10": 20.0,
    "solar": 2.0,
}
"""How many times as long a member should take in heyoka's batch mode."""

TOLERANCES, BATCHES = (1e-9, 1e-15), (4, 8, 16)
SPREAD, SAMPLED = 0.05, 4
"""Members start from states scaled by random numbers this near to 1; so many have a reference of 80 bits."""

SMALL = ("pendulum", "henon-heiles", "kepler", "double")
"""Systems of which all members run; of larger ones a twentieth."""

METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"rtol": 1e-9},
    "dop853": {"rtol": 1e-9},
    "rk4": {"step": 0.01},
    "verlet": {"step": 0.01},
}
SINGLE_BAR = 3.0

Array = NDArray[np.float64]


def starts(case: Case, members: int) -> Array:
    """Return the initial states of members, (members, 2n)."""
    draw = np.random.default_rng(7)
    return np.array(case.start) * (1.0 + SPREAD * draw.uniform(-1.0, 1.0, (members, 1)))


def ours(case: Case, system: lg.System, y0: Array, **options: Any) -> Callable[[], lg.Ensemble]:
    """Return an ensemble on one thread."""
    names = system.compile().layout.names()
    initial = dict(zip(names, y0.T, strict=True))
    return partial(lg.ensemble, system, SPANS[case.name], initial, workers=1, **options)


def in_batches(
    case: Case, system: lg.System, y0: Array, tolerance: float, mode: str, batch: int
) -> Callable[[], Array]:
    """Return the same members in heyoka's batch mode."""
    right, n = equations(case, system, float), y0.shape[1]
    made = hy.taylor_adaptive_batch(right, np.ascontiguousarray(y0[:batch].T), tol=tolerance, compact_mode=MODES[mode])
    whole = len(y0) // batch * batch
    groups = [np.ascontiguousarray(y0[k : k + batch].T) for k in range(0, whole, batch)]
    end, ends = SPANS[case.name], np.empty((whole, n))

    def run() -> Array:
        for k, group in enumerate(groups):
            made.set_time(0.0)
            made.state[:] = group
            made.propagate_until(end)
            ends[k * batch : (k + 1) * batch] = made.state.T
        return ends

    return run


def best(runs: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, float]:
    """Return the processor seconds of one call of each, on all threads of this process, the least of some rounds."""
    times = dict.fromkeys(runs, float("inf"))
    for _ in range(rounds):
        for name, run in runs.items():
            began = process_time()
            run()
            times[name] = min(times[name], process_time() - began)
    return times


def error(case: Case, system: lg.System, y0: Array, ends: Array) -> float:
    """Return the largest error of the first members, relative to the size of their states."""
    found = []
    for k in range(SAMPLED):
        one = replace(case, t_end=SPANS[case.name], start=tuple(y0[k]))
        exact = reference(one, system)[0][0].astype(float)
        found.append(np.abs(ends[k] - exact).max() / np.abs(exact).max())
    return float(max(found))


def against_heyoka(page: Page, options: Namespace) -> None:
    """Measure members against heyoka's batch mode."""
    rows = []
    for case in (one for one in CASES if one.name in options.only and one.name in SPANS):
        system = case.system()
        y0 = starts(case, options.members if case.name in SMALL else max(64, options.members // 20))
        for tolerance in TOLERANCES:
            here = ours(case, system, y0, rtol=tolerance, atol=tolerance)
            theirs = {
                (mode, batch): in_batches(case, system, y0, tolerance, mode, batch)
                for mode in MODES
                if mode == "compact" or case.unrolled <= tolerance
                for batch in BATCHES
            }
            runs = here()
            times = best(
                {"ours": here, **{" ".join(map(str, key)): run for key, run in theirs.items()}}, options.rounds
            )
            each = {(mode, batch): times[f"{mode} {batch}"] / (len(y0) // batch * batch) for mode, batch in theirs}
            fastest = min(each, key=each.__getitem__)
            mine, other, bar = times["ours"] / len(y0), each[fastest], BARS[case.name]
            errors = [error(case, system, y0, ends) for ends in (runs.y.T, theirs[fastest]())]
            numbers = (microseconds(mine), f"{errors[0]:.1e}", microseconds(other), f"{errors[1]:.1e}")
            way, met = f"{fastest[0]}, {fastest[1]}", "yes" if other >= bar * mine else "**no**"
            rows.append((case.name, f"{tolerance:g}", runs.form, *numbers, way, shown(other / mine), f"{bar:g}", met))
    page.text("## Against heyoka's batch mode")
    head = (
        "system",
        "tolerance",
        "how",
        "us a member",
        "error",
        "heyoka, us",
        "error",
        "its way, batch",
        "ratio",
        "bar",
        "met",
    )
    page.table(head, rows)


def against_single_runs(page: Page, options: Namespace) -> None:
    """Measure lanes against flows of one member after the other."""
    rows = []
    for case in (one for one in CASES if one.name in options.only and one.name in SMALL):
        system, y0, end = case.system(), starts(case, options.members)[:2000], SPANS[case.name]
        for method, settings in METHODS.items():
            if method == "verlet" and case.name == "double":
                continue
            here = ours(case, system, y0, method=method, **settings)
            assert "side by side" in here().form
            single = partial(one_by_one, lg.flow(system.compile(), method=method, **settings), y0, end)
            times = best({"lanes": here, "single": single}, options.rounds)
            lanes, alone = times["lanes"] / len(y0), times["single"] / len(y0)
            met = "yes" if alone >= SINGLE_BAR * lanes else "**no**"
            rows.append((case.name, method, microseconds(lanes), microseconds(alone), shown(alone / lanes), met))
    page.text("## Against our own runs, one after the other")
    head = ("system", "method", "us a member in lanes", "us alone, lg.flow", "ratio", f"at least {SINGLE_BAR:g}")
    page.table(head, rows)


def one_by_one(flow: Any, y0: Array, end: float) -> None:
    """Run members one after the other."""
    for start in y0:
        flow(start, 0.0, end)


def main() -> None:
    """Measure, and write the page."""
    parser = ArgumentParser(description="Many runs of one system.")
    parser.add_argument("--only", nargs="+", default=list(SPANS), help="names of systems")
    parser.add_argument("--members", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    hy.set_nthreads(1)
    page = Page(
        "Ensembles",
        __file__,
        f"Members that start within {SPREAD:.0%} of one state, on one thread: `lg.ensemble(..., workers=1)`, with all "
        "that it does around the runs, against heyoka's `taylor_adaptive_batch` at the same tolerance, the fastest of "
        "its modes and of batches of 4, 8 and 16, around which nothing is done. Errors are the largest of four "
        "members, against runs in 80-bit arithmetic.",
    )
    against_heyoka(page, options)
    against_single_runs(page, options)
    if set(options.only) == set(SPANS):
        page.write()


if __name__ == "__main__":
    main()
