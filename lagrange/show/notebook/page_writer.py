"""Markdown pages with formulas in LaTeX, of bounded length, whose long parts fold.

Markdown, because JupyterLab, VS Code, Colab, nbviewer and nbconvert all typeset the formulas in it. In HTML VS Code
typesets none, and JupyterLab takes MathML out of notebooks that are not trusted. LaTeX also takes a fifth of the room.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any

from sympy import Float

from lagrange.errors import counted
from lagrange.show.derivation import MarkdownPage
from lagrange.show.notation.names import markdown_text, plain_text
from lagrange.show.notation.sections import Formula
from lagrange.statement.statement import Statement

MOST_CHARACTERS = 20_000
"""Characters of a page in a notebook, pictures apart: the page of a double pendulum takes 2,000."""
MOST_OPERATIONS = 600
"""Operations of an expression that is written or derived for a notebook, which waits about a second for as many. All
scenes of the library have fewer."""
LONG = 12
"""Lines of formulas, or entries of a list, above which they are folded."""
NEXT_LINE = r" \\ "
"""What is between the lines of a formula."""

Part = tuple[str, str]
"""What a part of a page is called, and its text."""


def joined(parts: Iterable[Part], instead: str, most: int = MOST_CHARACTERS) -> str:
    """Return the parts that fit, and for each other one a sentence, with `instead`."""
    shown: list[str] = []
    room = most
    for name, text in parts:
        fits = len(text) + 2 <= room - 300
        shown.append(text if fits else left_out(name, f"it takes {len(text)} characters", instead))
        room -= len(shown[-1]) + 2
        if room < 600 and not fits:
            break
    return "\n\n".join(text for text in shown if text)


def left_out(name: str, why: str, instead: str) -> str:
    """Return the sentence that stands in place of a part; `instead` is Markdown, a sentence that says who has it."""
    return f"*{markdown_text(name)}: not shown here, {markdown_text(why)}; {instead}*"


def folded(summary: str, inside: str) -> str:
    """Return a part under a line that opens it, itself in Markdown."""
    return f"<details><summary>{escape(plain_text(summary))}</summary>\n\n{inside}\n\n</details>"


def bold(words: str) -> str:
    """Return words of ours or of the user in bold."""
    return f"**{markdown_text(words)}**"


def operations(statement: Statement) -> int:
    """Return how many operations the equations of motion are derived from."""
    stated = [statement.lagrangian, statement.dissipation, *statement.forces]
    return sum(int(one.count_ops()) for one in (*stated, *(each.expression for each in statement.constraints)))


def _plain(latex: str) -> str:
    """Return LaTeX without the mark that starts a tag: some readers of Markdown look for tags in formulas too."""
    return latex.replace("<", r"\lt ")


def _formulas(rows: Iterable[Formula | str]) -> list[Formula]:
    return [row for row in rows if isinstance(row, Formula)]


class PageWriter:
    """Writes parts of pages in the symbols of one statement."""

    def __init__(self, statement: Statement) -> None:
        self.statement = statement
        self._page = MarkdownPage(statement)

    def inline(self, side: Any) -> str:
        """Return an expression, or a number, in a line of text."""
        return f"${self.side(side)}$"

    def side(self, side: Any) -> str:
        """Return the LaTeX of an expression or a number; numbers have six digits."""
        return _plain(self._page.lines.sides.side(Float(f"{side:.6g}") if isinstance(side, float) else side))

    def condition(self, condition: Any) -> str:
        """Return the LaTeX of a condition on parameters."""
        return _plain(self._page.lines.setter.condition(condition))

    def values(self, values: Mapping[Any, Any], units: Mapping[Any, str] | None = None) -> str:
        """Return symbols with their values, as a sentence has them, with units where there are any."""
        known = units or {}
        parts = []
        for symbol, value in values.items():
            if value is None:
                parts.append(f"{self.inline(symbol)} without a value")
            else:
                unit = f" {markdown_text(known[symbol])}" if known.get(symbol) else ""
                parts.append(f"${self.side(symbol)} = {self.side(value)}${unit}")
        return ", ".join(parts)

    def formulas(self, formulas: Sequence[Formula]) -> str:
        """Return formulas below one another, aligned."""
        lines = [line for one in formulas for line in self._page.lines.formula(one)]
        if len(lines) == 1:
            return f"$$\n{_plain(self._page.in_one_line(lines[0]))}\n$$"
        return f"$$\n{_plain(self._page.aligned(lines, 'aligned'))}\n$$"

    def rows(self, rows: Sequence[Formula | str]) -> tuple[str, int]:
        """Return formulas and sentences below one another, and on how many lines."""
        together = groupby(rows, key=lambda row: isinstance(row, str))
        texts = [
            "\n\n".join(map(markdown_text, map(str, group))) if words else self.formulas(_formulas(group))
            for words, group in together
        ]
        return "\n\n".join(texts), sum(text.count(NEXT_LINE) + 1 for text in texts)

    def is_long(self, lines: int) -> bool:
        """Return whether so many lines are folded."""
        return lines > LONG

    def equations(self, heading: str, laws: Sequence[Any]) -> str:
        """Return a heading with SymPy equations below it, folded where they are long."""
        return self.under(heading, [Formula((law.lhs, law.rhs)) for law in laws])

    def under(self, heading: str, formulas: Sequence[Formula]) -> str:
        """Return formulas under a heading, folded where they are long."""
        text = self.formulas(formulas)
        lines = text.count(NEXT_LINE) + 1
        if self.is_long(lines):
            return folded(f"{heading} ({counted(lines, 'line')})", text)
        return f"{bold(heading)}\n\n{text}"


def listed(heading: str, text: str, count: int) -> str:
    """Return a heading with a list behind it, folded where it is long."""
    return folded(f"{heading} ({count})", text) if count > LONG else f"{bold(heading)}  {text}"
