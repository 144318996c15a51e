"""Many runs of one system: against heyoka's batch mode, runs one by one and diffrax, and on two workers.

python docs/benchmarks/ensembles.py --parts heyoka --only pendulum double --members 2000
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from functools import partial
from typing import Any

import heyoka as hy
from ensemble_diffrax import against_diffrax
from ensemble_heyoka import SMALL, against_heyoka
from ensemble_measures import SPANS, Array, best, ours, starts
from ensemble_workers import with_workers
from measure import Page, microseconds, shown, verdict
from taylor_systems import CASES

import lagrange as lg

METHODS: dict[str, dict[str, Any]] = {
    "taylor": {"rtol": 1e-9},
    "dop853": {"rtol": 1e-9},
    "rk4": {"step": 0.01},
    "verlet": {"step": 0.01},
}
SINGLE_BAR = 3.0


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
            times = best({"lanes": here, "single": single}, rounds=options.rounds)
            lanes, alone = times["lanes"] / len(y0), times["single"] / len(y0)
            met = verdict(SINGLE_BAR, alone / lanes)
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
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--seconds", type=float, default=60.0, help="how long the work for two workers takes on one")
    options = parser.parse_args()
    hy.set_nthreads(1)
    page = Page("Ensembles", __file__)
    for part in options.parts:
        PARTS[part](page, options)
    if set(options.only) == set(SPANS) and set(options.parts) == set(PARTS):
        page.write()


PARTS = {
    "heyoka": against_heyoka,
    "single": against_single_runs,
    "diffrax": against_diffrax,
    "workers": with_workers,
}
"""The sections of the page."""


if __name__ == "__main__":
    main()
