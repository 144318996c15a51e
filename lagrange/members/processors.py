"""How many threads run at once."""

from __future__ import annotations

import os
from typing import Any

from lagrange.statement.number import whole_number

MOST_WORKERS = 1024
"""More threads than any machine has processors: a larger number is a mistake."""


def processors() -> int:
    """Return how many processors this process may use, which a container or `taskset` may make fewer than there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_of(workers: Any) -> int:
    """Return the number of threads: as many as this process may use processors unless `workers` says it."""
    return processors() if workers is None else whole_number(workers, "workers", 1, MOST_WORKERS)
