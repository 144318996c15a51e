"""A derivation with its page, and the text of a page, which a notebook shows with its formulas set."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from lagrange.equations.derivation import Derivation
from lagrange.equations.textbook_algebra import TextbookAlgebra
from lagrange.show.derivation import render
from lagrange.show.notation.names import plain_text
from lagrange.show.notation.sections import Section, sections
from lagrange.show.notebook.page_writer import (
    MOST_CHARACTERS,
    MOST_OPERATIONS,
    PageWriter,
    Part,
    bold,
    folded,
    joined,
    left_out,
    operations,
)
from lagrange.show.terminal.languages import terminal_style
from lagrange.statement.coordinate import name_of
from lagrange.statement.statement import Statement

INSTEAD = "`print(system.page())` has it as text."
OPEN = ("Stated", "Lagrangian", "Equations of motion", "Structure")
"""Sections that a notebook shows unfolded where they are short."""


class ShownDerivation(Derivation):
    """A derivation with its page: str() gives it as text, a notebook shows it, and `page(style)` has every language."""

    def page(self, style: str | None = None) -> str:
        """Return the page, without a style as the terminal reads it; see `System.page`."""
        return shown_page(self, style, ())

    def __str__(self) -> str:
        return str(self.page())

    def __repr__(self) -> str:
        return f"<Derivation of {plain_text(self.statement.name)}: print it, or .page('latex')>"

    def __reduce__(self) -> tuple[Any, ...]:
        return written_derivation, (self.statement,)

    def _repr_markdown_(self) -> str:
        return derivation_page(self, ())


def written_derivation(statement: Statement) -> ShownDerivation:
    """Return the derivation of a statement with its page."""
    return ShownDerivation(statement, TextbookAlgebra(statement))


class ShownPage(str):
    """The text of a page; a notebook shows it with its formulas set, if it has the derivation, else as it is."""

    derivation: Derivation | None = None
    findings: tuple[str, ...] = ()

    def _repr_markdown_(self) -> str | None:
        return None if self.derivation is None else derivation_page(self.derivation, self.findings)

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        rest = "" if len(self) <= MOST_CHARACTERS else f"\n... {len(self) - MOST_CHARACTERS} more characters: print it"
        printer.text(self[:MOST_CHARACTERS] + rest)


def shown_page(derivation: Derivation, style: str | None, findings: Sequence[str]) -> ShownPage:
    """Return the page of a derivation in a style, or as the terminal reads it; see `System.page`."""
    page = ShownPage(render(derivation, terminal_style() if style is None else style, findings))
    if style not in TEXTS:
        page.derivation, page.findings = derivation, tuple(findings)
    return page


TEXTS = ("text", "unicode", "latex")
"""Styles whose text is what somebody asks for who names them; of the others a notebook shows what they stand for."""


def derivation_page(derivation: Derivation, findings: Sequence[str]) -> str:
    """Return the derivation as a notebook shows it, section by section, as far as there is room."""
    return joined(_parts(derivation, findings), INSTEAD)


def _parts(derivation: Derivation, findings: Sequence[str]) -> Iterator[Part]:
    statement = derivation.statement
    writer = PageWriter(statement)
    yield "the name", bold(statement.name)
    if (size := operations(statement)) > MOST_OPERATIONS:
        yield "", left_out("The derivation", f"it starts from {size} operations, which takes long", INSTEAD)
    else:
        for section in sections(derivation):
            yield section.heading, _section(section, writer)
    if findings:
        yield "the structure", _section(Section("Structure", tuple(findings)), writer)


def _section(section: Section, writer: PageWriter) -> str:
    text, lines = writer.rows(section.rows)
    if section.heading in OPEN and not writer.is_long(lines):
        return f"{bold(section.heading)}\n\n{text}"
    symbol = "" if section.symbol is None else f" {name_of(section.symbol)}"
    return folded(f"{section.heading}{symbol}", text)
