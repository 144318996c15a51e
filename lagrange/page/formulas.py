"""The equations on a page, as MathML."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from lagrange.equations.derivation import Derivation
from lagrange.show.derivation import HtmlPage
from lagrange.show.notation.sections import Section, sections

OPEN = ("Stated", "Equations of motion")
"""The sections that are unfolded when the page opens."""

LONGEST = 30_000
"""Characters of a section above which a sentence stands in its place; the accelerations of the double pendulum take
8,000."""


class FoldedFormulas(HtmlPage):
    """Sections that fold, without styles of their own: the page forbids those."""

    cell = '<mtd class="{}">{}</mtd>'

    def sections(self, found: Iterator[Section]) -> str:
        """Return the sections below one another."""
        return "".join(map(self.section, found))

    def section(self, section: Section) -> str:
        """Return a section, or the sentence that says that it is too long."""
        inside = "\n".join(map(self.row, section.rows))
        if len(inside) > LONGEST:
            inside = self.row("These formulas are too long to be read here: `lagrange derive` prints them.")
        opened = " open" if section.heading in OPEN else ""
        heading = self.heading(section, escape, "<math>{}</math>")
        return f"<details{opened}><summary>{heading}</summary>\n{inside}\n</details>\n"

    def letter(self, name: str) -> str:
        """Return the letter of a coordinate, a velocity such as x_dot or a parameter."""
        base = name.removesuffix("_dot")
        dots = int(name != base and base in self.statement.names)
        return f"<math>{self.lines.sides.notation.letter(base if dots else name, dots)}</math>"


def formulas(derivation: Derivation) -> str:
    """Return the derivation of a system as sections that fold."""
    return FoldedFormulas(derivation.statement).sections(sections(derivation))
