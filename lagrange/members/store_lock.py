"""One call at a time writes to a store: the lock of a file in it, which the system frees when a process ends."""

from __future__ import annotations

import os
import socket
import sys
import threading
from contextlib import suppress
from pathlib import Path

from lagrange.errors import RunError

if sys.platform != "win32":
    import fcntl

LOCK = ".lock"
"""The name of the file, which says who writes. It is removed at the end, and one that was left behind harms nothing."""

_HELD: set[str] = set()
_CHANGING = threading.Lock()
"""The stores that this process writes to: the locks of the system tell processes apart, and not threads."""


class StoreLock:
    """The right to write to a store, until it is closed. Raises RunError where another call has it.

    The lock is one of `lockf`: workers that a process forks do not keep it when that process is killed. There is none
    where the file cannot be made, as in a store that may only be read, and where there are no locks.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._key, self._descriptor = path / LOCK, os.path.realpath(path), -1
        with _CHANGING:
            if self._key in _HELD:
                raise _taken(path, "another thread of this process")
            self._descriptor = _locked(path, self._path)
            _HELD.add(self._key)

    def close(self) -> None:
        """Let other calls write."""
        with _CHANGING:
            _HELD.discard(self._key)
            if self._descriptor >= 0:
                with suppress(OSError):
                    self._path.unlink()
                os.close(self._descriptor)
                self._descriptor = -1


def _locked(store: Path, path: Path) -> int:
    """Return the descriptor of a file that is locked, -1 where there are no locks."""
    if sys.platform == "win32":
        return -1
    while True:
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError:
            return -1
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            owner = os.read(descriptor, 200).decode(errors="replace")
            os.close(descriptor)
            raise _taken(store, owner or "another process") from None
        except OSError:
            os.close(descriptor)
            return -1
        if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
            with suppress(OSError):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
            return descriptor
        os.close(descriptor)  # who had the lock before has removed the file


def _taken(store: Path, owner: str) -> RunError:
    return RunError(
        f"{store} is written to by {owner}: wait until that is done, and make the same call again, which goes on from "
        "there; or give another store."
    )
