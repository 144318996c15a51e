"""Arrays of a file in NumPy's format npz: their sizes are checked before they are read, and no code in it is run."""

from __future__ import annotations

import io
import math
import os
import stat
import struct
import zipfile
import zlib
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
            return _read(archive, path, most)
    except StatementError:
        raise
    except OSError as error:
        raise StatementError(f"{_named(path)} cannot be read ({error.strerror or error}).") from error
    except UNREADABLE as error:
        reason = str(error) or type(error).__name__
        raise StatementError(f"{_named(path)} is not a file that solution.to_npz wrote ({reason[:120]}).") from error


def _named(path: Any) -> str:
    return shown(os.fspath(path), 120)


def _read(archive: zipfile.ZipFile, path: Any, most: float) -> dict[str, Any]:
    """Return the arrays of an archive, one after the other."""
    infos = archive.infolist()
    total = sum(one.file_size for one in infos)
    if len(infos) > MOST_ARRAYS or total > most:
        raise StatementError(
            f"{_named(path)} has {counted(len(infos), 'array')} of {total:.3g} bytes together, and a run from a file "
            f"may have {MOST_ARRAYS} of {most:.3g} bytes, a quarter of the memory: write a run with fewer outputs."
        )
    found: dict[str, Any] = {}
    for one in infos:
        name = one.filename.removesuffix(".npy")
        if name in found:
            raise ValueError(f"two arrays have the name {name[:40]}")
        found[name] = _array(archive.read(one))
    return found


def _array(content: bytes) -> Any:
    """Return the array of an npy file, whose header states its size."""
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"its arrays have the version {version}")
    shape, by_columns, dtype = readers[version](file)
    size = math.prod(shape)
    if dtype.hasobject or min(shape, default=0) < 0 or size * dtype.itemsize != len(content) - file.tell():
        raise ValueError(f"an array of shape {shape} and type {dtype} has {len(content)} bytes")
    flat = np.frombuffer(content, dtype, size, file.tell()) if size * dtype.itemsize else np.empty(size, dtype)
    return flat.reshape(shape, order="F" if by_columns else "C").copy()
