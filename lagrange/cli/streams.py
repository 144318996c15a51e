"""Standard output and standard error of the program, also where they are closed, full, or read by nobody."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress

UNWRITTEN, UNREAD = 1, 141
"""Exit codes of an answer that cannot be written, and of one whose reader went away: 128 + the number of SIGPIPE."""


def output(text: str, code: int) -> int:
    """Print to standard output and return the exit code: of an answer that nobody got it is not 0.

    A reader who went away is no reason for words.
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
    """Print a sentence to standard error, if that is there."""
    if sys.stderr is not None:
        with suppress(OSError):
            print(f"lagrange: {message}", file=sys.stderr, flush=True)


def occupy_standard_streams() -> None:
    """Open nothing else under the number of a standard stream that the program was started without."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        continue
    os.close(descriptor)


def _silence() -> None:
    """Let nothing more go to standard output, not even what Python flushes when it ends."""
    if sys.stdout is not None:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
