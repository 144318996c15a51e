"""Write notebook pages of limited length as Markdown with LaTeX formulas, with long parts folded.

JupyterLab, VS Code, Colab, nbviewer and nbconvert all render formulas in Markdown. VS Code does not render formulas in
HTML, and JupyterLab removes MathML from notebooks that are not trusted. LaTeX also takes a fifth of the space of
MathML.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any

from sympy import Float

from lagrange.errors import UnknownKey, counted, listing, shown
from lagrange.show.derivation_page import MarkdownPage
from lagrange.show.notation.line_breaks import SideWriter
from lagrange.show.notation.sections import Formula
from lagrange.show.notation.text import Notation, markdown_text, plain_text
from lagrange.show.notebook.html_card import table
from lagrange.statement.coordinate import name_of
from lagrange.statement.expression import MOST_WORDS
from lagrange.statement.scene.library import library
from lagrange.statement.statement import Statement

MOST_CHARACTERS = 20_000
"""Longest page in a notebook, in characters without pictures: the page of a double pendulum takes 2,000."""
MOST_SHOWN_OPERATIONS = 600
"""Largest number of operations of an expression that a notebook shows, or from which it derives equations. More would
take over a second. All scenes of the library have fewer."""
LONG = 12  # Largest number of lines of formulas, or entries of a list, that is shown unfolded
NEXT_LINE = r" \\ "  # Separator of the lines of a formula
Part = tuple[str, str]  # Name of a part of a page, and its text


def joined(parts: Iterable[Part], instead: str, most: int = MOST_CHARACTERS) -> str:
    """Return a page of at most `most` characters from `parts`, pairs of name and text.

    A sentence that ends with `instead` replaces a part that does not fit. The page ends with this sentence if the space
    is almost used up.
    """
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
    """Return the Markdown sentence that replaces the part `name` of a page.

    `why` is the reason why the part is missing, and `instead` says in Markdown where to find it.
    """
    return f"*{markdown_text(name)}: not shown here, {markdown_text(why)}; {instead}*"


def folded(summary: str, inside: str) -> str:
    """Return Markdown that shows the line `summary`, under which the Markdown `inside` is folded."""
    return f"<details><summary>{escape(plain_text(summary))}</summary>\n\n{inside}\n\n</details>"


def bold(words: str) -> str:
    """Return Markdown of the text `words` in bold, with special characters escaped."""
    return f"**{markdown_text(words)}**"


def operations(statement: Statement) -> int:
    """Return the number of operations in the expressions from which the equations of motion are derived."""
    stated = [statement.lagrangian, statement.dissipation, *statement.forces]
    return sum(
        int(expression.count_ops())
        for expression in (*stated, *(constraint.expression for constraint in statement.constraints))
    )


def _plain(latex: str) -> str:
    """Return LaTeX with a command in place of <, because some Markdown renderers read < as the start of an HTML tag."""
    return latex.replace("<", r"\lt ")


class PageWriter:
    """Writes the parts of a notebook page as Markdown, with LaTeX formulas in the symbols of one statement."""

    def __init__(self, statement: Statement) -> None:
        self.statement = statement
        self._page = MarkdownPage(statement)

    def inline(self, side: Any) -> str:
        """Return the expression or number `side` as LaTeX for use within a line of text."""
        return f"${self.side(side)}$"

    def side(self, side: Any) -> str:
        """Return the LaTeX of one side of an equation: an expression or a number with six digits."""
        return _plain(self._page.lines.sides.side(Float(f"{side:.6g}") if isinstance(side, float) else side))

    def condition(self, condition: Any) -> str:
        """Return the LaTeX of a condition on parameters, such as m1 > m2."""
        return _plain(self._page.lines.setter.condition(condition))

    def values(self, values: Mapping[Any, Any], units: Mapping[Any, str] | None = None) -> str:
        """Return symbols with their values, and with their `units` if stated, as text such as m = 2 kg, l = 1 m."""
        stated_units = units or {}
        parts = []
        for symbol, value in values.items():
            if value is None:
                parts.append(f"{self.inline(symbol)} without a value")
            else:
                unit = f" {markdown_text(stated_units[symbol])}" if stated_units.get(symbol) else ""
                parts.append(f"${self.side(symbol)} = {self.side(value)}${unit}")
        return ", ".join(parts)

    def formulas(self, formulas: Sequence[Formula]) -> str:
        """Return formulas as a block of LaTeX in Markdown; several formulas are on separate lines and aligned."""
        return f"$$\n{_plain(self._page.formula(*formulas))}\n$$"

    def short(self, formula: Formula, name: str, instead: str) -> str:
        """Return a formula as LaTeX in Markdown, or a sentence if the formula has too many operations.

        The sentence begins with `name`, the name of the formula, and ends with `instead`, which says where to find it.
        """
        if formula.operations > MOST_SHOWN_OPERATIONS:
            return left_out(name, f"it has {formula.operations} operations", instead)
        return self.formulas([formula])

    def rows(self, rows: Sequence[Formula | str]) -> tuple[str, int]:
        """Return the formulas and sentences `rows` on separate lines as Markdown, and the number of these lines."""
        together = groupby(rows, key=lambda row: isinstance(row, str))
        texts = [
            "\n\n".join(map(markdown_text, map(str, group)))
            if words
            else self.formulas([row for row in group if isinstance(row, Formula)])
            for words, group in together
        ]
        return "\n\n".join(texts), sum(text.count(NEXT_LINE) + 1 for text in texts)

    def equations(self, heading: str, laws: Sequence[Any]) -> str:
        """Return Markdown: a heading, and the SymPy equations `laws` under it, folded if they are long."""
        return self.under(heading, [Formula((law.lhs, law.rhs)) for law in laws])

    def under(self, heading: str, formulas: Sequence[Formula]) -> str:
        """Return Markdown: a heading, and formulas under it, folded if they are long."""
        text = self.formulas(formulas)
        lines = text.count(NEXT_LINE) + 1
        if lines > LONG:
            return folded(f"{heading} ({counted(lines, 'line')})", text)
        return f"{bold(heading)}\n\n{text}"


def listed(heading: str, text: str, count: int) -> str:
    """Return a heading followed by `text`, a list of `count` entries; the list is folded if it is long."""
    return folded(f"{heading} ({count})", text) if count > LONG else f"{bold(heading)}  {text}"


class EquationList(list[Any]):
    """A list of SymPy equations; a notebook shows it as formulas in the symbols of a statement."""

    def __init__(self, equations: Iterable[Any], statement: Statement) -> None:
        super().__init__(equations)
        self.statement = statement

    def __reduce__(self) -> tuple[Any, ...]:
        return EquationList, (list(self), self.statement)

    def _repr_markdown_(self) -> str:
        return _formulas(((f"entry {k}", law.lhs, law.rhs) for k, law in enumerate(self)), self.statement)


class ExpressionDict(dict[Any, Any]):
    """A dict from coordinates to SymPy expressions; a notebook shows it as formulas.

    `shown` maps a coordinate to the left side of its formula, such as the acceleration of the coordinate.
    """

    def __init__(self, expressions: Mapping[Any, Any], statement: Statement, shown: Mapping[Any, Any]) -> None:
        super().__init__(expressions)
        self.statement, self.shown = statement, dict(shown)

    def __reduce__(self) -> tuple[Any, ...]:
        return ExpressionDict, (dict(self), self.statement, self.shown)

    def __missing__(self, key: Any) -> Any:
        raise UnknownKey(
            f"{shown(key)} is not a coordinate of this system: the keys are the coordinates "
            f"{listing(map(name_of, self), MOST_WORDS)} themselves, not their names."
        )

    def _repr_markdown_(self) -> str:
        rows = ((f"that of {key}", self.shown.get(key, key), value) for key, value in self.items())
        return _formulas(rows, self.statement)


class ExpressionTuple(tuple[Any, ...]):
    """A tuple of SymPy expressions in the symbols of `statement`, which prints in the spelling of scene files."""

    statement: Statement

    def __new__(cls, expressions: Iterable[Any], statement: Statement) -> ExpressionTuple:
        """Return a tuple of the expressions that also stores the statement, whose symbols the expressions contain."""
        entries = super().__new__(cls, expressions)
        entries.statement = statement
        return entries

    def __reduce__(self) -> tuple[Any, ...]:
        return ExpressionTuple, (tuple(self), self.statement)

    def written(self) -> list[str]:
        """Return the text of each expression, in the spelling of scene files."""
        return list(map(SideWriter(self.statement, Notation).setter.write, self))

    def __repr__(self) -> str:
        return f"({', '.join(self.written())}{',' * (len(self) == 1)})"


class SceneList(list[str]):
    """A list of the names of scenes; a notebook shows it with descriptions."""

    def __init__(self, names: Iterable[str], about: Iterable[str] = ()) -> None:
        super().__init__(names)
        self.about = tuple(about)

    def _repr_html_(self) -> str:
        return table(("scene", "about"), list(zip(self, self.about, strict=False)))


def scenes() -> list[str]:
    """Return the names of the scenes in the library."""
    entries = library()
    return SceneList((entry.name for entry in entries), (entry.about for entry in entries))


def _formulas(rows: Iterable[tuple[str, Any, Any]], statement: Statement) -> str:
    """Return the Markdown page of some formulas; `rows` has for each its name, its left side and its right side."""
    writer = PageWriter(statement)
    instead = "`print(...)` has it."
    return joined(((name, writer.short(Formula(tuple(sides)), name, instead)) for name, *sides in rows), instead)
