"""A progress bar on a terminal, and silence in a pipe."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

SILENT_SECONDS = 2.0
"""Seconds before a line says that something is being compiled."""


@contextmanager
def compiling(name: str, *, wanted: bool) -> Iterator[None]:
    """Say on a terminal what is being compiled, and for how long, where that takes more than `SILENT_SECONDS`."""
    if not wanted or not _on_a_terminal():
        yield
        return
    done = threading.Event()
    teller = threading.Thread(target=_tell, args=(name, done, time.perf_counter()), daemon=True)
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


def _on_a_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def progress_bar(span: Sequence[float], *, wanted: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield a function to call with the time reached, or None where no bar is wanted or nobody would see it."""
    if not wanted or not _on_a_terminal():
        yield None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn  # 50 ms, for nothing in a pipe

    start, end = float(span[0]), float(span[1])
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, transient=True) as progress:
        task = progress.add_task("compiling", total=abs(end - start) or 1.0)
        yield lambda t: progress.update(task, completed=abs(t - start), description=f"t = {t:.6g}")
