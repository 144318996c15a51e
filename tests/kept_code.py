"""A cache of object code for test runs, since LLVM takes almost half of their processor time.

Most texts that a test run compiles occurred in the previous one. The name of a cache file depends on the text, the
passes, the version of LLVM, the processor, and the source of the module that calls LLVM.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from lagrange.machine.llvm import engine

ROOM = 500_000_000
"""Bytes in the folder after a run. A default run writes some 60 MB, a run of all cases several times as much."""

DIGEST = 32
"""Bytes of the checksum at the begin of a file."""


class KeptCode:
    """A replacement for the function that compiles a text, which reads the code of known texts from the cache."""

    def __init__(self, folder: Path, compiled: Callable[..., bytes]) -> None:
        self.folder, self._compiled = folder, compiled
        processor = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
        source = Path(engine.__file__).read_text("utf-8")
        self._setting = f"{llvm.llvm_version_info} {processor} {source}"

    def __call__(self, text: str, effort: int, passes: Callable[[Any, Any], None] | None) -> bytes:
        """Return the object code of a text."""
        way = f"{self._setting}\n{effort} {passes and passes.__name__}\n{text}"
        file = self.folder / hashlib.sha256(way.encode()).hexdigest()
        kept = file.read_bytes() if file.exists() else b""
        if kept and hashlib.sha256(kept[DIGEST:]).digest() == kept[:DIGEST]:
            os.utime(file)
            return kept[DIGEST:]
        code = self._compiled(text, effort, passes)
        self.folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=self.folder, delete=False) as part:
            part.write(hashlib.sha256(code).digest() + code)
        Path(part.name).replace(file)
        return code


def shrink(folder: Path, room: int = ROOM) -> None:
    """Remove the least recently used files until the others fit."""
    files = []
    for file in folder.glob("*"):
        with suppress(FileNotFoundError):  # another run has put it in its place meanwhile
            files.append((file, file.stat()))
    taken = sum(status.st_size for _, status in files)
    for file, status in sorted(files, key=lambda entry: entry[1].st_mtime):
        if taken > room:
            file.unlink(missing_ok=True)
            taken -= status.st_size
