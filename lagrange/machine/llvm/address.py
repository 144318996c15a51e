"""Address of an array's data, read quickly: `ctypes.data` takes longer than a call of a small kernel."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

LINE = 64
"""Size of a cache line in bytes. Access to a vector that crosses lines takes twice as long, which costs a tenth of a
run.
"""

_HEADER = object.__basicsize__
_pointer_at = ctypes.c_void_p.from_address


def _by_layout(array: NDArray[Any]) -> int:
    """Return the address of an array's data, read from NumPy's C structure behind the object's header (0.13 us)."""
    return _pointer_at(id(array) + _HEADER).value or 0


def _by_attribute(array: NDArray[Any]) -> int:
    """Return the address of an array's data from NumPy's attribute `ctypes.data` (1 us)."""
    return int(array.ctypes.data)


# The test is needed because id() is an address in CPython only.
by_layout = sys.implementation.name == "cpython" and all(
    _by_layout(probe[..., :1]) == _by_attribute(probe[..., :1])
    for probe in (np.zeros(1), np.zeros(7), np.zeros((3, 5)))
)
"""True if the data pointer of arrays follows the object header, as NumPy documents, so that `_by_layout` is correct."""

address = _by_layout if by_layout else _by_attribute
"""Function that returns the address of an array's first number. The array must stay referenced while the address is
used.
"""


def workspace(count: int) -> NDArray[np.float64]:
    """Return an array of `count` zeros whose memory begins at a cache line, for fast access by vectors."""
    spare = LINE // 8
    memory = np.zeros(count + spare)
    begin = -address(memory) % LINE // 8
    return memory[begin : begin + count]
