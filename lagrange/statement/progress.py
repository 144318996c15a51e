"""A progress bar on a terminal and in a notebook; silence in a pipe, or lines where these are asked for."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any

from lagrange.statement.number import flag, one_of

SILENT_SECONDS = 2.0
"""Seconds before a line says that something is being compiled or derived."""

LINES = "lines"
"""Value of `progress` for lines instead of a bar where there is no terminal, as in a log file."""

SECONDS_OF_A_LINE = 10.0
"""Least time between two such lines, in seconds."""

SECONDS_BETWEEN = 0.1
"""Least time between two updates in a notebook, in seconds: each is a message to the browser."""

Report = Callable[[float], None]
"""Progress callback: time reached, or number of finished items."""


def wanted_progress(given: Any) -> bool | str:
    """Return the checked option `progress`: True, False or "lines". Raises StatementError for other values."""
    if isinstance(given, str):
        return one_of(given, (LINES,), "progress = {given}: give True, False or {known}.")
    return flag(given, "progress")


def compiling(name: str, *, wanted: bool) -> AbstractContextManager[None]:
    """Show on a terminal or in a notebook that `name` is being compiled, once that takes more than `SILENT_SECONDS`."""
    return _announced(f"compiling {name}", f"compiled {name}", wanted=wanted)


def deriving(name: str) -> AbstractContextManager[None]:
    """Show on a terminal or in a notebook that formulas of `name` are being derived, as `compiling` does."""
    return _announced(f"deriving {name}", f"derived {name}", wanted=True)


@contextmanager
def _announced(*words: str, wanted: bool) -> Iterator[None]:
    """Show the first words after `SILENT_SECONDS` of work; in a notebook the second words replace them at the end."""
    notebook = wanted and in_notebook()
    if not notebook and not (wanted and _on_a_terminal()):
        yield
        return
    done = threading.Event()
    tell = _tell_notebook if notebook else _tell
    teller = threading.Thread(target=tell, args=(words, done, time.perf_counter()), daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()


def _tell(words: tuple[str, ...], done: threading.Event, began: float) -> None:
    """Rewrite one line on the terminal each second until the work is done, then erase it."""
    line = ""
    pause = SILENT_SECONDS
    while not done.wait(pause):
        line = f"{words[0]}: {time.perf_counter() - began:.0f} s"
        sys.stderr.write(f"\r{line}")
        sys.stderr.flush()
        pause = 1.0
    if line:
        sys.stderr.write(f"\r{' ' * len(line)}\r")
        sys.stderr.flush()


def _tell_notebook(words: tuple[str, ...], done: threading.Event, began: float) -> None:
    """Rewrite one line of the notebook each second until the work is done; it stays, with the time taken."""
    line: LineDisplay | None = None
    pause = SILENT_SECONDS
    while not done.wait(pause):
        line = line or LineDisplay()
        line.write(f"{words[0]}: {time.perf_counter() - began:.0f} s")
        pause = 1.0
    if line is not None:
        line.write(f"{words[1]} in {time.perf_counter() - began:.1f} s")


def _on_a_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def progress_bar(span: Sequence[float], *, wanted: bool) -> Iterator[Report | None]:
    """Yield a callback for the time reached, or None if not `wanted`, or without a terminal or a notebook."""
    with _bar(span, "t = {:.6g}".format, wanted=wanted, stays=False) as report:
        yield report


@contextmanager
def counter(total: int, noun: str, *, wanted: bool | str, before: int = 0) -> Iterator[Report | None]:
    """Yield a callback for the number of finished items out of `total`, or None, as `progress_bar` does.

    The bar shows the rate and the remaining time, from the items finished since the start; `before` items were
    finished before. The last line stays. With `LINES`, lines are written without a terminal or a notebook.
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
    """Return a rate, in items a second, as text: a second, or a minute for slow ones."""
    number, unit = (rate, "second") if rate >= 1.0 else (60.0 * rate, "minute")
    return f"{number:,.0f} a {unit}" if number >= 10.0 else f"{number:.2g} a {unit}"


def _rounded_time(seconds: float) -> str:
    """Return a duration as text with about two digits, in seconds, minutes, hours or days."""
    for limit, unit, name in ((100.0, 1.0, "s"), (6000.0, 60.0, "min"), (360_000.0, 3600.0, "h")):
        if seconds < limit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds / 86400.0:,.0f} days"


@contextmanager
def _bar(
    span: Sequence[float], describe: Callable[[float], str], *, wanted: bool | str, stays: bool
) -> Iterator[Report | None]:
    """Yield a callback for the position in the span, which updates a bar, or None if no bar is shown."""
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
    """Yield a callback that writes a line to standard error every `SECONDS_OF_A_LINE`, and one at the end."""
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
    """Return True if this code runs in the kernel of a notebook. The test does not import IPython."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    shell = get_ipython()
    return shell is not None and shell.has_trait("kernel")


@dataclass(frozen=True)
class ProgressDisplay:
    """A bar followed by a text, as HTML, or as plain text where HTML is not shown."""

    share: float
    text: str

    def __repr__(self) -> str:
        return f"{self.share:4.0%}  {self.text}"

    def _repr_html_(self) -> str:
        bar = f"<progress value='{self.share:.3f}' max='1' style='width:16em;vertical-align:middle'></progress>"
        return f"{bar} {escape(self.text)}"


@contextmanager
def notebook_bar(total: float, describe: Callable[[float], str]) -> Iterator[Callable[[float], None]]:
    """Yield a callback for the finished amount of `total`; `describe` returns the text for an amount.

    The last bar stays in the output with the time taken; it is not full if the work ended early.
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
    """One line in the output of a notebook cell that can be rewritten."""

    def __init__(self) -> None:
        self._handle: Any = None

    def write(self, text: str) -> None:
        """Replace the text of the line."""
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
