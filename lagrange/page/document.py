"""The page as one HTML document that runs no code except its own: formulas, symbols, parts."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path

import sympy

from lagrange.equations.derivation import Derivation
from lagrange.page.description import moving_points
from lagrange.show.derivation import HtmlPage
from lagrange.show.figures.style import DARK, LIGHT, Style, colours
from lagrange.show.files.template import filled
from lagrange.show.notation.names import plain_text
from lagrange.show.notation.sections import Formula, Section, sections
from lagrange.show.notation.text import UnicodeNotation
from lagrange.show.sliders import PARAMETER, Slider
from lagrange.statement.statement import Statement

OPEN = ("Stated", "Equations of motion")
"""Sections that are open when the page loads."""

LONGEST = 30_000
"""Longest section, in characters; a longer one is replaced by a sentence. The accelerations of the double pendulum take
8,000."""

SHORTEST_OPERATION = 20
"""Least number of characters of an operation with its operand, in MathML."""

TOO_LONG = "These formulas are too long to be read here: `lagrange derive` prints them."


class FoldedFormulas(HtmlPage):
    """Sections that fold, without inline styles: the security policy of the page forbids those."""

    cell = '<mtd class="{}">{}</mtd>'

    def sections(self, found: Iterator[Section]) -> str:
        """Return the sections below one another."""
        return "".join(map(self.section, found))

    def section(self, section: Section) -> str:
        """Return a section, or a sentence instead of it if it is too long."""
        inside = "" if _is_long(section) else "\n".join(map(self.row, section.rows))
        if not inside or len(inside) > LONGEST:
            inside = self.row(TOO_LONG)
        opened = " open" if section.heading in OPEN else ""
        heading = self.heading(section, escape, "<math>{}</math>")
        return f"<details{opened}><summary>{heading}</summary>\n{inside}\n</details>\n"

    def letter(self, name: str) -> str:
        """Return the symbol of a coordinate, a velocity such as x_dot or a parameter."""
        base = name.removesuffix("_dot")
        dots = int(name != base and base in self.statement.names)
        return f"<math>{self.lines.sides.notation.letter(base if dots else name, dots)}</math>"


def _is_long(section: Section) -> bool:
    """Return True if the text of a section is surely longer than `LONGEST`, by its number of operations."""
    sides = [side for row in section.rows if isinstance(row, Formula) for side in row.sides]
    operations = sum(int(side.count_ops()) for side in sides if isinstance(side, sympy.Basic))
    return operations * SHORTEST_OPERATION > LONGEST


def formulas(derivation: Derivation) -> str:
    """Return the derivation of a system as sections that fold."""
    return FoldedFormulas(derivation.statement).sections(sections(derivation))


FEW = 15
"""Most sliders that are shown open. With more, those of the initial state are folded, and excess parameters."""


SPACE = 3
"""Number of entries of a position in space."""


def slider_groups(found: Sequence[Slider], page: FoldedFormulas) -> str:
    """Return the sliders in groups: chosen ones, parameters, initial values."""
    chosen = [(place, slider) for place, slider in enumerate(found) if slider.chosen]
    others = [(place, slider) for place, slider in enumerate(found) if not slider.chosen]
    parameters = [pair for pair in others if pair[1].kind == PARAMETER]
    states = [pair for pair in others if pair[1].kind != PARAMETER]
    groups = [
        ("Sliders", chosen, False),
        ("Parameters", parameters, bool(chosen) or len(parameters) > FEW),
        ("Start", states, bool(chosen) or len(others) > FEW),
    ]
    units = any(slider.unit or slider.angle for slider in found)
    written = (
        (title, folded, "".join(_slider(place, slider, page, units=units) for place, slider in rows))
        for title, rows, folded in groups
        if rows
    )
    return "".join(
        f"<details{'' if folded else ' open'}><summary>{title}</summary>\n{inside}</details>\n"
        for title, folded, inside in written
    )


def _slider(place: int, slider: Slider, page: FoldedFormulas, *, units: bool) -> str:
    name, unit = escape(slider.name), escape(plain_text(slider.unit))
    spoken = f"{name} in {unit}" if unit else name
    shown_unit = f'<span id="unit{place}">{unit}</span>' if units else ""
    start = "" if slider.kind == PARAMETER else "initial value of "
    return (
        f'<div class="slider"><label for="slider{place}">{page.letter(slider.name)}</label>'
        f'<input type="range" id="slider{place}" min="{slider.low!r}" max="{slider.high!r}"'
        f' step="any" value="{slider.value!r}"'
        f' aria-label="{start}{spoken}">'
        f'<input type="number" id="number{place}" step="any" value="{slider.value!r}"'
        f' aria-label="{start}{spoken}, typed">'
        f"{shown_unit}</div>\n"
    )


def legend(statement: Statement) -> str:
    """Return the names of the points that move, with their colours."""
    names = moving_points(statement)
    if len(names) < 2:
        return ""
    rows = (f'<li><i class="colour{k}"></i>{escape(name)}</li>' for k, name in enumerate(names))
    return f'<ul class="legend">{"".join(rows)}</ul>'


def note(statement: Statement) -> str:
    """Return a note on the picture if it does not show the motion of points."""
    if statement.positions:
        return ""
    said = "No positions are stated for this system: the picture shows its coordinates over time."
    return f'<p class="note">{said}</p>\n'


def hint(statement: Statement) -> str:
    """Return instructions for turning a picture of space."""
    in_space = any(len(point) == SPACE for point in statement.positions.values())
    return '<p class="hint">Drag to turn</p>' if in_space else ""


def phase_choices(statement: Statement) -> str:
    """Return the options of the phase plane, one for each coordinate."""
    letter = UnicodeNotation(statement.names).letter
    return "".join(f'<option value="{k}">{escape(letter(name))}</option>' for k, name in enumerate(statement.names))


def colour_rules(count: int) -> str:
    """Return the colours of both styles as CSS, for `count` lines."""
    light, dark = (_variables(style, count) for style in (LIGHT, DARK))
    swatches = "".join(f".colour{k}{{background:var(--colour{k})}}" for k in range(count))
    return (
        f":root{{color-scheme:light;{light}}}\n"
        f"@media (prefers-color-scheme:dark){{:root:not([data-style=light]){{color-scheme:dark;{dark}}}}}\n"
        f":root[data-style=dark]{{color-scheme:dark;{dark}}}\n{swatches}\n"
    )


def _variables(style: Style, count: int) -> str:
    lines = [*style.colours, *colours(count, style.colours)[len(style.colours) :]]
    named = {"paper": style.paper, "ink": style.ink, "quiet": style.quiet, "grid": style.grid}
    named |= {"accent": lines[0], "warning": lines[1]}
    named |= {f"colour{k}": colour for k, colour in enumerate(lines[:count])}
    return "".join(f"--{name}:{colour};" for name, colour in named.items())


TEMPLATE = Path(__file__).resolve().parent / "template"

SCRIPTS = ("numbers", "motion", "view", "picture", "plots", "sliders", "controls", "page")
"""Scripts of every page, in the order of their dependencies."""

ENDS = re.compile(r"<(?=/script|script|!--)", re.IGNORECASE)
"""Text that would end a script element early, or open a comment inside it."""


@dataclass(frozen=True)
class Document:
    """Content for the template: texts, parts in HTML, the module, the data and the colours."""

    parts: Mapping[str, str]
    module: str
    data: str
    colours: str

    def html(self) -> str:
        """Return the page. Its policy allows only its two scripts and its style, by their hashes, and no requests."""
        style = self.colours + template("page.css")
        scripts = [shared_scripts(), in_script(self.module)]
        allowed = {"script": " ".join(map(_hash, scripts)), "style": _hash(style)}
        policy = (
            f"default-src 'none'; script-src {allowed['script']}; style-src {allowed['style']}; base-uri 'none'; "
            "form-action 'none'; require-trusted-types-for 'script'; trusted-types 'none'"
        )
        fields = {
            **self.parts,
            "policy": policy,
            "style": style,
            "data": self.data,
            "shared": scripts[0],
            "module": scripts[1],
        }
        return filled(template("page.html"), fields)


@cache
def template(name: str) -> str:
    """Return a file of the template as text."""
    return (TEMPLATE / name).read_text("utf-8")


@cache
def shared_scripts() -> str:
    """Return the scripts that are the same for every page, joined."""
    return '"use strict";\n' + "\n".join(template(f"{name}.js") for name in SCRIPTS)


def in_script(text: str) -> str:
    """Return a script escaped for a script element.

    Only names and comments of a user can contain a text that ends the element. In a text or a comment JavaScript
    ignores the backslash that is inserted.
    """
    return ENDS.sub("<\\\\", text)


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"
