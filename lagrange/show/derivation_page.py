"""Write a derivation as a document in plain text, Unicode, LaTeX, Markdown or HTML: headings, sections, sentences."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby
from typing import Any, ClassVar

from lagrange.show.notation.latex_mathml import LatexNotation, MathmlNotation
from lagrange.show.notation.line_breaks import FormulaLine, LineWriter
from lagrange.show.notation.sections import (
    Formula,
    Section,
    ShownQuantity,
)
from lagrange.show.notation.text import (
    GREEK,
    Notation,
    UnicodeNotation,
    latex_text,
    markdown_text,
    plain_text,
    width,
)
from lagrange.statement.statement import Statement

INDENT = "    "
_WORD = re.compile(r"(?<![\\\w])[A-Za-z](?:\\_|\w)*")
"""Pattern of a word in a sentence with escaped characters. Its underscores may be escaped. The name of a LaTeX command,
after a backslash, does not match."""

COMPACT = (
    "\\AtBeginDocument{\\abovedisplayskip=1pt plus 4pt \\belowdisplayskip=\\abovedisplayskip",
    "\\abovedisplayshortskip=\\abovedisplayskip \\belowdisplayshortskip=\\abovedisplayskip}",
    "\\makeatletter",
    "\\renewcommand{\\@maketitle}{\\begin{center}{\\Large\\@title\\par}\\@author\\par\\@date\\end{center}}",
    "\\renewcommand{\\section}{\\@startsection{section}{1}{0pt}{0.7ex plus 1ex}{-1em}{\\normalfont\\large\\bfseries}}",
    "\\makeatother",
)
"""LaTeX settings for little space around the title, headings and formulas: three coordinates fill one page. A heading
stands at the start of a paragraph. After a heading on its own line a formula would begin with a blank line."""

LONG_SECTION = 12  # Lines of formulas above which a section of an HTML page is folded


@dataclass(frozen=True)
class Heading:
    """Texts above a derivation that a student hands in: title, author, date and problem; each may be empty."""

    title: str = ""
    author: str = ""
    date: str = ""
    problem: str = ""


NO_HEADING = Heading()

LEFT_OUT = {"full": (), "short": ("Positions and velocities", "Coordinate", "Matrix form", "Energy", "Jacobi integral")}
"""Headings of the sections that each level of detail leaves out."""

ALONE = "Equations of motion"
"""Heading of the section in which LaTeX prints one formula per line. In other sections short formulas share a line."""


class Page(ABC):
    """Base class of the writers of derivations, one per markup language; `notation` spells the formulas."""

    notation: ClassVar[type[Notation]] = Notation

    def __init__(self, statement: Statement, heading: Heading = NO_HEADING) -> None:
        self.statement, self.above = statement, heading
        self.title = heading.title or statement.name
        self.lines = LineWriter(statement, self.notation)

    @abstractmethod
    def write(self, sections: Sequence[Section]) -> str:
        """Return the derivation that consists of `sections` as a whole page."""

    def heading(self, section: Section, quoted: Callable[[str], str], formula: str) -> str:
        """Return the text of a section's heading, followed by the symbol that the section is about, if there is one.

        `quoted` escapes the words of the heading. `formula` is a format string for the symbol, such as "${}$".
        """
        words = quoted(section.heading)
        return words if section.symbol is None else f"{words} {formula.format(self.lines.sides.side(section.symbol))}"


class TextPage(Page):
    """Writer of plain text, spelled as in scene files: theta_dot for a velocity, theta_ddot for an acceleration."""

    def write(self, sections: Sequence[Section]) -> str:
        """Return the derivation as plain text: the heading of each of the `sections`, and its rows, indented."""
        lines = [plain_text(self.title)]
        lines += [plain_text(text) for text in (self.above.author, self.above.date, self.above.problem) if text]
        for section in sections:
            lines += ["", self.heading(section, plain_text, "{}")]
            for row in section.rows:
                lines += [INDENT + text for text in self.row(row)]
        return "\n".join(line.rstrip() for line in lines) + "\n"

    def row(self, row: Formula | str) -> list[str]:
        """Return `row`, a formula or a sentence of a section, as lines of text.

        A line that continues a formula or a sentence is indented once more.
        """
        if isinstance(row, str):
            return [plain_text(row)]
        lines: list[str] = []
        for line in self.lines.formula(row):
            start = f"{line.left} = " if line.left else INDENT if line.goes_on else ""
            first, *below = line.right.split("\n")
            lines += [start + first, *(" " * width(start) + text for text in below)]
        return lines


class UnicodePage(TextPage):
    """Writer of text in Unicode, with Greek letters, dots and superscripts."""

    notation = UnicodeNotation


class LatexPage(Page):
    """Writer of a LaTeX document."""

    spoken: ClassVar[Mapping[str, str]] = {
        "v.p - L": "$\\sum_i \\dot q_i p_i - L$",
        "(T + V is": "($T + V$ is",
        "appear in L:": "appear in $L$:",
        "M a = h": "$M \\ddot q = h$",
    }
    """Formulas that occur in sentences about the structure of a system: plain text, and the LaTeX that replaces it."""

    notation = LatexNotation

    def aligned(self, lines: Sequence[FormulaLine], environment: str) -> str:
        """Return the lines of a formula as LaTeX, below one another and aligned, in the environment `environment`."""
        starts = (f"{line.left} &= " if line.left else "&\\quad " if line.goes_on else "&" for line in lines)
        rows = [start + line.right for start, line in zip(starts, lines, strict=True)]
        return f"\\begin{{{environment}}} " + " \\\\ ".join(rows) + f" \\end{{{environment}}}"

    def formula(self, *rows: Formula) -> str:
        """Return formulas as LaTeX without dollar signs; several lines are aligned at their equals signs."""
        lines = [line for row in rows for line in self.lines.formula(row)]
        if len(lines) > 1:
            return self.aligned(lines, "aligned")
        return f"{lines[0].left} = {lines[0].right}" if lines[0].left else lines[0].right

    def write(self, sections: Sequence[Section]) -> str:
        """Return the derivation that consists of `sections` as a complete LaTeX document."""
        lines = [
            "\\documentclass[a4paper]{article}",
            "\\usepackage[T1]{fontenc}",
            "\\usepackage{amsmath}",
            "\\usepackage[margin=2cm, vmargin=1.3cm, footskip=6mm]{geometry}",
            "\\allowdisplaybreaks",
            "\\raggedbottom",
            "\\setlength{\\parindent}{0pt}",
            *COMPACT,
            f"\\title{{{latex_text(self.title)}}}",
            f"\\author{{{latex_text(self.above.author)}}}",
            f"\\date{{{latex_text(self.above.date)}}}",
            "\\begin{document}",
            "\\maketitle",
        ]
        if self.above.problem:
            lines += ["", f"\\noindent\\textbf{{Problem.}} {latex_text(self.above.problem)}\\par"]
        for section in sections:
            lines += ["", f"\\section*{{{self.heading(section, latex_text, '${}$')}}}"]
            lines += map(self.row, section.rows) if section.heading == ALONE else self.rows(section.rows)
        # A formula at the start of a paragraph has a blank line before it.
        text = re.sub(r"\\par\n(?=\\(?:\[|begin))", "\n", "\n".join(lines))
        return text + "\n\n\\end{document}\n"

    def rows(self, rows: Sequence[Formula | str]) -> Iterator[str]:
        """Yield the rows of a section as LaTeX: sentences and formulas. Short formulas are side by side."""
        for spoken, part in groupby(rows, lambda row: isinstance(row, str)):
            if spoken:
                yield from map(self.row, part)
            for group in self.lines.beside([row for row in part if isinstance(row, Formula)]):
                joined = ", \\qquad ".join(map(self.formula, group))
                yield self.row(group[0]) if len(group) == 1 else f"\\[ {joined} \\]"

    def sentence(self, text: str, quoted: Callable[[str], str]) -> str:
        """Return the sentence `text` in LaTeX, with its symbols as formulas; `quoted` escapes the other words.

        Symbols are a coordinate at the start of the sentence, momenta, Greek letters, names that end with a digit, and
        rotations with their entries and rates.
        """
        names = {*self.statement.names, *(p.name for p in self.statement.parameters)}
        letter = self.lines.sides.notation.letter

        def formula(match: re.Match[str]) -> str:
            word = match.group().replace("\\_", "_")
            if word.startswith("p_") and word[2:] in names:
                return f"${self.lines.sides.quantity(ShownQuantity('p', (word[2:],)))}$"
            first = match.start() == 0 and word in self.statement.names
            turned = word.partition("_")[0] in self.statement.rotations
            shown = first or turned or (word in names and (word in GREEK or word[-1].isdigit()))
            return f"${letter(word)}$" if shown else match.group()

        shown = _WORD.sub(formula, quoted(text))
        for words, formula_text in self.spoken.items():
            shown = shown.replace(quoted(words), formula_text)
        return shown

    def row(self, row: Formula | str) -> str:
        """Return `row` in LaTeX: a sentence as a paragraph, or a formula on its own lines."""
        if isinstance(row, str):
            return self.sentence(row, latex_text) + "\\par"
        lines = self.lines.formula(row)
        return f"\\[ {self.formula(row)} \\]" if len(lines) == 1 else self.aligned(lines, "align*")


class MarkdownPage(LatexPage):
    """Writer of Markdown with LaTeX formulas."""

    def write(self, sections: Sequence[Section]) -> str:
        """Return the derivation that consists of `sections` as Markdown, with formulas between double dollar signs."""
        lines = [f"# {markdown_text(self.title)}"]
        for text in (self.above.author, self.above.date, self.above.problem):
            lines += ["", markdown_text(text)] if text else []
        for section in sections:
            lines += ["", f"## {self.heading(section, markdown_text, '${}$')}"]
            for row in section.rows:
                lines += [
                    "",
                    self.sentence(row, markdown_text) if isinstance(row, str) else f"$$\n{self.formula(row)}\n$$",
                ]
        return "\n".join(lines) + "\n"


class HtmlPage(Page):
    """Writer of an HTML page with MathML. Sections fold, and long ones are folded when the page opens."""

    cell = '<mtd style="text-align: {}">{}</mtd>'
    """HTML template of one cell of a formula on several lines: its alignment, "right" or "left", and its content."""

    notation = MathmlNotation

    def write(self, sections: Sequence[Section]) -> str:
        """Return the derivation that consists of `sections` as a complete HTML page that loads no other file."""
        title = escape(plain_text(self.title))
        above = (self.above.author, self.above.date, self.above.problem)
        paragraphs = "".join(f"<p>{escape(plain_text(text))}</p>\n" for text in above if text)
        return (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f"<title>{title}</title>\n</head>\n<body>\n<h1>{title}</h1>\n{paragraphs}"
            + "".join(map(self.section, sections))
            + "</body>\n</html>\n"
        )

    def section(self, section: Section) -> str:
        """Return the HTML of a section that folds; a long section is folded when the page opens."""
        rows = [self.row(row) for row in section.rows]
        long = sum(row.count("<mtr class") or 1 for row in rows) > LONG_SECTION
        return self.folding(section, "\n".join(rows), folded=long)

    def folding(self, section: Section, inside: str, *, folded: bool) -> str:
        """Return the HTML of a section whose content `inside` folds under its heading; at first closed if `folded`."""
        heading = self.heading(section, escape, "<math>{}</math>")
        return f"<details{'' if folded else ' open'}><summary>{heading}</summary>\n{inside}\n</details>\n"

    def row(self, row: Formula | str) -> str:
        """Return `row`, a sentence or a formula, as a paragraph of HTML."""
        if isinstance(row, str):
            return f"<p>{escape(plain_text(row))}</p>"
        lines = self.lines.formula(row)
        if len(lines) == 1:
            inside = f"{lines[0].left}<mo>=</mo>{lines[0].right}" if lines[0].left else lines[0].right
        else:
            rows = (
                '<mtr class="line">'
                + self.cell.format("right", f"<mrow>{line.left}<mo>=</mo></mrow>" if line.left else "")
                + self.cell.format("left", f"<mrow>{line.right}</mrow>")
                + "</mtr>"
                for line in lines
            )
            inside = f"<mtable>{''.join(rows)}</mtable>"
        return f'<p><math display="block" xmlns="http://www.w3.org/1998/Math/MathML"><mrow>{inside}</mrow></math></p>'


PAGES: dict[str, Callable[[Statement, Heading], Any]] = {
    "text": TextPage,
    "unicode": UnicodePage,
    "latex": LatexPage,
    "markdown": MarkdownPage,
    "html": HtmlPage,
}
