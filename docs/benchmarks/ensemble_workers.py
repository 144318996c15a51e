"""One ensemble on one thread, on two, and on a local cluster of Dask with two workers."""

from __future__ import annotations

from argparse import Namespace
from time import perf_counter
from typing import Any

import numpy as np
from dask.distributed import Client, LocalCluster
from measure import Page, shown, verdict

import lagrange as lg

THREADS_BAR, CLUSTER_BAR = 1.8, 1.7
PILOT = 1_000_000
"""Members by which it is estimated how many take the time that is asked for."""


def run(system: lg.System, members: int, **options: Any) -> tuple[float, bytes]:
    """Return the seconds on the clock of an ensemble, compilation included, and the bytes of its ends."""
    side = int(np.sqrt(members))
    starts = lg.grid({"theta1": (-3.0, 3.0, side), "theta2": (-3.0, 3.0, side)})
    began = perf_counter()
    found = lg.ensemble(system, 5.0, starts, rtol=1e-9, **options)
    return perf_counter() - began, found.y.tobytes()


def with_workers(page: Page, options: Namespace) -> None:
    """Measure two workers against one thread; nothing else may run."""
    system = lg.scene("double-pendulum")
    seconds = min(run(system, PILOT, workers=1)[0] for _ in range(3))
    members = int(PILOT * options.seconds / seconds)
    one, ends = run(lg.scene("double-pendulum"), members, workers=1)
    two, ends_of_two = run(lg.scene("double-pendulum"), members, workers=2)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        dask, ends_of_dask = run(lg.scene("double-pendulum"), members, executor=client)
    same = "the same bytes" if ends == ends_of_two == ends_of_dask else "**other bytes**"
    page.text(
        f"## Two workers\n\nA grid of {members} starts of the double pendulum over 5 s at 1e-9, seconds on the clock, "
        f"with all that is compiled. All three give {same}."
    )
    rows = [("one thread", f"{one:.1f}", "1", "")]
    for name, seconds, bar in (("two threads", two, THREADS_BAR), ("Dask, two workers", dask, CLUSTER_BAR)):
        rows.append((name, f"{seconds:.1f}", shown(one / seconds), f"at least {bar:g}: {verdict(bar, one / seconds)}"))
    page.table(("where", "s", "times one thread", "asked for"), rows)
