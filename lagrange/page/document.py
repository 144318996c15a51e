"""Assemble the HTML document of a page: data for the scripts, colours, templates, and content security policy."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from lagrange.errors import StatementError
from lagrange.export.contents import contents_of, module_of
from lagrange.export.target import find, missing_operation
from lagrange.machine.model import Model
from lagrange.show.figures.paths import AZIMUTH, ELEVATION, spring
from lagrange.show.figures.style import DARK, LIGHT, NAMED_POINTS, FigureStyle, colours, point_look
from lagrange.show.notation.text import UnicodeNotation, plain_text
from lagrange.statement.declare import ORIGIN
from lagrange.statement.statement import Statement, corners, energy_unit, length_unit, unit_of
from lagrange.trajectory.measures.times_and_points import moving_points

ALWAYS = ("rhs", "energy", "dop853")  # Contents that every page exports; dop853 computes the motion

TOLERANCE = 1e-13
"""Relative and absolute tolerance with which a page computes the motion. In a minute of motion the energy of the double
pendulum drifts by some 1e-12. The computation of one picture takes 30 us."""

PAGE_STEPS = 5000  # Largest number of integration steps between two states that a page draws; a pendulum takes one


def contents(statement: Statement) -> tuple[str, ...]:
    """Return the names of the quantities, such as "energies", that the JavaScript of a system's page has to compute."""
    optional = {"energies": not statement.lagrangian_alone, "positions": bool(statement.positions)}
    return (*ALWAYS, *(name for name, present in optional.items() if present))


def motion_script(model: Model, parameters: Mapping[Any, Any] | None) -> tuple[str, tuple[float, ...]]:
    """Return the script that computes the motion of a model, and the values of the model's parameters.

    The script is the exported JavaScript module. It ends with a call that passes its functions to the page, because no
    other script can import an inline module. Raises StatementError for functions that JavaScript lacks.
    """
    target, quantities = find("javascript"), contents(model.statement)
    module = module_of(model, contents_of(target, model, quantities, (), parameters), (), parameters)
    missing = missing_operation(target, module)
    if missing is not None:
        quantity, function = missing
        raise StatementError(
            f"a page of {model.statement.name} cannot be made: its {quantity} contains {function}, which JavaScript "
            f"does not have. State the system without {function}."
        )
    names = ["prepare", "STATE", "PREPARED", *quantities, *(["projection"] if model.equations.constraints else [])]
    text = target.files(module)[f"{module.name}.mjs"]
    return in_script(f"{text!s}\nstartPage({{ {', '.join(names)} }});\n"), module.values


LONGEST_RUN, SHORTEST_RUN = 60.0, 1.0
"""Longest and shortest run, in units of time, that plays at one unit per second. Other runs play in `SHOWN` seconds."""
SHOWN = 20.0


ENERGIES = ("E", "T", "V")
"""Names of the conserved energy E and, if they were stated, of T and V. The scripts of a page use the same order."""


def description(statement: Statement, rate: float, energies: Sequence[str], energy_letter: str) -> dict[str, Any]:
    """Return the data of a system that the scripts of a page read, as a dict for JSON: names, points, links, units.

    The view of space and the shape of springs are the same as in figures. `rate` is the time of the run per second on
    the screen. `energies` are the names of the energies to draw, and `energy_letter` is the printed letter of the first
    one, the conserved energy.
    """
    notation = UnicodeNotation([*statement.names, *(symbol.name for symbol in statement.parameters)])
    # A dot above a letter would be too small on a screen: the velocity is dx/dt.
    entries = [(name, f"{name}{'_dot' * dots}", dots) for dots in (0, 1) for name in statement.names]
    return {
        "name": plain_text(statement.name),
        "states": [
            {
                "name": typed,
                "letter": f"d{notation.letter(name)}/dt" if dots else notation.letter(name),
                "unit": unit_of(statement, typed),
            }
            for name, typed, dots in entries
        ],
        **_points(statement),
        "view": [math.radians(AZIMUTH), math.radians(ELEVATION)],
        "spring": spring(np.zeros(2), np.array([1.0, 0.0]), 1.0).T.round(4).tolist(),
        "rate": rate,
        "decimals": 4 if abs(rate) < 1 else 2,
        "energies": [energy_letter if name == "E" else name for name in energies],
        "energySize": 0.0,
        "zero": 0.0,
        "play": True,
        "unit": {"t": unit_of(statement, "t"), "length": length_unit(statement), "energy": energy_unit(statement)},
    }


def _points(statement: Statement) -> dict[str, Any]:
    """Return the data of the named points, as a dict for JSON.

    - `points` are their names, `dimension` is 2 or 3.
    - `links` are pairs of indices of points with the kind of the link; the index after the last point is the origin.
    - `drawn` is the number of named points and of points of surfaces together; the points of surfaces come last.
    - `surfaces` has for each surface the index of its first point and the number of its points.
    - `colours` has a colour index for each point, null if the point is fixed.
    - `size` is a factor for the size of the points.
    - `corners` has true for each named point that is a corner of a shape and has no dot.
    """
    names = list(statement.positions)
    dimension = max(map(len, statement.positions.values()), default=0)
    indices = {name: index for index, name in enumerate([*names, ORIGIN])}
    links = [[indices[link.start], indices[link.end], link.kind] for link in statement.links]
    sizes = [len(line) for line in statement.outlines.values()]
    firsts = np.cumsum([len(names), *sizes]).tolist()
    moving = moving_points(statement)
    several = len(moving) <= NAMED_POINTS
    numbers = {name: number if several else 0 for number, name in enumerate(moving)}
    return {
        "points": names,
        "colours": [numbers.get(name) for name in names],
        "corners": [name in corners(statement.links) for name in names],
        "size": point_look(len(moving))[1],
        "dimension": dimension,
        "links": links,
        "drawn": len(statement.drawn),
        "surfaces": [[first, size] for first, size in zip(firsts, sizes, strict=False)],
    }


def rate_of(t_end: float) -> float:
    """Return the speed at which a page plays: time of the run per second on the screen, with the sign of `t_end`.

    The speed is 1 for a run of `SHORTEST_RUN` to `LONGEST_RUN` units of time. Any other run is shown in `SHOWN`
    seconds: its speed is `t_end` / `SHOWN`, rounded to one digit.
    """
    length = abs(t_end)
    shown = 1.0 if SHORTEST_RUN <= length <= LONGEST_RUN else float(f"{length / SHOWN:.1g}")
    return math.copysign(shown, t_end)


def legend(statement: Statement) -> str:
    """Return an HTML list of the moving points with their colours; empty for one point, or over `NAMED_POINTS`."""
    names = moving_points(statement)
    if not 1 < len(names) <= NAMED_POINTS:
        return ""
    rows = (f'<li><i class="colour{k}"></i>{escape(name)}</li>' for k, name in enumerate(names))
    return f'<ul class="legend">{"".join(rows)}</ul>'


def hint(statement: Statement) -> str:
    """Return HTML with instructions for turning the picture, empty for a system that does not move in space."""
    in_space = any(len(point) == 3 for point in statement.positions.values())
    return '<p class="hint">Drag to turn</p>' if in_space else ""


def phase_choices(statement: Statement) -> str:
    """Return the HTML options for the choice of the coordinate in the phase plane."""
    letter = UnicodeNotation(statement.names).letter
    return "".join(f'<option value="{k}">{escape(letter(name))}</option>' for k, name in enumerate(statement.names))


LEAST_COLOURS = 3  # Least number of colours on a page: the plot of energies has three lines


def colour_rules(statement: Statement) -> str:
    """Return CSS rules with the colours of a system's points and coordinates, for the light and the dark style."""
    count = max(len(moving_points(statement)), len(statement.names), LEAST_COLOURS)
    light, dark = (_variables(style, count) for style in (LIGHT, DARK))
    swatches = "".join(f".colour{k}{{background:var(--colour{k})}}" for k in range(count))
    return (
        f":root{{color-scheme:light;{light}}}\n"
        f"@media (prefers-color-scheme:dark){{:root:not([data-style=light]){{color-scheme:dark;{dark}}}}}\n"
        f":root[data-style=dark]{{color-scheme:dark;{dark}}}\n{swatches}\n"
    )


def _variables(style: FigureStyle, count: int) -> str:
    lines = [*style.colours, *colours(count, style.colours)[len(style.colours) :]]
    named = {"paper": style.paper, "ink": style.ink, "quiet": style.quiet, "grid": style.grid}
    named |= {"accent": lines[0], "warning": lines[1]}
    named |= {f"colour{k}": colour for k, colour in enumerate(lines[:count])}
    return "".join(f"--{name}:{colour};" for name, colour in named.items())


TEMPLATE = Path(__file__).resolve().parent / "template"

PICTURES = ("numbers", "view", "picture", "plots", "controls", "page")
"""Names of the JavaScript files that draw and control a motion, in the order in which they are joined."""

COMPUTED = ("motion", "sliders")  # Scripts of a motion that the page computes
RECORDED = ("recording",)  # Scripts of a recorded motion

ENDS = re.compile(r"<(?=/script|script|!--)", re.IGNORECASE)
"""Pattern of the first character of a text that would end a script element early, or open a comment inside it."""

_COMMENT = re.compile(r"^ *(//.*|/\*\*.*\*/|/\*\*$(?:\n *\* .*)*\n *\*/)$|/\*.*?\*/", re.MULTILINE)


def html(name: str, parts: Mapping[str, str], scripts: Mapping[str, str], hidden: str = "", *, trusted: bool) -> str:
    """Return a page: the template file `name` with its fields replaced by the texts of `parts` and `scripts`, by name.

    The security policy of the page allows only `scripts`, the style sheet in `parts`, and `hidden`, a script that the
    others add later. All are identified by their hashes; requests over the network are not allowed. If `trusted`,
    scripts cannot turn text into HTML or into other scripts.
    """
    allowed = " ".join(hash_of(script) for script in (*scripts.values(), hidden) if script)
    policy = f"default-src 'none'; script-src {allowed}; style-src {hash_of(parts['style'])}; base-uri 'none'; "
    policy += "form-action 'none'"
    if trusted:
        policy += "; require-trusted-types-for 'script'; trusted-types 'none'"
    return filled(template(name), {**parts, **scripts, "policy": policy})


@cache
def template(name: str) -> str:
    """Return the text of the file `name` in the folder of page templates."""
    return (TEMPLATE / name).read_text("utf-8")


@cache
def joined(*names: str) -> str:
    """Return one script: the JavaScript files with these names, without .js, from the folder of page templates."""
    return '"use strict";\n' + "\n".join(template(f"{name}.js") for name in names)


def short(text: str) -> str:
    """Return `text`, a script or a style sheet, without its comments, indents and empty lines."""
    return "\n".join(line.strip() for line in _COMMENT.sub("", text).splitlines() if line.strip())


def in_script(text: str) -> str:
    """Return a script, escaped so that it can be the content of an HTML script element.

    A text such as "</script" would end the element. It can occur only in a user's names and comments. A backslash is
    inserted into it, which JavaScript ignores in strings and comments.
    """
    return ENDS.sub("<\\\\", text)


def hash_of(text: str) -> str:
    """Return the hash of a script or a style in the form of a content security policy: 'sha256-...'."""
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


FIELD = re.compile(r"\{\{(\w+)\}\}")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """Return a template with its fields {{name}} replaced by the texts in `parts`; fields inside of texts stay."""
    return FIELD.sub(lambda match: parts[match[1]], template)


_ESCAPED = str.maketrans({mark: f"\\u{ord(mark):04x}" for mark in "<>&"})
"""Translation of the characters that have a meaning in HTML to their escapes in JSON. `json` itself escapes all
characters beyond ASCII."""


def as_json(data: Mapping[str, Any]) -> str:
    """Return data as JSON that cannot end a script element or begin a comment. Raises ValueError for NaN."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).translate(_ESCAPED)


def in_frame(page: str, title: str, width: int, height: int) -> str:
    """Return the HTML of an iframe that contains `page`, so that the page and a notebook do not affect each other.

    `title` is the title of the frame. `width` is its largest width in pixels, and `height` its height.
    """
    style = f"width:100%;max-width:{width}px;height:{height}px;border:0;display:block"
    inside = page.replace("&", "&amp;").replace('"', "&quot;")
    return f'<iframe title="{title}" sandbox="allow-scripts" style="{style}" srcdoc="{inside}"></iframe>'
