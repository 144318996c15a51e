"""Names of the reductions of an expression along a run, such as "max".

The command line imports this module, which does not import NumPy.
"""

from __future__ import annotations

REDUCTIONS = ("max", "min", "mean")
