"""Laws of contact on 500 random systems with up to four contacts, by two methods.

python docs/benchmarks/random_contacts.py [first seed] [number of systems]
"""

from __future__ import annotations

import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
from measure import FOLDER, Page

import lagrange as lg

sys.path.insert(0, str(FOLDER.parents[1]))

from tests.contact.random_contacts import KINDS, broken_laws, random_system

METHODS = {"taylor": 1e-12, "dop853": 1e-11}
"""Methods with their relative tolerances. Each also runs with its default tolerance."""

ERROR = 10.0
"""Largest relative error of energy, gaps and forces, as a multiple of the tolerance."""

SYSTEMS, SECONDS, AGREED, SAMPLES = 500, 120.0, 1e-6, 40
"""Number of systems; limit of a run; states that agree, as a part of the largest; number of times that are compared."""

FIRST_SEED = 10_000
"""First seed: tests use smaller ones."""

RIGHT, BROKEN, REFUSED, ENDED = "right", "a law is broken", "refused", "ended early"


class Row(NamedTuple):
    """A run: the seed, the kind of the system, the method, the outcome and its reason, and the modes and impacts."""

    seed: int
    kind: str
    method: str
    outcome: str
    reason: str
    modes: int
    impacts: int


def outcome(run: lg.Solution, texts: list[str]) -> tuple[str, str]:
    """Return the outcome of a run and its reason. Painleve's paradox, and laws that leave a choice, end a run."""
    if texts:
        return BROKEN, ", ".join(texts)
    if run.status is lg.Status.SINGULAR:
        return REFUSED, run.message
    return (RIGHT, "") if run.status.complete else (ENDED, run.message)


def rows_of(seed: int) -> tuple[list[Row], float]:
    """Return the runs of a random system, and the difference of their states."""
    drawn = random_system(seed)
    system, kind, rows, runs = drawn.system, KINDS[seed % len(KINDS)].__name__, [], []
    for method, rtol in [*METHODS.items(), *((method, None) for method in METHODS)]:
        name = method if rtol else f"{method}, default tolerance"
        try:
            run = system.run(drawn.end, method=method, rtol=rtol, max_wall=SECONDS)
        except lg.LagrangeError as refusal:
            rows.append(Row(seed, kind, name, REFUSED, str(refusal), 0, 0))
            continue
        # A method of steps has the positions, and the ends of modes, to its tolerance.
        error = 0.0 if method == "taylor" and rtol else ERROR * (run.trajectory.rtol or 0.0)
        texts = broken_laws(system, run, driven=drawn.driven, error=error)
        history = run.trajectory.contacts
        modes = 0 if history is None else len(history.begins)
        impacts = sum(len(contact.impacts) for contact in run.contacts.values())
        rows.append(Row(seed, kind, name, *outcome(run, texts), modes, impacts))
        if rtol:
            runs.append(run)
    if len(runs) < len(METHODS):
        return rows, 0.0
    times = np.linspace(0, 0.999 * min(run.t[-1] for run in runs), SAMPLES)
    first, second = (run.at(times) for run in runs)
    return rows, float(np.abs(first - second).max() / np.abs(first).max())


def main() -> None:
    """Run, print and write the page."""
    numbers = [int(text) for text in sys.argv[1:]]
    first, count = [*numbers, *(FIRST_SEED, SYSTEMS)[len(numbers) :]]
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(rows_of, range(first, first + count)))
    rows = [row for pair, _ in found for row in pair]
    counts = Counter((row.method, row.outcome) for row in rows)
    page = Page("Contact on random systems", __file__)
    outcomes = (RIGHT, BROKEN, REFUSED, ENDED)
    page.table(
        ("method", *outcomes, "modes", "impacts"),
        [
            (
                method,
                *(counts[method, each] for each in outcomes),
                sum(row.modes for row in rows if row.method == method),
                sum(row.impacts for row in rows if row.method == method),
            )
            for method in dict.fromkeys(row.method for row in rows)
        ],
    )
    page.text(f"The states of both agree to {AGREED:g} in {sum(far <= AGREED for _, far in found)} of {count} systems.")
    others = [row for row in rows if row.outcome != RIGHT]
    page.table(("seed", "kind", "method", "outcome", "reason"), [(*row[:4], row.reason[:200]) for row in others])
    page.write()


if __name__ == "__main__":
    main()
