"""How many threads run at once where nobody says it."""

from __future__ import annotations

import os


def processors() -> int:
    """Return how many processors this process may use, which a container or `taskset` may make fewer than there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
