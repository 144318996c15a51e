"""A cache of object code for test runs, since LLVM takes almost half of their processor time.

Most texts that a test run compiles occurred in the previous one. joblib keeps their code in files.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import joblib
import llvmlite.binding as llvm

from lagrange.machine.llvm import engine

ROOM = 500_000_000
"""Bytes in the folder after a run. A default run writes some 60 MB, a run of all cases several times as much."""

compile_text = engine._compiled


def compiled(key: str, text: str, effort: int, passes: Callable[[Any, Any], None] | None) -> bytes:
    """Return the object code of a text. `key` is a hash of all on which it depends; joblib reads no other argument."""
    return compile_text(text, effort, passes)


class KeptCode:
    """A replacement for the function that compiles a text, which reads the code of known texts from a folder.

    The key of a code has the text, the passes, the version of LLVM, the processor, and the source of the engine.
    """

    def __init__(self, folder: Path) -> None:
        self._memory = joblib.Memory(folder, verbose=0)
        self._kept = self._memory.cache(compiled, ignore=["text", "effort", "passes"])
        processor = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
        self._setting = f"{llvm.llvm_version_info} {processor} {Path(engine.__file__).read_text('utf-8')}"

    def __call__(self, text: str, effort: int, passes: Callable[[Any, Any], None] | None) -> bytes:
        """Return the object code of a text."""
        way = f"{self._setting}\n{effort} {passes and passes.__name__}\n{text}"
        code: bytes = self._kept(hashlib.sha256(way.encode()).hexdigest(), text, effort, passes)
        return code

    def shrink(self) -> None:
        """Remove the least recently used code until the rest fits."""
        self._memory.reduce_size(bytes_limit=ROOM)
