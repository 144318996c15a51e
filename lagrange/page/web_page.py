"""Write the web page of a system: sliders, its motion, which JavaScript computes, and its formulas."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import sympy

from lagrange.equations.derivation import Derivation
from lagrange.machine.model import Model
from lagrange.page.document import (
    COMPUTED,
    PICTURES,
    as_json,
    colour_rules,
    hint,
    html,
    in_script,
    joined,
    legend,
    phase_choices,
    template,
)
from lagrange.page.script_data import ENERGIES, PAGE_STEPS, TOLERANCE, description, motion_source, rate_of
from lagrange.page.sliders import PARAMETER, Slider, quaternion_rows, sliders
from lagrange.show.derivation_page import HtmlPage
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.notation.sections import Formula, Section, sections
from lagrange.show.notation.symbols import plain_text
from lagrange.show.units import energy_letter
from lagrange.statement.declare import initial_state
from lagrange.statement.statement import Statement
from lagrange.trajectory.constraints.consistent import complete_start

OPEN = ("Stated", "Equations of motion")
"""Sections that are open when the page loads."""

LONGEST_SECTION = 30_000
"""Longest section, in characters; a longer one is replaced by a sentence. The accelerations of the double pendulum take
8,000."""

SHORTEST_OPERATION = 20
"""Least number of characters of an operation with its operand, in MathML."""


class FoldedFormulas(HtmlPage):
    """Writes sections that fold. They have no inline styles, which the security policy of the page forbids."""

    cell = '<mtd class="{}">{}</mtd>'

    def section(self, section: Section) -> str:
        """Return a section as HTML; if it is too long, a sentence replaces its formulas."""
        sides = [side for row in section.rows if isinstance(row, Formula) for side in row.sides]
        operations = sum(int(side.count_ops()) for side in sides if isinstance(side, sympy.Basic))
        inside = ""
        if operations * SHORTEST_OPERATION <= LONGEST_SECTION:
            inside = "\n".join(map(self.row, section.rows))
        if not inside or len(inside) > LONGEST_SECTION:
            inside = self.row("These formulas are too long to be read here: `lagrange derive` prints them.")
        return self.folding(section, inside, folded=section.heading not in OPEN)

    def letter(self, name: str) -> str:
        """Return the symbol of a coordinate, velocity or parameter in MathML; a velocity is written as dx/dt."""
        base = name.removesuffix("_dot")
        rate = name != base and base in self.statement.names
        letter = self.lines.sides.notation.letter(base if rate else name, 0)
        over = '<mo lspace="0" rspace="0">/</mo>'
        return f"<math><mi>d</mi>{letter}{over}<mi>d</mi><mi>t</mi></math>" if rate else f"<math>{letter}</math>"


OPEN_SLIDERS = 15
"""Largest number of sliders that are shown unfolded. With more, those of the initial state and excess parameters are
folded."""


def slider_groups(sliders: Sequence[Slider], page: FoldedFormulas) -> str:
    """Return HTML of the sliders in groups: sliders that the user chose, parameters, initial values."""
    chosen = [(index, slider) for index, slider in enumerate(sliders) if slider.chosen]
    rest = [(index, slider) for index, slider in enumerate(sliders) if not slider.chosen]
    parameters = [pair for pair in rest if pair[1].kind == PARAMETER]
    states = [pair for pair in rest if pair[1].kind != PARAMETER]
    groups = [
        ("Sliders", chosen, False),
        ("Parameters", parameters, bool(chosen) or len(parameters) > OPEN_SLIDERS),
        ("Start", states, bool(chosen) or len(rest) > OPEN_SLIDERS),
    ]
    units = any(slider.unit or slider.angle for slider in sliders)
    written = (
        (title, folded, "".join(_slider(index, slider, page, units=units) for index, slider in rows))
        for title, rows, folded in groups
        if rows
    )
    return "".join(
        f"<details{'' if folded else ' open'}><summary>{title}</summary>\n{inside}</details>\n"
        for title, folded, inside in written
    )


def _slider(index: int, slider: Slider, page: FoldedFormulas, *, units: bool) -> str:
    name, unit = escape(slider.name), escape(plain_text(slider.unit))
    spoken = f"{name} in {unit}" if unit else name
    shown_unit = f'<span id="unit{index}">{unit}</span>' if units else ""
    start = "" if slider.kind == PARAMETER else "initial value of "
    return (
        f'<div class="slider"><label for="slider{index}">{page.letter(slider.name)}</label>'
        f'<input type="range" id="slider{index}" min="{slider.low!r}" max="{slider.high!r}"'
        f' step="any" value="{slider.value!r}"'
        f' aria-label="{start}{spoken}">'
        f'<input type="number" id="number{index}" step="any" value="{slider.value!r}"'
        f' aria-label="{start}{spoken}, typed">'
        f"{shown_unit}</div>\n"
    )


def note(statement: Statement) -> str:
    """Return an HTML note that the picture shows coordinates over time; empty if positions are stated."""
    if statement.positions:
        return ""
    said = "No positions are stated for this system: the picture shows its coordinates over time."
    return f'<p class="note">{said}</p>\n'


def write_page(
    model: Model,
    derivation: Derivation,
    path: str | os.PathLike[str],
    parameters: Mapping[Any, Any] | None,
    initial: Mapping[Any, Any] | None,
    asked: Mapping[Any, Any] | None,
) -> Path:
    """Write the page of a model, whole or not at all, and return its path.

    `parameters` and `initial` are values that replace the stated ones. `asked` maps symbols or names of sliders to
    bounds (low, high).
    """
    return write_atomically(
        path, lambda file: file.write(page_of(model, derivation, parameters, initial, asked).encode())
    )


def page_of(
    model: Model,
    derivation: Derivation | None,
    parameters: Mapping[Any, Any] | None,
    initial: Mapping[Any, Any] | None,
    asked: Mapping[Any, Any] | None,
    *,
    t_end: float | None = None,
    play: bool = True,
    style: str = "",
) -> str:
    """Return the page of a model as HTML, without formulas if `derivation` is None.

    `parameters` and `initial` are values that replace the stated ones. `asked` maps symbols or names of sliders to
    bounds (low, high). `t_end` sets the speed and the size of the picture, and `play` starts the motion at once.
    `style` is "light" or "dark", or empty for that of the browser.
    """
    statement = model.statement
    end = statement.run.t_end if t_end is None else t_end
    state = np.array(initial_state({} if initial is None else initial, statement.coordinates, statement.initial))
    values = tuple(float(value) for value in model.parameter_array(parameters))
    start = complete_start(model, 0.0, state, np.array(values))
    page_sliders = sliders(model, values, tuple(start.tolist()), asked)
    motion = motion_source(model, parameters)
    energies = ENERGIES[: 1 if statement.lagrangian_alone else 3]
    data = description(statement, rate_of(end), energies, energy_letter(model.equations))
    data |= {
        "parameters": list(motion.parameters),
        "initial": start.tolist(),
        "sliders": [
            {key: getattr(slider, key) for key in ("kind", "place", "value", "angle")} for slider in page_sliders
        ],
        "quaternions": quaternion_rows(statement),
        "tolerance": TOLERANCE,
        "most_steps": PAGE_STEPS,
        "t_end": end,
        "play": play,
        "span": [bound if math.isfinite(bound) else None for bound in statement.span],
        "kept": model.equations.structure.energy_kept is True,
    }
    formulas = ""
    if derivation is not None:
        formulas = "".join(map(FoldedFormulas(derivation.statement).section, sections(derivation)))
    parts = {
        "title": escape(plain_text(statement.name)),
        "about": escape(plain_text(statement.about)),
        "legend": legend(statement),
        "note": note(statement),
        "hint": hint(statement),
        "sliders": slider_groups(page_sliders, FoldedFormulas(statement)),
        "choices": phase_choices(statement),
        "formulas": formulas,
        "look": f' data-style="{style}"' if style else "",
    }
    parts |= {"data": as_json(data), "style": colour_rules(statement) + template("page.css") + template("system.css")}
    scripts = {"shared": joined(*PICTURES, *COMPUTED), "module": in_script(motion.script)}
    return html("page.html", parts, scripts, trusted=True)
