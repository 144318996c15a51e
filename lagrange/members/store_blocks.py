"""Blocks of members in a store, each variable of each block with a checksum: missing and changed files are noticed."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.errors import RunError
from lagrange.members.keep import STATUS
from lagrange.members.names import CHECKSUM
from lagrange.trajectory.trajectory import FloatArray

DAMAGE = (
    *(KeyError, TypeError, ValueError, RuntimeError, AttributeError, ArithmeticError, IndexError, EOFError),
    *(ImportError, MemoryError, OSError, zlib.error),
)
"""Errors that zarr raises where files of a store are missing, changed, or none of its own."""


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise RunError where files of a store are damaged."""
    try:
        yield
    except DAMAGE as error:
        raise damaged(path, (" ".join(str(error).split()) or type(error).__name__)[:120]) from error


def damaged(path: Path, reason: str) -> RunError:
    """Return the error of a store whose files are not those that were written."""
    return RunError(
        f"{str(path)[:120]} is damaged ({reason}): make the same call again, which runs the members of damaged blocks "
        "again, give another store, or restore this one."
    )


def checksum(rows: Any) -> int:
    """Return 64 bits of a digest of rows with their type and shape, never 0: that means rows that were not written."""
    digest = hashlib.blake2b(f"{rows.dtype.str} {rows.shape}".encode(), digest_size=8)
    digest.update(np.ascontiguousarray(rows).data if rows.size else b"")
    return int.from_bytes(digest.digest(), "little") or 1


class StoreBlocks:
    """The blocks of a store: `names` are its variables, with a row for each of the members."""

    def __init__(self, path: Path, group: Any, names: Sequence[str], members: int, size: int) -> None:
        self.path, self.group, self.names, self.size = path, group, tuple(names), size
        self.count, self._members = -(-members // size), members

    def bounds(self, k: int) -> tuple[int, int]:
        """Return the first member of a block, and the one after its last."""
        return k * self.size, min((k + 1) * self.size, self._members)

    def left(self) -> list[tuple[int, int]]:
        """Return the bounds of blocks that are still to be run; damaged ones are marked as not written."""
        found = []
        for k in range(self.count):
            try:
                sums = self._sums(k)
                whole = sums.all() and all(self._matches(name, k, sums[i]) for i, name in enumerate(self.names))
            except DAMAGE:
                sums, whole = None, False
            if not whole:
                if sums is None or sums.any():
                    self.group[CHECKSUM][k] = 0
                found.append(self.bounds(k))
        return found

    def write(self, k: int, rows: dict[str, Any]) -> None:
        """Write a block, its status last, and then its checksums."""
        begin, end = self.bounds(k)
        for name in sorted(rows, key=STATUS.__eq__):
            self.group[name][begin:end] = rows[name]
        self.group[CHECKSUM][k] = np.array([checksum(rows[name]) for name in self.names], dtype="u8")

    def column(self, name: str, blank: Any) -> Any:
        """Return a variable of all members, blank where it was not written. Raises RunError where it is damaged."""
        with reading(self.path):
            sums, rows = np.asarray(self.group[CHECKSUM][:]), np.asarray(self.group[name][:])
        for k in range(self.count):
            begin, end = self.bounds(k)
            rows[begin:end] = self._checked(name, k, rows[begin:end], sums[k], blank)
        return rows

    def row(self, name: str, member: int, blank: Any) -> Any:
        """Return a variable of one member; see `column`."""
        k = member // self.size
        begin, end = self.bounds(k)
        with reading(self.path):
            sums, rows = self._sums(k), np.asarray(self.group[name][begin:end])
        return np.broadcast_to(self._checked(name, k, rows, sums, blank), rows.shape)[member - begin]

    def _checked(self, name: str, k: int, rows: Any, sums: Any, blank: Any) -> Any:
        """Return the rows of a block as they were written."""
        if not sums.all():
            return blank
        if checksum(rows) != sums[self.names.index(name)]:
            raise damaged(self.path, f"{name} of members {self.bounds(k)[0]} to {self.bounds(k)[1] - 1} has changed")
        return rows

    def _sums(self, k: int) -> Any:
        return np.asarray(self.group[CHECKSUM][k])

    def _matches(self, name: str, k: int, expected: Any) -> bool:
        begin, end = self.bounds(k)
        return bool(checksum(np.asarray(self.group[name][begin:end])) == expected)


def same_array(found: Any, wanted: Any) -> bool:
    """Return whether an array of a store is laid out as it was made; codecs may differ between versions of zarr."""
    return bool(_layout(found) == _layout(wanted))


def same_values(found: Any, wanted: FloatArray) -> bool:
    """Return whether an array has these values."""
    return bool(np.array_equal(np.asarray(found[:]), wanted))


def _layout(array: Any) -> tuple[Any, ...]:
    names = array.metadata.dimension_names
    return array.shape, array.chunks, array.dtype.str, repr(array.fill_value), None if names is None else tuple(names)
