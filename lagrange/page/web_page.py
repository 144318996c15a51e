"""The web page of a system: sliders, its motion, which JavaScript computes, and its formulas."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, listing
from lagrange.machine.model import Model
from lagrange.page.document import (
    COMPUTED,
    ENERGIES,
    PAGE_STEPS,
    PICTURES,
    TOLERANCE,
    as_json,
    colour_rules,
    description,
    hint,
    html,
    in_frame,
    in_script,
    joined,
    legend,
    motion_source,
    phase_choices,
    rate_of,
    template,
)
from lagrange.page.sliders import (
    PARAMETER,
    RATE,
    STATE,
    Slider,
    asked_bounds,
    places,
    quaternion_rows,
    rates_at,
    sliders,
)
from lagrange.show.derivation_page import HtmlPage
from lagrange.show.figures.style import style_of
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.notation.sections import Formula, Section, sections
from lagrange.show.notation.symbols import plain_text
from lagrange.show.units import energy_letter
from lagrange.statement.declare import initial_state
from lagrange.statement.expression import flag, real_number
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


MOST_SLIDERS = 12
"""Largest number of sliders of a system: more are hard to use."""

FRAME_WIDTH, FRAME_HEIGHT = 1100, 760
"""Size in pixels of the frame of a page; a notebook may be narrower."""


@dataclass(frozen=True)
class ExploredPage:
    """A page with sliders, `html`, which a notebook shows in a frame."""

    name: str
    html: str

    def _repr_html_(self) -> str:
        return in_frame(self.html, f"sliders of {self.name}", FRAME_WIDTH, FRAME_HEIGHT)

    def __repr__(self) -> str:
        return f"<sliders of {self.name}: a notebook shows them; system.to_page(path) writes a page>"


def explore(
    statement: Statement,
    model: Callable[[], Model],
    ranges: Any,
    named: Mapping[str, Any],
    *,
    t_end: float | None,
    play: bool,
    style: str,
) -> ExploredPage:
    """Return the page of a system with sliders: first the entries of the dict `ranges`, then the keywords `named`.

    Both map symbols or names to bounds (low, high). `model()` compiles the system. The end of the run is `t_end`, None
    for the stated one. `play` starts the motion at once, and `style` chooses the colours. Raises StatementError for
    unknown names, invalid bounds, no or too many sliders, and where no page can be made.
    """
    bounds = asked_bounds(statement, ranges) | asked_bounds(statement, named)
    if not bounds:
        adjustable = places(statement)
        raise StatementError(
            f"no slider was asked for: give bounds such as explore({next(iter(adjustable))}=(0, 2)), for one of "
            f"{listing(adjustable)}."
        )
    if len(bounds) > MOST_SLIDERS:
        raise StatementError(f"{len(bounds)} sliders were asked for, and there is room for {MOST_SLIDERS}.")
    flag(play, "play")
    look = style_of(style)
    end = statement.run.t_end if t_end is None else real_number(t_end, "t_end, the time at which runs end,")
    parameters, initial = starts_within(statement, bounds)
    page = page_of(model(), None, parameters, initial, bounds, t_end=end, play=play, style=look.name)
    return ExploredPage(plain_text(statement.name), page)


def starts_within(
    statement: Statement, bounds: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return values of the sliders by name, of parameters and of the initial state: the stated ones within the bounds.

    A parameter without a value starts in the middle of its slider.
    """
    values: dict[str, dict[str, float]] = {PARAMETER: {}, STATE: {}, RATE: {}}
    stated: dict[str, Sequence[float | None]] = {
        PARAMETER: [statement.defaults.get(symbol) for symbol in statement.parameters],
        STATE: statement.initial,
        RATE: rates_at(statement, statement.initial),
    }
    adjustable = places(statement)
    for name, (low, high) in bounds.items():
        kind, index = adjustable[name]
        value = stated[kind][index]
        values[kind][name] = (low + high) / 2 if value is None else min(max(value, low), high)
    return values[PARAMETER], values[STATE] | values[RATE]
