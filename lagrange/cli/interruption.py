"""End the command line cleanly: on SIGINT (Ctrl-C), SIGTERM and SIGHUP, and if standard output is closed.

Python raises KeyboardInterrupt in whatever code runs when a signal arrives. Inside an import or a finalizer the
exception is lost or becomes another error. So a signal that arrives there is stored, and sent again later.

This module imports few others, because Ctrl-C prints a traceback until the handlers are installed. An interrupted run
keeps its steps: see `lagrange/trajectory/run_loop.py`.
"""

from __future__ import annotations

import _thread
import errno
import os
import signal
import sys
import time
from contextlib import suppress

UNWRITTEN, UNREAD = 1, 141
"""Exit codes: for output that cannot be written, and for a broken pipe, which is 128 + the number of SIGPIPE."""


def output(text: str, code: int) -> int:
    """Print a text to standard output and return the exit code.

    The exit code is `code`. If `code` is 0 and writing fails, it is `UNWRITTEN`, or `UNREAD` for a broken pipe. A
    broken pipe is not reported.
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


def _silence() -> None:
    """Discard all further standard output, including what Python flushes at exit."""
    if sys.stdout is not None:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


TYPE_CHECKING = False

if TYPE_CHECKING:
    from types import FrameType
    from typing import Any

SENTENCE = "interrupted; no file was left half written."

SIGNALS = [number for number in signal.Signals if number.name in ("SIGINT", "SIGTERM", "SIGHUP")]

INTERVAL = 0.01  # Seconds after which a signal that could not be raised is sent again

_IMPORTING = "<frozen importlib"


class Signalled(KeyboardInterrupt):
    """Exception: a signal asked the program to end.

    It is a subclass of KeyboardInterrupt, because Python treats a plain KeyboardInterrupt specially. If a plain one
    ends code that `exec` runs, such as the definition of a named tuple, Python kills the process with SIGINT at its
    end, even if the exception was caught.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.code = 128 + number


class Interruption:
    """Signal handlers for a program that ends at the first signal. Library code does not depend on them."""

    def __init__(self) -> None:
        self.number: int | None = None

    @property
    def code(self) -> int:
        """Exit code for the signal that ended the program."""
        return 128 + (self.number or 0)

    def listen(self) -> None:
        """Handle SIGINT, SIGTERM and SIGHUP from now on, except those that were ignored when the program began."""
        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self.handle)
        sys.unraisablehook = self._lost
        # The null device on closed standard streams keeps other files from getting their descriptors.
        while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
            continue
        os.close(descriptor)

    def close(self) -> None:
        """Ignore SIGINT, SIGTERM and SIGHUP from now on, because the program is ending.

        The interpreter handles signals that arrive in its last milliseconds.
        """
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Handle the signal `number`: raise `Signalled`, or during an import send the signal again later.

        `frame` is the stack frame at which the signal arrived, from which an import is recognized.
        """
        self.number = self.number or number
        if _importing(frame):
            self._come_again()
        else:
            raise Signalled(self.number)

    def _come_again(self) -> None:
        """Send the first signal again to the main thread, which must be the caller, after `INTERVAL` seconds."""
        number, main_thread = self.number or signal.SIGINT, _thread.get_ident()

        def wait() -> None:
            time.sleep(INTERVAL)
            if sys.platform == "win32":
                _thread.interrupt_main(number)
            else:
                signal.pthread_kill(main_thread, number)  # also ends a blocking call of the main thread

        _thread.start_new_thread(wait, ())

    def _lost(self, unraisable: Any) -> None:
        """Send a signal again if Python lost its exception, for example in a finalizer. It is `sys.unraisablehook`.

        `unraisable` describes the lost exception. After a signal, exceptions of other kinds are dropped, because they
        come from partly initialized objects.
        """
        if self.number is None:
            sys.__unraisablehook__(unraisable)
        elif issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._come_again()


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTING):
            return True
        frame = frame.f_back
    return False
