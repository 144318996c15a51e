"""A progress bar on a terminal and in a notebook, and silence in a pipe."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from lagrange.errors import counted
from lagrange.show.notebook.progress_display import LineDisplay, in_notebook, notebook_bar

SILENT_SECONDS = 2.0
"""Seconds before a line says that something is being compiled."""


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
def progress_bar(span: Sequence[float], *, wanted: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield a function to call with the time reached, or None where no bar is wanted or nobody would see it."""
    with _bar(span, "t = {:.6g}".format, wanted=wanted) as report:
        yield report


@contextmanager
def counter(total: int, noun: str, *, wanted: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield a function to call with how many of so many are done, or None, as `progress_bar` does."""
    with _bar((0.0, float(total)), lambda done: f"{done:.0f} of {counted(total, noun)}", wanted=wanted) as report:
        yield report


@contextmanager
def members_bar(members: int, *, wanted: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield a function to call with the number of members that are done; the bar has their rate and the time left."""
    began = time.perf_counter()

    def describe(done: float) -> str:
        rate = done / max(time.perf_counter() - began, 1e-9)
        left = (members - done) / rate if rate else 0.0
        return f"{done:,.0f} of {members:,} members, {rate:,.0f} a second, {left:.0f} s left"

    with _bar((0.0, float(members)), describe, wanted=wanted) as report:
        yield report


@contextmanager
def _bar(
    span: Sequence[float], describe: Callable[[float], str], *, wanted: bool
) -> Iterator[Callable[[float], None] | None]:
    """Yield a function to call with how far it is in the span, for a bar where there is somebody to see it."""
    start, end = float(span[0]), float(span[1])
    if wanted and in_notebook():
        forward = 1.0 if end >= start else -1.0
        with notebook_bar(abs(end - start), lambda done: describe(start + forward * done)) as update:
            yield lambda t: update(abs(t - start))
        return
    if not wanted or not _on_a_terminal():
        yield None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn  # 50 ms, for nothing in a pipe

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, transient=True) as progress:
        task = progress.add_task("compiling", total=abs(end - start) or 1.0)
        yield lambda t: progress.update(task, completed=abs(t - start), description=describe(t))
