"""The result of `system.derivation()`, which prints itself in every format, and the notebook page of a system."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.equations.derivation import Derivation
from lagrange.equations.textbook_algebra import TextbookAlgebra
from lagrange.errors import StatementError, counted
from lagrange.show.derivation_page import LEFT_OUT, PAGES, Heading
from lagrange.show.notation.sections import Formula, Section, ShownQuantity, sections, stated_formulas
from lagrange.show.notation.text import markdown_text, plain_text
from lagrange.show.notebook.page_writer import (
    LONG,
    MOST_SHOWN_OPERATIONS,
    PageWriter,
    Part,
    bold,
    folded,
    joined,
    left_out,
    listed,
    operations,
)
from lagrange.statement.coordinate import name_of
from lagrange.statement.display import DETAILS, FORMATS, announced, terminal_style
from lagrange.statement.expression import one_of, text
from lagrange.statement.statement import Statement, unit_of

SYSTEM_INSTEAD = "`print(system.derivation())` has it as text, `system.equations()` and the like as SymPy expressions."


def system_page(derivation: Derivation, findings: Sequence[str]) -> str:
    """Return the Markdown page of a system for a notebook, from the `derivation` of its equations.

    `findings` are sentences about the structure and the conserved quantities of the system.
    """
    return joined(_system_parts(derivation, findings), SYSTEM_INSTEAD)


def _system_parts(derivation: Derivation, findings: Sequence[str]) -> Iterator[Part]:
    statement = derivation.statement
    writer = PageWriter(statement)
    count = len(statement.coordinates)
    head = f"{bold(statement.name)}: {counted(count, 'coordinate')}"
    names = " " + ", ".join(map(writer.inline, statement.coordinates)) if count <= NAMED_COORDINATES else ""
    yield "the coordinates", f"{head}{names}" + (f". {markdown_text(statement.about)}" if statement.about else "")
    yield from _statement_parts(statement, writer)
    yield "the parameters", _parameters(statement, writer)
    symbols = (*statement.coordinates, *statement.velocities)
    values = {symbol: value for symbol, value in zip(symbols, statement.initial, strict=True) if value}
    units = {symbol: unit_of(statement, name) for symbol, name in zip(symbols, statement.state_names, strict=True)}
    rest = "" if len(values) == len(symbols) else "all else 0" if values else "all 0"
    yield (
        "the initial state",
        listed("Initial state", ", ".join(filter(None, (writer.values(values, units), rest))), len(values)),
    )
    yield "the equations of motion", _equations(derivation, writer)
    yield "the structure", f"{bold('Structure')}\n\n" + "\n".join(f"- {markdown_text(finding)}" for finding in findings)


NAMED_COORDINATES = 12  # Largest number of coordinates that are named; more are only counted


def _statement_parts(statement: Statement, writer: PageWriter) -> Iterator[Part]:
    """Yield the stated energies, forces, known functions of time and constraints as parts of a page.

    Short formulas are lines of one block. A sentence replaces a long formula.
    """
    rows = list(stated_formulas(statement))
    formulas = [row for row in rows if isinstance(row, Formula)]
    short = [formula for formula in formulas if formula.operations <= MOST_SHOWN_OPERATIONS]
    if short:
        yield "the energies, forces and constraints", writer.under("Stated", short)
    for formula in formulas:
        if formula not in short:
            name = formula.sides[0]
            spelled = " ".join((name.letter, *name.indices)) if isinstance(name, ShownQuantity) else str(name)
            yield "", writer.short(formula, spelled, SYSTEM_INSTEAD)
    yield from (("a given motion", markdown_text(row)) for row in rows if isinstance(row, str))


def _parameters(statement: Statement, writer: PageWriter) -> str:
    if not statement.parameters:
        return ""
    values = {symbol: statement.defaults.get(symbol) for symbol in statement.parameters}
    units = {symbol: unit_of(statement, symbol.name) for symbol in statement.parameters}
    return listed("Parameters", writer.values(values, units), len(values))


def _equations(derivation: Derivation, writer: PageWriter) -> str:
    statement = derivation.statement
    name = "the equations of motion"
    if (size := operations(statement)) > MOST_SHOWN_OPERATIONS:
        return left_out(name, f"they are derived from {size} operations, which takes long", SYSTEM_INSTEAD)
    try:
        return writer.equations("Equations of motion", (*derivation.equations, *derivation.constraints))
    except StatementError as refusal:
        return left_out(name, str(refusal), SYSTEM_INSTEAD)


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
        """Return the derivation as plain ASCII, in the spelling of scene files."""
        return self.written("text")

    def unicode(self) -> str:
        """Return the derivation as text with Greek letters, dots and superscripts."""
        return self.written("unicode")

    def markdown(self) -> str:
        """Return the derivation as Markdown, with formulas between dollar signs."""
        return self.written("markdown")

    def html(self) -> str:
        """Return the derivation as a page for a browser, with formulas in MathML; its sections fold."""
        return self.written("html")

    def latex(self, *, title: str = "", author: str = "", date: str = "", problem: str = "") -> str:
        """Return the derivation as a document for pdflatex, with a title, an author, a date and a problem above it.

        The default title is the name of the system. Empty texts are left out.
        """
        return self.written("latex", title=title, author=author, date=date, problem=problem)

    def written(self, style: str | None = None, **above: str) -> str:
        """Return the derivation in a style: "text", "unicode", "latex", "markdown" or "html".

        The default style is "unicode" if standard output is a terminal that supports it, else "text". `above` are the
        texts above the derivation: title, author, date and problem. A part that is too large is replaced by a sentence
        that says so. Raises StatementError for another style.
        """
        heading = Heading(**{field: text(value, field) for field, value in above.items()})
        chosen = terminal_style() if style is None else style
        one_of(chosen, FORMATS, "{given} is not a format of a derivation; they are {known}.")
        with announced("deriving", self.statement.name):
            page: str = PAGES[chosen](self.statement, heading).write([*self._sections(), *self._remarks()])
            return page

    def _sections(self) -> Iterator[Section]:
        """Yield the sections that the level of detail `detail` includes, without the remarks."""
        return (section for section in sections(self) if section.heading not in LEFT_OUT[self.detail])

    def _remarks(self) -> list[Section]:
        """Return a list with the section of the remarks; empty if there are none."""
        return [Section("Remarks", self.remarks)] if self.remarks else []

    def __str__(self) -> str:
        return self.written()

    def __repr__(self) -> str:
        return f"<Derivation of {plain_text(self.statement.name)}: print it, or .latex()>"

    def __reduce__(self) -> tuple[Any, ...]:
        return written_derivation, (self.statement, self.remarks, self.detail)

    def _repr_markdown_(self) -> str:
        with announced("deriving", self.statement.name):
            return joined(self._parts(), INSTEAD)

    def _parts(self) -> Iterator[Part]:
        """Yield the parts of the page in a notebook: name, sections and remarks."""
        writer = PageWriter(self.statement)
        yield "the name", bold(self.statement.name)
        if (size := operations(self.statement)) > MOST_SHOWN_OPERATIONS:
            yield "", left_out("The derivation", f"it starts from {size} operations, which takes long", INSTEAD)
        else:
            yield from ((section.heading, _section(section, writer)) for section in self._sections())
        yield from (("the remarks", _section(section, writer)) for section in self._remarks())


def written_derivation(statement: Statement, remarks: tuple[str, ...] = (), detail: str = "full") -> ShownDerivation:
    """Return the derivation of a statement as an object that prints itself.

    `remarks` are sentences on it; `detail` is "full" or "short". Raises StatementError for any other detail.
    """
    return ShownDerivation(statement, TextbookAlgebra(statement), remarks, detail)


def _section(section: Section, writer: PageWriter) -> str:
    shown, lines = writer.rows(section.rows)
    if section.heading in OPEN and lines <= LONG:
        return f"{bold(section.heading)}\n\n{shown}"
    symbol = "" if section.symbol is None else f" {name_of(section.symbol)}"
    return folded(f"{section.heading}{symbol}", shown)
