"""The signals that ask a program to end: SIGINT, which is Ctrl-C, SIGTERM and SIGHUP.

Python raises KeyboardInterrupt wherever a signal finds it. Raised inside an import or a finalizer it is lost or becomes
another error. So such a signal is noted, and comes again until it finds other code.

Few modules are imported here: until they are there, Ctrl-C prints a traceback.
"""

from __future__ import annotations

import _thread
import signal
import sys
import time

from lagrange.cli.streams import occupy_standard_streams

TYPE_CHECKING = False

if TYPE_CHECKING:
    from types import FrameType
    from typing import Any

SENTENCE = "interrupted; no file was left half written."

INTERVAL = 0.01
"""Seconds after which a signal that could not be raised comes again."""

_IMPORTING = "<frozen importlib"


class Signalled(KeyboardInterrupt):
    """A signal asked the program to end.

    It is a class of its own, since Python remembers a plain KeyboardInterrupt that ended code given as text, such as
    that of a named tuple, and kills the process with SIGINT in the end, caught or not.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.code = 128 + number


class Interruption:
    """The handler of the signals, for a program that ends with the first of them. Library code knows nothing of it."""

    def __init__(self) -> None:
        self.number: int | None = None

    @property
    def code(self) -> int:
        """The exit code that tells which signal ended the program."""
        return 128 + (self.number or 0)

    def listen(self) -> None:
        """Handle the signals from now on, but for those that the program was started to ignore."""
        for number in self._numbers():
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self.handle)
        sys.unraisablehook = self._lost
        occupy_standard_streams()

    def close(self) -> None:
        """Raise no more: the program ends by itself. Its last milliseconds are those of the interpreter."""
        for number in self._numbers():
            signal.signal(number, signal.SIG_IGN)

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Raise `Signalled`, or note a signal that comes during an import."""
        self.number = self.number or number
        if _importing(frame):
            self._come_again()
        else:
            raise Signalled(self.number)

    @staticmethod
    def _numbers() -> list[signal.Signals]:
        names = signal.Signals.__members__
        return [names[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if name in names]

    def _come_again(self) -> None:
        """Let the signal come to the main thread, which is the one here, once more after `INTERVAL`."""
        number, main_thread = self.number or signal.SIGINT, _thread.get_ident()

        def wait() -> None:
            time.sleep(INTERVAL)
            if sys.platform == "win32":
                _thread.interrupt_main(number)
            else:
                signal.pthread_kill(main_thread, number)  # ends a wait of the main thread too

        _thread.start_new_thread(wait, ())

    def _lost(self, unraisable: Any) -> None:
        """Let a signal that was raised where nothing can be raised come again; see `sys.unraisablehook`.

        Other complaints of finalizers, while the program is interrupted, come from objects that were half made.
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
