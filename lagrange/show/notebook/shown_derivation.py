"""A derivation that prints itself in every format, and that a notebook shows with rendered formulas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from lagrange.equations.derivation import Derivation
from lagrange.equations.textbook_algebra import TextbookAlgebra
from lagrange.show.derivation_page import LEFT_OUT, Heading, render
from lagrange.show.notation.sections import Section, sections
from lagrange.show.notation.symbols import plain_text
from lagrange.show.notebook.page_writer import (
    MOST_SHOWN_OPERATIONS,
    PageWriter,
    Part,
    bold,
    folded,
    joined,
    left_out,
    operations,
)
from lagrange.show.terminal import DETAILS, terminal_style
from lagrange.statement.coordinate import name_of
from lagrange.statement.expression import one_of, text
from lagrange.statement.progress import deriving
from lagrange.statement.statement import Statement

INSTEAD = "`print(system.derivation())` has it as text."
OPEN = ("Stated", "Lagrangian", "Equations of motion", "Remarks")
"""Sections that a notebook shows unfolded if they are short."""


@dataclass(frozen=True, eq=False)
class ShownDerivation(Derivation):
    """A derivation that prints itself: str() returns its text, and a notebook shows it with rendered formulas.

    `remarks` are sentences on conserved quantities and constraints. `detail` is "full" or "short".
    """

    remarks: tuple[str, ...] = ()
    detail: str = "full"

    def __post_init__(self) -> None:
        one_of(self.detail, DETAILS, "detail = {given}: choose one of {known}.")

    def text(self) -> str:
        """Return plain ASCII in the spelling of scene files."""
        return self.written("text")

    def unicode(self) -> str:
        """Return text with Greek letters, dots and superscripts."""
        return self.written("unicode")

    def markdown(self) -> str:
        """Return Markdown with formulas between dollar signs."""
        return self.written("markdown")

    def html(self) -> str:
        """Return a page for a browser, with formulas in MathML; its sections fold."""
        return self.written("html")

    def latex(self, *, title: str = "", author: str = "", date: str = "", problem: str = "") -> str:
        """Return a document for pdflatex, with these texts above the derivation.

        The default title is the name of the system.
        """
        return self.written("latex", title=title, author=author, date=date, problem=problem)

    def written(self, style: str | None = None, **above: str) -> str:
        """Return the derivation in a style: "text", "unicode", "latex", "markdown" or "html".

        The default style is "unicode" if standard output is a terminal that supports it, else "text". `above` are the
        texts above the derivation: title, author, date and problem. Raises StatementError for another style.
        """
        heading = Heading(**{field: text(value, field) for field, value in above.items()})
        chosen = terminal_style() if style is None else style
        with deriving(self.statement.name):
            return render(self, chosen, self.remarks, self.detail, heading)

    def __str__(self) -> str:
        return self.written()

    def __repr__(self) -> str:
        return f"<Derivation of {plain_text(self.statement.name)}: print it, or .latex()>"

    def __reduce__(self) -> tuple[Any, ...]:
        return written_derivation, (self.statement, self.remarks, self.detail)

    def _repr_markdown_(self) -> str:
        with deriving(self.statement.name):
            return derivation_page(self)


def written_derivation(statement: Statement, remarks: tuple[str, ...] = (), detail: str = "full") -> ShownDerivation:
    """Return the derivation of a statement as an object that prints itself.

    `remarks` are sentences on it; `detail` is "full" or "short". Raises StatementError for any other detail.
    """
    return ShownDerivation(statement, TextbookAlgebra(statement), remarks, detail)


def derivation_page(derivation: ShownDerivation) -> str:
    """Return the derivation for a notebook, section by section; sections that do not fit are replaced by a sentence."""
    return joined(_parts(derivation), INSTEAD)


def _parts(derivation: ShownDerivation) -> Iterator[Part]:
    statement = derivation.statement
    writer = PageWriter(statement)
    yield "the name", bold(statement.name)
    if (size := operations(statement)) > MOST_SHOWN_OPERATIONS:
        yield "", left_out("The derivation", f"it starts from {size} operations, which takes long", INSTEAD)
    else:
        for section in sections(derivation):
            if section.heading not in LEFT_OUT[derivation.detail]:
                yield section.heading, _section(section, writer)
    if derivation.remarks:
        yield "the remarks", _section(Section("Remarks", derivation.remarks), writer)


def _section(section: Section, writer: PageWriter) -> str:
    shown, lines = writer.rows(section.rows)
    if section.heading in OPEN and not writer.is_long(lines):
        return f"{bold(section.heading)}\n\n{shown}"
    symbol = "" if section.symbol is None else f" {name_of(section.symbol)}"
    return folded(f"{section.heading}{symbol}", shown)
