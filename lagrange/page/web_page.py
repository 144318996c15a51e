"""Build the web page of a system, `system.to_page` and `lagrange.explore`: sliders, motion in JavaScript, formulas."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.dynamics.axes import TURN, angles
from lagrange.equations.derivation import Derivation
from lagrange.errors import RunError, StatementError, listing, shown, suggestion
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
    joined,
    legend,
    motion_script,
    phase_choices,
    rate_of,
    template,
)
from lagrange.page.player import animate
from lagrange.show.derivation_page import HtmlPage
from lagrange.show.figures.style import style_of
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.notation.sections import Formula, Section, sections
from lagrange.show.notation.text import plain_text
from lagrange.statement.coordinate import name_of
from lagrange.statement.declare import initial_state, state_rows
from lagrange.statement.expression import entries, flag, real_number
from lagrange.statement.given.function import require_values
from lagrange.statement.parameters import label_of, table_of
from lagrange.statement.rotation import quaternion_rows, rotation_of, symbols_of_entries
from lagrange.statement.space import body_rates
from lagrange.statement.statement import Statement, unit_of
from lagrange.trajectory.constraints.consistent import complete_start
from lagrange.trajectory.solution import Solution

PARAMETER, STATE, RATE = "parameter", "state", "rate"
"""Kinds of sliders: for a parameter, for an entry of the initial state, or for an initial rate of rotation of a body
about one of its axes."""

RECORDED_NOTE = "This page plays a recorded run: it does not compute the motion of a system with contacts."
"""Note below the player on the page of a system with contacts."""

EXAMPLE = (0.5, 2.0)  # Example of bounds in an error message


@dataclass(frozen=True)
class Slider:
    """A slider of a page for one value of a system, with the bounds `low` and `high`, and the `unit` of the value.

    `kind` is `PARAMETER`, `STATE` or `RATE`. `place` is the index of the value among the parameters, in the initial
    state, or among the rates of rotation of all bodies, three for each body. `chosen` is true if the user chose the
    slider by name; `angle` is true if the value is in radians.
    """

    name: str
    kind: str
    place: int
    value: float
    low: float
    high: float
    unit: str = ""
    chosen: bool = False
    angle: bool = False


def places(statement: Statement) -> dict[str, tuple[str, int]]:
    """Return the pair (kind, index) of each value that may have a slider, by name: parameters, rates and the state.

    The entries of a quaternion have no sliders, because these would change its length.
    """
    parameters = {p.name: (PARAMETER, index) for index, p in enumerate(statement.parameters)}
    rates = {name_of(rate): (RATE, index) for index, rate in enumerate(_rates_of(statement))}
    quaternions = symbols_of_entries(statement.rotations)
    state = {name: (STATE, index) for index, name in enumerate(statement.state_names) if name not in quaternions}
    return parameters | rates | state


def _rates_of(statement: Statement) -> list[Any]:
    """Return the symbols of the rates of rotation of all bodies about their own axes, three for each body."""
    return [rate for name in statement.rotations for rate in rotation_of(name).body]


def rates_at(statement: Statement, state: Sequence[float]) -> list[float]:
    """Return the rates of rotation of all bodies about their axes at a state (2n,), three for each body."""
    rates = list[float]()
    for _, rows, moving in quaternion_rows(statement.coordinates):
        rates += body_rates([state[row] for row in rows], [state[row] for row in moving])
    return rates


def chosen_bounds(statement: Statement, slider_bounds: Any) -> dict[str, tuple[float, float]]:
    """Return the bounds of the sliders that the user chose, by name. `slider_bounds` is a dict by symbol or name.

    Raises StatementError for a name that is not a parameter, coordinate or velocity, and for invalid bounds.
    """
    slider_bounds = table_of(slider_bounds, "sliders", f"name to bounds, such as {{'l': {EXAMPLE}}}")
    states = statement.state_names
    rows = {key: states[row] for key, row in state_rows(statement.coordinates).items()}
    rates = {key: name_of(rate) for rate in _rates_of(statement) for key in (rate, name_of(rate))}
    names = {**{key: p.name for p in statement.parameters for key in (p, p.name)}, **rates, **rows}
    result: dict[str, tuple[float, float]] = {}
    known = places(statement)
    for key, pair in slider_bounds.items():
        name = names.get(key, "")
        if name not in known:
            raise StatementError(
                f"there is no slider of {shown(label_of(key), 40)}, which is not a parameter, coordinate or velocity "
                f"of {statement.name}: they are {listing(known)}.{suggestion(label_of(key), known)}"
            )
        result[name] = _bounds(name, pair)
    return result


def _bounds(name: str, pair: Any) -> tuple[float, float]:
    listed = None if isinstance(pair, (str, bytes, Mapping, set, frozenset)) else entries(pair, f"the slider of {name}")
    if listed is None or len(listed) != 2:
        raise StatementError(
            f"the slider of {name} is {shown(pair)}: give its lower and its upper bound, such as {EXAMPLE}."
        )
    low, high = (real_number(bound, f"a bound of the slider of {name}") for bound in listed)
    if low == high:
        such = (-1.0, 1.0) if low == 0 else tuple(sorted((low / 2, low * 2)))
        raise StatementError(
            f"the slider of {name} goes from {low:g} to {high:g}, which is an empty range: give a lower and a larger "
            f"upper bound, such as {such}."
        )
    if low > high:
        raise StatementError(
            f"the slider of {name} goes from {low:g} to {high:g}: give the lower bound first, ({high:g}, {low:g})."
        )
    return low, high


NICE = (1.0, 2.0, 3.0, 5.0, 10.0)  # First digits of default bounds

LOWEST, HIGHEST = 0.1, 3.0
"""Bounds of a parameter's slider as multiples of its value. A lower bound of 0 would often mean a mass of zero."""

COORDINATE_RANGE = 0.9
"""Half-range of the slider of a coordinate that starts at a nonzero value, as a fraction of this value. The sign of the
coordinate stays the same."""


def sliders(
    model: Model, parameters: tuple[float, ...], initial: tuple[float, ...], slider_bounds: Mapping[Any, Any] | None
) -> tuple[Slider, ...]:
    """Return a slider for each parameter and each entry of the initial state, those in `slider_bounds` first.

    `parameters` and `initial` are the present values. `slider_bounds` maps symbols or names to bounds (low, high). The
    sliders of a body change its rates of rotation, not its quaternion. Raises StatementError for unknown names, and for
    bounds that do not contain the present value.
    """
    statement = model.statement
    bounds, adjustable = chosen_bounds(statement, slider_bounds), places(statement)
    rates = rates_at(statement, initial)
    most = nice(2 * max(map(abs, rates), default=0.0) or 1.0)
    every = [
        *(
            Slider(symbol.name, PARAMETER, index, value, *parameter_bounds(value), unit_of(statement, symbol.name))
            for index, (symbol, value) in enumerate(zip(statement.parameters, parameters, strict=True))
        ),
        *_states(model, parameters, initial),
        *(
            Slider(name_of(rate), RATE, index, value, -most, most)
            for index, (rate, value) in enumerate(zip(_rates_of(statement), rates, strict=True))
        ),
    ]
    by_name = {slider.name: slider for slider in every if slider.name in adjustable}
    for name, (low, high) in bounds.items():
        slider = by_name[name]
        if not low <= slider.value <= high:
            raise StatementError(
                f"the slider of {name} goes from {low:g} to {high:g}, but {name} is {slider.value:g}: give bounds with "
                f"{slider.value:g} between them, or {name} another value."
            )
        by_name[name] = replace(slider, low=low, high=high, chosen=True)
    return (*(by_name[name] for name in bounds), *(slider for slider in by_name.values() if not slider.chosen))


def parameter_bounds(value: float) -> tuple[float, float]:
    """Return the bounds of a parameter: a tenth to three times its value, or 0 to 1 for the value zero."""
    if value == 0:
        return 0.0, 1.0
    low, high = sorted(math.copysign(nice(multiple * abs(value)), value) for multiple in (LOWEST, HIGHEST))
    return low, high


def nice(size: float) -> float:
    """Return the least round bound of a slider that is not below `size`, such as 0.3 for 0.27.

    A round number has a single nonzero digit: 1, 2, 3 or 5.
    """
    if not math.isfinite(1 / size):
        return size
    unit = 10.0 ** math.floor(math.log10(size))
    first = next(digit for digit in NICE if size <= digit * unit * (1 + 1e-9))
    return float(f"{first * unit:.1g}")


def _states(model: Model, parameters: tuple[float, ...], initial: tuple[float, ...]) -> Iterator[Slider]:
    """Yield the sliders of the initial coordinates and velocities, from their values `initial` (2n,).

    `parameters` are the values of the parameters. The bounds of a velocity that starts at zero follow from the
    acceleration of the coordinate. Accelerations that cannot be computed count as zero, because the page itself reports
    that.
    """
    statement = model.statement
    n = len(statement.names)
    circular = angles(statement)
    values = dict(zip(statement.parameters, parameters, strict=True))
    accelerations = np.zeros(n)
    with suppress(RunError):
        accelerations = np.nan_to_num(model.rhs(0.0, np.array(initial), values)[model.layout.v], posinf=0.0, neginf=0.0)
    free = [abs(value) for angle, value in zip(circular, initial, strict=False) if not angle]
    usual = max(free, default=0.0) or 1.0
    for index, (angle, name) in enumerate(zip(circular, statement.names, strict=True)):
        value = initial[index]
        half = TURN / 2 if angle else nice(usual) if value == 0 else COORDINATE_RANGE * abs(value)
        middle = TURN * round(value / TURN) if angle else value
        yield Slider(name, STATE, index, value, middle - half, middle + half, unit_of(statement, name), angle=angle)
        speed, name = initial[n + index], f"{name}_dot"
        length = 1.0 if angle else usual
        most = nice(2 * abs(speed) or math.sqrt(abs(float(accelerations[index])) * length) or usual)
        yield Slider(name, STATE, n + index, speed, -most, most, unit_of(statement, name))


OPEN = ("Stated", "Equations of motion")  # Sections that are open when the page loads

LONGEST_SECTION = 30_000
"""Longest section of formulas on a page, in characters; a longer one is replaced by a sentence. The accelerations of
the double pendulum take 8,000."""

SHORTEST_OPERATION = 20  # Least number of characters of an operation with its operand, in MathML


class FoldedFormulas(HtmlPage):
    """Writes the sections of a derivation for a page; most are folded until the user opens them.

    Inline styles are not used, since the security policy of the page forbids them.
    """

    cell = '<mtd class="{}">{}</mtd>'

    def section(self, section: Section) -> str:
        """Return a section as HTML; if it is too long, a sentence replaces its formulas."""
        operations = sum(row.operations for row in section.rows if isinstance(row, Formula))
        inside = ""
        if operations * SHORTEST_OPERATION <= LONGEST_SECTION:
            inside = "\n".join(map(self.row, section.rows))
        if not inside or len(inside) > LONGEST_SECTION:
            inside = self.row("These formulas are too long to be read here: `lagrange derive` prints them.")
        return self.folding(section, inside, folded=section.heading not in OPEN)

    def letter(self, name: str) -> str:
        """Return MathML of the coordinate, velocity or parameter `name`; a velocity is written as dx/dt."""
        base = name.removesuffix("_dot")
        rate = name != base and base in self.statement.names
        letter = self.lines.sides.notation.letter(base if rate else name, 0)
        over = '<mo lspace="0" rspace="0">/</mo>'
        return f"<math><mi>d</mi>{letter}{over}<mi>d</mi><mi>t</mi></math>" if rate else f"<math>{letter}</math>"


OPEN_SLIDERS = 15
"""Largest number of sliders that are shown unfolded. With more sliders, those of the initial state are folded; with
more parameters, those of the parameters are folded, too."""


def slider_groups(sliders: Sequence[Slider], page: FoldedFormulas) -> str:
    """Return the HTML of the sliders in three groups: sliders that the user chose, parameters, and initial values.

    `page` writes the symbols of the sliders.
    """
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
    text = ""
    for title, rows, folded in groups:
        if rows:
            inside = "".join(_slider(index, slider, page, units=units) for index, slider in rows)
            text += f"<details{'' if folded else ' open'}><summary>{title}</summary>\n{inside}</details>\n"
    return text


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


NO_POSITIONS = (
    '<p class="note">No positions are stated for this system: the picture shows its coordinates over time.</p>\n'
)
"""Note on the page of a system without positions."""

NO_SLIDERS = "{} does not compute the motion of a system with contacts: {} with the given parameters and initial state."


def write_recorded_page(run: Callable[[], Solution], path: str | os.PathLike[str], sliders: Any) -> Path:
    """Write the page of a system with contacts, which plays a recorded run, and return its path.

    `run()` runs the system. Raises StatementError unless `sliders` is None, because the page does not compute the
    motion for other values.
    """
    if sliders is not None:
        raise StatementError(NO_SLIDERS.format("a page", "leave sliders out, and the page plays a run"))
    animation = animate(run())
    animation = replace(animation, notes=(RECORDED_NOTE, *animation.notes))
    return write_atomically(path, lambda file: file.write(animation.to_html().encode()))


def page_of(
    model: Model,
    derivation: Derivation | None,
    parameters: Mapping[Any, Any] | None,
    initial: Mapping[Any, Any] | None,
    slider_bounds: Mapping[Any, Any] | None,
    *,
    t_end: float | None = None,
    play: bool = True,
    style: str = "",
) -> str:
    """Return the page of a model as HTML, without formulas if `derivation` is None.

    `parameters` and `initial` are values that replace the stated ones. `slider_bounds` maps symbols or names of sliders
    to bounds (low, high). `t_end` is the end of the run for which the page chooses its speed and the size of its
    picture, None for the stated end. With `play` the motion starts at once. `style` is "light" or "dark", or empty for
    the setting of the browser.
    """
    statement = model.statement
    end = statement.run.t_end if t_end is None else t_end
    state = np.array(initial_state({} if initial is None else initial, statement.coordinates, statement.initial))
    values = tuple(float(value) for value in model.parameter_array(parameters))
    start = complete_start(model, 0.0, state, np.array(values))
    page_sliders = sliders(model, values, tuple(start.tolist()), slider_bounds)
    script, page_parameters = motion_script(model, parameters)
    energies = ENERGIES[: 1 if statement.lagrangian_alone else 3]
    data = description(statement, rate_of(end), energies, model.equations.structure.energy_letter)
    data |= {
        "parameters": list(page_parameters),
        "initial": start.tolist(),
        "sliders": [
            {key: getattr(slider, key) for key in ("kind", "place", "value", "angle")} for slider in page_sliders
        ],
        "quaternions": [rows for _, rows, _ in quaternion_rows(statement.coordinates)],
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
        "note": "" if statement.positions else NO_POSITIONS,
        "hint": hint(statement),
        "sliders": slider_groups(page_sliders, FoldedFormulas(statement)),
        "choices": phase_choices(statement),
        "formulas": formulas,
        "look": f' data-style="{style}"' if style else "",
    }
    parts |= {"data": as_json(data), "style": colour_rules(statement) + template("page.css") + template("system.css")}
    scripts = {"shared": joined(*PICTURES, *COMPUTED), "module": script}
    return html("page.html", parts, scripts, trusted=True)


MOST_SLIDERS = 12  # Largest number of sliders of a system: more are hard to use
FRAME_WIDTH, FRAME_HEIGHT = 1100, 760  # Size in pixels of the frame of a page; a notebook may be narrower


@dataclass(frozen=True)
class ExploredPage:
    """A page with sliders for the system `name`; a notebook shows the page `html` in a frame."""

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
    """Return the page of a system with sliders: first those in the dict `ranges`, then those in the keywords `named`.

    Both map symbols or names to bounds (low, high). `model()` compiles the system. The end of the run is `t_end`, None
    for the stated end. With `play` the motion starts at once. `style` is "light" or "dark". Raises StatementError for
    unknown names, invalid bounds, no or too many sliders, and for a system with contacts.
    """
    if statement.contacts:
        raise StatementError(NO_SLIDERS.format("explore()", "system.to_page(path) plays a run"))
    require_values(statement)
    bounds = chosen_bounds(statement, ranges) | chosen_bounds(statement, named)
    if not bounds:
        adjustable = places(statement)
        raise StatementError(
            f"no slider was asked for: give bounds such as explore({next(iter(adjustable))}=(0, 2)), for one of "
            f"{listing(adjustable)}."
        )
    if len(bounds) > MOST_SLIDERS:
        raise StatementError(f"{len(bounds)} sliders were asked for: give bounds for at most {MOST_SLIDERS}.")
    flag(play, "play")
    look = style_of(style)
    end = statement.run.t_end if t_end is None else real_number(t_end, "t_end, the time at which runs end,")
    parameters, initial = starts_within(statement, bounds)
    page = page_of(model(), None, parameters, initial, bounds, t_end=end, play=play, style=look.name)
    return ExploredPage(plain_text(statement.name), page)


def starts_within(
    statement: Statement, bounds: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the values at which sliders start, in two dicts by name: parameters, and initial state with body rates.

    A slider starts at the stated value, or at the bound nearest to it. A parameter without a value starts in the middle
    of its slider. `bounds` are the bounds of the sliders.
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
