"""The parts of a page that differ from system to system, as HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from lagrange.page.description import moving_points
from lagrange.page.formulas import FoldedFormulas
from lagrange.show.figures.colours import colours
from lagrange.show.figures.style import DARK, LIGHT, Style
from lagrange.show.notation.names import plain_text
from lagrange.show.notation.text import UnicodeNotation
from lagrange.show.sliders import PARAMETER, Slider
from lagrange.statement.statement import Statement

FEW = 15
"""Sliders that are seen at once: where there are more, those of the start are folded, and parameters that are more."""


SPACE = 3
"""Entries of a position in space."""


def slider_groups(found: Sequence[Slider], page: FoldedFormulas) -> str:
    """Return the sliders in groups: those asked for, parameters, initial values."""
    chosen = [(place, one) for place, one in enumerate(found) if one.chosen]
    others = [(place, one) for place, one in enumerate(found) if not one.chosen]
    parameters = [pair for pair in others if pair[1].kind == PARAMETER]
    states = [pair for pair in others if pair[1].kind != PARAMETER]
    groups = [
        ("Sliders", chosen, False),
        ("Parameters", parameters, bool(chosen) or len(parameters) > FEW),
        ("Start", states, bool(chosen) or len(others) > FEW),
    ]
    units = any(one.unit or one.angle for one in found)
    written = (
        (title, folded, "".join(_slider(place, one, page, units=units) for place, one in rows))
        for title, rows, folded in groups
        if rows
    )
    return "".join(
        f"<details{'' if folded else ' open'}><summary>{title}</summary>\n{inside}</details>\n"
        for title, folded, inside in written
    )


def _slider(place: int, one: Slider, page: FoldedFormulas, *, units: bool) -> str:
    name, unit = escape(one.name), escape(plain_text(one.unit))
    spoken = f"{name} in {unit}" if unit else name
    shown_unit = f'<span id="unit{place}">{unit}</span>' if units else ""
    start = "" if one.kind == PARAMETER else "initial value of "
    return (
        f'<div class="slider"><label for="slider{place}">{page.letter(one.name)}</label>'
        f'<input type="range" id="slider{place}" min="{one.low!r}" max="{one.high!r}" step="any" value="{one.value!r}"'
        f' aria-label="{start}{spoken}">'
        f'<input type="number" id="number{place}" step="any" value="{one.value!r}" aria-label="{start}{spoken}, typed">'
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
    """Return what the picture shows where it is not the motion of points."""
    if statement.positions:
        return ""
    said = "No positions are stated for this system: the picture shows its coordinates over time."
    return f'<p class="note">{said}</p>\n'


def hint(statement: Statement) -> str:
    """Return what can be done with a picture of space."""
    in_space = any(len(point) == SPACE for point in statement.positions.values())
    return '<p class="hint">Drag to turn</p>' if in_space else ""


def phase_choices(statement: Statement) -> str:
    """Return the choices of a coordinate for the phase plane."""
    letter = UnicodeNotation(statement.names).letter
    return "".join(f'<option value="{k}">{escape(letter(name))}</option>' for k, name in enumerate(statement.names))


def colour_rules(count: int) -> str:
    """Return the colours of both styles as CSS, for so many lines."""
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
