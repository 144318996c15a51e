"""Output to terminals and notebooks: progress bars, aligned tables, text fitted to the width, pages of results.

Outputs that are neither a terminal nor a notebook show no progress, or lines of text on request.

A page of a result contains formulas, whose notation belongs to a later stage of the package. So that stage has a
module, `PAGES`, with the functions that write pages. This module is imported when the first page is shown.
"""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
from functools import singledispatch
from html import escape
from importlib import import_module
from typing import Any, TextIO

SILENT_SECONDS = 2.0  # Seconds of compiling or deriving after which a display reports it

LINES = "lines"
"""Value of the argument `progress` that writes a line every ten seconds if there is no terminal, as to a log file."""

Report = Callable[[float], None]  # Progress callback: time reached, or number of finished items


_announcing: ContextVar[bool] = ContextVar("announcing", default=False)
"""True inside a block that displays its work or suppresses displays. Blocks nested in it then show nothing."""


WORK = {"compiling": "compiled", "checking": "checked", "deriving": "derived", "reading": "read"}
"""Kinds of work that are announced, each with its past participle for the message at the end."""


@contextmanager
def announced(work: str, name: Any, *, enabled: bool = True) -> Iterator[None]:
    """Context manager that shows in a terminal or notebook that `work` is being done, once it takes `SILENT_SECONDS`.

    `work` is a key of `WORK`. `name` is the name of the system, if it is a text. If `enabled` is false, nothing is
    shown.
    """
    display = None if _announcing.get() else _display_of(enabled)
    outside, system = _announcing.set(True), name if isinstance(name, str) else "system"
    try:
        with nullcontext() if display is None else _timed(display, f"{work} {system}", f"{WORK[work]} {system}"):
            yield
    finally:
        _announcing.reset(outside)


@contextmanager
def _timed(display: _Terminal | _Notebook | _Log, doing: str, done: str) -> Iterator[None]:
    """Context manager that shows `doing` with the elapsed time on a display, and the text `done` at the end."""
    ended, began = threading.Event(), time.perf_counter()

    def show_elapsed() -> None:
        pause = SILENT_SECONDS
        while not ended.wait(pause):
            display.show(ProgressState(f"{doing}: {time.perf_counter() - began:.0f} s"))
            pause = 1.0

    thread = threading.Thread(target=show_elapsed, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        display.end(ProgressState(f"{done} in {time.perf_counter() - began:.1f} s"), stays=False)


@dataclass(frozen=True)
class ProgressState:
    """Present state of a progress display: a sentence, and the finished `share` of the work (0 to 1, None if unknown).

    The state is printed as text, or shown as HTML in a notebook. The share becomes a bar before the sentence.
    """

    text: str
    share: float | None = None

    def __repr__(self) -> str:
        return self.text if self.share is None else f"{self.share:4.0%}  {self.text}"

    def _repr_html_(self) -> str:
        if self.share is None:
            return escape(self.text)
        bar = f"<progress value='{self.share:.3f}' max='1' style='width:16em;vertical-align:middle'></progress>"
        return f"{bar} {escape(self.text)}"


class _Terminal:
    """Progress display on a terminal: one line of standard error that is rewritten."""

    seconds_between, timed = 0.1, True

    def __init__(self) -> None:
        self.length = 0

    def show(self, state: ProgressState) -> None:
        text = str(state)[: shutil.get_terminal_size().columns - 1]
        sys.stderr.write(f"\r{text.ljust(self.length)}")
        sys.stderr.flush()
        self.length = len(text)

    def end(self, state: ProgressState, *, stays: bool) -> None:
        """Print `state` as the last line if `stays` is true, else erase the line of the display."""
        if stays:
            self.show(state)
            sys.stderr.write("\n")
        elif self.length:
            sys.stderr.write(f"\r{' ' * self.length}\r")
        sys.stderr.flush()


class _Notebook:
    """Progress display in a notebook: an output of the cell that is rewritten. Its last state remains visible."""

    seconds_between, timed = 0.1, True

    def __init__(self) -> None:
        self.handle: Any = None

    def show(self, state: ProgressState) -> None:
        from IPython.display import display

        if self.handle is None:
            self.handle = display(state, display_id=True)
        else:
            self.handle.update(state)

    def end(self, state: ProgressState, *, stays: bool) -> None:
        del stays
        if self.handle is not None:
            self.show(state)


class _Log:
    """Progress display for a log file: lines on standard error."""

    seconds_between, timed = 10.0, False

    def show(self, state: ProgressState) -> None:
        sys.stderr.write(f"{state.text}\n")
        sys.stderr.flush()

    def end(self, state: ProgressState, *, stays: bool) -> None:
        del stays
        self.show(state)


def _display_of(enabled: bool | str) -> _Terminal | _Notebook | _Log | None:
    """Return the progress display for this process: of a notebook, a terminal or a log. None if nothing is to be shown.

    A log is used only if `enabled` is `LINES`. If `enabled` is false, the result is None.
    """
    if enabled and in_notebook():
        return _Notebook()
    if enabled and sys.stderr is not None and sys.stderr.isatty():
        return _Terminal()
    return _Log() if enabled == LINES and sys.stderr is not None else None


def progress_bar(span: Sequence[float], *, enabled: bool) -> AbstractContextManager[Report | None]:
    """Return a context manager of a callback that shows the time reached by a run in a progress bar.

    `span` is (t0, t1), the first and last time of the run. The callback is None if `enabled` is false, or without a
    terminal or a notebook.
    """
    return _bar(span, "t = {:.6g}".format, enabled=enabled, stays=False)


@contextmanager
def counter(total: int, noun: str, *, enabled: bool | str, before: int = 0) -> Iterator[Report | None]:
    """Context manager of a callback that shows in a progress bar how many of `total` items are finished.

    The callback is None if no bar is shown. The bar also has the rate and the remaining time, computed without the
    `before` items that were finished earlier. `noun` is the name of one item. The last line of the bar remains. If
    `enabled` is `LINES`, lines are written where there is no terminal or notebook.
    """
    began = time.perf_counter()

    def describe(done: float) -> str:
        seconds = max(time.perf_counter() - began, 1e-9)
        sentence = f"{done:,.0f} of {total:,} {noun}{'s' * (total != 1)}"
        if done <= before:
            return sentence
        rate = (done - before) / seconds
        left = "" if done >= total else f", {_rounded_time((total - done) / rate)} left"
        pace, unit = (rate, "second") if rate >= 1.0 else (60.0 * rate, "minute")
        return f"{sentence}, {f'{pace:,.0f}' if pace >= 10.0 else f'{pace:.2g}'} a {unit}{left}"

    with _bar((0.0, float(total)), describe, enabled=enabled, stays=True) as report:
        if report is not None:
            report(float(before))
        yield report


def _rounded_time(seconds: float) -> str:
    """Return a duration as text with about two digits, in seconds, minutes, hours or days."""
    for limit, unit, name in ((100.0, 1.0, "s"), (6000.0, 60.0, "min"), (360_000.0, 3600.0, "h")):
        if seconds < limit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds / 86400.0:,.0f} days"


@contextmanager
def _bar(
    span: Sequence[float], describe: Callable[[float], str], *, enabled: bool | str, stays: bool
) -> Iterator[Report | None]:
    """Context manager of a callback that shows a position within `span` (first, last) in a progress bar.

    `describe` returns the text of a position. If `stays` is true, the last state of the bar remains visible. `enabled`
    chooses the display as in `_display_of`. Without a display the callback is None.
    """
    display = _display_of(enabled)
    if display is None:
        yield None
        return
    began = last = time.perf_counter()
    position = start = float(span[0])
    length = float(span[1]) - start

    def state() -> ProgressState:
        seconds = f", {time.perf_counter() - began:.1f} s" if display.timed else ""
        share = min(abs((position - start) / length), 1.0) if length else 1.0
        return ProgressState(f"{describe(position)}{seconds}", share)

    def report(reached: float) -> None:
        nonlocal last, position
        position = reached
        if (now := time.perf_counter()) - last >= display.seconds_between:
            last = now
            display.show(state())

    if display.timed:
        display.show(state())
    try:
        yield report
    finally:
        display.end(state(), stays=stays)


def in_notebook() -> bool:
    """Return True if this code runs in the kernel of a notebook. IPython is not imported for the test."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    shell = get_ipython()
    return shell is not None and shell.has_trait("kernel")


def text_table(
    headings: Sequence[str], rows: Sequence[Sequence[object]], *, columns: int | None = None, right: Sequence[int] = ()
) -> str:
    """Return rows as aligned text, with a line under the `headings` unless all are empty.

    Columns of numbers, and columns whose index is in `right`, are aligned at the right. Lines have at most `columns`
    characters (None: any number). A long text in the last column continues on the next lines.
    """
    cells = [[*map(str, row)] for row in rows]
    if columns is not None and cells:
        room = columns - sum(max(map(len, column)) + 2 for column in [*zip(*cells, strict=True)][:-1])
        broken = ((row, textwrap.wrap(row[-1], max(room, 30)) or [""]) for row in cells)
        cells = [
            [*(row[:-1] if k == 0 else [""] * (len(row) - 1)), part]
            for row, parts in broken
            for k, part in enumerate(parts)
        ]
    widths = [max(map(len, column)) for column in zip(headings, *cells, strict=True)]
    flush = [j in right or all(isinstance(row[j], (int, float)) for row in rows) for j in range(len(headings))]
    padded = (
        [
            cell.rjust(width) if at_end else cell.ljust(width)
            for cell, width, at_end in zip(line, widths, flush, strict=True)
        ]
        for line in ([*headings], *cells)
    )
    lines = ["  ".join(line).rstrip() for line in padded]
    return "\n".join([lines[0], "  ".join("-" * width for width in widths), *lines[1:]] if any(headings) else lines[1:])


PAGES = "lagrange.show.notebook.result_pages"  # Module with the functions that write pages of results


@singledispatch
def notebook_page(result: Any) -> str | None:
    """Return the page of a result in Markdown. None means that its class has no page, and a notebook shows its repr."""
    del result
    return None


class ShownAsPage:
    """Base class of results that a notebook shows as a page in Markdown."""

    def _repr_markdown_(self) -> str | None:
        import_module(PAGES)
        return notebook_page(self)


def duration(seconds: float) -> str:
    """Return a time in seconds as text with three digits, in s, ms or us."""
    for limit, factor, unit in ((1e-3, 1e6, "us"), (1.0, 1e3, "ms")):
        if seconds < limit:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds:.3g} s"


LEAST_WIDTH = 40
"""Least width of a terminal, in columns, at which lines are wrapped. In narrower ones wrapped tables are unreadable."""

USUAL_WIDTH = 100  # Width of tables, in columns, where the output is not a terminal
_FIRST_COLUMN = re.compile(r"\s*\S+(?: \S+)*\s{2,}")  # Matches the first column of a table row


def fitted(text: str, stream: TextIO | None) -> str:
    """Return `text` for the output `stream`: wrapped to the width of a terminal, else unchanged, as for a file."""
    if stream is None or not stream.isatty():
        return text
    columns = shutil.get_terminal_size().columns
    return text if columns < LEAST_WIDTH else "\n".join(_broken(line, columns) for line in text.split("\n"))


def columns_of_output() -> int:
    """Return the width in columns of a terminal at standard output, or `USUAL_WIDTH`."""
    terminal = sys.stdout is not None and sys.stdout.isatty()
    return shutil.get_terminal_size().columns if terminal else USUAL_WIDTH


def _broken(line: str, columns: int) -> str:
    """Return a line of a table or text, wrapped to at most `columns` characters.

    Continued lines are indented to the second column of a table. Longer words stay whole, and a line of dashes is cut.
    """
    if len(line) <= columns:
        return line
    if not line.strip(" -"):
        return line[:columns].rstrip()
    match = _FIRST_COLUMN.match(line)
    begin = match.end() if match and match.end() <= columns // 2 else len(line) - len(line.lstrip()) + 2
    head, rest = (line[:begin], line[begin:]) if match and match.end() == begin else ("", line)
    parts = textwrap.wrap(
        rest,
        columns,
        initial_indent=" " * len(head),
        subsequent_indent=" " * begin,
        break_long_words=False,
        break_on_hyphens=False,
        drop_whitespace=True,
    )
    return "\n".join([head + parts[0][len(head) :], *parts[1:]])


DETAILS = ("full", "short")  # Levels of detail of a derivation
FORMATS = ("text", "unicode", "latex", "markdown", "html")  # Formats of a derivation
ABOVE = ("title", "author", "date", "problem")  # Texts that may precede a derivation


def terminal_style() -> str:
    """Return "unicode" if standard output is a terminal that supports Unicode, else "text", which is plain ASCII."""
    stream = sys.stdout
    if stream is None or not stream.isatty():
        return "text"
    return "unicode" if (stream.encoding or "").lower().replace("-", "").startswith("utf") else "text"
