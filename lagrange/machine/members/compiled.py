"""Machine code of a procedure for many members, and its arguments as NumPy arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from lagrange.machine.llvm.engine import lanes as widest
from lagrange.machine.llvm.tiers import TieredModule
from lagrange.machine.members.module import members_module
from lagrange.procedure.form import REAL, WHOLE, Kind, Procedure
from lagrange.procedure.members.queue import LANE
from lagrange.procedure.prune import Pruner
from lagrange.procedure.spread import COMMON, OWN

_SCALARS: Mapping[Kind, Any] = {REAL: ctypes.c_double, WHOLE: ctypes.c_int64}

AT_FIRST: Mapping[str, bool] = {"specialize": True, "often": True}
WELL: Mapping[str, bool] = {"optimize": True, "often": True}

STEPS = 50_000_000
"""So many steps of members are taken before code is compiled well.

Flips of a double pendulum take 1.1 s to compile well and 0.6 s at first, and then 81 and 94 ns a step; the largest
angle 0.5 s and 0.2 s, 55 and 72 ns. What compiling well takes is saved by 30 to 90 million steps.
"""


class MembersCode:
    """A procedure over members, see `lagrange.procedure.members.queue`, compiled for all lanes of a vector."""

    def __init__(self, procedure: Procedure) -> None:
        self.lanes = widest()
        pruned = Pruner().pruned(procedure)
        self._parameters = pruned.parameters
        signature = tuple(OWN if one.name == LANE else COMMON for one in pruned.parameters)
        text = members_module(pruned, signature, self.lanes)
        self._code = TieredModule(text, pruned.name, WELL, AT_FIRST, STEPS)
        types = [
            _SCALARS[one.type] if isinstance(one.type, Kind) and one.name != LANE else ctypes.c_void_p
            for one in pruned.parameters
        ]
        self._function = ctypes.CFUNCTYPE(None, ctypes.c_int64, *types, ctypes.c_void_p)
        self._numbers = np.arange(self.lanes, dtype=np.int64)

    def __call__(self, given: Mapping[str, Any]) -> None:
        """Run members; arrays are C-contiguous, of doubles or 64-bit whole numbers. Other threads run meanwhile."""
        known = {**given, LANE: self._numbers, "lanes": self.lanes}
        values = [known[one.name] for one in self._parameters]
        plain = [value.ctypes.data if isinstance(value, np.ndarray) else value for value in values]
        self._function(self._code.address)(2**self.lanes - 1, *plain, None)
        self._code.count(int(given["steps"].sum() + given["rejected"].sum()))
