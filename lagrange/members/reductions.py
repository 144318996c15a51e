"""Names of the reductions, such as "max", of an expression along a run; without numpy, for the command line."""

from __future__ import annotations

REDUCTIONS = ("max", "min", "mean")
