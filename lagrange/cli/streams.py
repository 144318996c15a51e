"""Standard output and standard error of the program, also where they are closed, full, or a broken pipe."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress

UNWRITTEN, UNREAD = 1, 141
"""Exit codes: the output cannot be written; broken pipe, 128 + the number of SIGPIPE."""


def output(text: str, code: int) -> int:
    """Print to standard output and return the exit code, which is not 0 if the text could not be written.

    A broken pipe is not reported.
    """
    try:
        if sys.stdout is None:
            raise OSError(errno.EBADF, "standard output is closed")
        print(text, flush=True)
    except BrokenPipeError:
        _silence()
        return code or UNREAD
    except OSError as error:
        _silence()
        complain(f"the output cannot be written ({error.strerror}).")
        return code or UNWRITTEN
    return code


def complain(message: str) -> None:
    """Print an error message to standard error, if it is open."""
    if sys.stderr is not None:
        with suppress(OSError):
            print(f"lagrange: {message}", file=sys.stderr, flush=True)


def occupy_standard_streams() -> None:
    """Open the null device on closed standard streams, so that no other file gets their descriptors."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        continue
    os.close(descriptor)


def _silence() -> None:
    """Discard all further standard output, including what Python flushes at exit."""
    if sys.stdout is not None:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
