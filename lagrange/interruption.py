"""The signals that ask a program to end: SIGINT, which is Ctrl-C, SIGTERM and SIGHUP.

Python raises KeyboardInterrupt wherever a signal finds it. In a callback of the import machinery or in a finalizer that
is printed and lost, and C code that imports makes another error of it. So a signal is noted first. It raises at once
where that is safe, else at the next line of our own code.

Few modules are imported here: until they are there, Ctrl-C prints a traceback.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import time

from lagrange.streams import occupy_standard_streams

TYPE_CHECKING = False

if TYPE_CHECKING:
    from types import FrameType
    from typing import Any

SENTENCE = "interrupted; no file was left half written."

GRACE = 0.2
"""Seconds that a second signal leaves to what is on its way out, as files that are put back."""

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
        self._over = False

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
        read, write = os.pipe()
        os.set_blocking(write, False)
        signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        _thread.start_new_thread(self._watch, (read,))

    def close(self) -> None:
        """Raise no more: the program ends by itself. Its last milliseconds are those of the interpreter."""
        self._over = True
        for number in self._numbers():
            signal.signal(number, signal.SIG_IGN)

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Note a signal and raise `Signalled`, here or at the next line of our own code."""
        if self._over:
            return
        self.number = self.number or number
        sys.settrace(None)
        if _within(frame, _importing):
            self._raise_soon(frame)
        else:
            raise Signalled(self.number)

    @staticmethod
    def _numbers() -> list[signal.Signals]:
        names = signal.Signals.__members__
        return [names[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if name in names]

    def _raise_soon(self, frame: FrameType | None) -> None:
        """Trace the frames of our own code, those that wait for others and those to come."""
        while frame is not None:
            if _ours(frame):
                frame.f_trace = self._trace
            frame = frame.f_back
        sys.settrace(lambda entered, *_: self._trace if _ours(entered) else None)

    def _trace(self, frame: FrameType, event: str, _: Any) -> Any:
        if event != "line" or self._over:
            return self._trace
        sys.settrace(None)
        raise Signalled(self.number or 0)

    def _lost(self, unraisable: Any) -> None:
        """Raise once more what was raised where nothing can be; see `sys.unraisablehook`.

        What other finalizers complain of while the program is interrupted comes from objects that were half made.
        """
        if self.number is None:
            sys.__unraisablehook__(unraisable)
        elif issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._raise_soon(sys._getframe())

    def _watch(self, pipe: int) -> None:
        """End the process with the second signal, in compiled code too, where no Python runs that could raise."""
        came = b""
        while len(came) < 2:
            came += os.read(pipe, 2)
        time.sleep(GRACE)
        while not self._over:
            if all(signal.getsignal(number) in (self.handle, signal.SIG_IGN) for number in self._numbers()):
                os._exit(128 + came[0])
            time.sleep(0.01)  # somebody holds signals back until files are in order


def _within(frame: FrameType | None, wanted: Any) -> bool:
    while frame is not None:
        if wanted(frame):
            return True
        frame = frame.f_back
    return False


def _importing(frame: FrameType) -> bool:
    return frame.f_code.co_filename.startswith(_IMPORTING)


def _ours(frame: FrameType) -> bool:
    return str(frame.f_globals.get("__name__")).startswith("lagrange.") and frame.f_globals is not globals()
