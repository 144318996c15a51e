"""The energy over long runs with fixed steps: every registered method of that kind, and Taylor's beside them.

python docs/benchmarks/energy.py
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import thread_time

import numpy as np
from long_runs import LongRun, blocks, long_run
from matplotlib.figure import Figure
from measure import Page, saved, shown
from systems import double_pendulum, henon_heiles

import lagrange as lg

PER_BLOCK, BLOCKS = 4000, 50
STEPS = {"Henon-Heiles": 0.1, "double pendulum": 0.02}
SYSTEMS: tuple[Callable[[], lg.System], ...] = (henon_heiles, double_pendulum)
INK = "#222222"
ENDED = (lg.RunError, lg.StatementError)


def adaptive_run(model: lg.Model, method: str, step: float) -> LongRun:
    """Run an adaptive method at its default tolerances over the same time."""
    began = thread_time()
    block = step * PER_BLOCK
    solution = lg.integrate(model, (0.0, block * BLOCKS), method=method).require()
    seconds = thread_time() - began
    off = solution.energy - solution.energy[0]
    place = np.minimum((solution.t / block).astype(int), BLOCKS - 1)
    parts = [off[place == k] for k in range(BLOCKS)]
    means, largest = ([float(f(part)) for part in parts] for f in (np.mean, lambda part: np.abs(part).max()))
    return LongRun(np.array(means), np.array(largest), block, seconds)


def runs(page: Page, system: lg.System) -> dict[str, LongRun]:
    """Run every method that takes fixed steps, and the adaptive ones of ours."""
    model, step = system.compile(), STEPS[system.name]
    found: dict[str, LongRun] = {}
    rows: list[Sequence[object]] = []
    for row in lg.methods.table():
        if row.name.startswith(("scipy-", "cvode")):
            continue
        try:
            if row.claims.adaptive:
                run = adaptive_run(model, row.name, step)
            else:
                run = long_run(blocks(model, row.name, step * PER_BLOCK, BLOCKS, step=step))
        except ENDED as error:
            rows.append((f"`{row.name}`", "", "", "", "", "", str(error).split(". ")[0]))
            continue
        found[row.name] = run
        slope, width = run.slope()
        kept = [
            word for word, claim in (("symplectic", row.claims.symplectic), ("adaptive", row.claims.adaptive)) if claim
        ]
        rows.append(
            (
                f"`{row.name}`",
                row.claims.order,
                f"{run.largest.max():.1e}",
                f"{slope:+.1e} ± {width:.0e}",
                "yes" if run.drifts() else "no",
                shown(run.seconds),
                ", ".join(kept),
            )
        )
    total = PER_BLOCK * BLOCKS
    page.text(f"## {system.name}, {total} steps of {step:g}")
    page.table(("method", "order", "largest error", "slope per unit of time", "drift", "s", "remark"), rows)
    return found


def picture(found: dict[str, dict[str, LongRun]]) -> None:
    """Draw the largest energy error until each time, for every method."""
    figure = Figure(figsize=(12.0, 6.2), layout="constrained")
    axes = figure.subplots(1, len(found), sharey=True)
    claims = {row.name: row.claims for row in lg.methods.table()}
    for axis, (title, curves) in zip(axes, found.items(), strict=True):
        for name, run in curves.items():
            times = run.block * np.arange(1, len(run.means) + 1)
            until = np.maximum(np.maximum.accumulate(run.largest), 1e-17)
            kept, own = claims[name].symplectic, claims[name].adaptive
            colour = "#0b6e99" if kept else "#8a8a8a" if own else "#d1495b"
            axis.loglog(times, until, color=colour, linewidth=1.3, linestyle=":" if own else "-")
            axis.annotate(name, (times[-1], until[-1]), (3, -2), textcoords="offset points", fontsize=7, color=colour)
        axis.set_title(title, loc="left", fontsize=10, color=INK)
        axis.set_xlabel("time")
        axis.set_ylim(1e-16, 1e3)
        axis.grid(color="#e3e3e3", linewidth=0.7)
        axis.spines[["top", "right"]].set_visible(False)
        axis.margins(x=0.22)
    axes[0].set_ylabel("largest energy error until then (blue: symplectic, dotted: adaptive)")
    saved(figure, "energy.png", 130)


def main() -> None:
    """Run, print and write the page and the picture."""
    page = Page("Energy over long runs", __file__)
    found = {system.name: runs(page, system) for system in (make() for make in SYSTEMS)}
    picture(found)
    page.text("![The largest energy error until each time, for every method, on two systems](energy.png)")
    page.write()


if __name__ == "__main__":
    main()
