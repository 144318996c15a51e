"""Entries of a reference with the error of each and the size that errors are judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lagrange.evidence.central_differences import Numbers
from lagrange.evidence.operations import OutsideDomain
from lagrange.machine.backend import FloatArray

SMOOTHNESS = 1e-14
"""Error of the differencing, relative to the size, above which a point is of no use."""


@dataclass(frozen=True)
class ReferenceEntries:
    """One quantity's entries in a row: values, error bounds of the differencing, and sizes (see the module)."""

    value: Numbers
    error: Numbers
    size: Numbers

    @cached_property
    def doubles(self) -> tuple[FloatArray, FloatArray]:
        """The nearest double of each value, and the rest as another double."""
        near = [float(x) for x in self.value]
        return np.array(near), np.array([float(x - y) if x else 0.0 for x, y in zip(self.value, near, strict=True)])

    @cached_property
    def allowance(self) -> tuple[FloatArray, FloatArray]:
        """The sizes and the error bounds as doubles."""
        return np.array([float(x) for x in self.size]), np.array([float(x) for x in self.error])

    @staticmethod
    def exactly(values: Numbers) -> ReferenceEntries:
        """Return entries that are known exactly, without rounding."""
        return ReferenceEntries(values, [0.0] * len(values), [abs(x) for x in values])

    def part(self, start: int, length: int) -> ReferenceEntries:
        """Return `length` entries from `start` on."""
        where = slice(start, start + length)
        return ReferenceEntries(self.value[where], self.error[where], self.size[where])

    def __add__(self, other: ReferenceEntries) -> ReferenceEntries:
        return ReferenceEntries(self.value + other.value, self.error + other.error, self.size + other.size)

    def around(self, values: Sequence[Any]) -> ReferenceEntries:
        """Return entries of the same sizes with other, exact values."""
        return ReferenceEntries(list(values), [0.0] * len(self.size), self.size)

    def check_smooth(self) -> None:
        """Raise OutsideDomain if differencing did not converge: a kink or a jump lies within its steps."""
        floor = max(self.size, default=0) * SMOOTHNESS
        if any(error > SMOOTHNESS * (size + floor) for error, size in zip(self.error, self.size, strict=True)):
            raise OutsideDomain("the energies have no derivative here")
