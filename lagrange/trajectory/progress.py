"""A progress bar on a terminal and in a notebook; silence in a pipe, or lines where these are asked for."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any

from lagrange.statement.choice import one_of
from lagrange.statement.number import flag

SILENT_SECONDS = 2.0
"""Seconds before a line says that something is being compiled."""

LINES = "lines"
"""What `progress` may be instead of True: a line now and then where there is no terminal, as in a log file."""

SECONDS_OF_A_LINE = 10.0
"""Least time between two such lines."""

SECONDS_BETWEEN = 0.1
"""Least time between two updates: each is a message to the browser."""

Report = Callable[[float], None]
"""What is told how far it is."""


def wanted_progress(given: Any) -> bool | str:
    """Return whether progress is shown, and how. Raises StatementError for anything but a truth value or "lines"."""
    if isinstance(given, str):
        return one_of(given, (LINES,), "progress = {given}: give True, False or {known}.")
    return flag(given, "progress")


@contextmanager
def compiling(name: str, *, wanted: bool) -> Iterator[None]:
    """Say on a terminal or in a notebook what is being compiled, where that takes more than `SILENT_SECONDS`."""
    notebook = wanted and in_notebook()
    if not notebook and not (wanted and _on_a_terminal()):
        yield
        return
    done = threading.Event()
    tell = _tell_notebook if notebook else _tell
    teller = threading.Thread(target=tell, args=(name, done, time.perf_counter()), daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()


def _tell(name: str, done: threading.Event, began: float) -> None:
    """Rewrite one line each second until it is done, and take it away."""
    line = ""
    pause = SILENT_SECONDS
    while not done.wait(pause):
        line = f"compiling {name}: {time.perf_counter() - began:.0f} s"
        sys.stderr.write(f"\r{line}")
        sys.stderr.flush()
        pause = 1.0
    if line:
        sys.stderr.write(f"\r{' ' * len(line)}\r")
        sys.stderr.flush()


def _tell_notebook(name: str, done: threading.Event, began: float) -> None:
    """Rewrite one line each second until it is done; it stays in the output, with the time that it took."""
    line: LineDisplay | None = None
    pause = SILENT_SECONDS
    while not done.wait(pause):
        line = line or LineDisplay()
        line.write(f"compiling {name}: {time.perf_counter() - began:.0f} s")
        pause = 1.0
    if line is not None:
        line.write(f"compiled {name} in {time.perf_counter() - began:.1f} s")


def _on_a_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def progress_bar(span: Sequence[float], *, wanted: bool) -> Iterator[Report | None]:
    """Yield a function to call with the time reached, or None where no bar is wanted or nobody would see it."""
    with _bar(span, "t = {:.6g}".format, wanted=wanted, stays=False) as report:
        yield report


@contextmanager
def counter(total: int, noun: str, *, wanted: bool | str, before: int = 0) -> Iterator[Report | None]:
    """Yield a function to call with how many of so many are done, or None, as `progress_bar` does.

    It tells their rate and the time left, by what was done since; `before` of them were done before. The last line
    stays. With `LINES` lines are written where there is neither a terminal nor a notebook.
    """
    began = time.perf_counter()

    def describe(done: float) -> str:
        seconds = max(time.perf_counter() - began, 1e-9)
        said = f"{done:,.0f} of {total:,} {noun}{'s' * (total != 1)}"
        if done <= before:
            return said
        rate = (done - before) / seconds
        left = "" if done >= total else f", {_rounded_time((total - done) / rate)} left"
        return f"{said}, {_rate(rate)}{left}"

    with _bar((0.0, float(total)), describe, wanted=wanted, stays=True) as report:
        if report is not None:
            report(float(before))
        yield report


def _rate(rate: float) -> str:
    """Return how many are done in a second, or in a minute where they are few."""
    number, unit = (rate, "second") if rate >= 1.0 else (60.0 * rate, "minute")
    return f"{number:,.0f} a {unit}" if number >= 10.0 else f"{number:.2g} a {unit}"


def _rounded_time(seconds: float) -> str:
    """Return a time in two digits or so: seconds, minutes or hours."""
    for limit, unit, name in ((100.0, 1.0, "s"), (6000.0, 60.0, "min"), (360_000.0, 3600.0, "h")):
        if seconds < limit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds / 86400.0:,.0f} days"


@contextmanager
def _bar(
    span: Sequence[float], describe: Callable[[float], str], *, wanted: bool | str, stays: bool
) -> Iterator[Report | None]:
    """Yield a function to call with how far it is in the span, for a bar where there is somebody to see it."""
    start, end = float(span[0]), float(span[1])
    if wanted and in_notebook():
        forward = 1.0 if end >= start else -1.0
        with notebook_bar(abs(end - start), lambda done: describe(start + forward * done)) as update:
            yield lambda t: update(abs(t - start))
        return
    if not wanted or not _on_a_terminal():
        if wanted == LINES and sys.stderr is not None:
            with _lines(describe) as report:
                yield report
            return
        yield None
        return
    from rich.console import Console  # 50 ms, for nothing in a pipe
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=not stays) as progress:
        task = progress.add_task("compiling", total=abs(end - start) or 1.0)
        yield lambda t: progress.update(task, completed=abs(t - start), description=describe(t))


@contextmanager
def _lines(describe: Callable[[float], str]) -> Iterator[Report]:
    """Yield a function that writes a line to standard error now and then, and one at the end."""
    last, done = time.perf_counter(), 0.0

    def write() -> None:
        sys.stderr.write(f"{describe(done)}\n")
        sys.stderr.flush()

    def report(amount: float) -> None:
        nonlocal last, done
        done = amount
        if (now := time.perf_counter()) - last >= SECONDS_OF_A_LINE:
            last = now
            write()

    try:
        yield report
    finally:
        write()


def in_notebook() -> bool:
    """Return whether a kernel runs this, whose output a notebook shows. IPython is not imported to find out."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    shell = get_ipython()
    return shell is not None and shell.has_trait("kernel")


@dataclass(frozen=True)
class ProgressDisplay:
    """A bar with a text behind it, as HTML, and in plain text where that is not shown."""

    share: float
    text: str

    def __repr__(self) -> str:
        return f"{self.share:4.0%}  {self.text}"

    def _repr_html_(self) -> str:
        bar = f"<progress value='{self.share:.3f}' max='1' style='width:16em;vertical-align:middle'></progress>"
        return f"{bar} {escape(self.text)}"


@contextmanager
def notebook_bar(total: float, describe: Callable[[float], str]) -> Iterator[Callable[[float], None]]:
    """Yield a function to call with how much of the total is done; `describe` says it in words.

    The bar stays in the output as it was last, with the time that it took: where it ended early it is not full.
    """
    from IPython.display import display

    began = last = time.perf_counter()
    done = 0.0

    def shown() -> ProgressDisplay:
        share = min(max(done / total, 0.0), 1.0) if total > 0 else 1.0
        return ProgressDisplay(share, f"{describe(done)}, {time.perf_counter() - began:.1f} s")

    handle: Any = display(shown(), display_id=True)

    def update(amount: float) -> None:
        nonlocal last, done
        done = amount
        if (now := time.perf_counter()) - last >= SECONDS_BETWEEN:
            last = now
            handle.update(shown())

    try:
        yield update
    finally:
        handle.update(shown())


class LineDisplay:
    """One line in the output of a cell, which may be rewritten and taken away."""

    def __init__(self) -> None:
        self._handle: Any = None

    def write(self, text: str) -> None:
        """Show a text in the place of the one before."""
        from IPython.display import display

        if self._handle is None:
            self._handle = display(_Line(text), display_id=True)
        else:
            self._handle.update(_Line(text))


@dataclass(frozen=True)
class _Line:
    text: str

    def __repr__(self) -> str:
        return self.text
