"""Cost of a first run of a compiled model beside its steps, and of further tolerances.

python docs/benchmarks/first_runs.py
"""

from __future__ import annotations

import gc
import json
import sys
from collections.abc import Callable, Iterator
from time import process_time
from typing import Any

from measure import Page, in_new_process, milliseconds

PROCESSES = 1
"""So many processes measure each row; the least counts. With one, rows differ by up to a fifth from time to time."""

TOLERANCES = [1e-9, *(10.0**-k for k in range(3, 17) if k != 9)]

RUNS: dict[str, dict[str, Any]] = {
    "taylor": {"method": "taylor"},
    "taylor, an event": {"method": "taylor", "event": True},
    "taylor, a later event": {"method": "taylor", "event": True, "before": True},
    "dop853": {"method": "dop853"},
    "rk4": {"method": "rk4", "step": 0.01},
    "radau5": {"method": "radau5"},
}

HEADER = ("system", "method", "first of its dimension, ms", "first of the system, ms", "14 tolerances, ms")


def systems() -> dict[str, Callable[[], Any]]:
    """Return the systems."""
    from systems import chain, double_pendulum, henon_heiles

    import lagrange as lg

    return {
        "pendulum": lambda: lg.System(**chain(1)),
        "Henon-Heiles": henon_heiles,
        "double pendulum": double_pendulum,
        "5 links": lambda: lg.System(**chain(5)),
    }


def measured(system: str, run: str) -> dict[str, float]:
    """Return the processor seconds of first runs beside their steps, and of all tolerances."""
    import lagrange as lg
    from lagrange.machine.llvm.engine import COMPILED

    options = dict(RUNS[run])
    watching, before = options.pop("event", False), options.pop("before", False)
    made = systems()

    def taken(model: Any, first: Any, rtol: float) -> float:
        given = options if "step" in options else {**options, "rtol": rtol}
        events = [lg.Event(first)] if watching else None
        began = process_time()
        lg.integrate(model, (0.0, 0.3), {first: 0.3}, events=events, **given)
        return process_time() - began

    def costs(tolerances: list[float]) -> list[float]:
        stated = made[system]()
        COMPILED.forget()
        model, first = stated.compile(check=False), stated.coordinates[0]
        gc.collect()
        found = [taken(model, first, rtol) for rtol in tolerances]
        return [one - taken(model, first, rtol) for one, rtol in zip(found, tolerances, strict=True)]

    other = made["5 links" if system == "pendulum" else "pendulum"]()
    compiled = other.compile(check=False)
    lg.integrate(compiled, (0.0, 0.1), method="rk4", step=0.01)
    if before:
        lg.integrate(compiled, (0.0, 0.1), method="taylor", events=[lg.Event(other.coordinates[0])])
    (alone,) = costs(TOLERANCES[:1])
    later = costs(TOLERANCES if options["method"] == "taylor" else TOLERANCES[:1])
    return {"alone": alone, "later": later[0], "all": sum(later)}


def rows() -> Iterator[tuple[str, ...]]:
    """Measure each row in new processes."""
    for system in systems():
        for run, options in RUNS.items():
            found = [in_new_process(__file__, system, run) for _ in range(PROCESSES)]
            least = {name: min(one[name] for one in found) for name in found[0]}
            tolerances = milliseconds(least["all"]) if options["method"] == "taylor" else ""
            yield system, run, milliseconds(least["alone"]), milliseconds(least["later"]), tolerances


if __name__ == "__main__":
    if sys.argv[1:]:
        print(json.dumps(measured(*sys.argv[1:])))
    else:
        page = Page("First runs and further tolerances", __file__)
        page.table(HEADER, rows())
        page.write()
