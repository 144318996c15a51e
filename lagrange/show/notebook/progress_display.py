"""Progress in the output of a notebook's cell: one display that is updated, and stays there when it is done."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any

SECONDS_BETWEEN = 0.1
"""Least time between two updates: each is a message to the browser."""


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
