"""Tiered compilation: code is compiled quickly at first, and optimized after many steps.

Both versions do the same operations in the same order, so their results agree to the last bit: LLVM neither
reassociates nor contracts operations without fast-math flags, and ours have none.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from lagrange.machine.copies import Shared
from lagrange.machine.llvm.engine import Module

STEPS_BEFORE_OPTIMIZING = 5000
"""Number of steps after which code is compiled with optimization.

The series of a double pendulum takes 59 ms to compile with optimization and 19 without; a loop over Runge-Kutta steps,
77 and 18. Steps without it take 1.1 to 1.5 times as long, and up to 2.6 times with Newton's method or ten coordinates,
so that 5,000 of them lose 1 to 40 ms.
"""


class TieredModule(Shared):
    """A module with a function that takes steps. `optimize` and `merge` apply to the optimized version; see `Module`.

    Both versions are kept, because other runs may hold the address of the first. Threads may share them. `needs` is
    called before each compilation, to compile what the code needs of other modules.
    """

    def __init__(
        self,
        text: str,
        name: str,
        *,
        merge: bool = False,
        optimize: bool = False,
        needs: Callable[..., None] | None = None,
    ) -> None:
        self.ir, self._name = text, name
        self._passes, self._needs = {"merge": merge, "optimize": optimize}, needs
        if needs is not None:
            needs(well=False)
        self.quick = Module(text, quickly=True)
        self.address = self.quick.address(name)
        self._well: Module | None = None
        self._left = STEPS_BEFORE_OPTIMIZING
        self._lock = threading.Lock()

    def address_of(self, name: str) -> int:
        """Return the address of another function of the module."""
        return (self._well or self.quick).address(name)

    @property
    def is_final(self) -> bool:
        """True if the optimized version exists."""
        return self._well is not None

    def count(self, steps: int) -> None:
        """Count steps that a run has taken, and compile with optimization after many; `address` then changes.

        While another thread compiles, this one continues with the quick version.
        """
        self._left -= steps
        if self._left > 0 or not self._lock.acquire(blocking=False):
            return
        try:
            if self._well is None:
                if self._needs is not None:
                    self._needs(well=True)
                well = Module(self.ir, **self._passes)
                self.address = well.address(self._name)
                self._well = well
        finally:
            self._lock.release()
