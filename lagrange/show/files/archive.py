"""Arrays of a file in NumPy's format npz: their sizes are checked before they are read, and no code in it is run."""

from __future__ import annotations

import os
import stat
import struct
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.errors import StatementError, counted, shown

MOST_ARRAYS = 10_000
"""Largest number of arrays in a file: those of a run are about ten, and two for each event."""

UNREADABLE = (
    *(ValueError, KeyError, TypeError, AttributeError, IndexError, ArithmeticError, RuntimeError, MemoryError),
    *(EOFError, SyntaxError, UnicodeError, struct.error, zlib.error, zipfile.BadZipFile),
)
"""Errors that NumPy, zipfile, json and SymPy raise for data that are not in their format."""


def arrays_of(path: str | os.PathLike[str], most: float) -> dict[str, Any]:
    """Return the arrays of a file by name.

    Raises StatementError for a path that is not a file, for a file that is not an npz archive, and for arrays of more
    than `most` bytes, which are not read.
    """
    try:
        file = Path(path)
        mode = file.stat().st_mode
        if not stat.S_ISREG(mode):
            kind = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
            raise StatementError(f"{_named(path)} is {kind}: give a file that solution.to_npz wrote.")
        with zipfile.ZipFile(file) as archive:
            _check_sizes([one.file_size for one in archive.infolist()], path, most)
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
    except StatementError:
        raise
    except OSError as error:
        raise StatementError(f"{_named(path)} cannot be read ({error.strerror or error}).") from error
    except UNREADABLE as error:
        reason = str(error) or type(error).__name__
        raise StatementError(f"{_named(path)} is not a file that solution.to_npz wrote ({reason[:120]}).") from error


def _named(path: Any) -> str:
    return shown(os.fspath(path), 120)


def _check_sizes(sizes: Sequence[int], path: Any, most: float) -> None:
    """Raise StatementError for too many arrays, or for more bytes in them than `most`."""
    if len(sizes) > MOST_ARRAYS or sum(sizes) > most:
        raise StatementError(
            f"{_named(path)} has {counted(len(sizes), 'array')} of {sum(sizes):.3g} bytes together, and a run from a "
            f"file may have {MOST_ARRAYS} of {most:.3g} bytes, a quarter of the memory: write a run with fewer outputs."
        )
