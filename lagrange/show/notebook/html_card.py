"""Write tables, sentences and pictures of results as HTML of limited length, in the colours of the notebook."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING

from lagrange.errors import StatementError, counted
from lagrange.show.files.picture import SCREEN_DPI, bounded_png
from lagrange.show.notation.text import plain_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_TABLE = 12_000  # Longest table in a notebook, in characters: some hundred rows
MOST_TEXT = 600  # Longest sentence or table entry in a notebook, in characters; print() shows the whole text
MOST_SENTENCES = 8  # Largest number of sentences about one result in a notebook
_LEFT = "style='text-align:left'"


def text(words: str) -> str:
    """Return the text `words` escaped for HTML, and cut off after `MOST_TEXT` characters."""
    line = plain_text(words)
    return escape(line if len(line) <= MOST_TEXT else line[:MOST_TEXT] + " ...")


def pairs(heading: str, rows: Sequence[tuple[str, str]]) -> str:
    """Return an HTML table of rows (label, text) under a heading."""
    body = "".join(f"<tr><th {_LEFT}>{text(name)}</th><td {_LEFT}>{text(value)}</td></tr>" for name, value in rows)
    return f"<table><caption {_LEFT}><b>{text(heading)}</b></caption>{body}</table>"


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return an HTML table of at most `MOST_TABLE` characters, with `headings` above its columns.

    Rows for which there is no room are left out, and a sentence gives their number.
    """
    head = "".join(f"<th {_LEFT}>{text(name)}</th>" for name in headings)
    body, shown = "", 0
    for row in rows:
        line = "<tr>" + "".join(f"<td {_LEFT}>{text(cell)}</td>" for cell in row) + "</tr>"
        if len(body) + len(line) > MOST_TABLE:
            break
        body += line
        shown += 1
    rest = "" if shown == len(rows) else f"<p>{counted(len(rows) - shown, 'more row')}: print() shows all.</p>"
    return f"<table><tr>{head}</tr>{body}</table>{rest}"


def folded(summary: str, inside: str) -> str:
    """Return HTML that shows the line `summary`, under which the HTML `inside` is folded."""
    return f"<details><summary>{text(summary)}</summary>{inside}</details>"


def sentences(lines: Sequence[str]) -> str:
    """Return an HTML paragraph for each of the sentences `lines`.

    After `MOST_SENTENCES` paragraphs, a last one gives the number of the other sentences.
    """
    shown = "".join(f"<p>{text(line)}</p>" for line in lines[:MOST_SENTENCES])
    more = len(lines) - MOST_SENTENCES
    return shown + (f"<p>{counted(more, 'more remark')}: print() shows all.</p>" if more > 0 else "")


def image(figure: Figure, about: str) -> str:
    """Return a figure as HTML with an embedded picture; `about` is its alternative text."""
    data = b64encode(bounded_png(figure, 2 * SCREEN_DPI)).decode("ascii")
    width = round(SCREEN_DPI * figure.get_size_inches()[0])
    source = f"data:image/png;base64,{data}"
    return f"<img src='{source}' width='{width}' style='max-width:100%;height:auto' alt='{text(about)}'>"


def pictured(card: str, draw: Callable[[], Figure], about: str) -> str:
    """Return `card`, a text in HTML, followed by the figure that `draw` returns.

    If `draw` raises StatementError, its message replaces the figure. `about` says what the figure shows, for its
    alternative text.
    """
    try:
        return card + image(draw(), f"plot of {about}")
    except StatementError as nothing_to_draw:
        return card + sentences([str(nothing_to_draw)])
