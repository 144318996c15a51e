"""What writing leaves behind when a process is killed: who may clean it up, and what no signal cuts in two."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

if sys.platform != "win32":
    import fcntl

_ENDING = ("SIGHUP", "SIGTERM", "SIGINT")


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold back the signals that end a process until the block is through; the first of them is delivered then.

    For changes of a few milliseconds that must not stop half way. Other threads than the main one get no signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        came.append(number)

    before = {}
    try:
        for number in [signal.Signals[name] for name in _ENDING if name in signal.Signals.__members__]:
            if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN):
                before[number] = handler
                signal.signal(number, note)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            _deliver(came[0])


def _deliver(number: int) -> None:
    handler = signal.getsignal(number)
    if callable(handler):
        handler(number, None)
    else:
        signal.raise_signal(number)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Wait until no other process creates, completes or cleans up temporary files of a folder; then keep it so."""
    if os.name != "posix":
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        lock(descriptor, wait=True)
        yield
    finally:
        os.close(descriptor)


def lock(descriptor: int, *, wait: bool = False) -> bool:
    """Lock an open file or folder until it is closed, and return whether that was done.

    It is not where another process has the lock, and where the system or the file system has no locks.
    """
    if sys.platform == "win32":
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def abandoned(path: Path) -> bool:
    """Return whether a temporary file or folder is there whose process has ended: nobody holds its lock any more.

    Call it while the folder around it is `locked`.
    """
    if os.name != "posix" or path.is_symlink() or not path.exists():
        return False
    descriptor = os.open(path, os.O_RDONLY)
    try:
        return lock(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Make new names in a folder last through a power cut, where the system can do that to a folder."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
