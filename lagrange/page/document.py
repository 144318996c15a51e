"""The HTML document of a page: its parts, its scripts, and the security policy that admits no other script."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

from lagrange.page.script_data import moving_points
from lagrange.show.figures.style import DARK, LIGHT, NAMED_POINTS, FigureStyle, colours
from lagrange.show.notation.text import UnicodeNotation
from lagrange.statement.statement import Statement

SPACE = 3
"""Dimension of space: positions with this number of entries can be turned."""


def legend(statement: Statement) -> str:
    """Return an HTML list of the names of the moving points in their colours; empty for a single point or for many."""
    names = moving_points(statement)
    if not 1 < len(names) <= NAMED_POINTS:
        return ""
    rows = (f'<li><i class="colour{k}"></i>{escape(name)}</li>' for k, name in enumerate(names))
    return f'<ul class="legend">{"".join(rows)}</ul>'


def hint(statement: Statement) -> str:
    """Return HTML with instructions for turning the picture, empty for a system that does not move in space."""
    in_space = any(len(point) == SPACE for point in statement.positions.values())
    return '<p class="hint">Drag to turn</p>' if in_space else ""


def phase_choices(statement: Statement) -> str:
    """Return the HTML options for the choice of the coordinate in the phase plane."""
    letter = UnicodeNotation(statement.names).letter
    return "".join(f'<option value="{k}">{escape(letter(name))}</option>' for k, name in enumerate(statement.names))


LEAST_COLOURS = 3
"""Least number of colours on a page: the plot of energies has three lines."""


def colour_rules(statement: Statement) -> str:
    """Return CSS with the colours of the points and coordinates of a system, in the light and the dark style."""
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
"""Scripts that draw and control a motion."""

COMPUTED = ("motion", "sliders")
"""Scripts of a motion that the page computes."""

RECORDED = ("recording",)
"""Scripts of a recorded motion."""

ENDS = re.compile(r"<(?=/script|script|!--)", re.IGNORECASE)
"""Text that would end a script element early, or open a comment inside it."""

_COMMENT = re.compile(r"^ *(//.*|/\*\*.*\*/|/\*\*$(?:\n *\* .*)*\n *\*/)$|/\*.*?\*/", re.MULTILINE)


def html(name: str, parts: Mapping[str, str], scripts: Mapping[str, str], hidden: str = "", *, trusted: bool) -> str:
    """Return a page: the template file `name`, filled with its parts and scripts by the names of their fields.

    The security policy of the page allows only `scripts`, the style in `parts`, and `hidden`, a script that the others
    add later. They are allowed by their hashes, and requests are not allowed. With `trusted` no script can add another
    one.
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
    """Return the JavaScript files with these names in the folder of page templates, as one text."""
    return '"use strict";\n' + "\n".join(template(f"{name}.js") for name in names)


def short(text: str) -> str:
    """Return a script or a style sheet without its comments and indents."""
    return "\n".join(line.strip() for line in _COMMENT.sub("", text).splitlines() if line.strip())


def in_script(text: str) -> str:
    """Return a script, escaped so that it can be the content of a script element.

    Only names and comments of a user can contain a text that ends the element. A backslash is inserted there, which
    JavaScript ignores in a text or a comment.
    """
    return ENDS.sub("<\\\\", text)


def hash_of(text: str) -> str:
    """Return the hash of a script or a style in the form of a content security policy: 'sha256-...'."""
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


FIELD = re.compile(r"\{\{(\w+)\}\}")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """Return a template with its fields replaced by `parts`. Text in a part that looks like a field is kept."""
    return FIELD.sub(lambda match: parts[match[1]], template)


_ESCAPED = str.maketrans({mark: f"\\u{ord(mark):04x}" for mark in "<>&"})
"""Escapes in JSON of characters with a meaning in HTML. All characters beyond ASCII are escaped by json itself."""


def as_json(data: Mapping[str, Any]) -> str:
    """Return data as JSON that cannot end a script element or begin a comment. Raises ValueError for NaN."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).translate(_ESCAPED)
