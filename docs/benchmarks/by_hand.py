"""Hand-written C for comparison, compiled by gcc and called through ctypes."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from native import address, compiled, pointer
from numpy.typing import NDArray
from systems import DOUBLE

PARAMETERS = np.array(list(DOUBLE.values()))
"""m1, m2, l1, l2, g in the order of the C file."""


class ByHand:
    """The functions of double_pendulum.c."""

    def __init__(self) -> None:
        self.library = compiled("double_pendulum.c")
        self.address = address(self.library.by_hand)
        """Address of the accelerations."""

    def loop(self, name: str, kernel: int, parameters: NDArray[Any], states: NDArray[Any]) -> Callable[[], float]:
        """Return a call of a timing loop, once over all states (N, 4)."""
        function = self.library[name]
        function.restype = ctypes.c_double
        function.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_int64] * 2
        return partial(function, kernel, pointer(parameters), pointer(states), len(states), 1)

    def rk4(self, y0: NDArray[Any], h: float, steps: int) -> NDArray[Any]:
        """Return the states (steps + 1, 4) of the classical Runge-Kutta method."""
        rows = np.empty((steps + 1, 4))
        rows[0] = y0
        function = self.library.rk4
        function.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_int64, ctypes.c_void_p]
        function(PARAMETERS.ctypes.data, h, steps, rows.ctypes.data)
        return rows
