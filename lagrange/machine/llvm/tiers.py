"""Tiered compilation: code is compiled quickly at first, and with optimization after many steps.

Both versions do the same operations in the same order, so that results agree to the last bit. LLVM reassociates or
contracts operations only with fast-math flags, which the code does not have.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from lagrange.machine.copies import Shared
from lagrange.machine.llvm.engine import Module

STEPS_BEFORE_OPTIMIZING = 5000
"""Number of steps after which code is compiled with optimization. The series of a double pendulum compiles in 59 ms
with optimization and 19 ms without; a loop over Runge-Kutta steps in 77 and 18 ms. Steps without it take 1.1 to 1.5
times as long, and up to 2.6 times with Newton's method or ten coordinates. So 5,000 of them lose 1 to 40 ms.
"""


class TieredModule(Shared):
    """A module with a function that takes steps, compiled twice: quickly at first, and optimized after many steps.

    `optimize` and `merge` are options of `Module` for the optimized version. Both versions are kept, because other
    runs may hold the address of the first. `needs` is called before each compilation; it compiles the procedures of
    other modules that the code calls. Threads may share it.
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
        """Return the address of the function `name` in the best version compiled so far."""
        return (self._well or self.quick).address(name)

    @property
    def is_final(self) -> bool:
        """True if the optimized version is compiled, so that addresses no longer change."""
        return self._well is not None

    def count(self, steps: int) -> None:
        """Report `steps` more steps of a run. After many steps the code is optimized, and `address` changes.

        While another thread compiles, this thread continues with the quick version.
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
