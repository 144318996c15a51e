"""A progress bar on a terminal, and silence in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager


@contextmanager
def progress_bar(span: Sequence[float], *, wanted: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield a function to call with the time reached, or None where no bar is wanted or nobody would see it."""
    if not wanted or sys.stderr is None or not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn  # 50 ms, for nothing in a pipe

    start, end = float(span[0]), float(span[1])
    columns = (TextColumn("t = {task.fields[now]:.6g}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, transient=True) as progress:
        task = progress.add_task("run", total=abs(end - start) or 1.0, now=start)
        yield lambda t: progress.update(task, completed=abs(t - start), now=t)
