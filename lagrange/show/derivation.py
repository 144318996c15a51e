"""A derivation on paper: plain text, LaTeX or Markdown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lagrange.errors import StatementError
from lagrange.show.names import latex_text, letters, markdown_text, plain_text, word
from lagrange.statement.choice import one_of

if TYPE_CHECKING:
    from lagrange.equations.derivation import Derivation
    from lagrange.statement.statement import Statement

# SymPy is imported where it is needed: the command line reads FORMATS before it knows what it is asked for.

FORMATS = ("text", "latex", "markdown")


@dataclass(frozen=True)
class ShownQuantity:
    """A letter such as T or phi, with a coordinate or a constraint for its index or without."""

    letter: str
    index: str = ""


TableRow = tuple[Any, Any] | str
"""A formula, as its two sides, or a sentence. A side is a SymPy expression or a Quantity."""


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it."""

    heading: str
    rows: tuple[TableRow, ...]


def render(derivation: Derivation, style: str = "text", findings: Sequence[str] = ()) -> str:
    """Return the derivation: what was stated, L, momenta, equations of motion, accelerations and energy.

    With constraints the equations of motion have their multipliers and the constraints behind them, and the multipliers
    are solved for beside the accelerations.

    `style` is "text", where formulas are spelled as in a scene file, "latex", a complete document, or "markdown", with
    formulas between dollar signs. `findings` are sentences about the structure. A part that is too large to be written
    out is replaced by the sentence that says so. Raises StatementError for any other format.
    """
    one_of(style, FORMATS, "{given} is no format of a derivation; they are {known}.")
    page = PAGES[style](derivation.statement)
    return page.write([*_sections(derivation), *([Section("Structure", tuple(findings))] if findings else [])])


def equations_latex(derivation: Derivation) -> str:
    """Return the equations of motion, and the constraints, as one LaTeX formula, as a notebook shows them."""
    page = LatexPage(derivation.statement)
    laws = (*derivation.equations, *derivation.constraints)
    lines = [f"{page.side(law.lhs)} &= {page.side(law.rhs)}" for law in laws]
    return "$\\displaystyle \\begin{aligned} " + " \\\\ ".join(lines) + " \\end{aligned}$"


def _sections(derivation: Derivation) -> Iterator[Section]:
    statement = derivation.statement
    yield Section("Stated", tuple(_stated(statement)))
    accelerations = list(statement.plain.values())[2::3]
    known = {one.name: one.multiplier for one in statement.constraints}
    parts: tuple[tuple[str, Callable[[], list[TableRow]]], ...] = (
        ("Lagrangian", lambda: [(ShownQuantity("L"), derivation.lagrangian)]),
        (
            "Momenta",
            lambda: [
                (ShownQuantity("p", name), p)
                for name, p in zip(statement.names, derivation.momenta.values(), strict=True)
            ],
        ),
        (
            "Equations of motion",
            lambda: [(law.lhs, law.rhs) for law in (*derivation.equations, *derivation.constraints)],
        ),
        (
            "Accelerations and multipliers" if statement.constraints else "Accelerations",
            lambda: [
                *zip(accelerations, derivation.accelerations.values(), strict=True),
                *((known[name], value) for name, value in derivation.multipliers.items()),
            ],
        ),
        ("Energy", lambda: [(ShownQuantity("E"), derivation.energy)]),
    )
    for heading, part in parts:
        try:
            yield Section(heading, tuple(part()))
        except StatementError as refusal:
            yield Section(heading, (f"Not written out: {refusal}",))


def _stated(statement: Statement) -> Iterator[TableRow]:
    if statement.about:
        yield statement.about
    if statement.source:
        yield f"Source: {statement.source}"
    if statement.potential == 0 and statement.kinetic == statement.lagrangian:
        yield ShownQuantity("L"), statement.lagrangian
    else:
        yield ShownQuantity("T"), statement.kinetic
        yield ShownQuantity("V"), statement.potential
    for name, force in zip(statement.names, statement.forces, strict=True):
        if force != 0:
            yield ShownQuantity("Q", name), force
    if statement.dissipation != 0:
        yield ShownQuantity("D"), statement.dissipation
    for one in statement.constraints:
        yield ShownQuantity("phi" if one.holonomic else "psi", one.name), one.expression


class Page(ABC):
    """Writes sections in one language; formulas are spelled by a SymPy printer over plain symbols of our own."""

    def __init__(self, statement: Statement) -> None:
        self.statement = statement
        self.plain = statement.plain
        self.rank = {symbol: place % 3 for place, symbol in enumerate(self.plain.values())}
        self.printer = self.make_printer()
        given = self.printer._as_ordered_terms
        self.printer._as_ordered_terms = lambda *arguments, **options: self.in_order(given(*arguments, **options))

    @abstractmethod
    def make_printer(self) -> Any:
        """Return the SymPy printer."""

    @abstractmethod
    def write(self, sections: Sequence[Section]) -> str:
        """Return the page."""

    @abstractmethod
    def quantity(self, quantity: ShownQuantity) -> str:
        """Return the spelling of a letter with its index."""

    def side(self, side: Any) -> str:
        """Return one side of a formula."""
        if isinstance(side, ShownQuantity):
            return self.quantity(side)
        return str(self.printer.doprint(side.xreplace(self.plain)))

    def formula(self, row: tuple[Any, Any]) -> str:
        """Return a formula."""
        return f"{self.side(row[0])} = {self.side(row[1])}"

    def in_order(self, terms: list[Any]) -> list[Any]:
        """Return the terms of a sum as a book has them: accelerations first, then velocities, then the rest."""
        return sorted(
            terms, key=lambda term: -max((self.rank.get(symbol, 0) for symbol in term.free_symbols), default=0)
        )


class TextPage(Page):
    """Plain text, in the spelling of scene files: theta_dot for a velocity, theta_ddot for an acceleration."""

    def make_printer(self) -> Any:
        """Return SymPy's plain printer."""
        from sympy.printing.str import StrPrinter

        return StrPrinter()

    def quantity(self, quantity: ShownQuantity) -> str:
        """Return L, or p_theta."""
        return f"{quantity.letter}_{quantity.index}" if quantity.index else quantity.letter

    def write(self, sections: Sequence[Section]) -> str:
        """Return headings with indented rows."""
        lines = [plain_text(self.statement.name)]
        for section in sections:
            lines += ["", section.heading]
            lines += [f"    {plain_text(row) if isinstance(row, str) else self.formula(row)}" for row in section.rows]
        return "\n".join(lines) + "\n"


class LatexPage(Page):
    """A LaTeX document."""

    def make_printer(self) -> Any:
        """Return SymPy's LaTeX printer with a name of our own for every symbol."""
        from sympy import Symbol
        from sympy.printing.latex import LatexPrinter

        stated = self.statement
        held = [one.name for one in stated.constraints]
        named = [*stated.parameters, *(one.multiplier for one in stated.constraints)]
        self.letters = letters([*stated.names, *(symbol.name for symbol in named)])
        self.indices = letters(held) | self.letters
        spelled = {symbol: str(self.letters[symbol.name]) for symbol in named}
        motions = iter(self.plain.values())
        for name, position, velocity, acceleration in zip(stated.names, motions, motions, motions, strict=True):
            spelled[position] = str(self.letters[name])
            spelled[velocity] = self.letters[name].dotted(1)
            spelled[acceleration] = self.letters[name].dotted(2)
        return LatexPrinter({"symbol_names": {**spelled, Symbol("t"): "t"}})

    def quantity(self, quantity: ShownQuantity) -> str:
        """Return L, or p with an index."""
        letter = word(quantity.letter)
        return f"{letter}_{{{self.indices[quantity.index]}}}" if quantity.index else letter

    def write(self, sections: Sequence[Section]) -> str:
        """Return a document that LaTeX sets as it stands."""
        lines = [
            "\\documentclass{article}",
            "\\usepackage[T1]{fontenc}",
            "\\usepackage{amsmath}",
            "\\usepackage[margin=2cm]{geometry}",
            f"\\title{{{latex_text(self.statement.name)}}}",
            "\\date{}",
            "\\begin{document}",
            "\\maketitle",
        ]
        for section in sections:
            lines += ["", f"\\section*{{{section.heading}}}"]
            lines += [
                latex_text(row) + "\\par" if isinstance(row, str) else f"\\[ {self.formula(row)} \\]"
                for row in section.rows
            ]
        return "\n".join([*lines, "", "\\end{document}"]) + "\n"


class MarkdownPage(LatexPage):
    """Markdown with LaTeX formulas."""

    def write(self, sections: Sequence[Section]) -> str:
        """Return headings, sentences, and formulas between double dollar signs."""
        lines = [f"# {markdown_text(self.statement.name)}"]
        for section in sections:
            lines += ["", f"## {section.heading}"]
            for row in section.rows:
                lines += ["", markdown_text(row) if isinstance(row, str) else f"$$\n{self.formula(row)}\n$$"]
        return "\n".join(lines) + "\n"


PAGES: dict[str, Callable[[Statement], Page]] = {"text": TextPage, "latex": LatexPage, "markdown": MarkdownPage}
