"""Limits of a run: seconds of compilation, and the memory of its results."""

from __future__ import annotations

import os
import time
from functools import cache

from lagrange.statement.preparation import COMPILE_SECONDS
from lagrange.trajectory.integrator import Problem

MEMORY_DIVISOR = 4
"""The default memory limit of a run is the memory of the machine divided by this.

At the end the states are joined to one array, and derived quantities, such as the energy, need as much again.
"""

ASSUMED_MEMORY = 8 * 2**30
"""Bytes of memory that are assumed if the machine does not report it."""


def memory_limit(problem: Problem) -> float:
    """Return the number of bytes that the run may keep."""
    return machine_memory() / MEMORY_DIVISOR if problem.max_memory is None else problem.max_memory


@cache
def machine_memory() -> int:
    """Return the memory of this machine in bytes."""
    names = getattr(os, "sysconf_names", {})  # Windows has none
    if not {"SC_PAGE_SIZE", "SC_PHYS_PAGES"} <= names.keys():
        return ASSUMED_MEMORY
    pages = os.sysconf("SC_PHYS_PAGES")
    return pages * os.sysconf("SC_PAGE_SIZE") if pages > 0 else ASSUMED_MEMORY


def compiled_late(problem: Problem) -> str:
    """Return a sentence with the remedy if compilation has exceeded the time limit of the run, else ""."""
    taken = time.perf_counter() - problem.began
    if problem.max_wall is None or taken <= max(problem.max_wall, COMPILE_SECONDS):
        return ""
    return (
        f"Compiling took {taken:.3g} s, more than max_wall = {problem.max_wall:.6g} s. What is compiled stays with the "
        "model: run it again, raise max_wall, or take a method that compiles less, such as dop853."
    )
