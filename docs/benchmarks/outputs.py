"""Cost of states between the steps: output times of a run, and states at any times after it.

python docs/benchmarks/outputs.py --only pendulum henon-heiles
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from measure import Page, best, milliseconds, shown, verdict
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from taylor_systems import CASES, MODES, Case, rival

import lagrange as lg

SPANS = {
    "pendulum": (200.0, 1.0),
    "henon-heiles": (2000.0, 1.0),
    "kepler": (400 * np.pi, 1.0),
    "double": (100.0, 1.0),
    "solar": (500_000.0, 1000.0),
    "chain5": (50.0, 1.0),
    "chain10": (20.0, 1.0),
}
"""The time at the end of each run, and its unit of time: 1000 days for planets."""

TOLERANCE, DENSITIES, RANDOM = 1e-9, (10, 100), 100_000
OURS = ("taylor", "dop853")
OTHERS, FIXED_STEPS, STEPS = ("tsit5", "verner9", "radau5", "rk4", "gauss3"), ("rk4", "gauss3"), 20_000
GRID_BAR, LARGER_BAR, SCIPY_BAR = 1.0, 0.7, 100.0
AT_BARS = {2: 0.2, 10: 1.0}
"""Microseconds that a state at a random time may take, by the number of coordinates."""

Array = NDArray[np.float64]


def grid_of(case: Case, density: int) -> Array:
    """Return the output times of a run, so many for each unit of time."""
    end, unit = SPANS[case.name]
    return np.linspace(0.0, end, round(density * end / unit) + 1)


def propagated(case: Case, system: lg.System) -> Callable[[Array | None], None]:
    """Return heyoka's faster way through output times, or to the end without any."""
    end, _ = SPANS[case.name]
    made = [rival(case, system, mode, TOLERANCE) for mode in MODES if mode == "compact" or case.unrolled <= TOLERANCE]
    start = case.starts()[0]

    def run(one: Any, grid: Array | None) -> None:
        one.integrator.time = 0.0
        one.integrator.state[:] = start
        if grid is None:
            one.integrator.propagate_until(end)
        else:
            one.integrator.propagate_grid(grid)

    times = best({str(i): partial(run, one, None) for i, one in enumerate(made)}, rounds=5)
    fastest = made[min(range(len(made)), key=lambda i: times[str(i)])]
    return partial(run, fastest)


def runs_of(case: Case, system: lg.System, model: lg.Model) -> tuple[dict[str, Callable[[], Any]], float]:
    """Return the runs of a case with and without output times, and how far ours differ from heyoka's at most."""
    end, _ = SPANS[case.name]
    start = case.starts()[0]
    initial = case.initial(model)
    theirs = propagated(case, system)
    calls: dict[str, Callable[[], Any]] = {"heyoka": partial(theirs, None)}
    for method in OURS:
        ours = partial(lg.integrate, model, (0.0, end), initial, method=method, rtol=TOLERANCE)
        calls[method] = ours
        for density in DENSITIES:
            calls[f"{method} {density}"] = partial(ours, t_eval=grid_of(case, density))
    for density in DENSITIES:
        calls[f"heyoka {density}"] = partial(theirs, grid_of(case, density))
    few = grid_of(case, DENSITIES[0])
    scipy: Mapping[str, Any] = {"method": "DOP853", "rtol": TOLERANCE, "atol": TOLERANCE, "t_eval": few}
    calls[f"SciPy {DENSITIES[0]}"] = partial(solve_ivp, model.rhs, (0.0, end), start, **scipy)
    found = [calls[f"{method} {DENSITIES[0]}"]().y for method in OURS]
    return calls, float(np.abs(found[0] - found[1]).max())


def outputs(page: Page, options: Namespace) -> None:
    """Add the table of runs with output times."""
    rows, ratios = [], []
    for case in (each for each in CASES if each.name in SPANS and each.name in options.only):
        system = case.system()
        model = system.compile()
        calls, apart = runs_of(case, system, model)
        times = best(calls, rounds=options.rounds)
        end, unit = SPANS[case.name]
        for who in ("heyoka", *OURS):
            cells = [milliseconds(times[f"{who} {density}"]) for density in DENSITIES]
            name = case.name if who == "heyoka" else ""
            rows.append((name, f"{end / unit:.0f}" if name else "", who, milliseconds(times[who]), *cells))
        scipy = times[f"SciPy {DENSITIES[0]}"]
        rows.append(("", "", "SciPy's DOP853", "", milliseconds(scipy), ""))
        bar = GRID_BAR if len(system.coordinates) < 2 else LARGER_BAR
        shares = [times[f"taylor {density}"] / times[f"heyoka {density}"] for density in DENSITIES]
        slower = scipy / times[f"taylor {DENSITIES[0]}"]
        added = [times[f"dop853 {density}"] / times["dop853"] for density in DENSITIES]
        checks = [verdict(share, bar) for share in shares]
        pairs = [cell for share, check in zip(shares, checks, strict=True) for cell in (shown(share), check)]
        ratios.append(
            (case.name, *pairs, shown(slower), verdict(SCIPY_BAR, slower), *map(shown, added), f"{apart:.0e}")
        )
    head = [f"{density} times a unit, ms" for density in DENSITIES]
    page.table(("system", "units of time", "run by", "without, ms", *head), rows)
    page.text(
        f"As parts of heyoka's time, which may be {GRID_BAR:g}, and {LARGER_BAR:g} from 2 coordinates on; SciPy's time "
        f"for {DENSITIES[0]} times a unit as a multiple of taylor's; dop853 with outputs against its run without; and "
        "how far apart taylor and dop853 are at the most."
    )
    columns = [name for density in DENSITIES for name in (f"taylor / heyoka, {density}", "met")]
    added_head = [f"dop853 / without, {density}" for density in DENSITIES]
    page.table(("system", *columns, "SciPy / taylor", "met", *added_head, "apart"), ratios)


def at_any_time(page: Page, options: Namespace) -> None:
    """Add the table of states at random times behind a run."""
    rows, rng = [], np.random.default_rng(1)
    for case in (each for each in CASES if each.name in SPANS and each.name in options.only):
        system = case.system()
        model = system.compile()
        end, _ = SPANS[case.name]
        times = rng.uniform(0.0, end, RANDOM)
        initial = case.initial(model)
        n = len(system.coordinates)
        bar = next((AT_BARS[k] for k in sorted(AT_BARS) if n <= k), float("inf"))
        for method in options.methods:
            run = partial(lg.integrate, model, (0.0, end), initial, method=method)
            given: dict[str, Any] = {"step": end / STEPS} if method in FIXED_STEPS else {"rtol": TOLERANCE}
            solution = run(**given)
            if not solution.status.at_end:
                continue
            calls = {"many": partial(solution.at, times), "one": partial(solution.at, end / 3)}
            found = best(calls, rounds=options.rounds)
            each = 1e6 * found["many"] / RANDOM
            rows.append(
                (case.name, n, method, solution.steps, shown(each), verdict(each, bar), shown(1e6 * found["one"]))
            )
    page.text(f"## solution.at of {RANDOM:,} random times")
    page.table(("system", "coordinates", "method", "steps", "us a time", "met", "one time, us"), rows)


def request() -> Namespace:
    """Return what is asked for on the command line."""
    parser = ArgumentParser(description="What states between the steps cost.")
    parser.add_argument("--only", nargs="+", default=list(SPANS), help="names of systems")
    parser.add_argument("--methods", nargs="+", default=[*OURS, *OTHERS])
    parser.add_argument("--rounds", type=int, default=10)
    return parser.parse_args()


def main() -> None:
    """Measure, and write the page."""
    options = request()
    page = Page("States between the steps", __file__)
    outputs(page, options)
    at_any_time(page, options)
    if set(options.only) == set(SPANS):
        page.write()


if __name__ == "__main__":
    main()
