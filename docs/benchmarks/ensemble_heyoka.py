"""Many runs by heyoka's batch mode, at the same tolerance as ours and at the same error."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable

import heyoka as hy
import numpy as np
from ensemble_measures import SAMPLED, SPANS, Array, Errors, best, ours, starts
from measure import Page, microseconds, shown, verdict
from taylor_systems import CASES, MODES, Case, equations

import lagrange as lg

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
DECADES, SMALLEST = 4, 2.0**-53
"""Our tolerance at the error of a rival is at most so many decades below its own, and no smaller."""

SMALL = ("pendulum", "henon-heiles", "kepler", "double")
"""Systems of which all members run; of larger ones a tenth."""


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


def at_most(
    wanted: float, tolerance: float, case: Case, system: lg.System, y0: Array, errors: Errors
) -> tuple[float, float]:
    """Return our largest tolerance whose error is at most the wanted one, else that of the least error; and the error.

    Four of them are tried in each decade.
    """
    found: dict[float, float] = {}
    for quarter in range(4 * DECADES):
        ours_at = max(tolerance * 10.0 ** (-quarter / 4), SMALLEST)
        runs = ours(case, system, y0[: 4 * SAMPLED], rtol=ours_at, atol=ours_at)()
        found[ours_at] = errors.of(runs.y.T)
        if found[ours_at] <= wanted or ours_at == SMALLEST:
            break
    least = min(found, key=found.__getitem__)
    return least, found[least]


def against_heyoka(page: Page, options: Namespace) -> None:
    """Measure members against heyoka's batch mode, at its tolerance and at its error."""
    rows = []
    for case in (one for one in CASES if one.name in options.only and one.name in SPANS):
        system = case.system()
        y0 = starts(case, options.members if case.name in SMALL else max(64, options.members // 10))
        errors = Errors(case, system, y0)
        for tolerance in TOLERANCES:
            theirs = {
                f"{mode}, {batch}": in_batches(case, system, y0, tolerance, mode, batch)
                for mode in MODES
                if mode == "compact" or case.unrolled <= tolerance
                for batch in BATCHES
            }
            wanted = errors.of(next(iter(theirs.values()))())
            asked, reached = at_most(wanted, tolerance, case, system, y0, errors)
            here = {
                "at its tolerance": ours(case, system, y0, rtol=tolerance, atol=tolerance),
                "at its error": ours(case, system, y0, rtol=asked, atol=asked),
            }
            form, mine = here["at its tolerance"]().form, errors.of(here["at its tolerance"]().y.T)
            times = {
                name: seconds / len(y0) for name, seconds in best({**here, **theirs}, rounds=options.rounds).items()
            }
            fastest = min(theirs, key=times.__getitem__)
            other, bar = times[fastest], BARS[case.name]
            plain, equal = (other / times[name] for name in here)
            rows.append(
                (
                    case.name,
                    f"{tolerance:g}",
                    "side by side" if "side by side" in form else "one by one",
                    f"{microseconds(other)} ({fastest})",
                    f"{wanted:.1e}",
                    microseconds(times["at its tolerance"]),
                    f"{mine:.1e}",
                    shown(plain),
                    f"{asked:.1e}",
                    f"{reached:.1e}",
                    shown(equal),
                    f"{bar:g}",
                    verdict(bar, equal),
                )
            )
    page.text(
        "## Against heyoka's batch mode\n\nTimes are microseconds a member, heyoka's with its mode and its batch. The "
        "first ratio is at the same tolerance, the second one at the tolerance of ours whose error is at most "
        "heyoka's; `at least` is what was aimed at, at equal errors."
    )
    head = (
        "system",
        "tolerance",
        "members",
        "heyoka, us",
        "error",
        "ours, us",
        "error",
        "ratio",
        "our tolerance",
        "error",
        "ratio",
        "at least",
        "met",
    )
    page.table(head, rows)
