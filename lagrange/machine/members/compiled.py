"""Machine code of a procedure for many members, and its arguments as NumPy arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from lagrange.algorithm.members.queue import LANE
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.engine import lanes as widest
from lagrange.machine.members.module import members_module
from lagrange.procedure.form import REAL, WHOLE, Kind, Procedure
from lagrange.procedure.rewrite import Pruner
from lagrange.procedure.spread import COMMON, OWN

_SCALARS: Mapping[Kind, Any] = {REAL: ctypes.c_double, WHOLE: ctypes.c_int64}


class MembersCode:
    """A procedure over members, see `lagrange.algorithm.members.queue`, compiled for all lanes of a vector."""

    def __init__(self, procedure: Procedure) -> None:
        self.lanes = widest()
        pruned = Pruner().pruned(procedure)
        self._parameters = pruned.parameters
        signature = tuple(OWN if one.name == LANE else COMMON for one in pruned.parameters)
        self._code = Module(members_module(pruned, signature, self.lanes), optimize=True, often=True)
        types = [
            _SCALARS[one.type] if isinstance(one.type, Kind) and one.name != LANE else ctypes.c_void_p
            for one in pruned.parameters
        ]
        self._call = ctypes.CFUNCTYPE(None, ctypes.c_int64, *types, ctypes.c_void_p)(self._code.address(pruned.name))
        self._numbers = np.arange(self.lanes, dtype=np.int64)

    def __call__(self, given: Mapping[str, Any]) -> None:
        """Run members; arrays are C-contiguous, of doubles or 64-bit whole numbers. Other threads run meanwhile."""
        known = {**given, LANE: self._numbers, "lanes": self.lanes}
        values = [known[one.name] for one in self._parameters]
        plain = [value.ctypes.data if isinstance(value, np.ndarray) else value for value in values]
        self._call(2**self.lanes - 1, *plain, None)
